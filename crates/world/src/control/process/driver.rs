//! Controller processes that drive a vehicle in a run.

use std::sync::Arc;

use super::{ConnectedProcess, ProcessController};
use crate::control::batch_query::{self, BatchQuery};
use crate::control::decision_timer::DecisionTimer;
use crate::control::history::InputHistory;
use crate::control::{Controller, ControllerFailure, Ego, Mapping};
use crate::observation::Observation;
use crate::process::ProcessProblem;
use crate::process::protocol::{
    self, BatchDecisionRequest, DecisionRequest, ResetParams, ResetRequest,
};

/// A driver that queries a process once per decision interval and holds its answer in between.
pub(crate) struct ProcessDriver {
    controller: Arc<ProcessController>,
    hello: Arc<[u8]>,
    /// Process of this run. `None` if the process answers in batches; the driver then borrows one for each decision.
    own_process: Option<ConnectedProcess>,
    is_batch: bool,
    is_reused: bool,
    /// Second, fresh process that receives the same queries, in runs with a determinism check.
    second_process: Option<ConnectedProcess>,
    decision_timer: DecisionTimer,
    step_s: f64,
    steps: u64,
    /// Time of the last decision, in seconds, and its inputs.
    time_s: f64,
    inputs: Vec<f64>,
    history: InputHistory<f64>,
    line_buffer: Vec<u8>,
    command_mps2: f64,
    /// Acceleration that was commanded in the last step in place of the answer, in m/s².
    replaced_mps2: Option<f64>,
}

impl ProcessDriver {
    /// Creates a driver for a vehicle. `seed` is the scenario's.
    ///
    /// # Errors
    /// [`ControllerFailure`] if the process cannot be started or is not ready.
    pub(crate) fn new(
        controller: Arc<ProcessController>,
        ego: &Ego,
        seed: u64,
    ) -> Result<Self, ControllerFailure> {
        let hello = controller.hello(ego);
        let taken = controller.acquire(&hello)?;
        let reused = taken.question_count > 0;
        let first = controller.reset_for_run(taken, seed)?;
        let checked = controller.is_selected_for_check(ego.vehicle, reused, seed);
        let second = checked.then(|| {
            controller
                .start(&hello)
                .and_then(|second| controller.reset_for_run(second, seed))
        });
        let is_batch = first.greeting.batch;
        let interval_s = controller
            .setup
            .mapping
            .decision_interval_s
            .or(first.greeting.interval_s);
        let mut driver = Self {
            own_process: Some(first),
            hello,
            is_batch,
            is_reused: reused,
            second_process: second.transpose()?,
            decision_timer: DecisionTimer::new(interval_s, ego.step_s),
            step_s: ego.step_s,
            steps: 0,
            time_s: 0.0,
            inputs: Vec::new(),
            history: InputHistory::default(),
            line_buffer: Vec::new(),
            command_mps2: 0.0,
            replaced_mps2: None,
            controller,
        };
        if let Some(interval_s) =
            interval_s.filter(|interval_s| !DecisionTimer::is_whole_steps(*interval_s, ego.step_s))
        {
            let wanted = format!("a multiple of the scenario's step of {} s", ego.step_s);
            return Err(
                driver.end_with_failure(ProcessProblem::Interval { interval_s, wanted }, None)
            );
        }
        if is_batch && let Some(borrowed) = driver.own_process.take() {
            driver.controller.release(borrowed);
        }
        Ok(driver)
    }

    fn ask(&mut self, greeted: &mut ConnectedProcess) -> Result<f64, ProcessProblem> {
        let within = self.controller.answer_timeout();
        let see = self.inputs.as_slice();
        let id = greeted.next_id();
        let answer = if self.is_batch {
            protocol::write_line(
                &mut self.line_buffer,
                &BatchDecisionRequest {
                    id,
                    times_s: &[self.time_s],
                    inputs: vec![see],
                },
            )?;
            protocol::parse_decisions(greeted.program.query(&self.line_buffer, within)?, id, 1)?
                .first()
                .copied()
                .unwrap_or(f64::NAN)
        } else {
            protocol::write_line(
                &mut self.line_buffer,
                &DecisionRequest {
                    id,
                    time_s: self.time_s,
                    inputs: see,
                },
            )?;
            protocol::parse_decision(greeted.program.query(&self.line_buffer, within)?, id)?
        };
        checked_acceleration_mps2(&self.controller.setup.mapping, answer)
    }

    fn end_with_failure(
        &mut self,
        problem: ProcessProblem,
        program: Option<ConnectedProcess>,
    ) -> ControllerFailure {
        self.second_process = None;
        let program = program.or_else(|| self.own_process.take());
        self.controller
            .end_with_failure(problem, program.map(|greeted| greeted.program))
    }
}

