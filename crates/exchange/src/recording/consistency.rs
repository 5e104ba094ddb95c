//! Columns that contradict each other: positions and gaps against the speeds that change them.

use std::collections::VecDeque;
use std::fmt;

use super::dropped::{DroppedItem, Omission};
use super::error::{ColumnProblem, LineProblem, RecordingError};
use super::map::{SpeedUnit, TimeSpec, TimeUnit};
use super::table::RowReader;
use crumple_core::digits::format_fixed;

/// Shortest time, in seconds, and largest number of rows of a window.
const WINDOW_S: f64 = 0.5;
const MAX_WINDOW_ROWS: usize = 50;
/// Smallest change within a window that tells more than noise, in metres.
const MIN_CHANGE_M: f64 = 0.3;
const MIN_WINDOWS: usize = 5;
/// Largest median error that noise explains, in m/s and relative to the smaller rate: a tenth and a twentieth below
/// errors of 0.5 m/s and 4 %, which are found beside noise, too.
const MIN_ERROR_MPS: f64 = 0.45;
const MAX_RELATIVE_ERROR: f64 = 0.038;
/// Largest relative error that a reason leaves; in noisy data it is larger.
const MAX_EXPLAINED_ERROR: f64 = 0.15;
/// In a recording that is too short to average noise out, an error without a reason is reported from this on: in m/s,
/// and relative to the rates.
const MIN_UNEXPLAINED_MPS: f64 = 1.5;
const MIN_UNEXPLAINED: f64 = 0.5;
/// Duration, in seconds, over which noise averages out: four windows, whose changes have a quarter of its error.
const LASTING_S: f64 = 2.0;
/// Largest median error over this time that noise explains, in m/s. In the published samples of OpenACC it is at most
/// 0.21 m/s, and at least 0.3 m/s for spacings beside the speeds of another pair.
const MAX_LASTING_ERROR_MPS: f64 = 0.25;
/// Share of the median error of all windows that noise of their ends leaves over this time: a quarter, with a margin.
const NOISE_SHARE: f64 = 0.4;
/// Further share if there are few such times, times the root of their number.
const FEW_WINDOWS_MARGIN: f64 = 2.0;
/// This margin at a hundred times, which [`NOISE_SHARE`] includes for errors that the columns show without selection.
const MARGIN_OF_MANY: f64 = 0.2;
/// Longest time without a row within this duration, in seconds.
const MAX_PAUSE_S: f64 = 0.5;
/// A reason explains an error if it leaves this share of it.
const EXPLAINED_SHARE: f64 = 0.25;
/// Ratios that a reason names, and the share of what another reason leaves that is clearly less.
const USUAL_RATIOS: std::ops::Range<f64> = 0.2..5.0;
const CLEARLY_LESS: f64 = 0.5;
/// Smallest ratio of both rates that shows another unit, whatever the noise.
const MIN_RATIO: f64 = 1.3;
/// Half width of the interval of this ratio in standard errors, and tolerance beside it.
const RATIO_ERRORS: f64 = 4.0;
const RATIO_TOLERANCE: f64 = 0.03;

/// Intervals of frames in seconds, by their rate.
#[rustfmt::skip]
const FRAME_INTERVALS_S: &[(&str, f64)] = &[
    ("5 Hz", 1.0 / 5.0), ("10 Hz", 1.0 / 10.0), ("12.5 Hz", 1.0 / 12.5), ("15 Hz", 1.0 / 15.0), ("20 Hz", 1.0 / 20.0),
    ("24 Hz", 1.0 / 24.0), ("25 Hz", 1.0 / 25.0), ("30 Hz", 1.0 / 30.0), ("50 Hz", 1.0 / 50.0), ("60 Hz", 1.0 / 60.0),
];

/// Two columns, or sums of columns, whose values exclude each other.
#[derive(Debug, Clone, PartialEq)]
pub struct ColumnContradiction {
    /// Columns, as nouns.
    pub columns: [String; 2],
    /// Rate by each of them, where their difference is the median.
    pub rates: [f64; 2],
    /// Unit of the rates.
    pub unit: &'static str,
    /// Likely reason.
    pub reason: Option<String>,
}

impl fmt::Display for ColumnContradiction {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            columns: [first, second],
            rates,
            unit,
            reason,
        } = self;
        let [first_rate, second_rate] = rates.map(|rate| format_fixed(rate, 1));
        write!(
            out,
            "{first} is {first_rate} {unit} here, but {second} is {second_rate} {unit}"
        )?;
        match reason {
            Some(reason) => write!(out, ": {reason}"),
            None => out.write_str(", and no other unit or sign explains this"),
        }
    }
}

