//! Vehicles with the Intelligent Driver Model, in all runs of a block.

use pulp::Arch;

use super::loops;
use super::per_run::PerRun;
use super::view::StateSlices;
use crate::control::Idm;
use crate::policy::SimdClosure;

/// One model per run, one array per parameter. Fast, because it is the usual driver of traffic.
pub(super) struct Followers([PerRun; 5]);

impl From<Vec<Idm>> for Followers {
    fn from(models: Vec<Idm>) -> Self {
        Self(std::array::from_fn(|number| {
            PerRun::from_values(models.iter().map(|model| model.to_array()[number]))
        }))
    }
}

impl Followers {
    pub(super) fn model(&self, run: usize) -> Idm {
        Idm::from_array(std::array::from_fn(|number| self.0[number][run]))
    }

    /// Computes the commands behind vehicles `front`.
    pub(super) fn command(
        &self,
        arch: Arch,
        own: &StateSlices<'_>,
        front: &StateSlices<'_>,
        decided_mps2: &mut [f64],
    ) {
        let own = [own.position_m, own.speed_mps];
        let models = self.0.each_ref().map(PerRun::padded);
        let ahead = [front.position_m, front.length_m, front.speed_mps];
        arch.dispatch(SimdClosure(
            #[inline(always)]
            || loops::follow(models, own, ahead, decided_mps2),
        ));
    }

    pub(super) fn swap_remove(&mut self, run: usize) {
        for number in &mut self.0 {
            number.swap_remove(run);
        }
    }
}
