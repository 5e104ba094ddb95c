//! Replay memory: flat arrays, oldest transitions overwritten first.

use std::collections::VecDeque;

use rand::RngExt;

use crumple_world::policy::STATE;
use crumple_world::random::Stream;

/// One decision and what came of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// What was seen.
    pub state: [f32; STATE],
    /// What was done, between -1 and 1.
    pub action: f32,
    /// Scaled reward.
    pub reward: f32,
    /// What was seen next.
    pub next_state: [f32; STATE],
    /// Whether the value of the next state counts.
    pub continues: bool,
    /// Whether it ended in contact.
    pub contact: bool,
}

/// The memory of a training.
#[derive(Debug, Clone, PartialEq)]
pub struct Replay {
    capacity: usize,
    /// Transitions ever stored.
    stored: u64,
    data: Vec<Transition>,
    /// Places of transitions that ended in contact, oldest first.
    contacts: VecDeque<u32>,
}

/// Transitions drawn for one update, one row each.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Batch {
    /// States, row after row.
    pub states: Vec<f32>,
    /// Actions.
    pub actions: Vec<f32>,
    /// Rewards.
    pub rewards: Vec<f32>,
    /// Next states, row after row.
    pub next_states: Vec<f32>,
    /// 1 where the value of the next state counts, else 0.
    pub continues: Vec<f32>,
}

impl Batch {
    /// Number of transitions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    fn clear(&mut self) {
        for array in
            [&mut self.states, &mut self.actions, &mut self.rewards, &mut self.next_states, &mut self.continues]
        {
            array.clear();
        }
    }

    /// Adds a transition.
    pub fn push(&mut self, transition: &Transition) {
        self.states.extend_from_slice(&transition.state);
        self.actions.push(transition.action);
        self.rewards.push(transition.reward);
        self.next_states.extend_from_slice(&transition.next_state);
        self.continues.push(f32::from(u8::from(transition.continues)));
    }
}

/// Numbers of one transition in [`Replay::to_numbers`].
const NUMBERS: usize = 2 * STATE + 4;

impl Replay {
    /// An empty memory for `capacity` transitions.
    #[must_use]
    pub fn new(capacity: usize) -> Self {
        Self { capacity: capacity.max(1), stored: 0, data: Vec::new(), contacts: VecDeque::new() }
    }

    /// Number of transitions in memory.
    #[must_use]
    pub fn len(&self) -> usize {
        self.data.len()
    }

