//! Pages, style sheet and script. The script requests all dynamic content from this server.

use crumple_core::quoting::TerminalText;
use crumple_report::PAGE_STYLE;
use crumple_report::draw;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::VehicleClass;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Value, json};

use crate::catalog::{Catalog, ExploreConfig};

pub(crate) fn style_sheet() -> String {
    [PAGE_STYLE, draw::STYLE, include_str!("explore.css")].concat()
}

pub(crate) const SCRIPT: &str = include_str!("explore.js");

pub(crate) fn scenario_page(catalog: &Catalog) -> String {
    let classes = VehicleClass::ALL.iter().map(|class| {
        json!({
            "name": class.name(),
            "max_brake_mps2": class.max_brake_mps2(),
            "max_accel_mps2": class.max_accel_mps2(),
        })
    });
    let initial = json!({ "classes": classes.collect::<Vec<_>>(), "most_controllers": ExploreConfig::MAX_CONTROLLERS });
    let content = html! {
        h1.unseen { "Scenario" }
        div.bench {
            (scenario_controls(catalog))
            section.seen aria-label="Result" {
                p.bad id="error" role="alert" hidden {}
                div id="verdicts" {}
                p.unseen id="said" role="status" {}
                p { button type="button" id="avoid" { "Is the collision avoidable?" } }
                div id="avoided" aria-live="polite" {}
                div id="figures" {}
            }
        }
    };
    document("scenario", "Scenario", &initial, &content)
}

/// Returns the form that chooses and edits a scenario, its controllers and its estimator.
fn scenario_controls(catalog: &Catalog) -> Markup {
    html! {
        form.controls id="controls" aria-label="What happens" {
            label { "Scenario "
                select id="scenario" {
                    @for (index, scenario) in catalog.scenarios.iter().enumerate() {
                        option value=(index) { (TerminalText(&scenario.name)) }
                    }
                }
            }
            p.hint id="about" hidden {}
            fieldset { legend { "Road" } div id="road" {} }
            div id="vehicles" {}
            fieldset {
                legend { "Acceleration of vehicle 0" }
                div id="lead" {}
                p.hint id="lead-help" { "Draw the acceleration with the pointer. With the keyboard, select a time \
                with ← and →, and change the value with ↑ and ↓." }
                button type="button" id="lead-back" { "As in the scenario" }
            }
            (controller_choice(catalog))
            (estimator_choice(catalog))
            label { "Name " input type="text" id="name" maxlength="200" autocomplete="off"; }
            div.buttons {
                button type="button" id="download" { "Download" }
                button type="button" id="reset" { "Begin anew" }
            }
            p id="saved" role="status" {}
        }
    }
}

fn controller_choice(catalog: &Catalog) -> Markup {
    html! {
        fieldset id="chosen" {
            legend { "Controllers to compare" }
            @for (index, controller) in catalog.controllers.iter().enumerate() {
                @let name = TerminalText(&controller.name);
                label.choice {
                    input type="checkbox" value=(controller.name) checked[index < catalog.selected_controllers];
                    " " (name)
                }
            }
        }
    }
}

fn estimator_choice(catalog: &Catalog) -> Markup {
    html! {
        label { "Estimator "
            select id="estimator" {
                @for kind in EstimatorKind::ALL {
                    option value=(kind.name()) selected[kind == catalog.estimator] { (kind.name()) }
                }
            }
        }
    }
}

/// Returns a list of names from which one is chosen.
fn choice<'n>(id: &str, label: &str, names: impl Iterator<Item = &'n str>) -> Markup {
    html! {
        label { (label) " "
            select id=(id) {
                @for (index, name) in names.enumerate() { option value=(index) { (TerminalText(name)) } }
            }
        }
    }
}

pub(crate) fn recordings_page(catalog: &Catalog) -> String {
    let names = catalog.recordings.iter().map(|recording| &*recording.name);
    let content = html! {
        h1.unseen { "Recordings" }
        @if catalog.recordings.is_empty() {
            p { "No recording was given. Start crumple with a recording:" }
            p { code { "crumple explore --recording platoon.csv --controller acc-aeb" } }
        } @else {
            div.bench {
                form.controls id="controls" aria-label="Selection" {
                    (choice("recording", "Recording", names))
                    (controller_choice(catalog))
                    p.hint { "Each controller observes the recorded drive of a vehicle behind its leader, and cannot \
                    change it. Braking that would have prevented a situation does not show." }
                }
                section.seen aria-label="Result" {
                    p.bad id="error" role="alert" hidden {}
                    div id="words" {}
                    div id="drives" {}
                    h2 id="drive-name" hidden {}
                    p { button type="button" id="whole" hidden { "Show the whole drive" } }
                    div id="figures" {}
                    div id="brakings" {}
                }
            }
        }
    };
    document("recordings", "Recordings", &start_values(), &content)
}

