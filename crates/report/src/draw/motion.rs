//! The three diagrams of the paper's results: time-space, time-speed and spacing.

use super::path::Px;
use maud::{Markup, html};

use super::axis::LEFT_MARGIN;
use super::closeup::{self, Focus};
use super::figure_layout::{FigureLayout, LABEL_STEP, vehicle_name};
use super::label::{PixelRect, spread_evenly, text_width};
use super::motion_axes::MotionAxes;
use super::panel::{Anchor, Marker, Panel, TaggedLine, draw_line, draw_tag, draw_text, tag_width};
use super::scale::extent;
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke, TEXT_SIZE};
use super::{Svg, path};
use crumple_sim::engine::{Contact, Impact, Trace, Track, VehiclePair};

/// The data of a motion figure of one run.
#[derive(Debug, Clone, Copy)]
pub struct MotionFigure<'a> {
    /// Prefix of every identifier in the figure; unique in a page.
    pub prefix: &'a str,
    /// Title above the panels; may be empty.
    pub title: &'a str,
    /// One name per vehicle, front to rear, such as `follower (heavy)`; the index is put before it.
    pub labels: &'a [String],
    /// Motion of the vehicles.
    pub trace: &'a Trace,
    /// Impacts in order of time; empty without a collision.
    pub impacts: &'a [Impact],
}

/// The arrangement of the panels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PanelArrangement {
    /// In a row, 960 pixels wide: screens and paper.
    Wide,
    /// One above the other, 360 pixels wide: phones.
    Stacked,
    /// One above the other, 470 pixels wide and flat: half a page, to compare two runs.
    Column,
}

/// Maximum number of vehicles with tags; with more, lines are too close for useful tags.
const MAX_TAGGED_VEHICLES: usize = 60;

/// Draws the three diagrams of one run.
#[must_use]
pub fn draw_motion(figure: &MotionFigure<'_>, layout: PanelArrangement) -> Svg {
    draw_motion_on_axes(figure, &MotionAxes::from_trace(figure.trace), layout)
}

/// Draws the three diagrams of one run on given axes, so that it can be compared with others.
#[must_use]
pub fn draw_motion_on_axes(
    figure: &MotionFigure<'_>,
    axes: &MotionAxes,
    layout: PanelArrangement,
) -> Svg {
    let plan = FigureLayout::new(figure, layout);
    let prefix = figure.prefix;
    let content = html! {
        (plan.draw_title_and_legend(figure))
        (position_panel(figure, &plan, axes).draw(&Svg::id(prefix, "space")))
        (speed_panel(figure, plan.speed, axes).draw(&Svg::id(prefix, "speed")))
        (gap_panel(figure, plan.gap, axes).draw(&Svg::id(prefix, "spacing")))
    };
    Svg::new(
        prefix,
        (plan.width, plan.height),
        figure.title,
        &description(figure),
        content,
    )
}

/// Draws both layouts for an HTML page with [`STYLE`](super::STYLE), which shows the one that fits.
#[must_use]
pub fn draw_motion_responsive(figure: &MotionFigure<'_>) -> Markup {
    let axes = MotionAxes::from_trace(figure.trace);
    super::responsive(
        &draw_variant(figure, &axes, "wide", PanelArrangement::Wide),
        &draw_variant(figure, &axes, "narrow", PanelArrangement::Stacked),
    )
}

/// Draws one of several variants of a figure in a page, with its own prefix.
fn draw_variant(
    figure: &MotionFigure<'_>,
    axes: &MotionAxes,
    variant: &str,
    layout: PanelArrangement,
) -> Svg {
    let prefix = format!("{}-{variant}", figure.prefix);
    let figure = MotionFigure {
        prefix: &prefix,
        ..*figure
    };
    draw_motion_on_axes(&figure, axes, layout)
}

