//! Campaigns on the page, finished or in progress.

mod figures;
mod grid;

use crumple_core::quoting::TerminalText;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{
    CampaignError, CampaignReader, EvaluatedPoint, MAX_READ_EVALUATIONS,
};
use crumple_search::falsify::counterexample::{AvoidabilityClass, ChangedParameter};
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use crate::catalog;
use crate::error::RequestError;
use crate::render::escape_markup;
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

impl<'a> CampaignView<'a> {
    fn new(index: usize, campaign: &'a CatalogCampaign) -> Self {
        Self {
            index,
            name: &campaign.name,
            reader: &campaign.reader,
        }
    }
}

pub(crate) fn campaign_error(error: CampaignError) -> RequestError {
    RequestError::Internal(TerminalText(&error.to_string()).to_string())
}

pub(crate) fn show_campaigns(
    request: &CampaignRequest,
    offered: &[CatalogCampaign],
) -> Result<CampaignResponse, RequestError> {
    let requested = catalog::find(offered, request.campaign, "campaign", "campaigns")?;
    let reader = &requested.reader;
    let mut shown = vec![CampaignView::new(request.campaign, requested)];
    // A comparison with itself would deadlock.
    if let Some(index) = request.against.filter(|index| *index != request.campaign) {
        let compared = catalog::find(offered, index, "against", "campaigns")?;
        shown.push(CampaignView::new(index, compared));
    }
    let coordinates = reader.space().coordinate_names();
    let x_parameter = grid_parameter(&coordinates, "x_parameter", &request.x_parameter, 0)?;
    let y_parameter = grid_parameter(&coordinates, "y_parameter", &request.y_parameter, 1)?;
    let filter = EvaluationFilter {
        method: request.method.as_deref(),
        kind: request.kind.as_deref(),
    };
    let maps = html! {
        div.side-by-side data-columns=(if request.narrow { 1 } else { shown.len() }) {
            @for campaign in &shown {
                @match FailureGrid::from_campaign(campaign.reader, [&x_parameter, &y_parameter], &filter) {
                    Some(map) => (figures::failure_grid_figure(campaign, &map, request.narrow || shown.len() > 1)),
                    None => p.hint { (TerminalText(campaign.name)) " does not vary both of these." },
                }
            }
        }
    };
    Ok(CampaignResponse {
        summaries: shown.iter().map(summary_line).collect(),
        x_parameter,
        y_parameter,
        methods: reader.methods().iter().map(Method::to_string).collect(),
        best: escape_markup(&figures::best_robustness_figure(&shown, request.narrow)),
        maps: escape_markup(&maps),
        distinct: escape_markup(
            &shown
                .iter()
                .map(distinct_failures_table)
                .fold(html! {}, |before, next| html! { (before) (next) }),
        ),
        failures: escape_markup(
            &html! { @for campaign in &shown { (failures_table(campaign, &filter)) } },
        ),
        coordinates,
        kinds: reader
            .summary()
            .failures
            .iter()
            .map(|kind| kind.kind.clone())
            .collect(),
    })
}

/// Returns the parameter of an axis of the failure grid: the requested one, or the one at index `default`.
fn grid_parameter(
    coordinates: &[String],
    field: &str,
    requested: &Option<String>,
    default: usize,
) -> Result<String, RequestError> {
    match requested {
        Some(name) if coordinates.contains(name) => Ok(name.clone()),
        Some(_) => Err(RequestError::invalid(
            field,
            "not a parameter of this campaign",
        )),
        None => Ok(coordinates
            .get(default)
            .or(coordinates.last())
            .cloned()
            .unwrap_or_default()),
    }
}

pub(crate) struct EvaluationFilter<'a> {
    method: Option<&'a str>,
    kind: Option<&'a str>,
}

