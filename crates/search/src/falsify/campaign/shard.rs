//! A shard of a campaign: a part of the budget of every method.
//!
//! Shard I of N makes the I-th of N parts of the evaluations that each method has. The reference searches do not look at values, so that a
//! part of them is the same points as in a campaign by one machine. The method asked for is searched with anew in every shard, by a seed
//! that follows from that of the campaign and from how many evaluations come before the shard: a campaign of N shards is N searches.
//!
//! A folder holds `shard.json`, all that decides it, and `findings.json`, what is remembered of its evaluations, with its failures
//! replayed, shrunk and classed. Evaluations themselves are not kept, but for the journal while it lasts.

use std::ops::{ControlFlow, Range};
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::config::CampaignRecord;
use super::failures::{Failures, Kind};
use super::findings::{Findings, Reached};
use super::front::Front;
use super::journal::Journal;
use super::run::{JOURNAL, Progress, Searching, go_on};
use super::terms::Terms;
use super::{Campaign, CampaignError, FailureCandidate, FailureKind, Log};
use crate::falsify::Method;
use crate::falsify::counterexample::{Examined, ExaminedRow, Examiner};
use crate::shard::{self, SHARD, Shard};
use crate::work::{Finished, WorkError};

/// What a folder of one is called in its `work.json`.
pub const SHARD_OF_A_CAMPAIGN: &str = "shard of a campaign";

const FINDINGS: &str = "findings.json";
/// The version of these files.
const VERSION: u32 = 1;
const WHAT: &str = "evaluations of each method";

/// The file `shard.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ShardFile {
    version: u32,
    shard: Shard,
    nondeterministic: bool,
    campaign: CampaignRecord,
}

/// The file `findings.json`.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FindingsFile {
    methods: Vec<Reached>,
    kinds: Vec<KindRow>,
    front: Vec<FailureCandidate>,
    examined: Vec<ExaminedRow>,
}

/// Failures of one kind, which is that of each of them.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct KindRow {
    by_method: Vec<(Method, u64, u64)>,
    first: FailureCandidate,
    severest: FailureCandidate,
    likeliest: FailureCandidate,
}

/// What came of a shard.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ShardDone {
    /// Evaluations of all methods together.
    pub evaluations: u64,
    /// How many failed.
    pub failures: u64,
    /// Kinds of failures.
    pub kinds: usize,
}

impl Campaign {
    /// Makes a shard of the campaign in `folder`, or goes on with it where `resume` says so, until `progress` breaks it off.
    ///
    /// # Errors
    /// [`CampaignError`] if there are fewer evaluations than shards, the controller states no identity, the folder cannot be used, or a
    /// scenario cannot be run.
    pub fn run_shard(
        &self,
        shard: Shard,
        folder: &Path,
        resume: bool,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<ShardDone, CampaignError> {
        let part = shard.range(self.budget, WHAT)?;
        if self.controller.kind.identity().is_none() {
            return Err(CampaignError::UnknownInShards(self.controller.name.clone()));
        }
        let terms = Terms::of(self, Log::Summary)?;
        self.check(&terms.nominal)?;
        let (nondeterministic, campaign) = (terms.nondeterministic, terms.record.clone());
        let file = ShardFile { version: VERSION, shard, nondeterministic, campaign };
        let work = shard::open_shard(folder, SHARD_OF_A_CAMPAIGN, &json(&file)?, FINDINGS, resume)?;
        if work.is_complete() {
            let read = serde_json::from_slice(&work.read_present(FINDINGS)?);
            return Ok(FindingsFile::done(&read.map_err(CampaignError::encoding)?));
        }
        work.changes().grow(JOURNAL).commit()?;
        let journal = Journal::in_work(&work, JOURNAL, resume)?;
        let findings = Findings::of(&terms);
        let mut searching =
            Searching { campaign: self, terms: &terms, work: &work, journal, table: None, findings, part };
        searching.search_all(progress)?;
        go_on(progress(&searching.progress(None)))?;
        let (findings, examiner) = (&searching.findings, Examiner::new(self, &terms));
        // Of all kinds: which are the most frequent in the end is not known here.
        let mut examined = examiner.examine_all(&findings.failures.picks(usize::MAX))?;
        examiner.class_all(&mut examined);
        go_on(progress(&searching.progress(None)))?;
        let file = FindingsFile::of(findings, &examined)?;
        work.changes().write(FINDINGS, json(&file)?).remove(JOURNAL).commit()?;
        work.finish()?;
        Ok(file.done())
    }
}

impl FindingsFile {
    fn of(findings: &Findings, examined: &[Examined]) -> Result<Self, CampaignError> {
        let row = |kind: &Kind| KindRow {
            by_method: kind.by_method.clone(),
            first: kind.first.clone(),
            severest: kind.severest.clone(),
            likeliest: kind.likeliest.clone(),
        };
        Ok(Self {
            methods: findings.reached.clone(),
            kinds: findings.failures.kinds.iter().map(row).collect(),
            front: findings.failures.front.failures().to_vec(),
            examined: examined.iter().map(ExaminedRow::of).collect::<Result<_, _>>()?,
        })
    }

