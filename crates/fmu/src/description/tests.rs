use std::time::{Duration, Instant};

use super::*;
use crate::{Conversion, UnitDimension};

fn fmi2_description(definitions: &str, variables: &str) -> String {
    format!(
        "<?xml version=\"1.0\"?>\n<fmiModelDescription fmiVersion=\"2.0\" modelName=\"a\" guid=\"g\">\n\
         <CoSimulation \
         modelIdentifier=\"a\"/>\n{definitions}<ModelVariables>{variables}</ModelVariables></fmiModelDescription>"
    )
}

fn fmi3_description(definitions: &str, variables: &str) -> String {
    fmi2_description(definitions, variables)
        .replace("fmiVersion=\"2.0\"", "fmiVersion=\"3.0\"")
        .replace("guid", "instantiationToken")
}

fn input(attributes: &str) -> String {
    format!(
        "<ScalarVariable name=\"x\" valueReference=\"0\" causality=\"input\"><Real {attributes}/></ScalarVariable>"
    )
}

const UNITS: &str = r#"<UnitDefinitions>
    <Unit name="km/h"><BaseUnit m="1" s="-1" factor="0.2777777777777778"/><DisplayUnit name="mph" factor="0.62"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
    <Unit name="m"><BaseUnit m=" +1 "/></Unit>
    <Unit name="furlong"/><Unit name="m/s2"/>
</UnitDefinitions>"#;

fn conversion(dimension: UnitDimension, factor: f64, offset: f64) -> Option<Conversion> {
    Some(Conversion {
        dimension,
        factor,
        offset,
    })
}

fn unit(text: &str) -> Option<DeclaredUnit> {
    let description = ModelDescription::from_xml(text).unwrap_or_else(|error| panic!("{error}"));
    description
        .variables
        .first()
        .expect("a variable")
        .unit
        .clone()
}

#[test]
fn units_come_from_the_variable_or_its_declared_type_in_both_editions() {
    let speed = conversion(
        UnitDimension::metres_seconds(1, -1),
        0.277_777_777_777_777_8,
        0.0,
    );
    let kelvin = UnitDimension([0, 0, 0, 0, 1, 0, 0, 0]);
    let types_2 = r#"<TypeDefinitions>
        <SimpleType name="Speed"><Real quantity="Velocity" unit="km/h" displayUnit="mph"/></SimpleType>
        <SimpleType name="Rise"><Real unit="degC" relativeQuantity="true"/></SimpleType>
        <SimpleType name="Count"><Integer/></SimpleType></TypeDefinitions>"#;
    let types_3 = r#"<TypeDefinitions><Float64Type name="Speed" unit="km/h"/>
        <Float64Type name="Rise" unit="degC" relativeQuantity="true"/><Int32Type name="Count"/></TypeDefinitions>"#;
    let cases = [
        ("unit=\"km/h\"", Some("km/h"), speed),
        ("declaredType=\"Speed\"", Some("km/h"), speed),
        (
            "declaredType=\"Speed\" unit=\"m\"",
            Some("m"),
            conversion(UnitDimension::metres_seconds(1, 0), 1.0, 0.0),
        ),
        (
            "unit=\"degC\"",
            Some("degC"),
            conversion(kelvin, 1.0, 273.15),
        ),
        (
            "unit=\"degC\" relativeQuantity=\"1\"",
            Some("degC"),
            conversion(kelvin, 1.0, 0.0),
        ),
        (
            "declaredType=\"Rise\"",
            Some("degC"),
            conversion(kelvin, 1.0, 0.0),
        ),
        (
            "declaredType=\"Rise\" relativeQuantity=\"false\"",
            Some("degC"),
            conversion(kelvin, 1.0, 273.15),
        ),
        ("unit=\"furlong\"", Some("furlong"), None),
        ("unit=\"parsec\"", Some("parsec"), None),
        (
            "unit=\"m/s2\"",
            Some("m/s2"),
            conversion(UnitDimension::metres_seconds(1, -2), 1.0, 0.0),
        ),
        (
            "unit=\"m/s\"",
            Some("m/s"),
            conversion(UnitDimension::metres_seconds(1, -1), 1.0, 0.0),
        ),
        ("displayUnit=\"km/h\"", None, None),
        ("unit=\"\"", None, None),
    ];
    for (attributes, name, conversion) in cases {
        let expected = name.map(|name| DeclaredUnit {
            name: name.to_owned(),
            conversion,
        });
        let two = fmi2_description(&format!("{UNITS}{types_2}"), &input(attributes));
        assert_eq!(unit(&two), expected, "FMI 2, {attributes}");
        let variable =
            format!("<Float64 name=\"x\" valueReference=\"0\" causality=\"input\" {attributes}/>");
        assert_eq!(
            unit(&fmi3_description(&format!("{UNITS}{types_3}"), &variable)),
            expected,
            "FMI 3, {attributes}"
        );
    }
}

