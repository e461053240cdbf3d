//! `goniod watch`: what happens, line by line, until the daemon ends or Ctrl-C; with `--json` one document a line.

use super::daemon::DaemonArgs;
use super::exit::Exit;
use super::output::{Outcome, Output};
use super::run::no_runtime;
use super::status::now_line;
use crate::control::events::Event;
use crate::control::sequencer::interlocks::{Gauge, Trip};
use crate::control::sequencer::state::State;
use crate::front::api::answers::Status;
use crate::front::api::client::{Client, ClientError};
use crate::front::daemon::hub::{DaemonEvent, Told, What};
use crate::front::lamp;
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
        Event::StateChanged { to, .. } => format!("now {}", state_words(to)),
        Event::Asked { verb, refused: None } => format!("{} was asked", verb.name()),
        Event::Asked { verb, refused: Some(why) } => format!("{} was asked and refused: {why}", verb.name()),
        Event::Interlocks { warnings, alarms } => interlock_words(warnings, alarms),
        Event::LightRead { power_w, u_w, .. } => format!("lamp {power_w:.4e} W, standard uncertainty {u_w:.1e} W"),
        Event::Lamp { lamp } => lamp::words(lamp),
        Event::LampHours { age } => age.words(),
        Event::ViewRetaken { view, change: Some(change) } => {
            format!("view {view} is taken again: the lamp changed by {:.2} %", change * 100.0)
        }
        Event::ViewRetaken { view, change: None } => {
            format!("view {view} is taken again: it is not known how the lamp changed")
        }
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

/// `suspended (disk, temperature)`.
fn state_words(state: &State) -> String {
    match state {
        State::Suspended(reasons) => {
            let names: Vec<&str> = reasons.iter().map(|r| r.name()).collect();
            format!("{} ({})", state.name(), names.join(", "))
        }
        state => state.name().to_owned(),
    }
}

fn interlock_words(warnings: &[Trip], alarms: &[Trip]) -> String {
    let names = |trips: &[Trip]| trips.iter().map(trip_words).collect::<Vec<_>>().join(", ");
    match (warnings, alarms) {
        ([], []) => "interlocks: nothing holds the run".to_owned(),
        (warnings, []) => format!("interlocks: waits for {}", names(warnings)),
        (_, alarms) => format!("interlocks: ALARM, {}", names(alarms)),
    }
}

fn trip_words(trip: &Trip) -> String {
    match &trip.gauge {
        Gauge::Temperature(device) => format!("{} of {device}", trip.reason.name()),
        _ => trip.reason.name().to_owned(),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::sequencer::interlocks::Reason;
    use crate::control::sequencer::verbs::Verb;

    #[test]
    fn what_was_asked_and_what_the_interlocks_say_is_told_in_words() {
        let trip = |gauge| Trip { reason: Reason::Temperature, gauge };
        let (warm, lost) = (trip(Gauge::Temperature("ccd".to_owned())), State::Suspended([Reason::DeviceLost].into()));
        for (event, words) in [
            (Event::Asked { verb: Verb::PauseNow, refused: None }, "pause now was asked"),
            (
                Event::Asked { verb: Verb::Resume, refused: Some("the run is under way".to_owned()) },
                "resume was asked and refused: the run is under way",
            ),
            (
                Event::Interlocks { warnings: vec![warm.clone()], alarms: vec![] },
                "interlocks: waits for temperature of ccd",
            ),
            (Event::Interlocks { warnings: vec![], alarms: vec![warm] }, "interlocks: ALARM, temperature of ccd"),
            (Event::Interlocks { warnings: vec![], alarms: vec![] }, "interlocks: nothing holds the run"),
            (Event::StateChanged { from: State::Running, to: lost }, "now suspended (device-lost)"),
        ] {
            assert_eq!(run_words(&event), words);
        }
    }
}
