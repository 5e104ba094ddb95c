//! The parts of a report: where each stands, what it shows, and which claims it is about.

use crumple_verify::Certificate;

use super::AssessmentPlan;
use super::claim_draft::ClaimDraft;
use super::claims::Evidence;
use super::document::ReportDocument;

/// The chapters of a report, in the order of the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Chapter {
    /// The answer, the claims, and their changes.
    Verdict,
    /// Scenarios that the paper, files or documents state.
    StatedScenarios,
    RandomScenarios,
    Searches,
    EverydayTraffic,
    Proofs,
    Limits,
    Appendix,
}

/// The place of a part in the page.
#[derive(Debug, Clone, Copy)]
pub(super) struct PartHeading {
    pub(super) chapter: Chapter,
    /// Anchor in the page.
    pub(super) anchor: &'static str,
    pub(super) title: &'static str,
}

/// A part of a report.
pub(super) trait ReportPart {
    fn heading(&self) -> PartHeading;

    /// Writes the part, without its heading.
    fn write(&self, out: &mut ReportDocument);

    /// Returns the approximate number of runs that a plan needs for the part; searches may end early.
    fn runs(_plan: &AssessmentPlan) -> u64
    where
        Self: Sized,
    {
        0
    }

    /// False if the part has nothing to show.
    fn is_shown(&self) -> bool {
        true
    }

    /// Returns the evidence that the part contributes to the ledger.
    fn evidence(&self, _plan: &AssessmentPlan) -> Vec<Evidence> {
        Vec::new()
    }

    /// Returns the claims that the report makes because of the part.
    fn claims(&self, _plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        Vec::new()
    }

    /// Returns the certificates of scenarios that the part found, each with the name of its scenario.
    fn certificates(&self) -> Vec<(&str, &Certificate)> {
        Vec::new()
    }

    /// Returns the files of the part, with paths relative to the report folder.
    fn files(&self) -> Vec<(String, Vec<u8>)> {
        Vec::new()
    }
}

/// A part of a report, written as blocks.
#[derive(Debug, Clone)]
pub struct ReportSection {
    /// Anchor in the page.
    pub anchor: &'static str,
    /// Heading.
    pub title: &'static str,
    pub(super) chapter: Chapter,
    pub(super) document: ReportDocument,
}

impl ReportSection {
    fn new(part: &dyn ReportPart) -> Self {
        let heading = part.heading();
        let mut document = ReportDocument::new();
        part.write(&mut document);
        Self {
            anchor: heading.anchor,
            title: heading.title,
            chapter: heading.chapter,
            document,
        }
    }

    /// Writes the parts that have something to show, in the order of their chapters.
    pub(super) fn from_parts(mut parts: Vec<&dyn ReportPart>) -> Vec<Self> {
        parts.retain(|part| part.is_shown());
        sort_by_chapter(&mut parts);
        parts.into_iter().map(Self::new).collect()
    }
}

/// Sorts parts by their chapters; parts of one chapter keep their order.
pub(super) fn sort_by_chapter(parts: &mut [&dyn ReportPart]) {
    parts.sort_by_key(|part| part.heading().chapter);
}
