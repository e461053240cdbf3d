//! What happened in the night, from the journal's events: how long it took, what failed and how it went on, where it
//! waited, what was taken again, what is missing.

use super::context::side_words;
use crate::archive::rows::{EventRow, StepRow, StepState};
use crate::control::events::Event;
use crate::control::frames::guard::Rejection;
use crate::control::plan::document::RunDocument;
use crate::control::plan::{Subject, View};
use crate::control::sequencer::state::State;
use std::collections::BTreeMap;

/// Lines of a kind that are told one by one; beyond them only their number.
const TOLD: usize = 12;

/// What is counted while the events are read.
#[derive(Default)]
struct Night {
    begun: Vec<i64>,
    last_us: i64,
    worked_us: i64,
    devices: BTreeMap<String, Trouble>,
    refused: BTreeMap<String, u32>,
    retaken: u32,
    waits: Vec<String>,
    waiting: Option<(i64, String)>,
    asked: Vec<String>,
    archive: Vec<String>,
}

/// Errors of one device.
#[derive(Default)]
struct Trouble {
    kinds: BTreeMap<String, u32>,
    opened: u32,
    last: String,
}

/// Heading and words of each thing worth telling; never empty.
pub fn night(document: &RunDocument, events: &[EventRow], steps: &[StepRow]) -> Vec<(String, String)> {
    let mut night = Night::default();
    for row in events {
        if let Ok(event) = serde_json::from_str(&row.json) {
            night.note(row.utc_us, event);
        }
    }
    night.told(document.plan.forecast.total_s(), missing(document, steps))
}

// === impl Night ===

impl Night {
    fn note(&mut self, at_us: i64, event: Event) {
        // A run that lay cut short takes no time until it is gone on with.
        if !matches!(event, Event::RunStarted { .. }) && !self.begun.is_empty() {
            self.worked_us += at_us - self.last_us;
        }
        self.last_us = at_us;
        match event {
            Event::RunStarted { .. } => {
                self.begun.push(at_us);
                self.waiting = None;
            }
            Event::DeviceOpened { device, .. } => self.devices.entry(device).or_default().opened += 1,
            Event::DeviceError { device, error, message, .. } => {
                let trouble = self.devices.entry(device).or_default();
                *trouble.kinds.entry(kind_words(error).to_owned()).or_default() += 1;
                trouble.last = message;
            }
            Event::FrameRejected { reason, .. } => {
                let kind = kind_of(&reason);
                *self.refused.entry(kind).or_default() += 1;
            }
            Event::ViewRetaken { .. } => self.retaken += 1,
            Event::Asked { verb, refused: None } => self.asked.push(format!("{} at {}", verb.name(), clock(at_us))),
            Event::ArchiveError { message } => self.archive.push(message),
            Event::StateChanged { to, .. } => self.state(at_us, &to),
            _ => {}
        }
    }

    /// A wait begins, changes or ends.
    fn state(&mut self, at_us: i64, to: &State) {
        if let Some((since, why)) = self.waiting.take() {
            self.waits.push(format!("{why}, {} for {}", clock(since), seconds(at_us - since)));
        }
        let why = match to {
            State::Paused => "paused".to_owned(),
            State::Suspended(reasons) => reasons.iter().map(|reason| reason.name()).collect::<Vec<_>>().join(" and "),
            _ => return,
        };
        self.waiting = Some((at_us, why));
    }

