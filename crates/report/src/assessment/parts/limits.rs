//! The limits of the assessment.

use crumple_verify::Statement;
use maud::html;
use serde::Serialize;

use crate::assessment::document::ReportDocument;
use crate::assessment::markdown::Inline;
use crate::assessment::plan::GivenCertificate;
use crate::assessment::{AssessmentPlan, ReportPart};
use crumple_world::observation::EstimatorKind;

/// Assumptions and limits of an assessment.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AssessmentLimits {
    /// List of assumptions.
    pub assumptions: Vec<LimitingAssumption>,
}

/// An assumption of the assessment.
#[derive(Debug, Clone, Copy, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LimitingAssumption {
    /// Assumption in a few words that are true or false.
    pub assumed: &'static str,
    /// Consequence for the reader.
    pub meaning: &'static str,
}

impl AssessmentLimits {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan) -> Self {
        let limit = |assumed, meaning| LimitingAssumption { assumed, meaning };
        let mut assumptions = vec![
            limit(
                "Traffic is one lane of point masses",
                "Acceleration is held over each step (0.01 s unless a scenario says otherwise). No steering, no lane change, no road \
                 grade, no load transfer.",
            ),
            match plan.config.estimator {
                EstimatorKind::Kalman => limit(
                    "Sensor noise is white and normal, and a Kalman filter looks through it",
                    "Range noise 0.03 m, position noise 0.02 m unless a scenario says otherwise; real sensors also have biases, false \
                     targets and correlated errors. A vehicle's filter knows its own acceleration exactly, as no accelerometer does; \
                     of its neighbours' it assumes white jerk: when one of them slams on its brakes, the filter lags for about a \
                     second and is more certain than it should be.",
                ),
                EstimatorKind::Truth => limit(
                    "Vehicles under test see the true state",
                    "No sensor is that good: take this as the best case.",
                ),
            },
            limit(
                "All other traffic sees the true state, and reacts as fast as its scenario says",
                "Without delay, unless a scenario or a space states one; the follower's emergency brake never fails.",
            ),
            limit(
                "Draws follow the law of their space",
                "Failure rates hold for that law and no other. Spaces that were built to be dangerous give no rates per kilometre of \
                 real driving.",
            ),
            limit(
                "What was only tested may still fail",
                "A run ends when its scenario does: \"no contact\" holds until then, and a run that ends while vehicles still close in \
                 says so. A search that found nothing says how hard it looked, and no more.",
            ),
            limit(
                "Vehicles stick together after a contact, with common momentum",
                "Crush, rebound and steering are not modelled, so delta-v is indicative.",
            ),
            limit(
                "This is no certification",
                "No controller here was built for a road, and nothing here replaces a test on one.",
            ),
        ];
        let is_counted =
            |one: &GivenCertificate| matches!(one.certificate.statement, Statement::Rate(_) | Statement::Comparison(_));
        if plan.certificates.iter().any(is_counted) {
            assumptions.push(limit(
                "Runs of given certificates came out as these say",
                "The checker holds what follows from the counts against them; that the runs were made, and came out so, is their \
                 author's word until `crumple check --rerun` has made them again. What was counted for this report was counted by it.",
            ));
        }
        if plan.config.paper {
            assumptions.push(limit(
                "What the paper leaves open is as we read it",
                "It gives neither largest accelerations nor masses nor the number of middle vehicles of scenario 3; ours are 3 m/s² and \
                 1.5 m/s², 1500 kg and 15 000 kg, and three. It does not say whether N(36, 0.5) means a variance: we take a standard \
                 deviation. Nor does it say how the follower's braking varies: ours is normal about the class value with 0.2 m/s², \
                 and heavy and light followers are equally likely.",
            ));
        }
        Self { assumptions }
    }
}

impl ReportPart for AssessmentLimits {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("limits", "What this does not show".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.push_html(
            html! { ul { @for limit in &self.assumptions { li { b { (limit.assumed) "." } " " (limit.meaning) } } } },
        );
        let line = |limit: &LimitingAssumption| {
            Inline::strong(&format!("{}.", limit.assumed)).and_prose(&format!(" {}", limit.meaning))
        };
        out.markdown_mut().list(self.assumptions.iter().map(line));
    }
}
