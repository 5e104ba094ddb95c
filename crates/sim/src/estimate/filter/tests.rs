use super::*;

fn largest_element(matrix: &Matrix3) -> f64 {
    let elements = matrix.0.as_flattened().iter();
    elements.fold(0.0, |largest, element| largest.max(element.abs()))
}

#[test]
fn steady_deviations_match_the_continuous_time_closed_form() {
    let (h, noise, bandwidth) = (0.01_f64, 0.03_f64, 5.0_f64);
    let [_, rate, acceleration] = Tuning::new(h, noise, bandwidth).steady_deviations();
    let density = noise * noise * h;
    let expected_rate = (3.0 * bandwidth.powi(3) * density).sqrt();
    let expected_acceleration = (2.0 * bandwidth.powi(5) * density).sqrt();
    // The discrete filter is slightly worse, because it does not measure continuously.
    assert!(
        (rate / expected_rate - 1.0).abs() < 0.06,
        "{rate} {expected_rate}"
    );
    assert!(
        (acceleration / expected_acceleration - 1.0).abs() < 0.06,
        "{acceleration} {expected_acceleration}"
    );
}

#[test]
fn the_steady_covariance_is_the_fixed_point_of_the_recursion() {
    for (step, noise, bandwidth) in [
        (0.01, 0.03, 5.0),
        (0.001, 1e-4, 5.0),
        (0.1, 2.0, 3.0),
        (1.0, 10.0, 5.0),
    ] {
        let tuning = Tuning::new(step, noise, bandwidth);
        let steady = tuning.steady_covariance;
        let once_more = tuning.predict_covariance(&tuning.correct_covariance(&steady));
        assert!(
            largest_element(&(once_more + steady * -1.0)) <= 1e-9 * largest_element(&steady),
            "step {step}"
        );
        let mut from_afar = steady * 4.0;
        for _ in 0..(20.0 / step) as usize + 100 {
            from_afar = tuning.predict_covariance(&tuning.correct_covariance(&from_afar));
        }
        assert!(
            largest_element(&(from_afar + steady * -1.0)) <= 1e-6 * largest_element(&steady),
            "step {step}"
        );
    }
}

#[test]
fn a_steady_filter_without_loss_equals_the_full_recursion() {
    let tuning = Tuning::new(0.01, 0.03, 5.0);
    let mut steady = Filter::new_steady(&tuning, 16.0, 0.0, [0.3, -1.0, 0.5]);
    let mut full = steady.clone();
    full.covariance = Some(tuning.steady_covariance);
    for k in 0..2000 {
        let measured = Some(16.0 + (k as f64 * 0.1).sin());
        let (a, b) = (
            steady.update(&tuning, measured),
            full.update(&tuning, measured),
        );
        assert!(
            (a.distance_m - b.distance_m).abs() < 1e-9 && (a.rate_mps - b.rate_mps).abs() < 1e-9
        );
    }
}

#[test]
fn lost_measurements_widen_the_expected_innovation_until_they_return() {
    let tuning = Tuning::new(0.01, 0.03, 5.0);
    let mut filter = Filter::new_steady(&tuning, 16.0, 0.0, [0.0; 3]);
    let steady = filter.innovation(&tuning, 16.0).variance_m2;
    for _ in 0..50 {
        filter.update(&tuning, None);
    }
    let blind = filter.innovation(&tuning, 16.0).variance_m2;
    assert!(
        blind > 1.5 * steady,
        "half a second blind: {blind} against {steady}"
    );
    for _ in 0..500 {
        filter.update(&tuning, Some(16.0));
    }
    let recovered = filter.innovation(&tuning, 16.0).variance_m2;
    assert!((recovered / steady - 1.0).abs() < 1e-6);
}
