//! Replay memory in flat arrays; a new transition overwrites the oldest one.

use std::collections::VecDeque;

use rand::RngExt;

use crumple_sim::random::Stream;

/// One decision and its result.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition<'a> {
    /// Observation at the decision.
    pub state: &'a [f32],
    /// Observation at the next decision.
    pub next_state: &'a [f32],
    /// Privileged information at the decision, then at the next one; empty without privileged critics.
    pub privileged: &'a [f32],
    /// Action, in `[-1, 1]`.
    pub action: f32,
    /// Scaled reward.
    pub reward: f32,
    /// True if the value of the next state is bootstrapped.
    pub continues: bool,
    /// True if the transition ended in a collision.
    pub collision: bool,
    /// Action of the expert, in `[-1, 1]`; none without imitation.
    pub expert_action: Option<f32>,
}

/// Numbers of a transition besides observations: action, reward, `continues`, `collision`, the expert's action.
const SCALAR_COUNT: usize = 5;
/// Value in place of the action of an absent expert, larger than every action. It is not NaN, because checkpoints hold
/// finite numbers only.
pub(super) const NO_EXPERT_ACTION: f32 = 2.0;

/// Layout of a stored transition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct TransitionLayout {
    /// Numbers of an observation.
    pub(crate) state_width: usize,
    /// Numbers of privileged information at each decision.
    pub(crate) privileged_width: usize,
}

impl TransitionLayout {
    pub(super) fn width(self) -> usize {
        2 * (self.state_width + self.privileged_width) + SCALAR_COUNT
    }
}

/// Replay memory of a training.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ReplayBuffer {
    capacity: usize,
    layout: TransitionLayout,
    width: usize,
    total_stored: u64,
    data: Vec<f32>,
    /// Indices of transitions that ended in a collision, oldest first.
    collision_indices: VecDeque<u32>,
}

/// Transitions that are sampled for one update, one row each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// States, row after row.
    pub states: Vec<f32>,
    /// Privileged information, row after row; can be empty.
    pub privileged: Vec<f32>,
    /// Actions.
    pub actions: Vec<f32>,
    /// Rewards.
    pub rewards: Vec<f32>,
    /// Next states, row after row.
    pub next_states: Vec<f32>,
    /// Privileged information at the next states, row after row.
    pub next_privileged: Vec<f32>,
    /// 1 if the value of the next state is bootstrapped, else 0.
    pub continues: Vec<f32>,
    /// Actions of the expert; 2 without imitation.
    pub expert_actions: Vec<f32>,
}

impl Batch {
    /// Returns the number of transitions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// True if the batch is empty.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    fn clear(&mut self) {
        for array in [
            &mut self.states,
            &mut self.privileged,
            &mut self.actions,
            &mut self.rewards,
            &mut self.next_states,
            &mut self.next_privileged,
            &mut self.continues,
            &mut self.expert_actions,
        ] {
            array.clear();
        }
    }

    /// Adds a transition.
    pub fn push(&mut self, transition: &Transition<'_>) {
        self.states.extend_from_slice(transition.state);
        self.actions.push(transition.action);
        self.rewards.push(transition.reward);
        self.next_states.extend_from_slice(transition.next_state);
        let (now, next) = transition
            .privileged
            .split_at(transition.privileged.len() / 2);
        self.privileged.extend_from_slice(now);
        self.next_privileged.extend_from_slice(next);
        self.continues
            .push(f32::from(u8::from(transition.continues)));
        self.expert_actions
            .push(transition.expert_action.unwrap_or(NO_EXPERT_ACTION));
    }
}

impl Transition<'_> {
    /// Returns the numbers in the order of the memory.
    fn to_row(self) -> Vec<f32> {
        let states = [self.state, self.next_state, self.privileged]
            .into_iter()
            .flatten()
            .copied();
        let [continues, collision] =
            [self.continues, self.collision].map(|flag| f32::from(u8::from(flag)));
        let scalars: [f32; SCALAR_COUNT] = [
            self.action,
            self.reward,
            continues,
            collision,
            self.expert_action.unwrap_or(NO_EXPERT_ACTION),
        ];
        states.chain(scalars).collect()
    }
}

