use super::{OpenScenarioSource, ParameterDistributionFile};
use crumple_core::observer::Quiet;
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LaneChange, LeadProfile, Scenario};

/// A road of two lanes of 3.5 m to the right of the reference line, which starts at x = 10 m.
pub(super) const ROAD: &str = r#"<OpenDRIVE><road id="7" length="5000" junction="-1">
<planView><geometry s="0" x="10" y="0" hdg="0" length="5000"><line/></geometry></planView>
<lanes><laneSection s="0"><center><lane id="0"/></center><right>
<lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
</right></laneSection></lanes></road></OpenDRIVE>"#;

pub(super) const TIME: &str = r#"<ByValueCondition>
<SimulationTimeCondition value="2" rule="greaterOrEqual"/></ByValueCondition>"#;

/// Returns a file with a vehicle `other` that does an action when a condition is true, and the vehicle `ego` behind it.
pub(super) fn file(position: &str, action: &str, condition: &str) -> String {
    let vehicle = |name: &str, controller: &str| {
        format!(
            r#"<ScenarioObject name="{name}"><Vehicle name="car" vehicleCategory="car"><BoundingBox>
<Center x="1.5" y="0" z="0.7"/><Dimensions width="1.5" length="5" height="1.5"/></BoundingBox>
<Performance maxSpeed="70" maxAcceleration="5" maxDeceleration="8"/><Axles/></Vehicle>{controller}</ScenarioObject>"#
        )
    };
    let controller = r#"<ObjectController><Controller name="mine"><Properties/></Controller></ObjectController>"#;
    let private = |name: &str, position: &str, speed: &str| {
        format!(
            r#"<Private entityRef="{name}"><PrivateAction><TeleportAction><Position>{position}</Position>
</TeleportAction>
</PrivateAction><PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="step"
dynamicsDimension="time" value="0"/><SpeedActionTarget>{speed}</SpeedActionTarget></SpeedAction>
</LongitudinalAction>
</PrivateAction></Private>"#
        )
    };
    format!(
        r#"<OpenSCENARIO>
<FileHeader revMajor="1" revMinor="2" date="2024-01-01T00:00:00" author="a" description="Two cars"/>
<ParameterDeclarations><ParameterDeclaration name="speed" parameterType="double" value="72">
<ConstraintGroup>
<ValueConstraint rule="greaterThan" value="0"/><ValueConstraint rule="lessOrEqual" value="${{2 * 54}}"/>
</ConstraintGroup>
</ParameterDeclaration><ParameterDeclaration name="rate" parameterType="double" value="4"/></ParameterDeclarations>
<CatalogLocations/><RoadNetwork><LogicFile filepath="f.xodr"/></RoadNetwork>
<Entities>{}{}</Entities><Storyboard><Init><Actions>{}{}</Actions></Init><Story name="s"><Act name="a">
<ManeuverGroup name="g" maximumExecutionCount="1"><Actors selectTriggeringEntities="false">
<EntityRef entityRef="other"/></Actors><Maneuver name="m"><Event name="e" priority="override"><Action name="act">
<PrivateAction>{action}</PrivateAction>
</Action><StartTrigger><ConditionGroup><Condition name="c" delay="0.5" conditionEdge="rising">{condition}</Condition>
</ConditionGroup></StartTrigger></Event></Maneuver></ManeuverGroup></Act></Story>
<StopTrigger><ConditionGroup><Condition name="end" delay="1" conditionEdge="rising"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="action" storyboardElementRef="act" state="completeState"/>
</ByValueCondition></Condition></ConditionGroup></StopTrigger></Storyboard></OpenSCENARIO>"#,
        vehicle("ego", controller),
        vehicle("other", ""),
        private(
            "ego",
            r#"<WorldPosition x="110" y="-1.75"/>"#,
            r#"<AbsoluteTargetSpeed value="${round($speed) / 3.6}"/>"#
        ),
        private(
            "other",
            position,
            r#"<RelativeTargetSpeed entityRef="ego" value="0" speedTargetValueType="delta" continuous="false"/>"#
        ),
    )
}

pub(super) fn same_lane() -> &'static str {
    r#"<LanePosition roadId="7" laneId="-1" offset="0" s="140"/>"#
}

