//! Quantities of an observation that a network or an external controller can receive.

use serde::{Deserialize, Serialize};

use super::{EMPTY_GAP_M, Neighbour, Observation};

/// Largest time to collision, in seconds; it stands for a gap that does not close.
const MAX_TTC_S: f64 = 100.0;

/// A quantity of an observation, in the unit that its name ends with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ObservedQuantity {
    /// Own speed.
    SpeedMps,
    /// Own acceleration over the last step.
    AccelerationMps2,
    /// Gap to the leader.
    GapAheadM,
    /// Speed of the leader.
    SpeedAheadMps,
    /// Speed of the leader minus own speed; negative if the gap closes.
    RelativeSpeedAheadMps,
    /// Acceleration of the leader.
    AccelerationAheadMps2,
    /// Gap to the leader divided by the own speed, or by 0.01 m/s at standstill.
    TimeGapAheadS,
    /// Gap to the leader divided by the speed at which it closes, at most 100 s; 100 s if it does not close.
    TimeToCollisionAheadS,
    /// 1 if there is a leader, else 0.
    IsAhead,
    /// Gap to the follower.
    GapBehindM,
    /// Speed of the follower.
    SpeedBehindMps,
    /// Speed of the follower minus own speed; positive if the gap closes.
    RelativeSpeedBehindMps,
    /// Acceleration of the follower.
    AccelerationBehindMps2,
    /// Gap to the follower divided by its speed, or by 0.01 m/s at standstill.
    TimeGapBehindS,
    /// Gap to the follower divided by the speed at which it closes, at most 100 s; 100 s if it does not close.
    TimeToCollisionBehindS,
    /// 1 if there is a follower, else 0.
    IsBehind,
    /// Last answer of the controller, or the command that replaced it in the last step; 0 before its first answer.
    LastAnswerMps2,
}

impl ObservedQuantity {
    const ALL: [Self; 17] = [
        Self::SpeedMps,
        Self::AccelerationMps2,
        Self::GapAheadM,
        Self::SpeedAheadMps,
        Self::RelativeSpeedAheadMps,
        Self::AccelerationAheadMps2,
        Self::TimeGapAheadS,
        Self::TimeToCollisionAheadS,
        Self::IsAhead,
        Self::GapBehindM,
        Self::SpeedBehindMps,
        Self::RelativeSpeedBehindMps,
        Self::AccelerationBehindMps2,
        Self::TimeGapBehindS,
        Self::TimeToCollisionBehindS,
        Self::IsBehind,
        Self::LastAnswerMps2,
    ];

