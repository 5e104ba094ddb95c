//! Growth of cost with size: the exponent p of time = c · sizeᵖ, and a plot.

use std::hint::black_box;

use crumple_report::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Marker, Panel, PixelRect, Stroke, Svg,
};
use crumple_search::falsify::{Method, UnitCube};
use crumple_world::measure::stl::Formula;
use crumple_world::observation::EstimatorKind;
use crumple_world::random::{Purpose, stream};
use crumple_world::sim::{RecordingLevel, simulate_batch};

use crate::clock::min_cpu_time_s;
use crate::work::chasing_cars::{ChasingCarsInputs, PIECES, SPECIFICATIONS, robustness};
use crate::work::long_lines::platoon;
use crate::work::networks::{batch, config, learner};
use crate::work::rollouts::{built_in, runs};

pub struct Growth {
    pub name: &'static str,
    pub points: Vec<(f64, f64)>,
}

impl Growth {
    fn measure(what: &'static str, sizes: &[usize], mut work: impl FnMut(usize) -> Box<dyn FnMut()>) -> Self {
        let point = |&size: &usize| {
            let [seconds] = min_cpu_time_s(8, [&mut work(size)]);
            (size as f64, seconds)
        };
        Self { name: what, points: sizes.iter().map(point).collect() }
    }

    /// Returns the slope of the least-squares line through the logarithms.
    pub fn exponent(&self) -> f64 {
        let n = self.points.len() as f64;
        let logarithms: Vec<_> = self.points.iter().map(|(x, y)| (x.ln(), y.ln())).collect();
        let mean = |of: fn(&(f64, f64)) -> f64| logarithms.iter().map(of).sum::<f64>() / n;
        let (mean_x, mean_y) = (mean(|point| point.0), mean(|point| point.1));
        let rise: f64 = logarithms.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum();
        rise / logarithms.iter().map(|(x, _)| (x - mean_x).powi(2)).sum::<f64>()
    }

    fn relative(&self) -> Vec<(f64, f64)> {
        let (size, seconds) = self.points[0];
        self.points.iter().map(|(x, y)| (x / size, y / seconds)).collect()
    }
}

const BUDGETS: [usize; 6] = [64, 128, 256, 512, 1024, 2048];

pub fn measure() -> Vec<Growth> {
    vec![
        Growth::measure("vehicles (3 to 100)", &[3, 6, 12, 25, 50, 100], |vehicles| drive(vehicles, 5.0, 64)),
        Growth::measure("steps (250 to 8000)", &[250, 500, 1000, 2000, 4000, 8000], |steps| {
            drive(3, steps as f64 / 100.0, 64)
        }),
        Growth::measure("runs in a batch (64 to 2048)", &[64, 128, 256, 512, 1024, 2048], |runs| drive(3, 5.0, runs)),
        Growth::measure("transitions in an update (32 to 1024)", &[32, 64, 128, 256, 512, 1024], update),
        Growth::measure("evaluations in a search, `uniform` (64 to 2048)", &BUDGETS, |budget| {
            search(Method::Uniform, budget)
        }),
        Growth::measure("evaluations in a search, `auto` (64 to 2048)", &BUDGETS, |budget| {
            search(Method::Auto, budget)
        }),
    ]
}

fn drive(vehicles: usize, duration_s: f64, count: usize) -> Box<dyn FnMut()> {
    let scenarios = vec![platoon(vehicles, duration_s); count];
    Box::new(move || {
        let runs = runs(&scenarios, built_in("idm"), EstimatorKind::Truth);
        black_box(simulate_batch(&runs, RecordingLevel::Summary, |_, result| result.outcome));
    })
}

fn update(count: usize) -> Box<dyn FnMut()> {
    let (mut learner, batch) = (learner(&config(64, count)), batch(count));
    let mut noise = stream(1, Purpose::TargetNoise, 0);
    Box::new(move || _ = black_box(learner.update(&batch, &mut noise)))
}

/// Returns a search that never succeeds, so that it uses its whole budget.
fn search(method: Method, budget: usize) -> Box<dyn FnMut()> {
    let formula: Formula = SPECIFICATIONS[3].1.parse().expect("a formula");
    let cube = UnitCube::new([PIECES, PIECES]).expect("not empty");
    Box::new(move || {
        let mut search = method.start(&cube, 1);
        let mut made = 0;
        while made < budget {
            let points = search.ask();
            let inputs = points.iter().take(budget - made).map(|point| ChasingCarsInputs::from_unit(point));
            let values: Vec<f64> = inputs.map(|inputs| robustness(&formula, &inputs).expect("fits")).collect();
            made += values.len();
            search.tell(&values);
        }
    })
}

pub fn figure(all: &[Growth]) -> Svg {
    const WIDTH: f64 = 640.0;
    const HEIGHT: f64 = 360.0;
    let octaves = |last: i32| (0..=last).map(|k| (f64::from(k), format!("{}", 1 << k))).collect::<Vec<_>>();
    let frame = PixelRect { left: LEFT_MARGIN, top: HEADING_HEIGHT, width: WIDTH - LEFT_MARGIN - 16.0, height: HEIGHT };
    let x = Axis::with_ticks("size, as a multiple of the smallest", (0.0, 5.2), octaves(5));
    let y = Axis::with_ticks("", (-0.2, 7.2), octaves(7));
    let title = "Time as a multiple of that of the smallest size";
    let mut panel = Panel::new(frame, title, x, y);
    panel.add_line(&[(0.0, 0.0), (5.2, 5.2)], Stroke { dash: "8 3.5", ..Stroke::solid(Ink::Muted, 1.2) });
    panel.add_note((4.3, 3.3), Anchor::Start, "proportional", Ink::Muted);
    for (index, growth) in all.iter().enumerate() {
        let points: Vec<_> = growth.relative().iter().map(|(x, y)| (x.log2(), y.log2())).collect();
        panel.add_line(&points, Stroke::series(index));
        let marker = [Marker::Disc, Marker::Ring, Marker::Square, Marker::Cross][index % 4];
        panel.add_markers(&points, marker, Ink::Series(index));
        let label = format!("{}: exponent {:.2}", growth.name, growth.exponent());
        panel.add_note((0.15, 6.8 - 0.45 * index as f64), Anchor::Start, &label, Ink::Series(index));
    }
    let content = panel.draw(&Svg::id("scaling", "frame"));
    let description = "Six quantities that decide the cost of a rollout, an update and a search, over a factor of 32.";
    Svg::new("scaling", (WIDTH, HEADING_HEIGHT + HEIGHT + BOTTOM_MARGIN), title, description, content)
}
