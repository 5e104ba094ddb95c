//! Controllers as processes of the program `crumple`.

use std::io::{self, BufRead, Write};

use serde_json::{Value, json};

use super::{Controller, ControllerFailure, ControllerSource, Ego};
use crate::observation::{Neighbour, Observation};

/// Reason why a controller cannot answer as a process.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServingError {
    /// A pipe to crumple failed.
    #[error(transparent)]
    Pipe(#[from] io::Error),
    /// A line is not a message of the protocol.
    #[error("not a message of crumple: {0}")]
    Message(String),
    /// The controller failed.
    #[error(transparent)]
    Controller(#[from] ControllerFailure),
}

/// Drives vehicles as a process of `crumple`, until standard input ends. A program with this call is a controller of
/// every command: `crumple falsify --controller exec:target/release/my-controller`.
///
/// The controller file of the process must state the default inputs, without offsets, scales and history.
///
/// ```no_run
/// use crumple_sim::control::{ServingError, serve, stateless};
///
/// fn main() -> Result<(), ServingError> {
///     serve("my-controller", &*stateless(|seen| seen.ahead.map_or(0.0, |ahead| ahead.speed_mps - seen.speed_mps)))
/// }
/// ```
///
/// # Errors
/// [`ServingError`], which ends the process and is a failure of the controller.
pub fn serve(name: &str, source: &dyn ControllerSource) -> Result<(), ServingError> {
    serve_lines(name, source, io::stdin().lock(), &mut io::stdout().lock())
}

fn serve_lines(
    name: &str,
    source: &dyn ControllerSource,
    queries: impl BufRead,
    answers: &mut impl Write,
) -> Result<(), ServingError> {
    let mut vehicle = Value::Null;
    let mut step_s = Value::Null;
    let mut names = Vec::new();
    let mut controller: Option<Box<dyn Controller>> = None;
    for line in queries.lines() {
        let line = line?;
        let wrong = || ServingError::Message(line.clone());
        let mut query: Value = serde_json::from_str(&line).map_err(|_| wrong())?;
        let id = query["id"].take();
        let answer = if let Some(hello) = query.get_mut("hello") {
            (vehicle, step_s) = (hello["vehicle"].take(), hello["step_s"].take());
            names = serde_json::from_value(hello["inputs"].take()).map_err(|_| wrong())?;
            let hello =
                json!({"crumple": 1, "name": name, "deterministic": true, "inputs": names.len()});
            with_interval(hello, source.interval_s())
        } else if let Some(seed) = query["reset"]["seed"].as_u64() {
            let number = |field: &str| vehicle[field].as_f64().ok_or_else(wrong);
            let ego = Ego {
                vehicle: vehicle["index"].as_u64().ok_or_else(wrong)? as usize,
                max_brake_mps2: number("max_brake_mps2")?,
                max_accel_mps2: number("max_accel_mps2")?,
                length_m: number("length_m")?,
                step_s: step_s.as_f64().ok_or_else(wrong)?,
            };
            controller = Some(source.start(&ego, seed)?);
            json!({"id": id, "ready": true})
        } else {
            let see: Vec<f64> = serde_json::from_value(query["see"].take()).map_err(|_| wrong())?;
            let seen = observation(&names, &see).ok_or_else(wrong)?;
            let command_mps2 = controller.as_mut().ok_or_else(wrong)?.decide(&seen)?;
            json!({"id": id, "acceleration_mps2": command_mps2})
        };
        writeln!(answers, "{answer}")?;
        answers.flush()?;
    }
    Ok(())
}

fn with_interval(mut hello: Value, interval_s: Option<f64>) -> Value {
    if let Some(interval_s) = interval_s {
        hello["interval_s"] = interval_s.into();
    }
    hello
}

/// Returns the observation of the default inputs; `None` if one is missing.
fn observation(names: &[String], see: &[f64]) -> Option<Observation> {
    let quantity = |name: &str| {
        see.get(names.iter().position(|known| known == name)?)
            .copied()
    };
    let speed_mps = quantity("speed_mps")?;
    let neighbour = |side: &str| {
        Some(Neighbour {
            gap_m: quantity(&format!("gap_{side}_m"))?,
            speed_mps: speed_mps + quantity(&format!("relative_speed_{side}_mps"))?,
            acceleration_mps2: quantity(&format!("acceleration_{side}_mps2"))?,
        })
    };
    let [ahead, behind] =
        ["ahead", "behind"].map(|side| (quantity(&format!("is_{side}")), neighbour(side)));
    Some(Observation {
        speed_mps,
        acceleration_mps2: quantity("acceleration_mps2")?,
        ahead: if ahead.0? == 0.0 {
            None
        } else {
            Some(ahead.1?)
        },
        behind: if behind.0? == 0.0 {
            None
        } else {
            Some(behind.1?)
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::stateless;

    const HELLO: &str = r#"{"crumple":1,"hello":{"vehicle":{"index":1,"max_brake_mps2":7.5,"max_accel_mps2":3.0,
        "length_m":2.0},"step_s":0.01,"inputs":["gap_ahead_m","relative_speed_ahead_mps","acceleration_ahead_mps2",
        "speed_mps","acceleration_mps2","gap_behind_m","relative_speed_behind_mps","acceleration_behind_mps2",
        "is_ahead","is_behind"],"history":1}}"#;

    fn answers(queries: &[&str]) -> Result<Vec<String>, ServingError> {
        let controller = stateless(|seen| {
            let ahead = seen.ahead.map_or(-1.0, |ahead| ahead.speed_mps);
            ahead + 100.0 * seen.behind.map_or(-1.0, |behind| behind.gap_m)
        });
        let hello = HELLO.replace('\n', "");
        let lines: String = std::iter::once(&*hello)
            .chain(queries.iter().copied())
            .map(|line| format!("{line}\n"))
            .collect();
        let mut text = Vec::new();
        serve_lines("mine", &*controller, lines.as_bytes(), &mut text)?;
        Ok(String::from_utf8_lossy(&text)
            .lines()
            .map(str::to_owned)
            .collect())
    }

    #[test]
    fn answers_with_the_commands_of_the_controller() {
        let reset = r#"{"id":7,"reset":{"seed":3}}"#;
        let both = r#"{"id":8,"time_s":0.0,"see":[20.0,-2.0,0.0,12.0,0.0,9.0,1.0,0.0,1.0,1.0]}"#;
        let alone = r#"{"id":9,"time_s":0.1,"see":[80.0,0.0,0.0,12.0,0.0,80.0,0.0,0.0,0.0,0.0]}"#;
        let answered = answers(&[reset, both, alone]).unwrap();
        assert!(
            answered[0].contains(r#""name":"mine""#) && answered[1].contains(r#""ready":true"#),
            "{answered:?}"
        );
        assert!(
            answered[2].contains(r#""acceleration_mps2":910.0"#),
            "{answered:?}"
        );
        assert!(
            answered[3].contains(r#""acceleration_mps2":-101.0"#)
                && answered[3].contains(r#""id":9"#),
            "{answered:?}"
        );
        for wrong in [
            "",
            "{}",
            r#"{"id":1,"reset":{}}"#,
            r#"{"id":1,"time_s":0,"see":[1.0]}"#,
        ] {
            assert!(
                matches!(answers(&[reset, wrong]), Err(ServingError::Message(_))),
                "{wrong}"
            );
        }
        assert!(
            matches!(answers(&[both]), Err(ServingError::Message(_))),
            "before a reset"
        );
    }
}
