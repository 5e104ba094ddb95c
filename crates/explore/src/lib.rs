//! Local web application for editing scenarios interactively, and for results of campaigns, recordings and suites.
//!
//! | module | content |
//! |---|---|
//! | `catalog` | scenarios, controllers and folders that requests may name |
//! | `auth` | checks of token, host and origin of a request |
//! | `error` | error responses |
//! | `request` | requests: a scenario and its edits |
//! | `render` | runs of a scenario: verdicts, diagrams, top views |
//! | `avoidability` | avoidability of a collision |
//! | `save` | storage of a scenario as a file |
//! | `campaign` | results of campaigns, over evaluations and over parameters |
//! | `recording` | recorded drives, and what controllers command there |
//! | `suite` | tests of suites with their margins |
//! | `page` | pages, style sheet and script |
//! | `routes` | dispatch of requests |
//! | `server` | connections, their limits, and shutdown |
//!
//! # Access
//!
//! The server listens on 127.0.0.1 only, and every path begins with a random token of 256 bits in hexadecimal. The
//! token is not in a cookie, because browsers send the cookies of a host to all of its ports, also with requests that
//! other pages make. The server refuses a request without the token, with another `Host` (as after DNS rebinding), or
//! with the `Origin` or `Sec-Fetch-Site` of another page.
//!
//! The server opens no path that a request contains. A request names items of the catalog, and a scenario in a request
//! may name only files that scenarios of the catalog use.

mod auth;
mod avoidability;
mod campaign;
mod catalog;
mod error;
mod page;
mod recording;
mod render;
mod request;
mod routes;
mod save;
mod server;
mod suite;

pub use catalog::{CatalogScenario, CatalogSuite, ExploreConfig, ExploreConfigError};
pub use server::{ServeError, Server};
