//! From a device's error to what is done about it: one pure function.

use crate::config::night::{AfterOutage, Recovery, seconds};
use crate::control::devices::bench::DeviceId;
use goniod_drivers::error::ErrorKind;
use std::collections::BTreeMap;
use std::time::Duration;

/// Views given up in a row for the same device, after which it is lost rather than unlucky.
pub const GIVEN_UP_BEFORE_LOST: u32 = 3;

/// Shortest wait before an attempt: no policy makes a loop without pause.
const SHORTEST_WAIT: Duration = Duration::from_millis(100);

/// How often an operator is asked again.
const OPERATOR_LOOK: Duration = Duration::from_secs(60);

/// What kind of part a device is: what helps one does not help another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Shutter.
    Shutter,
    /// Filter wheel.
    Wheel,
    /// Rotation axis.
    Axis,
    /// Camera.
    Camera,
}

/// When an error came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Before the first exposure.
    Start,
    /// While an exposure was prepared or taken.
    Exposure,
}

/// One error and what came before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Case {
    /// Kind of the error.
    pub kind: ErrorKind,
    /// Part that gave it.
    pub part: Part,
    /// When.
    pub phase: Phase,
    /// Failures of the device in this exposure, this one counted; at least 1.
    pub failures: u32,
    /// Time since the first failure that no success followed.
    pub outage: Duration,
    /// Views given up in a row for this device.
    pub given_up: u32,
}

/// What may be done about the errors of one device.
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// Attempts after the first failure in an exposure.
    pub attempts: u32,
    /// Waits before the attempts; the last holds for all further ones.
    pub backoff: Vec<Duration>,
    /// How long a lost device is waited for.
    pub longest_outage: Duration,
    /// What follows then.
    pub after_outage: AfterOutage,
}

/// The policies of all devices.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Policies {
    recovery: Recovery,
    single: BTreeMap<String, Policy>,
}

/// What is done about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// The same again after a wait; nothing is doubted.
    Retry(Duration),
    /// Where the device stands is unknown; it is asked, and the exposure is taken again.
    Resynchronise(Duration),
    /// What was commanded is not what is; the command is given again and the exposure taken again.
    Retake(Duration),
    /// The axis has lost its place: it finds its reference again.
    Rehome(Duration),
    /// The link is opened anew, identity proven, settings written and read back.
    Reopen(Duration),
    /// The bench is made safe and the run suspended; the device is opened anew after the wait.
    Suspend(Duration),
    /// The run stays suspended, and the device is tried again only when somebody asks.
    Hold,
    /// The view cannot be had: it is listed as missing, the night goes on.
    GiveUp,
    /// The run ends safely.
    End,
}

// === impl Decision ===

impl Decision {
    /// The wait before anything is done.
    pub fn wait(self) -> Duration {
        match self {
            Decision::Retry(after)
            | Decision::Resynchronise(after)
            | Decision::Retake(after)
            | Decision::Rehome(after)
            | Decision::Reopen(after)
            | Decision::Suspend(after) => after,
            Decision::Hold | Decision::GiveUp | Decision::End => Duration::ZERO,
        }
    }

    /// The decision in words, for journal and terminal.
    pub fn words(self) -> String {
        match self {
            Decision::Retry(after) => format!("tried again in {} s", after.as_secs_f64()),
            Decision::Resynchronise(after) => format!("asked where it stands in {} s", after.as_secs_f64()),
            Decision::Retake(after) => format!("commanded again in {} s", after.as_secs_f64()),
            Decision::Rehome(after) => format!("homed in {} s", after.as_secs_f64()),
            Decision::Reopen(after) => format!("opened anew in {} s", after.as_secs_f64()),
            Decision::Suspend(after) => format!("the run is suspended, opened anew in {} s", after.as_secs_f64()),
            Decision::Hold => "the run stays suspended until somebody resumes it".to_owned(),
            Decision::GiveUp => "given up for this view".to_owned(),
            Decision::End => "the run ends".to_owned(),
        }
    }
}

