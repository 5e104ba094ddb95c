//! The limits of the assessment.

use crumple_verify::Statement;
use serde::Serialize;

use crate::assessment::AssessmentPlan;
use crate::assessment::document::ReportDocument;
use crate::assessment::plan::GivenCertificate;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::rich_text::RichText;
use crumple_sim::observation::EstimatorKind;

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
                "Vehicles are point masses in one lane",
                "Acceleration is constant over each step (0.01 s unless a scenario states another). There is no \
                 steering, lane change, road grade or load transfer.",
            ),
            match plan.config.estimator {
                EstimatorKind::Kalman => limit(
                    "Sensor noise is white and normal, and a Kalman filter estimates the state",
                    "Range noise is 0.03 m and position noise 0.02 m unless a scenario states others. Real sensors \
                     also have biases, false targets and correlated errors. The filter knows the acceleration of its \
                     own vehicle exactly. For neighbours it assumes white jerk: when one brakes suddenly, the filter \
                     lags for about a second and underestimates its own error.",
                ),
                EstimatorKind::Truth => limit(
                    "Vehicles under test observe the true state",
                    "No sensor is that good; the results are a best case.",
                ),
            },
            limit(
                "Other vehicles observe the true state",
                "They react without delay unless a scenario or space states one; the follower's emergency brake never \
                 fails.",
            ),
            limit(
                "Random scenarios follow the distribution of their space",
                "Failure rates hold for this distribution only. Dangerous spaces give no rates per kilometre of real \
                 driving.",
            ),
            limit(
                "A tested claim may fail in other runs",
                "A run ends with its scenario: \"no collision\" holds until then, and the report marks runs that end \
                 while vehicles approach each other.",
            ),
            limit(
                "Vehicles stick together after a collision, with common momentum",
                "Deformation, rebound and steering are not modelled, so delta-v is approximate.",
            ),
            limit(
                "This report is no certification",
                "No controller here was built for a road, and the report replaces no test on a road.",
            ),
        ];
        let is_counted = |one: &GivenCertificate| {
            matches!(
                one.certificate.statement,
                Statement::Rate(_) | Statement::Comparison(_)
            )
        };
        if plan.certificates.iter().any(is_counted) {
            assumptions.push(limit(
                "Counts in given certificates are correct",
                "The checker only verifies what follows from the counts. `crumple check --rerun` repeats the runs. \
                 Counts of this report are its own.",
            ));
        }
        if plan.config.paper {
            assumptions.push(limit(
                "The paper leaves some values open",
                "crumple uses maximum accelerations of 3 m/s² and 1.5 m/s², masses of 1500 kg and 15 000 kg, three \
                 middle vehicles in scenario 3, and reads N(36, 0.5) as a standard deviation. The follower's braking \
                 is normal about the class value with 0.2 m/s²; heavy and light followers are equally likely.",
            ));
        }
        Self { assumptions }
    }
}

impl ReportPart for AssessmentLimits {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Limits,
            anchor: "limits",
            title: "Limits",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        let line = |limit: &LimitingAssumption| {
            RichText::strong(format!("{}.", limit.assumed)).and_prose(format!(" {}", limit.meaning))
        };
        out.list(self.assumptions.iter().map(line));
    }
}
