//! Imported networks as controllers.

use std::sync::Arc;

use crumple_core::digest::sha256;
use crumple_sim::control::{
    BatchQuery, Controller, ControllerFailure, ControllerSource, DecisionTimer, Ego, SourceFile,
    decide_by_query,
};
use crumple_sim::observation::Observation;
use crumple_sim::policy::Workspace;

use super::history::InputHistory;
use super::network::{FeedForward, NetworkFile};
use super::space_check;
use super::{InvalidMapping, Mapping};

/// An imported network and its mapping. Clones share the network.
///
/// A network always answers: its inputs are clipped, and a network that could overflow within their limits is rejected.
#[derive(Debug, Clone, PartialEq)]
pub struct NetworkController {
    mapped: Arc<MappedNetwork>,
    /// True if the controller file states that the inputs include the normalisation; no effect on commands.
    normalised: Option<bool>,
    source_file: Option<SourceFile>,
}

/// The network and the mapping, which determine the commands.
#[derive(Debug, PartialEq)]
struct MappedNetwork {
    file: NetworkFile,
    mapping: Mapping,
    identity: String,
}

/// Returns the index of the answer that is the command. With several outputs, the mapping must choose one.
fn choose_answer(answer: Option<usize>, outputs: usize) -> Result<usize, InvalidMapping> {
    match answer {
        Some(answer) if answer >= outputs => {
            let problem = format!("must be below {outputs}, the number of outputs of the network");
            Err(InvalidMapping::new("output.answer", problem))
        }
        None if outputs > 1 => {
            let problem = format!(
                "is missing: the network has {outputs} outputs; choose the one that is the command"
            );
            Err(InvalidMapping::new("output.answer", problem))
        }
        answer => Ok(answer.unwrap_or_default()),
    }
}

fn needs_controller_file<T>(problem: String) -> Result<T, InvalidMapping> {
    const ADVICE: &str =
        "write a controller file that describes its inputs and its output (docs/controllers.md)";
    let problem = format!("{problem}: {ADVICE}");
    Err(InvalidMapping::new("network", problem))
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
        // `answer = 0` and no `answer` are equivalent; normalised so that both have the same identity hash.
        mapping.output.answer = Some(choose_answer(mapping.output.answer, network.outputs())?);
        network
            .answer_ranges(&mapping.limits())
            .map_err(|error| InvalidMapping::new("network", error.to_string()))?;
        if let Some(saved) = file.saved_model() {
            space_check::check(&mapping, saved)?;
        }
        let mapping_text = serde_json::to_string(&mapping)
            .map_err(|e| InvalidMapping::new("inputs", e.to_string()))?;
        let identity = sha256(format!("network {} {mapping_text}", file.sha256));
        Ok(Self {
            mapped: Arc::new(MappedNetwork {
                file,
                mapping,
                identity,
            }),
            normalised: None,
            source_file: None,
        })
    }

    /// Creates a controller with the mapping of crumple's own policies.
    ///
    /// # Errors
    /// [`InvalidMapping`] if the network has other inputs, or not one answer from -1 to 1.
    pub fn with_native_mapping(file: NetworkFile) -> Result<Self, InvalidMapping> {
        let mapping = Mapping::native();
        let inputs = file.network.inputs();
        let outputs = file.network.outputs();
        if inputs != mapping.width() || outputs != 1 {
            return needs_controller_file(format!(
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
            return needs_controller_file(format!(
                "its action space is {low} to {high}; without a controller file crumple expects -1 to 1"
            ));
        }
        let controller = Self::new(file, mapping)?;
        match controller
            .network()
            .answer_ranges(&controller.mapping().limits())
        {
            Ok(ranges)
                if ranges
                    .iter()
                    .all(|[low, high]| *low >= -1.0 && *high <= 1.0) =>
            {
                Ok(controller)
            }
            _ => needs_controller_file(
                "its output is not limited to -1 to 1, for example by tanh or a clip".to_owned(),
            ),
        }
    }

    /// Sets the file that messages name.
    #[must_use]
    pub fn with_source_file(self, source_file: SourceFile) -> Self {
        Self {
            source_file: Some(source_file),
            ..self
        }
    }

    /// States if the inputs include the normalisation of the training; `None` if that is unknown.
    #[must_use]
    pub fn with_normalised(self, normalised: Option<bool>) -> Self {
        Self { normalised, ..self }
    }

    /// Returns true if the inputs include the normalisation of the training; `None` if that is unknown.
    #[must_use]
    pub fn normalised(&self) -> Option<bool> {
        self.normalised
    }

    /// Returns the network.
    #[must_use]
    pub fn network(&self) -> &FeedForward {
        &self.mapped.file.network
    }

    /// Returns the network's file.
    #[must_use]
    pub fn network_file(&self) -> &NetworkFile {
        &self.mapped.file
    }

    /// Returns the mapping.
    #[must_use]
    pub fn mapping(&self) -> &Mapping {
        &self.mapped.mapping
    }

    /// Returns the SHA-256, in hexadecimal, of file and mapping.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.mapped.identity
    }
}

