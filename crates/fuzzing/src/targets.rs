//! Complete fuzz targets: from bytes to a violation or nothing. The targets under `fuzz/` call them; the test suite
//! runs them with every seed in `corpora/fuzz/`.

use std::error::Error;
use std::io::Cursor;
use std::path::Path;

use crumple_fmu::{Fmu, ModelDescription};
use crumple_verify::{Certificate, WorkLimit, check_with};

use super::oracle::motion_is_physical;
use super::run_folder;
use super::{
    Crumple, Invariant, LANE_ORACLES, ORACLES, OracleContext, OracleOutcome, RunSetup,
    ScenarioFormat, System, TestCase, Violation,
};
use crumple_exchange::openscenario::{OpenScenarioSource, ParameterDistributionFile};
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::mdf::{DbcFile, SignalSet};
use crumple_exchange::recording::{self, FollowerDriver, LeaderSelection, MinBrake, find_episodes};
use crumple_measure::stl::{Formula, SampledSignals, SyntaxProblem, naive_robustness};
use crumple_networks::network::{FeedForward, NetworkFile};
use crumple_sim::engine::{RecordingLevel, Run, RunError, RunOptions, simulate};
use crumple_sim::policy::{Policy, Workspace};
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::file::{from_toml, to_toml};
use crumple_sim::scenario::{Scenario, built_in_scenario};

/// A fuzz target: checks the input that bytes encode.
pub type FuzzTarget = fn(&[u8]) -> Result<(), Violation>;

/// All targets by name, which is also the name of the folder of their seeds.
pub const TARGETS: [(&str, FuzzTarget); 13] = [
    ("scenario", scenario),
    ("lanes", lanes),
    ("scenario_file", scenario_file),
    ("policy_file", policy_file),
    ("network_file", network_file),
    ("fmu_file", fmu_file),
    ("certificate", certificate),
    ("recording", recording),
    ("openscenario", openscenario),
    ("binary_recording", binary_recording),
    ("dbc_file", dbc_file),
    ("stl", stl),
    ("work_folder", work_folder),
];

/// Maximum of steps times vehicles of a scenario from a file that is simulated.
const MAX_VEHICLE_STEPS: usize = 20_000;
/// Limit of the checking of a certificate: some hundredths of a second.
const WORK_LIMIT: WorkLimit = WorkLimit::from_operations(100_000_000);
const SAMPLES: usize = 16;

/// Checks all oracles with a test case. The fuzz target does so in a [`super::CollisionSearch`], which also collects
/// collisions.
///
/// # Errors
/// The first [`Violation`] found.
pub fn scenario(bytes: &[u8]) -> Result<(), Violation> {
    TestCase::from_bytes(bytes).check_all(&Crumple).map(drop)
}

/// Checks all oracles that apply to scenarios with lane changes.
///
/// # Errors
/// The first [`Violation`] found.
pub fn lanes(bytes: &[u8]) -> Result<(), Violation> {
    TestCase::from_bytes_with_lanes(bytes)
        .check_each(&LANE_ORACLES, &Crumple)
        .map(drop)
}

/// Counts the oracles that a test case does not leave undecided.
///
/// # Errors
/// The first [`Violation`] found.
pub fn count_decided(bytes: &[u8]) -> Result<usize, Violation> {
    let test_case = TestCase::from_bytes(bytes);
    let question = OracleContext::new(&test_case, &Crumple)?;
    let answers = ORACLES
        .into_iter()
        .map(|oracle| question.check(oracle))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(answers
        .into_iter()
        .filter(|answer| *answer != OracleOutcome::Undecided)
        .count())
}

/// Checks that a text is a scenario file or is refused with an existing line, and that a scenario survives a round trip
/// and runs.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`] or [`Invariant::Files`], or that of the run.
pub fn scenario_file(bytes: &[u8]) -> Result<(), Violation> {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Ok(());
    };
    for format in ScenarioFormat::ALL {
        match format.read(text) {
            Ok(scenario) => check_accepted_scenario(&scenario, format)?,
            Err(error) => {
                let message = error.to_string();
                let line = error_line(&message);
                let lines = 1 + text.matches('\n').count();
                ensure(
                    line.is_some_and(|line| (1..=lines).contains(&line)),
                    Invariant::Reading,
                    text,
                    || message,
                )?;
            }
        }
    }
    Ok(())
}