#[test]
fn unit_errors_name_their_line() {
    let with = |unit: &str| {
        fmi2_description(
            &format!("<UnitDefinitions>\n{unit}</UnitDefinitions>"),
            &input("unit=\"u\""),
        )
    };
    let cases = [
        (
            with("<Unit name=\"u\"><BaseUnit m=\"1.5\"/></Unit>"),
            "line 5: `BaseUnit`: m: \"1.5\" is not a whole number",
        ),
        (
            with("<Unit name=\"u\"><BaseUnit factor=\"0\"/></Unit>"),
            "line 5: `BaseUnit`: factor: must not be 0",
        ),
        (
            with("<Unit name=\"u\"><BaseUnit factor=\"INF\"/></Unit>"),
            "factor: \"INF\" is not a finite number",
        ),
        (
            with("<Unit name=\"u\"><BaseUnit offset=\"x\"/></Unit>"),
            "offset: \"x\" is not a finite number",
        ),
        (
            with("<Unit><BaseUnit/></Unit>"),
            "line 5: `Unit` has no attribute `name`",
        ),
        (
            with("<Unit name=\"u\"><BaseUnit/></Unit>\n<Unit name=\"u\"><BaseUnit/></Unit>"),
            "line 6: there are two units \"u\"",
        ),
        (
            fmi2_description("", &input("declaredType=\"T\"")),
            "line 4: declaredType: there is no real type \"T\"",
        ),
        (
            fmi2_description("", &input("unit=\"m\" relativeQuantity=\"maybe\"")),
            "relativeQuantity: \"maybe\" is neither true nor false",
        ),
    ];
    for (text, message) in cases {
        let error = ModelDescription::from_xml(&text)
            .expect_err(message)
            .to_string();
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
}

#[test]
fn texts_that_are_not_well_formed_are_refused_with_their_line() {
    let whole = fmi2_description("", &input(""));
    assert!(ModelDescription::from_xml(&format!("\u{feff}{whole}")).is_ok());
    assert!(ModelDescription::from_xml(&format!("{whole}\n<!-- end -->\n")).is_ok());
    let cases = [
        (whole.replace("</ModelVariables>", ""), "line 4: "),
        (
            whole.replace("</fmiModelDescription>", ""),
            "line 4: the text ends within an element",
        ),
        (
            format!("{whole}\n<fmiModelDescription/>"),
            "line 5: there is a second root element",
        ),
        (
            format!("{whole}\n\nmore"),
            "there is text outside of the root element",
        ),
        (
            whole.replace("?>\n", "?>\n<!DOCTYPE a [<!ENTITY b \"c\">]>"),
            "line 2: has a document type declaration",
        ),
        (
            whole.replace("name=\"x\"", "name=\"x\" name=\"y\""),
            "line 4: ",
        ),
        (
            whole.replace("modelName=\"a\"", "modelName=\"&b;\""),
            "line 2: attribute `modelName`: ",
        ),
        (whole.replace("guid=\"g\"", "guid=g"), "line 2: "),
        (
            whole.replace("fmiModelDescription", "other"),
            "there is no root element of a known name",
        ),
        (String::new(), "there is no root element of a known name"),
    ];
    for (text, message) in cases {
        let error = ModelDescription::from_xml(&text)
            .expect_err(message)
            .to_string();
        assert!(error.starts_with("modelDescription.xml, "), "{error}");
        assert!(error.contains(message), "{error}\n  should say\n{message}");
    }
    let escaped = whole.replace("name=\"x\"", "name=\"&lt;&#120;&gt;\"");
    assert_eq!(
        ModelDescription::from_xml(&escaped).unwrap().variables[0].name,
        "<x>"
    );
}

/// Each text of 1 MiB takes less than a second, even without optimisation; quadratic time would be minutes.
#[test]
fn descriptions_are_read_in_linear_time() {
    const BYTES: usize = 1 << 20;
    let many = |item: &dyn Fn(usize) -> String| {
        let mut text = String::with_capacity(BYTES + 100);
        let mut index = 0;
        while text.len() < BYTES {
            text += &item(index);
            index += 1;
        }
        text
    };
    let whole = |extra: &str| fmi2_description(extra, &input(""));
    let units = many(&|i| format!("<Unit name=\"{i}\"><BaseUnit/></Unit>"));
    let nested = "<Unit>".repeat(BYTES / 13) + &"</Unit>".repeat(BYTES / 13);
    let texts = [
        (
            "attributes",
            whole(&format!("<a {}/>", many(&|i| format!(" a{i}=\"1\"")))),
            true,
        ),
        (
            "known attributes of many elements",
            whole(&many(&|i| format!("<Unit name=\"{i}\"/>"))),
            true,
        ),
        (
            "prefixes",
            whole(&format!(
                "<a {}/>",
                many(&|i| format!(" xmlns:a{i}=\"b{i}\""))
            )),
            true,
        ),
        (
            "one attribute again and again",
            whole(&format!("<a {}/>", " a=\"1\"".repeat(BYTES / 6))),
            false,
        ),
        ("elements", whole(&many(&|i| format!("<a{i}/>"))), true),
        ("nested elements", whole(&nested), true),
        ("text", whole(&"x".repeat(BYTES)), true),
        ("references", whole(&"&amp;".repeat(BYTES / 5)), true),
        (
            "a value",
            whole(&format!("<a b=\"{}\"/>", "&#x20;".repeat(BYTES / 6))),
            true,
        ),
        ("comments", whole(&"<!---->".repeat(BYTES / 7)), true),
        ("an open comment", whole(&"<!--".repeat(BYTES / 4)), false),
        ("open tags", whole(&"<a ".repeat(BYTES / 3)), false),
        ("lines", whole(&"\n".repeat(BYTES)), true),
        (
            "units",
            whole(&format!("<UnitDefinitions>{units}</UnitDefinitions>")),
            true,
        ),
        (
            "variables",
            fmi2_description(
                "",
                &many(&|i| input("").replace("\"x\"", &format!("\"x{i}\""))),
            ),
            true,
        ),
    ];
    for (what, text, is_read) in texts {
        let start = Instant::now();
        assert_eq!(ModelDescription::from_xml(&text).is_ok(), is_read, "{what}");
        let took = start.elapsed();
        println!("{what}: {} bytes, {took:?}", text.len());
        assert!(took < Duration::from_secs(20), "{what} took {took:?}");
    }
}
