use super::super::spec::{
    ChoiceSpec, DistributionSpec, HistogramSpec, LogNormalSpec, NormalSpec, ParameterValue,
    PointMassSpec, ShapeScaleSpec, UniformSpec,
};
use super::CoordinateMarginal;
use proptest::prelude::*;

fn any_marginal() -> impl Strategy<Value = CoordinateMarginal> {
    let range = (-50.0..50.0f64, 0.1..60.0f64);
    let normal =
        (range.clone(), -0.3..1.3f64, 0.15..2.0f64).prop_map(|((low, width), at, deviation)| {
            let (mean, deviation) = (low + at * width, deviation * width);
            DistributionSpec::Normal(NormalSpec {
                mean,
                deviation,
                low,
                high: low + width,
            })
        });
    // Shapes above 1: an unbounded density would need finer cells.
    let positive =
        (0..3, 1.1..8.0f64, 0.3..3.0f64, 0.1..0.9f64).prop_map(|(law, shape, scale, low)| {
            let high = low + 4.0 * scale;
            match law {
                0 => DistributionSpec::LogNormal(LogNormalSpec {
                    ln_mean: scale.ln(),
                    ln_deviation: 1.0 / shape,
                    low,
                    high,
                }),
                1 => DistributionSpec::Gamma(ShapeScaleSpec {
                    shape,
                    scale: scale / shape,
                    low,
                    high,
                }),
                _ => DistributionSpec::Weibull(ShapeScaleSpec {
                    shape,
                    scale,
                    low,
                    high,
                }),
            }
        });
    let weights = prop::collection::vec(0.01..5.0f64, 1..6);
    let with_point = (
        range.clone(),
        0.02..0.9f64,
        -5.0..0.0f64,
        any::<(bool, bool)>(),
    );
    let with_point =
        with_point.prop_map(|((low, width), probability, apart, (is_first, is_end))| {
            let (apart, high) = (if is_end { 0.0 } else { apart }, low + width);
            let others = NormalSpec {
                mean: low + 0.3 * width,
                deviation: 0.5 * width,
                low,
                high,
            };
            let at = if is_first { low + apart } else { high - apart };
            DistributionSpec::PointMass(PointMassSpec {
                at,
                probability,
                others: Box::new(DistributionSpec::Normal(others)),
            })
        });
    prop_oneof![
        with_point,
        range.prop_map(|(low, width)| DistributionSpec::Uniform(UniformSpec {
            low,
            high: low + width
        })),
        (0.01..5.0f64, 1.1..50.0f64).prop_map(|(low, times)| DistributionSpec::LogUniform(
            UniformSpec {
                low,
                high: low * times
            }
        )),
        normal,
        positive,
        weights.clone().prop_map(|weights| {
            let edges = (0..=weights.len())
                .map(|i| (1.5 * i as f64).powi(2) - 2.0)
                .collect();
            DistributionSpec::Histogram(HistogramSpec { edges, weights })
        }),
        weights.prop_map(|weights| {
            let values = (0..weights.len())
                .map(|i| ParameterValue::Number(1.5 * i as f64 - 2.0))
                .collect();
            DistributionSpec::Choice(ChoiceSpec {
                values,
                weights: Some(weights),
            })
        }),
    ]
    .prop_filter_map("its range holds next to nothing", |distribution| {
        distribution.marginal().ok()
    })
}

/// Extreme distributions of a file: no panic, no hang, no value outside the range.
#[test]
fn extreme_distributions_have_values_at_every_share() {
    let ranges = [
        [0.0, 1.0],
        [0.0, 1e300],
        [1e-320, 1e-300],
        [0.0, 1e-310],
        [1e-3, 12.0],
        [1e200, 1e308],
    ];
    let shares = [0.0, f64::MIN_POSITIVE, 1e-100, 0.5, 1.0 - f64::EPSILON, 1.0];
    for [low, high] in ranges {
        for shape in [0.01, 0.3, 1.0, 7.0, 1e6] {
            for scale in [1e-9, 1e-3, 1.0, 1e9] {
                let spec = ShapeScaleSpec {
                    shape,
                    scale,
                    low,
                    high,
                };
                let lognormal = LogNormalSpec {
                    ln_mean: scale.ln(),
                    ln_deviation: shape,
                    low,
                    high,
                };
                for law in [
                    DistributionSpec::Gamma(spec.clone()),
                    DistributionSpec::Weibull(spec),
                    DistributionSpec::LogNormal(lognormal),
                ] {
                    let Ok(marginal) = law.marginal() else {
                        continue;
                    };
                    for u in shares {
                        let at = marginal.quantile(u);
                        assert!((0.0..=1.0).contains(&at), "{law:?} {u}: {at}");
                        assert!(!marginal.ln_density(at).is_nan(), "{law:?} {u}");
                        assert!((0.0..=1.0).contains(&marginal.cdf(at)), "{law:?} {u}");
                    }
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// The density integrates to one, its integral inverts the quantile, and values map to a coordinate and back.
    #[test]
    fn density_quantile_and_value_belong_together(marginal in any_marginal(), u in 0.001..0.999f64) {
        const CELLS: usize = 20_000;
        let cell = |i: usize| marginal.ln_density((i as f64 + 0.5) / CELLS as f64).exp() / CELLS as f64;
        prop_assert!(((0..CELLS).map(cell).sum::<f64>() - 1.0).abs() < 2e-3);
        let at = marginal.quantile(u);
        prop_assert!((0.0..=1.0).contains(&at));
        // Includes the fraction of the last cell: at a steep density one cell exceeds the tolerance.
        let position = at * CELLS as f64;
        let whole = position as usize;
        let below: f64 = (0..whole).map(cell).sum::<f64>() + (position - whole as f64) * cell(whole);
        prop_assert!((below - u).abs() < 2e-3, "{below} instead of {u}");
        prop_assert!((marginal.cdf(at) - u).abs() < 1e-8);
        let point = if let CoordinateMarginal::PointMass { probability: p, .. } = &marginal { *p } else { 0.0 };
        let is_choice = matches!(marginal, CoordinateMarginal::Choice { .. });
        let off = marginal.cdf_of_value(marginal.value(at)) - u;
        prop_assert!(is_choice || off.abs() <= point + 1e-8, "{off}");
        let value = marginal.value(at);
        prop_assert!(value >= marginal.low() && value <= marginal.high());
        let restored = marginal.value(marginal.coordinate(value));
        prop_assert!((restored - value).abs() <= 1e-9 * (1.0 + value.abs()));
    }
}
