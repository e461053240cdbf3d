//! The device falls silent, restarts, is pulled out; junk comes when it is opened.

use super::trial::{Honest, MakeRig, Trial, Violation, same};
use crate::firmware::WireFault;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{PATIENCE, Value, Verdict};
use goniod_drivers::error::ErrorKind;
use std::time::Duration;
use tokio::time::Instant;

/// Bytes (packets on USB) after which the device falls silent.
const SILENT_AFTER: [usize; 12] = [0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144];
/// Requests at which the power fails, from an order's first, and instants after its beginning.
const RESTART_AT: u64 = 10;
const RESTART_AFTER_MS: [u64; 6] = [1, 30, 120, 300, 700, 1500];
/// Longest settling of a rig's device, with one question.
const SETTLING: Duration = Duration::from_millis(300);
/// Instants after an order's beginning at which the adapter is pulled out.
const UNPLUG_AFTER_MS: [u64; 6] = [0, 3, 20, 60, 250, 900];
/// Openings that junk or a move under way may cost.
const OPENINGS: u32 = 3;
/// Rest of a device that nobody can tell to stop.
const STILL_MOVING: Duration = Duration::from_secs(8);
/// Time for a loss to reach the driver's end of the line.
const NOTICED: Duration = Duration::from_millis(10);
/// What may wait on a line that is opened.
const JUNK: [&[u8]; 7] = [
    b"\0",
    b"\xff\x00\xfe",
    b"> ",
    b"ER=4\r",
    b"@01 0 OK IDLE -- 0\r\n",
    b"\x18\x1b\x18",
    b"1.234E-05\n0\r\n17, 4, half a line",
];

/// Every call of a device that is silent after so many bytes.
pub async fn silence(make: &MakeRig<'_>) -> Verdict {
    match Trial::new(make) {
        Ok(trial) if !trial.rig.answers => Verdict::NotApplicable("it never answers".into()),
        _ => Verdict::of(silent(make).await),
    }
}

async fn silent(make: &MakeRig<'_>) -> Result<String, Violation> {
    let clock = Clock::system();
    let mut longest = Duration::ZERO;
    let mut calls = 0;
    let mut trial = Trial::ready(make).await?;
    let moves = trial.rig.subject.moves();
    for left in SILENT_AFTER {
        for call in 0..5 {
            let place = |what: Violation| format!("silent after {left}: {what}");
            let order = trial.another_order();
            trial.rig.stand.line().silence_after(Some(left));
            let begun = clock.now();
            let (what, failed) = match call {
                0 => ("an order", trial.order(&order).await.map_err(place)?.is_some()),
                1 => ("a question", trial.ask().await.map_err(place)?.is_some()),
                2 => ("its health", trial.health().await.map_err(place)?.is_some()),
                3 => ("an opening", trial.open().await.map_err(place)?.is_err()),
                // What has nothing to make safe need not ask.
                _ => ("the safe state", trial.make_safe().await.map_err(place)?.is_some() || !moves),
            };
            if left == 0 && !failed {
                return Err(format!("{what} was answered well by a device that says nothing"));
            }
            longest = longest.max(clock.now() - begun);
            calls += 1;
            trial.rig.stand.line().silence_after(None);
            trial.recover().await.map_err(|e| format!("silent after {left} in {what}: {e}"))?;
        }
    }
    Ok(format!("{calls} calls, the longest {:.0} s", longest.as_secs_f64()))
}

/// Junk when the port is opened, and before each of the first answers.
pub async fn junk(make: &MakeRig<'_>) -> Result<String, Violation> {
    let mut calm = Trial::new(make)?;
    let ours = calm.open().await?.map_err(|e| format!("it is not opened: {e}"))?;
    let answers = calm.rig.answers;
    let mut tried = 0;
    for bytes in JUNK {
        for before in 0..if answers { 6 } else { 1 } {
            let place = |what: Violation| format!("{bytes:02x?}, place {before}: {what}");
            let mut trial = Trial::new(make)?;
            match before {
                0 => trial.rig.stand.line().junk(bytes),
                n => {
                    for _ in 1..n {
                        trial.rig.stand.disturb(WireFault::Pass);
                    }
                    trial.rig.stand.disturb(WireFault::Junk(bytes.to_vec()));
                }
            }
            tried += 1;
            let mut opened = trial.open().await.map_err(place)?;
            for _ in 1..OPENINGS {
                if opened.is_err() {
                    opened = trial.open().await.map_err(place)?;
                }
            }
            match opened {
                Ok(identity) if same(&ours, &identity) => trial.recover().await.map_err(place)?,
                Ok(identity) => return Err(place(format!("it is taken for {identity:?}"))),
                Err(error) => return Err(place(format!("it is not opened: {error}"))),
            }
        }
    }
    Ok(format!("{tried} openings"))
}