/// A change of the map, or of the data, that would end a contradiction.
pub(super) struct Hypothesis {
    /// Factor of each term.
    pub(super) factors: [f64; 3],
    pub(super) reason: String,
}

impl Hypothesis {
    /// Returns the hypothesis that a column of relative speeds, which is compared with a gap, has the opposite sign.
    pub(super) fn opposite_sign(column: &str) -> Self {
        Self {
            factors: [1.0, -1.0, -1.0],
            reason: format!("{column} has the opposite sign"),
        }
    }

    /// Returns a hypothesis for each other unit of a column with the given terms.
    pub(super) fn units<'a>(
        column: &'a str,
        (units, given): (&'a [(&'static str, f64)], f64),
        terms: [bool; 3],
    ) -> impl Iterator<Item = Self> + 'a {
        units
            .iter()
            .filter(move |(_, factor)| *factor != given)
            .map(move |(name, factor)| {
                let change = factor / given;
                let factors = terms.map(|is_scaled| if is_scaled { change } else { 1.0 });
                Self {
                    factors,
                    reason: format!("{column} looks like {name}: ratio {:.2}", 1.0 / change),
                }
            })
    }

    /// Returns a hypothesis for each other unit of both speeds, or of either.
    pub(super) fn speeds<'a>(
        [(leader, leader_unit), (follower, follower_unit)]: [(&'a str, f64); 2],
        difference: &'a str,
    ) -> impl Iterator<Item = Self> + 'a {
        let leader_units = (SpeedUnit::ALL, leader_unit);
        let follower_units = (SpeedUnit::ALL, follower_unit);
        Self::units(difference, leader_units, [false, true, true])
            .filter(move |_| leader_unit == follower_unit)
            .chain(Self::units(leader, leader_units, [false, true, false]))
            .chain(Self::units(follower, follower_units, [false, false, true]))
    }

    /// Returns a hypothesis for each other unit of the time, or rate of frames.
    pub(super) fn times(time: &TimeSpec, given: f64) -> impl Iterator<Item = Self> {
        const TERMS: [bool; 3] = [false, true, true];
        match time {
            TimeSpec::Clock(clock) => Self::units(&clock.column, (TimeUnit::ALL, given), TERMS),
            TimeSpec::Frames(frames) => {
                Self::units(&frames.column, (FRAME_INTERVALS_S, given), TERMS)
            }
        }
    }
}

/// Factors of columns in the units of the map.
const GIVEN: [f64; 3] = [1.0; 3];

#[derive(Debug, Clone, Copy)]
struct Window {
    /// The first term should be the sum of the others.
    terms: [f64; 3],
    seconds: f64,
    /// Start and end in the recording.
    from_s: f64,
    to_s: f64,
    line: u64,
}

impl Window {
    fn rates(&self, factors: [f64; 3]) -> [f64; 2] {
        let [level, first, second] =
            [0, 1, 2].map(|index| factors[index] * self.terms[index] / self.seconds);
        [level, first + second]
    }

    fn difference(&self, factors: [f64; 3]) -> f64 {
        let [change, stated] = self.rates(factors);
        change - stated
    }

    fn largest_mps(&self, factors: [f64; 3]) -> f64 {
        let [change, stated] = self.rates(factors).map(f64::abs);
        change.max(stated)
    }

    fn smallest_mps(&self) -> f64 {
        let [change, stated] = self.rates(GIVEN).map(f64::abs);
        change.min(stated)
    }

    /// Returns whether one of the chosen rates makes a larger change than noise within a time.
    fn tells(&self, which: [bool; 2], seconds: f64) -> bool {
        let mut rates = self.rates(GIVEN).into_iter().zip(which);
        rates.any(|(rate_mps, is_chosen)| is_chosen && (rate_mps * seconds).abs() >= MIN_CHANGE_M)
    }

    /// Returns this window and the next one as one window.
    fn join(self, next: &Self) -> Self {
        let terms = [0, 1, 2].map(|index| self.terms[index] + next.terms[index]);
        Self {
            terms,
            seconds: self.seconds + next.seconds,
            to_s: next.to_s,
            ..self
        }
    }
}

