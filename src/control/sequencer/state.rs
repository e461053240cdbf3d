//! The states of a run and the total function from state and input to the next state. Pure.

use serde::{Deserialize, Serialize};

/// Why a run came to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Ending {
    /// Every exposure was done: stored, or listed as missing.
    Completed,
    /// Asked to stop: the exposure under way was finished.
    Stopped,
    /// Asked to abort: the exposure under way was given up.
    Aborted,
    /// No space is left on the run's disk.
    DiskFull,
    /// The run's disk or journal fails.
    ArchiveFailed,
    /// A device refused a command, or is another one than configured: going on could mislabel frames.
    DeviceRefused,
    /// A device could not be had at the start.
    NotReady,
}

/// What the sequencer is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Nothing asked yet.
    Idle,
    /// Devices are opened and their identities proven; axes find their references.
    Checking,
    /// Exposures are taken.
    Running,
    /// A pause was asked for; the exposure under way is finished.
    Pausing,
    /// The shutter is closed; everything waits for resume, stop or abort.
    Paused,
    /// The bench is brought into its safe state, for this reason.
    MakingSafe(Ending),
    /// The bench is safe, and each device proved it.
    Ended(Ending),
    /// The run is over, and at least one device did not prove that it is safe: somebody must look.
    Faulted(Ending),
}

/// What may happen to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Input {
    /// Begin.
    Start,
    /// All devices are ready.
    Ready,
    /// A pause is asked for.
    Pause,
    /// The exposure under way is finished, the shutter closed.
    Rested,
    /// Going on is asked for.
    Resume,
    /// The run must end, for this reason.
    End(Ending),
    /// The safe state was tried; `true` when every device proved it.
    Safe(bool),
}

// === impl State ===

impl State {
    /// The next state. Every pair has one: an input without meaning leaves the state as it is, and an end once
    /// decided keeps its first reason.
    pub fn next(self, input: Input) -> State {
        use State::{Checking, Ended, Faulted, Idle, MakingSafe, Paused, Pausing, Running};
        match (self, input) {
            (Idle, Input::Start) => Checking,
            (Checking, Input::Ready) => Running,
            (Running, Input::Pause) => Pausing,
            (Pausing, Input::Rested) => Paused,
            (Pausing | Paused, Input::Resume) => Running,
            (Idle | Checking | Running | Pausing | Paused, Input::End(why)) => MakingSafe(why),
            (MakingSafe(why), Input::Safe(true)) => Ended(why),
            (MakingSafe(why), Input::Safe(false)) => Faulted(why),
            (
                Idle | Checking | Running | Pausing | Paused | MakingSafe(_) | Ended(_) | Faulted(_),
                Input::Start
                | Input::Ready
                | Input::Pause
                | Input::Rested
                | Input::Resume
                | Input::End(_)
                | Input::Safe(_),
            ) => self,
        }
    }

    /// True when nothing follows.
    pub fn is_final(self) -> bool {
        matches!(self, State::Ended(_) | State::Faulted(_))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ENDINGS: [Ending; 7] = [
        Ending::Completed,
        Ending::Stopped,
        Ending::Aborted,
        Ending::DiskFull,
        Ending::ArchiveFailed,
        Ending::DeviceRefused,
        Ending::NotReady,
    ];

    fn states() -> Vec<State> {
        let mut all = vec![State::Idle, State::Checking, State::Running, State::Pausing, State::Paused];
        all.extend(ENDINGS.map(State::MakingSafe));
        all.extend(ENDINGS.map(State::Ended));
        all.extend(ENDINGS.map(State::Faulted));
        all
    }

    fn inputs() -> Vec<Input> {
        let mut all = vec![Input::Start, Input::Ready, Input::Pause, Input::Rested, Input::Resume];
        all.extend([Input::Safe(true), Input::Safe(false)]);
        all.extend(ENDINGS.map(Input::End));
        all
    }

    /// Every pair of state and input, against rules written down independently of the function.
    #[test]
    fn every_pair_of_state_and_input_keeps_the_rules() {
        let mut changed = 0;
        for state in states() {
            for input in inputs() {
                let next = state.next(input);
                changed += usize::from(next != state);
                let active = !state.is_final() && !matches!(state, State::MakingSafe(_));
                if state.is_final() {
                    assert_eq!(next, state, "{state:?} {input:?}: an end is an end");
                }
                if next.is_final() && next != state {
                    assert!(matches!(state, State::MakingSafe(_)), "{state:?} {input:?}: only through the safe state");
                    assert!(matches!(input, Input::Safe(_)));
                }
                if let Input::End(why) = input
                    && active
                {
                    assert_eq!(next, State::MakingSafe(why), "every active state can be ended");
                }
                if let (State::MakingSafe(a), State::MakingSafe(b) | State::Ended(b) | State::Faulted(b)) =
                    (state, next)
                {
                    assert_eq!(a, b, "the first reason stays");
                }
                if next == State::Running && state != State::Running {
                    assert!(matches!(state, State::Checking | State::Pausing | State::Paused));
                }
            }
        }
        // Idle-start, checking-ready, running-pause, pausing-rested, two resumes, 5 x 7 ends, 7 x 2 safe results.
        assert_eq!(changed, 6 + 5 * 7 + 7 * 2);
    }
}
