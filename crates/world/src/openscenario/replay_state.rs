//! State of the replay that conditions read.

use super::replay::Replay;
use super::storyboard::StoryEvent;

/// Start and end of an element, if they were reached, and whether they depend on a controller.
type ElementTimes = ([Option<f64>; 2], bool);

impl Replay<'_, '_> {
    pub(super) fn speed_mps(&self, entity: usize, time_s: f64) -> f64 {
        self.motion.get(entity).map_or(0.0, |motion| motion.plan.at(time_s).speed_mps)
    }

    /// Returns the position of the reference point along the road, in metres.
    pub(super) fn position_m(&self, entity: usize, time_s: f64) -> f64 {
        self.motion.get(entity).map_or(0.0, |motion| motion.plan.at(time_s).position_m)
    }

    /// Returns the distance of the front and of the rear bumper from the reference point, in metres.
    pub(super) fn bumpers_m(&self, entity: usize) -> [f64; 2] {
        self.entities.get(entity).map_or([0.0; 2], |one| [one.front_m, one.length_m - one.front_m])
    }

    /// Returns the times of an element of the storyboard; `None` if there is no such element.
    pub(super) fn element_times_s(&self, kind: &str, name: &str) -> Option<ElementTimes> {
        if kind == "action" {
            return self.events.iter().find_map(|event| {
                let place = event.actions.iter().position(|(action, _)| action == name)?;
                Some(([event.start_s, event.action_ends_s.get(place).copied()], event.depends))
            });
        }
        let level = ["story", "act", "maneuverGroup", "maneuver"].iter().position(|level| *level == kind);
        let is_inside = |event: &&StoryEvent<'_>| match level {
            Some(level) => event.parents.get(level).is_some_and(|parent| parent == name),
            None => kind == "event" && event.name == name,
        };
        let inside: Vec<_> = self.events.iter().filter(is_inside).collect();
        let start_s = inside.iter().filter_map(|event| event.start_s).reduce(f64::min);
        let end_s = inside.iter().map(|event| event.end_s()).reduce(|a, b| a.zip(b).map(|(a, b)| a.max(b))).flatten();
        (!inside.is_empty()).then(|| ([start_s, end_s], inside.iter().any(|event| event.depends)))
    }

    /// Returns true if the motion of an entity depends on a controller.
    pub(super) fn is_controlled(&self, entity: usize) -> bool {
        self.motion.get(entity).is_some_and(|motion| motion.is_controlled)
    }
}
