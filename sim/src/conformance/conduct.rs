//! How a driver conducts itself without any fault on the wire: towards other devices, before it is opened, after power-up,
//! and in the middle of a command.

use super::rig::{Unit, stand, subject};
use super::stand::Plug;
use super::trial::{MakeRig, Trial, Violation};
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{PATIENCE, Subject, Verdict};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table::{DRIVERS, Driver, Make};
use std::time::Duration;

/// When a command is given up and the next one sent.
const GIVEN_UP_MS: [u64; 8] = [1, 3, 10, 30, 90, 200, 500, 1200];

/// Another unit of the same model, and every other device of the table, on the driver's port.
pub async fn another_device(driver: &'static Driver, make: &MakeRig<'_>) -> Verdict {
    match Trial::new(make) {
        Ok(trial) if !trial.rig.answers => {
            return Verdict::NotApplicable(
                "it never answers: only a device that does is told apart, and one that is silent too is not".into(),
            );
        }
        _ => {}
    }
    Verdict::of(refuses_others(driver, make).await)
}

async fn refuses_others(driver: &'static Driver, make: &MakeRig<'_>) -> Result<String, Violation> {
    let unit = match make(Unit::Another) {
        None => "another unit cannot be told apart (no serial number)",
        Some(mut rig) => {
            let opened = Clock::system().timeout(PATIENCE, rig.subject.device().open()).await;
            match opened {
                Ok(Err(error)) if error.kind == ErrorKind::WrongDevice => {}
                Ok(Err(error)) => return Err(format!("another unit is told as {:?}: {error}", error.kind)),
                Ok(Ok(identity)) => return Err(format!("another unit is taken for ours: {identity:?}")),
                Err(_) => return Err("opening another unit did not end".into()),
            }
            if let Some(order) = rig.subject.orders().first()
                && rig.subject.carry_out(order).await.is_ok()
            {
                return Err(format!("another unit carried {order} out"));
            }
            "another unit refused"
        }
    };
    let mut others = 0;
    for other in DRIVERS.iter().filter(|other| other.devices != driver.devices && !same_device(other, driver)) {
        let clock = Clock::system();
        let Ok(Some(stand)) = stand(other, Unit::Ours) else { continue };
        let plug = stand.plug(clock);
        if matches!(plug, Plug::Usb(_)) != matches!(driver.make, Make::UsbLightMonitor(_) | Make::Spectrometer(_)) {
            continue;
        }
        let Ok(mut subject) = subject(driver, plug, clock) else { continue };
        others += 1;
        match clock.timeout(PATIENCE, subject.device().open()).await {
            Ok(Err(_)) => {}
            Ok(Ok(identity)) => return Err(format!("a device of {} is taken for {identity:?}", other.name)),
            Err(_) => return Err(format!("opening a device of {} did not end", other.name)),
        }
    }
    Ok(format!("{unit}; {others} other devices refused"))
}

/// The same controller on another line.
fn same_device(a: &Driver, b: &Driver) -> bool {
    a.name.starts_with("newport-esp") && b.name.starts_with("newport-esp")
}

/// Before it is opened.
pub async fn closed(make: &MakeRig<'_>) -> Result<String, Violation> {
    let mut trial = Trial::new(make)?;
    let order = trial.another_order();
    if trial.order(&order).await?.is_none() {
        return Err(format!("{order} is carried out"));
    }
    if let Ok(Some(said)) = trial.tell().await? {
        return Err(format!("it says {said}"));
    }
    match trial.rig.stand.line().requests() {
        0 => Ok("not a byte".into()),
        n => Err(format!("{n} requests were sent")),
    }
}

/// Orders that are refused send nothing.
pub async fn nothing_sent(make: &MakeRig<'_>) -> Verdict {
    let mut trial = match Trial::ready(make).await {
        Ok(trial) => trial,
        Err(what) => return Verdict::Failed(what),
    };
    let forbidden = trial.rig.subject.forbidden();
    if forbidden.is_empty() {
        return Verdict::NotApplicable("every order of its contract is allowed".into());
    }
    for order in &forbidden {
        let before = trial.rig.stand.line().requests();
        let ended = trial.rig.subject.carry_out(order).await;
        let sent = trial.rig.stand.line().requests() - before;
        match ended {
            Err(error) if error.kind == ErrorKind::Refused && sent == 0 => {}
            Err(error) if sent == 0 => return Verdict::Failed(format!("{order} gives {:?}: {error}", error.kind)),
            Err(_) => return Verdict::Failed(format!("{sent} requests were sent for {order}")),
            Ok(said) => return Verdict::Failed(format!("{order} was carried out: it says {said}")),
        }
    }
    Verdict::Passed(format!("{} refused, not a byte", forbidden.len()))
}

/// After power-up, and after the power failed at rest.
pub async fn power_up(make: &MakeRig<'_>) -> Result<String, Violation> {
    let mut trial = Trial::new(make)?;
    trial.open().await?.map_err(|e| format!("it is not opened: {e}"))?;
    let first = trial.tell().await?;
    let order = trial.another_order();
    let before = trial.order(&order).await?;
    trial.recover().await?;
    let next = trial.another_order();
    trial.order(&next).await?;
    trial.rig.stand.restart();
    trial.rest(Duration::from_secs(5)).await;
    let _ = trial.open().await?;
    trial.ask().await?;
    let order = trial.another_order();
    trial.order(&order).await?;
    trial.recover().await?;
    let known = matches!(first, Ok(Some(_)));
    if matches!(trial.rig.subject, Subject::Axis(_)) && known {
        return Err("an axis without a reference says an angle".into());
    }
    let said = if known { "knows the true one" } else { "says that it is unknown" };
    Ok(format!("{said}; {}", if before.is_some() { "refuses to move before" } else { "moves truly" }))
}

/// Given up in the middle of a command, then asked and ordered at once.
pub async fn busy(make: &MakeRig<'_>) -> Result<String, Violation> {
    let mut trial = Trial::ready(make).await?;
    let (mut given_up, mut refused) = (0, 0);
    for ms in GIVEN_UP_MS {
        for ask_first in [true, false] {
            let place = |what: Violation| format!("given up after {ms} ms: {what}");
            let order = trial.another_order();
            let limit = Duration::from_millis(ms);
            given_up += u32::from(Clock::system().timeout(limit, trial.rig.subject.carry_out(&order)).await.is_err());
            if ask_first {
                trial.ask().await.map_err(place)?;
            }
            let order = trial.another_order();
            refused += u32::from(trial.order(&order).await.map_err(place)?.is_some());
            trial.recover().await.map_err(place)?;
            let question = Clock::system().timeout(limit, trial.rig.subject.state()).await;
            drop(question);
            trial.ask().await.map_err(place)?;
            trial.recover().await.map_err(place)?;
        }
    }
    Ok(format!("{given_up} commands given up, the next one refused {refused} times"))
}
