//! Progress of a retraining.

use crumple_core::observer::Observer;
use crumple_search::falsify::campaign::CampaignProgress;

/// Progress of a retraining.
#[derive(Debug, Clone, PartialEq)]
pub enum RetrainingProgress {
    /// Draws are classed for a corpus.
    Gathering {
        /// Corpus file that the scenarios are gathered for.
        file: &'static str,
        /// Avoidable ones so far.
        done: u64,
        /// How many are wanted.
        wanted: u64,
    },
    /// A campaign is under way.
    Searching {
        /// Round, from 1.
        round: u64,
        /// Progress of the campaign.
        progress: CampaignProgress,
    },
    /// Draws of the space are driven and classed.
    SimulatingDraws {
        /// Round, from 1.
        round: u64,
        /// How many.
        draws: u64,
    },
    /// The learner is at work.
    Training {
        /// Round, from 1.
        round: u64,
        /// Episode of the round, from 1.
        episode: u64,
        /// Episodes of the round.
        episodes: u64,
        /// Fewest contacts of any checkpoint in the selection.
        fewest_contacts: Option<u64>,
    },
    /// A candidate is judged.
    Evaluating {
        /// Round, from 1.
        round: u64,
    },
}

/// Receives the progress, and may stop the retraining.
pub(super) type RetrainingObserver<'a> = dyn Observer<RetrainingProgress> + 'a;
