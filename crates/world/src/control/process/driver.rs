//! A process that drives one vehicle in one run.

use std::sync::Arc;

use super::{Greeted, ProcessController};
use crate::control::history::History;
use crate::control::interval::Interval;
use crate::control::together::{self, Asking};
use crate::control::{Controller, ControllerFailure, Ego, Mapping};
use crate::observation::Observation;
use crate::process::ProcessProblem;
use crate::process::protocol::{self, Ask, AskAll, Reset, Seed};

/// Asks a process once every decision interval and holds its answer in between.
pub(crate) struct ProcessDriver {
    controller: Arc<ProcessController>,
    hello: Arc<[u8]>,
    /// Its own for the run; none if it answers in batches, when one is borrowed for each decision.
    own: Option<Greeted>,
    is_batch: bool,
    /// Whether it had driven runs before this one.
    reused: bool,
    /// A second, fresh process that is asked the same, in the runs that are checked.
    second: Option<Greeted>,
    interval: Interval,
    step_s: f64,
    steps: u64,
    /// When it is asked, and what it then sees.
    time_s: f64,
    row: Vec<f64>,
    history: History<f64>,
    line: Vec<u8>,
    held_mps2: f64,
}

impl ProcessDriver {
    /// A process that drives a vehicle. `seed` is the scenario's.
    ///
    /// # Errors
    /// [`ControllerFailure`] if it cannot be started, or is not ready.
    pub(crate) fn new(controller: Arc<ProcessController>, ego: &Ego, seed: u64) -> Result<Self, ControllerFailure> {
        let hello = controller.hello(ego);
        let taken = controller.take(&hello)?;
        let reused = taken.asked > 0;
        let first = controller.ready(taken, seed)?;
        let checked = controller.is_to_be_checked(ego.vehicle, reused, seed);
        let second = checked.then(|| controller.start(&hello).and_then(|second| controller.ready(second, seed)));
        let is_batch = first.greeting.batch;
        let interval_s = controller.setup.mapping.decision_interval_s.or(first.greeting.interval_s);
        let mut driver = Self {
            own: Some(first),
            hello,
            is_batch,
            reused,
            second: second.transpose()?,
            interval: Interval::new(interval_s, ego.step_s),
            step_s: ego.step_s,
            steps: 0,
            time_s: 0.0,
            row: Vec::new(),
            history: History::default(),
            line: Vec::new(),
            held_mps2: 0.0,
            controller,
        };
        if let Some(interval_s) = interval_s.filter(|interval_s| !Interval::fits(*interval_s, ego.step_s)) {
            let wanted = format!("a multiple of the scenario's step of {} s", ego.step_s);
            return Err(driver.failed(ProcessProblem::Interval { interval_s, wanted }, None));
        }
        if is_batch && let Some(borrowed) = driver.own.take() {
            driver.controller.give_back(borrowed);
        }
        Ok(driver)
    }

    /// The acceleration that a process answers with, in m/s².
    fn ask(&mut self, greeted: &mut Greeted) -> Result<f64, ProcessProblem> {
        let within = self.controller.answer_within();
        let see = self.row.as_slice();
        let id = greeted.next_id();
        let answer = if self.is_batch {
            protocol::line(&mut self.line, &AskAll { id, times_s: &[self.time_s], see: vec![see] })?;
            protocol::decisions(greeted.program.ask(&self.line, within)?, id, 1)?.first().copied().unwrap_or(f64::NAN)
        } else {
            protocol::line(&mut self.line, &Ask { id, time_s: self.time_s, see })?;
            protocol::decision(greeted.program.ask(&self.line, within)?, id)?
        };
        acceleration_mps2(&self.controller.setup.mapping, answer)
    }

    /// Ends both processes of a run that failed.
    fn failed(&mut self, problem: ProcessProblem, program: Option<Greeted>) -> ControllerFailure {
        self.second = None;
        let program = program.or_else(|| self.own.take());
        self.controller.failure(problem, program.map(|greeted| greeted.program))
    }
}

/// What an answer means, if it is within its range.
fn acceleration_mps2(mapping: &Mapping, answer: f64) -> Result<f64, ProcessProblem> {
    let (wanted_mps2, [low_mps2, high_mps2]) = mapping.wanted_mps2(answer);
    if wanted_mps2.is_nan() {
        Err(ProcessProblem::NotFinite)
    } else if (low_mps2..=high_mps2).contains(&wanted_mps2) {
        Ok(wanted_mps2)
    } else {
        Err(ProcessProblem::OutOfRange { answer_mps2: wanted_mps2, low_mps2, high_mps2 })
    }
}

