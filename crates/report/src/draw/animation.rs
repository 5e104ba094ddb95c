//! A run seen from above: vehicles on a lane, a time slider, live speeds and gaps.
//!
//! The drawing shows the last instant; without the script and in print it stays so. The page's one script,
//! [`ANIMATION_SCRIPT`], finds every animation of the page and moves the vehicles by the numbers embedded as JSON.

use maud::{Markup, PreEscaped, html};

use super::animation_data::AnimationData;
use super::label::PixelRect;
use super::panel::{Anchor, Marker, draw_line, draw_marker, draw_tag, draw_text, tag_width};
use super::path::Px;
use super::scale::format_number;
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke};
use super::vehicle_names::vehicle_names;
use super::{PixelPoint, Svg};
use crumple_world::scenario::{Scenario, VehicleClass};
use crumple_world::sim::{Impact, Trace};

/// Style sheet of a page with animations, besides [`STYLE`](super::STYLE).
pub const ANIMATION_STYLE: &str = include_str!("animation.css");

/// Script of a page with animations: once per page, at its end, in a `<script>` element.
pub const ANIMATION_SCRIPT: &str = include_str!("animation.js");

/// Heights of the lane and of the space above and below it, in pixels.
const LANE_HEIGHT: f64 = 46.0;
const SPACE_ABOVE: f64 = 26.0;
const SPACE_BELOW: f64 = 44.0;
/// Additional height below if vehicles enter or leave the lane, in pixels.
const ADJACENT_LANE_HEIGHT: f64 = 34.0;

/// Length of a dash of the centre line and the gap after it, in metres.
const DASH_PERIOD_M: f64 = 10.0;

struct LaneView<'a> {
    data: &'a AnimationData,
    width: f64,
    px_per_m: f64,
    camera_m: f64,
}

/// Draws the animation of one run. `id` must be unique in the page; `trace` and `impacts` belong to a run of
/// `scenario`.
#[must_use]
pub fn draw_animation(id: &str, title: &str, trace: &Trace, scenario: &Scenario, impacts: &[Impact]) -> Markup {
    let labels = vehicle_names(scenario);
    let classes: Vec<VehicleClass> = scenario.vehicles().iter().map(|vehicle| vehicle.class).collect();
    let data = AnimationData::new(trace, impacts);
    let last = data.sample_count().saturating_sub(1);
    let end = format!("{:.2} s", data.end_s);
    let view = |name: &str, width: f64| {
        let px_per_m = width / data.window_m();
        let view = LaneView { data: &data, width, px_per_m, camera_m: data.camera_m(last) };
        view.draw(&Svg::id(id, name), title, &classes)
    };
    html! {
        div.draw-animation id=(Svg::id(id, "animation")) data-dash=(DASH_PERIOD_M) role="group" aria-label=(title) {
            p.draw-title { (title) }
            div.draw-wide { (view("above-wide", 960.0)) }
            div.draw-narrow { (view("above-narrow", 360.0)) }
            div.draw-controls hidden {
                button type="button" { "Play" }
                input type="range" min="0" max=(last) value=(last) step="1" aria-label="Time" aria-valuetext=(end);
            }
            p.draw-state { span.draw-time { (end) } " " span.draw-event { (data.event_text(data.end_s)) } }
            div.scroll tabindex="0" { table {
                thead { tr {
                    th scope="col" { "vehicle" }
                    th.number scope="col" { "speed (m/s)" }
                    th.number scope="col" { "acceleration (m/s²)" }
                    th.number scope="col" { "gap ahead (m)" }
                } }
                tbody { @for (index, vehicle) in data.vehicles.iter().enumerate() { tr {
                    th scope="row" { (index) " " (labels.get(index).map_or("", String::as_str)) }
                    td.number { (vehicle.speed_mps(last).map_or(String::new(), |v| format_number(v, 1))) }
                    td.number { (vehicle.acceleration_mps2(last).map_or(String::new(), |a| format_number(a, 1))) }
                    td.number { (data.gap_m(index, last).map_or("–".to_owned(), |gap| format_number(gap, 2))) }
                } } }
            } }
            // Contains only numbers, which cannot end the element.
            script type="application/json" { (PreEscaped(data.to_json())) }
        }
    }
}

