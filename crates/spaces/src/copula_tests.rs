use super::*;
use crumple_sim::scenario::NoDriverFiles;
use proptest::prelude::*;
use std::path::Path;

const SPACE: &str = r#"version = 1
name = "pairs"
base = "paper-1"
[[parameters]]
name = "friction"
field = "environment.friction"
unit = "1"
distribution.gamma = { shape = 20.0, scale = 0.035, low = 0.3, high = 1.0 }
[[parameters]]
name = "ahead_m"
field = "vehicles[1].gap_m"
unit = "m"
distribution.log-normal = { ln_mean = 3.0, ln_deviation = 0.4, low = 2.0, high = 100.0 }
[[parameters]]
name = "class"
field = "vehicles[2].class"
distribution.choice = { values = ["light", "heavy"] }
[dependence.gaussian-copula]
parameters = ["ahead_m", "friction"]
correlation = [[1.0, -0.6], [-0.6, 1.0]]
[exposure]
episodes = 3
hours = 0.5
kilometres = 30.0
[[exposure.sources]]
name = "a.csv"
episodes = 3
hours = 0.5
kilometres = 30.0
[observed]
braking_clusters = [0, 0, 1]
[[observed.parameters]]
name = "friction"
low = 0.3
high = 1.0
values = [0.5, 0.6, 0.9]
"#;

const MATRIX: &str = "[[1.0, -0.6], [-0.6, 1.0]]";
const NAMES: &str = "[\"ahead_m\", \"friction\"]";
const HOURS: &str = "hours = 0.5\nkilometres = 30.0\n[[";

fn space(text: &str) -> Result<ScenarioSpace, String> {
    file::from_toml(text, Path::new("pairs.toml"), &NoDriverFiles)
        .map_err(|error| error.to_string())
}

#[test]
fn errors_of_dependence_exposure_and_data_name_their_field() {
    let damaged: [(&str, &str, &str); 25] = [
        (
            MATRIX,
            "[[1.0, 1.0], [1.0, 1.0]]",
            "correlation: must be positive definite",
        ),
        (
            MATRIX,
            "[[1.0, -0.6], [-0.5, 1.0]]",
            "correlation[0]: must be symmetric, found -0.6 and -0.5",
        ),
        (
            MATRIX,
            "[[1.0, -0.6], [-0.6, 0.9]]",
            "correlation[1]: must have 1 on the diagonal, found 0.9",
        ),
        (
            MATRIX,
            "[[1.0, -1.6], [-1.6, 1.0]]",
            "correlation[0]: must be from -1 to 1",
        ),
        (
            MATRIX,
            "[[1.0, nan], [nan, 1.0]]",
            "correlation[0]: must be from -1 to 1",
        ),
        (
            MATRIX,
            "[[1.0, -0.6]]",
            "correlation: must have 2 rows, found 1",
        ),
        (
            MATRIX,
            "[[1.0], [-0.6, 1.0]]",
            "correlation[0]: must have 2 entries, found 1",
        ),
        (
            NAMES,
            "[\"ahead_m\", \"unknown\"]",
            "parameters[1]: there is no parameter `unknown`",
        ),
        (
            NAMES,
            "[\"ahead_m\", \"ahead_m\"]",
            "parameters[1]: `ahead_m` is named twice",
        ),
        (
            NAMES,
            "[\"ahead_m\", \"class\"]",
            "parameters[1]: `class` is a class or a driver",
        ),
        (
            NAMES,
            "[\"ahead_m\"]",
            "parameters: must be 2 to 50, found 1",
        ),
        ("gaussian-copula", "clayton-copula", "clayton-copula"),
        (
            HOURS,
            "hours = 0.0\nkilometres = 30.0\n[[",
            "exposure.hours: must be a finite number above 0",
        ),
        (
            HOURS,
            "hours = 0.6\nkilometres = 30.0\n[[",
            "exposure.hours: is 0.6, and the sources add up to 0.5",
        ),
        (
            "episodes = 3\nhours = 0.5\nkilometres = 30.0\n[[",
            "episodes = 0\nhours = 0.5\nkilometres = 30.0\n[[",
            "exposure.episodes: must be at least 1",
        ),
        (
            "name = \"a.csv\"",
            "name = \"\"",
            "exposure.sources[0].name: must have 1 to 200 characters",
        ),
        (
            "[0, 0, 1]",
            "[0, 1]",
            "exposure.episodes: is 3, and 2 are observed",
        ),
        (
            "[0, 0, 1]",
            "[0, 0, 3]",
            "observed.braking_clusters: must be below the number of episodes, 3, found 3",
        ),
        (
            "[0.5, 0.6, 0.9]",
            "[0.5, 0.6]",
            "observed.parameters[0].values: must be 3, one an episode, found 2",
        ),
        (
            "[0.5, 0.6, 0.9]",
            "[0.5, 0.6, 1.9]",
            "observed.parameters[0].values: must be from 0.3 to 1, found 1.9",
        ),
        (
            "name = \"friction\"\nlow",
            "name = \"unknown\"\nlow",
            "observed.parameters[0].name: there is no parameter `unknown`",
        ),
        (
            "shape = 20.0",
            "shape = 0.0",
            "parameters[0].distribution.gamma: shape must be from 0.01 to 1000000, found 0",
        ),
        (
            "scale = 0.035",
            "scale = -1.0",
            "parameters[0].distribution.gamma: scale must be from 1e-9 to 1e9, found -1",
        ),
        (
            "ln_deviation = 0.4",
            "ln_deviation = 0.0",
            "parameters[1].distribution.log-normal: ln_deviation must be above 0",
        ),
        (
            "ln_mean = 3.0",
            "ln_mean = 30.0",
            "parameters[1].distribution.log-normal: the range from 2 to 100 holds a share of only",
        ),
    ];
    assert!(space(SPACE).is_ok());
    for (was, is, message) in damaged {
        assert!(SPACE.contains(was), "{was}");
        let error = space(&SPACE.replacen(was, is, 1)).expect_err(is);
        assert!(
            error.contains(message) && error.starts_with("pairs.toml:"),
            "{is}: {error}"
        );
    }
}