/// Comparison of the change of a column with the integral of others.
#[derive(Default)]
pub(super) struct Comparison {
    windows: Vec<Window>,
    current: Option<OpenWindow>,
    /// True if the direction of the change is unknown.
    is_undirected: bool,
    /// True for speeds and accelerations.
    compares_speeds: bool,
}

/// A window to which rows are added.
#[derive(Clone, Copy)]
struct OpenWindow {
    first: Sample,
    last: Sample,
    rows: usize,
    /// Integral of each rate over the window.
    integrals_m: [f64; 2],
}

impl OpenWindow {
    fn new(first: Sample) -> Self {
        Self {
            first,
            last: first,
            rows: 1,
            integrals_m: [0.0; 2],
        }
    }

    /// Adds a row, and integrates the rates up to it.
    fn add(&mut self, sample: Sample) {
        let step_s = sample.time_s - self.last.time_s;
        for ((integral, before), after) in self
            .integrals_m
            .iter_mut()
            .zip(self.last.rates_mps)
            .zip(sample.rates_mps)
        {
            *integral += 0.5 * (before + after) * step_s;
        }
        self.last = sample;
        self.rows += 1;
    }

    fn seconds(&self) -> f64 {
        self.last.time_s - self.first.time_s
    }

    fn is_complete(&self) -> bool {
        self.seconds() >= WINDOW_S - 1e-6 || self.rows > MAX_WINDOW_ROWS
    }
}

#[derive(Clone, Copy)]
struct Sample {
    time_s: f64,
    line: u64,
    level_m: f64,
    rates_mps: [f64; 2],
}

impl Comparison {
    pub(super) fn undirected() -> Self {
        Self {
            is_undirected: true,
            ..Self::default()
        }
    }

    /// Compares speeds, as levels, with accelerations.
    pub(super) fn for_speeds() -> Self {
        Self {
            compares_speeds: true,
            ..Self::default()
        }
    }

    /// Ends the current window, for another vehicle.
    pub(super) fn restart(&mut self) {
        self.current = None;
    }

    /// Adds a row; unknown values end the window.
    pub(super) fn add(
        &mut self,
        (time_s, line): (f64, u64),
        level_m: Option<f64>,
        rates_mps: Option<[f64; 2]>,
    ) {
        let Some((level_m, rates_mps)) = level_m.zip(rates_mps) else {
            return self.restart();
        };
        let sample = Sample {
            time_s,
            line,
            level_m,
            rates_mps,
        };
        let Some(open) = &mut self.current else {
            self.current = Some(OpenWindow::new(sample));
            return;
        };
        open.add(sample);
        if !open.is_complete() {
            return;
        }
        let window = *open;
        self.current = Some(OpenWindow::new(sample));
        if window.seconds() > 0.0 {
            self.add_window(&window);
        }
    }

    /// Adds a complete window.
    fn add_window(&mut self, window: &OpenWindow) {
        let change_m = window.last.level_m - window.first.level_m;
        let change_m = if self.is_undirected {
            change_m.abs()
        } else {
            change_m
        };
        let [first_m, second_m] = window.integrals_m;
        self.windows.push(Window {
            terms: [change_m, first_m, second_m],
            seconds: window.seconds(),
            from_s: window.first.time_s,
            to_s: window.last.time_s,
            line: window.first.line,
        });
    }

    /// Adds an instant at which the first rate should be the sum of the others.
    pub(super) fn add_instant(&mut self, (time_s, line): (f64, u64), terms: [f64; 3]) {
        self.windows.push(Window {
            terms,
            seconds: 1.0,
            from_s: time_s,
            to_s: time_s,
            line,
        });
    }

    /// Returns whether the error lasts longer than noise: the median over times of [`LASTING_S`] in which the columns
    /// that should add up to the change tell more than noise. `None` for too few such times.
    fn error_lasts(&self) -> Option<bool> {
        let lasting = self.lasting_windows([false, true]);
        if lasting.len() < MIN_WINDOWS {
            return None;
        }
        let few = FEW_WINDOWS_MARGIN / (lasting.len() as f64).sqrt();
        let share = NOISE_SHARE + (few - MARGIN_OF_MANY).max(0.0);
        let noise_mps = share * median(&self.windows, |window| window.difference(GIVEN).abs());
        let scale_mps = median(&lasting, |window| window.largest_mps(GIVEN));
        let limit_mps = MAX_LASTING_ERROR_MPS
            .max(MAX_RELATIVE_ERROR * scale_mps)
            .max(noise_mps);
        Some(median(&lasting, |window| window.difference(GIVEN).abs()) > limit_mps)
    }

