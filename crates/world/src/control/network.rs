//! Imported networks as controllers.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::decision_timer::DecisionTimer;
use super::history::InputHistory;
use super::space_check;
use super::{Controller, ControllerFailure, Ego, InvalidMapping, Mapping};
use crate::network::{FeedForward, NetworkFile};
use crate::observation::Observation;
use crate::policy::Workspace;
use crumple_core::digest::sha256;

/// An imported network and its mapping.
///
/// A network always answers: its inputs are clipped, and a network that could overflow within their limits is rejected.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkController {
    file: NetworkFile,
    mapping: Mapping,
    identity: String,
    /// True if the controller file states that the inputs include the normalisation; no effect on commands.
    normalised: Option<bool>,
    file_path: Option<PathBuf>,
}

impl NetworkController {
    /// Creates a controller from a network and a mapping.
    ///
    /// # Errors
    /// [`InvalidMapping`] if the mapping is wrong or does not fit the network.
    pub fn new(file: NetworkFile, mut mapping: Mapping) -> Result<Self, InvalidMapping> {
        mapping.check()?;
        let network = &file.network;
        if mapping.width() != network.inputs() {
            let problem = format!(
                "there are {}, and the network has {} inputs",
                mapping.width(),
                network.inputs()
            );
            let field = if mapping.history == 1 {
                "inputs"
            } else {
                "history"
            };
            return Err(InvalidMapping::new(field, problem));
        }
        let answer = match (mapping.output.answer, network.outputs()) {
            (Some(answer), answers) if answer >= answers => {
                let problem =
                    format!("must be below {answers}, the number of outputs of the network");
                return Err(InvalidMapping::new("output.answer", problem));
            }
            (None, answers) if answers > 1 => {
                let problem = format!(
                    "is missing: the network has {answers} outputs; choose the one that is the command"
                );
                return Err(InvalidMapping::new("output.answer", problem));
            }
            (answer, _) => answer.unwrap_or_default(),
        };
        // `answer = 0` and no `answer` are equivalent; normalised so that both have the same identity hash.
        mapping.output.answer = Some(answer);
        let refused =
            |error: crate::network::NetworkError| InvalidMapping::new("network", error.to_string());
        network.answer_ranges(&mapping.limits()).map_err(refused)?;
        if let Some(saved) = file.saved_model() {
            space_check::check(&mapping, saved)?;
        }
        let written = serde_json::to_string(&mapping)
            .map_err(|e| InvalidMapping::new("inputs", e.to_string()))?;
        let identity = sha256(format!("network {} {written}", file.sha256));
        Ok(Self {
            file,
            mapping,
            identity,
            normalised: None,
            file_path: None,
        })
    }

    /// Creates a controller with the mapping of crumple's own policies.
    ///
    /// # Errors
    /// [`InvalidMapping`] if the network has other inputs, or not one answer from -1 to 1.
    pub(crate) fn with_native_mapping(file: NetworkFile) -> Result<Self, InvalidMapping> {
        const ASK: &str = "write a controller file that describes its inputs and its output (docs/controllers.md)";
        let mapping = Mapping::native();
        let (inputs, outputs) = (file.network.inputs(), file.network.outputs());
        let refused =
            |problem: String| Err(InvalidMapping::new("network", format!("{problem}: {ASK}")));
        if inputs != mapping.width() || outputs != 1 {
            return refused(format!(
                "inputs: {inputs}, outputs: {outputs}; without a controller file crumple expects {} inputs and \
                 1 output",
                mapping.width()
            ));
        }
        if let Some((low, high)) = file
            .saved_model()
            .and_then(|saved| saved.action_space.bounds(0))
            && !(low >= -1.0 && high <= 1.0)
        {
            return refused(format!(
                "its action space is {low} to {high}; without a controller file crumple expects -1 to 1"
            ));
        }
        let controller = Self::new(file, mapping)?;
        match controller
            .file
            .network
            .answer_ranges(&controller.mapping.limits())
        {
            Ok(ranges)
                if ranges
                    .iter()
                    .all(|[low, high]| *low >= -1.0 && *high <= 1.0) =>
            {
                Ok(controller)
            }
            _ => refused(
                "its output is not limited to -1 to 1, for example by tanh or a clip".to_owned(),
            ),
        }
    }

    pub(crate) fn with_file_path(self, path: &Path) -> Self {
        Self {
            file_path: Some(path.to_owned()),
            ..self
        }
    }

    pub(crate) fn file_path(&self) -> Option<&Path> {
        self.file_path.as_deref()
    }

    pub(crate) fn with_normalised(self, normalised: Option<bool>) -> Self {
        Self { normalised, ..self }
    }

    pub(crate) fn normalised(&self) -> Option<bool> {
        self.normalised
    }