impl ReplayBuffer {
    /// Creates an empty memory for `capacity` transitions.
    pub(crate) fn new(capacity: usize, layout: TransitionLayout) -> Self {
        let width = layout.width();
        Self {
            capacity: capacity.max(1),
            layout,
            width,
            total_stored: 0,
            data: Vec::new(),
            collision_indices: VecDeque::new(),
        }
    }

    /// Returns the number of stored transitions.
    pub(crate) fn len(&self) -> usize {
        self.data.len() / self.width
    }

    /// Stores a transition; a full memory overwrites the oldest one.
    pub(crate) fn push(&mut self, transition: &Transition<'_>) {
        let index = (self.total_stored % self.capacity as u64) as usize;
        let numbers = transition.to_row();
        debug_assert_eq!(numbers.len(), self.width, "as wide as the memory");
        match self.data.chunks_exact_mut(self.width).nth(index) {
            Some(oldest) => {
                if self.collision_indices.front() == Some(&(index as u32)) {
                    self.collision_indices.pop_front();
                }
                oldest
                    .iter_mut()
                    .zip(numbers)
                    .for_each(|(of_oldest, number)| *of_oldest = number);
            }
            None => {
                self.reserve_capacity();
                self.data.extend(numbers);
            }
        }
        if transition.collision {
            self.collision_indices.push_back(index as u32);
        }
        self.total_stored += 1;
    }

    /// Tries to reserve the full capacity at once, because growing would hold the data twice.
    fn reserve_capacity(&mut self) {
        if self.data.len() == self.data.capacity() {
            let missing = self
                .capacity
                .saturating_mul(self.width)
                .saturating_sub(self.data.len());
            let _ = self.data.try_reserve_exact(missing);
        }
    }

    /// Samples with replacement; a `collision_fraction` from transitions that ended in a collision, if any.
    pub(crate) fn sample(
        &self,
        stream: &mut Stream,
        count: usize,
        collision_share: f64,
        batch: &mut Batch,
    ) {
        batch.clear();
        if self.data.is_empty() {
            return;
        }
        let of_collisions = if self.collision_indices.is_empty() {
            0
        } else {
            (collision_share * count as f64).round() as usize
        };
        for drawn in 0..count {
            let index = if drawn < of_collisions {
                self.collision_indices[stream.random_range(0..self.collision_indices.len())]
                    as usize
            } else {
                stream.random_range(0..self.len())
            };
            if let Some(transition) = self.transition(index) {
                batch.push(&transition);
            }
        }
    }

    /// Returns the state for a checkpoint: the number of transitions ever stored, and the stored transitions by index.
    pub(crate) fn as_raw_parts(&self) -> (u64, &[f32]) {
        (self.total_stored, &self.data)
    }

    /// Restores the state of [`ReplayBuffer::as_raw_parts`]; none if its lengths are inconsistent.
    pub(crate) fn from_raw_parts(
        capacity: usize,
        remembered: TransitionLayout,
        stored: u64,
        numbers: Vec<f32>,
    ) -> Option<Self> {
        let mut replay = Self {
            total_stored: stored,
            data: numbers,
            ..Self::new(capacity, remembered)
        };
        if !replay.data.len().is_multiple_of(replay.width)
            || replay.len() as u64 != stored.min(capacity as u64)
        {
            return None;
        }
        let oldest = if replay.len() < capacity {
            0
        } else {
            (stored % capacity as u64) as usize
        };
        replay.collision_indices = (oldest..replay.len())
            .chain(0..oldest)
            .filter(|&index| {
                replay
                    .transition(index)
                    .is_some_and(|transition| transition.collision)
            })
            .map(|index| index as u32)
            .collect();
        Some(replay)
    }

