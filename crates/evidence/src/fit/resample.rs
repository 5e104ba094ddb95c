//! Bootstrap resamples of clusters of episodes.

use rand::RngExt;

use crumple_sim::random::{Purpose, stream};
use crumple_spaces::{ObservedData, ObservedParameter};

/// Returns the `index`-th resample: as many clusters as there are, drawn with replacement (Efron, Bootstrap methods:
/// another look at the jackknife, Annals of Statistics 7, 1979; of clusters, Davison and Hinkley, 1997, 3.8).
#[must_use]
pub(crate) fn resample(observed: &ObservedData, seed: u64, index: u64) -> ObservedData {
    let clusters = observed
        .braking_clusters
        .iter()
        .max()
        .map_or(0, |last| *last as usize + 1);
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); clusters];
    for (episode, cluster) in observed.braking_clusters.iter().enumerate() {
        if let Some(members) = members.get_mut(*cluster as usize) {
            members.push(episode);
        }
    }
    members.retain(|members| !members.is_empty());
    let mut random = stream(seed, Purpose::Resampling, index);
    let drawn: Vec<&Vec<usize>> = members
        .iter()
        .filter_map(|_| members.get(random.random_range(0..members.len())))
        .collect();
    let numbered = drawn
        .iter()
        .enumerate()
        .flat_map(|(cluster, members)| members.iter().map(move |_| cluster as u32));
    let parameters = observed.parameters.iter().map(|parameter| {
        let episodes = drawn.iter().flat_map(|members| members.iter());
        ObservedParameter {
            values: episodes
                .filter_map(|&episode| parameter.values.get(episode).copied())
                .collect(),
            ..parameter.clone()
        }
    });
    ObservedData {
        braking_clusters: numbered.collect(),
        search_share: observed.search_share,
        parameters: parameters.collect(),
    }
}