/// Returns the line that an error of [`ScenarioFormat::read`] names: `file:line: …`.
#[must_use]
pub fn error_line(message: &str) -> Option<usize> {
    let rest = message
        .strip_prefix("f.toml:")
        .or(message.strip_prefix("f.json:"))?;
    rest.split_once(": ")?.0.parse().ok()
}

fn check_accepted_scenario(scenario: &Scenario, format: ScenarioFormat) -> Result<(), Violation> {
    let text = format.to_text(scenario);
    let back = Crumple.file_round_trip(scenario, format);
    let same = back.as_ref().is_ok_and(|back| back == scenario);
    ensure(same, Invariant::Files, &text, || {
        format!("{format:?}: it reads back as {back:?}")
    })?;
    if scenario.steps().saturating_mul(scenario.vehicles().len()) <= MAX_VEHICLE_STEPS {
        let test_case = TestCase {
            scenario: scenario.clone(),
            setup: RunSetup::with_true_state(),
        };
        let options = test_case.setup.options(scenario.spec().step_s);
        if !matches!(
            Run::new(scenario, options),
            Err(RunError::DecisionInterval { .. })
        ) {
            test_case.check(motion_is_physical, &Crumple)?;
        }
    }
    Ok(())
}

/// Checks that bytes are a policy file or are refused, and that a policy has a single encoding and can drive.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn policy_file(bytes: &[u8]) -> Result<(), Violation> {
    let Ok(policy) = Policy::from_bytes(bytes) else {
        return Ok(());
    };
    let header = format!("{:?}", policy.header());
    let written = policy.to_bytes().ok();
    let back = written
        .as_ref()
        .and_then(|written| Policy::from_bytes(written).ok());
    let same = back.as_ref() == Some(&policy);
    ensure(same, Invariant::Reading, &header, || {
        "it differs from what was written".to_owned()
    })?;
    let short = built_in_scenario("paper-1")
        .and_then(|paper| paper.edited(|spec| spec.duration_s = 2.0).ok());
    let Some(short) = short else { return Ok(()) };
    // The decision interval of a policy may not be a multiple of the step of this scenario.
    if let Ok(run) = Run::new(&short, RunOptions::new(std::sync::Arc::new(policy))) {
        let result = simulate(&run, RecordingLevel::Summary);
        let moved = result
            .vehicles
            .iter()
            .all(|vehicle| vehicle.max_brake_mps2.is_finite());
        ensure(moved, Invariant::Reading, &header, || {
            format!("its state leaves the allowed range: {:?}", result.vehicles)
        })?;
    }
    Ok(())
}

/// Checks that bytes are an ONNX or Stable-Baselines3 network or are refused. The outputs of a network must lie in its
/// stated ranges and must not depend on the batch.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn network_file(bytes: &[u8]) -> Result<(), Violation> {
    for (format, read) in [
        ("ONNX", NetworkFile::from_onnx(bytes)),
        ("a zip", NetworkFile::from_sb3(bytes)),
    ] {
        let file = match read {
            Ok(file) => file,
            Err(refused) => {
                let has_reason = !refused.to_string().is_empty();
                ensure(has_reason, Invariant::Reading, "", || {
                    format!("{format} is refused without a reason")
                })?;
                continue;
            }
        };
        check_answers(&file.network)?;
    }
    Ok(())
}

/// Checks that the outputs of a network lie in its stated ranges and do not depend on the batch.
fn check_answers(network: &FeedForward) -> Result<(), Violation> {
    const INPUTS: [f32; 3] = [-4.0, 0.0, 1.5];
    let shape = network.shape();
    // A network whose outputs may overflow is refused as a controller.
    let Ok(ranges) = network.answer_ranges(&vec![[-4.0, 4.0]; network.inputs()]) else {
        return Ok(());
    };
    let mut space = Workspace::default();
    let rows: Vec<f32> = INPUTS
        .iter()
        .flat_map(|&value| vec![value; network.inputs()])
        .collect();
    let in_batch = network.forward(&rows, INPUTS.len(), &mut space).to_vec();
    for (row, answers) in rows
        .chunks(network.inputs())
        .zip(in_batch.chunks(network.outputs()))
    {
        let alone = network.forward(row, 1, &mut space);
        let same = alone
            .iter()
            .zip(answers)
            .all(|(alone, in_batch)| alone.to_bits() == in_batch.to_bits());
        ensure(same, Invariant::Reading, &shape, || {
            format!("{alone:?} alone, {answers:?} among others")
        })?;
        for (answer, [low, high]) in answers.iter().map(|&answer| f64::from(answer)).zip(&ranges) {
            let slack = 1e-3 * (1.0 + low.abs().max(high.abs()));
            let is_in_range = (low - slack..=high + slack).contains(&answer);
            ensure(is_in_range, Invariant::Reading, &shape, || {
                format!("{answer} is not within {low} to {high}")
            })?;
        }
    }
    Ok(())
}

