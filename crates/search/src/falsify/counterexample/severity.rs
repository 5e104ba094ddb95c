//! Severity of failures.

use std::cmp::Ordering;

/// Severity of a failure. Figures count in this order: violation of a formula or failure of a controller; impact speed;
/// largest change of speed of a vehicle; number of vehicles involved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Severity {
    /// Negative robustness, for a formula or a controller that failed; 0 for a collision.
    pub(super) violation: f64,
    pub(super) impact_speed_mps: f64,
    pub(super) max_delta_v_mps: f64,
    pub(super) vehicles_involved: usize,
}

impl Severity {
    pub(super) fn compare(&self, other: &Self) -> Ordering {
        self.violation
            .total_cmp(&other.violation)
            .then(self.impact_speed_mps.total_cmp(&other.impact_speed_mps))
            .then(self.max_delta_v_mps.total_cmp(&other.max_delta_v_mps))
            .then(self.vehicles_involved.cmp(&other.vehicles_involved))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_measure_decides_if_the_earlier_ones_are_equal() {
        let collision = |impact_speed_mps, max_delta_v_mps, vehicles_involved| Severity {
            violation: 0.0,
            impact_speed_mps,
            max_delta_v_mps,
            vehicles_involved,
        };
        let formula = |violation| Severity {
            violation,
            ..collision(1.0, 1.0, 2)
        };
        let mildest_first = [
            collision(9.2, 14.0, 4),
            collision(9.8, 3.0, 2),
            collision(10.1, 4.9, 2),
            collision(10.1, 5.1, 2),
            collision(10.1, 5.1, 3),
            collision(10.6, 0.0, 2),
        ];
        assert!(mildest_first.is_sorted_by(|a, b| a.compare(b) == Ordering::Less));
        assert_eq!(formula(0.2).compare(&formula(0.1)), Ordering::Greater);
        assert_eq!(
            formula(0.1).compare(&Severity {
                impact_speed_mps: 9.0,
                ..formula(0.1)
            }),
            Ordering::Less
        );
    }
}
