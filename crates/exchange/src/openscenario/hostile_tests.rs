//! Hostile files: extreme values, and more work than the limits allow.

use std::fmt::Write as _;
use std::time::{Duration, Instant};

use super::tests::{ROAD, TIME, file, lane_change, same_lane, speed_action};
use super::{OpenScenarioSource, ParameterDistributionFile};
use crumple_core::observer::Quiet;

/// Values that a number may have by mistake or by intent.
const EXTREME_VALUES: [&str; 12] = [
    "-1",
    "0",
    "-0",
    "1e308",
    "-1e308",
    "1e-320",
    "1e9",
    "-1e9",
    "NaN",
    "inf",
    "",
    "99999999999999999999",
];

fn import(scenario: &str, road: &str) -> Result<(), String> {
    let source = OpenScenarioSource::from_bytes(scenario.as_bytes(), road.as_bytes());
    source
        .and_then(|source| source.scenario(None, &[]))
        .map(drop)
        .map_err(|error| error.to_string())
}

fn trajectory() -> String {
    let vertex = |time_s: usize| {
        let x_m = 150 + 20 * time_s;
        format!(
            "<Vertex time=\"{time_s}\"><Position><WorldPosition x=\"{x_m}\" y=\"-1.75\" h=\"0\"/></Position></Vertex>"
        )
    };
    let vertices: String = (0..4).map(vertex).collect();
    format!(
        r#"<RoutingAction><FollowTrajectoryAction><Trajectory name="t" closed="false"><ParameterDeclarations/><Shape>
<Polyline>{vertices}</Polyline></Shape></Trajectory><TimeReference><Timing domainAbsoluteRelative="relative" scale="1"
offset="0"/></TimeReference><TrajectoryFollowingMode followingMode="position"/></FollowTrajectoryAction>
</RoutingAction>"#
    )
}

fn profile(entries: usize) -> String {
    let entries = "<SpeedProfileEntry time=\"0.1\" speed=\"20\"/>".repeat(entries);
    format!(
        "<LongitudinalAction><SpeedProfileAction followingMode=\"position\">{entries}</SpeedProfileAction>\
         </LongitudinalAction>"
    )
}

/// Returns the texts with each attribute in turn, from the first one after `start` on, replaced by each extreme value.
fn with_extreme_values(text: &str, start: &str) -> Vec<String> {
    let parts: Vec<&str> = text.split('"').collect();
    let before = text
        .split(start)
        .next()
        .unwrap_or_default()
        .matches('"')
        .count();
    let mut changed = Vec::new();
    for index in (before + 1..parts.len()).step_by(2) {
        for value in EXTREME_VALUES {
            let mut parts = parts.clone();
            parts[index] = value;
            changed.push(parts.join("\""));
        }
    }
    changed
}

#[test]
fn no_value_of_an_attribute_panics() {
    let friction = "<GlobalAction><EnvironmentAction><Environment name=\"e\"><RoadCondition frictionScaleFactor=\"1\"/>\
                    </Environment></EnvironmentAction></GlobalAction><Private entityRef=\"ego\">";
    let near = r#"<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="other"/>
</TriggeringEntities><EntityCondition><TimeHeadwayCondition entityRef="other" value="2" freespace="true"
coordinateSystem="lane" relativeDistanceType="longitudinal" rule="greaterThan"/></EntityCondition>
</ByEntityCondition>"#;
    let mut refused = 0;
    for (action, condition) in [
        (speed_action("cubic", "time", "5", 10.0), TIME),
        (speed_action("sinusoidal", "rate", "3", 10.0), near),
        (speed_action("linear", "distance", "75", 10.0), TIME),
        (lane_change("-2"), TIME),
        (
            trajectory(),
            r#"<ByValueCondition><SimulationTimeCondition value="0" rule="greaterOrEqual"/></ByValueCondition>"#,
        ),
        (profile(3), TIME),
    ] {
        let good = file(same_lane(), &action, condition).replacen(
            "<Private entityRef=\"ego\">",
            friction,
            1,
        );
        // The entities and the initial state are those of the first file.
        let start = if refused == 0 {
            "<OpenSCENARIO>"
        } else {
            "<Action "
        };
        for text in with_extreme_values(&good, start) {
            refused += usize::from(import(&text, ROAD).is_err());
        }
    }
    let good = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    refused += with_extreme_values(ROAD, "<OpenDRIVE>")
        .iter()
        .filter(|road| import(&good, road).is_err())
        .count();
    assert!(refused > 800, "{refused}");
    let negative = good.replacen(
        "<Private entityRef=\"ego\">",
        &friction.replace("\"1\"", "\"-1\""),
        1,
    );
    let error = import(&negative, ROAD).unwrap_err();
    let expected =
        "RoadCondition: attribute `frictionScaleFactor`: must be from 0.01 to 1, found -1";
    assert!(
        error.starts_with("f.xosc:") && error.ends_with(expected),
        "{error}"
    );
}

