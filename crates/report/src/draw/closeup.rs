//! An inset that enlarges the collision or the smallest gap: at full scale a car is thinner than a line.

use maud::{Markup, html};

use super::axis::Axis;
use super::label::PixelRect;
use super::motion::add_vehicle_band;
use super::panel::{Anchor, Marker, Panel, TaggedLine, draw_line};
use super::path::Px;
use super::scale::extent;
use super::theme::{Ink, Stroke};
use crumple_sim::engine::{Trace, Track};

/// The subject of the inset: two successive vehicles at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Focus {
    pub(super) time_s: f64,
    pub(super) front: usize,
    pub(super) rear: usize,
    pub(super) gap_m: f64,
    pub(super) is_contact: bool,
}

/// Shares of the host's width and height for the inset; the first one that hides little is used.
const INSET_SIZES: [(f64, f64); 4] = [(0.5, 0.46), (0.46, 0.42), (0.42, 0.37), (0.38, 0.33)];

/// Distance of the inset from the host's frame, in pixels.
const MARGIN: f64 = 8.0;

/// Maximum share of the trajectories' points that an inset may hide.
const MAX_HIDDEN_SHARE: f64 = 0.03;

/// Adds the inset in the corner where it hides least, unless it would hide too much.
pub(super) fn add_inset(host: &mut Panel, trace: &Trace, focus: &Focus, id: &str) {
    let (Some(front), Some(rear)) = (
        trace.vehicles.get(focus.front),
        trace.vehicles.get(focus.rear),
    ) else {
        return;
    };
    let (time, space) = zoom_ranges(trace, focus, front, rear);
    let Some(frame) = place_inset(host, trace) else {
        return;
    };

    let mut inset = Panel::new(frame, "", Axis::hidden(time), Axis::hidden(space));
    let from = trace
        .time_s
        .partition_point(|time_s| *time_s < time.0)
        .saturating_sub(1);
    let to = (trace.time_s.partition_point(|time_s| *time_s <= time.1) + 1).min(trace.time_s.len());
    let mut tags = Vec::new();
    for (index, track) in trace.vehicles.iter().enumerate() {
        let Some(part) = excerpt(track, from, to) else {
            continue;
        };
        let (low, high) = extent(part.position_m.iter().copied());
        if high < space.0 || low - part.length_m > space.1 {
            continue;
        }
        let times = trace.time_s.get(from..to).unwrap_or_default();
        add_vehicle_band(&mut inset, times, &part, index);
        let middle = times
            .iter()
            .zip(&part.position_m)
            .map(|(t, x)| (*t, x - part.length_m / 2.0));
        tags.push(TaggedLine {
            points: middle.collect(),
            tag: index.to_string(),
            ink: Ink::Series(index),
        });
    }
    let touch = (
        focus.time_s,
        value_at(trace, &rear.position_m, focus.time_s),
    );
    if focus.is_contact {
        inset.add_markers(&[touch], Marker::Burst, Ink::Alert);
    } else {
        let (ahead_m, middle_m) = (touch.1 + focus.gap_m, touch.1 + focus.gap_m / 2.0);
        inset.add_segment(
            touch,
            (focus.time_s, ahead_m),
            Stroke::solid(Ink::Text, 1.5),
        );
        let beside_s = focus.time_s - 0.03 * (time.1 - time.0);
        inset.add_note(
            (beside_s, middle_m),
            Anchor::End,
            &format!("{:.2} m", focus.gap_m),
            Ink::Text,
        );
    }
    inset.add_tags(&tags);

    let (left, top) = host.to_pixels((time.0, space.1));
    let (right, bottom) = host.to_pixels((time.1, space.0));
    let source = PixelRect {
        left,
        top,
        width: right - left,
        height: bottom - top,
    };
    host.add_overlay(html! {
        (draw_connectors(source, frame))
        (draw_outline(source, "none"))
        (draw_outline(frame, Ink::Paper.hex()))
        (inset.draw(id))
    });
}

fn draw_connectors(source: PixelRect, frame: PixelRect) -> Markup {
    let below = source.top < frame.top;
    let (near, far) = if below {
        (source.bottom(), frame.top)
    } else {
        (source.top, frame.bottom())
    };
    let stroke = Stroke::solid(Ink::Muted, 0.6);
    html! {
        (draw_line((source.left, near), (frame.left, far), stroke))
        (draw_line((source.right(), near), (frame.right(), far), stroke))
    }
}