pub(super) fn speed_action(shape: &str, dimension: &str, value: &str, target_mps: f64) -> String {
    format!(
        r#"<LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}"
value="{value}"/><SpeedActionTarget><AbsoluteTargetSpeed value="{target_mps}"/></SpeedActionTarget></SpeedAction>
</LongitudinalAction>"#
    )
}

pub(super) fn lane_change(target: &str) -> String {
    format!(
        r#"<LateralAction><LaneChangeAction><LaneChangeActionDynamics dynamicsShape="linear" dynamicsDimension="time"
value="3.5"/><LaneChangeTarget><AbsoluteTargetLane value="{target}"/></LaneChangeTarget></LaneChangeAction>
</LateralAction>"#
    )
}

fn import(text: &str) -> Result<Scenario, String> {
    let source = OpenScenarioSource::from_bytes(text.as_bytes(), ROAD.as_bytes())
        .map_err(|error| error.to_string())?;
    source
        .scenario(None, &[])
        .map(|imported| imported.scenario)
        .map_err(|error| error.to_string())
}

/// Returns the first and the last speed of the leader, and its largest braking and acceleration, in a simulation.
fn drive(scenario: &Scenario) -> [f64; 4] {
    let options = RunOptions::new(BuiltInController::from_name("match-leader").unwrap())
        .with_estimator(EstimatorKind::Truth);
    let trace = simulate(&Run::new(scenario, options).unwrap(), RecordingLevel::Trace)
        .trace
        .unwrap();
    let speeds = &trace.vehicles[0].speed_mps;
    let rates = || speeds.windows(2).map(|pair| (pair[1] - pair[0]) / 0.01);
    [
        speeds[0],
        *speeds.last().unwrap(),
        rates().fold(0.0, f64::min),
        rates().fold(0.0, f64::max),
    ]
}

#[test]
fn speed_actions_of_all_shapes_become_scripts() {
    let scenario = import(&file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    ))
    .unwrap();
    let [other, ego] = scenario.vehicles() else {
        panic!("{scenario:?}")
    };
    // The reference point is the rear axle, 1.5 m behind the middle.
    assert_eq!(
        (other.position_m, ego.position_m, other.speed_mps),
        (154.0, 114.0, 20.0)
    );
    assert_eq!(
        (other.length_m, other.max_brake_mps2, &ego.driver),
        (Some(5.0), Some(8.0), &Driver::UnderTest)
    );
    let Driver::Profile(LeadProfile::BrakeToSpeed(brake)) = &other.driver else {
        panic!("{other:?}")
    };
    assert_eq!(
        (brake.onset_s, brake.rate_mps2, brake.final_speed_mps),
        (2.5, 4.0, 10.0)
    );
    assert_eq!(scenario.spec().duration_s, 2.5 + 2.5 + 1.0);
    for (shape, dimension, value, hardest_mps2) in [
        ("cubic", "time", "5", 3.0),
        ("sinusoidal", "rate", "3", 3.0),
        // The speed is linear over the distance: 20 m/s times 10 m/s in 75 m.
        ("linear", "distance", "75", 20.0 * 10.0 / 75.0),
    ] {
        let scenario = import(&file(
            same_lane(),
            &speed_action(shape, dimension, value, 10.0),
            TIME,
        ))
        .unwrap();
        let [from_mps, to_mps, lowest_mps2, highest_mps2] = drive(&scenario);
        assert_eq!((from_mps, highest_mps2), (20.0, 0.0), "{shape}");
        assert!(
            (to_mps - 10.0).abs() < 1e-9 && (lowest_mps2 + hardest_mps2).abs() < 0.01,
            "{shape}: {lowest_mps2}"
        );
    }
    let refused = import(&file(
        same_lane(),
        &speed_action("step", "time", "0", 10.0),
        TIME,
    ))
    .unwrap_err();
    let expected = ": SpeedAction: at 2.50 s the speed of `other` changes at -1000.0 m/s², \
        outside its limits of -8 and 5 m/s²";
    assert!(refused.contains(expected), "{refused}");
}

