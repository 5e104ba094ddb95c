//! Units that FMUs declare: values are converted, or the controller is refused with the unit's name.

use super::*;
use crumple_controllers::find_for_user;
use crumple_process::ProcessController;

/// Another unit for each unit of the example, with its definition. The time gap's has an offset.
const OTHER_UNITS: &str = r#"<UnitDefinitions>
    <Unit name="ft"><BaseUnit m="1" factor="0.3048"/><DisplayUnit name="yd" factor="0.333"/></Unit>
    <Unit name="km/h"><BaseUnit m="1" s="-1" factor="0.2777777777777778"/></Unit>
    <Unit name="g"><BaseUnit m="1" s="-2" factor="9.80665"/></Unit>
    <Unit name="late"><BaseUnit s="1" factor="60" offset="0.25"/></Unit>
    <Unit name="furlong"/><Unit name="deg"><BaseUnit rad="1" factor="0.017453292519943295"/></Unit>
    <Unit name="1"><BaseUnit/></Unit><Unit name="%"><BaseUnit factor="0.01"/></Unit>
  </UnitDefinitions>"#;

/// Factors and offsets of gap, relative speed, speed, answer, time gap and set speed in [`OTHER_UNITS`].
const UNIT_TABLE: &str = "static const double FACTOR[] = {0.3048, 1 / 3.6, 1 / 3.6, 9.80665, 60, 1 / 3.6}, OFFSET[] = \
    {0, 0, 0, 0, 0.25, 0};\n";

/// Returns the C source of an FMU that computes in SI units with other units outside. Its table begins at reference
/// `first`.
fn convert_units_in_source(source: &str, first: u32) -> String {
    let entry = |table: &str| {
        format!("(references[one] - {first} < 6u ? {table}[references[one] - {first}]")
    };
    let (factor, offset) = (entry("FACTOR") + " : 1.0)", entry("OFFSET") + " : 0.0)");
    let source = source.replace(
        "= values[one];",
        &format!("= values[one] * {factor} + {offset};"),
    );
    let got = "values[references[one]];";
    assert_eq!(source.matches(got).count(), 1);
    let begin = source
        .find("values[one] = ((Follower")
        .expect("reads a value");
    let read = source
        .get(begin..)
        .and_then(|rest| rest.split_once(';'))
        .expect("a statement")
        .0
        .to_owned();
    let value = read.strip_prefix("values[one] = ").expect("an assignment");
    let source = source.replace(
        &read,
        &format!("values[one] = ({value} - {offset}) / {factor}"),
    );
    source.replace(
        "typedef struct {\n    double values",
        &format!("{UNIT_TABLE}typedef struct {{\n    double values"),
    )
}

/// Returns the description of the example with other units; the set speed gets its unit from a declared type.
fn other_units_xml() -> String {
    let begin = EXAMPLE_XML.find("<UnitDefinitions>").unwrap();
    let end = EXAMPLE_XML.find("<ModelVariables>").unwrap();
    let types = "<TypeDefinitions><SimpleType name=\"Speed\"><Real unit=\"km/h\"/></SimpleType></TypeDefinitions>\n  ";
    let text = format!(
        "{}{OTHER_UNITS}\n  {types}{}",
        &EXAMPLE_XML[..begin],
        &EXAMPLE_XML[end..]
    );
    let text = text.replace(
        "unit=\"m/s\" start=\"30\"",
        "declaredType=\"Speed\" start=\"108\"",
    );
    text.replace("unit=\"m\"", "unit=\"ft\"")
        .replace("unit=\"m/s\"", "unit=\"km/h\"")
        .replace("unit=\"m/s2\"", "unit=\"g\"")
        .replace("unit=\"s\"", "unit=\"late\"")
}

/// Returns the description of `odd` (FMI 3) with the units of [`OTHER_UNITS`].
fn other_units_odd_xml() -> String {
    let types = "<TypeDefinitions><Float64Type name=\"Speed\" unit=\"km/h\"/></TypeDefinitions>";
    let text = ODD_XML.replace("\"ONCE\"", "\"false\"");
    let text = text.replace(
        "  <ModelVariables>",
        &format!("  {OTHER_UNITS}\n  {types}\n  <ModelVariables>"),
    );
    let with = |text: String, name: &str, unit: &str| {
        text.replace(
            &format!("name=\"{name}\" "),
            &format!("name=\"{name}\" {unit} "),
        )
    };
    let units = [
        ("distance", "unit=\"ft\""),
        ("rate", "declaredType=\"Speed\""),
        ("speed", "unit=\"km/h\" displayUnit=\"mph\""),
        ("command", "unit=\"g\""),
        ("gap.time", "unit=\"late\""),
        ("set speed", "declaredType=\"Speed\""),
    ];
    units
        .into_iter()
        .fold(text, |text, (name, unit)| with(text, name, unit))
}