fn draw_outline(
    PixelRect {
        left,
        top,
        width,
        height,
    }: PixelRect,
    fill: &str,
) -> Markup {
    html! {
        rect x=(Px(left)) y=(Px(top)) width=(Px(width)) height=(Px(height)) fill=(fill) stroke=(Ink::Muted.hex())
            stroke-width="0.8" {}
    }
}

/// Returns the ranges of time and position to enlarge: large enough for both vehicles to stay inside.
fn zoom_ranges(
    trace: &Trace,
    focus: &Focus,
    front: &Track,
    rear: &Track,
) -> ((f64, f64), (f64, f64)) {
    let bodies_m = front.length_m.min(8.0) + rear.length_m.min(12.0);
    let metres = (1.5 * (bodies_m + focus.gap_m.max(0.0))).clamp(12.0, 60.0);
    let speed_at = |track: &Track| value_at(trace, &track.speed_mps, focus.time_s);
    let speed_mps = speed_at(front).max(speed_at(rear));
    let seconds = (1.2 * metres / speed_mps.max(1.0)).clamp(0.4, 4.0);
    let (first, last) = extent(trace.time_s.iter().copied());
    let from = (focus.time_s - 0.65 * seconds)
        .min(last + 0.07 * seconds - seconds)
        .max(first);
    let touch_m = value_at(trace, &rear.position_m, focus.time_s);
    let middle_m =
        touch_m + focus.gap_m / 2.0 + (front.length_m.min(8.0) - rear.length_m.min(12.0)) / 2.0;
    (
        (from, from + seconds),
        (middle_m - metres / 2.0, middle_m + metres / 2.0),
    )
}

/// Returns a frame in the lower right or upper left corner of the host, as large as the trajectories permit.
fn place_inset(host: &Panel, trace: &Trace) -> Option<PixelRect> {
    let around = host.frame;
    let corners = |(wide, high): (f64, f64)| {
        let (width, height) = (wide * around.width, high * around.height);
        let (left, top) = (
            around.right() - width - MARGIN,
            around.bottom() - height - MARGIN,
        );
        let upper_left = PixelRect {
            left: around.left + MARGIN,
            top: around.top + MARGIN,
            width,
            height,
        };
        [
            PixelRect {
                left,
                top,
                width,
                height,
            },
            upper_left,
        ]
    };
    let every = (trace.len() / 64).max(1);
    let samples = trace.vehicles.iter().flat_map(|track| {
        let ends = trace.time_s.iter().zip(&track.position_m).step_by(every);
        ends.flat_map(|(t, x)| {
            [
                host.to_pixels((*t, *x)),
                host.to_pixels((*t, x - track.length_m)),
            ]
        })
    });
    let samples: Vec<_> = samples.collect();
    let hidden = |frame: &PixelRect| {
        let (width, height) = (frame.width + MARGIN, frame.height + MARGIN);
        let wider = PixelRect::from_center(
            (
                frame.left + frame.width / 2.0,
                frame.top + frame.height / 2.0,
            ),
            width,
            height,
        );
        samples
            .iter()
            .filter(|place| wider.contains(**place))
            .count()
    };
    let best = INSET_SIZES
        .into_iter()
        .flat_map(corners)
        .min_by_key(hidden)?;
    (hidden(&best) as f64 <= MAX_HIDDEN_SHARE * samples.len() as f64).then_some(best)
}

fn excerpt(track: &Track, from: usize, to: usize) -> Option<Track> {
    let part = |values: &[f64]| values.get(from..to).map(<[f64]>::to_vec);
    Some(Track {
        position_m: part(&track.position_m)?,
        speed_mps: part(&track.speed_mps)?,
        acceleration_mps2: part(&track.acceleration_mps2)?,
        ..*track
    })
}

/// Returns the value at the first sample not before `time_s`.
pub(super) fn value_at(trace: &Trace, values: &[f64], time_s: f64) -> f64 {
    let index = trace.time_s.partition_point(|time| *time < time_s);
    values.get(index).or(values.last()).copied().unwrap_or(0.0)
}
