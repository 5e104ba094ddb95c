use super::*;
use crumple_core::observer::Quiet;
use crumple_sim::policy::Policy;
use crumple_verify::{ProvedClaim, WorkLimit, check_with};

fn plan(ranges: &str) -> ReachPlan {
    let text = format!("version = 1\nscenario = \"paper-1\"\n[ranges]\n{ranges}");
    ReachPlan::new(
        Policy::reference(),
        &BoxSpec::from_toml(&text, Path::new("paper-2.toml")).unwrap(),
    )
    .unwrap()
}

#[test]
fn claims_are_accepted_and_independent_of_threads() {
    let plan = plan(
        "gap_ahead_m = { low = 2.0, high = 18.0 }\nleader_brake_mps2 = { low = 2.5, high = 7.5 }",
    );
    let alone = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let partition = alone.install(|| plan.partition(6, &Quiet)).unwrap();
    assert_eq!(
        partition.certificate,
        plan.partition(6, &Quiet).unwrap().certificate
    );
    let Statement::Reach(claim) = &partition.certificate.statement else {
        panic!("reach")
    };
    match check_with(
        &partition.certificate,
        Some(plan.policy_bytes()),
        WorkLimit::default(),
    )
    .unwrap()
    {
        ProvedClaim::Reach {
            verified_share,
            falsified_share,
            min_gap_m,
            ..
        } => {
            assert_eq!(verified_share, claim.verified_share_at_least);
            assert_eq!(falsified_share, claim.falsified_share_at_least);
            let spare_m = min_gap_m - claim.min_gap_m_at_least;
            assert!((0.0..1.001e-6).contains(&spare_m), "{spare_m:e}");
            assert!(
                verified_share > 0.1 && falsified_share > 0.1,
                "{:?}",
                partition.shares
            );
        }
        other => panic!("{other:?}"),
    }
}

/// Tests the assumed accuracy of the functions of networks, with a safety factor of two.
#[test]
fn single_precision_functions_have_the_assumed_accuracy() {
    use crumple_verify::reach::controller::TANH_ERROR;
    let all = || {
        (0..u32::MAX / 997)
            .map(|k| f32::from_bits(k * 997))
            .filter(|z| z.is_finite())
    };
    let worst = all()
        .map(|z| (f64::from(libm::tanhf(z)) - f64::from(z).tanh()).abs())
        .fold(0.0, f64::max);
    assert!(worst < TANH_ERROR / 2.0, "{worst:e}");
    // Relative errors, except near 10⁻³⁸, where single precision ends. Beyond 88 exp is infinite.
    let off = |single: f32, exact: f64| {
        ((f64::from(single) - exact).abs() - 1e-38).max(0.0) / exact.abs()
    };
    let exp = all()
        .filter(|z| *z < 88.7)
        .map(|z| off(libm::expf(z), f64::from(z).exp()))
        .fold(0.0, f64::max);
    assert!(exp < TANH_ERROR / 2.0, "{exp:e}");
    let below = |z: &f32| *z < 0.0;
    let exp_m1 = all()
        .filter(below)
        .map(|z| off(libm::expm1f(z), f64::from(z).exp_m1()))
        .fold(0.0, f64::max);
    assert!(exp_m1 < TANH_ERROR / 2.0, "{exp_m1:e}");
}
