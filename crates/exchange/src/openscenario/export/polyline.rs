//! The motion of a vehicle as a polyline with as few vertices as position and speed permit.

use std::io;

use quick_xml::events::{BytesText, Event};

use super::storyboard::VehicleManeuver;
use super::{Xml, format_number, reference_point_m, write_element, write_empty_element};
use crate::openscenario::vocabulary::{POSITION_MODE, ReferenceContext, Word as _, path};
use crumple_sim::engine::{Trace, Track};

/// Maximum position error of a polyline, in metres.
pub(crate) const POSITION_TOLERANCE_M: f64 = 0.002;
/// Maximum speed error of a polyline, in m/s, over segments of more than one step.
pub(crate) const SPEED_TOLERANCE_MPS: f64 = 0.005;
/// Minimum time between two vertices, in seconds: shorter ones would let rounding determine the speed.
const MIN_STEP_S: f64 = 1e-6;
/// Time for which the last vertex holds the position after the end, in seconds.
const HOLD_S: f64 = 1.0;

/// Returns the indices of the samples that are vertices, always including the first and last.
pub(super) fn vertex_indices(time_s: &[f64], track: &Track) -> Vec<usize> {
    let mut vertices =
        simplify_polyline(time_s, &track.position_m, POSITION_TOLERANCE_M, |index| {
            let &mps = track.speed_mps.get(index)?;
            Some([mps - SPEED_TOLERANCE_MPS, mps + SPEED_TOLERANCE_MPS])
        });
    // A collision may be a nanosecond after a step.
    if let [.., before, last] = *vertices
        && let (Some(from_s), Some(to_s)) = (time_s.get(before), time_s.get(last))
        && to_s - from_s < MIN_STEP_S
        && vertices.len() > 2
    {
        vertices.remove(vertices.len() - 2);
    }
    vertices
}

/// Returns the fewest samples, chosen greedily, such that each segment stays within `tolerance` of the values it
/// passes, with a slope that each of them allows, including its ends. A segment of one step is always allowed.
pub(super) fn simplify_polyline(
    time_s: &[f64],
    values: &[f64],
    tolerance: f64,
    slopes: impl Fn(usize) -> Option<[f64; 2]>,
) -> Vec<usize> {
    let samples = Samples {
        time_s,
        values,
        slopes,
    };
    let count = time_s.len().min(values.len());
    let mut vertices: Vec<usize> = (0..count.min(1)).collect();
    let mut from = 0;
    let mut allowed = samples.allowed_slopes(0);
    for to in 1..count {
        let [low, high] = intersect(allowed, samples.allowed_slopes(to));
        let straight = samples.slope(from, to, 0.0);
        if to > from + 1 && !(low..=high).contains(&straight) {
            from = to - 1;
            vertices.push(from);
            allowed = samples.allowed_slopes(from);
        }
        allowed = intersect(
            intersect(allowed, samples.allowed_slopes(to)),
            [-tolerance, tolerance].map(|offset| samples.slope(from, to, offset)),
        );
    }
    if count > 1 {
        vertices.push(count - 1);
    }
    vertices
}

/// Samples of a polyline, with the slopes that each allows.
struct Samples<'a, F> {
    time_s: &'a [f64],
    values: &'a [f64],
    slopes: F,
}

impl<F: Fn(usize) -> Option<[f64; 2]>> Samples<'_, F> {
    /// Returns the range of slopes at a sample; all slopes if it states none.
    fn allowed_slopes(&self, index: usize) -> [f64; 2] {
        (self.slopes)(index).unwrap_or([f64::NEG_INFINITY, f64::INFINITY])
    }

    /// Returns the slope from a sample to a point at `offset` from another.
    fn slope(&self, from: usize, to: usize, offset: f64) -> f64 {
        let [from_value, to_value] =
            [from, to].map(|index| self.values.get(index).copied().unwrap_or(f64::NAN));
        let [from_s, to_s] =
            [from, to].map(|index| self.time_s.get(index).copied().unwrap_or(f64::NAN));
        (to_value + offset - from_value) / (to_s - from_s)
    }
}

/// Returns the intersection of two ranges.
fn intersect([a_low, a_high]: [f64; 2], [b_low, b_high]: [f64; 2]) -> [f64; 2] {
    [a_low.max(b_low), a_high.min(b_high)]
}

/// A vehicle that follows its polyline.
pub(super) struct Trajectory<'a> {
    pub(super) index: usize,
    pub(super) trace: &'a Trace,
    pub(super) vertex_indices: Vec<usize>,
    pub(super) end_s: f64,
}

impl VehicleManeuver for Trajectory<'_> {
    fn vehicle_index(&self) -> usize {
        self.index
    }

    fn start_event(&self) -> Option<(&'static str, f64)> {
        Some(("trajectory", 0.0))
    }

    fn write_action(&self, xml: &mut Xml) -> io::Result<()> {
        let name = format!("{}_path", super::entity_name(self.index));
        let absolute = [
            ("domainAbsoluteRelative", ReferenceContext::Absolute.name()),
            ("scale", "1"),
            ("offset", "0"),
        ];
        write_element(xml, path::TRAJECTORY_ACTION, &[], |xml| {
            write_element(
                xml,
                "TrajectoryRef/Trajectory",
                &[("name", &name), ("closed", "false")],
                |xml| write_element(xml, "Shape/Polyline", &[], |xml| self.write_vertices(xml)),
            )?;
            write_empty_element(xml, "TimeReference/Timing", &absolute)?;
            write_empty_element(
                xml,
                "TrajectoryFollowingMode",
                &[("followingMode", POSITION_MODE)],
            )
        })
    }
}

impl Trajectory<'_> {
    /// Writes one line of text per vertex, without an XML writer: numbers need no escapes, and there are thousands.
    fn write_vertices(&self, xml: &mut Xml) -> io::Result<()> {
        let Some(track) = self.trace.vehicles.get(self.index) else {
            return Ok(());
        };
        let samples = self.vertex_indices.iter().filter_map(|&index| {
            Some((
                *self.trace.time_s.get(index)?,
                *track.position_m.get(index)?,
            ))
        });
        let end = track
            .position_m
            .last()
            .map(|&front_m| (self.end_s + HOLD_S, front_m));
        let mut lines = String::from("\n");
        for (time_s, front_m) in samples.chain(end) {
            let x_m = reference_point_m(front_m, track.length_m);
            let [time, x] = [time_s, x_m].map(format_number);
            let position = format!("<Position><WorldPosition x=\"{x}\" y=\"0\"/></Position>");
            lines += &format!("<Vertex time=\"{time}\">{position}</Vertex>\n");
        }
        xml.write_event(Event::Text(BytesText::from_escaped(lines)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polylines_have_vertices_only_at_ends_and_corners() {
        let time_s: Vec<f64> = (0..=100).map(|k| f64::from(k) * 0.01).collect();
        let straight: Vec<f64> = time_s.iter().map(|t| 5.0 + 20.0 * t).collect();
        assert_eq!(
            simplify_polyline(&time_s, &straight, 1e-3, |_| None),
            [0, 100]
        );
        let corner: Vec<f64> = time_s.iter().map(|t| (t - 0.5).abs()).collect();
        assert_eq!(
            simplify_polyline(&time_s, &corner, 1e-6, |_| None),
            [0, 50, 100]
        );
        assert_eq!(
            simplify_polyline(&time_s[..1], &straight[..1], 1e-3, |_| None),
            [0]
        );
        assert_eq!(simplify_polyline(&[], &[], 1e-3, |_| None), [0usize; 0]);
    }
}