#[test]
fn lane_changes_take_effect_when_the_side_of_the_body_crosses_the_marking() {
    // The vehicle of 1.5 m leaves 1 m on each side, and changes 3.5 m in 3.5 s.
    let other_lane = same_lane().replace("\"-1\"", "\"-2\"");
    let scenario = import(&file(&other_lane, &lane_change("-1"), TIME)).unwrap();
    let Some(LaneChange::At(enters_s)) = scenario.vehicles()[0].enters else {
        panic!("{scenario:?}")
    };
    assert!((enters_s - 3.5).abs() < 1e-9, "{enters_s}");
    let scenario = import(&file(same_lane(), &lane_change("-2"), TIME)).unwrap();
    let Some(LaneChange::At(leaves_s)) = scenario.vehicles()[0].leaves else {
        panic!("{scenario:?}")
    };
    assert!((leaves_s - 5.0).abs() < 1e-9, "{leaves_s}");
    let near = r#"<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="other"/>
</TriggeringEntities><EntityCondition><TimeHeadwayCondition entityRef="ego" value="2" freespace="true"
coordinateSystem="lane" relativeDistanceType="longitudinal" rule="greaterThan"/></EntityCondition>
</ByEntityCondition>"#;
    let faster = |text: &str| {
        text.replace(
            r#"entityRef="ego" value="0""#,
            r#"entityRef="ego" value="5""#,
        )
    };
    let scenario = import(&faster(&file(&other_lane, &lane_change("-1"), near))).unwrap();
    let Some(LaneChange::Gap(gap_m)) = scenario.vehicles()[0].enters else {
        panic!("{scenario:?}")
    };
    // Fifty metres at the trigger, then half a second of delay and one second to the marking.
    assert!((gap_m - 57.5).abs() < 1e-6, "{gap_m}");
}

#[test]
fn content_that_one_lane_cannot_represent_is_refused_by_name() {
    let good = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    for (old, new, expected) in [
        (
            "SimulationTimeCondition",
            "TimeOfDayCondition",
            "TimeOfDayCondition: depends on the time of day",
        ),
        (
            "revMajor=\"1\"",
            "revMajor=\"2\"",
            "FileHeader: only versions 1.0 to 1.3",
        ),
        (
            "entityRef=\"other\"",
            "entityRef=\"unknown\"",
            "there is no entity `unknown`",
        ),
        (
            "override",
            "sometimes",
            "Event: `priority` = `sometimes` is not supported, only override, skip, parallel",
        ),
        (
            "LongitudinalAction>",
            "InstantAction>",
            "InstantAction: is not supported",
        ),
        (
            "s=\"140\"",
            "s=\"9000\"",
            "LanePosition: 9000 m is outside the road",
        ),
        (
            "name=\"mine\"",
            "name=\"mine\" sort=\"x\"",
            "Controller: the attribute `sort` is not supported",
        ),
        (
            "value=\"$rate\"",
            "value=\"$missing\"",
            "there is no parameter `missing`",
        ),
        (
            "${round($speed)",
            "${random($speed)",
            "`random` with 1 values is not supported in an expression",
        ),
        (
            "value=\"72\"",
            "value=\"200\"",
            "`speed` = `200` violates its constraints",
        ),
        (
            "storyboardElementRef=\"act\"",
            "storyboardElementRef=\"x\"",
            "there is no action `x`",
        ),
        (
            "<StopTrigger>",
            "<StopTrigger/><StopTrigger>",
            "Storyboard: has no stop trigger",
        ),
        (
            "y=\"-1.75\"",
            "y=\"-1.75\" h=\"1.5\"",
            "WorldPosition: `h` differs from the direction of the lane",
        ),
        (
            "y=\"-1.75\"",
            "y=\"-1.75\" p=\"0.1\"",
            "WorldPosition: `p` differs from the direction of the lane",
        ),
        (
            "<CatalogLocations/>",
            "<ParameterValueDistribution/>",
            "OpenSCENARIO: is a file of distributions",
        ),
        (
            "<EntityRef entityRef=\"other\"/></Actors>",
            "</Actors>",
            "Actors: names no entity",
        ),
        (
            "mine\"><Properties/>",
            "idm\"><Properties><Property name=\"gap\" value=\"1\"/></Properties>",
            "Controller: ",
        ),
        (
            "s=\"140\"",
            "s=\"101\"",
            "the scenario is outside the ranges of crumple: vehicles[1].position_m",
        ),
    ] {
        let damaged = good.replace(old, new);
        assert_ne!(damaged, good, "{old}");
        let error = import(&damaged).expect_err(new);
        assert!(
            error.starts_with("f.xosc:") && error.contains(expected) && !error.contains('\n'),
            "{new}: {error}"
        );
    }
    let curved = ROAD.replace("<line/>", "<arc curvature=\"0.001\"/>");
    let error = OpenScenarioSource::from_bytes(good.as_bytes(), curved.as_bytes())
        .unwrap()
        .scenario(None, &[]);
    assert_eq!(
        error.unwrap_err().to_string(),
        "f.xodr:2: arc: the road must be straight, or have bends with radii of 2000 m or more"
    );
    let many = "<a b=''>".repeat(1_100_000);
    assert!(
        import(&many)
            .unwrap_err()
            .contains(":1: there are more than 1000000 tags and attributes")
    );
    let deep = "<a>".repeat(100_000);
    assert!(import(&deep).unwrap_err().contains("nested deeper than 64"));
    let parentheses = good.replace("${round($speed)", &format!("${{{}", "(".repeat(900)));
    assert!(
        import(&parentheses)
            .unwrap_err()
            .contains("nested deeper than 50")
    );
}