    /// Returns the times of [`LASTING_S`] if noise of the ends of windows does not explain their median error. Their
    /// changes tell more than those of [`WINDOW_S`].
    fn lasting_errors(&self) -> Option<Vec<Window>> {
        // Slopes of a road are in accelerations. Noise of positions without direction does not average out.
        if self.compares_speeds {
            return None;
        }
        let lasting = self.lasting_windows([!self.is_undirected, true]);
        if lasting.len() < MIN_WINDOWS || !is_wrong(&lasting) {
            return None;
        }
        let middle_mps = median(&self.windows, |window| window.difference(GIVEN));
        let scatter_mps = median(&self.windows, |window| {
            (window.difference(GIVEN) - middle_mps).abs()
        });
        let share = NOISE_SHARE + FEW_WINDOWS_MARGIN / (lasting.len() as f64).sqrt();
        let error_mps = median(&lasting, |window| window.difference(GIVEN).abs());
        (error_mps > share * scatter_mps).then_some(lasting)
    }

    /// Returns the times of [`LASTING_S`] in which one of the chosen rates tells more than noise.
    fn lasting_windows(&self, chosen: [bool; 2]) -> Vec<Window> {
        let mut lasting = self.all_lasting_windows();
        lasting.retain(|window| window.tells(chosen, window.to_s - window.from_s));
        lasting
    }

    /// Joins windows to times of [`LASTING_S`], which overlap.
    fn all_lasting_windows(&self) -> Vec<Window> {
        let mut lasting: Vec<Window> = Vec::new();
        let mut open: VecDeque<Window> = VecDeque::new();
        for window in &self.windows {
            let pause_s = open.back().map_or(0.0, |last| window.from_s - last.to_s);
            if !(0.0..=MAX_PAUSE_S).contains(&pause_s) {
                open.clear();
            }
            open.iter_mut().for_each(|open| *open = open.join(window));
            if open
                .back()
                .is_none_or(|last| window.from_s - last.from_s >= WINDOW_S - 1e-6)
            {
                open.push_back(*window);
            }
            while let Some(complete) =
                open.pop_front_if(|first| first.to_s - first.from_s >= LASTING_S - 1e-6)
            {
                lasting.push(complete);
            }
        }
        lasting
    }

    /// Returns the windows that show an error; `None` if the columns agree.
    fn wrong_windows(&self) -> Option<Vec<Window>> {
        let mut windows = self.windows.clone();
        windows.retain(|window| window.tells([true, true], window.seconds));
        let has_short = windows.len() >= MIN_WINDOWS;
        if has_short && is_wrong(&windows) {
            return Some(windows);
        }
        match self.lasting_errors() {
            Some(lasting) => Some(lasting),
            None => (has_short && self.is_wrong_ratio()).then_some(windows),
        }
    }

    /// Finds a contradiction of two columns.
    fn find(&self, columns: [&str; 2], hypotheses: &[Hypothesis]) -> Option<FoundContradiction> {
        let unit = if self.compares_speeds { "m/s²" } else { "m/s" };
        let windows = self.wrong_windows()?;
        let is_wrong = is_wrong(&windows);
        let reasons = self.explain(&windows, hypotheses);
        let given_mps = median(&windows, |window| window.difference(GIVEN).abs());
        let is_explained = !reasons.is_empty();
        let reason = if is_explained {
            Some(reasons.join(", or "))
        } else if is_wrong {
            let pattern = describe_pattern(&windows, given_mps, unit);
            if !self.is_more_than_noise(&windows, pattern.is_some()) {
                return None;
            }
            pattern
        } else {
            return None;
        };
        let typical_mps = if is_wrong {
            given_mps
        } else {
            quantile(&windows, 0.9, |window| window.difference(GIVEN).abs())
        };
        let typical = windows.iter().min_by(|a, b| {
            let [a_mps, b_mps] =
                [a, b].map(|window| (window.difference(GIVEN).abs() - typical_mps).abs());
            a_mps.total_cmp(&b_mps)
        })?;
        let contradiction = ColumnContradiction {
            columns: columns.map(str::to_owned),
            rates: typical.rates(GIVEN),
            unit,
            reason,
        };
        Some(FoundContradiction {
            contradiction,
            line: typical.line,
            is_explained,
        })
    }