#[test]
fn no_value_of_a_distribution_panics() {
    let scenario = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    let source = OpenScenarioSource::from_bytes(scenario.as_bytes(), ROAD.as_bytes()).unwrap();
    for content in [
        r#"<Stochastic numberOfTestRuns="9"><StochasticDistribution parameterName="rate"><NormalDistribution
expectedValue="4" variance="0.25"><Range lowerLimit="3" upperLimit="5"/></NormalDistribution>
</StochasticDistribution></Stochastic>"#,
        r#"<Stochastic numberOfTestRuns="9"><StochasticDistribution parameterName="rate"><Histogram><HistogramBin
weight="1"><Range lowerLimit="3" upperLimit="5"/></HistogramBin></Histogram></StochasticDistribution></Stochastic>"#,
        r#"<Deterministic><DeterministicSingleParameterDistribution parameterName="rate"><DistributionRange
stepWidth="0.5"><Range lowerLimit="3" upperLimit="4"/></DistributionRange></DeterministicSingleParameterDistribution>
</Deterministic>"#,
    ] {
        for content in with_extreme_values(content, "<") {
            if let Ok(distributions) = distributions(&content) {
                let _ = source.space(None, &distributions, &Quiet);
                for variation in distributions.variations().unwrap_or_default() {
                    let _ = source.scenario(None, &variation);
                }
            }
        }
    }
}

fn distributions(content: &str) -> Result<ParameterDistributionFile, String> {
    let text = format!(
        r#"<OpenSCENARIO><FileHeader/><ParameterValueDistribution><ScenarioFile filepath="f.xosc"/>{content}
</ParameterValueDistribution></OpenSCENARIO>"#
    );
    ParameterDistributionFile::from_bytes(text.as_bytes()).map_err(|error| error.to_string())
}

/// Returns the elements that `element` makes of the numbers below `count`.
fn repeated(count: usize, element: impl Fn(usize) -> String) -> String {
    (0..count).map(element).collect()
}

