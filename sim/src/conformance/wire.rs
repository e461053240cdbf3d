//! One disturbed answer, of each sort, at each request of a command and of an opening.

use super::trial::{MakeRig, Trial, Violation, same};
use super::{CUT, DOUBLED, GARBLED, LATE, LOST, PREVIOUS};
use crate::firmware::WireFault;
use goniod_drivers::conformance::{Check, Verdict};
use std::time::Duration;

/// Requests of a command, and of an opening, whose answers are disturbed.
const REQUESTS: usize = 10;
/// Openings after which a device whose fault is over must be open.
const OPENINGS: u32 = 3;

/// The checks of this file with their disturbances.
pub fn all() -> [(Check, Vec<WireFault>); 6] {
    let late = [40, 300, 1500, 6000].map(|ms| WireFault::Late(Duration::from_millis(ms)));
    let cut = [0, 1, 2, 4, 9, 20].map(WireFault::Cut);
    let masks = [(0, 0x01), (1, 0x04), (2, 0x01), (3, 0x10), (4, 0x08), (5, 0x02), (8, 0x01), (12, 0x20)];
    let garbled = masks.map(|(place, mask)| WireFault::Corrupt(place, mask));
    let missing = [0, 1, 3, 6].map(WireFault::Drop);
    [
        (LATE, late.into()),
        (LOST, vec![WireFault::NoReply]),
        (CUT, cut.into()),
        (GARBLED, garbled.into_iter().chain(missing).collect()),
        (DOUBLED, vec![WireFault::Duplicate]),
        (PREVIOUS, vec![WireFault::Previous]),
    ]
}

/// Each fault at each of the first answers of an order, then of an opening.
pub async fn disturbed(make: &MakeRig<'_>, faults: &[WireFault]) -> Verdict {
    match Trial::new(make) {
        Ok(trial) if !trial.rig.answers => Verdict::NotApplicable("it never answers".into()),
        _ => Verdict::of(course(make, faults).await),
    }
}

async fn course(make: &MakeRig<'_>, faults: &[WireFault]) -> Result<String, Violation> {
    let (mut tried, mut honest) = (0, 0);
    let mut trial = Trial::ready(make).await?;
    for fault in faults {
        for before in 0..REQUESTS {
            let place = |what: Violation| format!("{fault:?} at answer {before}: {what}");
            place_fault(&trial, fault, before);
            let order = trial.another_order();
            tried += 1;
            if trial.order(&order).await.map_err(place)?.is_some() {
                honest += 1;
                trial.recover().await.map_err(place)?;
            }
            if trial.ask().await.map_err(place)?.is_some() {
                trial.recover().await.map_err(place)?;
            }
        }
    }
    let mut trial = Trial::ready(make).await?;
    let ours = trial.open().await?.map_err(|e| format!("it is not opened: {e}"))?;
    for fault in faults {
        for before in 0..REQUESTS {
            let place = |what: Violation| format!("{fault:?} at answer {before} of an opening: {what}");
            place_fault(&trial, fault, before);
            tried += 1;
            let mut opened = trial.open().await.map_err(place)?;
            honest += u32::from(opened.is_err());
            for _ in 0..OPENINGS {
                if opened.is_err() {
                    opened = trial.open().await.map_err(place)?;
                }
            }
            match opened {
                Ok(identity) if same(&ours, &identity) => {}
                Ok(identity) => return Err(place(format!("it is taken for {identity:?}"))),
                Err(error) => return Err(place(format!("it is not opened any more: {error}"))),
            }
        }
        trial.recover().await.map_err(|what| format!("{fault:?} at an opening: {what}"))?;
    }
    Ok(format!("{tried} tried, {honest} told as errors, the others survived"))
}

fn place_fault(trial: &Trial, fault: &WireFault, before: usize) {
    for _ in 0..before {
        trial.rig.stand.disturb(WireFault::Pass);
    }
    trial.rig.stand.disturb(fault.clone());
}
