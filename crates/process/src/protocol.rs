//! Messages of protocol version 1: lines of JSON (`docs/controllers.md`).

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crumple_sim::control::{ProcessProblem, escaped_excerpt};

pub(crate) use crumple_sim::control::PROTOCOL_VERSION as VERSION;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct HelloRequest<'a> {
    pub(crate) crumple: u64,
    pub(crate) hello: HelloParams<'a>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct HelloParams<'a> {
    pub(crate) vehicle: VehicleParams,
    pub(crate) step_s: f64,
    pub(crate) inputs: Vec<&'a str>,
    pub(crate) history: usize,
    pub(crate) newest_first: bool,
    /// Range of the answers as accelerations.
    pub(crate) low_mps2: f64,
    pub(crate) high_mps2: f64,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct VehicleParams {
    pub(crate) index: usize,
    pub(crate) max_brake_mps2: f64,
    pub(crate) max_accel_mps2: f64,
    pub(crate) length_m: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct HelloReply {
    crumple: u64,
    pub(crate) name: String,
    pub(crate) deterministic: bool,
    /// Time between its decisions, in seconds.
    pub(crate) interval_s: Option<f64>,
    /// True if one query may hold the decisions of several independent runs.
    #[serde(default)]
    pub(crate) batch: bool,
    /// Expected number of inputs.
    pub(crate) inputs: Option<u64>,
    /// True if each decision states whether the process warns of a collision.
    #[serde(default)]
    pub(crate) warns: bool,
}

/// Start of a run. Replies repeat the `id` of their query, which reveals surplus and late lines.
#[derive(Serialize)]
pub(crate) struct ResetRequest {
    pub(crate) id: u64,
    pub(crate) reset: ResetParams,
}

#[derive(Serialize)]
pub(crate) struct ResetParams {
    pub(crate) seed: u64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ResetReply {
    id: u64,
    ready: bool,
}

#[derive(Serialize)]
pub(crate) struct DecisionRequest<'a> {
    pub(crate) id: u64,
    pub(crate) time_s: f64,
    #[serde(rename = "see")]
    pub(crate) inputs: &'a [f64],
}

#[derive(Serialize)]
pub(crate) struct BatchDecisionRequest<'a> {
    pub(crate) id: u64,
    pub(crate) times_s: &'a [f64],
    #[serde(rename = "see")]
    pub(crate) inputs: Vec<&'a [f64]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DecisionReply<T, W> {
    id: u64,
    acceleration_mps2: T,
    warning: Option<W>,
}

/// A decision of a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Decision {
    /// Answer of the mapping.
    pub(crate) answer: f64,
    /// True while the process warns of a collision.
    pub(crate) warning: bool,
}

/// Query whose reply is expected, and the promise of the handshake.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ExpectedReply {
    /// Number of the query.
    pub(crate) id: u64,
    /// True if the handshake promises warnings.
    pub(crate) warns: bool,
}

pub(crate) fn write_line(
    into: &mut Vec<u8>,
    message: &impl Serialize,
) -> Result<(), ProcessProblem> {
    into.clear();
    // Cannot fail: the messages hold only numbers and text.
    serde_json::to_writer(&mut *into, message).map_err(|error| ProcessProblem::NotStarted {
        reason: error.to_string(),
    })?;
    into.push(b'\n');
    Ok(())
}

pub(crate) fn parse_hello_reply(line: &[u8]) -> Result<HelloReply, ProcessProblem> {
    #[derive(Deserialize)]
    struct Version {
        crumple: serde_json::Value,
    }
    let Version { crumple: version } = parse_message(line)?;
    if version != VERSION {
        return Err(ProcessProblem::Version {
            found: escaped_excerpt(&version.to_string()),
        });
    }
    let greeting: HelloReply = parse_message(line)?;
    Ok(HelloReply {
        name: escaped_excerpt(&greeting.name),
        ..greeting
    })
}