pub(crate) fn suites_page(catalog: &Catalog) -> String {
    let names = catalog.suites.iter().map(|suite| &*suite.name);
    let content = html! {
        h1.unseen { "Suites" }
        @if catalog.suites.is_empty() {
            p { "No suite was given. Start crumple with a suite:" }
            p { code { "crumple explore --suite fmvss-127 --controller acc-aeb" } }
        } @else {
            div.bench {
                form.controls id="controls" aria-label="Selection" {
                    (choice("suite", "Suite", names))
                    (controller_choice(catalog))
                    (estimator_choice(catalog))
                    p.hint { "A margin states how far one quantity can be changed until the test fails. Each link \
                    opens the simulation." }
                }
                section.seen aria-label="Result" {
                    p.bad id="error" role="alert" hidden {}
                    p id="said" role="status" {}
                    div id="words" {}
                    div id="tests" {}
                }
            }
        }
    };
    document("suites", "Suites", &start_values(), &content)
}

fn start_values() -> Value {
    json!({ "most_controllers": ExploreConfig::MAX_CONTROLLERS })
}

pub(crate) fn campaigns_page(catalog: &Catalog) -> String {
    let campaigns = &catalog.campaigns;
    let content = html! {
        h1.unseen { "Campaigns" }
        @if campaigns.is_empty() {
            p { "No campaign was given. Start crumple with the folder of a campaign:" }
            p { code { "crumple explore runs/match-leader" } }
        } @else {
            form.filters id="filters" aria-label="Selection" {
                label { "Campaign "
                    select id="campaign" {
                        @for (index, campaign) in campaigns.iter().enumerate() {
                            option value=(index) { (TerminalText(&campaign.name)) }
                        }
                    }
                }
                label { "Compare with "
                    select id="against" {
                        option value="" { "none" }
                        @for (index, campaign) in campaigns.iter().enumerate() {
                            option value=(index) { (TerminalText(&campaign.name)) }
                        }
                    }
                }
                label { "Map x axis " select id="across" {} }
                label { "Map y axis " select id="up" {} }
                label { "Method " select id="method" { option value="" { "every method" } } }
                label { "Kind of failure " select id="kind" { option value="" { "every kind" } } }
            }
            p.bad id="error" role="alert" hidden {}
            div id="words" {}
            p.unseen id="said" role="status" {}
            div id="best" {}
            section { h2 { "Where it fails" }
                p.hint { "Green: no evaluation fails. Crossed: some fail. Red with a number: all fail. Blank: no \
                evaluation. Each cell links to its worst scenario." }
                div id="maps" {}
            }
            section { h2 { "Failures" } div id="distinct" {} div id="failures" {} }
        }
    };
    document("campaigns", "Campaigns", &json!({}), &content)
}

fn document(page: &str, title: &str, start: &Value, content: &Markup) -> String {
    let document = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content={ "crumple " (env!("CARGO_PKG_VERSION")) };
                title { (title) " – crumple" }
                link rel="icon" href="data:,";
                link rel="stylesheet" href="explore.css";
                script src="explore.js" defer {}
            }
            body.explore data-page=(page) {
                header {
                    p.kicker { "crumple " (env!("CARGO_PKG_VERSION")) }
                    nav {
                        @let links = [("scenario", "./", "Scenario"), ("campaigns", "campaigns", "Campaigns"),
                            ("recordings", "recordings", "Recordings"), ("suites", "suites", "Suites")];
                        @for (name, address, label) in links {
                            a href=(address) aria-current=[(name == page).then_some("page")] { (label) } " "
                        }
                    }
                }
                main {
                    noscript { p.bad { "This page needs JavaScript." } }
                    (content)
                }
                script type="application/json" id="start" { (PreEscaped(escape_json(start))) }
            }
        }
    };
    document.into_string()
}

/// Returns JSON that is safe in a script element.
fn escape_json(json: &Value) -> String {
    json.to_string().replace('<', "\\u003c")
}
