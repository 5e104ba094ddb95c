//! Progress of a retraining.

use crumple_search::falsify::campaign;

/// Progress of a retraining.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Progress {
    /// Draws are classed for a corpus.
    Gathering {
        /// Corpus file that the scenarios are gathered for.
        what: &'static str,
        /// Avoidable ones so far.
        done: u64,
        /// How many are wanted.
        wanted: u64,
    },
    /// A campaign is under way.
    Searching {
        /// Round, from 1.
        round: u64,
        /// How far the campaign is.
        state: campaign::Progress,
    },
    /// Draws of the space are driven and classed.
    Drawing {
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
        fewest: Option<u64>,
    },
    /// A candidate is judged.
    Judging {
        /// Round, from 1.
        round: u64,
    },
}

/// A function that receives the progress.
pub(super) type Show<'a> = dyn FnMut(Progress) + 'a;
