//! A child process with pipes, and a watchdog that outlives crumple.
//!
//! Each program runs in the process group of a shell that waits for the end of its input and then kills the group. Only
//! crumple holds the other end of that input. The system closes it when crumple ends for any reason, so neither the
//! program nor its children remain. Processes that leave the group (`setsid`) are not followed.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::ioctl_fionbio;
use rustix::process::{Pid, Signal, kill_process_group};

use crate::stderr_tail::StderrTail;
use crumple_sim::control::ProcessProblem;

const MAX_LINE_BYTES: usize = 1 << 20;

const READ_BYTES: usize = 64 << 10;

/// Time to wait for the exit code of a program that has closed its output. After that the error is
/// [`ProcessProblem::Closed`].
const EXIT_CODE_TIMEOUT: Duration = Duration::from_millis(200);

/// Time to exit after stdin is closed. The host of an FMU removes its unpacked files in that time.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Kills its own process group at the end of its input.
const WATCHDOG_SCRIPT: &str = "trap '' HUP INT QUIT TERM; read -r _; kill -s KILL 0";

/// Lock for pipe creation and spawn: on systems where these are two steps, another child could inherit the pipes.
static SPAWN_LOCK: Mutex<()> = Mutex::new(());

pub(crate) struct ChildProcess {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: ChildStdout,
    stderr: Option<ChildStderr>,
    received: Vec<u8>,
    /// Number of received bytes that were returned as lines.
    consumed: usize,
    chunk: Box<[u8]>,
    stderr_tail: StderrTail,
    group: ProcessGroup,
}

/// A process group with its watchdog. The group id stays reserved until the watchdog is waited for.
struct ProcessGroup {
    watchdog: Child,
    /// Pipe that ends the watchdog's input when crumple ends.
    _lifeline: Option<ChildStdin>,
}

impl ProcessGroup {
    fn start() -> std::io::Result<Self> {
        let mut shell = Command::new("/bin/sh");
        // The name identifies the owner in process lists.
        shell
            .args([
                "-c",
                WATCHDOG_SCRIPT,
                &format!("crumple-watchdog-{}", std::process::id()),
            ])
            .process_group(0);
        let mut watchdog = shell
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        let lifeline = watchdog.stdin.take();
        Ok(Self {
            watchdog,
            _lifeline: lifeline,
        })
    }
}

impl Drop for ProcessGroup {
    fn drop(&mut self) {
        // Fails only if the group is empty.
        let _ = kill_process_group(Pid::from_child(&self.watchdog), Signal::KILL);
        let _ = self.watchdog.wait();
    }
}

impl ChildProcess {
    /// Starts a program in `folder`. `program` is its path, if it differs from the first of `words`.
    pub(crate) fn start(
        words: &[String],
        program: Option<&Path>,
        folder: &Path,
    ) -> Result<Self, ProcessProblem> {
        let [name, arguments @ ..] = words else {
            return Err(missing_command());
        };
        let spawn_lock = SPAWN_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
        let group = ProcessGroup::start().map_err(start_problem)?;
        let path = match program {
            Some(program) => program.to_owned(),
            // Relative paths would otherwise be resolved against a system-dependent folder.
            None if name.contains('/') => {
                std::path::absolute(folder.join(name)).map_err(start_problem)?
            }
            None => PathBuf::from(name),
        };
        let mut command = Command::new(path);
        command
            .args(arguments)
            .process_group(group.watchdog.id() as i32);
        if folder != Path::new("") {
            command.current_dir(folder);
        }
        let pipes = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let child = pipes.spawn().map_err(start_problem)?;
        drop(spawn_lock);
        Self::new(child, group)
    }

    /// Takes the pipes of a child.
    fn new(mut child: Child, group: ProcessGroup) -> Result<Self, ProcessProblem> {
        let process = Self {
            stdin: child.stdin.take(),
            stdout: child.stdout.take().ok_or_else(missing_command)?,
            stderr: child.stderr.take(),
            child,
            received: Vec::new(),
            consumed: 0,
            chunk: vec![0; READ_BYTES].into(),
            stderr_tail: StderrTail::default(),
            group,
        };
        process
            .set_nonblocking()
            .map_err(|error| start_problem(error.into()))?;
        Ok(process)
    }

    /// Makes crumple's ends of the pipes non-blocking; the program's own ends block.
    fn set_nonblocking(&self) -> rustix::io::Result<()> {
        self.stdin
            .as_ref()
            .map_or(Ok(()), |input| ioctl_fionbio(input, true))?;
        self.stderr
            .as_ref()
            .map_or(Ok(()), |error| ioctl_fionbio(error, true))?;
        ioctl_fionbio(&self.stdout, true)
    }

    /// Writes a line, which must end in a line feed, and waits for the reply.
    pub(crate) fn query(
        &mut self,
        request: &[u8],
        timeout: Duration,
    ) -> Result<&[u8], ProcessProblem> {
        let deadline = Instant::now() + timeout;
        self.received.drain(..self.consumed);
        self.consumed = 0;
        let mut rest = request;
        let mut searched = 0;
        loop {
            // A line that the program wrote too early counts as this reply. Whether it arrives before or after the
            // query depends on timing; the result must not.
            if rest.is_empty() {
                let new = self.received.get(searched..).unwrap_or_default();
                if let Some(length) = new.iter().position(|byte| *byte == b'\n') {
                    self.consumed = searched + length + 1;
                    return Ok(self.received.get(..self.consumed).unwrap_or_default());
                }
                searched = self.received.len();
            }
            if self.received.len() > MAX_LINE_BYTES {
                return Err(ProcessProblem::TooLong {
                    limit_bytes: MAX_LINE_BYTES,
                });
            }
            if let (false, Some(input)) = (rest.is_empty(), &mut self.stdin) {
                match input.write(rest) {
                    Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                    Err(error) if is_retryable(error.kind()) => {}
                    Err(_) => return Err(self.exit_problem()),
                }
            }
            self.poll_pipes(!rest.is_empty(), deadline, timeout)?;
        }
    }