#[test]
fn excess_content_is_refused_before_work_begins() {
    let good = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    let changed = |old: &str, new: &str| {
        let text = good.replacen(old, new, 1);
        assert_ne!(text, good, "{old}");
        text
    };
    let begin = |text: &str| text.split('>').next().unwrap_or_default().to_owned() + ">";
    let object = &good[good.find("<ScenarioObject").unwrap()..good.find("</Entities>").unwrap()];
    let event = &good[good.find("<Event").unwrap()..good.find("</Maneuver>").unwrap()];
    let condition =
        &event[event.find("<Condition ").unwrap()..event.find("</ConditionGroup>").unwrap()];
    let group = format!("<ConditionGroup>{condition}</ConditionGroup>");
    let reference = "<EntityRef entityRef=\"other\"/>";
    let late = condition.replace("delay=\"0.5\"", "delay=\"3000\"");
    let attributes = repeated(200, |index| format!(" a{index}=''"));
    let mut parameters = String::new();
    for index in 0..2000 {
        let _ = write!(
            parameters,
            "<ParameterDeclaration name=\"p{index}\" parameterType=\"string\" value=\"1\"/>"
        );
    }
    let long = format!(
        "<ParameterDeclaration name=\"p\" parameterType=\"string\" value=\"{}\"/>",
        "1".repeat(2000)
    );
    let entity_condition = format!(
        "<ByEntityCondition><TriggeringEntities triggeringEntitiesRule=\"any\">{}</TriggeringEntities>\
         </ByEntityCondition>",
        reference.repeat(100_001)
    );
    let curved = speed_action("cubic", "time", "3000", 10.0);
    let action = format!("<Action name=\"b\"><PrivateAction>{curved}</PrivateAction></Action>");
    for (text, expected) in [
        (
            changed(object, &object.repeat(600)),
            "Entities: has more than 1000 entities",
        ),
        (
            changed(
                "<Init><Actions>",
                &format!("<Init><Actions>{}", "<Private/>".repeat(10_001)),
            ),
            "more than 10000 act",
        ),
        (
            changed(
                "<Init><Actions>",
                &format!("<Init><Actions>{}", "<GlobalAction/>".repeat(101)),
            ),
            "Actions: has more than 100 environments",
        ),
        (
            changed(event, &event.repeat(2001)),
            "ManeuverGroup: has more than 2000 events",
        ),
        (
            changed(reference, &reference.repeat(1001)),
            "Actors: has more than 1000 entities",
        ),
        (
            changed(
                "<Act name=\"a\">",
                &format!("{}<Act name=\"a\">", "<Act name=\"b\"></Act>".repeat(2001)),
            ),
            "2000 acts",
        ),
        (
            changed(reference, &reference.repeat(900)).replace(event, &event.repeat(30)),
            "Event: has more than 20000 actions of events, each counted for each of its entities",
        ),
        (
            changed(&group, &group.repeat(6000)),
            "ConditionGroup: there are more than 10000 conditions",
        ),
        (
            changed(condition, &condition.repeat(11_000)),
            "ConditionGroup: there are more than 10000 conditions",
        ),
        (
            changed(condition, &late.repeat(40)),
            "Condition: the delays of all conditions exceed 100000 s",
        ),
        (
            changed(TIME, &entity_condition),
            "TriggeringEntities: there are more than 100000 entities in conditions",
        ),
        (
            changed(
                "<Action name=\"act\">",
                &format!("{}<Action name=\"act\">", action.repeat(2)),
            ),
            "SpeedAction: the scenario has more than 400000 samples of curved transitions",
        ),
        (
            file(same_lane(), &profile(150_000), TIME).replace(reference, &reference.repeat(3)),
            "Action: the scenario has more than 400000 samples",
        ),
        (
            changed(
                "<ParameterDeclarations>",
                &format!("<ParameterDeclarations>{parameters}"),
            ),
            "has more than 1000 param",
        ),
        (
            changed(
                "<ParameterDeclarations>",
                &format!("<ParameterDeclarations>{long}"),
            ),
            "of `p` has more than 1000 bytes",
        ),
        (
            changed(
                "${round($speed)",
                &format!("${{{}round($speed)", "1+".repeat(600)),
            ),
            "has more than 1000 bytes",
        ),
        (
            changed(
                "<CatalogLocations/>",
                &format!("<CatalogLocations{attributes}/>"),
            ),
            "has more than 100 attributes",
        ),
        (
            changed(
                "<CatalogLocations/>",
                &format!("<CatalogLocations>{}</CatalogLocations>", "<A/>".repeat(51)),
            ),
            "CatalogLocations: has more than 50 folders",
        ),
        (
            changed(
                "<Properties/>",
                &format!("<Properties>{}</Properties>", "<Property/>".repeat(101)),
            ),
            "Controller: has more than 100 properties",
        ),
        (
            changed(
                &begin(object),
                &begin(object).replace("ego", &"e".repeat(70_000)),
            ),
            "has more than 65536 bytes",
        ),
    ] {
        let began = Instant::now();
        let error = import(&text, ROAD).expect_err(expected);
        assert!(
            error.starts_with("f.xosc:") && error.contains(expected),
            "{expected}: {error}"
        );
        assert!(
            began.elapsed() < Duration::from_secs(10),
            "{expected}: {:?}",
            began.elapsed()
        );
        assert!(error.len() < 1000, "{}", error.len());
    }
    let lanes = "<lane id=\"-3\" type=\"driving\"><width a=\"1\"/></lane>".repeat(201);
    let error = import(&good, &ROAD.replace("<right>", &format!("<right>{lanes}"))).unwrap_err();
    assert!(error.contains("right: has more than 200 lanes"), "{error}");
}

