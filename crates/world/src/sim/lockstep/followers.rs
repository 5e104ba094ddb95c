//! Vehicles with the Intelligent Driver Model, in all runs of a block.

use pulp::Arch;

use super::loops;
use super::per_run::PerRun;
use super::view::NeighbourhoodView;
use crate::control::Idm;
use crate::policy::SimdClosure;

/// One model per run, one array per parameter. Fast, because it is the usual driver of traffic.
pub(super) struct Followers([PerRun; 5]);

impl From<Vec<Idm>> for Followers {
    fn from(models: Vec<Idm>) -> Self {
        Self(std::array::from_fn(|number| PerRun::from_values(models.iter().map(|model| model.to_array()[number]))))
    }
}

impl Followers {
    pub(super) fn model(&self, run: usize) -> Idm {
        Idm::from_array(std::array::from_fn(|number| self.0[number][run]))
    }

    pub(super) fn command(&self, arch: Arch, view: &NeighbourhoodView<'_>, decided_mps2: &mut [f64]) {
        let own = [view.own.position_m, view.own.speed_mps];
        let Some(front) = &view.front else {
            for (run, (decided_mps2, &speed_mps)) in decided_mps2.iter_mut().zip(own[1]).enumerate() {
                *decided_mps2 = self.model(run).acceleration_mps2(speed_mps, None);
            }
            return;
        };
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