    fn told(self, forecast_s: f64, missing: Vec<String>) -> Vec<(String, String)> {
        let parts = match self.begun.len() {
            0 | 1 => String::new(),
            n => format!(", in {n} parts: it was cut short or stopped and gone on with"),
        };
        let took = format!("{}, forecast {}{parts}", seconds(self.worked_us), duration(forecast_s));
        let mut told = vec![("Took".to_owned(), took)];
        let lives = self.begun.len().max(1) as u32;
        for (device, trouble) in self.devices.into_iter().filter(|(_, trouble)| !trouble.kinds.is_empty()) {
            told.push((device, trouble.words(lives)));
        }
        let refused: Vec<String> = self.refused.iter().map(|(why, n)| format!("{n} x {why}")).collect();
        let retaken = if self.retaken > 0 { vec![self.retaken.to_string()] } else { Vec::new() };
        for (what, lines) in [
            ("Frames refused", refused),
            ("Brackets taken again because the lamp drifted", retaken),
            ("Waited", self.waits),
            ("Asked by an operator", self.asked),
            ("Disk", self.archive),
            ("Missing", missing),
        ] {
            if !lines.is_empty() {
                told.push((what.to_owned(), few(lines)));
            }
        }
        if told.len() == 1 {
            told.push(("Trouble".to_owned(), "none".to_owned()));
        }
        told
    }
}

// === impl Trouble ===

impl Trouble {
    fn words(&self, lives: u32) -> String {
        let all: u32 = self.kinds.values().sum();
        let kinds: Vec<String> = self.kinds.iter().map(|(kind, n)| format!("{n} x {kind}")).collect();
        let opened = match self.opened.saturating_sub(lives) {
            0 => String::new(),
            1 => "; opened anew once".to_owned(),
            n => format!("; opened anew {n} times"),
        };
        let errors = if all == 1 { "error" } else { "errors" };
        format!("{all} {errors} ({}){opened}; the last: {}", kinds.join(", "), self.last)
    }
}

/// A reason by its name in the journal, without the numbers that differ from frame to frame.
fn kind_of(reason: &Rejection) -> String {
    let value = serde_json::to_value(reason).unwrap_or_default();
    let name = value.as_str().or_else(|| value.as_object()?.keys().next().map(String::as_str));
    name.unwrap_or("unknown").replace('-', " ")
}

fn kind_words(kind: goniod_drivers::error::ErrorKind) -> &'static str {
    use goniod_drivers::error::ErrorKind::{Broken, Busy, Garbled, Lost, Refused, Timeout, WrongDevice};
    match kind {
        Busy => "busy",
        Timeout => "no answer",
        Garbled => "garbled answer",
        Refused => "refused",
        Lost => "lost",
        WrongDevice => "another device",
        Broken => "fault of its own",
    }
}

/// Missing exposures by view and reason, as people name views.
fn missing(document: &RunDocument, steps: &[StepRow]) -> Vec<String> {
    let plan = &document.plan;
    let mut views: BTreeMap<(u32, &str), u32> = BTreeMap::new();
    for row in steps {
        let StepState::Missing(reason) = &row.state else { continue };
        let view = plan.steps.iter().find(|step| step.number == row.layout.number).map_or(u32::MAX, |step| step.view);
        *views.entry((view, reason.as_str())).or_default() += 1;
    }
    let named = |((view, reason), n): ((u32, &str), u32)| {
        let view = plan.views.get(view as usize).map_or_else(|| "a view".to_owned(), view_words);
        format!("{n} of {view}: {reason}")
    };
    views.into_iter().map(named).collect()
}

fn view_words(view: &View) -> String {
    let band = view.band.as_deref().map(|band| format!(" in {band}")).unwrap_or_default();
    match &view.subject {
        Subject::Sample { side, incident } => {
            let (theta, phi) = incident.degrees();
            format!("{} at ({theta:.0}, {phi:.0}){band}", side_words(*side))
        }
        Subject::Reference { transmission: true } => format!("the transmitting reference{band}"),
        Subject::Reference { transmission: false } => format!("the reflecting reference{band}"),
        Subject::Dark => format!("a dark of camera {}", view.camera),
    }
}

/// The first few lines, and how many more there are.
fn few(mut lines: Vec<String>) -> String {
    let more = lines.len().saturating_sub(TOLD);
    lines.truncate(TOLD);
    lines.extend((more > 0).then(|| format!("and {more} more")));
    lines.join("; ")
}

fn clock(us: i64) -> String {
    jiff::Timestamp::from_microsecond(us).map_or_else(|_| "-".to_owned(), |t| t.strftime("%H:%M:%S UTC").to_string())
}

