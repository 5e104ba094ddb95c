//! Search methods: their trait and their names.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::auto::Auto;
use super::cma_es::CmaEs;
use super::cross_entropy::CrossEntropy;
use super::cube::UnitCube;
use super::halton::Halton;
use super::uniform::UniformSearch;

/// A search for the smallest robustness in a unit cube. [`CustomMethod`] adds an implementation to a campaign.
pub trait SearchAlgorithm: fmt::Debug + Send {
    /// Proposes the next points to evaluate, at least one, every coordinate in [0, 1].
    fn ask(&mut self) -> Vec<Vec<f64>>;

    /// Receives the robustness of the last points, in their order. If it is shorter (the budget is used up), the other
    /// points were not evaluated. NaN counts as +∞: a point that cannot be evaluated is no counterexample.
    fn tell(&mut self, robustness: &[f64]);
}

/// A search method. Files and the command line support only the built-in ones.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Method {
    /// Independent uniform points.
    Uniform,
    /// A randomised Halton sequence.
    Halton,
    /// Covariance matrix adaptation with restarts.
    CmaEs,
    /// Cross-entropy with independent normal coordinates.
    CrossEntropy,
    /// A portfolio.
    Auto,
    /// A method of the program that uses this library.
    Custom(CustomMethod),
}

/// A search method that is not built in: a name, and a function that starts a search from a cube and a seed.
///
/// A campaign records the name, and does not resume with a method of another name. `crumple explore`
/// cannot show it, because it reads the method from a file.
/// `docs/optimisers.md` in the repository has a complete example.
#[derive(Clone)]
pub struct CustomMethod {
    name: Arc<str>,
    start: Arc<SearchFactory>,
}

type SearchFactory = dyn Fn(&UnitCube, u64) -> Box<dyn SearchAlgorithm> + Send + Sync;

/// The error of an invalid name of a custom method.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{name:?} cannot name a search method: use 1 to 40 of a-z, 0-9 and -, and not the name of a built-in method"
)]
pub struct InvalidMethodName {
    /// The name.
    pub name: String,
}

impl CustomMethod {
    /// Creates a method from a name and a function that starts a search.
    ///
    /// # Errors
    /// [`InvalidMethodName`] for the name of a built-in method, or unless it is 1 to 40 of `a-z`, `0-9` and `-`.
    pub fn new(
        name: &str,
        start: impl Fn(&UnitCube, u64) -> Box<dyn SearchAlgorithm> + Send + Sync + 'static,
    ) -> Result<Self, InvalidMethodName> {
        let is_plain = name
            .bytes()
            .all(|byte| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-'));
        if !is_plain || !(1..=40).contains(&name.len()) || name.parse::<Method>().is_ok() {
            return Err(InvalidMethodName {
                name: name.to_owned(),
            });
        }
        Ok(Self {
            name: name.into(),
            start: Arc::new(start),
        })
    }
}

impl PartialEq for CustomMethod {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for CustomMethod {}

impl fmt::Debug for CustomMethod {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("CustomMethod").field(&self.name).finish()
    }
}

/// The error of a name that is not that of a method.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown search method `{name}`; the methods are: {}", Method::ALL.each_ref().map(Method::name).join(", "))]
pub struct UnknownMethod {
    /// The name.
    pub name: String,
}

impl Method {
    /// All built-in methods.
    pub const ALL: [Self; 5] = [
        Self::Uniform,
        Self::Halton,
        Self::CmaEs,
        Self::CrossEntropy,
        Self::Auto,
    ];

