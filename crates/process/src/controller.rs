//! Controller processes: their setup, their identity, and the pool of idle processes.

mod driver;
mod portable;

use std::fmt;
use std::io::{self, Read as _};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crumple_core::digest::{Sha256, sha256};
use crumple_core::quoting::ShellWord;
use crumple_core::regular_file;
use crumple_networks::{InputMapping, InvalidMapping, Mapping};
use crumple_sim::control::{
    Controller, ControllerFailure, ControllerSource, Ego, ProcessFailure, ProcessProblem,
    SourceFile, escaped_excerpt,
};
use crumple_sim::random::{self, Purpose};
use rand::Rng as _;
use serde::Serialize;

use self::driver::ProcessDriver;
use super::child::ChildProcess;
use super::permission::StartPermission;
use super::protocol::{
    self, ExpectedReply, HelloParams, HelloReply, HelloRequest, VERSION, VehicleParams,
};
use super::setup::ProcessSetup;

const MAX_FILE_BYTES: u64 = 1 << 30;

/// Maximum number of consecutive failed starts, and of all starts.
const MAX_FAILED_STARTS: u32 = 3;
const MAX_STARTS: u32 = 10_000;

/// Determinism check. Per vehicle the first `ALWAYS_CHECKED_RUNS` runs send every query twice. Run n later is checked
/// with probability `CHECKED_RUNS_PER_TWO_DOUBLINGS` / next_power_of_two(n).
const ALWAYS_CHECKED_RUNS: u64 = 2;
const CHECKED_RUNS_PER_TWO_DOUBLINGS: u64 = 3;

/// Vehicle of a handshake without a run.
const TRIAL_EGO: Ego = Ego {
    vehicle: 1,
    max_brake_mps2: 7.5,
    max_accel_mps2: 3.0,
    length_m: 2.0,
    step_s: 0.01,
};

#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
struct ListedFile {
    path: String,
    sha256: String,
    #[serde(skip)]
    bytes: u64,
}

/// A controller that is a process. Clones share the processes.
///
/// A run starts a process if none is idle; idle processes wait for the next run and end with the last clone.
/// There is one process per driven vehicle of the current runs, or one per thread if processes answer in batches.
#[derive(Clone)]
pub struct ProcessController(Arc<ProcessPool>);

/// The processes of a controller.
struct ProcessPool {
    setup: ProcessSetup,
    files: Vec<ListedFile>,
    identity: Option<String>,
    state: Mutex<ProcessPoolState>,
}

#[derive(Default)]
struct ProcessPoolState {
    idle: Vec<ConnectedProcess>,
    /// Handshake of the first process.
    greeting: Option<HelloReply>,
    refusal: Option<ControllerFailure>,
    starts: u32,
    consecutive_failures: u32,
    runs: Vec<(usize, VehicleRunCounts)>,
}

/// Numbers of runs of a vehicle. State that a reset does not clear shows only in reused processes.
#[derive(Default)]
struct VehicleRunCounts {
    fresh: u64,
    reused: u64,
}

/// A process after its handshake.
struct ConnectedProcess {
    program: ChildProcess,
    hello: Arc<[u8]>,
    greeting: HelloReply,
    /// Queries since the first handshake.
    question_count: u64,
}

/// Returns the SHA-256 of command, mapping and files; `None` without files or for a nondeterministic process.
fn identity(setup: &ProcessSetup, files: &[ListedFile]) -> Result<Option<String>, InvalidMapping> {
    #[derive(Serialize)]
    struct Identity<'a> {
        command: &'a [String],
        files: &'a [ListedFile],
        mapping: &'a Mapping,
        answer_within_s: f64,
    }
    let parts = serde_json::to_string(&Identity {
        command: &setup.command,
        files,
        mapping: &setup.mapping,
        answer_within_s: setup.answer_within_s,
    })
    .map_err(|error| InvalidMapping::new("command", error.to_string()))?;
    let is_known = !files.is_empty() && setup.deterministic;
    Ok(is_known.then(|| sha256(format!("process {parts}"))))
}

impl ConnectedProcess {
    fn next_id(&mut self) -> u64 {
        self.question_count += 1;
        self.question_count
    }

    /// Returns the next number and the promise of the handshake, for a query about a decision.
    fn expect_reply(&mut self) -> ExpectedReply {
        ExpectedReply {
            id: self.next_id(),
            warns: self.greeting.warns,
        }
    }
}