fn seconds(us: i64) -> String {
    duration(us as f64 / 1e6)
}

/// `1 h 02 min`, `3 min 05 s`, `12.4 s`.
pub fn duration(seconds: f64) -> String {
    match seconds.round().max(0.0) as u64 {
        s if s >= 3600 => format!("{} h {:02} min", s / 3600, s % 3600 / 60),
        s if s >= 60 => format!("{} min {:02} s", s / 60, s % 60),
        _ => format!("{seconds:.1} s"),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::control::sequencer::interlocks::Reason;
    use crate::control::sequencer::recorder::row;
    use crate::control::sequencer::verbs::Verb;
    use goniod_drivers::clock::UtcMicros;
    use goniod_drivers::error::ErrorKind;

    fn told(events: &[(i64, Event)]) -> BTreeMap<String, String> {
        let mut night = Night::default();
        for (seq, (s, event)) in (0..).zip(events) {
            let row = row(seq, UtcMicros(s * 1_000_000), event);
            night.note(row.utc_us, serde_json::from_str(&row.json).unwrap());
        }
        night.told(600.0, Vec::new()).into_iter().collect()
    }

    #[test]
    fn a_quiet_night_says_how_long_it_took_and_that_there_was_nothing() {
        let told =
            told(&[(0, Event::RunStarted { steps: 3, to_do: 3 }), (90, Event::ViewRetaken { view: 1, change: None })]);
        assert_eq!(told["Took"], "1 min 30 s, forecast 10 min 00 s");
        assert_eq!(told["Brackets taken again because the lamp drifted"], "1");
        let quiet = Night::default().told(1.0, Vec::new());
        assert_eq!(quiet.last().unwrap(), &("Trouble".to_owned(), "none".to_owned()));
    }

    #[test]
    fn errors_waits_verbs_and_refused_frames_are_told_and_a_night_cut_short_takes_no_time_meanwhile() {
        let error = |error, message: &str| Event::DeviceError {
            device: "holder".to_owned(),
            error,
            message: message.to_owned(),
            decision: String::new(),
        };
        let suspended = State::Suspended([Reason::Disk].into());
        let refused = |previous| Event::FrameRejected { step: 1, reason: Rejection::NotAdvanced { previous, got: 1 } };
        let told = told(&[
            (0, Event::RunStarted { steps: 3, to_do: 3 }),
            (1, error(ErrorKind::Timeout, "it says nothing")),
            (2, error(ErrorKind::Timeout, "still nothing")),
            (3, error(ErrorKind::Lost, "it is gone")),
            (4, refused(7)),
            (5, refused(8)),
            (10, Event::StateChanged { from: State::Running, to: suspended.clone() }),
            (75, Event::StateChanged { from: suspended, to: State::Running }),
            (80, Event::Asked { verb: Verb::Pause, refused: None }),
            (80, Event::Asked { verb: Verb::Stop, refused: Some("no".to_owned()) }),
            (5000, Event::RunStarted { steps: 3, to_do: 1 }),
            (5010, Event::ArchiveError { message: "the disk is full".to_owned() }),
        ]);
        assert!(told["Took"].starts_with("1 min 30 s,") && told["Took"].contains("in 2 parts"), "{told:?}");
        assert_eq!(told["holder"], "3 errors (1 x lost, 2 x no answer); the last: it is gone");
        assert_eq!(told["Frames refused"], "2 x not advanced");
        assert_eq!(told["Waited"], "disk, 00:00:10 UTC for 1 min 05 s");
        assert_eq!(told["Asked by an operator"], "pause at 00:01:20 UTC");
        assert_eq!(told["Disk"], "the disk is full");
    }

    #[test]
    fn durations_read_naturally() {
        assert_eq!(duration(12.44), "12.4 s");
        assert_eq!(duration(185.0), "3 min 05 s");
        assert_eq!(duration(3720.0), "1 h 02 min");
    }
}
