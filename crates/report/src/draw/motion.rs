//! The diagrams of one run: the three of the paper's results (time-space, time-speed and spacing), acceleration, and
//! time to collision.

use super::path::Px;
use maud::{Markup, html};

use super::axis::LEFT_MARGIN;
use super::closeup::{self, Focus};
use super::figure_layout::{FigureLayout, LABEL_STEP, vehicle_name};
use super::label::{PixelRect, spread_evenly, text_width};
use super::motion_axes::{MAX_TTC_S, MotionAxes};
use super::panel::{Anchor, Marker, Panel, TaggedLine, draw_line, draw_tag, draw_text, tag_width};
use super::scale::extent;
use super::theme::{Ink, SMALL_TEXT_SIZE, Stroke, TEXT_SIZE};
use super::{Svg, path};
use crumple_sim::engine::{Collision, Impact, Trace, Track, VehiclePair};

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

/// Draws the diagrams of one run.
#[must_use]
pub fn draw_motion(figure: &MotionFigure<'_>, layout: PanelArrangement) -> Svg {
    draw_motion_on_axes(figure, &MotionAxes::from_trace(figure.trace), layout)
}

/// Draws the diagrams of one run on given axes, so that it can be compared with others.
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
        (acceleration_panel(figure, plan.acceleration, axes).draw(&Svg::id(prefix, "acceleration")))
        (ttc_panel(figure, plan.ttc, axes).draw(&Svg::id(prefix, "ttc")))
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
    mark_collisions(&mut panel, figure, right, |collision| CollisionMark {
        text: format!(
            "collision {} at {:.2} s, {:.1} m/s",
            format_pair(collision),
            collision.time_s,
            collision.impact_speed_mps
        ),
        value: trace
            .vehicles
            .get(collision.rear_vehicle)
            .map_or(0.0, |rear| {
                closeup::value_at(trace, &rear.position_m, collision.time_s)
            }),
    });
    if let Some(focus) = find_focus(figure) {
        if !focus.is_collision {
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
    let tags = add_tracks(&mut panel, trace, |track| &track.speed_mps);
    let width = if figure.impacts.len() > 4 { 1.2 } else { 2.4 };
    for Impact { collision, .. } in figure.impacts {
        panel.add_segment(
            (collision.time_s, collision.front_speed_mps),
            (collision.time_s, collision.rear_speed_mps),
            Stroke::solid(Ink::Alert, width),
        );
    }
    mark_collisions(&mut panel, figure, frame.right() + 12.0, |collision| {
        let rear_mps = collision.rear_speed_mps;
        let front_mps = collision.front_speed_mps;
        let pair = format_pair(collision);
        CollisionMark {
            text: format!("collision {pair}: {rear_mps:.1} into {front_mps:.1} m/s"),
            value: (rear_mps + front_mps) / 2.0,
        }
    });
    if tags.len() <= MAX_TAGGED_VEHICLES {
        panel.add_tags(&tags);
    }
    panel
}

/// Draws a series of every vehicle, and returns the lines with their tags.
fn add_tracks(
    panel: &mut Panel,
    trace: &Trace,
    series: impl Fn(&Track) -> &[f64],
) -> Vec<TaggedLine> {
    let tracks = trace.vehicles.iter().enumerate();
    let tagged = tracks.map(|(index, track)| TaggedLine {
        points: to_points(&trace.time_s, series(track).iter().copied()),
        tag: index.to_string(),
        ink: Ink::Series(index),
    });
    let tagged: Vec<_> = tagged.collect();
    for (index, line) in tagged.iter().enumerate() {
        panel.add_line(&line.points, Stroke::series(index));
    }
    tagged
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
    mark_collisions(&mut panel, figure, right, |collision| CollisionMark {
        text: format!(
            "collision {} at {:.2} s",
            format_pair(collision),
            collision.time_s
        ),
        value: 0.0,
    });
    if let Some(focus) = find_focus(figure).filter(|focus| !focus.is_collision) {
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

fn acceleration_panel(figure: &MotionFigure<'_>, frame: PixelRect, axes: &MotionAxes) -> Panel {
    let MotionFigure { trace, .. } = figure;
    let mut panel = Panel::new(
        frame,
        "Acceleration (m/s²)",
        axes.time(),
        axes.acceleration(),
    );
    panel.add_horizontal_line(0.0, Stroke::solid(Ink::Muted, 1.0));
    let tags = add_tracks(&mut panel, trace, |track| &track.acceleration_mps2);
    mark_first_collision(&mut panel, figure);
    if tags.len() <= MAX_TAGGED_VEHICLES {
        panel.add_tags(&tags);
    }
    panel
}

/// Draws the time to collision of each pair while it is at most [`MAX_TTC_S`].
fn ttc_panel(figure: &MotionFigure<'_>, frame: PixelRect, axes: &MotionAxes) -> Panel {
    let MotionFigure { trace, .. } = figure;
    let heading = format!("Time to collision, to {MAX_TTC_S} s (s)");
    let mut panel = Panel::new(frame, &heading, axes.time(), axes.ttc());
    for (rear, pair) in vehicle_pairs(trace) {
        for line in ttc_lines(&pair) {
            panel.add_line(&line, Stroke::series(rear));
        }
    }
    mark_first_collision(&mut panel, figure);
    panel
}

/// Returns the time to collision of a pair as one line for each time in which it is at most [`MAX_TTC_S`].
fn ttc_lines(pair: &VehiclePair<'_>) -> Vec<Vec<path::PixelPoint>> {
    let mut lines: Vec<Vec<path::PixelPoint>> = Vec::new();
    let mut is_open = false;
    for (sample, gap_m) in pair.gaps_m() {
        let speeds = [&pair.front.speed_mps, &pair.rear.speed_mps].map(|speed| speed.get(sample));
        let ([Some(front_mps), Some(rear_mps)], Some(&time_s)) = (speeds, pair.time_s.get(sample))
        else {
            continue;
        };
        let ttc_s = gap_m / (rear_mps - front_mps);
        let is_shown = rear_mps > front_mps && (0.0..=MAX_TTC_S).contains(&ttc_s);
        match lines.last_mut().filter(|_| is_open && is_shown) {
            Some(line) => line.push((time_s, ttc_s)),
            None if is_shown => lines.push(vec![(time_s, ttc_s)]),
            None => {}
        }
        is_open = is_shown;
    }
    lines
}

fn mark_first_collision(panel: &mut Panel, figure: &MotionFigure<'_>) {
    if let Some(Impact { collision, .. }) = figure.impacts.first() {
        let stroke = Stroke {
            dash: "3 3",
            ..Stroke::solid(Ink::Alert, 1.0)
        };
        panel.add_vertical_line(collision.time_s, stroke);
    }
}

/// The mark of a collision in a panel: its description, and its value on the vertical axis.
struct CollisionMark {
    text: String,
    value: f64,
}

/// Adds a star at every impact, and a line from the first one to its description.
fn mark_collisions(
    panel: &mut Panel,
    figure: &MotionFigure<'_>,
    right: f64,
    describe: impl Fn(&Collision) -> CollisionMark,
) {
    for (rank, Impact { collision, .. }) in figure.impacts.iter().enumerate() {
        let CollisionMark { text, value } = describe(collision);
        if rank == 0 {
            panel.add_vertical_line(
                collision.time_s,
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
            add_caption(panel, collision.time_s, &text, Ink::Alert, right);
        }
        panel.add_markers(&[(collision.time_s, value)], Marker::Burst, Ink::Alert);
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
    if let Some(Impact { collision, .. }) = figure.impacts.first() {
        let &Collision {
            time_s,
            front_vehicle: front,
            rear_vehicle: rear,
            ..
        } = collision;
        return Some(Focus {
            time_s,
            front,
            rear,
            gap_m: 0.0,
            is_collision: true,
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
                    is_collision: false,
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

fn format_pair(collision: &Collision) -> String {
    format!(
        "{}\u{2013}{}",
        collision.front_vehicle, collision.rear_vehicle
    )
}

fn description(figure: &MotionFigure<'_>) -> String {
    let (first, last) = extent(figure.trace.time_s.iter().copied());
    let run = format!(
        "Position, speed, bumper gaps, acceleration and time to collision of {} vehicles over {:.2} s.",
        figure.trace.vehicles.len(),
        last - first
    );
    let end = match (figure.impacts.first(), find_focus(figure)) {
        (Some(Impact { collision, .. }), _) => format!(
            "First collision: vehicle {} hits vehicle {} at {:.2} s, {:.1} into {:.1} m/s. Impacts: {}.",
            collision.rear_vehicle,
            collision.front_vehicle,
            collision.time_s,
            collision.rear_speed_mps,
            collision.front_speed_mps,
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