/// Checks that the process is ready for a run, in reply to query `request_id`.
pub(crate) fn parse_reset_reply(line: &[u8], request_id: u64) -> Result<(), ProcessProblem> {
    let ResetReply { id, ready } = parse_message(line)?;
    check_id(id, request_id)?;
    if ready {
        Ok(())
    } else {
        Err(invalid_reply(line, "it is not ready"))
    }
}

pub(crate) fn parse_decision(
    line: &[u8],
    expected: ExpectedReply,
) -> Result<Decision, ProcessProblem> {
    let reply: DecisionReply<f64, bool> = parse_message(line)?;
    check_id(reply.id, expected.id)?;
    check_warning(line, reply.warning.is_some(), expected)?;
    Ok(Decision {
        answer: reply.acceleration_mps2,
        warning: reply.warning.unwrap_or_default(),
    })
}

pub(crate) fn parse_decisions(
    line: &[u8],
    expected: ExpectedReply,
    count: usize,
) -> Result<Vec<Decision>, ProcessProblem> {
    let reply: DecisionReply<Vec<f64>, Vec<bool>> = parse_message(line)?;
    check_id(reply.id, expected.id)?;
    check_warning(line, reply.warning.is_some(), expected)?;
    let answers = reply.acceleration_mps2;
    let warnings = reply.warning.unwrap_or_else(|| vec![false; count]);
    for length in [answers.len(), warnings.len()] {
        if length != count {
            return Err(ProcessProblem::Answers {
                found: length,
                asked: count,
            });
        }
    }
    let decisions = answers.into_iter().zip(warnings);
    Ok(decisions
        .map(|(answer, warning)| Decision { answer, warning })
        .collect())
}

/// Refuses a decision with a warning that the handshake does not promise, and one without a promised warning.
fn check_warning(
    line: &[u8],
    has_warning: bool,
    expected: ExpectedReply,
) -> Result<(), ProcessProblem> {
    match (has_warning, expected.warns) {
        (true, false) => Err(invalid_reply(
            line,
            "it has `warning`, and the handshake lacks `\"warns\":true`",
        )),
        (false, true) => Err(invalid_reply(
            line,
            "it lacks `warning`, which the handshake promises",
        )),
        _ => Ok(()),
    }
}

fn check_id(id: u64, request_id: u64) -> Result<(), ProcessProblem> {
    if id == request_id {
        Ok(())
    } else {
        Err(ProcessProblem::WrongRequestId {
            found: id,
            asked: request_id,
        })
    }
}

fn parse_message<T: DeserializeOwned>(line: &[u8]) -> Result<T, ProcessProblem> {
    // Serde would accept a list as a structure.
    if line.trim_ascii_start().first() != Some(&b'{') {
        return Err(invalid_reply(line, "a line is a JSON object"));
    }
    serde_json::from_slice(line).map_err(|error| {
        let error = error.to_string();
        // Python and others write these numbers, which JSON lacks.
        let is_not_finite = error.starts_with("number out of range")
            || ["NaN", "nan", "Infinity", "inf", "number out of range"]
                .into_iter()
                .any(|number| contains(line, number));
        if contains(line, "\"acceleration_mps2\"") && is_not_finite {
            ProcessProblem::NotFinite
        } else {
            invalid_reply(line, &error)
        }
    })
}

fn contains(line: &[u8], text: &str) -> bool {
    line.windows(text.len()).any(|part| part == text.as_bytes())
}

