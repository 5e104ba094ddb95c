//! Simple profiles to start from, and random changes of a profile.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::plant::{CellBlock, Plant, Profile};
use crumple_world::random::Stream;

/// When a shape begins to change its speed, in seconds.
const BEGINS_S: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];

/// Duration of its first acceleration, in seconds.
const LASTS_S: [f64; 3] = [0.5, 1.5, 4.0];

/// Its accelerations: shares of the hardest braking if negative, of the largest acceleration if positive.
const SHARES: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0];

/// Ends of the first braking, in seconds, durations of the acceleration after it, and shares of the two brakings.
const HALTS_S: [f64; 6] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.5];
const BETWEEN_S: [f64; 4] = [0.4, 0.8, 1.5, 3.0];
const BRAKINGS: [[f64; 2]; 6] = [[-1.0, -1.0], [-1.0, -0.5], [-0.6, -1.0], [-0.6, -0.5], [-0.3, -1.0], [-0.3, -0.5]];

/// Simple profiles: pulses, steps and two-level profiles, and brakings with an acceleration in between, which make a follower
/// slow down before the last one.
pub(super) fn shapes(plant: &Plant<'_>) -> Vec<Profile> {
    let levels = || SHARES.into_iter().flat_map(|first| SHARES.map(|then| [first, then]));
    let two = BEGINS_S.into_iter().flat_map(|begins_s| {
        LASTS_S.into_iter().flat_map(move |lasts_s| {
            levels().map(move |[first, then]| vec![(begins_s, first), (begins_s + lasts_s, then)])
        })
    });
    let one = BEGINS_S.into_iter().flat_map(|begins_s| SHARES.map(|share| vec![(begins_s, share)]));
    let three = HALTS_S.into_iter().flat_map(|halt_s| {
        BETWEEN_S.into_iter().flat_map(move |between_s| {
            BRAKINGS.map(|[first, last]| vec![(0.0, first), (halt_s, 1.0), (halt_s + between_s, last)])
        })
    });
    one.chain(two).chain(three).map(|pieces| shape(plant, &pieces)).collect()
}

/// The profile that holds a share of the limits from each of these times on, in seconds, and no acceleration before.
fn shape(plant: &Plant<'_>, pieces: &[(f64, f64)]) -> Profile {
    let of_ego = |ego: usize| {
        let [low, high] = plant.limits_mps2(ego);
        let at = |cell: usize| {
            let time_s = (cell as f64 + 0.5) * plant.cell_s();
            let share = pieces.iter().take_while(|(from_s, _)| *from_s <= time_s).last().map_or(0.0, |(_, share)| *share);
            if share < 0.0 { -share * low } else { share * high }
        };
        (0..plant.cells()).map(at).collect()
    };
    (0..plant.egos()).map(of_ego).collect()
}

/// The profile with one to three random changes: an interval of one vehicle raised, lowered, levelled, or moved in time.
pub(super) fn perturbed(plant: &Plant<'_>, profile: &Profile, stream: &mut Stream) -> Profile {
    (0..stream.random_range(1..=3)).fold(profile.clone(), |profile, _| changed(plant, profile, stream))
}

fn changed(plant: &Plant<'_>, mut profile: Profile, stream: &mut Stream) -> Profile {
    let all = plant.cells();
    let ego = stream.random_range(0..plant.egos().max(1));
    // Short and early intervals are as frequent as long and late ones.
    let length = (all as f64).powf(stream.random::<f64>()).round() as usize;
    let from = (all as f64 * stream.random::<f64>().powi(2)) as usize;
    let from = from.min(all.saturating_sub(1));
    let cells = from..(from + length.max(1)).min(all);
    let normal: f64 = StandardNormal.sample(stream);
    let [low, high] = plant.limits_mps2(ego);
    let kind = stream.random_range(0..3);
    if kind == 0 {
        let size_mps2 = 10.0_f64.powf(stream.random_range(-1.5..0.6));
        return plant.moved(&profile, &CellBlock { ego, cells }, size_mps2 * normal);
    }
    let level = match stream.random_range(0..5) {
        0 => low,
        1 => 0.0,
        2 => high,
        3 => stream.random_range(low..=0.0),
        _ => stream.random_range(low..=high),
    };
    let changed = profile.get_mut(ego).and_then(|all| all.get_mut(cells));
    match changed {
        Some(changed) if kind == 1 => changed.fill(level),
        Some(changed) => {
            let shift = ((3.0 * normal).abs().ceil() as usize).min(changed.len());
            if normal > 0.0 { changed.rotate_right(shift) } else { changed.rotate_left(shift) }
        }
        None => {}
    }
    profile
}
