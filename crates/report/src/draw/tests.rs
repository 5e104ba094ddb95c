//! Properties of finished figures, read back from their SVG and PNG.

use std::collections::HashSet;

use proptest::num::f64::ANY as ANY_NUMBER;
use proptest::prelude::*;
use resvg::{tiny_skia, usvg};

use super::*;
use crumple_sim::control::{AebSettings, BuiltInController};
use crumple_sim::engine::{
    AfterCollision, Collision, Impact, RecordingLevel, Run, RunOptions, Trace, Track, simulate,
};
use crumple_sim::scenario::{
    Brake, Driver, LeadProfile, VehicleClass, VehicleSpec, built_in_scenario,
};

/// Simulates the paper's first scenario with these vehicles, 16 m apart. Followers brake fully below a time to
/// collision of `ttc_s`; without it they brake as the leader does, each 0.1 s after its leader.
fn simulate_line(
    heavy: &[bool],
    ttc_s: Option<f64>,
    after_collision: AfterCollision,
) -> (Trace, Vec<Impact>) {
    let scenario = built_in_scenario("paper-1").unwrap().edited(|spec| {
        let mut position_m = 36.0;
        let vehicle = |(rank, &heavy): (usize, &bool)| {
            let class = if heavy {
                VehicleClass::Heavy
            } else {
                VehicleClass::Light
            };
            let driver = match (rank, ttc_s) {
                (1.., Some(ttc_s)) => {
                    Driver::Controller(BuiltInController::Baseline(AebSettings { ttc_s }))
                }
                _ => Driver::Profile(LeadProfile::Brake(Brake {
                    onset_s: 1.0 + 0.1 * rank as f64,
                    rate_mps2: 3.0,
                })),
            };
            let vehicle = VehicleSpec::new(class, position_m, 25.0, driver);
            position_m -= class.length_m() + 16.0;
            vehicle
        };
        spec.vehicles = heavy.iter().enumerate().map(vehicle).collect();
    });
    let scenario = scenario.unwrap();
    let nobody = RunOptions::new(BuiltInController::MatchLeader(Default::default()));
    let simulated = simulate(
        &Run::new(&scenario, nobody.with_after_collision(after_collision)).unwrap(),
        RecordingLevel::Trace,
    );
    (simulated.trace.unwrap(), simulated.impacts)
}

const LAYOUTS: [PanelArrangement; 3] = [
    PanelArrangement::Wide,
    PanelArrangement::Stacked,
    PanelArrangement::Column,
];

fn vehicle_labels(count: usize) -> Vec<String> {
    (0..count)
        .map(|index| format!("vehicle of rank {index} <&>\u{7}"))
        .collect()
}

fn draw_figure(trace: &Trace, impacts: &[Impact], layout: PanelArrangement) -> Svg {
    let labels = vehicle_labels(trace.vehicles.len());
    let title = "Scenario 1 & others <with a long title>, vehicles stick together";
    draw_motion(
        &MotionFigure {
            prefix: "fig",
            title,
            labels: &labels,
            trace,
            impacts,
        },
        layout,
    )
}

fn parse_tree(svg: &Svg) -> usvg::Tree {
    usvg::Tree::from_str(&svg.document(), &png::usvg_options()).expect("valid SVG")
}

fn collect_text_boxes(group: &usvg::Group, boxes: &mut Vec<(String, PixelRect)>) {
    for node in group.children() {
        match node {
            usvg::Node::Group(group) => collect_text_boxes(group, boxes),
            usvg::Node::Text(text) => {
                let area = text.abs_bounding_box();
                let [left, top, width, height] =
                    [area.left(), area.top(), area.width(), area.height()].map(f64::from);
                let content = text.chunks().iter().map(usvg::TextChunk::text).collect();
                boxes.push((
                    content,
                    PixelRect {
                        left,
                        top,
                        width,
                        height,
                    },
                ));
            }
            _ => {}
        }
    }
}

