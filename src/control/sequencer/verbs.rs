//! What an operator or a signal may ask of a run under way, and what every state answers.

use super::interlocks::Reason;
use super::stage::Stage;
use super::state::{Ending, Input, State};
use crate::control::events::Event;
use rustix::process::Signal as Os;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;

/// A request to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verb {
    /// Finish the exposure under way, close the shutter, wait.
    Pause,
    /// Give the exposure under way up, close the shutter, wait; it is taken again later.
    PauseNow,
    /// Go on.
    Resume,
    /// Finish the exposure under way, then end safely.
    Stop,
    /// Give the exposure under way up and end safely.
    Abort,
    /// Drop everything and make the bench safe at once.
    Safe,
}

/// What a state answers to a verb.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// Carried out now; what is under way is given up.
    Now(Input),
    /// Carried out at the end of the exposure under way.
    AfterStep(Input),
    /// Not carried out, for this reason.
    Refused(&'static str),
}

/// The requests of a run, sorted by when they matter.
#[derive(Debug)]
pub struct Listener {
    verbs: mpsc::Receiver<Verb>,
    open: bool,
    /// The run is to end after the exposure under way.
    after_step: Option<Ending>,
    /// The run is to end now.
    now: Option<Ending>,
    /// What is under way is to be given up for a pause.
    pause_now: bool,
    /// Devices that are waited for are to be tried at once.
    try_again: bool,
}

// === impl Verb ===

impl Verb {
    /// All verbs.
    pub const ALL: [Verb; 6] = [Verb::Pause, Verb::PauseNow, Verb::Resume, Verb::Stop, Verb::Abort, Verb::Safe];

    /// The verb's name.
    pub fn name(self) -> &'static str {
        match self {
            Verb::Pause => "pause",
            Verb::PauseNow => "pause now",
            Verb::Resume => "resume",
            Verb::Stop => "stop",
            Verb::Abort => "abort",
            Verb::Safe => "safe",
        }
    }
}

// === impl State ===

impl State {
    /// What this state answers to a verb: every pair is carried out or refused with a reason.
    pub fn answer(&self, verb: Verb) -> Answer {
        use Answer::{AfterStep, Now, Refused};
        use State::{Checking, Faulted, Idle, MakingSafe, Paused, Pausing, Recovering, Running, Safe, Suspended};
        match (self, verb) {
            (MakingSafe(_), Verb::Safe) => Refused("the bench is being made safe already"),
            (MakingSafe(_), _) => Refused("the run is ending; the bench is being made safe"),
            (Safe(_) | Faulted(_), Verb::Safe) => {
                Refused("the run is over and no longer holds the bench; `goniod safe --direct` makes it safe")
            }
            (Safe(_) | Faulted(_), _) => Refused("the run is over; `goniod resume` goes on with it"),
            (_, Verb::Abort) => Now(Input::End(Ending::Aborted)),
            (_, Verb::Safe) => Now(Input::End(Ending::MadeSafe)),
            (Running | Pausing, Verb::Stop) => AfterStep(Input::End(Ending::Stopped)),
            (Idle | Checking | Paused | Suspended(_) | Recovering, Verb::Stop) => Now(Input::End(Ending::Stopped)),
            (Running, Verb::Pause) => AfterStep(Input::Pause),
            (Running | Recovering | Pausing | Suspended(_), Verb::PauseNow) => Now(Input::Pause),
            (Recovering | Suspended(_), Verb::Pause) => Now(Input::Pause),
            (Pausing, Verb::Pause) => Refused("a pause is asked for already"),
            (Paused, Verb::Pause | Verb::PauseNow) => Refused("the run is paused already"),
            (Idle | Checking, Verb::Pause | Verb::PauseNow) => {
                Refused("no exposure is taken yet; stop or abort end the run now")
            }
            (Pausing | Paused, Verb::Resume) => Now(Input::Resume),
            (Suspended(reasons), Verb::Resume) if reasons.iter().all(|r| *r == Reason::DeviceLost) => {
                Now(Input::Resume)
            }
            (Suspended(_), Verb::Resume) => Refused("it goes on by itself when its reasons are gone"),
            (Idle | Checking, Verb::Resume) => Refused("the run is about to begin"),
            (Running | Recovering, Verb::Resume) => Refused("the run is under way"),
        }
    }
}

