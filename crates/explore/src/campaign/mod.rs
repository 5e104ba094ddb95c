//! Campaigns on the page, finished or in progress.

mod figures;
mod grid;

use crumple_core::quoting::{TerminalLines, TerminalText};
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{
    CampaignError, CampaignReader, EvaluatedPoint, MAX_READ_EVALUATIONS,
};
use crumple_search::falsify::counterexample::{AvoidabilityClass, ChangedParameter};
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use crate::catalog;
use crate::error::RequestError;
use grid::FailureGrid;

const MAX_LISTED: usize = 40;

#[derive(Debug)]
pub(crate) struct CatalogCampaign {
    pub(crate) name: String,
    pub(crate) reader: CampaignReader,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CampaignRequest {
    campaign: usize,
    against: Option<usize>,
    /// Names of the parameters of the failure grid.
    #[serde(alias = "across")]
    x_parameter: Option<String>,
    #[serde(alias = "up")]
    y_parameter: Option<String>,
    method: Option<String>,
    kind: Option<String>,
    #[serde(default)]
    narrow: bool,
}

#[derive(Debug, Serialize)]
pub(crate) struct CampaignResponse {
    summaries: Vec<String>,
    coordinates: Vec<String>,
    x_parameter: String,
    y_parameter: String,
    methods: Vec<String>,
    kinds: Vec<String>,
    best: String,
    maps: String,
    distinct: String,
    failures: String,
}

pub(crate) struct CampaignView<'a> {
    pub(crate) index: usize,
    pub(crate) name: &'a str,
    pub(crate) reader: &'a CampaignReader,
}

pub(crate) fn campaign_error(error: CampaignError) -> RequestError {
    RequestError::Internal(TerminalText(&error.to_string()).to_string())
}

pub(crate) fn show_campaigns(
    request: &CampaignRequest,
    offered: &[CatalogCampaign],
) -> Result<CampaignResponse, RequestError> {
    let one = catalog::find(offered, request.campaign, "campaign", "campaigns")?;
    // A comparison with itself would deadlock.
    let against = request.against.filter(|index| *index != request.campaign);
    let other = against
        .map(|index| catalog::find(offered, index, "against", "campaigns"))
        .transpose()?;
    let mut shown = vec![CampaignView {
        index: request.campaign,
        name: &one.name,
        reader: &one.reader,
    }];
    if let Some((index, other)) = against.zip(other) {
        shown.push(CampaignView {
            index,
            name: &other.name,
            reader: &other.reader,
        });
    }
    let look = &one.reader;
    let coordinates = look.space().coordinate_names();
    let place = |field: &str, name: &Option<String>, otherwise: usize| match name {
        None => Ok(otherwise.min(coordinates.len().saturating_sub(1))),
        Some(name) => coordinates
            .iter()
            .position(|known| known == name)
            .ok_or_else(|| RequestError::invalid(field, "not a parameter of this campaign")),
    };
    let (x, y) = (
        place("x_parameter", &request.x_parameter, 0)?,
        place("y_parameter", &request.y_parameter, 1)?,
    );
    let kinds = look
        .summary()
        .failures
        .iter()
        .map(|kind| kind.kind.clone())
        .collect();
    let chosen = EvaluationFilter {
        method: request.method.as_deref(),
        kind: request.kind.as_deref(),
    };
    let name = |place: usize| coordinates.get(place).cloned().unwrap_or_default();
    let maps = html! {
        div.side-by-side data-columns=(if request.narrow { 1 } else { shown.len() }) {
            @for one in &shown {
                @match FailureGrid::from_campaign(one.reader, [&name(x), &name(y)], &chosen) {
                    Some(map) => (figures::failure_grid_figure(one, &map, request.narrow || shown.len() > 1)),
                    None => p.hint { (TerminalText(one.name)) " does not vary both of these." },
                }
            }
        }
    };
    Ok(CampaignResponse {
        summaries: shown.iter().map(summary_line).collect(),
        x_parameter: name(x),
        y_parameter: name(y),
        methods: look.methods().iter().map(Method::to_string).collect(),
        best: escape_markup(figures::best_robustness_figure(&shown, request.narrow)),
        maps: escape_markup(maps),
        distinct: escape_markup(
            shown
                .iter()
                .map(distinct_failures_table)
                .fold(html! {}, |before, next| html! { (before) (next) }),
        ),
        failures: escape_markup(failures_table(&shown, &chosen)),
        coordinates,
        kinds,
    })
}

/// Escapes control and bidirectional characters in markup, which names can contain.
fn escape_markup(markup: Markup) -> String {
    TerminalLines(&markup.into_string()).to_string()
}

pub(crate) struct EvaluationFilter<'a> {
    method: Option<&'a str>,
    kind: Option<&'a str>,
}

impl EvaluationFilter<'_> {
    /// Returns the failure state of an evaluation that passes the filter; none for others.
    fn classify(
        &self,
        look: &CampaignReader,
        method: &Method,
        evaluated: &EvaluatedPoint,
    ) -> Option<bool> {
        if self.method.is_some_and(|wanted| wanted != method.name()) {
            return None;
        }
        let fails = evaluated.verdict.is_violation();
        match self.kind {
            Some(wanted) if fails => look
                .describe_failure(evaluated)
                .is_some_and(|kind| kind == wanted)
                .then_some(true),
            _ => Some(fails),
        }
    }
}