// === impl Policy ===

impl Policy {
    /// The wait before the `failures`-th attempt.
    fn wait(&self, failures: u32) -> Duration {
        let at = failures.saturating_sub(1) as usize;
        self.backoff.get(at).or(self.backoff.last()).copied().unwrap_or(SHORTEST_WAIT).max(SHORTEST_WAIT)
    }
}

// === impl Policies ===

impl Policies {
    /// The policies of an instrument file.
    pub fn of(recovery: &Recovery) -> Policies {
        let mut policies = Policies { recovery: recovery.clone(), single: BTreeMap::new() };
        for (name, own) in &recovery.device {
            let all = &recovery;
            let policy = Policy {
                attempts: own.attempts.unwrap_or(all.attempts),
                backoff: waits(own.backoff_s.as_ref().unwrap_or(&all.backoff_s)),
                longest_outage: seconds(own.longest_outage_s.unwrap_or(all.longest_outage_s)),
                after_outage: own.after_outage.or(all.after_outage).unwrap_or_else(|| usual(name)),
            };
            policies.single.insert(name.clone(), policy);
        }
        policies
    }

    /// The same with an operator for a changer, who is waited for so long: nobody there, and what needs them is missing.
    /// A policy of the file for the changer holds before this.
    pub fn with_operator(mut self, within: Duration) -> Policies {
        self.single.entry(DeviceId::Changer.to_string()).or_insert(Policy {
            attempts: 0,
            backoff: vec![OPERATOR_LOOK],
            longest_outage: within,
            after_outage: AfterOutage::GiveUp,
        });
        self
    }

    /// The policy of a device.
    pub fn of_device(&self, id: &DeviceId) -> Policy {
        let name = id.to_string();
        if let Some(own) = self.single.get(&name) {
            return own.clone();
        }
        let all = &self.recovery;
        Policy {
            attempts: all.attempts,
            backoff: waits(&all.backoff_s),
            longest_outage: seconds(all.longest_outage_s),
            after_outage: all.after_outage.unwrap_or_else(|| usual(&name)),
        }
    }
}

/// Names of the devices that every view needs.
const ESSENTIAL: [&str; 5] = ["shutter", "filter_wheel", "tilt", "spin", "changer"];

/// A camera has views that the others do without; anything else has not.
fn usual(name: &str) -> AfterOutage {
    if ESSENTIAL.contains(&name) { AfterOutage::End } else { AfterOutage::GiveUp }
}

fn waits(seconds_each: &[f64]) -> Vec<Duration> {
    seconds_each.iter().map(|s| seconds(*s)).collect()
}

// === impl Part ===

impl Part {
    /// What kind of part a device is.
    pub fn of(id: &DeviceId) -> Part {
        match id {
            DeviceId::Shutter => Part::Shutter,
            DeviceId::FilterWheel => Part::Wheel,
            DeviceId::Changer | DeviceId::Tilt | DeviceId::Spin => Part::Axis,
            DeviceId::Camera(_) => Part::Camera,
        }
    }
}

/// What to do about an error.
pub fn decide(case: &Case, policy: &Policy) -> Decision {
    let lost = case.given_up >= GIVEN_UP_BEFORE_LOST;
    match case.kind {
        // Going on could mislabel frames.
        ErrorKind::Refused | ErrorKind::WrongDevice => Decision::End,
        _ if case.failures <= policy.attempts && !lost => first_aid(case, policy.wait(case.failures)),
        _ if case.phase == Phase::Start => Decision::End,
        // A camera's views are done without; anything else is waited for first.
        _ if policy.after_outage == AfterOutage::GiveUp
            && (case.part == Part::Camera || case.outage >= policy.longest_outage) =>
        {
            Decision::GiveUp
        }
        // It answers, so it is this view that cannot be had; unless no view could be had for a while.
        ErrorKind::Busy | ErrorKind::Broken if !lost => Decision::GiveUp,
        _ if case.outage < policy.longest_outage => Decision::Suspend(policy.wait(u32::MAX)),
        _ if policy.after_outage == AfterOutage::Suspend => Decision::Hold,
        _ => Decision::End,
    }
}

