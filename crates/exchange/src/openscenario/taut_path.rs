//! The shortest path in a tube around the vertices of a trajectory.

use super::trajectory::PathVertex;
use std::collections::VecDeque;

/// A time and a position.
pub(super) type Point = (f64, f64);

/// Returns the shortest path from the first to the last vertex that passes each at a distance of at most `tube_m`: no
/// other path in the tube changes from acceleration to braking less often (Davies and Kovac, Annals of Statistics
/// 2001, section 3).
pub(super) fn taut_path(vertices: &[PathVertex], tube_m: f64) -> Vec<Point> {
    let mut vertices = vertices
        .iter()
        .map(|vertex| (vertex.time_s, vertex.position_m));
    let Some(start) = vertices.next() else {
        return Vec::new();
    };
    let mut funnel = Funnel::new(start);
    let mut vertices = vertices.peekable();
    while let Some((time_s, position_m)) = vertices.next() {
        let is_last = vertices.peek().is_none();
        let tube_m = if is_last { 0.0 } else { tube_m };
        funnel.add((time_s, position_m + tube_m), Side::Upper);
        if !is_last {
            funnel.add((time_s, position_m - tube_m), Side::Lower);
        }
    }
    funnel.finish()
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    Upper,
    Lower,
}

/// Shortest paths from the end of the path so far, the apex, to the newest upper and the newest lower bound.
struct Funnel {
    path: Vec<Point>,
    /// Upper chain from its end to the apex, then lower chain to its end.
    chains: VecDeque<Point>,
    /// Index of the apex in `chains`.
    apex: usize,
}

impl Funnel {
    fn new(start: Point) -> Self {
        Self {
            path: vec![start],
            chains: VecDeque::from([start]),
            apex: 0,
        }
    }

    /// Adds a bound.
    fn add(&mut self, point: Point, side: Side) {
        // Counted from the end of the chain of this side.
        let mut to_apex = match side {
            Side::Upper => self.apex,
            Side::Lower => self.chains.len() - 1 - self.apex,
        };
        while let Some((end, next)) = self.end(side) {
            let bends_back = match side {
                Side::Upper => slope(next, point) <= slope(next, end),
                Side::Lower => slope(next, point) >= slope(next, end),
            };
            if to_apex > 0 {
                if !bends_back {
                    break;
                }
                to_apex -= 1;
            } else {
                // `end` is the apex, and `next` the first point of the other chain.
                let is_beyond = match side {
                    Side::Upper => slope(end, point) < slope(end, next),
                    Side::Lower => slope(end, point) > slope(end, next),
                };
                if !is_beyond {
                    break;
                }
                self.path.push(next);
            }
            self.pop(side);
        }
        match side {
            Side::Upper => self.chains.push_front(point),
            Side::Lower => self.chains.push_back(point),
        }
        self.apex = match side {
            Side::Upper => to_apex + 1,
            Side::Lower => self.chains.len() - 2 - to_apex,
        };
    }

    /// Returns the last point of a chain and the one before it.
    fn end(&self, side: Side) -> Option<(Point, Point)> {
        let count = self.chains.len();
        let [end, next] = match side {
            Side::Upper => [Some(0), Some(1)],
            Side::Lower => [count.checked_sub(1), count.checked_sub(2)],
        };
        Some((*self.chains.get(end?)?, *self.chains.get(next?)?))
    }

    fn pop(&mut self, side: Side) {
        match side {
            Side::Upper => self.chains.pop_front(),
            Side::Lower => self.chains.pop_back(),
        };
    }

    /// Returns the path to the last upper bound.
    fn finish(mut self) -> Vec<Point> {
        let upper = self.chains.iter().take(self.apex).rev();
        self.path.extend(upper);
        self.path
    }
}

/// Returns the mean speed between two points.
pub(super) fn slope(from: Point, to: Point) -> f64 {
    (to.1 - from.1) / (to.0 - from.0)
}