/// The power fails at each request of an order, and at instants after its beginning.
pub async fn restart(make: &MakeRig<'_>) -> Verdict {
    match Trial::new(make) {
        Ok(trial) if !trial.rig.answers => {
            Verdict::NotApplicable("no feedback: it says what was sent; the pictures prove the light".into())
        }
        _ => Verdict::of(restarts(make).await),
    }
}

async fn restarts(make: &MakeRig<'_>) -> Result<String, Violation> {
    let (mut tried, mut honest) = (0, 0);
    for case in 0..RESTART_AT + RESTART_AFTER_MS.len() as u64 {
        let mut trial = Trial::ready(make).await?;
        let order = trial.another_order();
        let (ended, when) = match case.checked_sub(RESTART_AT).and_then(|i| RESTART_AFTER_MS.get(i as usize)) {
            None => {
                trial.rig.stand.line().restart_at(Some(case));
                (trial.order(&order).await, format!("at request {case}"))
            }
            Some(&ms) => (interrupted(&mut trial, &order, ms).await, format!("after {ms} ms")),
        };
        trial.rig.stand.line().restart_at(None);
        let place = |what: Violation| format!("power failed {when}: {what}");
        tried += 1;
        honest += u32::from(ended.map_err(place)?.is_some());
        trial.ask().await.map_err(place)?;
        let next = trial.another_order();
        trial.order(&next).await.map_err(place)?;
        trial.ask().await.map_err(place)?;
        trial.recover().await.map_err(place)?;
    }
    Ok(format!("{tried} restarts, {honest} told as errors"))
}

/// An order in which the power fails after so many milliseconds. One that was fulfilled before is not judged by what is
/// true since: it was proven, and the driver only waits for the bench to settle.
async fn interrupted(trial: &mut Trial, order: &Value, ms: u64) -> Honest {
    let stand = &trial.rig.stand;
    let begun = Instant::now();
    let fails = begun + Duration::from_millis(ms);
    let power = async {
        Clock::system().sleep_until(fails).await;
        let fulfilled = stand.judge(order, fails).is_ok();
        stand.restart();
        fulfilled
    };
    let subject = &mut trial.rig.subject;
    let work = async { (Clock::system().timeout(PATIENCE, subject.carry_out(order)).await, Instant::now()) };
    let ((ended, at), fulfilled) = tokio::join!(work, power);
    match ended {
        Err(_) => Err(format!("the order {order} did not end within {} s", PATIENCE.as_secs())),
        Ok(ended) if at < fails || (fulfilled && at < fails + SETTLING) => Ok(ended.err()),
        Ok(ended) => trial.judge_order(order, ended),
    }
}

/// Pulled out at instants of an order, put back under another name.
pub async fn unplug(make: &MakeRig<'_>) -> Result<String, Violation> {
    for ms in UNPLUG_AFTER_MS {
        let place = |what: Violation| format!("pulled out after {ms} ms: {what}");
        let mut trial = Trial::new(make)?;
        let ours = trial.open().await?.map_err(|e| format!("it is not opened: {e}"))?;
        trial.recover().await?;
        let order = trial.another_order();
        let stand = &trial.rig.stand;
        let begun = Instant::now();
        let hand = async {
            Clock::system().sleep_until(begun + Duration::from_millis(ms)).await;
            stand.unplug();
        };
        let (ended, ()) = tokio::join!(trial.rig.subject.carry_out(&order), hand);
        if ended.is_ok() && ms == 0 {
            return Err(place("the order was carried out without a link".into()));
        }
        trial.rest(NOTICED).await;
        if trial.health().await.map_err(place)?.is_none() {
            return Err(place("it is well without a link".into()));
        }
        match trial.open().await.map_err(place)? {
            Err(error) if error.kind == ErrorKind::Lost => {}
            Err(error) => return Err(place(format!("its loss is told as {:?}: {error}", error.kind))),
            Ok(identity) => return Err(place(format!("{identity:?} was opened without a link"))),
        }
        trial.rig.stand.plug_elsewhere();
        let mut again = trial.open().await.map_err(place)?;
        for _ in 1..OPENINGS {
            if again.is_err() {
                // It may still be on its way where the order sent it.
                trial.rest(STILL_MOVING).await;
                again = trial.open().await.map_err(place)?;
            }
        }
        let again = again.map_err(|e| place(format!("it is not found again: {e}")))?;
        if !same(&ours, &again) {
            return Err(place(format!("it is taken for {again:?}")));
        }
        trial.recover().await.map_err(place)?;
    }
    Ok(format!("{} times, found again under another name", UNPLUG_AFTER_MS.len()))
}
