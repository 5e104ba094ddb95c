//! The simulator and the checker accept the same policy files: a certificate must not be about a file that cannot
//! drive.

use crumple_sim::policy::Policy;
use crumple_verify::reach::NeuralController;
use rand::rngs::Xoshiro256PlusPlus;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};

#[test]
fn the_checker_refuses_all_policy_files_that_the_simulator_refuses() {
    let genuine = [Policy::reference_bytes(), Policy::retrained_bytes()];
    let (mut refused, mut accepted) = (0, 0);
    for seed in 0..6000 {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut bytes = genuine[seed as usize % 2].to_vec();
        let header = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
        let in_header = random.random_range(8..8 + header);
        match random.random_range(0..6_u32) {
            0 | 1 => {
                bytes[in_header] = *b"0123456789,:{}[]\" -eE.+nul".choose(&mut random).unwrap()
            }
            2 => bytes.truncate(random.random_range(0..bytes.len())),
            3 => bytes.extend_from_slice(&[0; 4]),
            4 => {
                // NaN, infinite, huge, or an ordinary number, in place of a weight.
                let at = 8 + header + 4 * random.random_range(0..(bytes.len() - 8 - header) / 4);
                let value = [f32::NAN, f32::INFINITY, 3e38, -1e30, 0.5]
                    .choose(&mut random)
                    .unwrap();
                bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            }
            _ => bytes[random.random_range(0..8)] ^= 1 << random.random_range(0..8_u32),
        }
        match (
            NeuralController::from_bytes(&bytes),
            Policy::from_bytes(&bytes),
        ) {
            (Ok(_), Err(error)) => {
                panic!("{seed}: the checker accepts what the simulator refuses: {error}")
            }
            (Ok(actor), Ok(policy)) => {
                accepted += 1;
                let action = &policy.header().action;
                assert_eq!(
                    actor.action_bounds_mps2,
                    [action.low_mps2, action.high_mps2],
                    "{seed}"
                );
                assert_eq!(
                    actor.decision_interval_s,
                    policy.header().decision_interval_s,
                    "{seed}"
                );
            }
            (Err(_), _) => refused += 1,
        }
    }
    assert!(
        refused > 1000 && accepted > 500,
        "{refused} refused, {accepted} accepted"
    );
}
