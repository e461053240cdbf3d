//! The states of a run and the total function from state and input to the next state. Pure.

use super::interlocks::Reason;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

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
    /// Asked to be safe at once, whatever was under way.
    MadeSafe,
    /// No space is left on the run's disk.
    DiskFull,
    /// The run's disk or journal fails.
    ArchiveFailed,
    /// A device refused a command, or is another one than configured: going on could mislabel frames.
    DeviceRefused,
    /// A device could not be had at the start.
    NotReady,
    /// A device stayed lost beyond its longest outage.
    DeviceLost,
    /// An interlock gave the alarm.
    Alarm,
    /// A reason to suspend did not go away in the longest time allowed.
    SuspendedTooLong,
    /// The program itself failed while it carried the plan out.
    Crashed,
}

/// What the sequencer is doing.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Nothing asked yet.
    Idle,
    /// Devices are opened and their identities proven; axes find their references.
    Checking,
    /// Exposures are taken.
    Running,
    /// A pause was asked for; the exposure under way is finished or given up.
    Pausing,
    /// The shutter is closed; everything waits for resume, stop or abort.
    Paused,
    /// The shutter is closed, exposures wait until every one of these reasons is gone; then they go on by themselves.
    Suspended(BTreeSet<Reason>),
    /// A device gave an error; it is waited for, asked, opened anew or homed, and the exposure is taken again.
    Recovering,
    /// The bench is brought into its safe state, for this reason.
    MakingSafe(Ending),
    /// The run is over, the bench is safe, and each device proved it.
    Safe(Ending),
    /// The run is over, and at least one device did not prove that it is safe: somebody must look.
    Faulted(Ending),
}

/// What may happen to a run.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Input {
    /// Begin.
    Start,
    /// All devices are ready.
    Ready,
    /// A pause is asked for.
    Pause,
    /// The exposure under way is finished or given up, the shutter closed.
    Rested,
    /// Going on is asked for.
    Resume,
    /// A device gave an error that is to be recovered from.
    Fault,
    /// The device works again.
    Recovered,
    /// These reasons forbid to go on now; none = nothing does any more.
    Hold(BTreeSet<Reason>),
    /// The run must end, for this reason.
    End(Ending),
    /// The safe state was tried; `true` when every device proved it.
    Safe(bool),
}

// === impl State ===

impl State {
    /// The next state. Every pair has one: an input without meaning leaves the state as it is, and an end once
    /// decided keeps its first reason.
    pub fn next(&self, input: &Input) -> State {
        use State::{Checking, Faulted, Idle, MakingSafe, Paused, Pausing, Recovering, Running, Safe, Suspended};
        match (self, input) {
            (Idle, Input::Start) => Checking,
            (Checking, Input::Ready) => Running,
            (Running | Recovering, Input::Pause) => Pausing,
            (Suspended(_), Input::Pause) => Paused,
            (Pausing, Input::Rested) => Paused,
            (Pausing | Paused, Input::Resume) => Running,
            (Running, Input::Fault) => Recovering,
            (Recovering, Input::Recovered) => Running,
            (Suspended(_), Input::Hold(reasons)) if reasons.is_empty() => Running,
            (Running | Recovering | Suspended(_), Input::Hold(reasons)) if !reasons.is_empty() => {
                Suspended(reasons.clone())
            }
            (Idle | Checking | Running | Pausing | Paused | Suspended(_) | Recovering, Input::End(why)) => {
                MakingSafe(*why)
            }
            (MakingSafe(why), Input::Safe(true)) => Safe(*why),
            (MakingSafe(why), Input::Safe(false)) => Faulted(*why),
            (
                Idle | Checking | Running | Pausing | Paused | Suspended(_) | Recovering | MakingSafe(_) | Safe(_)
                | Faulted(_),
                Input::Start
                | Input::Ready
                | Input::Pause
                | Input::Rested
                | Input::Resume
                | Input::Fault
                | Input::Recovered
                | Input::Hold(_)
                | Input::End(_)
                | Input::Safe(_),
            ) => self.clone(),
        }
    }