impl ControllerSource for NetworkController {
    fn identity(&self) -> Option<String> {
        Some(self.sha256().to_owned())
    }

    fn start(&self, ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(NetworkDriver::new(Arc::clone(&self.mapped), ego)))
    }

    fn holds_answers(&self) -> bool {
        true
    }

    fn interval_s(&self) -> Option<f64> {
        self.mapping().decision_interval_s
    }

    /// Returns differences between the mapping and the spaces of the training, if the file contains them.
    fn warnings(&self) -> Vec<String> {
        match self.network_file().saved_model() {
            Some(saved) => {
                space_check::warnings(self.mapping(), saved, self.normalised == Some(true))
            }
            None => Vec::new(),
        }
    }

    fn description(&self) -> String {
        let trained_by = match self.network_file().saved_model() {
            Some(saved) => format!(" ({} of Stable-Baselines3)", saved.algorithm),
            None => String::new(),
        };
        let shape = self.network().shape();
        format!("external network{trained_by} with layers {shape}")
    }

    fn file(&self) -> Option<&SourceFile> {
        self.source_file.as_ref()
    }

    fn is_learned(&self) -> bool {
        true
    }

    fn can_fail(&self) -> bool {
        false
    }
}

impl MappedNetwork {
    /// Returns the acceleration for each of `batch` rows of inputs, in m/s².
    fn accelerations_mps2(&self, rows: &[f32], batch: usize, space: &mut Workspace) -> Vec<f64> {
        let network = &self.file.network;
        let answer = self.mapping.output.answer.unwrap_or_default();
        let answers = network.forward(rows, batch, space);
        answers
            .chunks_exact(network.outputs())
            .map(|row| {
                let raw = row.get(answer).copied().unwrap_or(f32::NAN);
                self.mapping.acceleration_mps2(raw)
            })
            .collect()
    }
}

/// A controller that evaluates a network once per decision interval and holds its answer in between.
struct NetworkDriver {
    mapped: Arc<MappedNetwork>,
    decision_timer: DecisionTimer,
    command_mps2: f64,
    /// Acceleration that was commanded in the last step in place of the answer, in m/s².
    replaced_mps2: Option<f64>,
    history: InputHistory<f32>,
    /// Inputs of the last decision.
    row: Vec<f32>,
    workspace: Workspace,
}

impl NetworkDriver {
    fn new(mapped: Arc<MappedNetwork>, ego: &Ego) -> Self {
        let decision_timer = DecisionTimer::new(mapped.mapping.decision_interval_s, ego.step_s);
        Self {
            mapped,
            decision_timer,
            command_mps2: 0.0,
            replaced_mps2: None,
            history: InputHistory::default(),
            row: Vec::new(),
            workspace: Workspace::default(),
        }
    }
}

impl BatchQuery for NetworkDriver {
    fn sample(&mut self, observation: &Observation) -> bool {
        let last_mps2 = self.replaced_mps2.take().unwrap_or(self.command_mps2);
        if !self.decision_timer.tick() {
            return false;
        }
        let mapping = &self.mapped.mapping;
        let inputs = mapping.input_values(observation, last_mps2);
        self.row.clear();
        self.history
            .push(mapping, inputs.map(|value| value as f32), &mut self.row);
        true
    }

    fn query(&mut self) -> Result<(), ControllerFailure> {
        let answers_mps2 = self
            .mapped
            .accelerations_mps2(&self.row, 1, &mut self.workspace);
        let lowest_mps2 = self.mapped.mapping.output.low_mps2;
        self.set_command(answers_mps2.first().copied().unwrap_or(lowest_mps2))
    }

    fn shares_batch_with(&self, other: &dyn BatchQuery) -> bool {
        other
            .downcast_ref::<Self>()
            .is_some_and(|other| Arc::ptr_eq(&self.mapped, &other.mapped))
    }

    /// Evaluates one matrix product for all members.
    fn query_batch(&self, members: &[&dyn BatchQuery]) -> Option<Vec<f64>> {
        let mut rows = Vec::with_capacity(members.len() * self.row.len());
        for member in members {
            rows.extend_from_slice(&member.downcast_ref::<Self>()?.row);
        }
        let mut space = Workspace::default();
        Some(
            self.mapped
                .accelerations_mps2(&rows, members.len(), &mut space),
        )
    }

    fn set_command(&mut self, answer_mps2: f64) -> Result<(), ControllerFailure> {
        self.command_mps2 = answer_mps2;
        Ok(())
    }

    fn command_mps2(&self) -> f64 {
        self.command_mps2
    }
}

impl Controller for NetworkDriver {
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        decide_by_query(self, observation)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.replaced_mps2 = Some(command_mps2);
    }

    fn as_batch_query(&mut self) -> Option<&mut dyn BatchQuery> {
        Some(self)
    }
}