impl ProcessController {
    /// A process at the start of a run. Those that answer in batches have no runs: their answers depend on what they see alone.
    fn ready(&self, mut greeted: Greeted, seed: u64) -> Result<Greeted, ControllerFailure> {
        if greeted.greeting.batch {
            return Ok(greeted);
        }
        let (id, mut line) = (greeted.next_id(), Vec::new());
        let ready = protocol::line(&mut line, &Reset { id, reset: Seed { seed } })
            .and_then(|()| protocol::ready(greeted.program.ask(&line, self.answer_within())?, id));
        match ready {
            Ok(()) => {
                greeted.program.forget_words();
                Ok(greeted)
            }
            Err(problem) => Err(self.failure(problem, Some(greeted.program))),
        }
    }
}

impl Asking for ProcessDriver {
    fn looks(&mut self, seen: &Observation) -> bool {
        self.time_s = self.steps as f64 * self.step_s;
        self.steps += 1;
        let due = self.interval.is_due();
        if due {
            let mapping = &self.controller.setup.mapping;
            self.row.clear();
            self.history.look_back(mapping, mapping.see(seen, self.held_mps2), &mut self.row);
        }
        due
    }

    fn decides(&mut self) -> Result<(), ControllerFailure> {
        let mut first = match self.own.take() {
            Some(own) => own,
            None if self.is_batch => self.controller.take(&self.hello)?,
            None => return Err(self.failed(ProcessProblem::Closed, None)),
        };
        match self.ask(&mut first) {
            Ok(answer_mps2) if self.is_batch => {
                self.controller.give_back(first);
                self.take(answer_mps2)
            }
            Ok(answer_mps2) => {
                self.own = Some(first);
                self.take(answer_mps2)
            }
            Err(problem) => Err(self.failed(problem, Some(first))),
        }
    }

    fn is_asked_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.controller, &other.controller) && self.is_batch && other.is_batch && self.hello == other.hello
    }

    fn answers_mps2(all: &[&Self]) -> Option<Vec<f64>> {
        let first = all.first()?;
        let controller = &first.controller;
        let mut greeted = controller.take(&first.hello).ok()?;
        let times_s: Vec<f64> = all.iter().map(|driver| driver.time_s).collect();
        let see = all.iter().map(|driver| driver.row.as_slice()).collect();
        let (id, mut line) = (greeted.next_id(), Vec::new());
        protocol::line(&mut line, &AskAll { id, times_s: &times_s, see }).ok()?;
        let line = greeted.program.ask(&line, controller.answer_within()).ok()?;
        let answers = protocol::decisions(line, id, all.len()).ok()?;
        let wanted = answers.into_iter().map(|answer| acceleration_mps2(&controller.setup.mapping, answer).ok());
        let wanted = wanted.collect::<Option<Vec<_>>>()?;
        controller.give_back(greeted);
        Some(wanted)
    }

    /// If the second process gives the same.
    fn take(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure> {
        if let Some(mut second) = self.second.take() {
            match self.ask(&mut second) {
                Ok(again_mps2) if again_mps2.to_bits() == answer_mps2.to_bits() => self.second = Some(second),
                Ok(second_mps2) => {
                    let problem =
                        ProcessProblem::Nondeterministic { first_mps2: answer_mps2, second_mps2, reused: self.reused };
                    let failure = self.failed(problem, Some(second));
                    return Err(self.controller.refuse(failure));
                }
                Err(problem) => return Err(self.failed(problem, Some(second))),
            }
        }
        self.held_mps2 = answer_mps2;
        Ok(())
    }

    fn held_mps2(&self) -> f64 {
        self.held_mps2
    }
}

impl Controller for ProcessDriver {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        together::decide(self, seen)
    }

    fn decide_together(
        all: &mut [Self],
        see: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        together::decide_together(all, see, commands_mps2, failed);
    }
}

impl Drop for ProcessDriver {
    fn drop(&mut self) {
        if let Some(own) = self.own.take() {
            self.controller.give_back(own);
        }
    }
}
