//! Local web application for editing scenarios interactively and for watching campaigns.
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
//! | `page` | pages, style sheet and script |
//! | `routes` | dispatch of requests |
//! | `server` | connections, their limits, and shutdown |
//!
//! # Access
//!
//! The server listens on 127.0.0.1 only, and every path begins with a random token of 256 bits in hexadecimal. It is no
//! cookie, because browsers send the cookies of a host to all of its ports, also for requests of other pages. Every
//! request without the token is refused. So is one with another `Host`, as after DNS rebinding, or with the `Origin` or
//! `Sec-Fetch-Site` of another page.
//!
//! No path in a request is opened. Requests name items of the catalog, and scenarios in them only its files.

mod auth;
mod avoidability;
mod campaign;
mod catalog;
mod error;
mod page;
mod render;
mod request;
mod routes;
mod save;
mod server;

pub use catalog::{CatalogScenario, ExploreConfig, ExploreConfigError};
pub use server::{ServeError, Server};
