//! An inset that enlarges the collision or the smallest gap: at full scale a car is thinner than a line.

use maud::{Markup, html};

use super::axis::Axis;
use super::label::PixelRect;
use super::motion::add_vehicle_band;
use super::panel::{Anchor, Marker, Panel, TaggedLine, draw_line};
use super::path::{PixelPoint, Px};
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
    pub(super) is_collision: bool,
}

/// Shares of the host's width and height for the inset; the first one that hides little is used.
const INSET_SIZES: [(f64, f64); 4] = [(0.5, 0.46), (0.46, 0.42), (0.42, 0.37), (0.38, 0.33)];

/// Distance of the inset from the host's frame, in pixels.
const MARGIN: f64 = 8.0;

/// Maximum share of the trajectories' points that an inset may hide.
const MAX_HIDDEN_SHARE: f64 = 0.03;

/// Adds the inset in the corner where it hides least, unless it would hide too much.
pub(super) fn add_inset(host: &mut Panel, trace: &Trace, focus: &Focus, id: &str) {
    let Some(front) = trace.vehicles.get(focus.front) else {
        return;
    };
    let Some(rear) = trace.vehicles.get(focus.rear) else {
        return;
    };
    let zoom = ZoomRanges::around_focus(trace, focus, front, rear);
    let Some(frame) = place_inset(host, trace) else {
        return;
    };
    let mut inset = Panel::new(
        frame,
        "",
        Axis::hidden(zoom.time_s),
        Axis::hidden(zoom.position_m),
    );
    let tags = add_vehicle_bands(&mut inset, trace, &zoom);
    let rear_m = value_at(trace, &rear.position_m, focus.time_s);
    add_focus(&mut inset, focus, rear_m, &zoom);
    inset.add_tags(&tags);
    let source = zoom.to_pixels(host);
    host.add_overlay(html! {
        (draw_connectors(source, frame))
        (draw_outline(source, "none"))
        (draw_outline(frame, Ink::Paper.hex()))
        (inset.draw(id))
    });
}

