//! A program with pipes, and a watchman that outlives crumple.
//!
//! Each program runs in the process group of a shell that does nothing but wait for the end of its input, and then ends the group.
//! The other end of that input is held by crumple alone and closed by the system when crumple ends, however it ends: so neither the
//! program nor what it started stays behind. That is so from its first instant, since it is started into the group. What leaves
//! the group of its own will (`setsid`) is not followed.

use std::io::{ErrorKind, Read as _, Write as _};
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::ioctl_fionbio;
use rustix::process::{Pid, Signal, kill_process_group};

use super::ProcessProblem;
use super::stderr_tail::StderrTail;

/// Most bytes of a line.
const MAX_LINE_BYTES: usize = 1 << 20;

/// Bytes that are read at once.
const READ_BYTES: usize = 64 << 10;

/// Time for a program that closed its output to have an exit code.
const EXIT_CODE_TIMEOUT: Duration = Duration::from_millis(200);

/// Time for a program whose input has ended to end by itself. The host of an FMU removes what it unpacked in that time.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Ends its process group, itself included, at the end of its input.
const WATCHDOG_SCRIPT: &str = "trap '' HUP INT QUIT TERM; read -r _; kill -s KILL 0";

/// Held while pipes are made and handed to a process: where a system does that in two steps, another process could inherit them.
static SPAWN_LOCK: Mutex<()> = Mutex::new(());

/// A program that runs.
pub(crate) struct ChildProcess {
    child: Child,
    stdin: Option<ChildStdin>,
    stdout: ChildStdout,
    stderr: Option<ChildStderr>,
    received: Vec<u8>,
    /// Bytes at their beginning that were handed on as a line.
    consumed: usize,
    chunk: Box<[u8]>,
    stderr_tail: StderrTail,
    group: ProcessGroup,
}

/// A process group with its watchman. The group's number is its own as long as the watchman is not waited for.
struct ProcessGroup {
    watchdog: Child,
    /// Held so that the watchman's input ends with crumple.
    _lifeline: Option<ChildStdin>,
}

impl ProcessGroup {
    fn start() -> std::io::Result<Self> {
        let mut shell = Command::new("/bin/sh");
        // Its name in lists of processes says whose it is.
        shell.args(["-c", WATCHDOG_SCRIPT, &format!("crumple-watchman-{}", std::process::id())]).process_group(0);
        let mut watchman = shell.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
        let lifeline = watchman.stdin.take();
        Ok(Self { watchdog: watchman, _lifeline: lifeline })
    }
}

impl Drop for ProcessGroup {
    fn drop(&mut self) {
        // Fails only where nobody of the group is left.
        let _ = kill_process_group(Pid::from_child(&self.watchdog), Signal::KILL);
        let _ = self.watchdog.wait();
    }
}

impl ChildProcess {
    /// Starts a program in a folder: the first of the words, unless it is said where it lies.
    pub(crate) fn start(words: &[String], found: Option<&Path>, folder: &Path) -> Result<Self, ProcessProblem> {
        let failed = |error: std::io::Error| ProcessProblem::NotStarted { reason: error.to_string() };
        let missing = || ProcessProblem::NotStarted { reason: "there is no command".to_owned() };
        let (program, arguments) = words.split_first().ok_or_else(missing)?;
        let starting = SPAWN_LOCK.lock().unwrap_or_else(PoisonError::into_inner);
        let group = ProcessGroup::start().map_err(failed)?;
        let mut command = match found {
            Some(found) => Command::new(found),
            // Otherwise it would depend on the system which folder it starts from.
            None if program.contains('/') => Command::new(std::path::absolute(folder.join(program)).map_err(failed)?),
            None => Command::new(program),
        };
        command.args(arguments).process_group(group.watchdog.id() as i32);
        if folder != Path::new("") {
            command.current_dir(folder);
        }
        let pipes = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = pipes.spawn().map_err(failed)?;
        drop(starting);
        let (Some(input), Some(output), Some(error)) = (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(missing());
        };
        let program = Self {
            child,
            stdin: Some(input),
            stdout: output,
            stderr: Some(error),
            received: Vec::new(),
            consumed: 0,
            chunk: vec![0; READ_BYTES].into(),
            stderr_tail: StderrTail::default(),
            group,
        };
        program.set_nonblocking().map_err(|error| failed(error.into()))?;
        Ok(program)
    }

    /// Only crumple's ends: the program's own block as programs expect.
    fn set_nonblocking(&self) -> rustix::io::Result<()> {
        self.stdin.as_ref().map_or(Ok(()), |input| ioctl_fionbio(input, true))?;
        self.stderr.as_ref().map_or(Ok(()), |error| ioctl_fionbio(error, true))?;
        ioctl_fionbio(&self.stdout, true)
    }