    fn transition(&self, index: usize) -> Option<Transition<'_>> {
        let row = self
            .data
            .get(index * self.width..(index + 1) * self.width)?;
        let (states, &[action, reward, continues, collision, expert]) = row.split_last_chunk()?;
        let (state, others) = states.split_at_checked(self.layout.state_width)?;
        let (next_state, privileged) = others.split_at_checked(self.layout.state_width)?;
        Some(Transition {
            state,
            next_state,
            privileged,
            action,
            reward,
            continues: continues != 0.0,
            collision: collision != 0.0,
            expert_action: Some(expert).filter(|&action| action != NO_EXPERT_ACTION),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::random::{Purpose, stream};
    use proptest::prelude::*;

    const LAYOUT: TransitionLayout = TransitionLayout {
        state_width: 24,
        privileged_width: 2,
    };
    const STATE_ROW: [f32; LAYOUT.state_width] = [0.25; LAYOUT.state_width];
    const PRIVILEGED_ROW: [f32; 2 * LAYOUT.privileged_width] = [0.5; 2 * LAYOUT.privileged_width];

    fn numbered_transition(number: usize) -> Transition<'static> {
        Transition {
            state: &STATE_ROW,
            next_state: &STATE_ROW,
            privileged: &PRIVILEGED_ROW,
            action: 0.5,
            reward: number as f32,
            continues: !number.is_multiple_of(7),
            collision: number.is_multiple_of(7),
            expert_action: (!number.is_multiple_of(3)).then_some(0.25),
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// The memory holds the last `capacity` transitions and finds collisions, also after a checkpoint.
        #[test]
        fn the_replay_buffer_keeps_the_last_transitions(capacity in 1..30_usize, count in 1..100_usize) {
            let mut replay = ReplayBuffer::new(capacity, LAYOUT);
            (0..count).for_each(|number| replay.push(&numbered_transition(number)));
            let kept = count.saturating_sub(capacity)..count;
            let offset = 2 * STATE_ROW.len() + PRIVILEGED_ROW.len() + 1;
            let reward = |place: usize| replay.data[place * replay.width + offset] as usize;
            let mut rewards: Vec<usize> = (0..replay.len()).map(reward).collect();
            rewards.sort_unstable();
            prop_assert_eq!(rewards, kept.clone().collect::<Vec<_>>());
            let collisions: Vec<usize> = replay.collision_indices.iter().map(|&p| reward(p as usize)).collect();
            prop_assert_eq!(collisions, kept.filter(|number| number % 7 == 0).collect::<Vec<_>>());
            prop_assert_eq!(replay.data.capacity(), capacity * replay.width);
            let (stored, numbers) = replay.as_raw_parts();
            let numbers = numbers.to_vec();
            prop_assert_eq!(ReplayBuffer::from_raw_parts(capacity, LAYOUT, stored, numbers), Some(replay));
        }
    }

    #[test]
    fn sampling_is_uniform_and_collisions_get_their_share() {
        let mut replay = ReplayBuffer::new(70, LAYOUT);
        (0..70).for_each(|number| replay.push(&numbered_transition(number)));
        let mut batch = Batch::default();
        let mut counts = [0_u32; 70];
        replay.sample(
            &mut stream(1, Purpose::ReplaySampling, 0),
            70_000,
            0.0,
            &mut batch,
        );
        batch
            .rewards
            .iter()
            .for_each(|&number| counts[number as usize] += 1);
        // The 99.9 % quantile of χ² with 69 degrees of freedom is 111.
        let chi_squared: f64 = counts
            .iter()
            .map(|&n| (f64::from(n) - 1000.0).powi(2) / 1000.0)
            .sum();
        assert!(chi_squared < 111.0, "{chi_squared}");
        replay.sample(
            &mut stream(1, Purpose::ReplaySampling, 0),
            1000,
            0.25,
            &mut batch,
        );
        let collisions = batch
            .rewards
            .iter()
            .take(250)
            .filter(|&&number| (number as usize).is_multiple_of(7))
            .count();
        assert_eq!((collisions, batch.len()), (250, 1000));
    }
}
