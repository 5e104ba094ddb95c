//! Dispatch of requests.

use std::sync::{Mutex, TryLockError};

use crumple_core::quoting::TerminalText;
use crumple_search::falsify::campaign::CampaignReader;
use crumple_sim::control::TestDriverSettings;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, ScenarioSpec};
use hyper::{Method, StatusCode};
use serde::{Deserialize, Serialize};

use crate::auth::RequestAuth;
use crate::avoidability::check_avoidability;
use crate::campaign;
use crate::catalog::{self, Catalog};
use crate::error::RequestError;
use crate::page;
use crate::recording;
use crate::render::{Sliders, run_and_render};
use crate::request::{EditedScenario, RunRequest, parse_body, parse_test_driver};
use crate::save::SaveResponse;
use crate::suite::{self, TestRequest};

/// Application state: access control and catalog.
#[derive(Debug)]
pub(crate) struct Application {
    pub(crate) auth: RequestAuth,
    catalog: Catalog,
    /// Held while avoidability is decided, which takes up to two minutes.
    avoidability_lock: Mutex<()>,
}

#[derive(Debug)]
pub(crate) struct HttpResponse {
    pub(crate) status: StatusCode,
    pub(crate) content_type: &'static str,
    pub(crate) body: Vec<u8>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OpenRequest {
    scenario: Option<usize>,
    campaign: Option<usize>,
    /// Index among the distinct failures of the campaign.
    counterexample: Option<usize>,
    evaluation: Option<usize>,
}

#[derive(Serialize)]
struct OpenResponse<'a> {
    scenario: &'a ScenarioSpec,
    sliders: Sliders,
    /// Controller of the campaign; none if the catalog lacks it.
    controller: Option<String>,
    estimator: Option<&'static str>,
    note: Option<String>,
    /// Test driver that drives with the controller, as in the names of controllers.
    #[serde(skip_serializing_if = "Option::is_none")]
    test_driver: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SaveRequest {
    #[serde(alias = "what")]
    edited: EditedScenario,
    controller: String,
    #[serde(default)]
    estimator: EstimatorKind,
    #[serde(default)]
    test_driver: Option<String>,
}

impl Application {
    pub(crate) fn new(auth: RequestAuth, catalog: Catalog) -> Self {
        Self {
            auth,
            catalog,
            avoidability_lock: Mutex::new(()),
        }
    }

    /// Responds to a request; `rest` is its path after the token. A request with a body may block for a long time.
    pub(crate) fn dispatch(
        &self,
        method: &Method,
        rest: &str,
        body: &[u8],
    ) -> Result<HttpResponse, RequestError> {
        match (rest, method) {
            ("", &Method::GET) => Ok(HttpResponse::new(HTML, page::scenario_page(&self.catalog))),
            ("campaigns", &Method::GET) => {
                Ok(HttpResponse::new(HTML, page::campaigns_page(&self.catalog)))
            }
            ("recordings", &Method::GET) => Ok(HttpResponse::new(
                HTML,
                page::recordings_page(&self.catalog),
            )),
            ("suites", &Method::GET) => {
                Ok(HttpResponse::new(HTML, page::suites_page(&self.catalog)))
            }
            ("explore.css", &Method::GET) => Ok(HttpResponse::new(
                "text/css; charset=utf-8",
                page::style_sheet(),
            )),
            ("explore.js", &Method::GET) => Ok(HttpResponse::new(
                "text/javascript; charset=utf-8",
                page::SCRIPT.to_owned(),
            )),
            ("" | "campaigns" | "recordings" | "suites" | "explore.css" | "explore.js", _) => {
                Err(RequestError::MethodNotAllowed("GET"))
            }
            (call, _) => match call.strip_prefix("api/") {
                Some(call) => self.call(method, call, body),
                None => Err(NOT_FOUND),
            },
        }
    }

    /// Responds to a request of the script.
    fn call(&self, method: &Method, call: &str, body: &[u8]) -> Result<HttpResponse, RequestError> {
        if !CALLS.contains(&call) {
            return Err(NOT_FOUND);
        }
        if method != Method::POST {
            return Err(RequestError::MethodNotAllowed("POST"));
        }
        match call {
            "open" => self.open(&parse_body(body)?),
            "open-test" => self.open_test(&parse_body(body)?),
            "run" => json_response(&run_and_render(
                parse_body::<RunRequest>(body)?,
                &self.catalog,
            )?),
            "avoid" => self.avoid(parse_body(body)?),
            "save" => self.save(parse_body(body)?),
            "campaign" => json_response(&campaign::show_campaigns(
                &parse_body(body)?,
                &self.catalog.campaigns,
            )?),
            "recording" => json_response(&recording::show_recording(
                &parse_body(body)?,
                &self.catalog.recordings,
            )?),
            "replay" => json_response(&recording::show_replay(&parse_body(body)?, &self.catalog)?),
            "suite" => json_response(&suite::show_suite(&parse_body(body)?, &self.catalog)?),
            _ => Err(NOT_FOUND),
        }
    }

    fn open(&self, request: &OpenRequest) -> Result<HttpResponse, RequestError> {
        match request {
            OpenRequest {
                scenario: Some(index),
                campaign: None,
                counterexample: None,
                evaluation: None,
            } => {
                let scenario =
                    &catalog::find(&self.catalog.scenarios, *index, "scenario", "scenarios")?
                        .scenario;
                json_response(&OpenResponse {
                    scenario: scenario.spec(),
                    sliders: Sliders::new(scenario),
                    controller: None,
                    estimator: None,
                    note: None,
                    test_driver: None,
                })
            }
            OpenRequest {
                scenario: None,
                campaign: Some(index),
                counterexample,
                evaluation,
            } => self.open_campaign_scenario(*index, *counterexample, *evaluation),
            _ => Err(RequestError::invalid(
                "scenario",
                "open either a scenario or a campaign",
            )),
        }
    }

