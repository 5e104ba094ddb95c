//! Situations of a crash map, and its two parameters.

use crumple_world::control::R157SimpleSettings;
use crumple_world::scenario::{InvalidField, Scenario, VehicleClass};
use serde::Serialize;

use super::TestSuite;
use super::parameter::{Origin, ParameterUnit, TestParameter, TestParameters};
use super::result::DISCLAIMER;
use super::spec::{LeadManeuver, TestSpec};

const KMPH_PER_MPS: f64 = 3.6;

/// Situation of a crash map: the fixed parameter, and implicitly the two parameters of the axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum CrashMapSituation {
    /// The vehicle ahead, at the speed of the vehicle under test, brakes to standstill. Axes: its deceleration and the
    /// speed.
    CarFollowing {
        /// Gap at the start divided by the speed, in seconds.
        time_gap_s: f64,
    },
    /// A slower vehicle cuts in. Axes: speed difference and gap at its entry.
    CutInGap {
        /// Speed of the vehicle under test, in km/h.
        own_speed_kmph: f64,
    },
    /// A slower vehicle cuts in. Axes: speed difference and TTC at its entry.
    CutInTime {
        /// Speed of the vehicle under test, in km/h.
        own_speed_kmph: f64,
    },
}

/// Axis of a crash map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CrashMapAxis {
    /// Title for readers.
    pub title: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Lower end of the first cell.
    pub low: f64,
    /// Upper end of the last cell.
    pub high: f64,
    /// Number of cells.
    pub cells: usize,
}

impl CrashMapAxis {
    /// Returns the middle of a cell, from 0, rounded to a thousandth, so that the shown value is the simulated one.
    #[must_use]
    pub(crate) fn cell_middle(&self, cell: usize) -> f64 {
        let middle = self.low + (self.high - self.low) * ((cell as f64 + 0.5) / self.cells as f64);
        (middle * 1e3).round() / 1e3
    }
}

/// Boundary of collisions by a closed form: beyond it the model predicts a collision.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Boundary {
    /// Name and formula, for readers.
    #[serde(rename = "words")]
    pub label: String,
    /// Reference driver that the boundary models; `None` for the boundary of immediate full braking.
    pub driver: Option<&'static str>,
    /// Reaction time, in seconds.
    pub reaction_s: f64,
    /// Deceleration, in m/s², positive.
    pub brake_mps2: f64,
    /// Points of the line: x and y.
    pub points: Vec<[f64; 2]>,
}

impl CrashMapSituation {
    pub(crate) const TIME_GAP_RANGE_S: [f64; 2] = [0.2, 10.0];
    pub(crate) const OWN_SPEED_RANGE_KMPH: [f64; 2] = [30.0, 250.0];