impl EvaluationFilter<'_> {
    /// Returns the failure state of an evaluation that passes the filter; none for others.
    fn classify(
        &self,
        reader: &CampaignReader,
        method: &Method,
        evaluated: &EvaluatedPoint,
    ) -> Option<bool> {
        if self.method.is_some_and(|wanted| wanted != method.name()) {
            return None;
        }
        let fails = evaluated.verdict.is_violation();
        match self.kind {
            Some(wanted) if fails => reader
                .describe_failure(evaluated)
                .is_some_and(|kind| kind == wanted)
                .then_some(true),
            _ => Some(fails),
        }
    }
}

fn summary_line(shown: &CampaignView<'_>) -> String {
    let CampaignView { name, reader, .. } = shown;
    let logged = reader.evaluations().len();
    let all = reader.total_evaluations();
    let failing = reader
        .evaluations()
        .iter()
        .filter(|(_, evaluated)| evaluated.verdict.is_violation())
        .count();
    let stage = match reader.summary() {
        summary if summary.methods.iter().any(|method| method.evaluations > 0) && logged == 0 => {
            format!("complete, {all} evaluations, none of them logged")
        }
        _ if logged < usize::try_from(all).unwrap_or(usize::MAX)
            && logged >= MAX_READ_EVALUATIONS =>
        {
            format!(
                "complete; of {all} evaluations the first {logged} are shown, {failing} of which fail"
            )
        }
        _ => format!("complete, {logged} evaluations, {failing} fail"),
    };
    TerminalText(&format!(
        "{name}: {} in {}, {}, estimator {}: {stage}",
        reader.controller(),
        reader.space().name(),
        reader.specification(),
        reader.estimator().name()
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
            tbody { @for (index, failure) in summary.counterexamples.iter().enumerate() { tr {
                th scope="row" {
                    a href={ "./?campaign=" (shown.index) "&counterexample=" (index) } { (TerminalText(&failure.kind)) }
                }
                td.number { (format_number(failure.impact_speed_mps, 1)) }
                td.number { (format_number(failure.collision_time_s, 2)) }
                td { (avoidability_label(failure.avoidability.class())) }
                td { (failure.found_by) " after " (failure.found_at) }
                td { (TerminalText(&list_changes(&failure.changed))) }
            } } }
        } } }
    }
}

/// Lists failing evaluations: the latest while a campaign runs, the severest afterwards.
fn failures_table(shown: &CampaignView<'_>, filter: &EvaluationFilter<'_>) -> Markup {
    let rows = shown.reader.evaluations().iter().enumerate();
    let mut failing: Vec<_> = rows
        .filter(|(_, (method, evaluated))| {
            filter.classify(shown.reader, method, evaluated) == Some(true)
        })
        .collect();
    failing
        .sort_by(|(_, (_, a)), (_, (_, b))| a.verdict.robustness.total_cmp(&b.verdict.robustness));
    let all = failing.len();
    failing.truncate(MAX_LISTED);
    html! { @if all > 0 { div.scroll tabindex="0" { table {
        caption {
            (TerminalText(shown.name)) ": " (all) " failing evaluations"
            @if all > failing.len() { ", the " (failing.len()) " severest" }
        }
        thead { tr {
            th scope="col" { "evaluation" } th scope="col" { "what happens" }
            th.number scope="col" { "impact (m/s)" } th.number scope="col" { "at (s)" }
            th.number scope="col" { "robustness" } th.number scope="col" { "ln likelihood" }
        } }
        tbody { @for (index, (method, evaluated)) in &failing { tr {
            th scope="row" { a href={ "./?campaign=" (shown.index) "&evaluation=" (index) } {
                (method.name()) " " (evaluated.number)
            } }
            td { (TerminalText(&shown.reader.describe_failure(evaluated).unwrap_or_default())) }
            td.number { (format_number(evaluated.verdict.collision.map(|collision| collision.impact_speed_mps), 1)) }
            td.number { (format_number(evaluated.verdict.collision.map(|collision| collision.time_s), 2)) }
            td.number { (format_number(Some(evaluated.verdict.robustness), 2)) }
            td.number { (format_number(Some(evaluated.ln_likelihood), 2)) }
        } } }
    } } } @else { p.hint { (TerminalText(shown.name)) ": no evaluation fails among these." } } }
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