    /// Returns whether noise cannot be the reason of an error in `windows`. In a recording that is too short for the
    /// median over longer times, the error has a pattern, or is large.
    fn is_more_than_noise(&self, windows: &[Window], has_pattern: bool) -> bool {
        let given_mps = median(windows, |window| window.difference(GIVEN).abs());
        let scale_mps = median(windows, |window| window.largest_mps(GIVEN));
        let is_large = given_mps > MIN_UNEXPLAINED_MPS.max(MIN_UNEXPLAINED * scale_mps);
        // Few windows that were chosen for their changes show an offset by chance.
        let averages_out = !self.compares_speeds && !self.is_undirected;
        let has_lasting = averages_out && self.all_lasting_windows().len() >= MIN_WINDOWS;
        match self.error_lasts() {
            _ if has_lasting && self.lasting_errors().is_some() => true,
            Some(lasts) => lasts || has_pattern && !has_lasting,
            None => !has_lasting && (has_pattern || is_large),
        }
    }

    /// Returns whether the ratio of both rates shows another unit, whatever the noise.
    fn is_wrong_ratio(&self) -> bool {
        let [low, high] = self.ratio(GIVEN);
        low > MIN_RATIO || high < 1.0 / MIN_RATIO
    }

    fn ratio(&self, factors: [f64; 3]) -> [f64; 2] {
        ratio_interval(
            self.windows
                .iter()
                .map(|window| window.rates(factors))
                .collect(),
        )
    }

    /// Returns the reasons of the hypotheses that leave only noise of an error.
    fn explain(&self, windows: &[Window], hypotheses: &[Hypothesis]) -> Vec<String> {
        let remaining_errors: Vec<f64> = hypotheses
            .iter()
            .map(|hypothesis| {
                let error = MedianError::new(windows, hypothesis.factors);
                let noise_mps = MIN_ERROR_MPS.max(MAX_EXPLAINED_ERROR * error.scale_mps);
                if error.error_mps <= noise_mps {
                    error.relative()
                } else {
                    f64::INFINITY
                }
            })
            .collect();
        let best = remaining_errors
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min);
        let given = MedianError::new(windows, GIVEN).relative();
        let has_better_error = is_wrong(windows) && best <= EXPLAINED_SHARE * given;
        hypotheses
            .iter()
            .zip(remaining_errors)
            .filter(|(hypothesis, error)| {
                if has_better_error {
                    *error <= best + 0.03
                } else {
                    error.is_finite() && self.has_equal_rates(hypothesis)
                }
            })
            .map(|(hypothesis, _)| hypothesis.reason.clone())
            .collect()
    }

    /// Returns whether both rates are equal, up to noise, under a hypothesis.
    fn has_equal_rates(&self, hypothesis: &Hypothesis) -> bool {
        let [low, high] = self.ratio(hypothesis.factors);
        low > 1.0 / MIN_RATIO && low < 1.0 + RATIO_TOLERANCE && high > 1.0 - RATIO_TOLERANCE
    }

    /// Reports a contradiction of two columns, of which `field` is probably wrong. Returns whether they agree.
    ///
    /// # Errors
    /// [`RecordingError::Line`] if another unit or sign in the map would end the contradiction.
    pub(super) fn check(
        &self,
        table: &RowReader<'_>,
        field: &str,
        columns: [&str; 2],
        (hypotheses, dropped): (&[Hypothesis], &mut Vec<DroppedItem>),
    ) -> Result<bool, RecordingError> {
        let Some(finding) = self.find(columns, hypotheses) else {
            return Ok(true);
        };
        let path = table.path().to_owned();
        if finding.is_explained {
            let problem = LineProblem::Column {
                column: field.to_owned(),
                problem: ColumnProblem::Contradiction(Box::new(finding.contradiction)),
            };
            return Err(RecordingError::Line {
                path,
                line: finding.line,
                problem,
            });
        }
        dropped.push(DroppedItem {
            path,
            line: finding.line,
            omission: Omission::ColumnsContradict(finding.contradiction),
        });
        Ok(false)
    }
}

/// A contradiction in a recording.
struct FoundContradiction {
    contradiction: ColumnContradiction,
    line: u64,
    /// True if another unit or sign explains it.
    is_explained: bool,
}

/// Median error of windows.
struct MedianError {
    error_mps: f64,
    /// Median of the larger rate of each window.
    scale_mps: f64,
}