    /// Returns all names, in the order of the documentation.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Self::ALL.into_iter().map(Self::name)
    }

    /// Returns the quantity of a name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|quantity| quantity.name() == name)
    }

    /// Returns the usual range in car following.
    #[must_use]
    pub fn typical_range(self) -> [f64; 2] {
        use ObservedQuantity as Q;
        match self {
            Q::SpeedMps | Q::SpeedAheadMps | Q::SpeedBehindMps => [5.0, 25.0],
            Q::GapAheadM | Q::GapBehindM => [10.0, 50.0],
            Q::RelativeSpeedAheadMps | Q::RelativeSpeedBehindMps => [-3.0, 3.0],
            Q::AccelerationMps2
            | Q::AccelerationAheadMps2
            | Q::AccelerationBehindMps2
            | Q::LastAnswerMps2 => [-3.0, 2.0],
            Q::TimeGapAheadS | Q::TimeGapBehindS => [0.8, 2.5],
            Q::TimeToCollisionAheadS | Q::TimeToCollisionBehindS => [1.0, MAX_TTC_S],
            Q::IsAhead | Q::IsBehind => [0.0, 1.0],
        }
    }

    /// Returns the name in files and in the protocol of processes.
    #[must_use]
    pub fn name(self) -> &'static str {
        use ObservedQuantity as Q;
        match self {
            Q::SpeedMps => "speed_mps",
            Q::AccelerationMps2 => "acceleration_mps2",
            Q::GapAheadM => "gap_ahead_m",
            Q::SpeedAheadMps => "speed_ahead_mps",
            Q::RelativeSpeedAheadMps => "relative_speed_ahead_mps",
            Q::AccelerationAheadMps2 => "acceleration_ahead_mps2",
            Q::TimeGapAheadS => "time_gap_ahead_s",
            Q::TimeToCollisionAheadS => "time_to_collision_ahead_s",
            Q::IsAhead => "is_ahead",
            Q::GapBehindM => "gap_behind_m",
            Q::SpeedBehindMps => "speed_behind_mps",
            Q::RelativeSpeedBehindMps => "relative_speed_behind_mps",
            Q::AccelerationBehindMps2 => "acceleration_behind_mps2",
            Q::TimeGapBehindS => "time_gap_behind_s",
            Q::TimeToCollisionBehindS => "time_to_collision_behind_s",
            Q::IsBehind => "is_behind",
            Q::LastAnswerMps2 => "last_answer_mps2",
        }
    }

    /// True if the quantity belongs to a neighbour, which may be absent.
    #[must_use]
    pub fn is_of_neighbour(self) -> bool {
        use ObservedQuantity as Q;
        !matches!(
            self,
            Q::SpeedMps | Q::AccelerationMps2 | Q::LastAnswerMps2 | Q::IsAhead | Q::IsBehind
        )
    }

    /// Returns the value of the quantity in an observation; `absent` replaces that of a missing neighbour.
    #[must_use]
    #[inline]
    pub fn value(
        self,
        observation: &Observation,
        last_answer_mps2: f64,
        absent: Option<f64>,
    ) -> f64 {
        use ObservedQuantity as Q;
        fn time_gap_s(gap_m: f64, speed_mps: f64) -> f64 {
            gap_m / if speed_mps > 0.01 { speed_mps } else { 0.01 }
        }
        fn ttc_s(gap_m: f64, closing_mps: f64) -> f64 {
            if closing_mps > 0.0 {
                (gap_m / closing_mps).min(MAX_TTC_S)
            } else {
                MAX_TTC_S
            }
        }
        let own_mps = observation.speed_mps;
        let neighbour = match self {
            Q::SpeedMps => return own_mps,
            Q::AccelerationMps2 => return observation.acceleration_mps2,
            Q::LastAnswerMps2 => return last_answer_mps2,
            Q::IsAhead => return f64::from(u8::from(observation.ahead.is_some())),
            Q::IsBehind => return f64::from(u8::from(observation.behind.is_some())),
            Q::GapAheadM
            | Q::SpeedAheadMps
            | Q::RelativeSpeedAheadMps
            | Q::AccelerationAheadMps2
            | Q::TimeGapAheadS
            | Q::TimeToCollisionAheadS => observation.ahead,
            Q::GapBehindM
            | Q::SpeedBehindMps
            | Q::RelativeSpeedBehindMps
            | Q::AccelerationBehindMps2
            | Q::TimeGapBehindS
            | Q::TimeToCollisionBehindS => observation.behind,
        };
        let neighbour = match (neighbour, absent) {
            (Some(neighbour), _) => neighbour,
            (None, Some(absent)) => return absent,
            (None, None) => Neighbour {
                gap_m: EMPTY_GAP_M,
                speed_mps: own_mps,
                acceleration_mps2: 0.0,
            },
        };
        match self {
            Q::SpeedAheadMps | Q::SpeedBehindMps => neighbour.speed_mps,
            Q::RelativeSpeedAheadMps | Q::RelativeSpeedBehindMps => neighbour.speed_mps - own_mps,
            Q::AccelerationAheadMps2 | Q::AccelerationBehindMps2 => neighbour.acceleration_mps2,
            Q::TimeGapAheadS => time_gap_s(neighbour.gap_m, own_mps),
            Q::TimeGapBehindS => time_gap_s(neighbour.gap_m, neighbour.speed_mps),
            Q::TimeToCollisionAheadS => ttc_s(neighbour.gap_m, own_mps - neighbour.speed_mps),
            Q::TimeToCollisionBehindS => ttc_s(neighbour.gap_m, neighbour.speed_mps - own_mps),
            _ => neighbour.gap_m,
        }
    }
}