    /// Writes a line, which ends in a line feed, and waits for the line that answers it.
    pub(crate) fn query(&mut self, request: &[u8], within: Duration) -> Result<&[u8], ProcessProblem> {
        let end = Instant::now() + within;
        self.received.drain(..self.consumed);
        self.consumed = 0;
        let (mut rest, mut searched) = (request, 0);
        loop {
            // What it wrote too much before is its answer now, whenever it came: so the outcome is no matter of time.
            if rest.is_empty() {
                let new = self.received.get(searched..).unwrap_or_default();
                if let Some(length) = new.iter().position(|byte| *byte == b'\n') {
                    self.consumed = searched + length + 1;
                    return Ok(self.received.get(..self.consumed).unwrap_or_default());
                }
                searched = self.received.len();
            }
            if self.received.len() > MAX_LINE_BYTES {
                return Err(ProcessProblem::TooLong { limit_bytes: MAX_LINE_BYTES });
            }
            if let (false, Some(input)) = (rest.is_empty(), &mut self.stdin) {
                match input.write(rest) {
                    Ok(written) => rest = rest.get(written..).unwrap_or_default(),
                    Err(error) if is_retryable(error.kind()) => {}
                    Err(_) => return Err(self.exit_problem()),
                }
            }
            self.poll_pipes(!rest.is_empty(), end, within)?;
        }
    }

    /// Waits until there is something to read, or to write if that is wanted, and reads it.
    fn poll_pipes(&mut self, wants_to_write: bool, end: Instant, within: Duration) -> Result<(), ProcessProblem> {
        let Some(left) = end.checked_duration_since(Instant::now()) else { return Err(self.timeout_problem(within)) };
        // What does not count is the output once more.
        let input = match &self.stdin {
            Some(input) if wants_to_write => PollFd::new(input, PollFlags::OUT),
            _ => PollFd::new(&self.stdout, PollFlags::IN),
        };
        let error = match &self.stderr {
            Some(error) => PollFd::new(error, PollFlags::IN),
            None => PollFd::new(&self.stdout, PollFlags::IN),
        };
        let mut pipes = [PollFd::new(&self.stdout, PollFlags::IN), error, input];
        let left = Timespec { tv_sec: left.as_secs() as i64, tv_nsec: left.subsec_nanos().into() };
        match poll(&mut pipes, Some(&left)) {
            Ok(0) => return Err(self.timeout_problem(within)),
            Ok(_) | Err(rustix::io::Errno::INTR) => {}
            Err(_) => return Err(ProcessProblem::Closed),
        }
        let [output, error, _] = pipes.map(|pipe| !pipe.revents().is_empty());
        if error {
            self.read_stderr();
        }
        if output {
            match self.stdout.read(&mut self.chunk) {
                Ok(0) => return Err(self.exit_problem()),
                Ok(read) => self.received.extend_from_slice(self.chunk.get(..read).unwrap_or_default()),
                Err(error) if is_retryable(error.kind()) => {}
                Err(_) => return Err(self.exit_problem()),
            }
        }
        Ok(())
    }

    /// Reads once from standard error; whether there was something.
    fn read_stderr(&mut self) -> bool {
        let Some(error) = &mut self.stderr else { return false };
        match error.read(&mut self.chunk) {
            Ok(read) if read > 0 => {
                self.stderr_tail.push(self.chunk.get(..read).unwrap_or_default());
                return true;
            }
            Err(error) if is_retryable(error.kind()) => {}
            Ok(_) | Err(_) => self.stderr = None,
        }
        false
    }

    /// Why no answer came. What a program started may hold its output open when it has ended.
    fn timeout_problem(&mut self, within: Duration) -> ProcessProblem {
        match self.child.try_wait() {
            Ok(Some(status)) => ProcessProblem::Ended { status: describe_exit(status) },
            _ => ProcessProblem::Timeout { limit_s: within.as_secs_f64() },
        }
    }

    /// How a program ended that no longer reads or writes.
    fn exit_problem(&mut self) -> ProcessProblem {
        let end = Instant::now() + EXIT_CODE_TIMEOUT;
        while Instant::now() < end {
            match self.child.try_wait() {
                Ok(Some(status)) => return ProcessProblem::Ended { status: describe_exit(status) },
                Ok(None) => thread::sleep(Duration::from_millis(1)),
                Err(_) => break,
            }
        }
        ProcessProblem::Closed
    }

    /// Forgets what was said on standard error until now.
    pub(crate) fn clear_stderr(&mut self) {
        self.drain_stderr();
        self.stderr_tail.clear();
    }

    /// Lets the program know that it may end.
    pub(crate) fn close_stdin(&mut self) {
        self.stdin = None;
    }

    /// Ends it and all that it started at once; what it said last.
    pub(crate) fn terminate(mut self) -> Vec<String> {
        self.kill();
        self.drain_stderr();
        self.stderr_tail.lines()
    }

    /// Reads what there is on standard error. There may be no end of it.
    fn drain_stderr(&mut self) {
        let most = 2 * MAX_LINE_BYTES / READ_BYTES;
        let _ = (0..most).take_while(|_| self.read_stderr()).count();
    }

    fn kill(&mut self) {
        let _ = kill_process_group(Pid::from_child(&self.group.watchdog), Signal::KILL);
        // It may have left the group.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Lets it end by itself for a moment, and then ends it and all that it started. Returns what it said before.
    pub(crate) fn shut_down(mut self) -> Vec<String> {
        self.drain_stderr();
        self.stderr_tail.lines()
    }

    /// Waits for its end for a moment.
    fn wait_for_exit(&mut self) {
        self.close_stdin();
        let end = Instant::now() + SHUTDOWN_TIMEOUT;
        while self.poll_pipes(false, end, SHUTDOWN_TIMEOUT).is_ok() {
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

fn is_retryable(kind: ErrorKind) -> bool {
    matches!(kind, ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

fn describe_exit(status: ExitStatus) -> String {
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("itself with exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => status.to_string(),
    }
}
