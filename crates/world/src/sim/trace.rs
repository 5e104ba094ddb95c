//! What happened, sample by sample.

/// The recorded motion of all vehicles of one run.
///
/// Samples are taken at the start, after every integration step, and at the instant of first contact where the run
/// ends there. A run that goes on after contact has no samples at the contacts themselves: those are in its impacts. All
/// tracks have one length.
#[derive(Debug, Clone, PartialEq)]
pub struct Trace {
    /// Time of each sample in seconds, increasing.
    pub time_s: Vec<f64>,
    /// One track a vehicle, front to rear.
    pub vehicles: Vec<Track>,
}

/// The motion of one vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Bumper to bumper, in metres.
    pub length_m: f64,
    /// Mass in kilograms.
    pub mass_kg: f64,
    /// Front bumper at each sample, in metres.
    pub position_m: Vec<f64>,
    /// Speed at each sample in m/s, never negative.
    pub speed_mps: Vec<f64>,
    /// Acceleration held from each sample to the next, in m/s²; the last entry repeats the one before, or is
    /// what an impact in between made of it.
    ///
    /// In a step in which the vehicle stops it is the acceleration until it stops; it is 0 from the next step on while the
    /// vehicle stands, whatever is commanded. Changes of speed in impacts are not part of it.
    pub acceleration_mps2: Vec<f64>,
}

impl Trace {
    /// The number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    /// The pair of a vehicle and the one ahead of it; none for the leader.
    #[must_use]
    pub fn pair(&self, rear: usize) -> Option<Pair<'_>> {
        let front = self.vehicles.get(rear.checked_sub(1)?)?;
        let rear = self.vehicles.get(rear)?;
        Some(Pair { time_s: &self.time_s, front, rear })
    }
}

/// Two successive vehicles of a trace.
#[derive(Debug, Clone, Copy)]
pub struct Pair<'a> {
    /// Time of each sample in seconds.
    pub time_s: &'a [f64],
    /// The vehicle ahead.
    pub front: &'a Track,
    /// The vehicle behind.
    pub rear: &'a Track,
}

impl<'a> Pair<'a> {
    /// Bumper gap at each sample, in metres.
    pub fn gaps_m(&self) -> impl Iterator<Item = f64> + use<'a> {
        let length_m = self.front.length_m;
        self.front.position_m.iter().zip(&self.rear.position_m).map(move |(front, rear)| front - length_m - rear)
    }
}