/// Draws several runs on the same axes, in two columns or in one, for a page with [`STYLE`](super::STYLE).
#[must_use]
pub(crate) fn draw_motions_side_by_side(figures: &[MotionFigure<'_>]) -> Markup {
    let axes = MotionAxes::from_traces(figures.iter().map(|figure| figure.trace));
    html! {
        div.draw-wide { div.draw-beside {
            @for figure in figures { (draw_variant(figure, &axes, "column", PanelArrangement::Column)) }
        } }
        div.draw-narrow {
            @for figure in figures { (draw_variant(figure, &axes, "narrow", PanelArrangement::Stacked)) }
        }
    }
}

/// Draws several runs on the same axes as columns of one figure.
#[must_use]
pub(crate) fn draw_motion_columns(prefix: &str, title: &str, figures: &[MotionFigure<'_>]) -> Svg {
    let axes = MotionAxes::from_traces(figures.iter().map(|figure| figure.trace));
    let drawn: Vec<Svg> = figures
        .iter()
        .map(|figure| draw_motion_on_axes(figure, &axes, PanelArrangement::Column))
        .collect();
    let lefts = drawn.iter().scan(0.0, |left, svg| {
        Some(std::mem::replace(left, *left + svg.size().0 + COLUMN_GAP))
    });
    let content = html! {
        @for (svg, left) in drawn.iter().zip(lefts) { g transform={ "translate(" (Px(left)) " 0)" } { (svg) } }
    };
    let width = drawn
        .iter()
        .map(|svg| svg.size().0 + COLUMN_GAP)
        .sum::<f64>()
        - COLUMN_GAP;
    let height = drawn.iter().map(|svg| svg.size().1).fold(0.0, f64::max);
    Svg::new(
        prefix,
        (width.max(0.0), height),
        title,
        "The runs next to each other, on the same axes.",
        content,
    )
}

const COLUMN_GAP: f64 = 20.0;

fn position_panel(figure: &MotionFigure<'_>, plan: &FigureLayout, axes: &MotionAxes) -> Panel {
    let MotionFigure { trace, .. } = figure;
    let mut panel = Panel::new(
        plan.position,
        "Position of the vehicles (m)",
        axes.time(),
        axes.position(),
    );
    for (index, track) in trace.vehicles.iter().enumerate() {
        add_vehicle_band(&mut panel, &trace.time_s, track, index);
    }
    let right = plan.labels_right;
    mark_contacts(&mut panel, figure, right, |contact| ContactMark {
        text: format!(
            "collision {} at {:.2} s, {:.1} m/s",
            format_pair(contact),
            contact.time_s,
            contact.impact_speed_mps
        ),
        value: trace
            .vehicles
            .get(contact.rear_vehicle)
            .map_or(0.0, |rear| {
                closeup::value_at(trace, &rear.position_m, contact.time_s)
            }),
    });
    if let Some(focus) = find_focus(figure) {
        if !focus.is_contact {
            add_caption(&mut panel, focus.time_s, "no collision", Ink::Muted, right);
        }
        closeup::add_inset(
            &mut panel,
            trace,
            &focus,
            &Svg::id(figure.prefix, "closeup"),
        );
    }
    add_end_labels(&mut panel, figure, plan);
    panel
}

/// Adds a vehicle as the band between its bumpers: the front edge in the vehicle's stroke, the rear edge thin.
pub(super) fn add_vehicle_band(panel: &mut Panel, time_s: &[f64], track: &Track, index: usize) {
    let front = to_points(time_s, track.position_m.iter().copied());
    let rear = to_points(
        time_s,
        track.position_m.iter().map(|front| front - track.length_m),
    );
    if track.in_lane_s != Track::THROUGHOUT_S {
        // Outside the lane, a dotted line of its position.
        panel.add_line(
            &front,
            Stroke {
                dash: "2 3",
                ..Stroke::solid(Ink::Series(index), 0.8)
            },
        );
    }
    let first = time_s
        .iter()
        .position(|&time_s| track.is_in_lane(time_s))
        .unwrap_or(time_s.len());
    let end = time_s
        .iter()
        .rposition(|&time_s| track.is_in_lane(time_s))
        .map_or(first, |last| last + 1);
    let front = front.get(first..end).unwrap_or_default();
    let rear = rear.get(first..end).unwrap_or_default();
    panel.add_band(front, rear, Ink::Series(index));
    panel.add_line(rear, Stroke::solid(Ink::Series(index), 0.7));
    panel.add_line(
        front,
        Stroke {
            width: 1.5,
            ..Stroke::series(index)
        },
    );
}

/// Adds numbers, and names if there is room, to the right of each vehicle's end.
fn add_end_labels(panel: &mut Panel, figure: &MotionFigure<'_>, plan: &FigureLayout) {
    let frame = panel.frame;
    let last_s = figure.trace.time_s.last();
    let ends: Vec<_> = figure
        .trace
        .vehicles
        .iter()
        .map(|track| match (last_s, track.position_m.last()) {
            (Some(&time_s), Some(&front_m)) => {
                panel.to_pixels((time_s, front_m - track.length_m / 2.0))
            }
            _ => path::PixelPoint::default(),
        })
        .collect();
    let wanted: Vec<f64> = ends.iter().map(|(_, y)| *y).collect();
    let heights = spread_evenly(&wanted, LABEL_STEP, (frame.top + 7.0, frame.bottom() - 7.0));
    for (index, (&from, y)) in ends.iter().zip(heights).enumerate() {
        let ink = Ink::Series(index);
        let number = index.to_string();
        let left = frame.right() + 8.0;
        let name_left = left + plan.widest_tag + 4.0;
        panel.add_overlay(html! {
            (draw_line(from, (left, y), Stroke::solid(ink, 0.8)))
            (draw_tag((left + tag_width(&number) / 2.0, y), &number, ink))
            @if plan.arrangement == PanelArrangement::Wide {
                @let baseline = (name_left, y + TEXT_SIZE * 0.35);
                (draw_text(baseline, Anchor::Start, &vehicle_name(figure, index), TEXT_SIZE, Ink::Text, false))
            }
        });
    }
}

fn speed_panel(figure: &MotionFigure<'_>, frame: PixelRect, axes: &MotionAxes) -> Panel {
    let MotionFigure { trace, .. } = figure;
    let mut panel = Panel::new(frame, "Speed (m/s)", axes.time(), axes.speed());
    let mut tags = Vec::new();
    for (index, track) in trace.vehicles.iter().enumerate() {
        let line = to_points(&trace.time_s, track.speed_mps.iter().copied());
        panel.add_line(&line, Stroke::series(index));
        tags.push(TaggedLine {
            points: line,
            tag: index.to_string(),
            ink: Ink::Series(index),
        });
    }
    let width = if figure.impacts.len() > 4 { 1.2 } else { 2.4 };
    for Impact { contact, .. } in figure.impacts {
        panel.add_segment(
            (contact.time_s, contact.front_speed_mps),
            (contact.time_s, contact.rear_speed_mps),
            Stroke::solid(Ink::Alert, width),
        );
    }
    mark_contacts(&mut panel, figure, frame.right() + 12.0, |contact| {
        let rear_mps = contact.rear_speed_mps;
        let front_mps = contact.front_speed_mps;
        let pair = format_pair(contact);
        ContactMark {
            text: format!("collision {pair}: {rear_mps:.1} into {front_mps:.1} m/s"),
            value: (rear_mps + front_mps) / 2.0,
        }
    });
    if tags.len() <= MAX_TAGGED_VEHICLES {
        panel.add_tags(&tags);
    }
    panel
}

fn gap_panel(figure: &MotionFigure<'_>, frame: PixelRect, axes: &MotionAxes) -> Panel {
    let MotionFigure { trace, .. } = figure;
    let mut panel = Panel::new(frame, "Gap between bumpers (m)", axes.time(), axes.gap());
    panel.add_horizontal_line(0.0, Stroke::solid(Ink::Text, 1.0));
    let mut tags = Vec::new();
    for (rear, pair) in vehicle_pairs(trace) {
        let line: Vec<path::PixelPoint> = pair
            .gaps_m()
            .filter_map(|(sample, gap_m)| Some((*trace.time_s.get(sample)?, gap_m)))
            .collect();
        panel.add_line(&line, Stroke::series(rear));
        tags.push(TaggedLine {
            points: line,
            tag: format!("{}\u{2013}{rear}", pair.front_vehicle),
            ink: Ink::Series(rear),
        });
    }
    let right = frame.right() + 12.0;
    mark_contacts(&mut panel, figure, right, |contact| ContactMark {
        text: format!(
            "collision {} at {:.2} s",
            format_pair(contact),
            contact.time_s
        ),
        value: 0.0,
    });
    if let Some(focus) = find_focus(figure).filter(|focus| !focus.is_contact) {
        panel.add_markers(&[(focus.time_s, focus.gap_m)], Marker::Ring, Ink::Text);
        let text = format!(
            "smallest gap {:.2} m ({}\u{2013}{}) at {:.2} s",
            focus.gap_m, focus.front, focus.rear, focus.time_s
        );
        add_caption(&mut panel, focus.time_s, &text, Ink::Muted, right);
    }
    if tags.len() <= MAX_TAGGED_VEHICLES {
        panel.add_tags(&tags);
    }
    panel
}

/// The mark of a collision in a panel: its description, and its value on the vertical axis.
struct ContactMark {
    text: String,
    value: f64,
}

/// Adds a star at every impact, and a line from the first one to its description.
fn mark_contacts(
    panel: &mut Panel,
    figure: &MotionFigure<'_>,
    right: f64,
    describe: impl Fn(&Contact) -> ContactMark,
) {
    for (rank, Impact { contact, .. }) in figure.impacts.iter().enumerate() {
        let ContactMark { text, value } = describe(contact);
        if rank == 0 {
            panel.add_vertical_line(
                contact.time_s,
                Stroke {
                    dash: "3 3",
                    ..Stroke::solid(Ink::Alert, 1.0)
                },
            );
            let more = figure.impacts.len() - 1;
            let text = if more == 0 {
                text
            } else {
                format!("{text}; {more} more")
            };
            add_caption(panel, contact.time_s, &text, Ink::Alert, right);
        }
        panel.add_markers(&[(contact.time_s, value)], Marker::Burst, Ink::Alert);
    }
}

/// Adds text between the heading and the frame, centred over an instant if there is room.
fn add_caption(panel: &mut Panel, time_s: f64, text: &str, ink: Ink, right: f64) {
    let frame = panel.frame;
    let half = text_width(text, SMALL_TEXT_SIZE) / 2.0;
    let x = panel.to_pixels((time_s, 0.0)).0;
    let centre = x
        .min(right - half)
        .max(frame.left - LEFT_MARGIN + 2.0 + half);
    panel.add_overlay(draw_text(
        (centre, frame.top - 7.0),
        Anchor::Middle,
        text,
        SMALL_TEXT_SIZE,
        ink,
        false,
    ));
}

fn find_focus(figure: &MotionFigure<'_>) -> Option<Focus> {
    if let Some(Impact { contact, .. }) = figure.impacts.first() {
        let &Contact {
            time_s,
            front_vehicle: front,
            rear_vehicle: rear,
            ..
        } = contact;
        return Some(Focus {
            time_s,
            front,
            rear,
            gap_m: 0.0,
            is_contact: true,
        });
    }
    let mut closest: Option<Focus> = None;
    for (rear, pair) in vehicle_pairs(figure.trace) {
        for (sample, gap_m) in pair.gaps_m() {
            let Some(&time_s) = pair.time_s.get(sample) else {
                continue;
            };
            if gap_m.is_finite() && closest.is_none_or(|closest| gap_m < closest.gap_m) {
                closest = Some(Focus {
                    time_s,
                    front: pair.front_vehicle,
                    rear,
                    gap_m,
                    is_contact: false,
                });
            }
        }
    }
    closest
}

/// Returns every pair of a vehicle and its leader, each with the index of the rear vehicle.
pub(super) fn vehicle_pairs(trace: &Trace) -> impl Iterator<Item = (usize, VehiclePair<'_>)> {
    (1..trace.vehicles.len())
        .flat_map(|rear| trace.pairs(rear).into_iter().map(move |pair| (rear, pair)))
}

fn to_points(time_s: &[f64], values: impl Iterator<Item = f64>) -> Vec<path::PixelPoint> {
    time_s.iter().copied().zip(values).collect()
}

fn format_pair(contact: &Contact) -> String {
    format!("{}\u{2013}{}", contact.front_vehicle, contact.rear_vehicle)
}

fn description(figure: &MotionFigure<'_>) -> String {
    let (first, last) = extent(figure.trace.time_s.iter().copied());
    let run = format!(
        "Position, speed and bumper gaps of {} vehicles over {:.2} s.",
        figure.trace.vehicles.len(),
        last - first
    );
    let end = match (figure.impacts.first(), find_focus(figure)) {
        (Some(Impact { contact, .. }), _) => format!(
            "First collision: vehicle {} hits vehicle {} at {:.2} s, {:.1} into {:.1} m/s. Impacts: {}.",
            contact.rear_vehicle,
            contact.front_vehicle,
            contact.time_s,
            contact.rear_speed_mps,
            contact.front_speed_mps,
            figure.impacts.len()
        ),
        (None, Some(focus)) => format!(
            "No collision; smallest gap {:.2} m between vehicles {} and {} at {:.2} s.",
            focus.gap_m, focus.front, focus.rear, focus.time_s
        ),
        (None, None) => "No collision.".to_owned(),
    };
    format!("{run} {end}")
}