/// Adds the vehicles inside the enlarged ranges, and returns their tags.
fn add_vehicle_bands(inset: &mut Panel, trace: &Trace, zoom: &ZoomRanges) -> Vec<TaggedLine> {
    let from = trace
        .time_s
        .partition_point(|time_s| *time_s < zoom.time_s.0)
        .saturating_sub(1);
    let to = (trace
        .time_s
        .partition_point(|time_s| *time_s <= zoom.time_s.1)
        + 1)
    .min(trace.time_s.len());
    let times = trace.time_s.get(from..to).unwrap_or_default();
    let mut tags = Vec::new();
    for (index, track) in trace.vehicles.iter().enumerate() {
        let Some(part) = excerpt(track, from, to) else {
            continue;
        };
        let (low, high) = extent(part.position_m.iter().copied());
        if high < zoom.position_m.0 || low - part.length_m > zoom.position_m.1 {
            continue;
        }
        add_vehicle_band(inset, times, &part, index);
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
    tags
}

/// Marks the collision, or the smallest gap with its length.
fn add_focus(inset: &mut Panel, focus: &Focus, rear_m: f64, zoom: &ZoomRanges) {
    let rear = (focus.time_s, rear_m);
    if focus.is_collision {
        inset.add_markers(&[rear], Marker::Burst, Ink::Alert);
        return;
    }
    let front = (focus.time_s, rear_m + focus.gap_m);
    inset.add_segment(rear, front, Stroke::solid(Ink::Text, 1.5));
    let note = (
        focus.time_s - 0.03 * (zoom.time_s.1 - zoom.time_s.0),
        rear_m + focus.gap_m / 2.0,
    );
    inset.add_note(
        note,
        Anchor::End,
        &format!("{:.2} m", focus.gap_m),
        Ink::Text,
    );
}

fn draw_connectors(source: PixelRect, frame: PixelRect) -> Markup {
    let is_below = source.top < frame.top;
    let source_y = if is_below {
        source.bottom()
    } else {
        source.top
    };
    let frame_y = if is_below { frame.top } else { frame.bottom() };
    let stroke = Stroke::solid(Ink::Muted, 0.6);
    html! {
        (draw_line((source.left, source_y), (frame.left, frame_y), stroke))
        (draw_line((source.right(), source_y), (frame.right(), frame_y), stroke))
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

/// The ranges of time and position that the inset enlarges.
struct ZoomRanges {
    time_s: (f64, f64),
    position_m: (f64, f64),
}

impl ZoomRanges {
    /// Returns ranges that are large enough for both vehicles to stay inside.
    fn around_focus(trace: &Trace, focus: &Focus, front: &Track, rear: &Track) -> Self {
        let bodies_m = front.length_m.min(8.0) + rear.length_m.min(12.0);
        let metres = (1.5 * (bodies_m + focus.gap_m.max(0.0))).clamp(12.0, 60.0);
        let front_mps = value_at(trace, &front.speed_mps, focus.time_s);
        let rear_mps = value_at(trace, &rear.speed_mps, focus.time_s);
        let speed_mps = front_mps.max(rear_mps);
        let seconds = (1.2 * metres / speed_mps.max(1.0)).clamp(0.4, 4.0);
        let (first, last) = extent(trace.time_s.iter().copied());
        let from = (focus.time_s - 0.65 * seconds)
            .min(last + 0.07 * seconds - seconds)
            .max(first);
        let rear_m = value_at(trace, &rear.position_m, focus.time_s);
        let middle_m =
            rear_m + focus.gap_m / 2.0 + (front.length_m.min(8.0) - rear.length_m.min(12.0)) / 2.0;
        Self {
            time_s: (from, from + seconds),
            position_m: (middle_m - metres / 2.0, middle_m + metres / 2.0),
        }
    }

    /// Returns the enlarged part of the host.
    fn to_pixels(&self, host: &Panel) -> PixelRect {
        let upper_left = host.to_pixels((self.time_s.0, self.position_m.1));
        let lower_right = host.to_pixels((self.time_s.1, self.position_m.0));
        PixelRect {
            left: upper_left.0,
            top: upper_left.1,
            width: lower_right.0 - upper_left.0,
            height: lower_right.1 - upper_left.1,
        }
    }
}

/// Returns a frame in the lower right or upper left corner of the host, as large as the trajectories permit.
fn place_inset(host: &Panel, trace: &Trace) -> Option<PixelRect> {
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
    let best = INSET_SIZES
        .into_iter()
        .flat_map(|shares| corner_frames(host.frame, shares))
        .min_by_key(|frame| count_hidden(&samples, frame))?;
    let hidden = count_hidden(&samples, &best);
    (hidden as f64 <= MAX_HIDDEN_SHARE * samples.len() as f64).then_some(best)
}

/// Returns frames in the lower right and the upper left corner, with these shares of the host's width and height.
fn corner_frames(host: PixelRect, (width_share, height_share): (f64, f64)) -> [PixelRect; 2] {
    let width = width_share * host.width;
    let height = height_share * host.height;
    let lower_right = PixelRect {
        left: host.right() - width - MARGIN,
        top: host.bottom() - height - MARGIN,
        width,
        height,
    };
    let upper_left = PixelRect {
        left: host.left + MARGIN,
        top: host.top + MARGIN,
        width,
        height,
    };
    [lower_right, upper_left]
}

/// Counts the samples that a frame hides with its surroundings.
fn count_hidden(samples: &[PixelPoint], frame: &PixelRect) -> usize {
    let centre = (
        frame.left + frame.width / 2.0,
        frame.top + frame.height / 2.0,
    );
    let wider = PixelRect::from_center(centre, frame.width + MARGIN, frame.height + MARGIN);
    samples
        .iter()
        .filter(|sample| wider.contains(**sample))
        .count()
}

fn excerpt(track: &Track, from: usize, to: usize) -> Option<Track> {
    Some(Track {
        position_m: track.position_m.get(from..to)?.to_vec(),
        speed_mps: track.speed_mps.get(from..to)?.to_vec(),
        acceleration_mps2: track.acceleration_mps2.get(from..to)?.to_vec(),
        ..*track
    })
}

/// Returns the value at the first sample not before `time_s`.
pub(super) fn value_at(trace: &Trace, values: &[f64], time_s: f64) -> f64 {
    let index = trace.time_s.partition_point(|time| *time < time_s);
    values.get(index).or(values.last()).copied().unwrap_or(0.0)
}
