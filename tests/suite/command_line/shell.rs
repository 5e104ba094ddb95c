//! Shell completions, manual pages and `doctor`.

use super::*;

#[test]
fn pages_and_completions_know_every_command() {
    let folder = temp_folder();
    let commands = listed_subcommands(&run_crumple(folder.path(), "--help"));
    assert!(commands.len() > 15, "{commands:?}");
    run_ok(folder.path(), "man --out man");
    for command in &commands {
        let page =
            fs::read_to_string(folder.path().join(format!("man/crumple-{command}.1"))).unwrap();
        assert!(
            page.contains(".SH SYNOPSIS") && page.contains("130  interrupted"),
            "{command}"
        );
    }
    assert!(folder.path().join("man/crumple-verify-rate.1").exists());
    // The synopsis is the usage of `--help`: required options without brackets, with their values.
    for words in ["suite run", "verify rate", "simulate"] {
        let help = run_crumple(folder.path(), &format!("{words} --help"));
        let usage = stdout(&help)
            .lines()
            .find_map(|line| line.strip_prefix("Usage: "))
            .expect("a usage")
            .to_owned();
        let page = fs::read_to_string(
            folder
                .path()
                .join(format!("man/crumple-{}.1", words.replace(' ', "-"))),
        )
        .unwrap();
        let synopsis = page
            .split(".SH SYNOPSIS\n")
            .nth(1)
            .unwrap()
            .split("\n.SH")
            .next()
            .unwrap();
        let plain = synopsis
            .replace("\\fB", "")
            .replace("\\fR", "")
            .replace("\\fI", "")
            .replace("\\-", "-");
        assert_eq!(
            plain.split_whitespace().collect::<Vec<_>>(),
            usage.split_whitespace().collect::<Vec<_>>()
        );
    }
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = run_ok(folder.path(), &format!("completions {shell}"));
        let missing: Vec<_> = commands
            .iter()
            .filter(|command| !stdout(&script).contains(*command))
            .collect();
        assert!(missing.is_empty(), "{shell}: {missing:?}");
    }
    assert_refused(
        &run_crumple(folder.path(), "completions tcsh"),
        "invalid value 'tcsh'",
    );
}

/// Completions offer the built-in names; the program and the scripts still take files.
#[test]
fn completions_have_the_built_in_names() {
    let folder = temp_folder();
    let bash = run_ok(folder.path(), "completions bash");
    fs::write(folder.path().join("crumple.bash"), stdout(&bash)).unwrap();
    let complete = |words: &str| {
        let script = format!(
            ". ./crumple.bash; COMP_WORDS=(crumple {words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); _crumple crumple \
             \"${{COMP_WORDS[COMP_CWORD]}}\" \"${{COMP_WORDS[COMP_CWORD - 1]}}\"; echo \"${{COMPREPLY[@]}}\""
        );
        let output = Command::new("bash")
            .args(["-c", &script])
            .current_dir(folder.path())
            .output()
            .unwrap();
        stdout(&output).trim().to_owned()
    };
    for (words, expected) in [
        ("falsify --controller base", "baseline"),
        ("falsify --against poli", "policy"),
        ("falsify --space high", "high-risk high-risk-human"),
        ("falsify --method cma", "cma-es"),
        ("verify rate --space traf", "traffic traffic-human"),
        ("suite run un-r152 --controller fuz", "fuzzy-safety"),
        ("simulate pap", "paper-1 paper-2 paper-3"),
        ("check proof.json --scenario pap", "paper-1 paper-2 paper-3"),
        ("simulate paper-1 --controller shield:id", "shield:idm"),
        ("show un-", "un-r152 un-r157"),
        ("show openacc", "openacc"),
        ("show hea", "heavy"),
        ("import a.csv --map openacc", "openacc"),
        ("replay a.csv --map ngs", "ngsim"),
        ("train --preset paper", "paper paper-net"),
        ("retrain --preset r", "retrain road"),
        ("retrain --policy r", "retrained road"),
        ("suite run fmvss", "fmvss-127"),
        ("verify reach --box pap", "paper-1 paper-2"),
        // The option `-o default` of `complete` then offers files.
        ("simulate paper-1 --controller my-", ""),
    ] {
        assert_eq!(complete(words), expected, "{words}");
    }
    assert!(stdout(&bash).contains("-o default crumple"));
    // As bash calls it: it splits words at colons, and replaces only the part after the last one.
    let split = "simulate paper-1 --controller shield : hum";
    let line = "crumple simulate paper-1 --controller shield:hum";
    let script = format!(
        ". ./crumple.bash; COMP_WORDS=(crumple {split}); COMP_CWORD=6; COMP_LINE='{line}'; COMP_POINT={}; \
         _crumple_with_colons crumple hum :; echo \"${{COMPREPLY[@]}}\"; complete -p crumple",
        line.len()
    );
    let output = Command::new("bash")
        .args(["-c", &script])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(
        stdout(&output).starts_with("human\n")
            && stdout(&output).contains("-F _crumple_with_colons crumple"),
        "{output:?}"
    );
    for (shell, parts) in [
        (
            "zsh",
            [
                ":{compadd -- baseline idm ",
                " paper-3; _files}",
                " shield2:road; _files}",
                ":{compadd -- fmvss-127 ",
            ],
        ),
        (
            "fish",
            [
                " -r -F -a \"baseline\\t''\nidm\\t''",
                "-n \"__fish_crumple_using_subcommand simulate\" -a \"paper-1 paper-2 paper-3\"\n",
                "-n \"__fish_crumple_using_subcommand suite; and __fish_seen_subcommand_from run\" -a \"fmvss-127 ",
                "\nshield2:road\\t''\"",
            ],
        ),
    ] {
        let script = run_ok(folder.path(), &format!("completions {shell}"));
        assert_contains(stdout(&script), &parts);
        for without_files in [
            " -r -f -a \"baseline",
            " -r -f -a \"paper",
            ":(baseline ",
            ":(paper-1 paper-2 paper-3)",
        ] {
            assert!(
                !stdout(&script).contains(without_files),
                "{shell}: {without_files}"
            );
        }
    }
}