fn track(length_m: f64, position_m: Vec<f64>, speed_mps: Vec<f64>) -> Track {
    Track {
        in_lane_s: Track::THROUGHOUT_S,
        length_m,
        mass_kg: 1_500.0,
        acceleration_mps2: vec![0.0; speed_mps.len()],
        position_m,
        speed_mps,
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(8))]

    #[test]
    fn texts_of_a_figure_lie_inside_and_do_not_overlap(
        heavy in proptest::collection::vec(any::<bool>(), 2..=20), ttc_s in proptest::option::of(0.8..3.0f64),
        go_on in any::<bool>(), layout in proptest::sample::select(LAYOUTS.to_vec()),
    ) {
        let after_collision = if go_on { AfterCollision::Continue } else { AfterCollision::Stop };
        let (trace, impacts) = simulate_line(&heavy, ttc_s, after_collision);
        let svg = draw_figure(&trace, &impacts, layout);
        let mut boxes = Vec::new();
        collect_text_boxes(parse_tree(&svg).root(), &mut boxes);
        prop_assert!(boxes.len() > 20);
        let (width, height) = svg.size();
        let whole = PixelRect { left: 0.0, top: 0.0, width, height };
        for (rank, (text, area)) in boxes.iter().enumerate() {
            prop_assert!(whole.encloses(area), "{text:?} leaves the figure: {area:?}");
            // Boxes go from the highest ascender to the lowest descender of the font, which the texts hardly use.
            let middle = (area.left + area.width / 2.0, area.top + area.height / 2.0);
            let core = PixelRect::from_center(middle, area.width, area.height * 0.7);
            for (other, other_area) in boxes.iter().skip(rank + 1) {
                let middle = (other_area.left + other_area.width / 2.0, other_area.top + other_area.height / 2.0);
                let other_core = PixelRect::from_center(middle, other_area.width, other_area.height * 0.7);
                prop_assert!(!core.overlaps(&other_core), "{text:?} and {other:?} overlap: {area:?} {other_area:?}");
            }
        }
    }

    #[test]
    fn any_numbers_give_a_figure(
        values in proptest::collection::vec(proptest::collection::vec(ANY_NUMBER, 0..12), 0..6),
        lengths in proptest::collection::vec(ANY_NUMBER, 6), times in proptest::collection::vec(ANY_NUMBER, 0..12),
        front_vehicle in 0usize..9, numbers in proptest::array::uniform3(ANY_NUMBER),
        layout in proptest::sample::select(LAYOUTS.to_vec()),
    ) {
        let vehicles = values
            .iter()
            .zip(&lengths)
            .map(|(values, length_m)| track(*length_m, values.clone(), values.iter().rev().copied().collect()))
            .collect();
        let [time_s, front_speed_mps, rear_speed_mps] = numbers;
        let impact_speed_mps = rear_speed_mps - front_speed_mps;
        let rear_vehicle = front_vehicle + 1;
        let collision =
            Collision { time_s, front_vehicle, rear_vehicle, front_speed_mps, rear_speed_mps, impact_speed_mps };
        let impact =
            Impact { collision, common_speed_mps: 0.0, first_involved: 0, last_involved: 0, beside: Vec::new() };
        let impacts: Vec<Impact> = (front_vehicle < 4).then_some(impact).into_iter().collect();
        let trace = Trace { time_s: times, vehicles };
        let svg = draw_figure(&trace, &impacts, layout);
        parse_tree(&svg);
    }
}

#[test]
fn the_collision_is_labelled_and_drawn_in_every_panel() {
    let (trace, impacts) = simulate_line(&[false, false, true], Some(1.4), AfterCollision::Stop);
    let svg = draw_figure(&trace, &impacts, PanelArrangement::Wide);
    let document = svg.document();
    let impact_speed_mps = impacts[0].collision.impact_speed_mps;
    let at = format!(
        "collision 1\u{2013}2 at {:.2} s",
        impacts[0].collision.time_s
    );
    assert!(
        document.contains(&format!(">{at}, {impact_speed_mps:.1} m/s<")),
        "{document}"
    );
    assert!(document.contains(&format!(">{at}<")) && document.contains(">collision 1\u{2013}2: "));
    // One star per panel and one in the inset.
    let star = format!("Z\" fill=\"{}\"", Ink::Alert.hex());
    assert_eq!(document.matches(&star).count(), 4);

    let (trace, impacts) = simulate_line(&[false, false, true], None, AfterCollision::Stop);
    let document = draw_figure(&trace, &impacts, PanelArrangement::Wide).document();
    assert!(document.contains(">no collision<") && document.contains(">smallest gap "));
    assert!(!document.contains(Ink::Alert.hex()));
}

