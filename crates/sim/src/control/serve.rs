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
///     let match_speed = stateless(|observation| {
///         observation.ahead.map_or(0.0, |ahead| ahead.speed_mps - observation.speed_mps)
///     });
///     serve("my-controller", &*match_speed)
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
    let mut session = Session {
        vehicle: Value::Null,
        step_s: Value::Null,
        inputs: Vec::new(),
        controller: None,
    };
    for line in queries.lines() {
        let line = line?;
        let answer = match serde_json::from_str(&line) {
            Ok(query) => session.answer(name, source, query)?,
            Err(_) => None,
        };
        let answer = answer.ok_or(ServingError::Message(line))?;
        writeln!(answers, "{answer}")?;
        answers.flush()?;
    }
    Ok(())
}

/// State between two messages of crumple.
struct Session {
    vehicle: Value,
    step_s: Value,
    /// Names of the inputs.
    inputs: Vec<String>,
    controller: Option<Box<dyn Controller>>,
}

impl Session {
    /// Returns the answer to a message; `None` if it is not a message of the protocol.
    fn answer(
        &mut self,
        name: &str,
        source: &dyn ControllerSource,
        mut query: Value,
    ) -> Result<Option<Value>, ControllerFailure> {
        let id = take(&mut query, "id");
        if let Some(hello) = query.get_mut("hello") {
            self.vehicle = take(hello, "vehicle");
            self.step_s = take(hello, "step_s");
            let Ok(inputs) = serde_json::from_value(take(hello, "inputs")) else {
                return Ok(None);
            };
            self.inputs = inputs;
            let count = self.inputs.len();
            let mut hello =
                json!({"crumple": 1, "name": name, "deterministic": true, "inputs": count});
            if source.reports_warnings() {
                hello["warns"] = true.into();
            }
            return Ok(Some(with_interval(hello, source.interval_s())));
        }
        if let Some(seed) = query["reset"]["seed"].as_u64() {
            let Some(ego) = self.ego() else {
                return Ok(None);
            };
            self.controller = Some(source.start(&ego, seed)?);
            return Ok(Some(json!({"id": id, "ready": true})));
        }
        let observation = serde_json::from_value::<Vec<f64>>(take(&mut query, "see"))
            .ok()
            .and_then(|values| {
                let names = &self.inputs;
                Inputs { names, values }.observation()
            });
        let Some((observation, controller)) = observation.zip(self.controller.as_mut()) else {
            return Ok(None);
        };
        let command_mps2 = controller.decide(&observation)?;
        let mut decision = json!({"id": id, "acceleration_mps2": command_mps2});
        if source.reports_warnings() {
            decision["warning"] = controller.is_warning().into();
        }
        Ok(Some(decision))
    }

    /// Returns the vehicle of the controller, as the first message describes it.
    fn ego(&self) -> Option<Ego> {
        Some(Ego {
            vehicle: self.vehicle["index"].as_u64()? as usize,
            max_brake_mps2: self.vehicle["max_brake_mps2"].as_f64()?,
            max_accel_mps2: self.vehicle["max_accel_mps2"].as_f64()?,
            length_m: self.vehicle["length_m"].as_f64()?,
            step_s: self.step_s.as_f64()?,
        })
    }
}

fn with_interval(mut hello: Value, interval_s: Option<f64>) -> Value {
    if let Some(interval_s) = interval_s {
        hello["interval_s"] = interval_s.into();
    }
    hello
}

/// Removes and returns a field of a message; null if it is missing.
fn take(message: &mut Value, field: &str) -> Value {
    message.get_mut(field).map(Value::take).unwrap_or_default()
}

/// Inputs of a decision.
struct Inputs<'a> {
    names: &'a [String],
    values: Vec<f64>,
}

impl Inputs<'_> {
    fn get(&self, name: &str) -> Option<f64> {
        let index = self.names.iter().position(|input| input == name)?;
        self.values.get(index).copied()
    }

    /// Returns the observation of the default inputs; `None` if one is missing.
    fn observation(&self) -> Option<Observation> {
        Some(Observation {
            speed_mps: self.get("speed_mps")?,
            acceleration_mps2: self.get("acceleration_mps2")?,
            ahead: self.neighbour("ahead")?,
            behind: self.neighbour("behind")?,
        })
    }

    /// Returns the neighbour on one side, `Some(None)` if there is none; `None` if an input is missing.
    fn neighbour(&self, side: &str) -> Option<Option<Neighbour>> {
        if self.get(&format!("is_{side}"))? == 0.0 {
            return Some(None);
        }
        Some(Some(Neighbour {
            gap_m: self.get(&format!("gap_{side}_m"))?,
            speed_mps: self.get("speed_mps")? + self.get(&format!("relative_speed_{side}_mps"))?,
            acceleration_mps2: self.get(&format!("acceleration_{side}_mps2"))?,
        }))
    }
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
        let controller = stateless(|observation| {
            let ahead = observation.ahead.map_or(-1.0, |ahead| ahead.speed_mps);
            ahead + 100.0 * observation.behind.map_or(-1.0, |behind| behind.gap_m)
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
            "5",
            r#"{"hello":5}"#,
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