// === impl Listener ===

impl Listener {
    /// Listens on a channel; when its other end is gone, nothing more is asked.
    pub fn new(verbs: mpsc::Receiver<Verb>) -> Listener {
        Listener { verbs, open: true, after_step: None, now: None, pause_now: false, try_again: false }
    }

    /// Why the run is to end, once the exposure under way is finished or given up.
    pub fn ending(&self) -> Option<Ending> {
        self.now.or(self.after_step)
    }

    /// True once when devices that are waited for are to be tried at once.
    pub fn take_try_again(&mut self) -> bool {
        std::mem::take(&mut self.try_again)
    }

    /// True when nobody can ask any more.
    pub fn is_closed(&self) -> bool {
        !self.open
    }

    /// Answers requests until what is under way must be given up; otherwise never ends.
    pub async fn until_interrupted(&mut self, stage: &Stage) {
        self.pause_now = false;
        while self.now.is_none() && !self.pause_now {
            self.answer_next(stage).await;
        }
    }

    /// Answers the next request; never ends when nobody can ask any more.
    pub async fn answer_next(&mut self, stage: &Stage) {
        if !self.open {
            return std::future::pending().await;
        }
        match self.verbs.recv().await {
            Some(verb) => self.note(verb, stage).await,
            None => self.open = false,
        }
    }

    /// Answers everything asked so far, without waiting.
    pub async fn catch_up(&mut self, stage: &Stage) {
        loop {
            match self.verbs.try_recv() {
                Ok(verb) => self.note(verb, stage).await,
                Err(mpsc::error::TryRecvError::Disconnected) => return self.open = false,
                Err(mpsc::error::TryRecvError::Empty) => return,
            }
        }
    }

    async fn note(&mut self, verb: Verb, stage: &Stage) {
        let answer = stage.state().answer(verb);
        // Ends come first: the record of the request may wait for a slow disk, the bench must not.
        match &answer {
            Answer::Now(Input::End(why)) => self.now = self.now.or(Some(*why)),
            Answer::AfterStep(Input::End(why)) => self.after_step = self.after_step.or(Some(*why)),
            Answer::Now(Input::Pause) => self.pause_now = true,
            Answer::Now(Input::Resume) => (self.pause_now, self.try_again) = (false, true),
            Answer::Now(_) | Answer::AfterStep(_) | Answer::Refused(_) => {}
        }
        let refused = match &answer {
            Answer::Refused(why) => Some((*why).to_owned()),
            _ => None,
        };
        stage.recorder().event(Event::Asked { verb, refused }).await;
        match answer {
            Answer::Now(input @ (Input::Pause | Input::Resume)) | Answer::AfterStep(input @ Input::Pause) => {
                stage.go(input).await;
            }
            _ => {}
        }
    }
}

/// What would kill a program that does not heed it, and is none of the ends that somebody asks for: a limit of its time, a
/// failing power supply, a timer, a signal sent by mistake.
const LESS_USUAL: [Os; 7] = [Os::XCPU, Os::POWER, Os::ALARM, Os::VTALARM, Os::PROF, Os::USR1, Os::USR2];

/// The signals that ask a program to end well: SIGTERM, SIGINT, SIGQUIT, SIGHUP of a terminal that is closed, unless the
/// program was started so that it survives that (nohup), and whatever else would end it otherwise. A file that grows
/// beyond a limit ends nothing: the write fails, as on a full disk.
///
/// # Errors
/// When the operating system refuses the handlers.
pub fn ending_signals() -> std::io::Result<Vec<Signal>> {
    drop(signal(SignalKind::from_raw(Os::XFSZ.as_raw()))?);
    let hangup = (!ignores_hangup()).then(SignalKind::hangup);
    let kinds = [SignalKind::terminate(), SignalKind::interrupt(), SignalKind::quit()].into_iter().chain(hangup);
    kinds.chain(LESS_USUAL.map(|s| SignalKind::from_raw(s.as_raw()))).map(signal).collect()
}

