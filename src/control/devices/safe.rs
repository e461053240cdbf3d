//! The safe state: every device of the ordered list is tried, whatever the others do, and each tells how it went.

use super::bench::{Bench, DeviceId, Known};
use crate::config::instrument::SafeState;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::Device;
use goniod_drivers::error::{DeviceError, ErrorKind};
use serde::{Deserialize, Serialize};
use std::time::Duration;

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
}

// === impl Bench ===

impl Bench {
    /// Brings the bench into its safe state: all devices of the list in its order, each within its limit, one that
    /// gives an error opened again and tried once more. Never fails, never waits longer than twice the limit a device.
    pub async fn make_safe(&mut self, list: &SafeState, clock: Clock) -> Vec<SafeReport> {
        let limit = Duration::try_from_secs_f64(list.limit_s).unwrap_or(Duration::from_secs(10));
        let mut reports = Vec::new();
        for name in &list.order {
            if name == "cameras" {
                for (name, camera) in &mut self.devices.cameras {
                    reports.push(one(name, camera.as_mut(), limit, clock).await);
                }
                continue;
            }
            let device: Option<&mut dyn Device> = match name.as_str() {
                "shutter" => Some(self.devices.shutter.as_mut()),
                "filter_wheel" => Some(self.devices.wheel.as_mut()),
                "tilt" => Some(self.devices.tilt.as_mut()),
                "spin" => Some(self.devices.spin.as_mut()),
                "changer" => self.devices.changer.as_mut().map(|axis| axis.as_mut() as &mut dyn Device),
                other => self.devices.cameras.get_mut(other).map(|camera| camera.as_mut() as &mut dyn Device),
            };
            if let Some(device) = device {
                reports.push(one(name, device, limit, clock).await);
            } else if name != &DeviceId::Changer.to_string() {
                let message = Some("the bench has no such device".to_owned());
                reports.push(SafeReport { device: name.clone(), outcome: SafeResult::Unreachable, message });
            }
        }
        self.known = Known::default();
        reports
    }
}

async fn one(name: &str, device: &mut dyn Device, limit: Duration, clock: Clock) -> SafeReport {
    let first = within(clock, limit, device.make_safe()).await;
    let last = match first {
        Ok(()) => Ok(()),
        Err(_) => {
            let again = async {
                device.open().await?;
                device.make_safe().await
            };
            within(clock, limit, again).await
        }
    };
    let (outcome, message) = match last {
        Ok(()) => (SafeResult::Confirmed, None),
        Err(e) if matches!(e.kind, ErrorKind::Lost | ErrorKind::WrongDevice | ErrorKind::Timeout) => {
            (SafeResult::Unreachable, Some(e.to_string()))
        }
        Err(e) => (SafeResult::Unconfirmed, Some(e.to_string())),
    };
    SafeReport { device: name.to_owned(), outcome, message }
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
