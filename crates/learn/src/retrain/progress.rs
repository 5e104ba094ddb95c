//! Progress of a retraining.

use crate::rl::ImitationRound;
use crumple_core::observer::Observer;
use crumple_search::falsify::campaign::CampaignProgress;

/// Progress of a retraining.
#[derive(Debug, Clone, PartialEq)]
pub enum RetrainingProgress {
    /// Random scenarios are classified for a corpus.
    Gathering {
        /// File of the corpus.
        file: &'static str,
        /// Avoidable scenarios so far.
        done: u64,
        /// Number of scenarios that are needed.
        wanted: u64,
    },
    /// A campaign is under way.
    Searching {
        /// Round, from 1.
        round: u64,
        /// Name of the space.
        space: String,
        /// Number of the space, from 0, and number of spaces.
        space_index: [usize; 2],
        /// Progress of the campaign.
        progress: CampaignProgress,
    },
    /// Random scenarios of the space are simulated and classified.
    SimulatingDraws {
        /// Round, from 1.
        round: u64,
        /// Number of random scenarios.
        draws: u64,
    },
    /// Given scenarios are attacked.
    Attacking {
        /// Round, from 1.
        round: u64,
        /// Number of scenarios.
        scenarios: usize,
    },
    /// The learner imitates an expert.
    Imitating {
        /// Round, from 1.
        round: u64,
        /// The last round of the imitation.
        imitation: ImitationRound,
    },
    /// The learner trains.
    Training {
        /// Round, from 1.
        round: u64,
        /// Episode of the round, from 1.
        episode: u64,
        /// Episodes of the round.
        episodes: u64,
        /// Fewest collisions of any checkpoint in the selection set.
        fewest_collisions: Option<u64>,
    },
    /// A candidate is evaluated.
    Evaluating {
        /// Round, from 1.
        round: u64,
    },
}

/// Observer of the progress, which can stop the retraining.
pub(super) type RetrainingObserver<'a> = dyn Observer<RetrainingProgress> + 'a;