fn checked_acceleration_mps2(mapping: &Mapping, answer: f64) -> Result<f64, ProcessProblem> {
    let (wanted_mps2, [low_mps2, high_mps2]) = mapping.acceleration_and_range_mps2(answer);
    if wanted_mps2.is_nan() {
        Err(ProcessProblem::NotFinite)
    } else if (low_mps2..=high_mps2).contains(&wanted_mps2) {
        Ok(wanted_mps2)
    } else {
        Err(ProcessProblem::OutOfRange {
            answer_mps2: wanted_mps2,
            low_mps2,
            high_mps2,
        })
    }
}

impl ProcessController {
    /// Resets a process for a run, unless it answers in batches and therefore has no state.
    fn reset_for_run(
        &self,
        mut greeted: ConnectedProcess,
        seed: u64,
    ) -> Result<ConnectedProcess, ControllerFailure> {
        if greeted.greeting.batch {
            return Ok(greeted);
        }
        let (id, mut line) = (greeted.next_id(), Vec::new());
        let ready = protocol::write_line(
            &mut line,
            &ResetRequest {
                id,
                reset: ResetParams { seed },
            },
        )
        .and_then(|()| {
            protocol::parse_reset_reply(greeted.program.query(&line, self.answer_timeout())?, id)
        });
        match ready {
            Ok(()) => {
                greeted.program.clear_stderr();
                Ok(greeted)
            }
            Err(problem) => Err(self.end_with_failure(problem, Some(greeted.program))),
        }
    }
}

impl BatchQuery for ProcessDriver {
    fn sample(&mut self, seen: &Observation) -> bool {
        self.time_s = self.steps as f64 * self.step_s;
        self.steps += 1;
        let due = self.decision_timer.tick();
        let last_mps2 = self.replaced_mps2.take().unwrap_or(self.command_mps2);
        if due {
            let mapping = &self.controller.setup.mapping;
            self.inputs.clear();
            self.history.push(
                mapping,
                mapping.input_values(seen, last_mps2),
                &mut self.inputs,
            );
        }
        due
    }

    fn query(&mut self) -> Result<(), ControllerFailure> {
        let mut first = match self.own_process.take() {
            Some(own) => own,
            None if self.is_batch => self.controller.acquire(&self.hello)?,
            None => return Err(self.end_with_failure(ProcessProblem::Closed, None)),
        };
        match self.ask(&mut first) {
            Ok(answer_mps2) if self.is_batch => {
                self.controller.release(first);
                self.set_command(answer_mps2)
            }
            Ok(answer_mps2) => {
                self.own_process = Some(first);
                self.set_command(answer_mps2)
            }
            Err(problem) => Err(self.end_with_failure(problem, Some(first))),
        }
    }

    fn shares_batch_with(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.controller, &other.controller)
            && self.is_batch
            && other.is_batch
            && self.hello == other.hello
    }

    fn query_batch(all: &[&Self]) -> Option<Vec<f64>> {
        let first = all.first()?;
        let controller = &first.controller;
        let mut greeted = controller.acquire(&first.hello).ok()?;
        let times_s: Vec<f64> = all.iter().map(|driver| driver.time_s).collect();
        let see = all.iter().map(|driver| driver.inputs.as_slice()).collect();
        let (id, mut line) = (greeted.next_id(), Vec::new());
        protocol::write_line(
            &mut line,
            &BatchDecisionRequest {
                id,
                times_s: &times_s,
                inputs: see,
            },
        )
        .ok()?;
        let line = greeted
            .program
            .query(&line, controller.answer_timeout())
            .ok()?;
        let answers = protocol::parse_decisions(line, id, all.len()).ok()?;
        let wanted = answers
            .into_iter()
            .map(|answer| checked_acceleration_mps2(&controller.setup.mapping, answer).ok());
        let wanted = wanted.collect::<Option<Vec<_>>>()?;
        controller.release(greeted);
        Some(wanted)
    }

    /// Accepts the answer if the second process gives the same.
    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure> {
        if let Some(mut second) = self.second_process.take() {
            match self.ask(&mut second) {
                Ok(again_mps2) if again_mps2.to_bits() == answer_mps2.to_bits() => {
                    self.second_process = Some(second)
                }
                Ok(second_mps2) => {
                    let problem = ProcessProblem::Nondeterministic {
                        first_mps2: answer_mps2,
                        second_mps2,
                        reused: self.is_reused,
                    };
                    let failure = self.end_with_failure(problem, Some(second));
                    return Err(self.controller.refuse(failure));
                }
                Err(problem) => return Err(self.end_with_failure(problem, Some(second))),
            }
        }
        self.command_mps2 = answer_mps2;
        Ok(())
    }

    fn command_mps2(&self) -> f64 {
        self.command_mps2
    }
}

impl Controller for ProcessDriver {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        batch_query::decide(self, seen)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.replaced_mps2 = Some(command_mps2);
    }

    fn decide_batch(
        all: &mut [Self],
        see: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        batch_query::decide_batch(all, see, commands_mps2, failed);
    }
}

impl Drop for ProcessDriver {
    fn drop(&mut self) {
        if let Some(own) = self.own_process.take() {
            self.controller.release(own);
        }
    }
}
