//! Progress of a run on the terminal: step, time left, forecast end.

use crate::control::events::{Event, Stamped};
use crate::control::plan::Plan;
use crate::control::sequencer::state::State;
use crate::front::lamp::{self, LampWait};
use crate::front::night::stamp;
use crate::front::remaining::{after, left_s};
use crate::products::night::duration;
use goniod_drivers::clock::UtcMicros;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::Write;
use tokio::sync::broadcast;
use tokio::task::JoinHandle;

/// A progress display fed by the run's events.
pub struct Progress {
    bar: ProgressBar,
    task: JoinHandle<()>,
}

// === impl Progress ===

impl Progress {
    /// Begins to show; hidden when standard error is no terminal or `quiet`.
    pub fn begin(plan: &Plan, events: broadcast::Receiver<Stamped>, quiet: bool) -> Progress {
        let bar = ProgressBar::new(plan.steps.len() as u64);
        if quiet {
            bar.set_draw_target(ProgressDrawTarget::hidden());
        }
        let style = ProgressStyle::with_template("{bar:30} {pos}/{len}  {msg}");
        bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
        let task = tokio::spawn(follow(bar.clone(), events, plan.forecast.total_s(), plan.steps.len()));
        Progress { bar, task }
    }

    /// Ends the display.
    pub fn end(self) {
        self.bar.finish_and_clear();
        self.task.abort();
    }
}

async fn follow(bar: ProgressBar, mut events: broadcast::Receiver<Stamped>, forecast_s: f64, steps: usize) {
    let mut begun: Option<UtcMicros> = None;
    let mut wait = LampWait::default();
    loop {
        let stamped = match events.recv().await {
            Ok(stamped) => stamped,
            Err(broadcast::error::RecvError::Lagged(_)) => continue,
            Err(broadcast::error::RecvError::Closed) => return,
        };
        let now = stamped.utc;
        let begin = *begun.get_or_insert(now);
        wait.note(&stamped);
        match stamped.event {
            Event::Progress { stored, missing, .. } => {
                let done = stored + missing;
                bar.set_position(u64::from(done));
                let elapsed_s = (now.0 - begin.0) as f64 / 1e6 - wait.taken_s(now);
                let left_s = left_s(forecast_s, elapsed_s, done, steps as u32) + wait.ahead_s(now);
                let clock = stamp(after(now, left_s)).strftime("%H:%M:%S UTC").to_string();
                bar.set_message(format!("{} left, done at {clock}", duration(left_s)));
            }
            Event::StepMissing { step, reason, .. } => bar.println(format!("step {step} missing: {reason}")),
            Event::DeviceError { device, message, decision, .. } => {
                bar.println(format!("{device}: {message}; {decision}"));
            }
            Event::StateChanged { from, to } if from != to => waits(&bar, &from, &to),
            Event::Lamp { lamp } => bar.println(lamp::words(&lamp)),
            Event::RunEnded { .. } => return,
            _ => {}
        }
    }
}

/// Tells when the run begins to wait and when it goes on, also where no terminal shows the bar: nobody should wonder
/// about a night that stands still.
fn waits(bar: &ProgressBar, from: &State, to: &State) {
    let line = match (from, to) {
        (_, State::Suspended(reasons)) => {
            let reasons: Vec<&str> = reasons.iter().map(|reason| reason.name()).collect();
            format!("suspended: {}; goes on by itself when that is over", reasons.join(", "))
        }
        (State::Suspended(_), State::Running) => "goes on".to_owned(),
        _ => return,
    };
    if bar.is_hidden() {
        let _ = writeln!(std::io::stderr(), "goniod: {line}");
    } else {
        bar.println(line);
    }
}
