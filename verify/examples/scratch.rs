mod inner {
    #[path = "/work/h59/crates/evidence/src/invariant/search.rs"]
    pub mod search;
    pub fn run(
        c: &crumple_verify::invariant::ClosedLoop<'_>,
        t: &mut crumple_verify::invariant::table::HeightTable,
        h: f64,
    ) -> Option<u32> {
        search::raise_boundary(c, t, h, &mut |p, f| {
            if p % 20 == 0 || f == 0 {
                let e = t0();
                eprintln!("pass {p} failed {f} {e:.1}s");
            }
            true
        })
    }
    fn t0() -> f64 {
        static S: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new();
        S.get_or_init(std::time::Instant::now).elapsed().as_secs_f64()
    }
}
use crumple_verify::invariant::table::*;
use crumple_verify::invariant::*;
use crumple_verify::reach::*;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let v: f64 = a[2].parse().unwrap();
    let own_cells: u32 = a[3].parse().unwrap();
    let leader_cells: u32 = a[4].parse().unwrap();
    let splits: u32 = a[5].parse().unwrap();
    let law = if a[1] == "idm" {
        FollowerLaw::Idm(IdmLaw {
            desired_speed_mps: 120.0 / 3.6,
            time_headway_s: 1.6,
            standstill_gap_m: 2.0,
            accel_mps2: 0.73,
            comfortable_brake_mps2: 1.67,
            max_accel_mps2: 3.0,
        })
    } else {
        FollowerLaw::AccAeb(AccAebLaw {
            ttc_s: 1.4,
            time_headway_s: 0.8,
            standstill_gap_m: 2.0,
            gap_gain_per_s2: 0.25,
            speed_gain_per_s: 0.8,
            comfort_brake_mps2: 3.5,
            comfort_accel_mps2: 2.0,
            max_accel_mps2: 3.0,
        })
    };
    let d = v / f64::from(own_cells);
    let own = Axis { low: 0.0, high: v + 2.0 * d, cells: own_cells + 2 };
    let leader = Axis { low: 0.0, high: 35.0, cells: leader_cells };
    let mut claim = InvariantClaim {
        motion: MotionModel::Absolute,
        controller: InvariantController::Law(law),
        step_s: 0.01,
        decision_steps: 1,
        response_per_step: 1.0,
        own_mps2: [-7.5, 3.0],
        leader_mps2: [-7.5, 3.0],
        observation_error: [1e-9; 3],
        region_gap_m: 100.0,
        region_own_mps: [0.0, 35.0],
        region_leader_mps: [0.0, 35.0],
        initial_own_mps_at_most: own.node(own_cells as usize),
        axes: [own, leader, Axis::point(0.0)],
        splits,
        heights: vec![],
        share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
    };
    let mut table = HeightTable::new(claim.axes, 0.0).unwrap();
    let floor = (claim.floor_m() / HEIGHT_UNIT_M).ceil() * HEIGHT_UNIT_M + HEIGHT_UNIT_M;
    table = HeightTable::new(claim.axes, floor).unwrap();
    let r = claim.with_closed_loop(None, |c| inner::run(c, &mut table, 300.0)).unwrap();
    println!("{r:?} {:?}", table.extremes());
    for i in (0..=own_cells as usize + 2).step_by((own_cells as usize / 8).max(1)) {
        let row: Vec<String> = (0..=leader_cells as usize)
            .step_by((leader_cells as usize / 8).max(1))
            .map(|j| format!("{:7.2}", table.node_height([i, j, 0])))
            .collect();
        println!("v={:5.2}: {}", own.node(i), row.join(" "));
    }
    if r.is_some() {
        claim.heights = table.to_runs();
        println!("runs {} share {}", claim.heights.len(), claim.share(&table).unwrap());
    }
}