#[test]
fn all_variations_share_one_work_budget() {
    let stop = r#"<StoryboardElementStateCondition storyboardElementType="action" storyboardElementRef="act"
state="completeState"/>"#
        .replace('\n', " ");
    let condition = r#"<SimulationTimeCondition value="3500" rule="greaterThan"/>"#;
    let text = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    assert!(text.contains(&stop), "{text}");
    let text = text.replace(&stop, condition);
    let source = OpenScenarioSource::from_bytes(text.as_bytes(), ROAD.as_bytes()).unwrap();
    let began = Instant::now();
    let refused = (0..10_000)
        .find_map(|_| source.scenario(None, &[]).err())
        .expect("too much work");
    assert!(
        refused
            .to_string()
            .contains("Storyboard: the import needs more than 4000000000 units of work"),
        "{refused}"
    );
    assert!(
        began.elapsed() < Duration::from_secs(60),
        "{:?}",
        began.elapsed()
    );
}

#[test]
fn positions_that_depend_on_each_other_are_resolved_in_any_order() {
    let text = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    let object = &text
        [text.find("<ScenarioObject name=\"other\"").unwrap()..text.find("</Entities>").unwrap()];
    let start = text.find("<Private entityRef=\"other\"").unwrap();
    let private = &text[start..text.find("</Actions>").unwrap()];
    // Each is 30 m behind the next one, in the order of the file.
    let chain = |last: &str| {
        let private_at = |index: usize| {
            let next = if index == 899 {
                last.to_owned()
            } else {
                format!("v{}", index + 1)
            };
            let position =
                format!("<RelativeLanePosition entityRef=\"{next}\" dLane=\"0\" ds=\"-5.01\"/>");
            private
                .replace("\"other\"", &format!("\"v{index}\""))
                .replace(same_lane(), &position)
        };
        let objects = repeated(900, |index| {
            object.replace("\"other\"", &format!("\"v{index}\""))
        });
        let privates = repeated(900, private_at);
        let text = text.replace("</Entities>", &format!("{objects}</Entities>"));
        text.replace("</Actions>", &format!("{privates}</Actions>"))
            .replace("s=\"140\"", "s=\"4800\"")
    };
    let source =
        OpenScenarioSource::from_bytes(chain("other").as_bytes(), ROAD.as_bytes()).unwrap();
    let scenario = source.scenario(None, &[]).unwrap().scenario;
    assert_eq!(scenario.vehicles().len(), 902);
    let [first, second] = &scenario.vehicles()[..2] else {
        panic!("902 vehicles")
    };
    assert!((first.position_m - second.position_m - 5.01).abs() < 1e-9);
    let circle = import(&chain("v0"), ROAD).unwrap_err();
    assert!(
        circle.contains("Init: positions of entities are relative to each other in a circle"),
        "{circle}"
    );
}