    fn open_test(&self, request: &TestRequest) -> Result<HttpResponse, RequestError> {
        let opened = suite::open_test(request, &self.catalog)?;
        json_response(&OpenResponse {
            scenario: opened.scenario.spec(),
            sliders: Sliders::new(&opened.scenario),
            controller: Some(opened.controller),
            estimator: Some(request.estimator.name()),
            note: Some(opened.note),
            test_driver: opened
                .test_driver
                .as_ref()
                .map(TestDriverSettings::name_prefix),
        })
    }

    fn open_campaign_scenario(
        &self,
        index: usize,
        counterexample: Option<usize>,
        evaluation: Option<usize>,
    ) -> Result<HttpResponse, RequestError> {
        let reader =
            &catalog::find(&self.catalog.campaigns, index, "campaign", "campaigns")?.reader;
        // A damaged campaign is not opened in part.
        let scenario = match (counterexample, evaluation) {
            (Some(index), None) => reader
                .counterexample(index)
                .map_err(campaign::campaign_error)?
                .ok_or_else(|| {
                    RequestError::invalid("counterexample", "the campaign has no such failure")
                })?,
            (None, Some(index)) => evaluated_scenario(reader, index)?,
            _ => {
                return Err(RequestError::invalid(
                    "campaign",
                    "open either a counterexample or an evaluation",
                ));
            }
        };
        self.catalog.register_drivers(&scenario);
        let unavailable = self.why_unavailable(reader);
        json_response(&OpenResponse {
            scenario: scenario.spec(),
            sliders: Sliders::new(&scenario),
            controller: unavailable
                .is_none()
                .then(|| reader.controller().to_owned()),
            estimator: Some(reader.estimator().name()),
            note: unavailable,
            test_driver: None,
        })
    }

    /// Explains why the controller of a campaign is not available; none if it is.
    fn why_unavailable(&self, reader: &CampaignReader) -> Option<String> {
        let name = reader.controller();
        let controllers = &self.catalog.controllers;
        let reason = match controllers
            .iter()
            .find(|controller| controller.name == name)
        {
            Some(controller) if reader.is_for_controller(controller) => return None,
            Some(_) => "the controller of this name has another identity",
            None => "start with --controller",
        };
        Some(format!(
            "The campaign is about {}, which is not available: {reason}",
            TerminalText(name)
        ))
    }

    fn avoid(&self, edited: EditedScenario) -> Result<HttpResponse, RequestError> {
        let scenario = edited.into_scenario(&self.catalog)?;
        let _alone = match self.avoidability_lock.try_lock() {
            Ok(alone) => alone,
            // The lock protects no data.
            Err(TryLockError::Poisoned(alone)) => alone.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(RequestError::Busy("the avoidability of another scenario"));
            }
        };
        json_response(&check_avoidability(&scenario)?)
    }

    fn save(&self, save: SaveRequest) -> Result<HttpResponse, RequestError> {
        let scenario = save.edited.into_scenario(&self.catalog)?;
        let controllers = self
            .catalog
            .find_controllers(std::slice::from_ref(&save.controller))?;
        let name = controllers
            .first()
            .map_or("", |controller| controller.name.as_str());
        let test_driver = parse_test_driver(save.test_driver.as_deref())?
            .map_or_else(String::new, |driver| driver.name_prefix());
        json_response(&SaveResponse::new(
            &scenario,
            &format!("{test_driver}{name}"),
            save.estimator.name(),
        )?)
    }
}

const NOT_FOUND: RequestError =
    RequestError::NotFound("see the address that crumple printed at its start");

/// Calls of the script, below `api/`.
const CALLS: [&str; 9] = [
    "open",
    "open-test",
    "run",
    "avoid",
    "save",
    "campaign",
    "recording",
    "replay",
    "suite",
];

/// Returns the scenario of an evaluation of a campaign, with a name that says which.
fn evaluated_scenario(reader: &CampaignReader, index: usize) -> Result<Scenario, RequestError> {
    let Some((method, evaluated)) = reader.evaluations().get(index) else {
        return Err(RequestError::invalid(
            "evaluation",
            format!("{} are known", reader.evaluations().len()),
        ));
    };
    let scenario = reader
        .scenario(&evaluated.values)
        .map_err(campaign::campaign_error)?;
    let space = reader.space().name();
    let named = scenario.edited(|spec| {
        spec.name = format!("{space}-{}-{}", method.name(), evaluated.number);
        spec.about = format!(
            "Evaluation {} of {} in the space `{space}`.",
            evaluated.number,
            method.name()
        );
    })?;
    Ok(named)
}

impl HttpResponse {
    fn new(content_type: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self {
            status: StatusCode::OK,
            content_type,
            body: body.into(),
        }
    }
}

impl From<RequestError> for HttpResponse {
    fn from(refused: RequestError) -> Self {
        let body = format!("{}\n", refused.to_json()).into_bytes();
        Self {
            status: refused.status_and_kind().0,
            content_type: JSON,
            body,
        }
    }
}

const HTML: &str = "text/html; charset=utf-8";
const JSON: &str = "application/json";

fn json_response(content: &impl Serialize) -> Result<HttpResponse, RequestError> {
    let body =
        serde_json::to_vec(content).map_err(|error| RequestError::Internal(error.to_string()))?;
    Ok(HttpResponse::new(JSON, body))
}