    fn done(&self) -> ShardDone {
        let sum = |of: fn(&Reached) -> u64| self.methods.iter().map(of).fold(0, u64::saturating_add);
        ShardDone {
            evaluations: sum(|reached| reached.evaluations),
            failures: sum(|reached| reached.failures),
            kinds: self.kinds.len(),
        }
    }

    /// What it says, unless no evaluations in that part can have come to it.
    fn read(self, terms: &Terms, part: &Range<u64>) -> Result<(Findings, Vec<Examined>), String> {
        let methods = terms.methods();
        let dimension = terms.space.dimension();
        let is_sound = self.methods.iter().map(|reached| reached.method).eq(methods.iter().copied())
            && self.methods.iter().all(|reached| reached.is_sound(part, dimension));
        if !is_sound {
            return Err("methods: not what this part of the budget comes to".to_owned());
        }
        let kind = |found: &FailureCandidate| {
            let is_made = methods.contains(&found.method) && part.contains(&found.number.wrapping_sub(1));
            let is_made = is_made && found.values.len() == dimension && !found.ln_likelihood.is_nan();
            FailureKind::of(&found.verdict, &terms.specification).filter(|_| is_made)
        };
        let mut failures = Failures::new(terms.specification.clone());
        for KindRow { by_method, first, severest, likeliest } in self.kinds {
            let all = [&first, &severest, &likeliest].map(kind);
            let (Some(kind), true) = (all[0], all[1] == all[0] && all[2] == all[0]) else {
                return Err("kinds: not failures of this campaign".to_owned());
            };
            let is_known = |(method, count, first): &(Method, u64, u64)| {
                methods.contains(method) && part.contains(&first.wrapping_sub(1)) && *count <= part.end - part.start
            };
            if by_method.is_empty() || !by_method.iter().all(is_known) {
                return Err("kinds: not counted in this part of the budget".to_owned());
            }
            failures.kinds.push(Kind { kind, by_method, first, severest, likeliest });
        }
        if self.front.iter().any(|found| kind(found).is_none()) {
            return Err("front: not failures of this campaign".to_owned());
        }
        failures.front = Front::of(self.front);
        let examined = self.examined.into_iter().map(|row| row.read(terms)).collect::<Result<_, _>>()?;
        Ok((Findings { reached: self.methods, failures }, examined))
    }
}

/// A shard that was made, as it is read from its folder.
pub(super) struct MadeShard {
    pub(super) shard: Shard,
    pub(super) part: Range<u64>,
    pub(super) findings: Findings,
    pub(super) examined: Vec<Examined>,
    /// Of the text of its findings.
    pub(super) text: String,
}

/// What shards have to share.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shared {
    pub(super) campaign: CampaignRecord,
    pub(super) nondeterministic: bool,
}

impl MadeShard {
    /// What it is a shard of.
    pub(super) fn shared(found: &Finished) -> Result<(Shard, Shared), WorkError> {
        let file: ShardFile = shard::read_shard(found)?;
        let ShardFile { version, shard, nondeterministic, campaign } = file;
        if version != VERSION {
            return Err(found.damaged(SHARD, format!("version: {version}, and this release reads {VERSION}")));
        }
        Ok((shard, Shared { campaign, nondeterministic }))
    }

    /// Reads it.
    pub(super) fn read(found: &Finished, shard: Shard, terms: &Terms) -> Result<Self, WorkError> {
        let part = shard.range(terms.record.budget, WHAT).map_err(|error| found.damaged(SHARD, error))?;
        let text = found.read(FINDINGS)?;
        let file: FindingsFile = serde_json::from_str(&text).map_err(|error| found.unreadable(FINDINGS, &error))?;
        let (findings, examined) = file.read(terms, &part).map_err(|problem| found.damaged(FINDINGS, problem))?;
        Ok(Self { shard, part, findings, examined, text })
    }

    /// The error about what it says of the campaign.
    pub(super) fn unusable(found: &Finished, problem: String) -> WorkError {
        found.damaged(SHARD, format!("campaign.{problem}"))
    }
}

fn json(value: &impl Serialize) -> Result<String, CampaignError> {
    Ok(serde_json::to_string(value).map_err(CampaignError::encoding)? + "\n")
}
