//! Protocol of controllers, version 1: each line of JSON is answered by one line.

use std::fs::File;
use std::io::{self, BufRead, Write};
use std::path::Path;

use serde::Deserialize;

use super::instance::{Instance, VariableMap};

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

pub(super) fn serve(fmu: &Path, wiring: &VariableMap) -> Result<(), String> {
    let io_failed = |error: io::Error| format!("standard input or output: {error}");
    let mut answers = redirect_stdout().map_err(io_failed)?;
    let mut instance = Instance::load(fmu, wiring)?;
    let name =
        serde_json::Value::from(fmu.file_name().unwrap_or(fmu.as_os_str()).to_string_lossy());
    let mut interval_s = None;
    let (mut questions, mut line) = (io::stdin().lock(), String::new());
    loop {
        line.clear();
        let read = io::Read::take(&mut questions, MAX_LINE_BYTES)
            .read_line(&mut line)
            .map_err(io_failed)?;
        if read == 0 {
            return Ok(());
        }
        let question = serde_json::from_str(&line)
            .map_err(|error| format!("{error} in {}", line.trim_end()))?;
        let answer = match question {
            HostRequest::Hello { crumple, hello } => {
                let HelloBody {
                    step_s,
                    inputs,
                    history,
                } = hello;
                if crumple != 1 || history != 1 || inputs.len() != wiring.inputs.len() {
                    return Err(format!("does not support the request {}", line.trim_end()));
                }
                interval_s = Some(wiring.interval_s.unwrap_or(step_s));
                let stated = wiring
                    .interval_s
                    .map_or_else(String::new, |own_s| format!(",\"interval_s\":{own_s}"));
                format!(
                    "{{\"crumple\":1,\"name\":{name},\"deterministic\":true,\"inputs\":{}{stated}}}\n",
                    wiring.inputs.len()
                )
            }
            HostRequest::Reset { id, .. } => {
                instance.start_run()?;
                format!("{{\"id\":{id},\"ready\":true}}\n")
            }
            HostRequest::Decide {
                id,
                time_s,
                inputs: see,
            } => {
                let interval_s = interval_s
                    .ok_or("received a request for a decision before the request `hello`")?;
                if see.len() != wiring.inputs.len() {
                    return Err(format!(
                        "received {} values for {} inputs",
                        see.len(),
                        wiring.inputs.len()
                    ));
                }
                let answer = instance.decide(time_s, interval_s, &see)?;
                let answer =
                    serde_json::Number::from_f64(answer).ok_or("its output is not finite")?;
                format!("{{\"id\":{id},\"acceleration_mps2\":{answer}}}\n")
            }
        };
        answers
            .write_all(answer.as_bytes())
            .and_then(|()| answers.flush())
            .map_err(io_failed)?;
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
