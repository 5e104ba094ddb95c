//! Looking instead of reading: a local web application in which scenarios are dragged about and campaigns watched.
//!
//! | module | what it holds |
//! |---|---|
//! | `offer` | what the page may speak of: the scenarios, controllers and folders it was started with |
//! | `gate` | who is let in: the token, the host and the origin of a request |
//! | `refused` | everything a request can be answered with instead of what it asks for |
//! | `request` | what the page sends: a scenario and what was changed of it |
//! | `drawn` | runs of a scenario: verdicts, diagrams, the view from above |
//! | `avoided` | whether anybody could have avoided it |
//! | `saved` | a scenario as a file |
//! | `campaign` | campaigns: what they have found, over evaluations and over parameters |
//! | `page` | the pages, their style sheet and their script |
//! | `answer` | which request is answered by what |
//! | `server` | connections, their limits, and the end |
//!
//! # Who is let in
//!
//! The server listens on 127.0.0.1 alone, and every address begins with 256 random bits in hexadecimal. They stand in the address
//! and in no cookie: a browser sends cookies of a host to all of its ports, and along with what other pages ask for. Whoever does
//! not say them is refused, whatever else is asked. So is a request with another `Host` than the server's own, which a name that
//! was rebound to 127.0.0.1 would bring along, and one with another page's `Origin` or `Sec-Fetch-Site`.
//!
//! No path in a request is ever opened: a request names scenarios, controllers and campaigns by number or by a name that was
//! offered, and a scenario that it sends may name the files of those that were offered and no others.

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