    /// Returns the name used on the command line and in files.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::Uniform => "uniform",
            Self::Halton => "halton",
            Self::CmaEs => "cma-es",
            Self::CrossEntropy => "cross-entropy",
            Self::Auto => "auto",
            Self::Custom(custom) => &custom.name,
        }
    }

    /// Describes the method in one line.
    #[must_use]
    pub fn summary(&self) -> &'static str {
        match self {
            Self::Uniform => "independent uniform points",
            Self::Halton => "a randomised Halton sequence",
            Self::CmaEs => "covariance matrix adaptation with restarts",
            Self::CrossEntropy => "cross-entropy with independent normal coordinates",
            Self::Auto => {
                "several methods that share the budget: random points with few, often extreme values of each signal; \
                 CMA-ES; bisection between different outcomes; hill climbs; sequential convex programs"
            }
            Self::Custom(_) => "a method of the program that uses the library",
        }
    }

    /// Returns true for non-adaptive methods (uniform, Halton).
    #[must_use]
    pub fn is_non_adaptive(&self) -> bool {
        matches!(self, Self::Uniform | Self::Halton)
    }

    /// Starts a search in `cube`, determined by `seed`.
    #[must_use]
    pub fn start(&self, cube: &UnitCube, seed: u64) -> Box<dyn SearchAlgorithm> {
        match self {
            Self::Uniform => Box::new(UniformSearch::new(cube, seed)),
            Self::Halton => Box::new(Halton::new(cube, seed)),
            Self::CmaEs => Box::new(CmaEs::new(cube, seed)),
            Self::CrossEntropy => Box::new(CrossEntropy::new(cube, seed)),
            Self::Auto => Box::new(Auto::new(cube, seed)),
            Self::Custom(custom) => (custom.start)(cube, seed),
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl From<Method> for String {
    fn from(method: Method) -> Self {
        method.name().to_owned()
    }
}

impl TryFrom<String> for Method {
    type Error = UnknownMethod;

    fn try_from(name: String) -> Result<Self, UnknownMethod> {
        name.parse()
    }
}

impl FromStr for Method {
    type Err = UnknownMethod;

    fn from_str(name: &str) -> Result<Self, UnknownMethod> {
        Self::ALL
            .into_iter()
            .find(|method| method.name() == name)
            .ok_or_else(|| UnknownMethod {
                name: name.to_owned(),
            })
    }
}

/// Replaces NaN by infinity, so that it ranks worst.
pub(super) fn nan_as_infinity(robustness: f64) -> f64 {
    if robustness.is_nan() {
        f64::INFINITY
    } else {
        robustness
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::falsify::campaign::{Campaign, CampaignError, CampaignProgress};
    use crumple_core::observer::Quiet;
    use crumple_store::study::Study;
    use proptest::prelude::*;
    use std::ops::ControlFlow;

    #[derive(Debug)]
    struct FixedPointSearch(Vec<f64>);

    impl SearchAlgorithm for FixedPointSearch {
        fn ask(&mut self) -> Vec<Vec<f64>> {
            vec![self.0.clone()]
        }

        fn tell(&mut self, _: &[f64]) {}
    }

    fn campaign(name: &str, coordinate: f64) -> Campaign {
        let start = move |cube: &UnitCube, _| -> Box<dyn SearchAlgorithm> {
            Box::new(FixedPointSearch(vec![coordinate; cube.dimension()]))
        };
        Campaign::of_match_leader(
            "high-risk",
            Method::Custom(CustomMethod::new(name, start).unwrap()),
            10,
            7,
        )
    }

    #[test]
    fn a_campaign_with_a_custom_method_is_resumed_by_its_name_only() {
        let [whole, part] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let expected = campaign("mine", 0.5)
            .run(whole.path(), false, &Quiet)
            .unwrap();
        assert_eq!(
            (expected.method.as_str(), expected.evaluations),
            ("mine", 10)
        );
        let stop = |progress: &CampaignProgress| match progress.evaluations {
            ..5 => ControlFlow::Continue(()),
            _ => ControlFlow::Break(()),
        };
        let stopped = campaign("mine", 0.5).run(part.path(), false, &stop);
        assert!(
            matches!(stopped, Err(CampaignError::Stopped(_))),
            "{stopped:?}"
        );
        let refused = campaign("other", 0.5)
            .run(part.path(), true, &Quiet)
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("the campaign there has a different configuration"),
            "{refused}"
        );
        assert_eq!(
            campaign("mine", 0.5)
                .run(part.path(), true, &Quiet)
                .unwrap(),
            expected
        );
    }

    #[test]
    fn custom_methods_that_do_not_fit_are_refused() {
        for name in ["", "auto", "My method", &"x".repeat(41)] {
            assert!(
                CustomMethod::new(name, |_, _| Box::new(FixedPointSearch(Vec::new()))).is_err(),
                "{name}"
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let outside = campaign("outside", 1.5).run(&folder.path().join("a"), false, &Quiet);
        let message = outside.unwrap_err().to_string();
        assert_eq!(
            message,
            "the search method `outside` must propose coordinates from 0 to 1, and proposed 1.5"
        );
        let cube = UnitCube::new([15]).unwrap();
        for (points, expected) in [
            (
                vec![vec![0.5; 15], vec![0.5; 14]],
                "must propose points of 15 coordinates, and proposed one of 14",
            ),
            (
                Vec::new(),
                "must propose at least one point each time, and proposed none",
            ),
            (
                vec![vec![f64::NAN; 15]],
                "must propose coordinates from 0 to 1, and proposed NaN",
            ),
        ] {
            assert_eq!(
                cube.check_points(&points).unwrap_err().to_string(),
                expected
            );
        }
        assert_eq!(cube.check_points(&[vec![0.0; 15], vec![1.0; 15]]), Ok(()));
    }

    proptest! {
        // Each case runs all methods twice.
        #![proptest_config(crumple_cases::with_cases(100))]

        #[test]
        fn every_method_stays_in_the_cube_and_repeats_itself(
            lengths in prop::collection::vec(prop_oneof![Just(1usize), 2usize..22], 1..4),
            leader in prop::collection::vec(0usize..40, 0..8),
            seed in any::<u64>(),
            values in prop::collection::vec(
                prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(1.0), -1.0..1.0f64],
                20,
            ),
        ) {
            let cube = UnitCube::new(lengths).unwrap().with_leader_coordinates(leader);
            for method in Method::ALL {
                prop_assert_eq!(&method.name().parse::<Method>().unwrap(), &method);
                let mut search = method.start(&cube, seed);
                let mut twin = method.start(&cube, seed);
                for round in 0..12 {
                    let points = search.ask();
                    prop_assert_eq!(&points, &twin.ask(), "{}", method);
                    prop_assert!(!points.is_empty());
                    for point in &points {
                        prop_assert_eq!(point.len(), cube.dimension());
                        prop_assert!(point.iter().all(|x| (0.0..=1.0).contains(x)), "{}: {:?}", method, point);
                    }
                    let costs: Vec<f64> = (0..points.len()).map(|i| values[(7 * i + round) % values.len()]).collect();
                    search.tell(&costs);
                    twin.tell(&costs);
                }
                // The budget ends in the middle of a batch.
                let points = search.ask();
                search.tell(&vec![1.0; points.len() / 2]);
                prop_assert!(!search.ask().is_empty());
            }
        }
    }
}