    /// Whether nothing was stored yet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.data.is_empty()
    }

    /// Remembers a transition, in place of the oldest one if the memory is full.
    pub fn push(&mut self, transition: Transition) {
        let place = (self.stored % self.capacity as u64) as usize;
        match self.data.get_mut(place) {
            Some(oldest) => {
                if oldest.contact {
                    self.contacts.pop_front();
                }
                *oldest = transition;
            }
            None => self.data.push(transition),
        }
        if transition.contact {
            self.contacts.push_back(place as u32);
        }
        self.stored += 1;
    }

    /// Draws `count` transitions with replacement: `contact_share` of them among those that ended in contact, if there
    /// are any, the others among all.
    pub fn sample(&self, stream: &mut Stream, count: usize, contact_share: f64, batch: &mut Batch) {
        batch.clear();
        if self.data.is_empty() {
            return;
        }
        let of_contacts = if self.contacts.is_empty() { 0 } else { (contact_share * count as f64).round() as usize };
        for index in 0..count {
            let place = if index < of_contacts {
                self.contacts[stream.random_range(0..self.contacts.len())] as usize
            } else {
                stream.random_range(0..self.data.len())
            };
            batch.push(&self.data[place]);
        }
    }

    /// Everything as numbers, for a checkpoint: transitions ever stored, and the memory in order of place.
    #[must_use]
    pub fn to_numbers(&self) -> (u64, Vec<f32>) {
        let flag = |is: bool| f32::from(u8::from(is));
        let numbers = self.data.iter().flat_map(|t| {
            let tail = [t.action, t.reward, flag(t.continues), flag(t.contact)];
            t.state.into_iter().chain(t.next_state).chain(tail)
        });
        (self.stored, numbers.collect())
    }

    /// The memory that [`Replay::to_numbers`] wrote; none if the numbers do not fit each other.
    #[must_use]
    pub fn from_numbers(capacity: usize, stored: u64, numbers: &[f32]) -> Option<Self> {
        let (rows, rest) = numbers.as_chunks::<NUMBERS>();
        if !rest.is_empty() || rows.len() as u64 != stored.min(capacity as u64) {
            return None;
        }
        let mut replay = Self::new(capacity);
        for row in rows {
            let mut numbers = row.iter().copied();
            let mut next = || numbers.next().unwrap_or_default();
            replay.data.push(Transition {
                state: std::array::from_fn(|_| next()),
                next_state: std::array::from_fn(|_| next()),
                action: next(),
                reward: next(),
                continues: next() != 0.0,
                contact: next() != 0.0,
            });
        }
        replay.stored = stored;
        let oldest = if rows.len() < capacity { 0 } else { (stored % capacity as u64) as usize };
        let places = (oldest..rows.len()).chain(0..oldest);
        replay.contacts = places.filter(|&place| replay.data[place].contact).map(|place| place as u32).collect();
        Some(replay)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::random::{Purpose, stream};
    use proptest::prelude::*;

    fn numbered(number: usize) -> Transition {
        Transition {
            state: [number as f32; STATE],
            action: 0.5,
            reward: number as f32,
            next_state: [0.0; STATE],
            continues: !number.is_multiple_of(7),
            contact: number.is_multiple_of(7),
        }
    }

    proptest! {
        /// The memory is always the last `capacity` transitions; contacts among them are known; it survives a checkpoint.
        #[test]
        fn holds_the_last_ones(capacity in 1..30_usize, count in 1..100_usize) {
            let mut replay = Replay::new(capacity);
            (0..count).for_each(|number| replay.push(numbered(number)));
            let kept = count.saturating_sub(capacity)..count;
            let mut rewards: Vec<usize> = replay.data.iter().map(|t| t.reward as usize).collect();
            rewards.sort_unstable();
            prop_assert_eq!(rewards, kept.clone().collect::<Vec<_>>());
            let contacts: Vec<usize> = replay.contacts.iter().map(|&p| replay.data[p as usize].reward as usize).collect();
            prop_assert_eq!(contacts, kept.filter(|number| number % 7 == 0).collect::<Vec<_>>());
            let (stored, numbers) = replay.to_numbers();
            prop_assert_eq!(Replay::from_numbers(capacity, stored, &numbers), Some(replay));
        }
    }

    #[test]
    fn draws_are_uniform_and_contacts_get_their_share() {
        let mut replay = Replay::new(70);
        (0..70).for_each(|number| replay.push(numbered(number)));
        let mut batch = Batch::default();
        let mut counts = [0_u32; 70];
        replay.sample(&mut stream(1, Purpose::ReplayDraw, 0), 70_000, 0.0, &mut batch);
        batch.rewards.iter().for_each(|&number| counts[number as usize] += 1);
        // χ² with 69 degrees of freedom: 99.9 % lie below 111.
        let chi_squared: f64 = counts.iter().map(|&n| (f64::from(n) - 1000.0).powi(2) / 1000.0).sum();
        assert!(chi_squared < 111.0, "{chi_squared}");
        replay.sample(&mut stream(1, Purpose::ReplayDraw, 0), 1000, 0.25, &mut batch);
        let contacts = batch.rewards.iter().take(250).filter(|&&number| (number as usize).is_multiple_of(7)).count();
        assert_eq!((contacts, batch.len()), (250, 1000));
    }
}
