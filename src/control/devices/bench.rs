//! The devices of the bench, opened and proven one by one; what is known about where they stand.

use crate::config::instrument::{self, Instrument};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, FilterWheel, Identity, LightMonitor, RotaryAxis, Shutter, ShutterState};
use goniod_drivers::devices::operator::Desk;
use goniod_drivers::error::{DeviceError, ErrorKind};
use goniod_drivers::units::Slot;
use std::collections::BTreeMap;
use std::fmt;
use std::time::Duration;
use thiserror::Error;

/// Limit for opening a device, beyond the driver's own.
const OPEN_LIMIT: Duration = Duration::from_secs(60);
/// Limit for finding an axis's reference.
const HOME_LIMIT: Duration = Duration::from_secs(300);
/// Limit for a question.
pub(super) const QUESTION_LIMIT: Duration = Duration::from_secs(30);

/// A device by its part on the bench.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DeviceId {
    /// Shutter in the beam.
    Shutter,
    /// Filter wheel.
    FilterWheel,
    /// Third axis.
    Changer,
    /// Tilt axis.
    Tilt,
    /// Spin axis.
    Spin,
    /// Camera of this name.
    Camera(String),
}

/// An error of a device, with its part on the bench.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{device}: {error}")]
pub struct Fault {
    /// Which.
    pub device: DeviceId,
    /// What.
    pub error: DeviceError,
}

/// The devices.
pub struct Devices {
    /// Tilt axis.
    pub tilt: Box<dyn RotaryAxis>,
    /// Spin axis.
    pub spin: Box<dyn RotaryAxis>,
    /// Changer axis, where there is one.
    pub changer: Option<Box<dyn RotaryAxis>>,
    /// Filter wheel.
    pub wheel: Box<dyn FilterWheel>,
    /// Shutter.
    pub shutter: Box<dyn Shutter>,
    /// Cameras by name.
    pub cameras: BTreeMap<String, Box<dyn Camera>>,
    /// Power meter that watches the lamp, where there is one.
    pub light_monitor: Option<Box<dyn LightMonitor>>,
    /// Where the operator is asked, where the changer is a person.
    pub operator: Option<Desk>,
}

/// How long to wait after a move, and how well an axis must stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisCare {
    /// Wait after the axis stands.
    pub settle: Duration,
    /// Largest difference between commanded and read position, degrees.
    pub tolerance_deg: f64,
}

/// Waits and tolerances of the bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settle {
    /// Tilt axis.
    pub tilt: AxisCare,
    /// Spin axis.
    pub spin: AxisCare,
    /// Changer axis.
    pub changer: AxisCare,
    /// Wait after the wheel has arrived.
    pub wheel: Duration,
    /// Wait after the shutter has changed.
    pub shutter: Duration,
}

/// What was proven and not disturbed since; `None` is unknown.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Known {
    /// Tilt axis, commanded degrees.
    pub tilt_deg: Option<f64>,
    /// Spin axis.
    pub spin_deg: Option<f64>,
    /// Changer axis.
    pub changer_deg: Option<f64>,
    /// Filter wheel.
    pub slot: Option<Slot>,
    /// Shutter.
    pub shutter: Option<ShutterState>,
}

/// The bench.
pub struct Bench {
    /// Its devices.
    pub devices: Devices,
    /// Waits and tolerances.
    pub settle: Settle,
    /// What is known of their state.
    pub known: Known,
}

// === impl DeviceId ===

impl fmt::Display for DeviceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            DeviceId::Shutter => "shutter",
            DeviceId::FilterWheel => "filter_wheel",
            DeviceId::Changer => "changer",
            DeviceId::Tilt => "tilt",
            DeviceId::Spin => "spin",
            DeviceId::Camera(name) => name,
        })
    }
}

// === impl Settle ===

impl Settle {
    /// The waits of the instrument file.
    pub fn of(instrument: &Instrument) -> Settle {
        let holder = &instrument.holder;
        let tilt = AxisCare::of(&holder.tilt);
        Settle {
            tilt,
            spin: AxisCare::of(&holder.spin),
            changer: holder.changer.as_ref().map_or(tilt, |changer| AxisCare::of(&changer.axis)),
            wheel: seconds(instrument.filter_wheel.settle_s),
            shutter: seconds(instrument.shutter.settle_s),
        }
    }
}

impl AxisCare {
    fn of(axis: &instrument::Axis) -> AxisCare {
        AxisCare { settle: seconds(axis.settle_s), tolerance_deg: axis.tolerance_deg }
    }
}

// === impl Bench ===

impl Bench {
    /// A bench of which nothing is known yet.
    pub fn new(devices: Devices, settle: Settle) -> Bench {
        Bench { devices, settle, known: Known::default() }
    }

    /// All devices, the shutter first: it closes before anything moves.
    pub fn ids(&self) -> Vec<DeviceId> {
        let mut ids = vec![DeviceId::Shutter, DeviceId::FilterWheel];
        if self.devices.changer.is_some() {
            ids.push(DeviceId::Changer);
        }
        ids.extend([DeviceId::Tilt, DeviceId::Spin]);
        ids.extend(self.devices.cameras.keys().cloned().map(DeviceId::Camera));
        ids
    }

    /// Opens every device: identities proven, shutter closed, axes with a reference. For callers without a
    /// recovery of their own; the sequencer opens one by one.
    ///
    /// # Errors
    /// The first device that cannot be had.
    pub async fn open_all(&mut self, clock: Clock) -> Result<Vec<(DeviceId, Identity)>, Fault> {
        let mut identities = Vec::new();
        for id in self.ids() {
            let identity = self.open(&id, clock).await?;
            identities.push((id, identity));
        }
        Ok(identities)
    }

