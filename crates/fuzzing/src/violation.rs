//! Violated invariants with their reproducers.

use super::{TestCase, TestedController};
use crumple_core::quoting::ShellWord;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::AfterCollision;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file::to_toml;
use crumple_sim::scenario::{Driver, Scenario};

/// An invariant that must hold in every test case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum Invariant {
    /// A generated scenario can be run.
    #[error("a valid scenario can be run")]
    Runnable,
    /// No vehicle reverses.
    #[error("no vehicle reverses")]
    ForwardMotion,
    /// The position of a vehicle follows from its speed.
    #[error("every position agrees with the speed")]
    Continuity,
    /// Brakes and impacts never add energy.
    #[error("brakes and impacts do not add energy")]
    Energy,
    /// Impacts conserve momentum.
    #[error("impacts keep momentum")]
    Momentum,
    /// Vehicles that collided stay together, and no pair collides twice.
    #[error("vehicles that collided stay together")]
    Sticking,
    /// Verdict, summary and trace agree.
    #[error("verdict, summary and trace agree")]
    MetricsAgree,
    /// No vehicle exceeds the limits of road and vehicle.
    #[error("no vehicle exceeds the limits of road and vehicle")]
    Limits,
    /// The reported role in a collision is that of the trace.
    #[error("the role in the collision agrees with the trace")]
    CollisionRole,
    /// The batch engine gives the results of the scalar engine to the last bit.
    #[error("the batch engine gives the same bits as the scalar engine")]
    Engines,
    /// The integration step has no influence.
    #[error("the integration step does not change the verdict")]
    StepSize,
    /// Estimates are finite, speeds are not negative, and errors are bounded.
    #[error("estimates are finite and near the truth")]
    Estimates,
    /// A scenario survives a round trip through a file.
    #[error("a file that was written reads back identically")]
    Files,
    /// The robustness of the monitor is that of the definition, and its sign the verdict.
    #[error("robustness agrees with its definition, and its sign with the verdict")]
    Monitor,
    /// A vehicle with a shield does not hit its leader.
    #[error("a shielded vehicle does not hit its leader")]
    Shield,
    /// No driver does what is proved impossible.
    #[error("no controller achieves what is proved impossible")]
    Avoidability,
    /// The checker gives the same answer to a certificate after a round trip.
    #[error("the checker accepts an accepted certificate again after writing and reading")]
    Certificates,
    /// A text or file is read or refused as documented.
    #[error("crumple reads a file or refuses it with a reason")]
    Reading,
    /// The content of a run folder is what was written, or is refused.
    #[error("the files of a run folder are unchanged, or crumple refuses them")]
    Folders,
    /// Times in the lane are consistent, and vehicles outside the lane have no influence.
    #[error("times in the lane are consistent, and vehicles outside the lane have no influence")]
    Lanes,
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
    #[expect(
        clippy::panic,
        reason = "this is what fuzzers and test suites listen to"
    )]
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
        let has_default_settings = match &setup.controller {
            TestedController::BuiltIn(spec) => {
                BuiltInController::from_name(name).as_ref() == Some(spec)
            }
            TestedController::Named(_) => true,
            TestedController::FullObservation(_) => false,
        };
        let mut scenario = scenario.clone();
        let mut options = Vec::new();
        if has_default_settings {
            options.push(format!("--controller {}", ShellWord(name)));
        } else if let (TestedController::BuiltIn(spec), EstimatorKind::Truth) =
            (&setup.controller, setup.estimator)
        {
            // Controllers of a scenario observe the true state, so they can replace a controller under test that does.
            scenario = with_driver_under_test(scenario, spec);
        } else {
            options.push(format!(
                "--controller ... (under test: {:?})",
                setup.controller
            ));
        }
        if setup.estimator != EstimatorKind::default() {
            options.push(format!("--estimator {}", setup.estimator.name()));
        }
        if setup.substeps > 1 {
            options.push(format!(
                "--dt {}",
                scenario.spec().step_s / f64::from(setup.substeps)
            ));
        }
        let after_collision = match setup.after_collision {
            AfterCollision::Stop => None,
            AfterCollision::Continue => Some("continue"),
            AfterCollision::Hold => Some("hold"),
            AfterCollision::Coast => Some("coast"),
        };
        options.extend(after_collision.map(|name| format!("--after-collision {name}")));
        let text = to_toml(&scenario).unwrap_or_default();
        format!(
            "# crumple simulate THIS-FILE.toml {}\n{text}",
            options.join(" ")
        )
    }
}

/// Replaces the controller under test by a driver; returns an invalid result unchanged.
fn with_driver_under_test(scenario: Scenario, controller: &BuiltInController) -> Scenario {
    let filled = scenario.edited(|spec| {
        for vehicle in &mut spec.vehicles {
            if vehicle.driver == Driver::UnderTest {
                vehicle.driver = Driver::Controller(controller.clone());
            }
        }
    });
    filled.unwrap_or(scenario)
}
