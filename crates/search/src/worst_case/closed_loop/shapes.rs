//! Simple profiles to start from, and random changes of a profile.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::plant::{CellBlock, Plant, Profile};
use crumple_world::random::Stream;

/// When a shape begins to change its speed, in seconds.
const BEGINS_S: [f64; 5] = [0.0, 0.5, 1.0, 2.0, 4.0];

/// Duration of its first acceleration, in seconds.
const LASTS_S: [f64; 4] = [0.5, 1.5, 4.0, 1e3];

/// Its accelerations: shares of the hardest braking if negative, of the largest acceleration if positive.
const SHARES: [f64; 7] = [-1.0, -0.75, -0.5, -0.25, 0.0, 0.5, 1.0];

/// Constant speed, then one acceleration for a while, then another: pulses, steps and two-level profiles.
pub(super) fn shapes(plant: &Plant<'_>) -> Vec<Profile> {
    let times = BEGINS_S.into_iter().flat_map(|begins_s| LASTS_S.map(|lasts_s| [begins_s, begins_s + lasts_s]));
    let shares = || SHARES.into_iter().flat_map(|first| SHARES.map(|then| [first, then]));
    let all = times.flat_map(|borders_s| shares().map(move |shares| (borders_s, shares)));
    all.map(|(borders_s, shares)| shape(plant, borders_s, shares)).collect()
}

fn shape(plant: &Plant<'_>, borders_s: [f64; 2], shares: [f64; 2]) -> Profile {
    let borders = borders_s.map(|border_s| (border_s / plant.cell_s()).round());
    let of_ego = |ego: usize| {
        let [low, high] = plant.limits_mps2(ego);
        let [first, then] = shares.map(|share| if share < 0.0 { -share * low } else { share * high });
        let at = |cell: usize| match cell as f64 {
            cell if cell < borders[0] => 0.0,
            cell if cell < borders[1] => first,
            _ => then,
        };
        (0..plant.cells()).map(at).collect()
    };
    (0..plant.egos()).map(of_ego).collect()
}

/// The profile with a random interval of one vehicle raised, lowered, levelled, or moved in time.
pub(super) fn perturbed(plant: &Plant<'_>, profile: &Profile, stream: &mut Stream) -> Profile {
    let all = plant.cells();
    let ego = stream.random_range(0..plant.egos().max(1));
    let length = (all as f64).powf(stream.random::<f64>()).round() as usize;
    let from = (all as f64 * stream.random::<f64>().powi(2)) as usize;
    let cells = from.min(all.saturating_sub(1))..(from + length.max(1)).min(all);
    let normal: f64 = StandardNormal.sample(stream);
    let [low, high] = plant.limits_mps2(ego);
    match stream.random_range(0..3) {
        0 => plant.moved(profile, &CellBlock { ego, cells }, 3.0 * stream.random::<f64>().powi(2) * normal),
        1 => {
            let level = [low, 0.0, high, stream.random_range(low..=high)][stream.random_range(0..4)];
            let mut levelled = profile.clone();
            let changed = levelled.get_mut(ego).and_then(|all| all.get_mut(cells));
            changed.into_iter().flatten().for_each(|held| *held = level);
            levelled
        }
        _ => {
            let mut shifted = profile.clone();
            let by = (3.0 * normal).round();
            if let Some(changed) = shifted.get_mut(ego).and_then(|all| all.get_mut(cells)) {
                let shift = (by.abs() as usize).min(changed.len());
                if by > 0.0 { changed.rotate_right(shift) } else { changed.rotate_left(shift) }
            }
            shifted
        }
    }
}