const PARAMETERS: &str = "version = 1\nfmu = \"follower.fmu\"\nparameters = { time_gap_s = 1.0, \
    set_speed_mps = 26.0 }\n";

fn largest_difference_m(first: &SimulationResult, other: &SimulationResult) -> f64 {
    let (first, other) = (first.trace.as_ref().unwrap(), other.trace.as_ref().unwrap());
    let positions = |trace: &crumple_sim::engine::Trace| trace.vehicles[1].position_m.clone();
    positions(first)
        .iter()
        .zip(positions(other))
        .map(|(first, other)| (first - other).abs())
        .fold(0.0, f64::max)
}

#[test]
fn an_fmu_that_declares_other_units_drives_as_one_in_si_units() {
    let Some(plain) = example_fmu_folder() else {
        return;
    };
    fs::write(plain.path().join("f.toml"), PARAMETERS).unwrap();
    let scenario = built_in_scenario("paper-1").unwrap();
    let expected = simulate_with_truth(&find_controller("f.toml", plain.path()).source, &scenario);

    let two = temp_folder();
    let library = compile_library(
        two.path(),
        &convert_units_in_source(EXAMPLE, 0),
        "-DEXAMPLE",
    )
    .unwrap();
    write_fmu(
        &two.path().join("follower.fmu"),
        &other_units_xml(),
        &[(&library_member(2, "follower"), &library)],
    );
    fs::write(two.path().join("f.toml"), PARAMETERS).unwrap();
    let result = simulate_with_truth(&find_controller("f.toml", two.path()).source, &scenario);
    let apart_m = largest_difference_m(&expected, &result);
    assert!(
        expected.outcome.failed_controller().is_none() && apart_m < 1e-9,
        "FMI 2: {apart_m} m"
    );
    // Without a controller file the variables are named like quantities, and are converted too.
    let by_names = |folder: &Path| {
        simulate_with_truth(&find_controller("follower.fmu", folder).source, &scenario)
    };
    let apart_m = largest_difference_m(&by_names(plain.path()), &by_names(two.path()));
    assert!(apart_m < 1e-9, "by names: {apart_m} m");

    let three = temp_folder();
    let library = compile_library(
        three.path(),
        &convert_units_in_source(ODD, 1),
        "-DWHAT=NOTHING",
    )
    .unwrap();
    write_fmu(
        &three.path().join("odd.fmu"),
        &other_units_odd_xml(),
        &[(&library_member(3, "odd"), &library)],
    );
    let text = ODD_CONTROLLER.replace(
        "\"set speed\" = 30.0",
        "\"gap.time\" = 1.0, \"set speed\" = 26.0",
    );
    fs::write(three.path().join("odd.toml"), text).unwrap();
    let result = simulate_with_truth(&find_controller("odd.toml", three.path()).source, &scenario);
    let apart_m = largest_difference_m(&expected, &result);
    assert!(apart_m < 1e-9, "FMI 3: {apart_m} m");
}