    /// Opens one device, or opens it again: identity proven, a shutter closed, an axis with a reference. Where it
    /// stands is unknown afterwards.
    ///
    /// # Errors
    /// The device's own.
    pub async fn open(&mut self, id: &DeviceId, clock: Clock) -> Result<Identity, Fault> {
        self.forget(id);
        match id {
            DeviceId::Shutter => {
                let identity = limited(clock, OPEN_LIMIT, id, self.devices.shutter.open()).await?;
                self.set_shutter(ShutterState::Closed, clock).await?;
                Ok(identity)
            }
            DeviceId::FilterWheel => limited(clock, OPEN_LIMIT, id, self.devices.wheel.open()).await,
            DeviceId::Camera(name) => match self.devices.cameras.get_mut(name) {
                Some(camera) => limited(clock, OPEN_LIMIT, id, camera.open()).await,
                None => Err(absent(id)),
            },
            DeviceId::Changer | DeviceId::Tilt | DeviceId::Spin => {
                let axis = self.axis(id)?;
                let identity = limited(clock, OPEN_LIMIT, id, axis.open()).await?;
                if limited(clock, QUESTION_LIMIT, id, axis.position()).await?.is_none() {
                    limited(clock, HOME_LIMIT, id, axis.home()).await?;
                }
                Ok(identity)
            }
        }
    }

    /// Asks a device that is open whether it is well, without doubting its link: where it stands is unknown afterwards,
    /// and an axis that has lost its place finds its reference.
    ///
    /// # Errors
    /// The device's own.
    pub async fn resynchronise(&mut self, id: &DeviceId, clock: Clock) -> Result<(), Fault> {
        self.forget(id);
        match id {
            DeviceId::Shutter => limited(clock, QUESTION_LIMIT, id, self.devices.shutter.health()).await.map(drop),
            DeviceId::FilterWheel => limited(clock, QUESTION_LIMIT, id, self.devices.wheel.health()).await.map(drop),
            DeviceId::Camera(name) => match self.devices.cameras.get_mut(name) {
                Some(camera) => limited(clock, QUESTION_LIMIT, id, camera.health()).await.map(drop),
                None => Err(absent(id)),
            },
            DeviceId::Changer | DeviceId::Tilt | DeviceId::Spin => {
                let axis = self.axis(id)?;
                limited(clock, QUESTION_LIMIT, id, axis.health()).await?;
                if limited(clock, QUESTION_LIMIT, id, axis.position()).await?.is_none() {
                    limited(clock, HOME_LIMIT, id, axis.home()).await?;
                }
                Ok(())
            }
        }
    }

    /// Lets an axis find its reference; for anything else this is [`Bench::resynchronise`].
    ///
    /// # Errors
    /// The device's own.
    pub async fn rehome(&mut self, id: &DeviceId, clock: Clock) -> Result<(), Fault> {
        self.forget(id);
        match self.axis(id) {
            Ok(axis) => limited(clock, HOME_LIMIT, id, axis.home()).await,
            Err(_) => self.resynchronise(id, clock).await,
        }
    }

    /// The axis of this part.
    ///
    /// # Errors
    /// `Refused` where the bench has none.
    pub(super) fn axis(&mut self, id: &DeviceId) -> Result<&mut dyn RotaryAxis, Fault> {
        match id {
            DeviceId::Tilt => Ok(self.devices.tilt.as_mut()),
            DeviceId::Spin => Ok(self.devices.spin.as_mut()),
            DeviceId::Changer => match self.devices.changer.as_mut() {
                Some(axis) => Ok(axis.as_mut()),
                None => Err(absent(id)),
            },
            _ => Err(absent(id)),
        }
    }

    /// From now on nothing is known of this device's state.
    pub fn forget(&mut self, id: &DeviceId) {
        match id {
            DeviceId::Shutter => self.known.shutter = None,
            DeviceId::FilterWheel => self.known.slot = None,
            DeviceId::Changer => self.known.changer_deg = None,
            DeviceId::Tilt => self.known.tilt_deg = None,
            DeviceId::Spin => self.known.spin_deg = None,
            DeviceId::Camera(_) => {}
        }
    }
}

/// The result of a device's work, or a time-out of ours when it keeps neither its own deadline nor `limit`.
pub(super) async fn limited<T>(
    clock: Clock,
    limit: Duration,
    id: &DeviceId,
    work: impl Future<Output = goniod_drivers::error::Result<T>>,
) -> Result<T, Fault> {
    let done = clock.timeout(limit, work).await.unwrap_or_else(|_| {
        let message = format!("no answer within {} s; check its cable and power", limit.as_secs());
        Err(DeviceError::new(ErrorKind::Timeout, id.to_string(), message))
    });
    done.map_err(|error| Fault { device: id.clone(), error })
}

/// A fault found by the bench itself.
pub(super) fn fault(id: &DeviceId, kind: ErrorKind, message: String) -> Fault {
    Fault { device: id.clone(), error: DeviceError::new(kind, id.to_string(), message) }
}

fn absent(id: &DeviceId) -> Fault {
    fault(id, ErrorKind::Refused, "this bench has no such device; compare scan and instrument file".to_owned())
}

fn seconds(s: f64) -> Duration {
    Duration::try_from_secs_f64(s).unwrap_or_default()
}
