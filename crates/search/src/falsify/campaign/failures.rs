//! Failures of a campaign, grouped by kind, and the choice of those that are examined.

use super::EvaluatedPoint;
use crate::falsify::Method;
use crumple_measure::{BrakingLevel, RunVerdict, Specification};
use crumple_sim::scenario::{Scenario, VehicleClass};

/// Kind of a failure, which distinguishes the colliding vehicles, the ego vehicle's braking and the rear class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum FailureKind {
    /// A collision.
    Collision {
        /// Index of the vehicle that is hit.
        front_vehicle: u32,
        /// Index of the vehicle that hits it.
        rear_vehicle: u32,
        /// Braking of the vehicle under test among the two.
        ego_braking: BrakingLevel,
        /// Class of the vehicle that hits.
        rear_class: VehicleClass,
    },
    /// A controller gave no usable answer.
    ControllerFailed {
        /// Index of its vehicle.
        vehicle: u32,
    },
    /// A formula or a rule is violated, whichever vehicles collide.
    Violation {
        /// True if vehicles collided as well.
        has_collision: bool,
    },
}

impl FailureKind {
    /// Returns the kind of a verdict by a specification; `None` if the specification holds.
    #[must_use]
    pub fn from_verdict(verdict: &RunVerdict, specification: &Specification) -> Option<Self> {
        if verdict.robustness.is_nan() || verdict.robustness >= 0.0 {
            return None;
        }
        if let Some((_, vehicle)) = verdict.failure {
            return Some(Self::ControllerFailed { vehicle });
        }
        Some(match (specification, verdict.collision) {
            (Specification::NoCollision, Some(collision)) => Self::Collision {
                front_vehicle: collision.front_vehicle,
                rear_vehicle: collision.rear_vehicle,
                ego_braking: collision.ego_braking,
                rear_class: collision.rear_class,
            },
            (_, collision) => Self::Violation {
                has_collision: collision.is_some(),
            },
        })
    }

    /// Returns the indices of the vehicle that is hit and of the one that hits it; `None` without a collision.
    #[must_use]
    pub fn vehicles(&self) -> Option<[u32; 2]> {
        match self {
            Self::Collision {
                front_vehicle,
                rear_vehicle,
                ..
            } => Some([*front_vehicle, *rear_vehicle]),
            Self::ControllerFailed { .. } | Self::Violation { .. } => None,
        }
    }

    /// Returns true if the rear vehicle or the failed controller is the same, or both violate the formula.
    #[must_use]
    pub fn is_same_failure_mode(&self, other: &Self) -> bool {
        match (self, other) {
            (
                Self::Collision {
                    rear_vehicle: a, ..
                },
                Self::Collision {
                    rear_vehicle: b, ..
                },
            ) => a == b,
            (Self::ControllerFailed { vehicle: a }, Self::ControllerFailed { vehicle: b }) => {
                a == b
            }
            (Self::Violation { .. }, Self::Violation { .. }) => true,
            _ => false,
        }
    }

    /// Describes the kind, for scenarios like `scenario`.
    #[must_use]
    pub fn describe(&self, scenario: &Scenario) -> String {
        match self {
            Self::ControllerFailed { vehicle } => {
                format!("the controller of vehicle {vehicle} fails")
            }
            Self::Violation {
                has_collision: false,
            } => "the specification is violated without a collision".to_owned(),
            Self::Violation {
                has_collision: true,
            } => "the specification is violated with a collision".to_owned(),
            &Self::Collision {
                front_vehicle,
                rear_vehicle,
                ego_braking,
                rear_class,
            } => {
                let class = rear_class.name();
                let braking = describe_braking(ego_braking);
                if scenario.is_under_test(rear_vehicle as usize) {
                    format!("ego (vehicle {rear_vehicle}) hits vehicle {front_vehicle}, {braking}")
                } else if scenario.is_under_test(front_vehicle as usize) {
                    format!(
                        "vehicle {rear_vehicle} ({class}) hits the ego (vehicle {front_vehicle}), the ego {braking}"
                    )
                } else {
                    format!("vehicle {rear_vehicle} ({class}) hits vehicle {front_vehicle}")
                }
            }
        }
    }
}

fn describe_braking(braking: BrakingLevel) -> &'static str {
    match braking {
        BrakingLevel::None => "without braking",
        BrakingLevel::Partial => "braking partly",
        BrakingLevel::Full => "braking fully",
    }
}

