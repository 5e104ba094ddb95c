//! Plans and folders for tests.

use crumple_measure::Specification;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::NamedController;
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::built_in_space;

use crate::rare::{RarePlan, SplittingConfig};
use crate::{CountTally, RateConfig, RatePlan};

pub(crate) fn controller(name: &str) -> NamedController {
    BuiltInController::from_name(name).unwrap().into()
}

pub(crate) fn rate_plan(
    name: &str,
    against: Option<&str>,
    (space, runs): (&str, u64),
    (seed, confidence): (u64, f64),
) -> RatePlan {
    RatePlan::new(RateConfig {
        second_controller: against.map(controller),
        seed,
        estimator: EstimatorKind::Truth,
        confidence,
        ..RateConfig::new(controller(name), built_in_space(space).unwrap(), runs)
    })
    .unwrap()
}

pub(crate) fn count_all(plan: &RatePlan) -> CountTally {
    let mut tally = plan.empty_tally();
    while tally.runs < plan.registration().runs {
        plan.count_batch(&mut tally).unwrap();
    }
    tally
}

pub(crate) fn rare_plan(seed: u64, repetitions: usize) -> RarePlan {
    RarePlan {
        controller: controller("match-leader"),
        space: built_in_space("paper").unwrap(),
        estimator: EstimatorKind::Truth,
        specification: Specification::NoCollision,
        seed,
        effort: SplittingConfig {
            samples: 50,
            repetition_count: repetitions,
        },
        resamples: 0,
    }
}
