//! Controller processes that drive a vehicle in a run.

use std::sync::Arc;

use super::{ConnectedProcess, ProcessPool};
use crate::protocol::{
    self, BatchDecisionRequest, Decision, DecisionRequest, ResetParams, ResetRequest,
};
use crumple_networks::{InputHistory, Mapping};
use crumple_sim::control::{
    BatchQuery, Controller, ControllerFailure, DecisionTimer, Ego, ProcessProblem, decide_by_query,
};
use crumple_sim::observation::Observation;

/// A driver that queries a process once per decision interval and holds its answer in between.
pub(super) struct ProcessDriver {
    pool: Arc<ProcessPool>,
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
    /// True if the process warned at its last decision.
    is_warning: bool,
    /// Acceleration that was commanded in the last step in place of the answer, in m/s².
    replaced_mps2: Option<f64>,
}

impl ProcessDriver {
    /// Creates a driver for a vehicle. `seed` is the scenario's.
    ///
    /// # Errors
    /// [`ControllerFailure`] if the process cannot be started or is not ready.
    pub(super) fn new(
        pool: Arc<ProcessPool>,
        ego: &Ego,
        seed: u64,
    ) -> Result<Self, ControllerFailure> {
        let hello = pool.hello(ego);
        let process = pool.acquire(&hello)?;
        let is_reused = process.question_count > 0;
        let process = pool.reset_for_run(process, seed)?;
        let second_process = if pool.is_selected_for_check(ego.vehicle, is_reused, seed) {
            Some(pool.reset_for_run(pool.start(&hello)?, seed)?)
        } else {
            None
        };
        let is_batch = process.greeting.batch;
        let stated_interval_s = pool.setup.mapping.decision_interval_s;
        let interval_s = stated_interval_s.or(process.greeting.interval_s);
        let mut driver = Self {
            own_process: Some(process),
            hello,
            is_batch,
            is_reused,
            second_process,
            decision_timer: DecisionTimer::new(interval_s, ego.step_s),
            step_s: ego.step_s,
            steps: 0,
            time_s: 0.0,
            inputs: Vec::new(),
            history: InputHistory::default(),
            line_buffer: Vec::new(),
            command_mps2: 0.0,
            is_warning: false,
            replaced_mps2: None,
            pool,
        };
        driver.check_interval(interval_s)?;
        if is_batch && let Some(process) = driver.own_process.take() {
            driver.pool.release(process);
        }
        Ok(driver)
    }

    /// Refuses an interval between decisions that is not a whole number of steps.
    fn check_interval(&mut self, interval_s: Option<f64>) -> Result<(), ControllerFailure> {
        match interval_s {
            Some(interval_s) if !DecisionTimer::is_whole_steps(interval_s, self.step_s) => {
                let wanted = format!("a multiple of the scenario's step of {} s", self.step_s);
                let problem = ProcessProblem::Interval { interval_s, wanted };
                Err(self.end_with_failure(problem, None))
            }
            _ => Ok(()),
        }
    }

    /// Queries a process. The answer of the decision is an acceleration, in m/s².
    fn ask(&mut self, process: &mut ConnectedProcess) -> Result<Decision, ProcessProblem> {
        let timeout = self.pool.answer_timeout();
        let inputs = self.inputs.as_slice();
        let expected = process.expect_reply();
        let id = expected.id;
        let decision = if self.is_batch {
            protocol::write_line(
                &mut self.line_buffer,
                &BatchDecisionRequest {
                    id,
                    times_s: &[self.time_s],
                    inputs: vec![inputs],
                },
            )?;
            let line = process.program.query(&self.line_buffer, timeout)?;
            let decisions = protocol::parse_decisions(line, expected, 1)?;
            let first = decisions.first().copied();
            first.ok_or(ProcessProblem::NotFinite)?
        } else {
            protocol::write_line(
                &mut self.line_buffer,
                &DecisionRequest {
                    id,
                    time_s: self.time_s,
                    inputs,
                },
            )?;
            protocol::parse_decision(process.program.query(&self.line_buffer, timeout)?, expected)?
        };
        Ok(Decision {
            answer: checked_acceleration_mps2(&self.pool.setup.mapping, decision.answer)?,
            ..decision
        })
    }