/// A failure that may be examined.
#[derive(Debug, Clone, PartialEq)]
pub struct FailureCandidate {
    /// Method that found it.
    pub method: Method,
    /// Number of the evaluation of this method, from 1.
    pub number: u64,
    /// Values, one per coordinate.
    pub values: Vec<f64>,
    /// Verdict of the simulation.
    pub verdict: RunVerdict,
    /// Logarithm of its density under the space's distribution, relative to the uniform density.
    pub ln_likelihood: f64,
    /// Distance from nominal in the unit cube, from 0 to 1: mean over the parameters.
    pub distance_from_nominal: f64,
}

#[derive(Debug, Clone)]
pub(super) struct FailureGroup {
    pub(super) kind: FailureKind,
    /// For each method that found this kind: the number of failures, and the number of its first failing evaluation.
    pub(super) by_method: Vec<(Method, u64, u64)>,
    pub(super) first: FailureCandidate,
    pub(super) severest: FailureCandidate,
    pub(super) likeliest: FailureCandidate,
}

/// Failures by kind, in the order of their discovery. Memory does not depend on the number of evaluations.
#[derive(Debug, Clone)]
pub(super) struct Failures {
    pub(super) specification: Specification,
    pub(super) groups: Vec<FailureGroup>,
}

impl Failures {
    pub(super) fn new(specification: Specification) -> Self {
        Self {
            specification,
            groups: Vec::new(),
        }
    }

    pub(super) fn add(&mut self, method: &Method, evaluated: &EvaluatedPoint) {
        let Some(kind) = FailureKind::from_verdict(&evaluated.verdict, &self.specification) else {
            return;
        };
        let candidate = FailureCandidate {
            method: method.clone(),
            number: evaluated.number,
            values: evaluated.values.clone(),
            verdict: evaluated.verdict,
            ln_likelihood: evaluated.ln_likelihood,
            distance_from_nominal: evaluated.distance_from_nominal,
        };
        let Some(group) = self.groups.iter_mut().find(|group| group.kind == kind) else {
            self.groups.push(FailureGroup {
                kind,
                by_method: vec![(method.clone(), 1, evaluated.number)],
                first: candidate.clone(),
                severest: candidate.clone(),
                likeliest: candidate,
            });
            return;
        };
        match group.by_method.iter_mut().find(|(by, ..)| by == method) {
            Some((_, count, _)) => *count += 1,
            None => group.by_method.push((method.clone(), 1, evaluated.number)),
        }
        if candidate.is_likelier_than(&group.likeliest) {
            group.likeliest = candidate.clone();
        }
        if candidate.verdict.robustness < group.severest.verdict.robustness {
            group.severest = candidate;
        }
    }

    pub(super) fn examination_candidates(&self, kinds: usize) -> Vec<&FailureCandidate> {
        self.by_frequency()
            .into_iter()
            .take(kinds)
            .flat_map(FailureGroup::examination_candidates)
            .collect()
    }

    /// Returns the kinds by descending frequency; equally frequent ones in the order of discovery.
    pub(super) fn by_frequency(&self) -> Vec<&FailureGroup> {
        let mut kinds: Vec<_> = self.groups.iter().collect();
        kinds.sort_by_key(|kind| std::cmp::Reverse(kind.count()));
        kinds
    }
}

impl FailureCandidate {
    /// Returns true if this failure is likelier; if equally likely, nearer to nominal.
    fn is_likelier_than(&self, other: &Self) -> bool {
        self.likelihood_key() > other.likelihood_key()
    }

    fn likelihood_key(&self) -> (f64, f64) {
        (self.ln_likelihood, -self.distance_from_nominal)
    }
}

impl FailureGroup {
    /// Returns the failures of this kind to examine: the severest, the likeliest and the first, without repetition.
    pub(super) fn examination_candidates(&self) -> Vec<&FailureCandidate> {
        let mut picks = vec![&self.severest];
        for candidate in [&self.likeliest, &self.first] {
            if !picks.iter().any(|pick| pick.values == candidate.values) {
                picks.push(candidate);
            }
        }
        picks
    }

    pub(super) fn count(&self) -> u64 {
        self.by_method.iter().map(|(_, count, _)| count).sum()
    }
}