/// As the kernel tells in the mask of ignored signals; signal 1 is its lowest bit.
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

/// Turns the first of the signals that ask for an end into stop and each further one into abort, for as long as the
/// runtime lives.
///
/// # Errors
/// When the operating system refuses the handlers.
pub fn listen_to_signals(verbs: mpsc::Sender<Verb>) -> std::io::Result<()> {
    let asked = Arc::new(AtomicBool::new(false));
    for mut signal in ending_signals()? {
        let (verbs, asked) = (verbs.clone(), Arc::clone(&asked));
        tokio::spawn(async move {
            while signal.recv().await.is_some() {
                let verb = if asked.swap(true, Ordering::SeqCst) { Verb::Abort } else { Verb::Stop };
                if verbs.send(verb).await.is_err() {
                    return;
                }
            }
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::super::state::samples::{sets, states};
    use super::*;

    #[test]
    fn every_verb_in_every_state_is_carried_out_or_refused_with_a_reason() {
        for state in states() {
            for verb in Verb::ALL {
                match state.answer(verb) {
                    Answer::Now(input) | Answer::AfterStep(input) => {
                        // A pause under way may still be hastened, a lost device tried again at once.
                        let hastened = matches!(state, State::Pausing | State::Suspended(_));
                        assert!(
                            hastened || state.next(&input) != state,
                            "{state:?} {verb:?}: carried out without effect"
                        );
                        assert!(!state.is_final());
                    }
                    Answer::Refused(why) => assert!(why.len() > 10, "{state:?} {verb:?}: {why}"),
                }
                let over = state.is_final() || matches!(state, State::MakingSafe(_));
                if matches!(verb, Verb::Abort | Verb::Safe | Verb::Stop) {
                    let carried_out = !matches!(state.answer(verb), Answer::Refused(_));
                    assert_eq!(carried_out, !over, "{state:?} {verb:?}: an active run can always be ended");
                }
            }
        }
    }

    /// The page `docs/states.md` has one row a state and one column a verb; this is what must stand there.
    fn table() -> String {
        let mut states = vec![State::Idle, State::Checking, State::Running, State::Pausing, State::Paused];
        states.push(State::Suspended([Reason::Disk].into()));
        states.push(State::Suspended([Reason::DeviceLost].into()));
        states.push(State::Recovering);
        states.extend([State::MakingSafe(Ending::Stopped), State::Safe(Ending::Stopped)]);
        states.push(State::Faulted(Ending::Stopped));
        let mut lines = vec![
            format!("| state | {} |", Verb::ALL.map(Verb::name).join(" | ")),
            format!("|---|{}", "---|".repeat(Verb::ALL.len())),
        ];
        for state in states {
            let cell = |verb| match state.answer(verb) {
                Answer::Now(input) => format!("now: {}", shown(&state, &input)),
                Answer::AfterStep(input) => format!("after the exposure: {}", shown(&state, &input)),
                Answer::Refused(why) => format!("refused: {why}"),
            };
            let name = match &state {
                State::Suspended(r) if r.contains(&Reason::DeviceLost) => "suspended, a device is lost".to_owned(),
                state => state.name().to_owned(),
            };
            lines.push(format!("| {name} | {} |", Verb::ALL.map(cell).join(" | ")));
        }
        lines.join("\n")
    }

    fn shown(state: &State, input: &Input) -> String {
        match state.next(input) {
            next if next == *state && *input == Input::Resume => "the device is tried again".to_owned(),
            next => next.name().to_owned(),
        }
    }

    #[test]
    fn the_page_of_states_tells_every_answer() {
        let page = include_str!("../../../docs/states.md");
        assert!(page.contains(&table()), "docs/states.md must hold this table:\n\n{}\n", table());
        for state in states() {
            assert!(page.contains(&format!("**{}**", state.name())), "{} is not told", state.name());
        }
        for set in sets() {
            for reason in set {
                assert!(page.contains(&format!("`{}`", reason.name())), "{} is not told", reason.name());
            }
        }
    }
}