#[test]
fn assumptions_and_content_without_influence_are_noted_with_their_lines() {
    let relative =
        r#"<RelativeTargetSpeed entityRef="ego" value="-5" speedTargetValueType="delta"/>"#;
    let slower = speed_action("linear", "rate", "2", 10.0)
        .replace("<AbsoluteTargetSpeed value=\"10\"/>", relative);
    let good = file(same_lane(), &slower, TIME);
    let notes = |old: &str, new: &str, road: &str| {
        let text = good.replace(old, new);
        let source = OpenScenarioSource::from_bytes(text.as_bytes(), road.as_bytes()).unwrap();
        source.scenario(None, &[]).unwrap().notes
    };
    let [relative, never] = &notes("", "", ROAD)[..] else {
        panic!("two notes")
    };
    assert!(
        relative
            .ends_with("SpeedAction: is relative to `ego`, as if the default controller drove it"),
        "{relative}"
    );
    assert!(
        never.ends_with(
            "ScenarioObject: the controller is never activated: it drives from the start"
        ),
        "{never}"
    );
    let until = r#"<SimulationTimeCondition value="9" rule="greaterThan"/>"#;
    let falling = good.replace(
        "<StoryboardElementStateCondition storyboardElementType=\"action\" ",
        until,
    );
    let falling = falling.replace("storyboardElementRef=\"act\" state=\"completeState\"/>", "");
    let property =
        |name: &str| format!("<Properties><Property name=\"{name}\" value=\"idm\"/></Properties>");
    for (old, new, expected) in [
        (
            &*good,
            falling.replace(
                "delay=\"0.5\" conditionEdge=\"rising",
                "delay=\"0\" conditionEdge=\"falling",
            ),
            ": Event: `e` never",
        ),
        (
            &*good,
            falling.replace("value=\"2\" rule", "value=\"20\" rule"),
            ": Event: `e` never starts within the 10 s",
        ),
        (
            "<Properties/>",
            property("sensor"),
            ": Controller: properties without influence on the motion: sensor",
        ),
        (
            "<Axles/>",
            "<Axles/>".to_owned() + &property("paint"),
            ": Vehicle: properties without influence on the motion: paint",
        ),
        (
            "<Axles/>",
            "<Axles/>".to_owned() + &property("driver"),
            "driver = `idm` contradicts the controller `mine`",
        ),
    ] {
        let messages = notes(old, &new, ROAD);
        assert!(
            messages
                .iter()
                .any(|note| note.starts_with("f.xosc:") && note.contains(expected)),
            "{expected}: {messages:?}"
        );
    }
    let messages = notes("", "", &ROAD.replace("5000", "150"));
    assert!(
        messages
            .iter()
            .any(|note| note.contains("is outside the road `7` of 150 m, at the end")),
        "{messages:?}"
    );
}

fn distributions(content: &str) -> Result<ParameterDistributionFile, String> {
    let text = format!(
        r#"<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" author="" description=""/>
<ParameterValueDistribution><ScenarioFile filepath="x/f.xosc"/>{content}</ParameterValueDistribution></OpenSCENARIO>"#
    );
    ParameterDistributionFile::from_bytes(text.as_bytes()).map_err(|error| error.to_string())
}

