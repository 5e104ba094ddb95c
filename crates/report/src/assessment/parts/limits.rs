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
        let mut assumptions = vec![POINT_MASSES, estimator_limit(plan.config.estimator)];
        assumptions.extend(LIMITS_OF_EVERY_ASSESSMENT);
        if plan.certificates.iter().any(GivenCertificate::is_count) {
            assumptions.push(GIVEN_COUNTS);
        }
        if plan.config.paper {
            assumptions.push(PAPER);
        }
        Self { assumptions }
    }
}

impl GivenCertificate {
    fn is_count(&self) -> bool {
        matches!(
            self.certificate.statement,
            Statement::Rate(_) | Statement::Comparison(_)
        )
    }
}

const POINT_MASSES: LimitingAssumption = LimitingAssumption {
    assumed: "Vehicles are point masses in one lane",
    meaning: "Acceleration is constant over each step (0.01 s unless a scenario states another). There is no \
              steering, lane change, road grade or load transfer.",
};

fn estimator_limit(estimator: EstimatorKind) -> LimitingAssumption {
    match estimator {
        EstimatorKind::Kalman => LimitingAssumption {
            assumed: "Sensor noise is white and normal, and a Kalman filter estimates the state",
            meaning: "Range noise is 0.03 m and position noise 0.02 m unless a scenario states others. Real sensors \
                      also have biases, false targets and correlated errors. The filter knows the acceleration of its \
                      own vehicle exactly. For neighbours it assumes white jerk: when one brakes suddenly, the filter \
                      lags for about a second and underestimates its own error.",
        },
        EstimatorKind::Truth => LimitingAssumption {
            assumed: "Vehicles under test observe the true state",
            meaning: "No sensor is that good; the results are a best case.",
        },
    }
}

const LIMITS_OF_EVERY_ASSESSMENT: [LimitingAssumption; 5] = [
    LimitingAssumption {
        assumed: "Other vehicles observe the true state",
        meaning: "They react without delay unless a scenario or space states one; the follower's emergency brake never \
                  fails.",
    },
    LimitingAssumption {
        assumed: "Random scenarios follow the distribution of their space",
        meaning: "Failure rates hold for this distribution only. Dangerous spaces give no rates per kilometre of real \
                  driving.",
    },
    LimitingAssumption {
        assumed: "A tested claim may fail in other runs",
        meaning: "A run ends with its scenario: \"no collision\" holds until then, and the report marks runs that end \
                  while vehicles approach each other.",
    },
    LimitingAssumption {
        assumed: "Vehicles stick together after a collision; their momentum is conserved",
        meaning: "Deformation, rebound and steering are not modelled, so delta-v is approximate.",
    },
    LimitingAssumption {
        assumed: "This report is no certification",
        meaning: "No controller here was built for a road, and the report replaces no test on a road.",
    },
];

const GIVEN_COUNTS: LimitingAssumption = LimitingAssumption {
    assumed: "Counts in given certificates are correct",
    meaning: "The checker only verifies what follows from the counts. `crumple check --rerun` repeats the runs. Counts \
              of this report are its own.",
};

const PAPER: LimitingAssumption = LimitingAssumption {
    assumed: "crumple chose values that the paper does not state",
    meaning: "crumple uses maximum accelerations of 3 m/s² and 1.5 m/s², masses of 1500 kg and 15 000 kg, three \
              middle vehicles in scenario 3, and reads N(36, 0.5) as a standard deviation. The follower's braking \
              is normal about the class value with 0.2 m/s²; heavy and light followers are equally likely.",
};

impl ReportPart for AssessmentLimits {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::Limits,
            anchor: "limits",
            title: "Limits",
        }
    }

    fn write(&self, out: &mut ReportDocument) {
        out.list(self.assumptions.iter().map(|limit| {
            RichText::strong(format!("{}.", limit.assumed)).and_prose(format!(" {}", limit.meaning))
        }));
    }
}