    /// Returns warnings about the mapping, from the spaces of the training if the network file contains them.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let undecided =
            |saved| space_check::warnings(&self.mapping, saved, self.normalised == Some(true));
        self.file.saved_model().map(undecided).unwrap_or_default()
    }

    /// Returns the network.
    #[must_use]
    pub fn network(&self) -> &FeedForward {
        &self.file.network
    }

    /// Returns the network's file.
    #[must_use]
    pub fn file(&self) -> &NetworkFile {
        &self.file
    }

    /// Returns the mapping.
    #[must_use]
    pub fn mapping(&self) -> &Mapping {
        &self.mapping
    }

    /// Returns the SHA-256, in hexadecimal, of file and mapping.
    #[must_use]
    pub fn identity(&self) -> &str {
        &self.identity
    }

    /// Starts a driver of a vehicle.
    #[must_use]
    pub fn start(self: &Arc<Self>, ego: &Ego) -> Box<dyn Controller> {
        Box::new(NetworkDriver::new(Arc::clone(self), ego))
    }

    fn accelerations_mps2(
        &self,
        rows: &[f32],
        batch: usize,
        space: &mut Workspace,
    ) -> impl Iterator<Item = f64> {
        let width = self.file.network.outputs();
        let answer = self.mapping.output.answer.unwrap_or_default();
        let answers = self
            .file
            .network
            .forward(rows, batch, space)
            .chunks_exact(width);
        answers.map(move |row| {
            self.mapping
                .acceleration_mps2(row.get(answer).copied().unwrap_or(f32::NAN))
        })
    }
}

/// A driver that evaluates a network once per decision interval and holds its answer in between.
pub(crate) struct NetworkDriver {
    controller: Arc<NetworkController>,
    decision_timer: DecisionTimer,
    command_mps2: f64,
    /// Acceleration that was commanded in the last step in place of the answer, in m/s².
    replaced_mps2: Option<f64>,
    history: InputHistory<f32>,
    rows: Vec<f32>,
    workspace: Workspace,
}

impl NetworkDriver {
    pub(crate) fn new(controller: Arc<NetworkController>, ego: &Ego) -> Self {
        let interval = DecisionTimer::new(controller.mapping.decision_interval_s, ego.step_s);
        Self {
            controller,
            decision_timer: interval,
            command_mps2: 0.0,
            replaced_mps2: None,
            history: InputHistory::default(),
            rows: Vec::new(),
            workspace: Workspace::default(),
        }
    }

    fn push_inputs(&mut self, seen: &Observation, rows: &mut Vec<f32>) {
        let Self {
            controller,
            history,
            command_mps2,
            replaced_mps2,
            ..
        } = self;
        let last_mps2 = replaced_mps2.unwrap_or(*command_mps2);
        let now = controller
            .mapping
            .input_values(seen, last_mps2)
            .map(|value| value as f32);
        history.push(&controller.mapping, now, rows);
    }
}

impl Controller for NetworkDriver {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        if self.decision_timer.tick() {
            let mut rows = std::mem::take(&mut self.rows);
            rows.clear();
            self.push_inputs(seen, &mut rows);
            let Self {
                controller,
                workspace: space,
                ..
            } = self;
            let answer_mps2 = controller.accelerations_mps2(&rows, 1, space).next();
            self.command_mps2 = answer_mps2.unwrap_or(self.controller.mapping.output.low_mps2);
            self.rows = rows;
        }
        self.replaced_mps2 = None;
        Ok(self.command_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.replaced_mps2 = Some(command_mps2);
    }

    /// Decides for all drivers that are due, with one matrix product per group of equal networks.
    fn decide_batch(
        all: &mut [Self],
        mut see: impl FnMut(usize) -> Observation,
        commands_mps2: &mut [f64],
        _failed: &mut Vec<(usize, ControllerFailure)>,
    ) {
        let (mut due, mut rows) = (Vec::new(), Vec::new());
        for (index, driver) in all.iter_mut().enumerate() {
            let observation = see(index);
            if driver.decision_timer.tick() {
                due.push((index, Arc::clone(&driver.controller)));
                driver.push_inputs(&observation, &mut rows);
            }
            driver.replaced_mps2 = None;
        }
        let mut rows = rows.as_slice();
        let mut space = Workspace::default();
        for group in due.chunk_by(|(_, a), (_, b)| Arc::ptr_eq(a, b)) {
            let controller = &group[0].1;
            let (now, later) = rows.split_at(group.len() * controller.mapping.width());
            rows = later;
            for ((index, _), answer_mps2) in
                group
                    .iter()
                    .zip(controller.accelerations_mps2(now, group.len(), &mut space))
            {
                all[*index].command_mps2 = answer_mps2;
            }
        }
        for (command_mps2, driver) in commands_mps2.iter_mut().zip(all) {
            *command_mps2 = driver.command_mps2;
        }
    }
}