#[test]
fn distributions_give_variations_or_a_space() {
    let text = file(
        same_lane(),
        &speed_action("linear", "rate", "$rate", 10.0),
        TIME,
    );
    let source = OpenScenarioSource::from_bytes(text.as_bytes(), ROAD.as_bytes()).unwrap();
    let varied = distributions(
        r#"<Deterministic><DeterministicSingleParameterDistribution parameterName="rate">
<DistributionRange stepWidth="0.1">
<Range lowerLimit="1" upperLimit="2"/></DistributionRange></DeterministicSingleParameterDistribution>
<DeterministicMultiParameterDistribution><ValueSetDistribution><ParameterValueSet><ParameterAssignment
parameterRef="speed" value="90"/></ParameterValueSet><ParameterValueSet><ParameterAssignment parameterRef="speed"
value="300"/></ParameterValueSet></ValueSetDistribution></DeterministicMultiParameterDistribution></Deterministic>"#,
    );
    let variations = varied.unwrap().variations().unwrap();
    assert_eq!(variations.len(), 22);
    assert_eq!(
        variations[6],
        [
            ("rate".to_owned(), "1.3".to_owned()),
            ("speed".to_owned(), "90".to_owned())
        ]
    );
    assert_eq!(
        variations
            .iter()
            .filter(|variation| source.scenario(None, variation).is_ok())
            .count(),
        11,
        "one speed is too high"
    );

    let stochastic = |name: &str, distribution: &str| {
        distributions(&format!(
            r#"<Stochastic numberOfTestRuns="9"><StochasticDistribution parameterName="{name}">{distribution}
</StochasticDistribution>
</Stochastic>"#
        ))
    };
    let histogram = r#"<Histogram><HistogramBin weight="1"><Range lowerLimit="2" upperLimit="3"/></HistogramBin>
<HistogramBin weight="3"><Range lowerLimit="4" upperLimit="6"/></HistogramBin></Histogram>"#;
    for (distribution, mean_mps2) in [
        (histogram, 0.25 * 2.5 + 0.75 * 5.0),
        (
            r#"<UniformDistribution><Range lowerLimit="2" upperLimit="6"/></UniformDistribution>"#,
            4.0,
        ),
        (
            r#"<NormalDistribution expectedValue="4" variance="0.25"/>"#,
            4.0,
        ),
    ] {
        let (space, _) = source
            .space(None, &stochastic("rate", distribution).unwrap(), &Quiet)
            .unwrap();
        assert_eq!(
            space.spec().parameters[0].field,
            "vehicles[0].driver.brake-to-speed.rate_mps2"
        );
        let rate = |index| match &space.draw(1, index).unwrap().vehicles()[0].driver {
            Driver::Profile(LeadProfile::BrakeToSpeed(brake)) => brake.rate_mps2,
            other => panic!("{other:?}"),
        };
        let mean = (0..2000).map(rate).sum::<f64>() / 2000.0;
        assert!((mean - mean_mps2).abs() < 0.1, "{distribution}: {mean}");
    }
    let uniform =
        r#"<UniformDistribution><Range lowerLimit="50" upperLimit="60"/></UniformDistribution>"#;
    let refused = source
        .space(None, &stochastic("speed", uniform).unwrap(), &Quiet)
        .unwrap_err()
        .to_string();
    assert!(
        refused.contains("`speed` changes vehicles[0].speed_mps, vehicles[1].speed_mps, not"),
        "{refused}"
    );
    let twice = distributions(
        r#"<Stochastic numberOfTestRuns="9"><StochasticDistribution parameterName="rate"><NormalDistribution
expectedValue="4" variance="1"/></StochasticDistribution><StochasticDistribution parameterName="rate">
<NormalDistribution expectedValue="5" variance="1"/></StochasticDistribution></Stochastic>"#,
    );
    assert!(
        twice
            .unwrap_err()
            .ends_with("StochasticDistribution: the parameter `rate` has two distributions")
    );
    let refused = stochastic("rate", r#"<PoissonDistribution expectedValue="4"/>"#).unwrap_err();
    assert!(
        refused.ends_with("PoissonDistribution: is not supported in `StochasticDistribution`"),
        "{refused}"
    );
}

/// Returns the error of a file in which `old` is replaced, without its path, and the line of `old`.
fn refusal(good: &str, [old, new]: [&str; 2]) -> (String, usize) {
    let (before, _) = good
        .split_once(old)
        .unwrap_or_else(|| panic!("no {old} in {good}"));
    let line = 1 + before.matches('\n').count();
    let message = import(&good.replacen(old, new, 1)).expect_err(new);
    (message, line)
}

/// ASAM OpenSCENARIO XML 1.3.1: delays, distances, headways and times to collision are from 0 on, and a transition
/// reaches its target. A scenario ends after its start.
#[test]
fn values_out_of_range_are_refused_at_their_element() {
    let good = file(
        same_lane(),
        &speed_action("linear", "rate", "4", 10.0),
        TIME,
    );
    import(&good).expect("good");
    let stop = |value: &str| {
        let condition = format!(
            r#"<Condition name="end" delay="0" conditionEdge="none"><ByValueCondition>
<SimulationTimeCondition value="{value}" rule="greaterThan"/>"#
        );
        let old = r#"<Condition name="end" delay="1" conditionEdge="rising"><ByValueCondition>
<StoryboardElementStateCondition storyboardElementType="action" storyboardElementRef="act" state="completeState"/>"#;
        good.replace(old, &condition)
    };
    import(&stop("3")).expect("good");
    let headway = |value: &str| {
        let condition = format!(
            r#"<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="other"/>
</TriggeringEntities><EntityCondition><TimeHeadwayCondition entityRef="ego" value="{value}" freespace="true"
coordinateSystem="lane" relativeDistanceType="longitudinal" rule="greaterThan"/></EntityCondition>
</ByEntityCondition>"#
        );
        good.replace(TIME, &condition)
    };
    for (text, change, element, problem) in [
        (
            good.clone(),
            [
                r#"<Condition name="c" delay="0.5""#,
                r#"<Condition name="c" delay="-0.5""#,
            ],
            "Condition",
            "attribute `delay`: must not be negative, found -0.5",
        ),
        (
            stop("3"),
            [
                "<StopTrigger><ConditionGroup><Condition name=\"end\" delay=\"0\" conditionEdge=\"none\">\
                 <ByValueCondition>\n<SimulationTimeCondition value=\"3\"",
                "<StopTrigger><ConditionGroup><Condition name=\"end\" delay=\"0\" conditionEdge=\"none\">\
                 <ByValueCondition>\n<SimulationTimeCondition value=\"-1\"",
            ],
            "StopTrigger",
            "ends the scenario at 0 s, but it starts at 0 s",
        ),
        (
            headway("2"),
            [
                "<TimeHeadwayCondition entityRef=\"ego\" value=\"2\"",
                "<TimeHeadwayCondition entityRef=\"ego\" value=\"-2\"",
            ],
            "TimeHeadwayCondition",
            "attribute `value`: must not be negative, found -2",
        ),
        (
            good.clone(),
            ["width=\"1.5\" length=\"5\"", "width=\"1.5\" length=\"500\""],
            "Dimensions",
            "length_m: must be from 0.1 to 100, found 500",
        ),
        (
            good.clone(),
            ["<Center x=\"1.5\"", "<Center x=\"1e308\""],
            "Center",
            "position_m: must be from -1000000 to 1000000, found 1e308",
        ),
        (
            good.clone(),
            [
                "<Vehicle name=\"car\"",
                "<Vehicle name=\"car\" mass=\"1e308\"",
            ],
            "Vehicle",
            "mass_kg: must be from 1 to 1000000, found 1e308",
        ),
        (
            good.clone(),
            [
                "<Performance maxSpeed=\"70\" maxAcceleration=\"5\" maxDeceleration=\"8\"",
                "<Performance maxSpeed=\"70\" maxAcceleration=\"5\" maxDeceleration=\"1e308\"",
            ],
            "Performance",
            "max_brake_mps2: must be from 0.1 to 30, found 1e308",
        ),
    ] {
        let (message, line) = refusal(&text, change);
        let expected = format!("f.xosc:{line}: {element}: ");
        assert!(
            message.starts_with(&expected) && message.contains(problem),
            "{message}\n{expected}{problem}"
        );
    }
    let weak = good.replace(
        "maxAcceleration=\"5\" maxDeceleration=\"8\"",
        "maxAcceleration=\"3\" maxDeceleration=\"0\"",
    );
    let message = import(&weak).expect_err("no brakes");
    assert!(
        message.contains("outside its limits of 0 and 3 m/s²"),
        "{message}"
    );
}
