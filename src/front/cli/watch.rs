//! `goniod watch`: what happens, line by line, until the daemon ends or Ctrl-C; with `--json` one document a line.

use super::daemon::DaemonArgs;
use super::exit::Exit;
use super::output::{Outcome, Output};
use super::run::no_runtime;
use super::status::now_line;
use crate::control::events::Event;
use crate::front::api::answers::Status;
use crate::front::api::client::{Client, ClientError};
use crate::front::daemon::hub::{DaemonEvent, Told, What};
use crate::front::night::stamp;
use hyper::Method;

/// Arguments.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Begin with what the journals have after this event: RUN/NUMBER, as events are named; RUN/-1 for a whole run.
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    since: Option<String>,
    #[command(flatten)]
    daemon: DaemonArgs,
}

/// Runs the command.
pub fn run(args: Args, output: &Output) -> Outcome {
    let client = Client::new(args.daemon.find());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(no_runtime)?;
    runtime.block_on(watch(&client, args.since.as_deref(), output))?;
    Ok(Exit::Done)
}

async fn watch(client: &Client, since: Option<&str>, output: &Output) -> Result<(), ClientError> {
    // First listen, then ask how things stand: nothing falls between the two.
    let mut events = client.events(since).await?;
    let status: Status = client.ask(Method::GET, "/v1/status", None::<&()>).await?;
    output.say(&status.run.as_ref().map_or_else(|| format!("{}: idle", status.instrument), now_line));
    while let Some(data) = events.next().await {
        if output.json {
            output.raw_line(&data);
        } else if let Ok(told) = serde_json::from_str::<Told>(&data) {
            output.say(&line(&told));
        }
    }
    Ok(())
}

/// One event as a line for people.
fn line(told: &Told) -> String {
    let when = stamp(told.utc).strftime("%H:%M:%S").to_string();
    let what = match &told.event {
        What::Run(event) => run_words(event),
        What::Daemon(event) => daemon_words(event, told.run.as_deref()),
    };
    format!("{when}  {what}")
}

fn run_words(event: &Event) -> String {
    match event {
        Event::RunStarted { steps, to_do } => format!("run begins: {to_do} of {steps} exposures to do"),
        Event::Progress { stored, missing, steps } => format!("{stored} of {steps} stored, {missing} missing"),
        Event::StepMissing { step, reason, .. } => format!("step {step} missing: {reason}"),
        Event::DeviceError { device, message, decision, .. } => format!("{device}: {message}; {decision}"),
        Event::RunEnded { stored, missing, planned, message, .. } => {
            let message = message.as_ref().map_or_else(String::new, |m| format!("; {m}"));
            format!("run ended: {stored} stored, {missing} missing, {planned} not done{message}")
        }
        event => {
            // Events are plain data of ours: JSON always holds them.
            let mut json = serde_json::to_value(event).unwrap_or_default();
            json.as_object_mut().map(|o| o.remove("kind"));
            format!("{} {json}", event.kind())
        }
    }
}

fn daemon_words(event: &DaemonEvent, run: Option<&str>) -> String {
    let run = run.unwrap_or("-");
    match event {
        DaemonEvent::EntryChanged { entry, state, reason } => {
            let reason = reason.as_ref().map_or_else(String::new, |r| format!(": {r}"));
            format!("entry {entry} {state}{reason}")
        }
        DaemonEvent::QueueHeld { reason: Some(reason) } => format!("the queue is held: {reason}"),
        DaemonEvent::QueueHeld { reason: None } => "the queue goes on".to_owned(),
        DaemonEvent::ProductsMade { headline } => format!("{run}: products made\n{}", headline.join("\n")),
        DaemonEvent::ProductsFailed { reason } => format!("{run}: products could not be made: {reason}"),
        DaemonEvent::Lagged { lost } => format!("{lost} events were lost here; the journal has those of the run"),
        DaemonEvent::Stopping => "the daemon ends".to_owned(),
    }
}