/// Checks that bytes are an FMU or are refused with a one-line error. Runs nothing of the FMU.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn fmu_file(bytes: &[u8]) -> Result<(), Violation> {
    // As an archive, and as the model description within one.
    let read = [
        Fmu::read(Cursor::new(bytes))
            .map(|fmu| fmu.description().clone())
            .map_err(|error| error.to_string()),
        ModelDescription::from_xml(&String::from_utf8_lossy(bytes))
            .map_err(|error| error.to_string()),
    ];
    for read in read {
        match read {
            Ok(ModelDescription {
                variables,
                model_identifier,
                ..
            }) => {
                let mut names: Vec<&str> = variables
                    .iter()
                    .map(|variable| variable.name.as_str())
                    .collect();
                names.sort_unstable();
                names.dedup();
                let is_one =
                    names.len() == variables.len() && !model_identifier.contains(['/', '\\', '.']);
                ensure(is_one, Invariant::Reading, &model_identifier, || {
                    format!("{names:?} are incomplete")
                })?;
            }
            Err(refused) => ensure(!refused.is_empty(), Invariant::Reading, "", || {
                "refused without a reason".to_owned()
            })?,
        }
    }
    Ok(())
}

/// Checks that a text is a certificate or is refused, and that the checker gives the same answer after a round trip.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Certificates`].
pub fn certificate(bytes: &[u8]) -> Result<(), Violation> {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Ok(());
    };
    let Ok(read) = Certificate::from_json(text) else {
        return Ok(());
    };
    let written = serde_json::to_string(&read).unwrap_or_default();
    let again = Certificate::from_json(&written).ok();
    let same = again.as_ref() == Some(&read);
    ensure(same, Invariant::Certificates, text, || {
        format!("it reads back as {again:?}")
    })?;
    let first = check_as_text(&read);
    let second = again.as_ref().map_or_else(|| first.clone(), check_as_text);
    ensure(first == second, Invariant::Certificates, text, || {
        format!("first {first}, then {second}")
    })
}

/// Returns the answer of the checker as text, because a reason may contain NaN.
fn check_as_text(certificate: &Certificate) -> String {
    let answer = check_with(certificate, Some(Policy::reference_bytes()), WORK_LIMIT);
    format!("{answer:?}")
}

/// A map that reads the columns of car-following events as positions of numbered vehicles.
const TRACKS_MAP: &str = r#"version = 1
name = "tracks"
time.clock = { column = "time_s" }
interpolate_s = 0.5
layout.tracks.vehicle = "event"
layout.tracks.position = { column = "gap_m", of = "centre" }
layout.tracks.speed = { column = "follower_speed_mps" }
layout.tracks.length.metres = 2.0
"#;

/// Checks that bytes are a recording or are refused, and that every braking episode makes a scenario or states a
/// reason. Uses the built-in maps and one of tracks.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn recording(bytes: &[u8]) -> Result<(), Violation> {
    let tracks = RecordingMap::from_toml(TRACKS_MAP, Path::new("tracks.toml"));
    ensure(tracks.is_ok(), Invariant::Reading, TRACKS_MAP, || {
        format!("{tracks:?}")
    })?;
    [None, tracks.ok()]
        .iter()
        .try_for_each(|map| check_recording(bytes, map.as_ref()))
}

/// Map for the signals of the seeds of [`binary_recording`].
const BINARY_MAP: &str = r#"version = 1
name = "binary"
time.clock = { column = "time_s" }
layout.pairs.spacing = { column = "gap_m" }
layout.pairs.follower_speed = { column = "ego_mps" }
layout.pairs.leader_speed = { column = "lead_mps" }
"#;