fn summary_line(shown: &CampaignView<'_>) -> String {
    let CampaignView {
        name, reader: look, ..
    } = shown;
    let (made, all) = (look.evaluations().len(), look.total_evaluations());
    let failing = look
        .evaluations()
        .iter()
        .filter(|(_, evaluated)| evaluated.verdict.is_violation())
        .count();
    let stage = match look.summary() {
        summary if summary.methods.iter().any(|method| method.evaluations > 0) && made == 0 => {
            format!("complete, {all} evaluations, none of them logged")
        }
        _ if made < usize::try_from(all).unwrap_or(usize::MAX) && made >= MAX_READ_EVALUATIONS => {
            format!(
                "complete; of {all} evaluations the first {made} are shown, {failing} of which fail"
            )
        }
        _ => format!("complete, {made} evaluations, {failing} fail"),
    };
    let (controller, space) = (look.controller(), look.space().name());
    TerminalText(&format!(
        "{name}: {controller} in {space}, {}, estimator {}: {stage}",
        look.specification(),
        look.estimator().name()
    ))
    .to_string()
}

fn distinct_failures_table(shown: &CampaignView<'_>) -> Markup {
    let summary = shown.reader.summary();
    html! {
        @if summary.counterexamples.is_empty() { p { (TerminalText(shown.name)) ": no failure was found. That does \
            not prove that none exists." } }
        @else { div.scroll tabindex="0" { table {
            caption { (TerminalText(shown.name)) ": distinct failures, shrunk, most severe first" }
            thead { tr {
                th scope="col" { "what happens" } th.number scope="col" { "impact (m/s)" }
                th.number scope="col" { "at (s)" } th scope="col" { "avoidable" }
                th scope="col" { "found by" } th scope="col" { "not nominal" }
            } }
            tbody { @for (place, found) in summary.counterexamples.iter().enumerate() { tr {
                th scope="row" {
                    a href={ "./?campaign=" (shown.index) "&counterexample=" (place) } { (TerminalText(&found.kind)) }
                }
                td.number { (format_number(found.impact_speed_mps, 1)) }
                td.number { (format_number(found.contact_time_s, 2)) }
                td { (avoidability_label(found.avoidability.class())) }
                td { (found.found_by) " after " (found.found_at) }
                td { (TerminalText(&list_changes(&found.changed))) }
            } } }
        } } }
    }
}

/// Lists failing evaluations: the latest while a campaign runs, the severest afterwards.
fn failures_table(shown: &[CampaignView<'_>], chosen: &EvaluationFilter<'_>) -> Markup {
    let list = |one: &CampaignView<'_>| {
        let rows = one.reader.evaluations().iter().enumerate();
        let mut failing: Vec<_> = rows
            .filter(|(_, (method, evaluated))| {
                chosen.classify(one.reader, method, evaluated) == Some(true)
            })
            .collect();
        failing.sort_by(|(_, (_, a)), (_, (_, b))| {
            a.verdict.robustness.total_cmp(&b.verdict.robustness)
        });
        let all = failing.len();
        failing.truncate(MAX_LISTED);
        html! { @if all > 0 { div.scroll tabindex="0" { table {
            caption {
                (TerminalText(one.name)) ": " (all) " failing evaluations"
                @if all > failing.len() { ", the " (failing.len()) " severest" }
            }
            thead { tr {
                th scope="col" { "evaluation" } th scope="col" { "what happens" }
                th.number scope="col" { "impact (m/s)" } th.number scope="col" { "at (s)" }
                th.number scope="col" { "robustness" } th.number scope="col" { "ln likelihood" }
            } }
            tbody { @for (index, (method, evaluated)) in &failing { tr {
                th scope="row" { a href={ "./?campaign=" (one.index) "&evaluation=" (index) } {
                    (method.name()) " " (evaluated.number)
                } }
                td { (TerminalText(&one.reader.describe_failure(evaluated).unwrap_or_default())) }
                td.number { (format_number(evaluated.verdict.contact.map(|contact| contact.impact_speed_mps), 1)) }
                td.number { (format_number(evaluated.verdict.contact.map(|contact| contact.time_s), 2)) }
                td.number { (format_number(Some(evaluated.verdict.robustness), 2)) }
                td.number { (format_number(Some(evaluated.ln_likelihood), 2)) }
            } } }
        } } } @else { p.hint { (TerminalText(one.name)) ": no evaluation fails among these." } } }
    };
    html! { @for one in shown { (list(one)) } }
}

fn list_changes(changed: &[ChangedParameter]) -> String {
    changed
        .iter()
        .map(ChangedParameter::to_string)
        .collect::<Vec<_>>()
        .join(", ")
}

fn avoidability_label(class: AvoidabilityClass) -> &'static str {
    match class {
        AvoidabilityClass::Avoidable => "yes",
        AvoidabilityClass::Unavoidable => "no, proved",
        AvoidabilityClass::Undecided => "undecided",
        AvoidabilityClass::NotAsked => "not asked",
    }
}

fn format_number(value: Option<f64>, digits: usize) -> String {
    value.map_or("–".to_owned(), |value| {
        crumple_report::draw::format_number(value, digits)
    })
}
