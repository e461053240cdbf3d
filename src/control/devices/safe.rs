//! The safe state: every device of the ordered list is tried, whatever the others do, and each tells how it went.

use super::bench::{Bench, DeviceId, Devices, Known};
use crate::config::instrument::SafeState;
use futures_util::future::join_all;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Device;
use goniod_drivers::error::{DeviceError, ErrorKind};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::Instant;

/// How long a device waits for the one before it in the list: what hangs must not hold up the rest.
const PRECEDENCE: Duration = Duration::from_secs(1);

/// How one device became safe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SafeResult {
    /// The device proved its safe state.
    Confirmed,
    /// The command was given; no proof came within the limit, or the device says it is not safe.
    Unconfirmed,
    /// The device cannot be reached.
    Unreachable,
}

/// One device of the list.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SafeReport {
    /// Name of the instrument file.
    pub device: String,
    /// How it went.
    pub outcome: SafeResult,
    /// The device's sentence, where it gave one.
    pub message: Option<String>,
    /// First command after the reason was known, milliseconds.
    pub began_ms: u64,
    /// Proof or last answer after the reason was known, milliseconds.
    pub ended_ms: u64,
}

/// A device of the list: its name, and the device where the bench has it.
type Listed<'a> = (String, Option<&'a mut dyn Device>);

// === impl SafeResult ===

impl SafeResult {
    /// The result in one word.
    pub fn word(self) -> &'static str {
        match self {
            SafeResult::Confirmed => "confirmed",
            SafeResult::Unconfirmed => "unconfirmed",
            SafeResult::Unreachable => "unreachable",
        }
    }
}

// === impl Bench ===

impl Bench {
    /// Brings the bench into its safe state: all devices of the list in its order, each within its limit, one that
    /// gives an error opened again and tried once more. Each begins when the one before it is done, or a second after
    /// it began. Never fails, never waits longer than twice the limit a device.
    pub async fn make_safe(&mut self, list: &SafeState, clock: Clock) -> Vec<SafeReport> {
        self.known = Known::default();
        let limit = Duration::try_from_secs_f64(list.limit_s).unwrap_or(Duration::from_secs(10));
        let since = clock.now();
        let mut before = None;
        let mut all = Vec::new();
        for (name, device) in listed(&mut self.devices, list) {
            let (done, next) = oneshot::channel();
            let before = before.replace(next);
            all.push(async move {
                if let Some(before) = before {
                    // Done, or gone, or too slow: this device's turn in any case.
                    let _ = clock.timeout(PRECEDENCE, before).await;
                }
                let report = one(&name, device, (limit, since), clock).await;
                let _ = done.send(());
                report
            });
        }
        join_all(all).await
    }
}

/// The devices of the list in its order. A changer that the bench has not is left out: the file says so itself.
fn listed<'a>(devices: &'a mut Devices, list: &SafeState) -> Vec<Listed<'a>> {
    let mut parts: BTreeMap<String, &'a mut dyn Device> = BTreeMap::new();
    parts.insert(DeviceId::Shutter.to_string(), devices.shutter.as_mut());
    parts.insert(DeviceId::FilterWheel.to_string(), devices.wheel.as_mut());
    parts.insert(DeviceId::Tilt.to_string(), devices.tilt.as_mut());
    parts.insert(DeviceId::Spin.to_string(), devices.spin.as_mut());
    if let Some(changer) = devices.changer.as_mut() {
        parts.insert(DeviceId::Changer.to_string(), changer.as_mut());
    }
    let names: Vec<String> = devices.cameras.keys().cloned().collect();
    for (name, camera) in &mut devices.cameras {
        parts.insert(name.clone(), camera.as_mut());
    }
    let mut out: Vec<Listed<'a>> = Vec::new();
    for name in &list.order {
        let members = if name == "cameras" { names.clone() } else { vec![name.clone()] };
        for member in members {
            match parts.remove(&member) {
                None if member == DeviceId::Changer.to_string() => {}
                device => out.push((member, device)),
            }
        }
    }
    out
}

async fn one(
    name: &str,
    device: Option<&mut dyn Device>,
    (limit, since): (Duration, Instant),
    clock: Clock,
) -> SafeReport {
    let began_ms = (clock.now() - since).as_millis() as u64;
    let (outcome, message) = match device {
        None => (SafeResult::Unreachable, Some("the bench has no such device".to_owned())),
        Some(device) => match safe_or_reopened(device, limit, clock).await {
            Ok(()) => (SafeResult::Confirmed, None),
            Err(e) if matches!(e.kind, ErrorKind::Lost | ErrorKind::WrongDevice | ErrorKind::Timeout) => {
                (SafeResult::Unreachable, Some(e.to_string()))
            }
            Err(e) => (SafeResult::Unconfirmed, Some(e.to_string())),
        },
    };
    let ended_ms = (clock.now() - since).as_millis() as u64;
    SafeReport { device: name.to_owned(), outcome, message, began_ms, ended_ms }
}

async fn safe_or_reopened(device: &mut dyn Device, limit: Duration, clock: Clock) -> goniod_drivers::error::Result<()> {
    if within(clock, limit, device.make_safe()).await.is_ok() {
        return Ok(());
    }
    let again = async {
        device.open().await?;
        device.make_safe().await
    };
    within(clock, limit, again).await
}

async fn within(
    clock: Clock,
    limit: Duration,
    work: impl Future<Output = goniod_drivers::error::Result<()>>,
) -> goniod_drivers::error::Result<()> {
    clock.timeout(limit, work).await.unwrap_or_else(|_| {
        let message = format!("not proven safe within {} s", limit.as_secs_f64());
        Err(DeviceError::new(ErrorKind::Busy, "bench", message))
    })
}
