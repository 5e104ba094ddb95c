use super::*;

fn parse_error(arguments: &[&str]) -> String {
    SpaceComparisonArgs::parse(arguments.iter().map(|argument| (*argument).to_owned()))
        .err()
        .expect("refused")
        .to_string()
}

#[test]
fn arguments_that_make_no_sense_are_named() {
    assert_eq!(parse_error(&[]), "how many draws?");
    for draws in ["policy", "0", "-1", "1.5", "1000001", ""] {
        assert_eq!(
            parse_error(&[draws, "idm"]),
            format!("`{draws}` is no number of draws from 1 to 1000000")
        );
    }
    assert_eq!(parse_error(&["10"]), "which controllers?");
    assert_eq!(
        parse_error(&["10", "idm", "space=nowhere"]),
        "there is no built-in space `nowhere`"
    );
    assert_eq!(
        parse_error(&["10", "idm", "front.svg", "space=steady"]),
        "a figure needs the space `high-risk`"
    );
    assert!(
        parse_error(&["10", "idm", "hal"]).contains("`hal`"),
        "{}",
        parse_error(&["10", "idm", "hal"])
    );
    assert!(parse_error(&["10", "none.safetensors"]).contains("none.safetensors"));
    let asked =
        SpaceComparisonArgs::parse(["10", "idm", "space=steady"].into_iter().map(str::to_owned))
            .unwrap();
    assert_eq!((asked.draws, asked.spaces), (10, vec!["steady"]));
}