impl ProcessController {
    /// Creates a controller and reads the files of its identity. Only runs start the program.
    ///
    /// # Errors
    /// [`InvalidMapping`] names the first field that is wrong.
    pub fn new(
        mut setup: ProcessSetup,
        _permission: StartPermission,
    ) -> Result<Self, InvalidMapping> {
        setup.check()?;
        // `answer = 0` and no `answer` are equivalent; normalised so that both have the same identity hash.
        setup.mapping.output.answer = Some(0);
        let mut files = Vec::new();
        for (index, path) in setup.files.iter().enumerate() {
            let digest = file_digest(&setup.folder.join(path)).map_err(|error| {
                InvalidMapping::new(format!("files[{index}]"), format!("{path}: {error}"))
            })?;
            files.push(ListedFile {
                path: path.clone(),
                sha256: digest.sha256,
                bytes: digest.bytes,
            });
        }
        Ok(Self(Arc::new(ProcessPool {
            identity: identity(&setup, &files)?,
            setup,
            files,
            state: Mutex::default(),
        })))
    }

    /// Returns true for an FMU, which runs in its own process.
    #[must_use]
    pub fn is_fmu(&self) -> bool {
        self.0.setup.program.is_some()
    }

    /// Returns the setup.
    #[must_use]
    pub fn setup(&self) -> &ProcessSetup {
        &self.0.setup
    }
}

impl ControllerSource for ProcessController {
    /// Returns the SHA-256 of command, mapping and files; `None` without files or for a nondeterministic process.
    fn identity(&self) -> Option<String> {
        self.0.identity.clone()
    }

    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        let driver = ProcessDriver::new(Arc::clone(&self.0), ego, seed)?;
        Ok(Box::new(driver))
    }

    fn holds_answers(&self) -> bool {
        true
    }

    fn interval_s(&self) -> Option<f64> {
        self.setup().mapping.decision_interval_s
    }

    fn description(&self) -> String {
        let kind = if self.is_fmu() { "FMU" } else { "process" };
        if self.is_deterministic() {
            kind.to_owned()
        } else {
            format!(
                "{kind} that is not deterministic: a repeated assessment may have other results"
            )
        }
    }

    fn file(&self) -> Option<&SourceFile> {
        self.setup().file.as_ref()
    }

    fn program_field(&self) -> Option<&'static str> {
        Some(if self.is_fmu() { "fmu" } else { "command" })
    }

    fn is_deterministic(&self) -> bool {
        self.0.is_deterministic()
    }

    fn try_start(&self) -> Result<(), ControllerFailure> {
        self.0.try_start()
    }

    fn refusal(&self) -> Option<ControllerFailure> {
        self.0.state().refusal.clone()
    }

    fn supports_lockstep(&self, ego: &Ego) -> bool {
        self.0.greeting_says(ego, |greeting| greeting.batch)
    }

    fn reports_warnings(&self) -> bool {
        self.0.greeting_says(&TRIAL_EGO, |greeting| greeting.warns)
    }
}

impl ProcessPool {
    /// True unless the controller file or the handshake declares the process nondeterministic.
    fn is_deterministic(&self) -> bool {
        self.setup.deterministic
            && self
                .state()
                .greeting
                .as_ref()
                .is_none_or(|greeting| greeting.deterministic)
    }

    /// Starts a process without a run, completes the handshake, and ends the process.
    ///
    /// # Errors
    /// [`ControllerFailure`] if the start or the handshake fails.
    fn try_start(&self) -> Result<(), ControllerFailure> {
        let process = self.start(&self.hello(&TRIAL_EGO))?;
        // Dropped instead of killed: a killed FMU host would leave its extraction folder behind.
        drop(process);
        Ok(())
    }

    /// Returns a promise of the handshake. Starts a process if that is not known yet; false if it does not start.
    fn greeting_says(&self, ego: &Ego, promise: impl Fn(&HelloReply) -> bool) -> bool {
        if let Some(greeting) = &self.state().greeting {
            return promise(greeting);
        }
        self.acquire(&self.hello(ego)).is_ok_and(|process| {
            let is_promised = promise(&process.greeting);
            self.release(process);
            is_promised
        })
    }

