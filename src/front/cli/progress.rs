//! Progress of a run on the terminal: step, time left, forecast end.

use crate::control::events::{Event, Stamped};
use crate::control::plan::Plan;
use crate::front::night::stamp;
use crate::front::remaining::left_s;
use goniod_drivers::clock::UtcMicros;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tokio::sync::broadcast;
use tokio::task::JoinHandle;

/// A progress display fed by the run's events.
pub struct Progress {
    bar: ProgressBar,
    task: JoinHandle<()>,
}

/// `1 h 02 min`, `3 min 05 s`, `12.4 s`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.round().max(0.0) as u64;
    match whole {
        s if s >= 3600 => format!("{} h {:02} min", s / 3600, s % 3600 / 60),
        s if s >= 60 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{seconds:.1} s"),
    }
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
    loop {
        let stamped = match events.recv().await {
            Ok(stamped) => stamped,
            Err(broadcast::error::RecvError::Lagged(_)) => continue,
            Err(broadcast::error::RecvError::Closed) => return,
        };
        let now = stamped.utc;
        let begin = *begun.get_or_insert(now);
        match stamped.event {
            Event::Progress { stored, missing, .. } => {
                let done = stored + missing;
                bar.set_position(u64::from(done));
                let elapsed_s = (now.0 - begin.0) as f64 / 1e6;
                let left_s = left_s(forecast_s, elapsed_s, done, steps as u32);
                let end = UtcMicros(now.0 + (left_s * 1e6) as i64);
                let clock = stamp(end).strftime("%H:%M:%S UTC").to_string();
                bar.set_message(format!("{} left, done at {clock}", duration(left_s)));
            }
            Event::StepMissing { step, reason, .. } => bar.println(format!("step {step} missing: {reason}")),
            Event::DeviceError { device, message, decision, .. } => {
                bar.println(format!("{device}: {message}; {decision}"));
            }
            Event::RunEnded { .. } => return,
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::duration;

    #[test]
    fn durations_read_naturally() {
        assert_eq!(duration(12.44), "12.4 s");
        assert_eq!(duration(185.0), "3 min 05 s");
        assert_eq!(duration(3720.0), "1 h 02 min");
    }
}
