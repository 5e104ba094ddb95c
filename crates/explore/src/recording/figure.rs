//! Diagrams of a recorded drive with the commands of controllers.

use crumple_exchange::recording::replay::{OpenLoopDrive, ReplayStep};
use crumple_report::draw::{
    Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect, Stroke, Svg,
    draw_legend, extent, pad_interval,
};
use maud::{Markup, html};

use super::ReplayedController;

const PANEL_HEIGHT: f64 = 150.0;
/// Largest time to collision in the diagram, in seconds.
const MAX_TTC_S: f64 = 10.0;
/// Indices of the lines; those of the controllers follow.
const LEADER: usize = 0;
const VEHICLE: usize = 1;
const FOLLOWER: usize = 2;
const FIRST_CONTROLLER: usize = 3;

/// One line of a diagram: its index, and times in seconds with values.
struct SeriesLine {
    index: usize,
    points: Vec<(f64, f64)>,
}

/// A diagram over the time of the recording.
struct ReplayPanel {
    id: &'static str,
    title: String,
    range: (f64, f64),
    lines: Vec<SeriesLine>,
}

/// Draws speeds, gaps, accelerations and time to collision of a drive, or of the part within `window_s`.
pub(super) fn draw_replay(
    drive: &OpenLoopDrive,
    replayed: &[ReplayedController<'_>],
    window_s: Option<[f64; 2]>,
    narrow: bool,
) -> Markup {
    let width = if narrow { 380.0 } else { 900.0 };
    let [from_s, until_s] = window_s.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    let shown = |step: &ReplayStep| (from_s..=until_s).contains(&step.time_s);
    let steps: Vec<ReplayStep> = drive.steps().iter().copied().filter(shown).collect();
    let panels = [
        speed_panel(&steps),
        gap_panel(&steps),
        acceleration_panel(drive, &steps, replayed),
        ttc_panel(&steps),
    ];
    let time_s = extent(steps.iter().map(|step| step.time_s));
    let names = entry_names(&steps, replayed);
    let entries: Vec<_> = names
        .iter()
        .map(|(index, name)| (Stroke::series(*index), name.as_str()))
        .collect();
    let (key, key_height) = draw_legend(&entries, width - 12.0);
    let step = PANEL_HEIGHT + BOTTOM_MARGIN + HEADING_HEIGHT;
    let content = html! {
        g transform="translate(12 4)" { (key) }
        @for (index, panel) in panels.iter().enumerate() {
            @let top = key_height + HEADING_HEIGHT + step * index as f64;
            (panel.draw(time_s, PixelRect {
                left: LEFT_MARGIN, top, width: width - LEFT_MARGIN - 14.0, height: PANEL_HEIGHT
            }))
        }
    };
    let description = describe(time_s);
    let size = (width, key_height + step * panels.len() as f64);
    let title = format!("Recorded drive of vehicle {}", drive.vehicle());
    Svg::new("replay", size, &title, &description, content).inline()
}

fn describe((from_s, until_s): (f64, f64)) -> String {
    format!(
        "Speeds, bumper gaps, accelerations and time to collision of a recorded drive from {from_s:.2} to {until_s:.2} \
         s, with the acceleration that each controller commands."
    )
}

/// Returns the index and the name of each line, for the legend.
fn entry_names(steps: &[ReplayStep], replayed: &[ReplayedController<'_>]) -> Vec<(usize, String)> {
    let mut names = vec![
        (LEADER, "leader".to_owned()),
        (VEHICLE, "vehicle, recorded".to_owned()),
    ];
    if steps.iter().any(|step| step.observed.behind.is_some()) {
        names.push((FOLLOWER, "follower".to_owned()));
    }
    let commanded = replayed.iter().enumerate();
    names.extend(commanded.map(|(index, controller)| {
        (
            FIRST_CONTROLLER + index,
            format!("commanded by {}", controller.name),
        )
    }));
    names
}

fn series(
    index: usize,
    steps: &[ReplayStep],
    value: impl Fn(&ReplayStep) -> Option<f64>,
) -> SeriesLine {
    let points = steps
        .iter()
        .filter_map(|step| Some((step.time_s, value(step)?)));
    SeriesLine {
        index,
        points: points.collect(),
    }
}

fn speed_panel(steps: &[ReplayStep]) -> ReplayPanel {
    let lines = vec![
        series(LEADER, steps, |step| {
            step.observed.ahead.map(|ahead| ahead.speed_mps)
        }),
        series(VEHICLE, steps, |step| Some(step.observed.speed_mps)),
        series(FOLLOWER, steps, |step| {
            step.observed.behind.map(|behind| behind.speed_mps)
        }),
    ];
    ReplayPanel::new("speed", "Recorded speed (m/s)", [0.0, 1.0], lines)
}

fn gap_panel(steps: &[ReplayStep]) -> ReplayPanel {
    let lines = vec![
        series(VEHICLE, steps, |step| {
            step.observed.ahead.map(|ahead| ahead.gap_m)
        }),
        series(FOLLOWER, steps, |step| {
            step.observed.behind.map(|behind| behind.gap_m)
        }),
    ];
    let title = "Recorded gap between bumpers, ahead of each vehicle (m)";
    ReplayPanel::new("gap", title, [0.0, 1.0], lines)
}

fn acceleration_panel(
    drive: &OpenLoopDrive,
    steps: &[ReplayStep],
    replayed: &[ReplayedController<'_>],
) -> ReplayPanel {
    let mut lines = vec![series(VEHICLE, steps, |step| {
        Some(step.observed.acceleration_mps2)
    })];
    let time_s = extent(steps.iter().map(|step| step.time_s));
    for (index, controller) in replayed.iter().enumerate() {
        let commands = drive.steps().iter().zip(&controller.commands_mps2);
        let points = commands
            .map(|(step, command_mps2)| (step.time_s, *command_mps2))
            .filter(|(at_s, _)| (time_s.0..=time_s.1).contains(at_s));
        lines.push(SeriesLine {
            index: FIRST_CONTROLLER + index,
            points: points.collect(),
        });
    }
    let title = "Acceleration, recorded and commanded (m/s²)";
    ReplayPanel::new("acceleration", title, [-1.0, 1.0], lines)
}

fn ttc_panel(steps: &[ReplayStep]) -> ReplayPanel {
    let line = series(VEHICLE, steps, |step| {
        let ahead = step.observed.ahead?;
        let closing_mps = step.observed.speed_mps - ahead.speed_mps;
        let ttc_s = ahead.gap_m / closing_mps;
        (closing_mps > 0.0 && ttc_s <= MAX_TTC_S).then_some(ttc_s)
    });
    let title = format!("Recorded time to collision with the leader, to {MAX_TTC_S} s (s)");
    ReplayPanel {
        range: (0.0, MAX_TTC_S),
        ..ReplayPanel::new("ttc", &title, [0.0, MAX_TTC_S], vec![line])
    }
}

impl ReplayPanel {
    /// Creates a diagram whose range contains all lines and the values `contained`.
    fn new(id: &'static str, title: &str, contained: [f64; 2], lines: Vec<SeriesLine>) -> Self {
        let values = lines
            .iter()
            .flat_map(|line| line.points.iter().map(|point| point.1));
        Self {
            id,
            title: title.to_owned(),
            range: pad_interval(extent(values.chain(contained)), 0.05),
            lines,
        }
    }

    fn draw(&self, time_s: (f64, f64), frame: PixelRect) -> Markup {
        let x = Axis::numeric("Time of the recording (s)", time_s, 8);
        let y = Axis::numeric("", self.range, 5);
        let mut panel = Panel::new(frame, &self.title, x, y);
        panel.add_horizontal_line(0.0, Stroke::solid(Ink::Muted, 1.0));
        for line in &self.lines {
            // A line is interrupted where its value is unknown.
            let is_next = |a: &(f64, f64), b: &(f64, f64)| b.0 - a.0 < 1.5 * OpenLoopDrive::STEP_S;
            for part in line.points.chunk_by(is_next) {
                panel.add_line(part, Stroke::series(line.index));
            }
        }
        panel.draw(&Svg::id("replay", self.id))
    }
}