impl MedianError {
    fn new(windows: &[Window], factors: [f64; 3]) -> Self {
        let scale_mps = median(windows, |window| window.largest_mps(factors));
        Self {
            error_mps: median(windows, |window| window.difference(factors).abs()),
            scale_mps: scale_mps.max(f64::MIN_POSITIVE),
        }
    }

    fn relative(&self) -> f64 {
        self.error_mps / self.scale_mps
    }
}

fn quantile(windows: &[Window], share: f64, value: impl Fn(&Window) -> f64) -> f64 {
    let mut values: Vec<f64> = windows.iter().map(value).collect();
    let rank = (values.len() as f64 * share) as usize;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

fn median(windows: &[Window], value: impl Fn(&Window) -> f64) -> f64 {
    quantile(windows, 0.5, value)
}

/// Returns whether the median error is one that noise does not explain.
fn is_wrong(windows: &[Window]) -> bool {
    let error_mps = median(windows, |window| window.difference(GIVEN).abs());
    let scale_mps = median(windows, Window::smallest_mps);
    error_mps > MIN_ERROR_MPS.max(MAX_RELATIVE_ERROR * scale_mps)
}

/// Returns in words an offset or a ratio that leaves a small share of an error: that which leaves less, or both.
fn describe_pattern(windows: &[Window], given_mps: f64, unit: &str) -> Option<String> {
    let offset_mps = median(windows, |window| window.difference(GIVEN));
    let ratio = median(windows, |window| {
        let [change, stated] = window.rates(GIVEN);
        change / stated
    });
    let offset_leaves_mps = median(windows, |window| {
        (window.difference(GIVEN) - offset_mps).abs()
    });
    let ratio_leaves_mps = median(windows, |window| {
        let [change, stated] = window.rates(GIVEN);
        (change - ratio * stated).abs()
    });
    let most_mps = EXPLAINED_SHARE * given_mps;
    let is_ratio = USUAL_RATIOS.contains(&ratio) && ratio_leaves_mps <= most_mps;
    let is_offset = offset_leaves_mps <= most_mps;
    let offset = format!("an offset of {} {unit}", format_fixed(offset_mps, 1));
    let ratio = format!("a ratio of {ratio:.2}");
    let pattern = match (is_offset, is_ratio) {
        (false, false) => return None,
        (_, false) => offset,
        (false, _) => ratio,
        _ if ratio_leaves_mps < CLEARLY_LESS * offset_leaves_mps => ratio,
        _ if offset_leaves_mps < CLEARLY_LESS * ratio_leaves_mps => offset,
        _ => format!("{offset}, or {ratio}"),
    };
    Some(format!("this looks like {pattern}"))
}

/// Regression line of first rates over second ones.
struct LineFit {
    mean: [f64; 2],
    slope: f64,
    /// Square of the correlation coefficient.
    correlation: f64,
}

impl LineFit {
    fn new(rates: &[[f64; 2]]) -> Self {
        let count = rates.len() as f64;
        let mean = [0, 1].map(|index| rates.iter().map(|pair| pair[index]).sum::<f64>() / count);
        let [first, mixed, second] = [[0, 0], [0, 1], [1, 1]].map(|[a, b]| {
            rates
                .iter()
                .map(|pair| (pair[a] - mean[a]) * (pair[b] - mean[b]))
                .sum::<f64>()
        });
        Self {
            mean,
            slope: mixed / second,
            correlation: mixed.powi(2) / (first * second),
        }
    }

    fn error(&self, pair: &[f64; 2]) -> f64 {
        (pair[0] - self.mean[0] - self.slope * (pair[1] - self.mean[1])).abs()
    }
}

/// Returns an interval of the slope of the first rates over the second ones, with noise in either. The twentieth of the
/// rates that differs most from the slope does not count.
fn ratio_interval(mut rates: Vec<[f64; 2]>) -> [f64; 2] {
    let fit = LineFit::new(&rates);
    rates.sort_by(|a, b| fit.error(a).total_cmp(&fit.error(b)));
    rates.truncate(rates.len() - rates.len() / 20);
    let LineFit {
        slope, correlation, ..
    } = LineFit::new(&rates);
    let least = 1.0
        - RATIO_ERRORS * ((1.0 / correlation - 1.0).max(0.0) / (rates.len() as f64 - 2.0)).sqrt();
    match slope * least {
        low if least > 0.0 && slope > 0.0 => [low, slope / (correlation * least)],
        high if least > 0.0 => [slope / (correlation * least), high],
        _ => [f64::NEG_INFINITY, f64::INFINITY],
    }
}