    /// Locks the state. Poisoning is ignored: a panic elsewhere leaves no partial change here.
    fn state(&self) -> MutexGuard<'_, ProcessPoolState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn answer_timeout(&self) -> Duration {
        Duration::from_secs_f64(self.setup.answer_within_s)
    }

    fn hello(&self, ego: &Ego) -> Arc<[u8]> {
        let Mapping {
            history,
            newest_first,
            inputs,
            output,
            ..
        } = &self.setup.mapping;
        let hello = HelloParams {
            vehicle: VehicleParams {
                index: ego.vehicle,
                max_brake_mps2: ego.max_brake_mps2,
                max_accel_mps2: ego.max_accel_mps2,
                length_m: ego.length_m,
            },
            step_s: ego.step_s,
            inputs: inputs.iter().map(InputMapping::name).collect(),
            history: *history,
            newest_first: *newest_first,
            low_mps2: output.low_mps2,
            high_mps2: output.high_mps2,
        };
        let mut line = Vec::new();
        // Writing cannot fail for these numbers and names; the process would reject an incomplete line.
        let _ = protocol::write_line(
            &mut line,
            &HelloRequest {
                crumple: VERSION,
                hello,
            },
        );
        line.into()
    }

    /// Returns a process with the handshake of this vehicle: an idle one, or else a new one.
    fn acquire(&self, hello: &Arc<[u8]>) -> Result<ConnectedProcess, ControllerFailure> {
        match self.take_idle(hello)? {
            Some(process) if process.hello == *hello => Ok(process),
            Some(process) => self.greet(process.program, process.question_count, hello),
            None => self.start(hello),
        }
    }

    /// Takes an idle process, if possible one with the handshake of this vehicle.
    fn take_idle(&self, hello: &Arc<[u8]>) -> Result<Option<ConnectedProcess>, ControllerFailure> {
        let mut state = self.state();
        if let Some(refusal) = &state.refusal {
            return Err(refusal.clone());
        }
        let mut idle = state.idle.iter();
        let index = idle.position(|process| process.hello == *hello);
        Ok(index
            .map(|index| state.idle.swap_remove(index))
            .or_else(|| state.idle.pop()))
    }

    fn start(&self, hello: &Arc<[u8]>) -> Result<ConnectedProcess, ControllerFailure> {
        self.check_start()
            .map_err(|problem| self.refuse(self.end_with_failure(problem, None)))?;
        let ProcessSetup {
            command,
            program,
            folder,
            ..
        } = &self.setup;
        let process = ChildProcess::start(command, program.as_deref(), folder)
            .map_err(|problem| self.end_with_failure(problem, None))
            .and_then(|program| self.greet(program, 0, hello));
        let mut state = self.state();
        match &process {
            Ok(_) => state.consecutive_failures = 0,
            Err(failure) => {
                state.consecutive_failures += 1;
                if state.consecutive_failures == MAX_FAILED_STARTS {
                    state.refusal = Some(failure.clone());
                }
            }
        }
        process
    }

    /// Counts a start, and refuses it after too many starts or after a change of a listed file.
    fn check_start(&self) -> Result<(), ProcessProblem> {
        let mut state = self.state();
        if state.starts == MAX_STARTS {
            return Err(ProcessProblem::TooManyStarts { starts: MAX_STARTS });
        }
        state.starts += 1;
        drop(state);
        for file in &self.files {
            let digest = file_digest(&self.setup.folder.join(&file.path));
            if !digest.is_ok_and(|digest| digest.sha256 == file.sha256) {
                return Err(ProcessProblem::FileChanged {
                    file: escaped_excerpt(&file.path),
                });
            }
        }
        Ok(())
    }

    fn greet(
        &self,
        mut program: ChildProcess,
        question_count: u64,
        hello: &Arc<[u8]>,
    ) -> Result<ConnectedProcess, ControllerFailure> {
        let timeout = Duration::from_secs_f64(self.setup.start_within_s);
        let greeting = program
            .query(hello, timeout)
            .and_then(protocol::parse_hello_reply);
        match greeting.and_then(|greeting| self.check_greeting(greeting)) {
            Ok(greeting) => Ok(ConnectedProcess {
                program,
                hello: Arc::clone(hello),
                greeting,
                question_count,
            }),
            Err(problem) => Err(self.end_with_failure(problem, Some(program))),
        }
    }

    /// Checks the reply of a handshake against the mapping, the identity and the first reply.
    fn check_greeting(&self, greeting: HelloReply) -> Result<HelloReply, ProcessProblem> {
        let shown = self.setup.mapping.width();
        if let Some(wanted) = greeting.inputs.filter(|wanted| *wanted != shown as u64) {
            return Err(ProcessProblem::Inputs { wanted, shown });
        }
        if let Some(interval_s) = greeting.interval_s.filter(|stated_s| *stated_s <= 0.0) {
            let wanted = "a positive time".to_owned();
            return Err(ProcessProblem::Interval { interval_s, wanted });
        }
        if let (Some(interval_s), Some(stated_s)) =
            (greeting.interval_s, self.setup.mapping.decision_interval_s)
            && interval_s != stated_s
        {
            let wanted = format!("the {stated_s} s of its controller file");
            return Err(ProcessProblem::Interval { interval_s, wanted });
        }
        if !greeting.deterministic && self.identity.is_some() {
            return Err(ProcessProblem::UndeclaredNondeterminism);
        }
        let mut state = self.state();
        match &state.greeting {
            Some(first) if *first != greeting => Err(ProcessProblem::HandshakeChanged),
            Some(_) => Ok(greeting),
            None => {
                state.greeting = Some(greeting.clone());
                Ok(greeting)
            }
        }
    }

    fn release(&self, process: ConnectedProcess) {
        self.state().idle.push(process);
    }

    /// Counts a run and selects it for the determinism check by its number and the scenario's seed.
    fn is_selected_for_check(&self, vehicle: usize, reused: bool, seed: u64) -> bool {
        if !self.is_deterministic() {
            return false;
        }
        let mut state = self.state();
        let index = state
            .runs
            .iter()
            .position(|(counted, _)| *counted == vehicle)
            .unwrap_or_else(|| {
                state.runs.push((vehicle, VehicleRunCounts::default()));
                state.runs.len() - 1
            });
        let Some((_, runs)) = state.runs.get_mut(index) else {
            return false;
        };
        let count = if reused {
            &mut runs.reused
        } else {
            &mut runs.fresh
        };
        let number = *count;
        *count += 1;
        if number < ALWAYS_CHECKED_RUNS {
            return true;
        }
        // Nondeterminism of fresh processes shows in the first runs; left-over state of reused ones may show late.
        let random = random::stream(seed, Purpose::DeterminismCheck, number).next_u64();
        reused && random % number.next_power_of_two() < CHECKED_RUNS_PER_TWO_DOUBLINGS
    }

    /// Records a permanent failure: no process is started any more.
    fn refuse(&self, failure: ControllerFailure) -> ControllerFailure {
        self.state().refusal.get_or_insert(failure).clone()
    }

    fn end_with_failure(
        &self,
        problem: ProcessProblem,
        program: Option<ChildProcess>,
    ) -> ControllerFailure {
        // A program that still answers may end by itself, so that an FMU host can remove its extraction folder.
        let stderr_tail = match &problem {
            ProcessProblem::Timeout { .. } | ProcessProblem::TooLong { .. } => {
                program.map(ChildProcess::terminate)
            }
            _ => program.map(ChildProcess::shut_down),
        };
        let greeting = self.state().greeting.clone();
        let name = greeting.map(|greeting| greeting.name);
        ControllerFailure::Process(Box::new(ProcessFailure {
            controller: name.unwrap_or_else(|| self.command_line()),
            problem,
            stderr_tail: stderr_tail.unwrap_or_default(),
        }))
    }

    /// Returns the command as a shell would accept it, shortened.
    fn command_line(&self) -> String {
        let words = self.setup.command.iter();
        let words: Vec<_> = words.map(|word| ShellWord(word).to_string()).collect();
        escaped_excerpt(&words.join(" "))
    }
}