    /// Waits until the process has output, or accepts input if `wants_to_write`, and reads the output.
    fn poll_pipes(
        &mut self,
        wants_to_write: bool,
        deadline: Instant,
        timeout: Duration,
    ) -> Result<(), ProcessProblem> {
        let Some(left) = deadline.checked_duration_since(Instant::now()) else {
            return Err(self.timeout_problem(timeout));
        };
        // The number of polled pipes is fixed: if nothing is to be written, stdout takes the place of stdin.
        let input = match &self.stdin {
            Some(input) if wants_to_write => PollFd::new(input, PollFlags::OUT),
            _ => PollFd::new(&self.stdout, PollFlags::IN),
        };
        let error = match &self.stderr {
            Some(error) => PollFd::new(error, PollFlags::IN),
            None => PollFd::new(&self.stdout, PollFlags::IN),
        };
        let mut pipes = [PollFd::new(&self.stdout, PollFlags::IN), error, input];
        let left = Timespec {
            tv_sec: left.as_secs() as i64,
            tv_nsec: left.subsec_nanos().into(),
        };
        match poll(&mut pipes, Some(&left)) {
            Ok(0) => return Err(self.timeout_problem(timeout)),
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(_) => return Err(ProcessProblem::Closed),
        }
        let [has_output, has_error, _] = pipes.map(|pipe| !pipe.revents().is_empty());
        if has_error {
            self.read_stderr();
        }
        if has_output {
            self.read_stdout()?;
        }
        Ok(())
    }

    /// Reads once from standard output.
    fn read_stdout(&mut self) -> Result<(), ProcessProblem> {
        match self.stdout.read(&mut self.chunk) {
            Ok(0) => return Err(self.exit_problem()),
            Ok(length) => self
                .received
                .extend_from_slice(self.chunk.get(..length).unwrap_or_default()),
            Err(error) if is_retryable(error.kind()) => {}
            Err(_) => return Err(self.exit_problem()),
        }
        Ok(())
    }

    /// Reads once from standard error; returns true if there was output.
    fn read_stderr(&mut self) -> bool {
        let Some(error) = &mut self.stderr else {
            return false;
        };
        match error.read(&mut self.chunk) {
            Ok(read) if read > 0 => {
                self.stderr_tail
                    .push(self.chunk.get(..read).unwrap_or_default());
                return true;
            }
            Err(error) if is_retryable(error.kind()) => {}
            Ok(_) | Err(_) => self.stderr = None,
        }
        false
    }

    /// Returns the reason of a missing reply. Children may keep the output open after the program ended.
    fn timeout_problem(&mut self, timeout: Duration) -> ProcessProblem {
        match self.child.try_wait() {
            Ok(Some(status)) => ProcessProblem::Ended {
                status: describe_exit(status),
            },
            _ => ProcessProblem::Timeout {
                limit_s: timeout.as_secs_f64(),
            },
        }
    }

    /// Returns the error for a program that closed its pipes.
    fn exit_problem(&mut self) -> ProcessProblem {
        let deadline = Instant::now() + EXIT_CODE_TIMEOUT;
        while Instant::now() < deadline {
            match self.child.try_wait() {
                Ok(Some(status)) => {
                    return ProcessProblem::Ended {
                        status: describe_exit(status),
                    };
                }
                Ok(None) => thread::sleep(Duration::from_millis(1)),
                Err(_) => break,
            }
        }
        ProcessProblem::Closed
    }

    pub(crate) fn clear_stderr(&mut self) {
        self.drain_stderr();
        self.stderr_tail.clear();
    }

    pub(crate) fn close_stdin(&mut self) {
        self.stdin = None;
    }

    /// Kills the process group; returns the last lines of standard error.
    pub(crate) fn terminate(mut self) -> Vec<String> {
        self.kill();
        self.drain_stderr();
        self.stderr_tail.lines()
    }

    /// Reads pending standard error. The loop is bounded: the output may be endless.
    fn drain_stderr(&mut self) {
        let max_reads = 2 * MAX_LINE_BYTES / READ_BYTES;
        let _ = (0..max_reads).take_while(|_| self.read_stderr()).count();
    }

    fn kill(&mut self) {
        let _ = kill_process_group(Pid::from_child(&self.group.watchdog), Signal::KILL);
        // The program may have left the group.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Closes stdin, waits briefly and kills the process group. Returns the last lines of standard error.
    pub(crate) fn shut_down(mut self) -> Vec<String> {
        self.drain_stderr();
        self.stderr_tail.lines()
    }

    /// Waits up to `SHUTDOWN_TIMEOUT` for the end of the process.
    fn wait_for_exit(&mut self) {
        self.close_stdin();
        let deadline = Instant::now() + SHUTDOWN_TIMEOUT;
        while self.poll_pipes(false, deadline, SHUTDOWN_TIMEOUT).is_ok() {
            self.received.clear();
        }
    }
}

impl Drop for ChildProcess {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.wait_for_exit();
        }
        self.kill();
    }
}

fn start_problem(error: std::io::Error) -> ProcessProblem {
    ProcessProblem::NotStarted {
        reason: error.to_string(),
    }
}

fn missing_command() -> ProcessProblem {
    ProcessProblem::NotStarted {
        reason: "there is no command".to_owned(),
    }
}

fn is_retryable(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

fn describe_exit(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => status.to_string(),
    }
}
