//! The control API: HTTP on a Unix socket, and read-only on a loopback port where the instrument file asks for it.
//!
//! - [`routes`]: the table of everything that can be asked; `docs/api.md` tells the same
//! - [`answers`]: the documents that are answered; [`error`]: refusals
//! - [`queue`], [`verbs`], [`runs`], [`events`], [`page`]: one file a resource
//! - [`server`]: listeners, bounds, the end; [`client`]: how the command line asks

pub mod answers;
pub mod client;
pub mod error;
mod events;
mod guarded;
mod page;
mod queue;
pub mod routes;
mod runs;
pub mod server;
mod status;
mod verbs;

#[cfg(test)]
mod tests;
