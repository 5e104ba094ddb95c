//! Summary of a recording: numbers of vehicles, speeds, gaps, and the hardest braking.

use std::fmt;

use super::Recording;
use super::lead_vehicles::LeadVehicle;
use super::motion::{BRAKING_WINDOW_MS, MAX_HOLE_MS, SpeedSample, find_brakings};
use super::series::round_to_milli;
use crumple_core::digits::format_fixed;

const MAX_LINES: usize = 40;

/// The hardest braking of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct HardestBraking {
    /// Event, if the file names events.
    pub event: Option<String>,
    /// Number of the vehicle.
    pub number: usize,
    /// Start of the second with the largest loss of speed, in seconds of the recording.
    pub from_s: f64,
    /// Speed lost in that second, in m/s.
    pub drop_mps: f64,
}

/// Hardest braking of a recording, or the reason of its absence.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum HardestBrakingResult {
    /// Hardest braking.
    Braking(HardestBraking),
    /// Known speeds over whole seconds, none of which falls.
    NoBraking,
    /// No known speed of a vehicle that may lead.
    NoSpeed,
    /// Samples too far apart for interpolation.
    SamplesTooFarApart {
        /// Median time between two samples of a vehicle, in seconds.
        step_s: f64,
    },
    /// No segment of a whole second.
    TooShort {
        /// Duration of the longest segment, in seconds.
        longest_s: f64,
    },
}

impl HardestBraking {
    /// Describes the braking as the rest of a sentence about a file.
    fn describe(&self) -> String {
        let event = self
            .event
            .as_ref()
            .map(|event| format!(" of event {event}"))
            .unwrap_or_default();
        format!(
            "the hardest braking is {} m/s within a second, of vehicle {}{event} from {} s on",
            format_fixed(self.drop_mps, 2),
            self.number,
            format_fixed(self.from_s, 2)
        )
    }
}

/// Describes samples that are too far apart, and the unit of the time that would explain it.
fn describe_distance(step_s: f64) -> [String; 2] {
    let distance = format!(
        "the speeds of a vehicle are {} s apart, more than the limit of {} s",
        format_fixed(step_s, 3),
        MAX_HOLE_MS as f64 / 1000.0
    );
    let hint = match step_s {
        1e6.. => ", unless the unit of the time is ns",
        1e3.. => ", unless the unit of the time is us",
        5.0.. => ", unless the unit of the time is ms",
        _ => "",
    };
    [distance, hint.to_owned()]
}

impl HardestBrakingResult {
    /// Returns the reason why the recording has no drive without holes, if it is in the speeds, as the rest of a
    /// sentence about a file.
    #[must_use]
    pub fn describe_holes(&self) -> Option<String> {
        match self {
            Self::SamplesTooFarApart { step_s } => {
                let [distance, hint] = describe_distance(*step_s);
                Some(format!("{distance}, so that every drive has holes{hint}"))
            }
            Self::NoSpeed => Some("no vehicle that can be a leader has a known speed".to_owned()),
            _ => None,
        }
    }
}

/// Writes the result as the rest of a sentence about a file.
impl fmt::Display for HardestBrakingResult {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Braking(braking) => out.write_str(&braking.describe()),
            Self::NoBraking => out.write_str("no vehicle brakes"),
            Self::NoSpeed => out.write_str(
                "no vehicle that can be a leader has a known speed, so crumple cannot find braking",
            ),
            Self::SamplesTooFarApart { step_s } => {
                let [distance, hint] = describe_distance(*step_s);
                write!(out, "{distance}: crumple cannot find braking{hint}")
            }
            Self::TooShort { longest_s } => write!(
                out,
                "no vehicle has a known speed for a whole second without a gap in the data, {} s at most: \
                    crumple cannot find braking",
                format_fixed(*longest_s, 3)
            ),
        }
    }
}

/// Summary of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// Number of vehicles that may have a follower.
    pub lead_vehicles: usize,
    /// Number of samples of these with known speed.
    pub samples: usize,
    /// First and last time, in seconds.
    pub time_s: [f64; 2],
    /// Median time between two samples of a vehicle, in seconds; `None` if no vehicle has two.
    pub step_s: Option<f64>,
    /// Lowest, median and highest speed, in m/s.
    pub speed_mps: [f64; 3],
    /// Lowest, median and highest bumper gap, in metres; `None` without followers.
    pub gap_m: Option<[f64; 3]>,
    /// Hardest braking.
    pub hardest: HardestBrakingResult,
    /// Data of a figure: speeds of the vehicles with the longest tracks, and the gap behind each.
    pub lines: Vec<SpeedLine>,
}

/// Speeds of a vehicle, and the gap to its follower.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedLine {
    /// Number of the vehicle.
    pub number: usize,
    /// Time in seconds, and speed in m/s.
    pub speed_mps: Vec<(f64, f64)>,
    /// Time in seconds, and bumper gap from this vehicle to its follower, in metres.
    pub gap_behind_m: Vec<(f64, f64)>,
    /// Time in seconds, and speed of that follower, in m/s.
    pub speed_behind_mps: Vec<(f64, f64)>,
}

