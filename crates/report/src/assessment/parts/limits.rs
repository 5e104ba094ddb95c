//! What the assessment does not show.

use maud::{Markup, html};
use serde::Serialize;

use crate::assessment::{AssessmentPlan, Part};
use crumple_world::observation::EstimatorKind;

/// Assumptions and limits, each a sentence or two.
#[derive(Debug, Clone, Serialize)]
pub struct Limits {
    /// The assumptions.
    pub assumptions: Vec<&'static str>,
}

impl Limits {
    pub(in crate::assessment) fn of(plan: &AssessmentPlan) -> Self {
        let estimator = match plan.config.estimator {
            EstimatorKind::Kalman => {
                "Vehicles under test see through noisy sensors (range noise 0.03 m, position noise 0.02 m unless a scenario \
                 says otherwise) and a Kalman filter. Noise is white and normal; real sensors also have biases, false \
                 targets and correlated errors. A vehicle's filter knows its own acceleration exactly, as no accelerometer does; \
                 of its neighbours' it assumes white jerk: when one of them slams on its brakes, the filter lags for about a \
                 second and is more certain than it should be."
            }
            EstimatorKind::Truth => "Vehicles under test see the true state: no sensor is that good.",
        };
        Self {
            assumptions: vec![
                "One lane, point-mass vehicles, acceleration held over each step (0.01 s unless a scenario says otherwise). No steering, no lane change, no \
                 road grade, no load transfer.",
                estimator,
                "All other traffic sees the true state and reacts without delay unless a scenario says otherwise; the \
                 follower's emergency brake never fails.",
                "Failure rates hold for the stated distribution and no other. It was built to be dangerous: they are not \
                 rates per kilometre of real driving.",
                "A controller without a collision here was tested, not proved safe. A run ends when its scenario does: \"no \
                 contact\" holds until then, and a run that ends while vehicles still close in says so.",
                "After a contact vehicles stick together with common momentum; crush, rebound and steering are not \
                 modelled, so delta-v is indicative.",
                "The paper gives neither largest accelerations nor masses nor the number of middle vehicles of scenario 3; \
                 ours are 3 m/s² and 1.5 m/s², 1500 kg and 15 000 kg, and three. It does not say whether N(36, 0.5) means a \
                 variance: we take a standard deviation. Nor does it say how the follower's braking varies: ours is normal \
                 about the class value with 0.2 m/s², and heavy and light followers are equally likely.",
            ],
        }
    }
}

impl Part for Limits {
    fn heading(&self) -> (&'static str, String) {
        ("limits", "What this does not show".to_owned())
    }

    fn html(&self) -> Markup {
        html! { ul { @for assumption in &self.assumptions { li { (assumption) } } } }
    }

    fn markdown(&self) -> String {
        self.assumptions.iter().map(|assumption| format!("- {assumption}\n")).collect()
    }
}