/// Checks Parquet and MDF files as [`recording()`] checks texts.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn binary_recording(bytes: &[u8]) -> Result<(), Violation> {
    let map = RecordingMap::from_toml(BINARY_MAP, Path::new("binary.toml"));
    ensure(map.is_ok(), Invariant::Reading, BINARY_MAP, || {
        format!("{map:?}")
    })?;
    check_recording(bytes, map.as_ref().ok())
}

/// Checks that bytes are a DBC file or are refused with a one-line error, and that a frame of it can be decoded.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`].
pub fn dbc_file(bytes: &[u8]) -> Result<(), Violation> {
    let dbc = match DbcFile::parse(bytes, Path::new("f.dbc")) {
        Ok(dbc) => dbc,
        Err(error) => return reason_is_one_line(&error),
    };
    // A signal that does not fit its message is refused only if it is read.
    match SignalSet::read(Cursor::new(FRAMES), Some(&dbc), &|name| !name.contains('.')) {
        Ok(_) => Ok(()),
        Err(error) => reason_is_one_line(&error),
    }
}

fn reason_is_one_line(error: &dyn Error) -> Result<(), Violation> {
    let reason = error.to_string();
    let is_one_line = !reason.is_empty() && !reason.contains('\n');
    ensure(is_one_line, Invariant::Reading, "", || reason)
}

/// An MDF file of raw CAN frames.
const FRAMES: &[u8] = include_bytes!("../../../corpora/fuzz/binary_recording/frames");

fn check_recording(bytes: &[u8], map: Option<&RecordingMap>) -> Result<(), Violation> {
    let recording = match recording::read(bytes, Path::new("f.csv"), map) {
        Ok(recording) => recording,
        Err(error) => return reason_is_one_line(&error),
    };
    for (number, episode) in find_episodes(&recording, MinBrake::default(), LeaderSelection::Any)
        .episodes
        .iter()
        .enumerate()
    {
        let name = format!("f-{number}");
        let Ok(scenario) = episode.scenario(name, "f.csv", &FollowerDriver::Recorded) else {
            continue;
        };
        let text = to_toml(&scenario).unwrap_or_default();
        let back = from_toml(&text, Path::new("f.toml"), &NoDriverFiles);
        let same = back.as_ref().is_ok_and(|back| *back == scenario);
        ensure(same, Invariant::Files, &text, || {
            format!("it reads back as {back:?}")
        })?;
    }
    for dropped in &recording.dropped {
        let is_said = !dropped.to_string().is_empty();
        ensure(is_said, Invariant::Reading, "", || {
            "a row or column is dropped without a note".to_owned()
        })?;
    }
    let preview = recording::preview(&recording);
    let is_even = preview.is_none_or(|preview| {
        preview.speed_mps[0] <= preview.speed_mps[1] && preview.speed_mps[1] <= preview.speed_mps[2]
    });
    ensure(is_even, Invariant::Reading, "", || {
        "speeds are out of order".to_owned()
    })?;
    Ok(())
}

/// Road of the scenarios of [`openscenario`]: two lanes, of which one has its middle at y = 0.
const ROAD: &[u8] = br#"<OpenDRIVE><road id="1" length="4000" junction="-1"><planView>
<geometry s="0" x="-1000" y="1.875" hdg="0" length="4000"><line/></geometry></planView><lanes><laneSection s="0"><right>
<lane id="-1"><width sOffset="0" a="3.75"/></lane><lane id="-2"><width sOffset="0" a="3.75"/></lane></right>
</laneSection></lanes></road></OpenDRIVE>"#;

/// Checks that bytes are an OpenSCENARIO file on a straight road, or a file with distributions, or are refused with an
/// existing line. An imported scenario must survive a round trip as a file.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`] or [`Invariant::Files`].
pub fn openscenario(bytes: &[u8]) -> Result<(), Violation> {
    let text = String::from_utf8_lossy(bytes);
    let variations =
        ParameterDistributionFile::from_bytes(bytes).and_then(|file| file.variations());
    let imported =
        OpenScenarioSource::from_bytes(bytes, ROAD).and_then(|source| source.scenario(None, &[]));
    if let Ok(imported) = &imported {
        let written = to_toml(&imported.scenario).unwrap_or_default();
        let back = from_toml(&written, Path::new("f.toml"), &NoDriverFiles);
        let same = back.as_ref().is_ok_and(|back| *back == imported.scenario);
        ensure(same, Invariant::Files, &text, || {
            format!("it reads back as {back:?}")
        })?;
    }
    for message in [variations.err(), imported.err()]
        .into_iter()
        .flatten()
        .map(|error| error.to_string())
    {
        let location = message
            .strip_prefix("f.xosc:")
            .or(message.strip_prefix("d.xosc:"));
        let line = location.and_then(|rest| rest.split_once(": ")?.0.parse::<usize>().ok());
        let lines = 1 + text.matches('\n').count();
        let line_exists =
            line.is_none_or(|line| (1..=lines).contains(&line)) && !message.is_empty();
        ensure(line_exists, Invariant::Reading, &text, || message)?;
    }
    Ok(())
}

