//! What was understood of a recording: how many, how fast, how near, and how hard anybody braked.

use super::Recording;
use super::motion::{Sample, brakings};
use super::series::rounded;

/// Most lines that are drawn of one recording.
const MOST_LINES: usize = 40;

/// The hardest braking of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct HardestBraking {
    /// The event it was recorded in, where the file names events.
    pub event: Option<String>,
    /// Number of the vehicle.
    pub number: usize,
    /// When the second begins in which it loses most speed, in seconds of the recording.
    pub from_s: f64,
    /// Speed lost in that second, in m/s.
    pub drop_mps: f64,
}

/// What was understood of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Preview {
    /// Vehicles with one behind them, or with a place for one.
    pub leads: usize,
    /// Samples with a known speed of these.
    pub samples: usize,
    /// First and last time, in seconds.
    pub time_s: [f64; 2],
    /// The usual time between two samples of a vehicle, in seconds.
    pub step_s: f64,
    /// Lowest, median and highest speed, in m/s.
    pub speed_mps: [f64; 3],
    /// Lowest, median and highest bumper gap, in metres; none if nobody follows anybody.
    pub gap_m: Option<[f64; 3]>,
    /// The hardest braking.
    pub hardest: Option<HardestBraking>,
    /// What can be drawn: the speeds of the vehicles with the longest tracks, and the gap behind each.
    pub lines: Vec<SpeedLine>,
}

/// Speeds of one vehicle, and the gap behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedLine {
    /// Number of the vehicle.
    pub number: usize,
    /// Time in seconds, and speed in m/s.
    pub speed_mps: Vec<(f64, f64)>,
    /// Time in seconds, and the bumper gap from this vehicle to the one behind, in metres.
    pub gap_behind_m: Vec<(f64, f64)>,
}

/// Looks through a recording; none if nobody's speed is known.
#[must_use]
pub fn preview(recording: &Recording) -> Option<Preview> {
    let (mut speeds_mps, mut gaps_m, mut steps_s, mut lines) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut time_s = [f64::INFINITY, f64::NEG_INFINITY];
    let leads = recording.leads();
    for lead in &leads {
        let mut line = SpeedLine { number: lead.placed(0.0).number, speed_mps: Vec::new(), gap_behind_m: Vec::new() };
        for run in lead.runs() {
            steps_s.extend(run.windows(2).filter_map(|pair| Some(seconds(pair.last()?) - seconds(pair.first()?))));
            for sample in &run {
                let now_s = seconds(sample);
                time_s = [time_s[0].min(now_s), time_s[1].max(now_s)];
                speeds_mps.push(sample.speed_mps);
                line.speed_mps.push((now_s, sample.speed_mps));
                if let Some(next) = lead.followers_at(sample).first() {
                    gaps_m.push(next.gap_ahead_m);
                    line.gap_behind_m.push((now_s, next.gap_ahead_m));
                }
            }
        }
        lines.push(line);
        lines.sort_by_key(|line: &SpeedLine| std::cmp::Reverse(line.speed_mps.len()));
        lines.truncate(MOST_LINES);
    }
    Some(Preview {
        leads: leads.len(),
        samples: speeds_mps.len(),
        time_s,
        step_s: extremes(&mut steps_s).map_or(0.0, |[_, median, _]| rounded(median)),
        speed_mps: extremes(&mut speeds_mps)?,
        gap_m: extremes(&mut gaps_m),
        hardest: hardest_braking(recording),
        lines,
    })
}

/// The hardest braking of a recording, by the speed lost within a second; none if nobody brakes.
#[must_use]
pub fn hardest_braking(recording: &Recording) -> Option<HardestBraking> {
    let mut hardest: Option<HardestBraking> = None;
    for lead in recording.leads() {
        for braking in lead.runs().iter().flat_map(|run| brakings(run, 0.0)) {
            if hardest.as_ref().is_none_or(|known| braking.largest_drop_mps > known.drop_mps) {
                let (event, number) = (lead.event().map(str::to_owned), lead.placed(0.0).number);
                let from_s = braking.hardest_ms as f64 / 1000.0;
                hardest = Some(HardestBraking { event, number, from_s, drop_mps: braking.largest_drop_mps });
            }
        }
    }
    hardest
}

fn seconds(sample: &Sample) -> f64 {
    sample.time_ms as f64 / 1000.0
}

/// Lowest, middle and highest.
fn extremes(values: &mut [f64]) -> Option<[f64; 3]> {
    values.sort_by(f64::total_cmp);
    Some([*values.first()?, *values.get(values.len() / 2)?, *values.last()?])
}
