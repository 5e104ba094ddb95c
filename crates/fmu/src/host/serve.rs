//! Protocol of controllers, version 1: each line of JSON is answered by one line.

use std::fs::File;
use std::io::{self, BufRead, Write};
use std::path::Path;

use serde::Deserialize;

use super::instance::{FmuOutputs, Instance, VariableMap};

const MAX_LINE_BYTES: u64 = 1 << 20;

/// Request of crumple to a controller without batches.
#[derive(Deserialize)]
#[serde(untagged)]
enum HostRequest {
    Hello {
        /// Version of the protocol.
        crumple: u32,
        hello: HelloBody,
    },
    Reset {
        id: u64,
        #[serde(rename = "reset")]
        _reset: serde::de::IgnoredAny,
    },
    Decide {
        id: u64,
        time_s: f64,
        #[serde(rename = "see")]
        inputs: Vec<f64>,
    },
}

#[derive(Deserialize)]
struct HelloBody {
    step_s: f64,
    inputs: Vec<String>,
    history: usize,
}

/// Answers requests from standard input until its end.
pub(super) fn serve(fmu: &Path, wiring: &VariableMap) -> Result<(), String> {
    let mut answers = redirect_stdout().map_err(describe_io_error)?;
    let name = fmu.file_name().unwrap_or(fmu.as_os_str()).to_string_lossy();
    let mut host = FmuHost {
        instance: Instance::load(fmu, wiring)?,
        wiring,
        name: name.into(),
        interval_s: None,
    };
    let mut requests = io::stdin().lock();
    let mut line = String::new();
    loop {
        line.clear();
        let bytes = io::Read::take(&mut requests, MAX_LINE_BYTES)
            .read_line(&mut line)
            .map_err(describe_io_error)?;
        if bytes == 0 {
            return Ok(());
        }
        let answer = host.answer(&line)?;
        answers
            .write_all(answer.as_bytes())
            .and_then(|()| answers.flush())
            .map_err(describe_io_error)?;
    }
}

fn describe_io_error(error: io::Error) -> String {
    format!("standard input or output: {error}")
}

/// An FMU that answers requests.
struct FmuHost<'a> {
    instance: Instance,
    wiring: &'a VariableMap,
    name: serde_json::Value,
    /// Time between decisions, in seconds; none before the request `hello`.
    interval_s: Option<f64>,
}

impl FmuHost<'_> {
    /// Returns the line that answers a request.
    fn answer(&mut self, line: &str) -> Result<String, String> {
        let request = serde_json::from_str(line)
            .map_err(|error| format!("{error} in {}", line.trim_end()))?;
        match request {
            HostRequest::Hello { crumple, hello } => self
                .greet(crumple, &hello)
                .ok_or_else(|| format!("does not support the request {}", line.trim_end())),
            HostRequest::Reset { id, .. } => {
                self.instance.start_run()?;
                Ok(format!("{{\"id\":{id},\"ready\":true}}\n"))
            }
            HostRequest::Decide { id, time_s, inputs } => {
                let outputs = self.decide(time_s, &inputs)?;
                let answer = serde_json::Number::from_f64(outputs.answer);
                let answer = answer.ok_or("its output is not finite")?;
                let warning = outputs.is_warning.map_or_else(String::new, |is_warning| {
                    format!(",\"warning\":{is_warning}")
                });
                Ok(format!(
                    "{{\"id\":{id},\"acceleration_mps2\":{answer}{warning}}}\n"
                ))
            }
        }
    }

    /// Returns the answer to a greeting; none if this program does not support the request.
    fn greet(&mut self, version: u32, hello: &HelloBody) -> Option<String> {
        let count = self.wiring.inputs.len();
        if version != 1 || hello.history != 1 || hello.inputs.len() != count {
            return None;
        }
        let own_interval_s = self.wiring.interval_s;
        self.interval_s = Some(own_interval_s.unwrap_or(hello.step_s));
        let stated = own_interval_s.map_or_else(String::new, |interval_s| {
            format!(",\"interval_s\":{interval_s}")
        });
        let warns = match &self.wiring.warning {
            Some(_) => ",\"warns\":true",
            None => "",
        };
        let name = &self.name;
        Some(format!(
            "{{\"crumple\":1,\"name\":{name},\"deterministic\":true,\"inputs\":{count}{stated}{warns}}}\n"
        ))
    }

    /// Returns the outputs for values of the inputs.
    fn decide(&mut self, time_s: f64, inputs: &[f64]) -> Result<FmuOutputs, String> {
        let interval_s = self
            .interval_s
            .ok_or("received a request for a decision before the request `hello`")?;
        let count = self.wiring.inputs.len();
        if inputs.len() != count {
            return Err(format!(
                "received {} values for {count} inputs",
                inputs.len()
            ));
        }
        self.instance.decide(time_s, interval_s, inputs)
    }
}

/// Returns a copy of standard output for the answers. Afterwards standard output is standard error, so that text that
/// the FMU prints cannot corrupt the protocol.
#[cfg(unix)]
fn redirect_stdout() -> io::Result<File> {
    let own = rustix::io::dup(rustix::stdio::stdout())?;
    rustix::stdio::dup2_stdout(rustix::stdio::stderr())?;
    Ok(own.into())
}

/// Returns an error, because controllers that are processes need Unix.
#[cfg(not(unix))]
fn redirect_stdout() -> io::Result<File> {
    Err(io::Error::new(
        io::ErrorKind::Unsupported,
        "controllers that are processes need Unix",
    ))
}