/// Text for users calls it a collision.
#[test]
fn help_calls_a_collision_a_collision() {
    let folder = temp_folder();
    run_ok(folder.path(), "man --out man");
    for page in file_names_in(&folder.path().join("man")) {
        let text = fs::read_to_string(folder.path().join("man").join(&page))
            .unwrap()
            .replace("\\-", "-");
        let values: Vec<_> = text
            .lines()
            .filter(|line| line.to_lowercase().contains("contact"))
            .collect();
        assert!(values.is_empty(), "{page}: {values:?}");
    }
}

/// An empty `PATH` is no error.
#[test]
fn doctor_names_missing_programs() {
    let folder = temp_folder();
    let output = command(folder.path(), "doctor --format json")
        .env("PATH", "/nowhere")
        .output()
        .unwrap();
    assert_eq!(exit_code(&output), 0, "{}", stderr(&output));
    let report = &json_objects(&output)[0];
    // The first is crumple's FMU host, next to the program.
    assert!(
        report["needs"]
            .as_array()
            .unwrap()
            .iter()
            .skip(1)
            .all(|need| need["found"].is_null())
    );
    assert!(report["fused_multiply_add"].is_boolean());
    assert!(
        report["register_bits"].as_u64().unwrap() >= 64 && report["threads"].as_u64().unwrap() >= 1
    );
    let text = run_crumple(folder.path(), "doctor");
    assert!(
        stdout(&text).contains("cargo-fuzz") && stdout(&text).starts_with("crumple 0."),
        "{}",
        stdout(&text)
    );
}

/// The printed file can replace the name.
#[test]
fn built_in_items_are_shown_as_files() {
    let folder = temp_folder();
    let show = |arguments: &str| {
        let shown = run_ok(folder.path(), &format!("show {arguments}"));
        fs::write(folder.path().join("mine.toml"), stdout(&shown)).unwrap();
        stdout(&shown).to_owned()
    };
    let runs = |arguments: &str| {
        let run = run_crumple(folder.path(), arguments);
        assert_eq!(exit_code(&run), 0, "{arguments:?}: {}", stderr(&run));
        stdout(&run).to_owned()
    };
    show("paper-1");
    assert_eq!(runs("simulate mine.toml"), runs("simulate paper-1"));
    show("traffic");
    runs("verify rate --controller idm --space mine.toml --runs 5 --out rate");
    show("fast");
    let trained = run_crumple(
        folder.path(),
        "train --preset mine.toml --seed 1 --episodes 1 --out runs",
    );
    assert_ne!(exit_code(&trained), 2, "{}", stderr(&trained));
    show("un-r152");
    assert_eq!(
        runs("suite run mine.toml --controller idm"),
        runs("suite run un-r152 --controller idm")
    );
    show("openacc");
    let recording = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/corpora/recordings/synthetic-platoon.csv"
    );
    runs(&format!("import '{recording}' --map mine.toml"));
    show("paper-2 --kind box");
    let reached = run_crumple(folder.path(), "verify reach --box mine.toml --depth 0");
    assert_ne!(exit_code(&reached), 2, "{}", stderr(&reached));
    let vehicle = show("heavy");
    let head = "version = 1\nname = \"two\"\nduration_s = 1.0\n[[vehicles]]\nclass = \"light\"\nposition_m = \
        50.0\nspeed_mps = 0.0\n\
                driver.constant-speed = {}\n";
    fs::write(folder.path().join("two.toml"), format!("{head}{vehicle}")).unwrap();
    runs("simulate two.toml --expect safe");

    let shown = run_crumple(folder.path(), "show paper");
    assert!(
        stdout(&shown).contains("[[parameters]]") && stderr(&shown).contains("--kind preset"),
        "{shown:?}"
    );
    assert!(show("paper --kind preset").contains("actor_rate"));
    assert!(show("retrain").contains("[td3]"));
    let unknown = run_crumple(folder.path(), "show paper-4");
    assert_refused(
        &unknown,
        "there is no built-in file `paper-4`. Names: assessment: assessment; scenario: paper-1, paper-2, paper-3; \
         space: paper,",
    );
    for name in ["fast", "fmvss-127", "car-following", "heavy"] {
        assert!(stderr(&unknown).contains(name), "{name}");
    }
}