    fn end_with_failure(
        &mut self,
        problem: ProcessProblem,
        process: Option<ConnectedProcess>,
    ) -> ControllerFailure {
        self.second_process = None;
        let process = process.or_else(|| self.own_process.take());
        self.pool
            .end_with_failure(problem, process.map(|process| process.program))
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

impl ProcessPool {
    /// Resets a process for a run, unless it answers in batches and therefore has no state.
    fn reset_for_run(
        &self,
        mut process: ConnectedProcess,
        seed: u64,
    ) -> Result<ConnectedProcess, ControllerFailure> {
        if process.greeting.batch {
            return Ok(process);
        }
        let id = process.next_id();
        let mut line = Vec::new();
        let ready = protocol::write_line(
            &mut line,
            &ResetRequest {
                id,
                reset: ResetParams { seed },
            },
        )
        .and_then(|()| {
            protocol::parse_reset_reply(process.program.query(&line, self.answer_timeout())?, id)
        });
        match ready {
            Ok(()) => {
                process.program.clear_stderr();
                Ok(process)
            }
            Err(problem) => Err(self.end_with_failure(problem, Some(process.program))),
        }
    }
}

impl BatchQuery for ProcessDriver {
    fn sample(&mut self, observation: &Observation) -> bool {
        self.time_s = self.steps as f64 * self.step_s;
        self.steps += 1;
        let due = self.decision_timer.tick();
        let last_mps2 = self.replaced_mps2.take().unwrap_or(self.command_mps2);
        if due {
            let mapping = &self.pool.setup.mapping;
            self.inputs.clear();
            self.history.push(
                mapping,
                mapping.input_values(observation, last_mps2),
                &mut self.inputs,
            );
        }
        due
    }

    fn query(&mut self) -> Result<(), ControllerFailure> {
        let mut first = match self.own_process.take() {
            Some(own) => own,
            None if self.is_batch => self.pool.acquire(&self.hello)?,
            None => return Err(self.end_with_failure(ProcessProblem::Closed, None)),
        };
        match self.ask(&mut first) {
            Ok(decision) => {
                if self.is_batch {
                    self.pool.release(first);
                } else {
                    self.own_process = Some(first);
                }
                self.is_warning = decision.warning;
                self.set_command(decision.answer)
            }
            Err(problem) => Err(self.end_with_failure(problem, Some(first))),
        }
    }

    fn shares_batch_with(&self, other: &dyn BatchQuery) -> bool {
        other.downcast_ref::<Self>().is_some_and(|other| {
            let both_batch = self.is_batch && other.is_batch;
            both_batch && Arc::ptr_eq(&self.pool, &other.pool) && self.hello == other.hello
        })
    }

    fn query_batch(&self, members: &[&dyn BatchQuery]) -> Option<Vec<f64>> {
        let drivers = members
            .iter()
            .map(|member| member.downcast_ref::<Self>())
            .collect::<Option<Vec<_>>>()?;
        let times_s: Vec<f64> = drivers.iter().map(|driver| driver.time_s).collect();
        let inputs = drivers.iter().map(|driver| driver.inputs.as_slice());
        let mut process = self.pool.acquire(&self.hello).ok()?;
        let expected = process.expect_reply();
        let request = BatchDecisionRequest {
            id: expected.id,
            times_s: &times_s,
            inputs: inputs.collect(),
        };
        let mut line = Vec::new();
        protocol::write_line(&mut line, &request).ok()?;
        let line = process
            .program
            .query(&line, self.pool.answer_timeout())
            .ok()?;
        let decisions = protocol::parse_decisions(line, expected, drivers.len()).ok()?;
        let mapping = &self.pool.setup.mapping;
        let accelerations_mps2 = decisions
            .into_iter()
            .map(|decision| checked_acceleration_mps2(mapping, decision.answer).ok())
            .collect::<Option<Vec<_>>>()?;
        self.pool.release(process);
        Some(accelerations_mps2)
    }

    /// Accepts the answer if the second process gives the same.
    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure> {
        if let Some(mut second) = self.second_process.take() {
            match self.ask(&mut second) {
                Ok(again) if again.answer.to_bits() == answer_mps2.to_bits() => {
                    self.second_process = Some(second)
                }
                Ok(Decision {
                    answer: second_mps2,
                    ..
                }) => {
                    let problem = ProcessProblem::Nondeterministic {
                        first_mps2: answer_mps2,
                        second_mps2,
                        reused: self.is_reused,
                    };
                    let failure = self.end_with_failure(problem, Some(second));
                    return Err(self.pool.refuse(failure));
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
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        decide_by_query(self, observation)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.replaced_mps2 = Some(command_mps2);
    }

    /// Valid for a driver that is queried alone: queries of batches drop the warnings.
    fn is_warning(&self) -> bool {
        self.is_warning
    }

    fn as_batch_query(&mut self) -> Option<&mut dyn BatchQuery> {
        Some(self)
    }
}

impl Drop for ProcessDriver {
    fn drop(&mut self) {
        if let Some(own) = self.own_process.take() {
            self.pool.release(own);
        }
    }
}
