//! Random commands while answers are disturbed at random: whatever the driver then says is true.

use super::Effort;
use super::trial::{MakeRig, Trial, Violation};
use crate::firmware::WireFault;
use crate::truth::rng::Key;
use goniod_drivers::conformance::Verdict;
use std::time::Duration;

/// Most undisturbed answers between two disturbed ones, beyond those that the rig asks for.
const LONGEST_GAP: u64 = 6;
/// Wrong answers that are told in words.
const TOLD: usize = 3;

/// What was counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Commands of the contract.
    pub commands: u64,
    /// Of them carried out or answered.
    pub done: u64,
    /// Requests that reached the device.
    pub exchanges: u64,
    /// Answers that were disturbed, or orders that were lost.
    pub disturbed: u64,
    /// Things said that were not true, or calls without end.
    pub wrong: u64,
}

/// Random numbers in a row.
struct Draw {
    key: Key,
    next: u64,
}

/// As many random commands as `effort` asks for.
pub async fn random(make: &MakeRig<'_>, effort: Effort) -> (Verdict, Counts) {
    let mut counts = Counts::default();
    let mut told = Vec::new();
    let mut draw = Draw { key: Key::new(effort.seed).named("conformance"), next: 0 };
    let mut trial = match Trial::ready(make).await {
        Ok(trial) => trial,
        Err(what) => return (Verdict::Failed(what), counts),
    };
    let begun = trial.rig.stand.line().requests();
    let answers = trial.rig.answers;
    while counts.commands < effort.commands || counts.exchanges < effort.exchanges {
        if answers && !trial.rig.stand.disturbed() {
            disturb(&trial, &mut draw);
            counts.disturbed += 1;
        }
        if !answers && draw.below(2) == 0 {
            // No answer to disturb: the order itself is lost.
            counts.disturbed += u64::from(trial.rig.stand.line().lose_request());
        }
        counts.commands += 1;
        match command(&mut trial, &mut draw).await {
            Ok(true) => counts.done += 1,
            Ok(false) => back(&mut trial, &mut draw, &mut told, &mut counts).await,
            Err(what) => {
                counts.wrong += 1;
                told.push(what);
            }
        }
        counts.exchanges = trial.rig.stand.line().requests() - begun;
    }
    if counts.wrong > 0 {
        told.truncate(TOLD);
        return (Verdict::Failed(format!("{} wrong in {}: {}", counts.wrong, counts, told.join("; "))), counts);
    }
    if counts.done * 10 < counts.commands {
        return (Verdict::Failed(format!("hardly anything is done under noise: {counts}")), counts);
    }
    (Verdict::Passed(counts.to_string()), counts)
}

/// One command; true when it was done.
async fn command(trial: &mut Trial, draw: &mut Draw) -> Result<bool, Violation> {
    match draw.below(20) {
        0..=9 => {
            let skip = draw.below(3);
            (0..skip).for_each(|_| drop(trial.another_order()));
            let order = trial.another_order();
            trial.order(&order).await.map(|failed| failed.is_none())
        }
        10..=16 => trial.ask().await.map(|failed| failed.is_none()),
        17..=18 => trial.health().await.map(|failed| failed.is_none()),
        _ => trial.open().await.map(|opened| opened.is_ok()),
    }
}

/// After an error, as the daemon does: opens again, and finds the reference where it is gone.
async fn back(trial: &mut Trial, draw: &mut Draw, told: &mut Vec<Violation>, counts: &mut Counts) {
    if draw.below(2) == 0 {
        return;
    }
    trial.rest(Duration::from_millis(draw.below(3000))).await;
    let course = async {
        trial.open().await?.ok();
        if matches!(trial.tell().await?, Ok(None)) {
            trial.rig.subject.reference().await.ok();
        }
        Ok::<(), Violation>(())
    };
    if let Err(what) = course.await {
        counts.wrong += 1;
        told.push(what);
    }
}

/// Some clean answers, then a disturbed one.
fn disturb(trial: &Trial, draw: &mut Draw) {
    for _ in 0..trial.rig.clean_answers + draw.below(LONGEST_GAP + 1) {
        trial.rig.stand.disturb(WireFault::Pass);
    }
    let fault = match draw.below(11) {
        0 => WireFault::Late(Duration::from_millis(draw.below(1200))),
        1 => WireFault::NoReply,
        2 => WireFault::Cut(draw.below(40) as usize),
        3..=5 => WireFault::Corrupt(draw.below(80) as usize, 1 + draw.below(255) as u8),
        6 => WireFault::Drop(draw.below(80) as usize),
        7 | 8 => WireFault::Junk((0..1 + draw.below(11)).map(|_| draw.below(256) as u8).collect()),
        9 => WireFault::Previous,
        _ => WireFault::Duplicate,
    };
    trial.rig.stand.disturb(fault);
}

// === impl Draw ===

impl Draw {
    fn below(&mut self, limit: u64) -> u64 {
        self.next += 1;
        self.key.bits(self.next) % limit.max(1)
    }
}

// === impl Counts ===

impl std::fmt::Display for Counts {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Counts { commands, done, exchanges, disturbed, wrong } = self;
        write!(f, "{commands} commands, {done} done, {exchanges} exchanges, {disturbed} disturbed, {wrong} wrong")
    }
}