fn invalid_reply(line: &[u8], reason: &str) -> ProcessProblem {
    ProcessProblem::InvalidReply {
        found: escaped_excerpt(String::from_utf8_lossy(line).trim_end()),
        reason: escaped_excerpt(reason),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn invalid_answers_are_distinguished() {
        let silent = ExpectedReply {
            id: 7,
            warns: false,
        };
        let problem = |line: &str| parse_decision(line.as_bytes(), silent).unwrap_err();
        assert_eq!(
            parse_decision(b"{\"id\":7, \"acceleration_mps2\": -1.5}", silent),
            Ok(Decision {
                answer: -1.5,
                warning: false
            })
        );
        let wrong_id = problem("{\"id\":6,\"acceleration_mps2\":1}");
        assert_eq!(
            wrong_id,
            ProcessProblem::WrongRequestId { found: 6, asked: 7 }
        );
        for line in ["NaN", "-Infinity", "nan", "1e999", "[NaN]"] {
            let reason = problem(&format!("{{\"id\":7,\"acceleration_mps2\":{line}}}"));
            assert_eq!(reason, ProcessProblem::NotFinite, "{line}");
        }
        for rest in [
            "",
            "\"acceleration_mps2\":null}",
            "\"acceleration_mps2\":1,\"x\":2}",
            "\"x\":2}",
        ] {
            let line = format!("{{\"id\":7,{rest}");
            assert!(
                matches!(problem(&line), ProcessProblem::InvalidReply { .. }),
                "{line}"
            );
        }
        for line in [
            "",
            "[1.0]",
            "{}",
            "{\"acceleration_mps2\":1}",
            "{\"id\":7.0,\"acceleration_mps2\":1}",
        ] {
            assert!(
                matches!(problem(line), ProcessProblem::InvalidReply { .. }),
                "{line}"
            );
        }
        let all = |line: &str| {
            let decisions = parse_decisions(line.as_bytes(), silent, 2)?;
            Ok(decisions
                .into_iter()
                .map(|decision| decision.answer)
                .collect::<Vec<_>>())
        };
        assert_eq!(
            all("{\"id\":7,\"acceleration_mps2\":[1,2.5]}"),
            Ok(vec![1.0, 2.5])
        );
        assert_eq!(
            all("{\"id\":7,\"acceleration_mps2\":[1]}"),
            Err(ProcessProblem::Answers { found: 1, asked: 2 })
        );
        let is_ready = |line: &str| parse_reset_reply(line.as_bytes(), 7).is_ok();
        assert!(!is_ready("{\"id\":7,\"ready\":false}") && is_ready("{\"id\":7,\"ready\":true}"));
        let version = parse_hello_reply(b"{\"crumple\":2,\"whatever\":0}").unwrap_err();
        assert_eq!(
            version,
            ProcessProblem::Version {
                found: "2".to_owned()
            }
        );
        assert!(
            parse_hello_reply(b"{\"crumple\":1,\"name\":\"a\"}").is_err(),
            "says not whether it is deterministic"
        );
        assert!(
            parse_hello_reply(
                b"{\"crumple\":1,\"name\":\"a\",\"deterministic\":true,\"interval\":1}"
            )
            .is_err()
        );
    }

    #[test]
    fn a_warning_is_stated_exactly_if_the_handshake_promises_it() {
        let decide =
            |line: &str, warns| parse_decision(line.as_bytes(), ExpectedReply { id: 7, warns });
        let decide_two =
            |line: &str, warns| parse_decisions(line.as_bytes(), ExpectedReply { id: 7, warns }, 2);
        let warning = |decided: Result<Decision, _>| decided.map(|decision| decision.warning);
        let stated = "{\"id\":7,\"acceleration_mps2\":1,\"warning\":true}";
        let silent = "{\"id\":7,\"acceleration_mps2\":1}";
        assert_eq!(warning(decide(stated, true)), Ok(true));
        assert_eq!(warning(decide(silent, false)), Ok(false));
        assert!(decide(stated, false).is_err() && decide(silent, true).is_err());
        let both = "{\"id\":7,\"acceleration_mps2\":[1,2],\"warning\":[false,true]}";
        let warnings: Vec<bool> = decide_two(both, true)
            .unwrap()
            .iter()
            .map(|decision| decision.warning)
            .collect();
        assert_eq!(warnings, [false, true]);
        let short = "{\"id\":7,\"acceleration_mps2\":[1,2],\"warning\":[true]}";
        assert!(decide_two(short, true).is_err() && decide_two(both, false).is_err());
    }
}
