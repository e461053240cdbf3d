//! `goniod pause | stop | abort`: what the daemon's run is asked.

use super::daemon::{DaemonArgs, asked};
use super::exit::Exit;
use super::output::{Outcome, Output};
use crate::front::api::answers::Accepted;
use hyper::Method;

/// Arguments of a verb.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    pub daemon: DaemonArgs,
}

/// Arguments of `pause`.
#[derive(Debug, clap::Args)]
pub struct PauseArgs {
    /// Give the exposure under way up instead of finishing it.
    #[arg(long)]
    now: bool,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Runs `goniod pause`.
pub fn pause(args: &PauseArgs, output: &Output) -> Outcome {
    give(if args.now { "pause-now" } else { "pause" }, &args.daemon, output)
}

/// Gives a verb to the daemon.
pub fn give(verb: &str, daemon: &DaemonArgs, output: &Output) -> Outcome {
    let path = format!("/v1/verbs/{verb}");
    let accepted: Accepted = asked(daemon, |client| async move { client.ask(Method::POST, &path, None::<&()>).await })?;
    output.result(Exit::Done, &accepted, || match &accepted.run {
        Some(run) => format!("{run}: {}", accepted.message),
        None => accepted.message.clone(),
    })
}
