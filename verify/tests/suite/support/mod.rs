//! Scenes, and an independent, plain simulation of them.

pub mod closed_loop;
pub mod exact;
pub mod mutants;
pub mod networks;

use crumple_verify::*;
use num_rational::BigRational;
use num_traits::FromPrimitive;
use proptest::prelude::*;
use sha2::{Digest, Sha256};

pub fn rational(value: f64) -> BigRational {
    BigRational::from_f64(value).unwrap()
}

/// True if an interval with finite ends contains an exact number.
pub fn contains(interval: Interval, value: &BigRational) -> bool {
    rational(interval.low()) <= *value && *value <= rational(interval.high())
}

pub fn sha256(bytes: impl AsRef<[u8]>) -> String {
    Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

pub fn policy_bytes(name: &str) -> Vec<u8> {
    std::fs::read(format!(
        "{}/../corpora/policy/{name}.safetensors",
        env!("CARGO_MANIFEST_DIR")
    ))
    .unwrap()
}

/// Returns a scene in which a leader of 2 m holds its speed, `gap_m` ahead of the only ego vehicle.
pub fn one_ego_scene(
    (step_s, steps): (f64, u32),
    gap_m: f64,
    [leader_mps, ego_mps]: [f64; 2],
    [max_brake_mps2, max_accel_mps2]: [f64; 2],
) -> Scene {
    let point = Interval::point;
    Scene {
        step_s,
        steps,
        leader: SceneLeader {
            position_m: point(gap_m + 2.0),
            length_m: 2.0,
            speed_mps: point(leader_mps),
            acceleration_mps2: vec![ConstantPiece(steps, Interval::ZERO)],
        },
        egos: vec![SceneEgo {
            position_m: Interval::ZERO,
            length_m: 2.0,
            speed_mps: point(ego_mps),
            max_brake_mps2,
            max_accel_mps2,
        }],
        follower: None,
    }
}

pub fn follower_at(position_m: f64, speed_mps: f64) -> SceneFollower {
    SceneFollower {
        position_m: Interval::point(position_m),
        speed_mps: Interval::point(speed_mps),
        brake_mps2: Interval::point(6.0),
        ttc_s: 1.0,
        reaction_steps: 0,
    }
}

pub fn expand_to_substeps(witness: &[Vec<ConstantPiece<f64>>]) -> Vec<Vec<f64>> {
    let pieces_of = |profile: &Vec<ConstantPiece<f64>>| {
        profile
            .iter()
            .flat_map(|held| vec![held.1; held.0 as usize * SUBSTEPS])
            .collect()
    };
    witness.iter().map(pieces_of).collect()
}

/// Substeps in a step. Profiles change between them, so they are more general than any held over steps.
pub const SUBSTEPS: usize = 6;

#[derive(Debug, Clone)]
pub struct SceneMember {
    pub leader: [f64; 2],
    pub leader_mps2: Vec<f64>,
    pub egos: Vec<[f64; 2]>,
    pub follower: Option<[f64; 3]>,
}

/// Returns the member that `pick` chooses: 0 for the low end of an interval, 1 for the high one.
pub fn pick_member(scene: &Scene, mut pick: impl FnMut() -> f64) -> SceneMember {
    let mut sample = |interval: Interval| {
        let value = interval.low() + pick() * (interval.high() - interval.low());
        value.clamp(interval.low(), interval.high())
    };
    SceneMember {
        leader: [
            sample(scene.leader.position_m),
            sample(scene.leader.speed_mps),
        ],
        leader_mps2: scene
            .leader
            .acceleration_mps2
            .iter()
            .flat_map(|&ConstantPiece(steps, a)| std::iter::repeat_n(a, steps as usize))
            .map(&mut sample)
            .collect(),
        egos: scene
            .egos
            .iter()
            .map(|ego| [sample(ego.position_m), sample(ego.speed_mps)])
            .collect(),
        follower: scene.follower.as_ref().map(|f| {
            [
                sample(f.position_m),
                sample(f.speed_mps),
                sample(f.brake_mps2),
            ]
        }),
    }
}

#[derive(Debug, Clone)]
pub struct SimulatedRun {
    /// Rear bumper of the leader at the instants.
    pub leader_rear_m: Vec<f64>,
    /// Position and speed of each ego at the instants.
    pub egos: Vec<Vec<[f64; 2]>>,
    /// First instant with a negative guard of the follower; N if none.
    pub fired: u32,
    /// Smallest gap at the ends of substeps.
    pub min_gap_m: f64,
}

/// Returns position and speed after `dt`, without reversing.
pub fn advance([x, v]: [f64; 2], a: f64, dt: f64) -> [f64; 2] {
    let end = v + a * dt;
    if end < 0.0 {
        [x - v * v / (2.0 * a), 0.0]
    } else {
        [x + v * dt + 0.5 * a * dt * dt, end]
    }
}

pub fn simulate_scene(scene: &Scene, member: &SceneMember, profiles: &[Vec<f64>]) -> SimulatedRun {
    let dt = scene.step_s / SUBSTEPS as f64;
    let mut leader = member.leader;
    let mut egos = member.egos.clone();
    let mut rear = member.follower.map(|[x, v, _]| [x, v]);
    let last_length_m = scene.egos.last().unwrap().length_m;
    let gaps = |leader: [f64; 2], egos: &[[f64; 2]], rear: Option<[f64; 2]>| {
        let mut bumper = leader[0] - scene.leader.length_m;
        let mut least = f64::INFINITY;
        for (ego, spec) in egos.iter().zip(&scene.egos) {
            least = least.min(bumper - ego[0]);
            bumper = ego[0] - spec.length_m;
        }
        rear.map_or(least, |rear| least.min(bumper - rear[0]))
    };
    let mut seen = SimulatedRun {
        leader_rear_m: vec![leader[0] - scene.leader.length_m],
        egos: egos.iter().map(|ego| vec![*ego]).collect(),
        fired: scene.steps,
        min_gap_m: gaps(leader, &egos, rear),
    };
    for k in 0..scene.steps {
        let mut rear_mps2 = 0.0;
        if let (Some(follower), Some(rear), Some([_, _, brake])) =
            (&scene.follower, rear, member.follower)
        {
            let ego = egos.last().unwrap();
            let guard = ego[0] - last_length_m - rear[0] - follower.ttc_s * (rear[1] - ego[1]);
            if guard < 0.0 && seen.fired == scene.steps {
                seen.fired = k;
            }
            if seen.fired < scene.steps && k >= seen.fired + follower.reaction_steps {
                rear_mps2 = -brake;
            }
        }
        for substep in 0..SUBSTEPS {
            leader = advance(leader, member.leader_mps2[k as usize], dt);
            for (ego, profile) in egos.iter_mut().zip(profiles) {
                *ego = advance(*ego, profile[k as usize * SUBSTEPS + substep], dt);
            }
            rear = rear.map(|rear| advance(rear, rear_mps2, dt));
            seen.min_gap_m = seen.min_gap_m.min(gaps(leader, &egos, rear));
        }
        seen.leader_rear_m.push(leader[0] - scene.leader.length_m);
        for (path, ego) in seen.egos.iter_mut().zip(&egos) {
            path.push(*ego);
        }
    }
    seen
}

/// True if some profile of three levels, each held over a block of substeps, escapes in this member.
pub fn has_escape(scene: &Scene, member: &SceneMember, blocks: usize) -> bool {
    let substeps = scene.steps as usize * SUBSTEPS;
    let choices = scene.egos.len() * blocks;
    (0..3_usize.pow(choices as u32)).any(|code| {
        let level = |ego: &SceneEgo, index: usize| match code / 3_usize.pow(index as u32) % 3 {
            0 => -ego.max_brake_mps2,
            1 => 0.0,
            _ => ego.max_accel_mps2,
        };
        let profiles: Vec<Vec<f64>> = scene
            .egos
            .iter()
            .enumerate()
            .map(|(i, ego)| {
                (0..substeps)
                    .map(|j| level(ego, i * blocks + j * blocks / substeps))
                    .collect()
            })
            .collect();
        simulate_scene(scene, member, &profiles).min_gap_m > 0.0
    })
}

/// Returns the rows of a branch as `(multiplier, value, is_collision_row)` for one run of one member.
pub fn row_values(
    scene: &Scene,
    member: &SceneMember,
    run: &SimulatedRun,
    branch: &Branch,
) -> Vec<(f64, f64, bool)> {
    let h = scene.step_s;
    let (first_ego, last_ego) = (&run.egos[0], run.egos.last().unwrap());
    let length_m = scene.egos.last().unwrap().length_m;
    let mut rows = Vec::new();
    for &(k, y) in &branch.front {
        rows.push((
            y,
            first_ego[k as usize][0] - run.leader_rear_m[k as usize],
            true,
        ));
    }
    for (i, list) in branch.between.iter().enumerate() {
        for &(k, y) in list {
            let [ahead, behind] = [i, i + 1].map(|ego| run.egos[ego][k as usize][0]);
            rows.push((y, behind - ahead + scene.egos[i].length_m, true));
        }
    }
    for (i, list) in branch.speed.iter().enumerate() {
        rows.extend(
            list.iter()
                .map(|&(k, y)| (y, -run.egos[i][k as usize][1], false)),
        );
    }
    if let (Some(follower), Some([r0, vr, brake])) = (&scene.follower, member.follower) {
        for &(k, y) in &branch.rear {
            let coast_s = f64::from(k.min(branch.first + follower.reaction_steps)) * h;
            let braking = advance([r0 + vr * coast_s, vr], -brake, f64::from(k) * h - coast_s);
            rows.push((y, braking[0] + length_m - last_ego[k as usize][0], true));
        }
        let guard = |k: u32| {
            let [x, v] = last_ego[k as usize];
            x - length_m - (r0 + vr * f64::from(k) * h) - follower.ttc_s * (vr - v)
        };
        rows.extend(branch.unfired.iter().map(|&(k, y)| (y, -guard(k), false)));
        if branch.fired > 0.0 {
            rows.push((branch.fired, guard(branch.first), false));
        }
    }
    rows
}

fn interval_around(value: f64, width: f64) -> Interval {
    Interval::new(value - width / 2.0, value + width / 2.0).unwrap()
}

prop_compose! {
    /// Generates narrow scenes, half of them boxes, most of them with a follower.
    pub fn scenes(egos: usize)(
        steps in 2..8_u32, step_s in prop::sample::select(vec![0.1, 0.25, 0.5]),
        width in prop_oneof![Just(0.0), 0.0..0.5], leader in (0.0..20.0_f64, -8.0..2.0_f64, -8.0..2.0_f64),
        spaced in prop::collection::vec((0.1..12.0_f64, 0.0..25.0_f64, 0.0..9.0_f64, 0.0..3.0_f64), egos),
        follower in prop::option::weighted(0.8, (0.1..15.0_f64, 5.0..30.0_f64, 1.0..8.0_f64, 0.0..3.0_f64, 0..3_u32)),
    ) -> Scene {
        let mut bumper = -2.0;
        let around = |middle: f64| interval_around(middle, width);
        let speed = |v: f64| around(v + width / 2.0);
        let egos: Vec<SceneEgo> = spaced.into_iter().map(|(gap, v, max_brake_mps2, max_accel_mps2)| {
            let position_m = around(bumper - gap);
            bumper = bumper - gap - 3.0;
            SceneEgo { position_m, length_m: 3.0, speed_mps: speed(v), max_brake_mps2, max_accel_mps2 }
        }).collect();
        Scene {
            step_s, steps,
            leader: SceneLeader {
                position_m: around(0.0), length_m: 2.0, speed_mps: speed(leader.0),
                acceleration_mps2: vec![ConstantPiece(1, around(leader.1)), ConstantPiece(steps - 1, around(leader.2))],
            },
            egos,
            follower: follower.map(|(gap, v, brake, ttc_s, reaction_steps)| SceneFollower {
                position_m: around(bumper - gap), speed_mps: speed(v), brake_mps2: around(brake), ttc_s, reaction_steps,
            }),
        }
    }
}

/// Generates accelerations within the egos' limits, per substep or held.
pub fn profiles(scene: &Scene) -> impl Strategy<Value = Vec<Vec<f64>>> + use<> {
    let egos = scene.egos.clone();
    let substeps = scene.steps as usize * SUBSTEPS;
    let levels = prop::collection::vec(
        prop_oneof![Just(0.0), Just(1.0), 0.0..1.0_f64],
        egos.len() * substeps,
    );
    (levels, prop::sample::select(vec![1, 3, SUBSTEPS, 1000])).prop_map(move |(levels, held)| {
        let at = |i: usize, j: usize| levels[i * substeps + j / held * held];
        let trajectory_of = |(i, ego): (usize, &SceneEgo)| {
            (0..substeps)
                .map(|j| at(i, j) * (ego.max_accel_mps2 + ego.max_brake_mps2) - ego.max_brake_mps2)
                .map(|a| a.clamp(-ego.max_brake_mps2, ego.max_accel_mps2))
                .collect()
        };
        egos.iter().enumerate().map(trajectory_of).collect()
    })
}

/// Generates sparse multipliers for the instants below `end`.
fn multiplier_lists(end: u32) -> impl Strategy<Value = Vec<(u32, f64)>> {
    let value = prop_oneof![3 => Just(0.0), 1 => Just(1.0), 1 => 0.0..2.0_f64];
    prop::collection::vec(value, end as usize).prop_map(|values| {
        (0..)
            .zip(values)
            .filter(|row| row.1 > 0.0)
            .collect::<Vec<_>>()
    })
}

pub fn branches(scene: &Scene) -> impl Strategy<Value = Branch> + use<> {
    let (n, egos, has_follower) = (scene.steps, scene.egos.len(), scene.follower.is_some());
    let ends = if has_follower {
        (0..=n, 0..=n).boxed()
    } else {
        Just((0, n)).boxed()
    };
    ends.prop_flat_map(move |(a, b)| {
        let (first, last) = (a.min(b), a.max(b));
        let with_follower = move |end: u32| if has_follower { end } else { 0 };
        let fired = if has_follower && first == last && first < n {
            0.0..1.0_f64
        } else {
            0.0..f64::MIN_POSITIVE
        };
        (
            multiplier_lists(n + 1),
            prop::collection::vec(multiplier_lists(n + 1), egos - 1),
            multiplier_lists(with_follower(n + 1)),
            prop::collection::vec(multiplier_lists(n + 1), egos),
            multiplier_lists(with_follower(first)),
            fired.prop_map(|fired| {
                if fired < f64::MIN_POSITIVE {
                    0.0
                } else {
                    fired
                }
            }),
        )
            .prop_map(
                move |(front, between, rear, speed, unfired, fired)| Branch {
                    first,
                    last,
                    front,
                    between,
                    rear,
                    speed,
                    unfired,
                    fired,
                },
            )
    })
}

pub fn certificate(statement: Statement) -> Certificate {
    let provenance = CertificateProvenance {
        crumple: "0".into(),
        scenario: "a test".into(),
        ..CertificateProvenance::default()
    };
    Certificate {
        version: 1,
        provenance,
        assumptions: statement.assumptions(),
        statement,
    }
}

pub fn reach_certificate(claim: reach::ReachClaim) -> Certificate {
    certificate(Statement::Reach(claim))
}

/// Generates scenes with multipliers that often prove them unavoidable: the best of many guesses per firing instant.
pub fn proofs(egos: usize) -> impl Strategy<Value = (Scene, Vec<Branch>)> {
    let guess = (
        any::<[prop::sample::Index; 4]>(),
        any::<[bool; 4]>(),
        0.2..3.0_f64,
        0.0..2.0_f64,
        0.0..2.0_f64,
    );
    (scenes(egos), prop::collection::vec(guess, 60)).prop_map(|(scene, guesses)| {
        let n = scene.steps;
        let ends = if scene.follower.is_some() { n } else { 0 };
        let branches = (0..=ends).map(|first| {
            let last = if ends == 0 { n } else { first };
            let guessed = guesses.iter().map(|(at, with, rear, unfired, fired)| {
                let k = |i: usize| at[i].index(n as usize + 1) as u32;
                let list =
                    |is_there: bool, row: (u32, f64)| if is_there { vec![row] } else { Vec::new() };
                Branch {
                    first,
                    last,
                    front: list(with[0] || ends == 0, (k(0), 1.0)),
                    between: (1..scene.egos.len())
                        .map(|_| list(true, (k(1), 1.0)))
                        .collect(),
                    rear: list(ends > 0 && with[1], (k(2), *rear)),
                    unfired: list(
                        with[2] && first > 0,
                        (at[3].index(first.max(1) as usize) as u32, *unfired),
                    ),
                    fired: if with[3] && first < ends { *fired } else { 0.0 },
                    ..Branch::default()
                }
            });
            let proved_m = |branch: &Branch| match unavoidable::check_branch(&scene, branch, 0) {
                Ok(overlap_m) => overlap_m,
                Err(Rejection::Unproved { sum_m, .. }) => sum_m.min(0.0),
                Err(other) => panic!("{other}"),
            };
            guessed
                .max_by(|a, b| proved_m(a).total_cmp(&proved_m(b)))
                .expect("some guess")
        });
        let branches = branches.collect();
        (scene, branches)
    })
}
