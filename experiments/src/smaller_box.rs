//! Prints a box of `crumple verify reach --box` with each range reduced about its centre to a share of its width:
//!
//! ```text
//! cargo run --release -p crumple-experiments -- smaller_box corpora/boxes/paper-1.toml 0.03
//! ```

use std::path::Path;

use crate::ExperimentError;
use crumple_evidence::BoxSpec;
use crumple_verify::Interval;

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut arguments = arguments.iter();
    let path = arguments.next().ok_or("name the file of a box, and a share")?;
    let share: f64 = arguments.next().ok_or("name a share besides")?.parse()?;
    if !(0.0..=1.0).contains(&share) {
        return Err("the share must be from 0 to 1".into());
    }
    let text = std::fs::read_to_string(path).map_err(|error| format!("{path}: {error}"))?;
    let mut spec = BoxSpec::from_toml(&text, Path::new(path))?;
    let shrunk = |range: Interval| {
        let [middle, half] = [0.5 * (range.low() + range.high()), 0.5 * share * (range.high() - range.low())];
        Interval::new(middle - half, middle + half)
    };
    let ranges = &mut spec.ranges;
    for range in [
        &mut ranges.gap_ahead_m,
        &mut ranges.gap_behind_m,
        &mut ranges.leader_speed_mps,
        &mut ranges.ego_speed_mps,
        &mut ranges.follower_speed_mps,
        &mut ranges.leader_brake_mps2,
        &mut ranges.follower_brake_mps2,
        &mut ranges.onset_s,
    ] {
        *range = range.and_then(shrunk);
    }
    print!("{}", toml::to_string(&spec)?);
    Ok(())
}
