//! Which request is answered by what.

use std::sync::{Mutex, TryLockError};

use crumple_core::quoted::Terminal;
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::ScenarioSpec;
use hyper::{Method, StatusCode};
use serde::{Deserialize, Serialize};

use crate::avoidability::avoided;
use crate::campaign;
use crate::render::{Sliders, drawn};
use crate::auth::Gate;
use crate::catalog::Catalog;
use crate::page;
use crate::error::Refused;
use crate::request::{Edited, RunRequest, read};
use crate::save::saved;

/// The application: what it offers, and to whom.
#[derive(Debug)]
pub(crate) struct Application {
    pub(crate) auth: Gate,
    catalog: Catalog,
    /// Held while it is decided whether somebody could have avoided something, which takes up to two minutes.
    avoidability_lock: Mutex<()>,
}

/// What is sent back.
#[derive(Debug)]
pub(crate) struct HttpResponse {
    pub(crate) status: StatusCode,
    pub(crate) content_type: &'static str,
    pub(crate) body: Vec<u8>,
}

/// What is to be opened: an offered scenario, or one of a campaign.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct OpenRequest {
    #[serde(default)]
    scenario: Option<usize>,
    #[serde(default)]
    campaign: Option<usize>,
    /// Place among its distinct failures.
    #[serde(default)]
    counterexample: Option<usize>,
    /// Place among its evaluations.
    #[serde(default)]
    evaluation: Option<usize>,
}

#[derive(Serialize)]
struct OpenResponse<'a> {
    scenario: &'a ScenarioSpec,
    sliders: Sliders,
    /// Who drove in the campaign; none if that was not offered.
    controller: Option<String>,
    estimator: Option<&'static str>,
    note: Option<String>,
}

/// A scenario that is to be saved.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SaveRequest {
    #[serde(rename = "what")]
    edited: Edited,
    controller: String,
    #[serde(default)]
    estimator: EstimatorKind,
    /// Whether it goes into the folder; otherwise it is only told.
    to_folder: bool,
}

impl Application {
    pub(crate) fn new(gate: Gate, offer: Catalog) -> Self {
        Self { gate, offer, deciding: Mutex::new(()) }
    }

    /// Answers what is behind the token. What is asked with a body may take its time.
    pub(crate) fn dispatch(&self, method: &Method, rest: &str, body: &[u8]) -> Result<HttpResponse, Refused> {
        match (rest, method) {
            ("", &Method::GET) => Ok(HttpResponse::of("text/html; charset=utf-8", page::scenario(&self.offer))),
            ("campaigns", &Method::GET) => Ok(HttpResponse::of("text/html; charset=utf-8", page::campaigns(&self.offer))),
            ("explore.css", &Method::GET) => Ok(HttpResponse::of("text/css; charset=utf-8", page::style())),
            ("explore.js", &Method::GET) => Ok(HttpResponse::of("text/javascript; charset=utf-8", page::script())),
            ("" | "campaigns" | "explore.css" | "explore.js", _) => Err(Refused::Method("GET")),
            ("api/open", &Method::POST) => self.open(&read(body)?),
            ("api/run", &Method::POST) => json(&drawn(read::<RunRequest>(body)?, &self.offer)?),
            ("api/avoid", &Method::POST) => self.avoid(read(body)?),
            ("api/save", &Method::POST) => self.save(read(body)?),
            ("api/campaign", &Method::POST) => json(&campaign::seen(&read(body)?, &self.offer.campaigns)?),
            ("api/open" | "api/run" | "api/avoid" | "api/save" | "api/campaign", _) => Err(Refused::Method("POST")),
            _ => Err(Refused::NotFound("the pages and what they ask for are elsewhere")),
        }
    }

    fn open(&self, wanted: &Open) -> Result<HttpResponse, Refused> {
        match wanted {
            Open { scenario: Some(index), campaign: None, counterexample: None, evaluation: None } => {
                let offered = self.offer.scenarios.get(*index);
                let offered = offered.ok_or_else(|| {
                    Refused::invalid("scenario", format!("{} were offered", self.offer.scenarios.len()))
                })?;
                let scenario = &offered.scenario;
                json(&OpenResponse {
                    scenario: scenario.spec(),
                    sliders: Sliders::of(scenario),
                    controller: None,
                    estimator: None,
                    note: None,
                })
            }
            Open { scenario: None, campaign: Some(index), counterexample, evaluation } => {
                self.open_campaign_scenario(*index, *counterexample, *evaluation)
            }
            _ => Err(Refused::invalid("scenario", "either a scenario or a campaign is opened")),
        }
    }