/// Checks that a text is a formula or is refused with an existing column. A formula must have the robustness of the
/// definition and survive a round trip.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Reading`] or [`Invariant::Monitor`].
pub fn stl(bytes: &[u8]) -> Result<(), Violation> {
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Ok(());
    };
    let formula: Formula = match text.parse() {
        Ok(formula) => formula,
        Err(crumple_measure::stl::FormulaParseError { column, problem }) => {
            let columns = 1..=1 + text.chars().count();
            let column_exists = columns.contains(&column);
            return ensure(column_exists, Invariant::Reading, text, || {
                format!("column {column}: {problem}")
            });
        }
    };
    check_printed_formula(&formula, text)?;
    let Some(signals) = test_signals(&formula) else {
        return Ok(());
    };
    let Ok(robustness) = formula.robustness(&signals) else {
        return Ok(());
    };
    let Ok(defined) = naive_robustness(&formula, &signals, 0) else {
        return Ok(());
    };
    let same = robustness == defined;
    ensure(same, Invariant::Monitor, text, || {
        format!("robustness {robustness}, defined as {defined}")
    })?;
    let satisfied = formula.is_satisfied(&signals);
    let sign = robustness == 0.0 || satisfied == Ok(robustness > 0.0);
    ensure(sign, Invariant::Monitor, text, || {
        format!("robustness {robustness}, satisfied {satisfied:?}")
    })
}

/// Checks that a formula from `text` reads back as it is printed.
fn check_printed_formula(formula: &Formula, text: &str) -> Result<(), Violation> {
    let printed = formula.to_string();
    match printed.parse::<Formula>() {
        // Printing adds parentheses and may expand a sum: a text at the limits can exceed them.
        Err(error) if matches!(error.problem, SyntaxProblem::TooLong { .. }) => Ok(()),
        back => {
            let same = back.as_ref() == Ok(formula);
            ensure(same, Invariant::Reading, text, || {
                format!("{printed} reads back as {back:?}")
            })
        }
    }
}

/// Returns samples for the signals of a formula; `None` if they cannot be represented.
fn test_signals(formula: &Formula) -> Option<SampledSignals<'static>> {
    let mut signals = SampledSignals::new(0.1, SAMPLES).ok()?;
    for (name, seed) in formula.signal_names().into_iter().zip(1_usize..) {
        // Small integers, so that margins of exactly zero are common.
        let samples: Vec<f64> = (0..SAMPLES)
            .map(|k| ((k * k * seed + 3 * k + seed) % 7) as f64 - 3.0)
            .collect();
        signals.insert(name.to_owned(), samples).ok()?;
    }
    Some(signals)
}

/// Checks that a changed campaign folder is accepted as complete only if it is the genuine one, and that a resumed
/// campaign ends as the genuine one.
///
/// # Errors
/// A [`Violation`] of [`Invariant::Folders`].
pub fn work_folder(bytes: &[u8]) -> Result<(), Violation> {
    // Errors of temporary files are not findings.
    match run_folder::find_wrong_acceptance(bytes) {
        Ok(Some(finding)) => ensure(false, Invariant::Folders, &format!("{bytes:?}"), || finding),
        Ok(None) | Err(_) => Ok(()),
    }
}

fn ensure(
    holds: bool,
    invariant: Invariant,
    input: &str,
    finding: impl FnOnce() -> String,
) -> Result<(), Violation> {
    if holds {
        Ok(())
    } else {
        Err(Violation {
            invariant,
            finding: finding(),
            reproducer: input.to_owned(),
        })
    }
}