    /// True when nothing follows.
    pub fn is_final(&self) -> bool {
        matches!(self, State::Safe(_) | State::Faulted(_))
    }

    /// The state's name without what it carries.
    pub fn name(&self) -> &'static str {
        match self {
            State::Idle => "idle",
            State::Checking => "checking",
            State::Running => "running",
            State::Pausing => "pausing",
            State::Paused => "paused",
            State::Suspended(_) => "suspended",
            State::Recovering => "recovering",
            State::MakingSafe(_) => "making safe",
            State::Safe(_) => "safe",
            State::Faulted(_) => "faulted",
        }
    }
}

#[cfg(test)]
pub(super) mod samples {
    //! Every state and every input, the sets by some of their members.
    use super::*;

    pub const ENDINGS: [Ending; 12] = [
        Ending::Completed,
        Ending::Stopped,
        Ending::Aborted,
        Ending::MadeSafe,
        Ending::DiskFull,
        Ending::ArchiveFailed,
        Ending::DeviceRefused,
        Ending::NotReady,
        Ending::DeviceLost,
        Ending::Alarm,
        Ending::SuspendedTooLong,
        Ending::Crashed,
    ];

    pub fn sets() -> Vec<BTreeSet<Reason>> {
        let mut sets: Vec<BTreeSet<Reason>> = Reason::ALL.iter().map(|r| [*r].into()).collect();
        sets.push([Reason::Disk, Reason::LampUnsteady].into());
        sets.push([Reason::Disk, Reason::DeviceLost].into());
        sets.push(Reason::ALL.into());
        sets
    }

    pub fn states() -> Vec<State> {
        use State::{Checking, Idle, Paused, Pausing, Recovering, Running};
        let mut all = vec![Idle, Checking, Running, Pausing, Paused, Recovering];
        all.extend(sets().into_iter().map(State::Suspended));
        all.extend(ENDINGS.map(State::MakingSafe));
        all.extend(ENDINGS.map(State::Safe));
        all.extend(ENDINGS.map(State::Faulted));
        all
    }

    pub fn inputs() -> Vec<Input> {
        let mut all = vec![Input::Start, Input::Ready, Input::Pause, Input::Rested, Input::Resume];
        all.extend([Input::Fault, Input::Recovered, Input::Safe(true), Input::Safe(false)]);
        all.push(Input::Hold(BTreeSet::new()));
        all.extend(sets().into_iter().map(Input::Hold));
        all.extend(ENDINGS.map(Input::End));
        all
    }
}

#[cfg(test)]
mod tests {
    use super::samples::{inputs, states};
    use super::*;

    /// Every pair of state and input, against rules written down independently of the function.
    #[test]
    fn every_pair_of_state_and_input_keeps_the_rules() {
        let mut changed = 0;
        for state in states() {
            for input in inputs() {
                let next = state.next(&input);
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
                if let (State::MakingSafe(a), State::MakingSafe(b) | State::Safe(b) | State::Faulted(b)) =
                    (&state, &next)
                {
                    assert_eq!(a, b, "the first reason stays");
                }
                if let State::Suspended(reasons) = &next {
                    assert!(!reasons.is_empty(), "{state:?} {input:?}: suspended for nothing");
                }
                if next == State::Running && state != State::Running {
                    let lit = matches!(input, Input::Ready | Input::Resume | Input::Recovered | Input::Hold(_));
                    assert!(lit, "{state:?} {input:?}: nothing else begins exposures");
                }
            }
        }
        let (sets, endings) = (super::samples::sets().len(), super::samples::ENDINGS.len());
        // Idle-start, checking-ready, two pauses, pausing-rested, two resumes, fault, recovered; each suspended state
        // paused, cleared, or with other reasons; holds from running and recovering; ends; safe results.
        let suspended = sets * (1 + 1 + (sets - 1)) + 2 * sets;
        assert_eq!(changed, 9 + suspended + (6 + sets) * endings + endings * 2);
    }
}
