//! Violated invariants with their reproducers.

use std::fmt;

use super::{TestCase, TestedController};
use crumple_core::quoting::ShellWord;
use crumple_world::control::ControllerSpec;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::Driver;
use crumple_world::scenario::file::to_toml;
use crumple_world::sim::AfterContact;

/// An invariant that must hold in every test case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Invariant {
    /// A generated scenario can be run.
    Runnable,
    /// No vehicle reverses.
    ForwardMotion,
    /// The position of a vehicle follows from its speed.
    Continuity,
    /// Brakes and impacts never add energy.
    Energy,
    /// Impacts conserve momentum.
    Momentum,
    /// Vehicles that collided stay together, and no pair collides twice.
    Sticking,
    /// Verdict, summary and trace agree.
    MetricsAgree,
    /// No vehicle exceeds the limits of road and vehicle.
    Limits,
    /// The reported role in a collision is that of the trace.
    ContactRole,
    /// The batch engine gives the results of the scalar engine to the last bit.
    Engines,
    /// The integration step has no influence.
    StepSize,
    /// Estimates are finite, speeds are not negative, and errors are bounded.
    Estimates,
    /// A scenario survives a round trip through a file.
    Files,
    /// The robustness of the monitor is that of the definition, and its sign the verdict.
    Monitor,
    /// A vehicle with a shield does not hit its leader.
    Shield,
    /// No driver does what is proved impossible.
    Avoidability,
    /// The checker gives the same answer to a certificate after a round trip.
    Certificates,
    /// A text or file is read or refused as documented.
    Reading,
    /// The content of a run folder is what was written, or is refused.
    Folders,
    /// Times in the lane are consistent, and vehicles outside the lane have no influence.
    Lanes,
}

impl fmt::Display for Invariant {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Runnable => "a valid scenario can be run",
            Self::ForwardMotion => "no vehicle reverses",
            Self::Continuity => "every position agrees with the speed",
            Self::Energy => "brakes and impacts do not add energy",
            Self::Momentum => "impacts keep momentum",
            Self::Sticking => "vehicles that collided stay together",
            Self::MetricsAgree => "verdict, summary and trace agree",
            Self::Limits => "no vehicle exceeds the limits of road and vehicle",
            Self::ContactRole => "the role in the collision agrees with the trace",
            Self::Engines => "the batch engine gives the same bits as the scalar engine",
            Self::StepSize => "the integration step does not change the verdict",
            Self::Estimates => "estimates are finite and near the truth",
            Self::Files => "a file that was written reads back identically",
            Self::Monitor => "robustness agrees with its definition, and its sign with the verdict",
            Self::Shield => "a shielded vehicle does not hit its leader",
            Self::Avoidability => "no controller achieves what is proved impossible",
            Self::Certificates => "the checker accepts an accepted certificate again after writing and reading",
            Self::Reading => "crumple reads a file or refuses it with a reason",
            Self::Lanes => "times in the lane are consistent, and vehicles outside the lane have no influence",
            Self::Folders => "the files of a run folder are unchanged, or crumple refuses them",
        })
    }
}

/// A violated invariant.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("broken: {invariant}\n{finding}\n\n{reproducer}")]
pub struct Violation {
    /// Invariant that is violated.
    pub invariant: Invariant,
    /// Description of the violation.
    pub finding: String,
    /// Scenario file that reproduces the violation, with the command that runs it.
    pub reproducer: String,
}

impl Violation {
    /// Panics, to report the violation to test suites and fuzzers.
    ///
    /// # Panics
    /// Always.
    #[expect(clippy::panic, reason = "this is what fuzzers and test suites listen to")]
    pub fn panic(self) -> ! {
        panic!("{self}")
    }
}

impl TestCase {
    /// Returns a scenario file whose first lines state how to run it.
    #[must_use]
    pub fn reproducer(&self) -> String {
        let Self { scenario, setup } = self;
        let name = setup.controller.name();
        let as_named = match &setup.controller {
            TestedController::BuiltIn(spec) => ControllerSpec::from_name(name).as_ref() == Some(spec),
            TestedController::Named(_) => true,
            TestedController::FullObservation(_) => false,
        };
        let mut scenario = scenario.clone();
        let mut how = Vec::new();
        if as_named {
            how.push(format!("--controller {}", ShellWord(name)));
        } else if let (TestedController::BuiltIn(spec), EstimatorKind::Truth) = (&setup.controller, setup.estimator) {
            // Controllers of a scenario observe the true state, so they can replace a controller under test that does.
            let put = |driver: &mut Driver| {
                if *driver == Driver::UnderTest {
                    *driver = Driver::Controller(spec.clone());
                }
            };
            let filled = scenario.edited(|spec| spec.vehicles.iter_mut().for_each(|v| put(&mut v.driver)));
            scenario = filled.unwrap_or(scenario);
        } else {
            how.push(format!("--controller ... (under test: {:?})", setup.controller));
        }
        if setup.estimator != EstimatorKind::default() {
            how.push(format!("--estimator {}", setup.estimator.name()));
        }
        if setup.substeps > 1 {
            how.push(format!("--dt {}", scenario.spec().step_s / f64::from(setup.substeps)));
        }
        if setup.after_contact == AfterContact::Continue {
            how.push("--after-contact continue".to_owned());
        }
        let text = to_toml(&scenario).unwrap_or_default();
        format!("# crumple simulate THIS-FILE.toml {}\n{text}", how.join(" "))
    }
}