/// The gentlest thing that may help, harder from the second failure on.
fn first_aid(case: &Case, wait: Duration) -> Decision {
    let first = case.failures <= 1;
    match (case.kind, case.part) {
        (ErrorKind::Busy, _) => Decision::Retry(wait),
        // Opened devices only can be asked; a camera's stream is only sound when it is begun anew.
        _ if case.phase == Phase::Start => Decision::Reopen(wait),
        (_, Part::Camera) | (ErrorKind::Lost, _) => Decision::Reopen(wait),
        (ErrorKind::Timeout | ErrorKind::Garbled, _) if first => Decision::Resynchronise(wait),
        (ErrorKind::Broken, Part::Axis) if first => Decision::Rehome(wait),
        (ErrorKind::Broken, _) if first => Decision::Retake(wait),
        _ => Decision::Reopen(wait),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use ErrorKind::{Broken, Busy, Garbled, Lost, Refused, Timeout, WrongDevice};

    const KINDS: [ErrorKind; 7] = [Busy, Timeout, Garbled, Refused, Lost, WrongDevice, Broken];
    const PARTS: [Part; 4] = [Part::Shutter, Part::Wheel, Part::Axis, Part::Camera];
    const S: Duration = Duration::from_secs(1);

    fn policy(attempts: u32, after_outage: AfterOutage) -> Policy {
        Policy { attempts, backoff: vec![S, 5 * S, 20 * S], longest_outage: 1800 * S, after_outage }
    }

    fn case(kind: ErrorKind, part: Part, failures: u32) -> Case {
        Case { kind, part, phase: Phase::Exposure, failures, outage: Duration::ZERO, given_up: 0 }
    }

    #[test]
    fn each_kind_of_error_gets_its_own_aid_and_a_harder_one_the_second_time() {
        use Decision::{End, Rehome, Reopen, Resynchronise, Retake, Retry};
        let table = [
            (Busy, Part::Axis, Retry(S), Retry(5 * S)),
            (Timeout, Part::Shutter, Resynchronise(S), Reopen(5 * S)),
            (Garbled, Part::Wheel, Resynchronise(S), Reopen(5 * S)),
            (Timeout, Part::Camera, Reopen(S), Reopen(5 * S)),
            (Lost, Part::Axis, Reopen(S), Reopen(5 * S)),
            (Lost, Part::Camera, Reopen(S), Reopen(5 * S)),
            (Broken, Part::Axis, Rehome(S), Reopen(5 * S)),
            (Broken, Part::Wheel, Retake(S), Reopen(5 * S)),
            (Broken, Part::Shutter, Retake(S), Reopen(5 * S)),
            (Broken, Part::Camera, Reopen(S), Reopen(5 * S)),
            (Refused, Part::Axis, End, End),
            (WrongDevice, Part::Camera, End, End),
        ];
        for (kind, part, first, second) in table {
            let policy = policy(3, AfterOutage::End);
            assert_eq!(decide(&case(kind, part, 1), &policy), first, "{kind:?} {part:?}");
            assert_eq!(decide(&case(kind, part, 2), &policy), second, "{kind:?} {part:?}");
        }
    }

    #[test]
    fn what_follows_the_attempts_depends_on_whether_the_device_answers_and_on_its_policy() {
        use AfterOutage::{End, GiveUp, Suspend};
        let beyond = |kind| Case { outage: 1800 * S, ..case(kind, Part::Axis, 4) };
        for kind in [Busy, Broken] {
            assert_eq!(decide(&case(kind, Part::Axis, 4), &policy(3, End)), Decision::GiveUp);
            let again = Case { given_up: GIVEN_UP_BEFORE_LOST, ..case(kind, Part::Axis, 1) };
            assert_eq!(decide(&again, &policy(3, End)), Decision::Suspend(20 * S), "no view could be had");
        }
        for kind in [Timeout, Garbled, Lost] {
            assert_eq!(decide(&case(kind, Part::Axis, 4), &policy(3, End)), Decision::Suspend(20 * S));
            assert_eq!(decide(&beyond(kind), &policy(3, End)), Decision::End);
            assert_eq!(decide(&beyond(kind), &policy(3, Suspend)), Decision::Hold);
            assert_eq!(decide(&case(kind, Part::Camera, 4), &policy(3, GiveUp)), Decision::GiveUp);
            let start = Case { phase: Phase::Start, ..case(kind, Part::Axis, 4) };
            assert_eq!(decide(&start, &policy(3, End)), Decision::End);
        }
    }

    /// A device that never works again, whatever it answers and whatever the policy: the number of attempts is bounded.
    #[test]
    fn nothing_is_tried_for_ever() {
        for kinds in KINDS.iter().flat_map(|a| KINDS.iter().map(move |b| [*a, *b])) {
            for part in PARTS {
                for attempts in [0, 1, 3, 10] {
                    for after in [AfterOutage::Suspend, AfterOutage::End, AfterOutage::GiveUp] {
                        for backoff in [vec![], vec![Duration::ZERO], vec![S, 5 * S, 20 * S]] {
                            let policy = Policy { backoff, longest_outage: 60 * S, ..policy(attempts, after) };
                            let tries = tries_until_over(kinds, part, &policy);
                            let most = attempts.max(1) * (GIVEN_UP_BEFORE_LOST + 1) + 700;
                            assert!(tries <= most, "{kinds:?} {part:?} {policy:?}: {tries}");
                        }
                    }
                }
            }
        }
    }

    /// Views are given up until the device counts as lost; then it is the outage that ends it.
    fn tries_until_over(kinds: [ErrorKind; 2], part: Part, policy: &Policy) -> u32 {
        let (mut outage, mut given_up, mut failures, mut tries) = (Duration::ZERO, 0, 0, 0);
        loop {
            (failures, tries) = (failures + 1, tries + 1);
            let kind = kinds[tries as usize % 2];
            let case = Case { kind, part, phase: Phase::Exposure, failures, outage, given_up };
            match decide(&case, policy) {
                Decision::Retry(wait)
                | Decision::Resynchronise(wait)
                | Decision::Retake(wait)
                | Decision::Rehome(wait)
                | Decision::Reopen(wait)
                | Decision::Suspend(wait) => {
                    assert!(!wait.is_zero(), "no loop without pause");
                    outage += wait;
                }
                // A camera given up costs one try a view: bounded by the plan.
                Decision::GiveUp if given_up > GIVEN_UP_BEFORE_LOST => return tries,
                Decision::GiveUp => (failures, given_up) = (0, given_up + 1),
                Decision::Hold | Decision::End => return tries,
            }
        }
    }

    #[test]
    fn the_instrument_file_rules_each_device_and_cameras_may_be_done_without() {
        let text = "attempts = 2\nbackoff_s = [0.5]\n[device.tilt]\nattempts = 9\nafter_outage = \"suspend\"\n";
        let policies = Policies::of(&toml::from_str(text).unwrap());
        assert_eq!(policies.of_device(&DeviceId::Tilt).attempts, 9);
        assert_eq!(policies.of_device(&DeviceId::Tilt).after_outage, AfterOutage::Suspend);
        assert_eq!(policies.of_device(&DeviceId::Spin).attempts, 2);
        assert_eq!(policies.of_device(&DeviceId::Spin).after_outage, AfterOutage::End);
        assert_eq!(policies.of_device(&DeviceId::Camera("ccd".into())).after_outage, AfterOutage::GiveUp);
    }
}