/// No code of an FMU runs here, so its library may be empty.
#[test]
fn units_that_cannot_be_converted_are_refused_by_name() {
    let folder = temp_folder();
    let outcome = |xml: &str, toml: &str| {
        write_fmu(
            &folder.path().join("follower.fmu"),
            xml,
            &[(&library_member(2, "follower"), b"")],
        );
        fs::write(folder.path().join("f.toml"), toml).unwrap();
        find_for_user("f.toml", folder.path()).map_err(|error| error.to_string())
    };
    let wired = |quantity: &str, scale: &str, output: &str| {
        format!(
            "version = 1\nfmu = \"follower.fmu\"\noutput = {{ low_mps2 = -8.0, high_mps2 = 3.0, {output} }}\n\
             [[inputs]]\nquantity = \"{quantity}\"\nvariable = \"gap_ahead_m\"\n{scale}\n"
        )
    };
    let plain = wired("gap_ahead_m", "", "");
    let with = |was: &str, is: &str| other_units_xml().replacen(was, is, 1);
    let gap_in = |unit: &str| with("unit=\"ft\"", &format!("unit=\"{unit}\""));
    let answer_in = |unit: &str| with("unit=\"g\"", &format!("unit=\"{unit}\""));
    let refused = [
        (
            gap_in("furlong"),
            plain.clone(),
            "f.toml:4: inputs[0]: the FMU's `gap_ahead_m` has the unit `furlong`, which the FMU does not define",
        ),
        (
            gap_in("parsec"),
            plain.clone(),
            "the unit `parsec`, which the FMU does not define",
        ),
        (
            gap_in("km/h"),
            plain.clone(),
            "has the unit `km/h` (m.s-1 in SI units), and gap_ahead_m is in m",
        ),
        (
            gap_in("deg"),
            plain.clone(),
            "has the unit `deg` (rad in SI units), and gap_ahead_m is in m",
        ),
        (
            gap_in("1"),
            plain.clone(),
            "has the unit `1` (1 in SI units), and gap_ahead_m is in m; a plain number needs a `scale`",
        ),
        (
            other_units_xml(),
            wired("speed_mps", "", ""),
            "has the unit `ft` (m in SI units), and speed_mps is in m.s-1",
        ),
        (
            other_units_xml(),
            wired("gap_ahead_m", "scale = 0.3048", ""),
            "`scale` must be 1 or -1, found 0.3048",
        ),
        (
            answer_in("furlong"),
            plain.clone(),
            "output.variable: the FMU's `acceleration_mps2` has the unit `furlong`",
        ),
        (
            answer_in("km/h"),
            plain.clone(),
            "has the unit `km/h` (m.s-1 in SI units), and the answer is in m.s-2",
        ),
        (
            answer_in("1"),
            plain.clone(),
            "a plain number needs a `scale_mps2`",
        ),
        (
            other_units_xml(),
            wired("gap_ahead_m", "", "scale_mps2 = 9.8"),
            "`scale_mps2` must be 1 or -1, found 9.8",
        ),
        (
            other_units_xml(),
            wired("gap_ahead_m", "", "squash = \"tanh\""),
            "has the unit `g`, and `squash` is allowed only for outputs",
        ),
        (
            with("unit=\"late\"", "unit=\"furlong\""),
            format!("{plain}[parameters]\ntime_gap_s = 1.0\n"),
            "parameters.time_gap_s: the FMU's `time_gap_s` has the unit `furlong`",
        ),
    ];
    for (xml, toml, message) in refused {
        let error = outcome(&xml, &toml).expect_err(message);
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
    let accepted = [
        (gap_in("m"), plain.clone()),
        (gap_in("1"), wired("gap_ahead_m", "scale = 100.0", "")),
        (gap_in("%"), wired("is_ahead", "", "")),
        (
            other_units_xml(),
            wired("gap_ahead_m", "scale = -1.0\noffset = 3.0", ""),
        ),
        (answer_in("%"), wired("gap_ahead_m", "", "scale_mps2 = 3.0")),
        (answer_in("m/s²"), plain.clone()),
        // An unset parameter keeps its start value, in any unit.
        (with("unit=\"late\"", "unit=\"furlong\""), plain.clone()),
        (other_units_xml().replace("unit=", "quantity="), plain),
    ];
    for (number, (xml, toml)) in accepted.into_iter().enumerate() {
        outcome(&xml, &toml).unwrap_or_else(|error| panic!("{number}: {error}"));
    }
}

/// Limits, scale and offset of an input are in SI units.
#[test]
fn numbers_of_a_controller_file_are_in_si_units() {
    let folder = temp_folder();
    let library = library_member(2, "follower");
    write_fmu(
        &folder.path().join("follower.fmu"),
        &other_units_xml(),
        &[(&library, b"")],
    );
    let text = "version = 1\nfmu = \"follower.fmu\"\n[[inputs]]\nquantity = \"gap_ahead_m\"\noffset = 3.048\nlow = \
        0.0\nhigh = 60.96\n";
    fs::write(folder.path().join("f.toml"), text).unwrap();
    let source = find_controller("f.toml", folder.path()).source;
    let Some(process) = source.downcast_ref::<ProcessController>() else {
        panic!("a process")
    };
    let input = &process.setup().mapping.inputs[0];
    let close = |found: f64, expected: f64| (found - expected).abs() < 1e-12;
    assert!(
        close(input.offset, 3.048) && close(input.scale, 0.3048),
        "{input:?}"
    );
    assert!(
        close(input.low, 0.0) && close(input.high, 200.0),
        "{input:?}"
    );
    let output = &process.setup().mapping.output;
    assert!(
        close(output.scale_mps2, 9.80665) && output.low_mps2 == -30.0,
        "{output:?}"
    );
}