    fn open_campaign_scenario(
        &self,
        index: usize,
        counterexample: Option<usize>,
        evaluation: Option<usize>,
    ) -> Result<HttpResponse, Refused> {
        let offered = self.offer.campaigns.get(index);
        let offered = offered
            .ok_or_else(|| Refused::invalid("campaign", format!("{} were offered", self.offer.campaigns.len())))?;
        // A campaign whose files are damaged is not opened in part.
        offered.poll()?;
        let look = offered.look();
        let scenario = match (counterexample, evaluation) {
            (Some(place), None) => {
                let found = look.counterexample(place).map_err(campaign::failed)?;
                found.ok_or_else(|| {
                    Refused::invalid("counterexample", "the campaign has no such failure, or is not complete")
                })?
            }
            (None, Some(place)) => {
                let found = look.evaluations().get(place);
                let (method, evaluated) = found
                    .ok_or_else(|| Refused::invalid("evaluation", format!("{} are known", look.evaluations().len())))?;
                let scenario = look.scenario(&evaluated.values).map_err(campaign::failed)?;
                let name = format!("{}-{}-{}", look.space().name(), method.name(), evaluated.number);
                let about = format!(
                    "Evaluation {} of {} in the space `{}`.",
                    evaluated.number,
                    method.name(),
                    look.space().name()
                );
                scenario.edited(|spec| (spec.name, spec.about) = (name, about))?
            }
            _ => return Err(Refused::invalid("campaign", "either a counterexample or an evaluation is opened")),
        };
        self.offer.register_drivers(&scenario);
        let name = look.controller();
        let offered = self.offer.controllers.iter().find(|controller| controller.name == name);
        let is_offered = offered.is_some_and(|controller| look.is_about(controller));
        let note = match offered {
            None => Some(format!(
                "The campaign is about {}, which is not available: start with --controller",
                Terminal(name)
            )),
            Some(_) if !is_offered => Some(format!(
                "The campaign is about {}, which is not available: the controller of this name has another identity",
                Terminal(name)
            )),
            Some(_) => None,
        };
        json(&OpenResponse {
            scenario: scenario.spec(),
            sliders: Sliders::of(&scenario),
            controller: is_offered.then(|| name.to_owned()),
            estimator: Some(look.estimator().name()),
            note,
        })
    }

    fn avoid(&self, edited: Edited) -> Result<HttpResponse, Refused> {
        let scenario = edited.scenario(&self.offer)?;
        let _alone = match self.deciding.try_lock() {
            Ok(alone) => alone,
            // Nothing is kept in it.
            Err(TryLockError::Poisoned(alone)) => alone.into_inner(),
            Err(TryLockError::WouldBlock) => {
                return Err(Refused::Busy("whether another scenario could have been avoided"));
            }
        };
        json(&avoided(&scenario)?)
    }

    fn save(&self, save: SaveRequest) -> Result<HttpResponse, Refused> {
        let scenario = save.what.scenario(&self.offer)?;
        let named = self.offer.controllers(std::slice::from_ref(&save.controller))?;
        let controller = named.first().map_or("", |controller| controller.name.as_str());
        let out = match (&self.offer.out, save.to_folder) {
            (Some(folder), true) => Some(folder.as_path()),
            (None, true) => return Err(Refused::invalid("to_folder", "no folder was given: start with --out")),
            (_, false) => None,
        };
        json(&saved(&scenario, controller, save.estimator.name(), out)?)
    }
}

impl HttpResponse {
    fn new(content_type: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status: StatusCode::OK, content_type, body: body.into() }
    }
}

impl From<Refused> for HttpResponse {
    fn from(refused: Refused) -> Self {
        let body = format!("{}\n", refused.json()).into_bytes();
        Self { status: refused.status(), content_type: JSON, body }
    }
}

const JSON: &str = "application/json";

fn json_response(content: &impl Serialize) -> Result<HttpResponse, Refused> {
    let body = serde_json::to_vec(content).map_err(|error| Refused::Failed(error.to_string()))?;
    Ok(HttpResponse::of(JSON, body))
}