#[test]
fn figures_are_the_same_every_time_and_share_no_identifier() {
    let (trace, impacts) = simulate_line(&[false, false, true], Some(1.4), AfterCollision::Stop);
    let labels = vehicle_labels(3);
    let figure = MotionFigure {
        prefix: "a b\"",
        title: "t",
        labels: &labels,
        trace: &trace,
        impacts: &impacts,
    };
    let page = |prefix| draw_motion_responsive(&MotionFigure { prefix, ..figure }).into_string();
    assert_eq!(page("one"), page("one"));
    assert!(
        page("one").len() < 66_000,
        "thirty figures are to stay well under 2 MB: {}",
        page("one").len()
    );

    check_identifiers(&(page("one") + &page("two") + &page("3 \"")));
}

/// Checks that every identifier of a page is unique, and that those used are defined.
fn check_identifiers(page: &str) {
    let ids: Vec<&str> = page
        .split(" id=\"")
        .skip(1)
        .filter_map(|rest| rest.split('"').next())
        .collect();
    let unique: HashSet<&str> = ids.iter().copied().collect();
    assert_eq!(unique.len(), ids.len(), "{ids:?}");
    for used in page
        .split("url(#")
        .skip(1)
        .filter_map(|rest| rest.split(')').next())
    {
        assert!(unique.contains(used), "{used} is not defined");
    }
}

#[test]
fn a_png_has_its_size_and_shows_every_ink() {
    let (trace, impacts) = simulate_line(&[false, false, true], Some(1.4), AfterCollision::Stop);
    let svg = draw_figure(&trace, &impacts, PanelArrangement::Wide);
    let (width, height) = svg.size();
    let picture =
        tiny_skia::Pixmap::decode_png(&svg.to_png(PNG_SCALE).expect("drawn")).expect("a PNG");
    assert_eq!(
        (picture.width(), picture.height()),
        ((2.0 * width).round() as u32, (2.0 * height).round() as u32)
    );
    let inks: HashSet<String> = picture
        .pixels()
        .iter()
        .map(|pixel| {
            format!(
                "#{:02x}{:02x}{:02x}",
                pixel.red(),
                pixel.green(),
                pixel.blue()
            )
        })
        .collect();
    for ink in [
        Ink::Paper,
        Ink::Text,
        Ink::Alert,
        Ink::Series(0),
        Ink::Series(1),
        Ink::Series(2),
    ] {
        assert!(inks.contains(ink.hex()), "{ink:?} is missing");
    }
    assert!(picture.pixels().iter().all(|pixel| pixel.alpha() == 255));

    for scale in [0.0, -1.0, f64::NAN, 1e6] {
        assert!(
            matches!(svg.to_png(scale), Err(DrawError::Size { .. })),
            "{scale}"
        );
    }
}

#[test]
fn runs_beside_each_other_are_drawn_on_the_same_axes() {
    let (crash, crash_impacts) =
        simulate_line(&[false, false, true], Some(1.4), AfterCollision::Stop);
    let (safe, safe_impacts) = simulate_line(&[false, false, true], None, AfterCollision::Stop);
    let labels = vehicle_labels(3);
    let figure = |prefix, trace, impacts| MotionFigure {
        prefix,
        title: "t",
        labels: &labels,
        trace,
        impacts,
    };
    let figures = [
        figure("one", &crash, &crash_impacts),
        figure("two", &safe, &safe_impacts),
    ];
    let axes = MotionAxes::from_traces([&crash, &safe]);
    let labels_of = |svg: Svg| -> Vec<String> {
        let document = svg.document();
        let texts = document
            .split("<text ")
            .skip(1)
            .filter_map(|rest| rest.split("</text>").next());
        let labels =
            texts.filter(|text| text.contains("text-anchor=\"end\"") && !text.contains("stroke"));
        labels.map(str::to_owned).collect()
    };
    let together = figures.map(|figure| {
        labels_of(draw_motion_on_axes(
            &figure,
            &axes,
            PanelArrangement::Column,
        ))
    });
    assert_eq!(together[0], together[1]);
    assert!(together[0].len() > 12);
    let alone = figures.map(|figure| labels_of(draw_motion(&figure, PanelArrangement::Column)));
    assert_ne!(alone[0], alone[1], "the runs differ too little to tell");

    let page = draw_motions_side_by_side(&figures).into_string();
    assert_eq!(page.matches("<svg").count(), 4);
}