/// The copula density matches the samples: its mean inverse over samples is 1, and marginals stay uniform.
#[test]
fn draws_have_the_density_that_is_stated() {
    let space = space(SPACE).unwrap();
    let apart = self::space(SPACE.split("[dependence").next().unwrap()).unwrap();
    let (mut inverse, mut below) = (0.0, 0);
    for index in 0..20_000 {
        let point = space.draw_point(3, index);
        inverse += (apart.ln_likelihood(&point) - space.ln_likelihood(&point)).exp() / 20_000.0;
        below += u32::from(point[1] < apart.quantile(&[0.5, 0.3, 0.5])[1]);
    }
    assert!((inverse - 1.0).abs() < 0.05, "{inverse}");
    assert!((f64::from(below) / 20_000.0 - 0.3).abs() < 0.015, "{below}");
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Any uniform numbers, ends included, map to a point of the space.
    #[test]
    fn every_corner_of_the_cube_is_a_point(
        u in prop::collection::vec(prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64], 3),
    ) {
        let space = space(SPACE).unwrap();
        let point = space.quantile(&u);
        prop_assert!(point.iter().all(|x| (0.0..=1.0).contains(x)), "{point:?}");
        prop_assert!(space.scenario_at(&point).is_ok());
        prop_assert!(!space.ln_likelihood(&point).is_nan());
    }
    /// Searches stay in the region, which contains the stated share of random scenarios, and reach its surface.
    #[test]
    fn searches_stay_in_the_likelihood_region(
        point in prop::collection::vec(prop_oneof![Just(0.0), Just(1.0), 0.0..1.0f64], 3),
        share in 0.5..0.9999f64,
        seed in 0..1000u64,
    ) {
        let all = space(SPACE).unwrap();
        let text = SPACE.replace("braking_clusters", &format!("search_share = {share}\nbraking_clusters"));
        let space = space(&text).unwrap();
        let evaluated = space.search_point(&point);
        prop_assert!(space.is_in_search_region(&evaluated), "{evaluated:?}");
        prop_assert_eq!(&evaluated[2..], &point[2..], "a parameter that was not observed stays free");
        prop_assert_eq!(&all.search_point(&point), &point);
        let inside = (0..400).filter(|&index| space.is_in_search_region(&all.draw_point(seed, index))).count();
        let deviation = (share * (1.0 - share) / 400.0).sqrt();
        prop_assert!((inside as f64 / 400.0 - share).abs() < 5.0 * deviation + 0.004, "{inside} for {share}");
    }
}
