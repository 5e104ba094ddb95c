//! Charts of the leader's acceleration against each controller, all to the same scale.

use maud::{Markup, html};

use super::MildestAttack;
use crate::assessment::CaseVerdict;
use crate::draw::{
    Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Marker, Panel, PixelRect, Stroke, Svg, responsive,
};
use crumple_world::scenario::PiecewiseAcceleration;

const HEIGHT: f64 = 96.0;

/// Time for which a profile is shown after the collision, in seconds.
const TIME_AFTER_CONTACT_S: f64 = 1.0;

pub(super) fn draw_responsive<'a>(
    profiles: impl Iterator<Item = (&'a str, &'a MildestAttack)>,
    duration_s: f64,
) -> Markup {
    let profiles: Vec<_> = profiles.collect();
    let drawn = |prefix: &str, width: f64, columns: usize| draw(&profiles, duration_s, prefix, width, columns);
    responsive(&drawn("worst-profiles-wide", 720.0, 2), &drawn("worst-profiles-narrow", 360.0, 1))
}

fn draw(profiles: &[(&str, &MildestAttack)], duration_s: f64, prefix: &str, width: f64, columns: usize) -> Svg {
    let deepest_mps2 = profiles.iter().map(|(_, mildest)| mildest.peak_brake_mps2.value()).fold(1.0, f64::max);
    let contacts_s = profiles.iter().filter_map(|(_, mildest)| contact_s(mildest));
    let end_s = (contacts_s.fold(1.0, f64::max) + TIME_AFTER_CONTACT_S).min(duration_s);
    let (column_width, row_height) = (width / columns as f64, HEADING_HEIGHT + HEIGHT + BOTTOM_MARGIN);
    let rows = profiles.len().div_ceil(columns);
    let chart = |(index, (controller, mildest)): (usize, &(&str, &MildestAttack))| {
        let (column, row) = (index % columns, index / columns);
        let frame = PixelRect {
            left: column as f64 * column_width + LEFT_MARGIN,
            top: row as f64 * row_height + HEADING_HEIGHT,
            width: column_width - LEFT_MARGIN - 16.0,
            height: HEIGHT,
        };
        let (x, y) = (Axis::numeric("Time (s)", (0.0, end_s), 6), Axis::numeric("", (-1.08 * deepest_mps2, 0.0), 4));
        let mut panel = Panel::new(frame, &format!("{controller}: leader's acceleration (m/s²)"), x, y);
        let steps = mildest.profile.as_ref().map_or_else(Vec::new, |profile| step_corners(profile, end_s));
        let coasting: Vec<_> = steps.iter().map(|&(time_s, _)| (time_s, 0.0)).collect();
        panel.add_band(&coasting, &steps, Ink::Series(0));
        panel.add_line(&steps, Stroke::solid(Ink::Series(0), 1.8));
        if let Some(time_s) = contact_s(mildest) {
            panel.add_vertical_line(time_s, Stroke { dash: "2.2 2.6", ..Stroke::solid(Ink::Alert, 1.2) });
            panel.add_markers(&[(time_s, -0.54 * deepest_mps2)], Marker::Burst, Ink::Alert);
        }
        panel.draw(&Svg::id(prefix, controller))
    };
    let content = html! { @for placed in profiles.iter().enumerate() { (chart(placed)) } };
    let size = (width, rows as f64 * row_height);
    let description = "Acceleration of the leader over time, one chart per controller; a star marks the collision.";
    Svg::new(prefix, size, "Mildest braking of the leader that makes each controller collide", description, content)
}

fn contact_s(mildest: &MildestAttack) -> Option<f64> {
    match &mildest.verdict {
        CaseVerdict::Safe { .. } => None,
        CaseVerdict::ControllerFailed { time_s, .. } => Some(time_s.value()),
        CaseVerdict::Hit(contact) | CaseVerdict::WasHit(contact) | CaseVerdict::OthersCollided(contact) => {
            Some(contact.time_s.value())
        }
    }
}

fn step_corners(profile: &PiecewiseAcceleration, end_s: f64) -> Vec<(f64, f64)> {
    let until_s = profile.from_s.iter().skip(1).copied().chain([end_s]);
    let pieces = profile.from_s.iter().zip(until_s).zip(&profile.accel_mps2);
    pieces
        .filter(|((from_s, _), _)| **from_s < end_s)
        .flat_map(|((&from_s, to_s), &held)| [(from_s, held), (to_s.min(end_s), held)])
        .collect()
}