impl LaneView<'_> {
    fn to_px(&self, position_m: f64) -> f64 {
        self.width / 2.0 + (position_m - self.camera_m) * self.px_per_m
    }

    fn draw(&self, prefix: &str, title: &str, classes: &[VehicleClass]) -> Svg {
        let last = self.data.sample_count().saturating_sub(1);
        let (top, bottom) = (SPACE_ABOVE, SPACE_ABOVE + LANE_HEIGHT);
        let middle = SPACE_ABOVE + LANE_HEIGHT / 2.0;
        let below = SPACE_BELOW + if self.data.has_lane_changes() { ADJACENT_LANE_HEIGHT } else { 0.0 };
        let beside = bottom + SPACE_BELOW - 16.0;
        let clip = Svg::id(prefix, "clip");
        let edge = |y| draw_line((0.0, y), (self.width, y), Stroke::solid(Ink::Axis, 1.4));
        let dash = DASH_PERIOD_M * self.px_per_m;
        let content = html! {
            clipPath id=(clip) { rect x="0" y="0" width=(Px(self.width)) height=(Px(bottom + below)) {} }
            g class="draw-view" data-width=(Px(self.width)) data-scale=(format!("{:.4}", self.px_per_m))
                data-lane=(Px(middle)) data-beside=(Px(beside))
                clip-path={ "url(#" (clip) ")" } {
                (edge(top)) (edge(bottom))
                path class="draw-lane" d={ "M0 " (Px(bottom + 5.0)) "H" (Px(self.width)) } stroke=(Ink::Muted.hex())
                    stroke-width="3" stroke-dasharray={ (Px(0.3 * dash)) " " (Px(0.7 * dash)) }
                    stroke-dashoffset=(Px(self.dash_offset())) {}
                @for (index, vehicle) in self.data.vehicles.iter().enumerate() {
                    @let class = classes.get(index).copied().unwrap_or(VehicleClass::Light);
                    @let x = self.to_px(vehicle.position_m(last).unwrap_or(0.0));
                    @let braking = vehicle.acceleration_mps2(last).is_some_and(|a| a < -0.5);
                    @let y = if self.data.is_in_lane(index, last) { middle } else { beside };
                    g class="draw-vehicle" transform={ "translate(" (Px(x)) " " (Px(y)) ")" } {
                        (self.draw_vehicle(vehicle.length_m, class, index, braking))
                    }
                }
                @for rear in 1..self.data.vehicles.len() {
                    @let is_below = rear % 2 == 1 && !self.data.has_lane_changes();
                    (self.draw_gap(rear, last, if is_below { bottom + 22.0 } else { top - 8.0 }))
                }
                @for impact in &self.data.impacts {
                    @let x = self.to_px(self.data.impact_position_m(impact, last));
                    g class="draw-impact" transform={ "translate(" (Px(x)) " " (Px(middle)) ")" } {
                        (draw_marker((0.0, 0.0), Marker::Burst, Ink::Alert))
                    }
                }
            }
            (self.draw_scale_bar((self.width - 8.0, bottom + below - 6.0)))
        };
        let description = "The vehicles of a run on their lane, seen from above, moving to the right. Lengths and gaps \
            are to scale, widths are not. A bar at a vehicle's rear means that it brakes, a star contact.";
        Svg::new(prefix, (self.width, bottom + below), title, description, content)
    }

    /// Draws a vehicle with its front bumper at x = 0, centred on y = 0.
    fn draw_vehicle(&self, length_m: f64, class: VehicleClass, index: usize, braking: bool) -> Markup {
        let length = (length_m * self.px_per_m).max(3.0);
        let width = match class {
            VehicleClass::Light => 22.0,
            VehicleClass::Heavy => 30.0,
        };
        let PixelRect { left, top, .. } = PixelRect::from_center((-length / 2.0, 0.0), length, width);
        let (ink, number) = (Ink::Series(index), index.to_string());
        html! {
            rect x=(Px(left)) y=(Px(top)) width=(Px(length)) height=(Px(width)) rx="3" fill=(ink.hex())
                fill-opacity="0.3" stroke=(ink.hex()) stroke-width="1.6" {}
            // A windscreen distinguishes the front from the rear.
            path d={ "M" (Px(-(0.28 * length).min(9.0))) " " (Px(top + 3.0)) "V" (Px(-top - 3.0)) } stroke=(ink.hex())
                stroke-width="1.6" {}
            path class="draw-brake" d={ "M" (Px(left + 1.5)) " " (Px(top + 2.0)) "V" (Px(-top - 2.0)) }
                stroke=(Ink::Alert.hex()) stroke-width="4" visibility=[(!braking).then_some("hidden")] {}
            @if length >= 1.9 * tag_width(&number) {
                (draw_tag((-length / 2.0, 0.0), &number, ink))
            } @else {
                @let at = (-length / 2.0, SMALL_TEXT_SIZE * 0.35);
                (draw_text(at, Anchor::Middle, &number, SMALL_TEXT_SIZE, Ink::Text, true))
            }
        }
    }

    fn draw_gap(&self, rear: usize, sample: usize, y: f64) -> Markup {
        let ahead_m = self.data.gap_m(rear, sample);
        let gap_m = ahead_m.unwrap_or(0.0);
        let from = self.data.vehicles.get(rear).and_then(|vehicle| vehicle.position_m(sample)).unwrap_or(0.0);
        html! {
            g class="draw-gap" transform={ "translate(" (Px(self.to_px(from + gap_m / 2.0))) " " (Px(y)) ")" } {
                @let said = ahead_m.map_or(String::new(), |gap_m| format!("{} m", format_number(gap_m, 1)));
                (draw_text((0.0, 0.0), Anchor::Middle, &said, SMALL_TEXT_SIZE, Ink::Text, false))
            }
        }
    }

    fn draw_scale_bar(&self, (right, y): PixelPoint) -> Markup {
        let metres = if DASH_PERIOD_M * self.px_per_m > 24.0 { DASH_PERIOD_M } else { 5.0 * DASH_PERIOD_M };
        let left = right - metres * self.px_per_m;
        html! {
            (draw_line((left, y), (right, y), Stroke::solid(Ink::Muted, 1.2)))
            (draw_line((left, y - 3.0), (left, y + 3.0), Stroke::solid(Ink::Muted, 1.2)))
            (draw_line((right, y - 3.0), (right, y + 3.0), Stroke::solid(Ink::Muted, 1.2)))
            @let at = (left - 5.0, y + SMALL_TEXT_SIZE * 0.35);
            (draw_text(at, Anchor::End, &format!("{metres} m"), SMALL_TEXT_SIZE, Ink::Muted, false))
        }
    }

    /// Returns the distance of the dashes from the left edge that keeps them fixed on the road.
    fn dash_offset(&self) -> f64 {
        let left_m = self.camera_m - self.width / 2.0 / self.px_per_m;
        left_m.rem_euclid(DASH_PERIOD_M) * self.px_per_m
    }
}