impl fmt::Debug for ProcessController {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("ProcessController")
            .field("setup", &self.0.setup)
            .field("identity", &self.0.identity)
            .finish()
    }
}

impl Drop for ProcessPool {
    fn drop(&mut self) {
        let state = self.state.get_mut().unwrap_or_else(PoisonError::into_inner);
        // Close all stdins first, so that the processes exit concurrently.
        state
            .idle
            .iter_mut()
            .for_each(|process| process.program.close_stdin());
    }
}

/// Digest and size of a file.
struct FileDigest {
    /// SHA-256 in hexadecimal.
    sha256: String,
    bytes: u64,
}

/// Returns the digest of a regular file.
fn file_digest(path: &Path) -> io::Result<FileDigest> {
    let mut file = regular_file::open(path)?.take(MAX_FILE_BYTES + 1);
    let mut digest = Sha256::default();
    let mut chunk = vec![0; 1 << 16];
    let mut bytes = 0;
    loop {
        let read = file.read(&mut chunk)?;
        bytes += read as u64;
        if bytes > MAX_FILE_BYTES {
            let problem = "holds more than 1024 MiB";
            return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
        }
        match chunk.get(..read) {
            Some(new @ [_, ..]) => digest.update(new),
            _ => {
                return Ok(FileDigest {
                    sha256: digest.hexadecimal(),
                    bytes,
                });
            }
        }
    }
}