    /// Returns the name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::CarFollowing { .. } => "car-following",
            Self::CutInGap { .. } => "cut-in-gap",
            Self::CutInTime { .. } => "cut-in-time",
        }
    }

    /// Describes the situation and its fixed parameter.
    #[must_use]
    pub fn description(self) -> String {
        match self {
            Self::CarFollowing { time_gap_s } => format!(
                "The vehicle ahead brakes at once and to standstill; both drive at the same speed, {time_gap_s} s \
                 apart."
            ),
            Self::CutInGap { own_speed_kmph } | Self::CutInTime { own_speed_kmph } => format!(
                "A slower vehicle enters the lane and holds its speed; the vehicle under test drives at \
                 {own_speed_kmph} km/h."
            ),
        }
    }

    /// Returns the range, the unit and the value of the fixed parameter.
    pub(super) fn fixed_parameter(self) -> ([f64; 2], &'static str, f64) {
        match self {
            Self::CarFollowing { time_gap_s } => (Self::TIME_GAP_RANGE_S, "s", time_gap_s),
            Self::CutInGap { own_speed_kmph } | Self::CutInTime { own_speed_kmph } => {
                (Self::OWN_SPEED_RANGE_KMPH, "km/h", own_speed_kmph)
            }
        }
    }

    /// Returns the horizontal and the vertical axis, with these numbers of cells.
    pub(super) fn axes(self, [across, up]: [usize; 2]) -> [CrashMapAxis; 2] {
        let axis = |title, unit, low, high, cells| CrashMapAxis { title, unit, low, high, cells };
        let slower =
            |own_kmph: f64| axis("How much slower it is (km/h)", "km/h", 5.0, (own_kmph - 10.0).min(90.0), across);
        match self {
            Self::CarFollowing { .. } => [
                axis("Braking of the vehicle ahead (m/s²)", "m/s²", 1.0, 10.0, across),
                axis("Speed of both (km/h)", "km/h", 10.0, 130.0, up),
            ],
            Self::CutInGap { own_speed_kmph } => {
                [slower(own_speed_kmph), axis("Gap when it enters (m)", "m", 1.0, 80.0, up)]
            }
            Self::CutInTime { own_speed_kmph } => {
                [slower(own_speed_kmph), axis("Time to collision when it enters (s)", "s", 0.1, 4.0, up)]
            }
        }
    }

    pub(super) fn lead_maneuver(self) -> LeadManeuver {
        match self {
            Self::CarFollowing { .. } => LeadManeuver::Decelerating,
            Self::CutInGap { .. } | Self::CutInTime { .. } => LeadManeuver::CutIn,
        }
    }

    pub(super) fn scenario(self, across: f64, up: f64) -> Result<Scenario, InvalidField> {
        let figure = |value, unit| Some(TestParameter::from_chosen(value, unit));
        let figures = match self {
            Self::CarFollowing { time_gap_s } => TestParameters {
                own_speed: figure(up, ParameterUnit::Kmph),
                gap: figure(time_gap_s * up / KMPH_PER_MPS, ParameterUnit::Metre),
                deceleration: figure(across, ParameterUnit::Mps2),
                ramp: figure(0.0, ParameterUnit::Second),
                ..TestParameters::default()
            },
            Self::CutInGap { own_speed_kmph } | Self::CutInTime { own_speed_kmph } => TestParameters {
                own_speed: figure(own_speed_kmph, ParameterUnit::Kmph),
                lead_speed: figure(own_speed_kmph - across, ParameterUnit::Kmph),
                closing_time: figure(
                    if self.is_by_time() { up } else { up / (across / KMPH_PER_MPS) },
                    ParameterUnit::Second,
                ),
                ..TestParameters::default()
            },
        };
        let test = TestSpec {
            name: self.name().to_owned(),
            lead: Some(self.lead_maneuver()),
            parameters: figures,
            ..TestSpec::default()
        };
        let point: Vec<f64> = test.grid().concat();
        test.scenario(&format!("{}-{across}-{up}", self.name()), DISCLAIMER, &point)
    }

    fn is_by_time(self) -> bool {
        matches!(self, Self::CutInTime { .. })
    }

    /// Returns the boundaries of immediate full braking and of the simple driver of UN R157.
    pub(super) fn boundaries(self, [across, up]: [&CrashMapAxis; 2]) -> Vec<Boundary> {
        let simple = R157SimpleSettings::default();
        let hardest_mps2 = VehicleClass::Light.max_brake_mps2();
        let lines = [
            (None, "beyond this line, even this braking collides", 0.0, hardest_mps2),
            (Some("r157-simple"), "closed form of r157-simple", simple.reaction_s, simple.brake_mps2),
        ];
        let line = |(driver, words, reaction_s, brake_mps2): (_, &str, f64, f64)| {
            let points = (0..=200).map(|part| across.low + (across.high - across.low) * f64::from(part) / 200.0);
            let points = points.filter_map(|at| Some([at, self.contact_limit(at, reaction_s, brake_mps2)?])).collect();
            let words = format!("{words}: {brake_mps2} m/s² from {reaction_s} s");
            Boundary { label: words, driver, reaction_s, brake_mps2, points }
        };
        let is_on_map = |line: &Boundary| line.points.iter().any(|[_, at]| (up.low..=up.high).contains(at));
        lines.into_iter().map(line).filter(is_on_map).collect()
    }

    /// Returns the vertical coordinate at which braking at b after the reaction time τ just avoids the collision;
    /// `None` if no speed leads to a collision. Behind a leader that brakes at d > b, with time gap T, the gap is
    /// smallest when both stand, so the speed v satisfies T v + v²/(2 d) = τ v + v²/(2 b). Behind a leader that brakes
    /// at d <= b, no speed leads to a collision if T >= τ. After the cut-in of a vehicle that is Δv slower, the needed
    /// gap is Δv τ + Δv²/(2 b).
    fn contact_limit(self, across: f64, reaction_s: f64, brake_mps2: f64) -> Option<f64> {
        let slower_mps = across / KMPH_PER_MPS;
        let needed_s = reaction_s + slower_mps / (2.0 * brake_mps2);
        match self {
            Self::CarFollowing { time_gap_s } => {
                let harder = 1.0 / brake_mps2 - 1.0 / across;
                (harder > 0.0 && time_gap_s >= reaction_s)
                    .then(|| KMPH_PER_MPS * 2.0 * (time_gap_s - reaction_s) / harder)
            }
            Self::CutInTime { .. } => Some(needed_s),
            Self::CutInGap { .. } => Some(needed_s * slower_mps),
        }
    }

    /// Returns the prediction of the closed form for a cell; `None` outside its validity.
    pub(super) fn predicts_contact(self, line: &Boundary, [across, up]: [f64; 2]) -> Option<bool> {
        let limit = self.contact_limit(across, line.reaction_s, line.brake_mps2);
        match self {
            Self::CarFollowing { time_gap_s } if time_gap_s < line.reaction_s => None,
            // The simple driver does not notice such weak braking.
            Self::CarFollowing { .. }
                if line.driver.is_some() && across <= R157SimpleSettings::default().seen_brake_mps2 =>
            {
                None
            }
            Self::CarFollowing { .. } => Some(limit.is_some_and(|limit| up > limit)),
            Self::CutInGap { .. } | Self::CutInTime { .. } => limit.map(|limit| up < limit),
        }
    }

    /// Returns the points from which on, for longer gaps, the document requires no collision: the rows of the table in
    /// the AFGBV.
    pub(super) fn stated_points(self) -> Vec<[f64; 2]> {
        let suite = match self {
            Self::CarFollowing { .. } => None,
            Self::CutInGap { .. } | Self::CutInTime { .. } => TestSuite::shipped("afgbv-cut-in").and_then(Result::ok),
        };
        let point = |test: &TestSpec| {
            let first = |figure: &Option<TestParameter>| figure.as_ref()?.values.first().copied();
            let stated = test.parameters.closing_time.as_ref().filter(|figure| figure.origin == Origin::Document)?;
            let slower_kmph = first(&test.parameters.own_speed)? - first(&test.parameters.lead_speed)?;
            let time_s = *stated.values.first()?;
            Some([slower_kmph, if self.is_by_time() { time_s } else { time_s * slower_kmph / KMPH_PER_MPS }])
        };
        let tests = suite.iter().flat_map(|suite| &suite.spec().clauses).flat_map(|clause| &clause.tests);
        tests.filter_map(point).collect()
    }
}