/// Summarises a recording; `None` if no speed is known.
#[must_use]
pub fn preview(recording: &Recording) -> Option<Preview> {
    let mut speeds_mps = Vec::new();
    let mut gaps_m = Vec::new();
    let mut steps_s = Vec::new();
    let mut lines = Vec::new();
    let mut time_s = [f64::INFINITY, f64::NEG_INFINITY];
    let leads = recording.lead_vehicles();
    for lead in &leads {
        let mut line = SpeedLine {
            number: lead.number(),
            speed_mps: Vec::new(),
            gap_behind_m: Vec::new(),
            speed_behind_mps: Vec::new(),
        };
        steps_s.extend(sample_intervals(&**lead));
        for run in lead.segments() {
            for sample in &run {
                let now_s = seconds(sample);
                time_s = [time_s[0].min(now_s), time_s[1].max(now_s)];
                speeds_mps.push(sample.speed_mps);
                line.speed_mps.push((now_s, sample.speed_mps));
                if let Some(next) = lead.followers_at(sample).first() {
                    gaps_m.push(next.gap_ahead_m);
                    line.gap_behind_m.push((now_s, next.gap_ahead_m));
                    line.speed_behind_mps.push((now_s, next.speed_mps));
                }
            }
        }
        lines.push(line);
        lines.sort_by_key(|line: &SpeedLine| std::cmp::Reverse(line.speed_mps.len()));
        lines.truncate(MAX_LINES);
    }
    Some(Preview {
        lead_vehicles: leads.len(),
        samples: speeds_mps.len(),
        time_s,
        step_s: min_median_max(&mut steps_s).map(|[_, median, _]| round_to_milli(median)),
        speed_mps: min_median_max(&mut speeds_mps)?,
        gap_m: min_median_max(&mut gaps_m),
        hardest: hardest_braking(recording),
        lines,
    })
}

/// Finds the hardest braking of a recording, by the loss of speed within a second.
#[must_use]
pub fn hardest_braking(recording: &Recording) -> HardestBrakingResult {
    let mut search = HardestSearch::default();
    search.add(recording);
    search.finish()
}

/// Search for the hardest braking in the parts of a recording.
#[derive(Debug, Default)]
pub struct HardestSearch {
    hardest: Option<HardestBraking>,
    longest_ms: Option<i64>,
    /// Median time between two samples in the first part.
    step_s: Option<f64>,
}

impl HardestSearch {
    /// Adds a part.
    pub fn add(&mut self, part: &Recording) {
        let mut steps_s = Vec::new();
        for lead in part.lead_vehicles() {
            if self.step_s.is_none() {
                steps_s.extend(sample_intervals(&*lead));
            }
            for run in lead.segments() {
                let lasts_ms = run
                    .first()
                    .zip(run.last())
                    .map(|(first, last)| last.time_ms - first.time_ms);
                self.longest_ms = self.longest_ms.max(lasts_ms);
                for braking in find_brakings(&run, 0.0) {
                    if self
                        .hardest
                        .as_ref()
                        .is_none_or(|hardest| braking.largest_drop_mps > hardest.drop_mps)
                    {
                        self.hardest = Some(HardestBraking {
                            event: lead.event().map(str::to_owned),
                            number: lead.number(),
                            from_s: braking.hardest_ms as f64 / 1000.0,
                            drop_mps: braking.largest_drop_mps,
                        });
                    }
                }
            }
        }
        self.step_s = self
            .step_s
            .or(min_median_max(&mut steps_s).map(|[_, median, _]| median));
    }

    /// Returns the result.
    #[must_use]
    pub fn finish(self) -> HardestBrakingResult {
        match (self.hardest, self.longest_ms) {
            (Some(hardest), _) => HardestBrakingResult::Braking(hardest),
            (None, None) => HardestBrakingResult::NoSpeed,
            (None, Some(longest_ms)) if longest_ms >= BRAKING_WINDOW_MS => {
                HardestBrakingResult::NoBraking
            }
            (None, Some(longest_ms)) => match self.step_s {
                Some(step_s) if step_s * 1000.0 > MAX_HOLE_MS as f64 => {
                    HardestBrakingResult::SamplesTooFarApart { step_s }
                }
                _ => HardestBrakingResult::TooShort {
                    longest_s: longest_ms as f64 / 1000.0,
                },
            },
        }
    }
}

fn sample_intervals(lead: &dyn LeadVehicle) -> Vec<f64> {
    let times: Vec<f64> = lead.segments().iter().flatten().map(seconds).collect();
    times
        .windows(2)
        .filter_map(|pair| Some(pair.last()? - pair.first()?))
        .collect()
}

fn seconds(sample: &SpeedSample) -> f64 {
    sample.time_ms as f64 / 1000.0
}

fn min_median_max(values: &mut [f64]) -> Option<[f64; 3]> {
    values.sort_by(f64::total_cmp);
    Some([
        *values.first()?,
        *values.get(values.len() / 2)?,
        *values.last()?,
    ])
}
