//! `goniod queue add SCAN | list | remove ID`: what the daemon is to do.

use super::daemon::{DaemonArgs, asked};
use super::exit::Exit;
use super::output::{Failure, Outcome, Output};
use crate::front::api::answers::{Added, EntryNow, NewEntry, QueueList};
use crate::front::daemon::entry::Products;
use crate::front::daemon::snapshot::plain;
use crate::products::night::duration;
use hyper::Method;
use std::path::PathBuf;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Put a scan at the end of the queue; later edits of its files change nothing.
    Add {
        /// The scan file.
        scan: PathBuf,
        #[command(flatten)]
        daemon: DaemonArgs,
    },
    /// Tell all entries in their order.
    List {
        #[command(flatten)]
        daemon: DaemonArgs,
    },
    /// Take a waiting entry out of the queue.
    Remove {
        /// Number of the entry.
        id: u32,
        #[command(flatten)]
        daemon: DaemonArgs,
    },
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    match args.command {
        Command::Add { scan, daemon } => {
            if !scan.is_file() {
                let why = format!("{}: there is no such scan file; check the path", scan.display());
                return Err(Failure::new(Exit::BadInput, why));
            }
            let new = NewEntry { scan: Some(plain(&scan)), resume: None };
            added(&new, &daemon, output)
        }
        Command::List { daemon } => {
            let list: QueueList =
                asked(&daemon, |client| async move { client.ask(Method::GET, "/v1/queue", None::<&()>).await })?;
            output.result(Exit::Done, &list, || list_text(&list))
        }
        Command::Remove { id, daemon } => {
            let path = format!("/v1/queue/{id}");
            let entry: EntryNow =
                asked(&daemon, |client| async move { client.ask(Method::DELETE, &path, None::<&()>).await })?;
            output.result(Exit::Done, &entry, || format!("entry {id} ({}) is out of the queue", entry.name))
        }
    }
}

/// Puts an entry into the queue and says where it stands.
pub fn added(new: &NewEntry, daemon: &DaemonArgs, output: &Output) -> Outcome {
    let added: Added = asked(daemon, |client| async move { client.ask(Method::POST, "/v1/queue", Some(new)).await })?;
    for warning in &added.warnings {
        output.warn(warning);
    }
    output.result(Exit::Done, &added, || {
        let mut text = format!("entry {} ({}), {} before it", added.entry.id, added.entry.name, added.before);
        if let Some(why) = &added.held {
            text.push_str(&format!("\nthe queue is held: {why}"));
        }
        text
    })
}

fn list_text(list: &QueueList) -> String {
    let mut lines: Vec<String> = list.entries.iter().map(entry_line).collect();
    lines.extend(list.bad.iter().map(|b| format!("{}: cannot be read: {}", b.path.display(), b.reason)));
    if lines.is_empty() {
        lines.push("the queue is empty".to_owned());
    }
    lines.extend(list.held.as_ref().map(|why| format!("the queue is held: {why}")));
    lines.join("\n")
}

fn entry_line(entry: &EntryNow) -> String {
    let more = match (&entry.outcome, &entry.reason, &entry.run) {
        (Some(o), _, Some(run)) => {
            format!("{run}: {}, {} stored, {} missing{}", o.ending, o.stored, o.missing, products(entry))
        }
        (_, Some(reason), _) => reason.clone(),
        (_, _, Some(run)) => run.clone(),
        _ => entry.forecast_s.map_or_else(String::new, |s| format!("{} forecast", duration(s))),
    };
    format!("{:>4}  {:<9}  {}  {more}", entry.id, entry.state, entry.name)
}

fn products(entry: &EntryNow) -> &'static str {
    match entry.products {
        Products::None => "",
        Products::Pending => ", products to come",
        Products::Made { .. } => ", products made",
        Products::Failed { .. } => ", products FAILED",
    }
}
