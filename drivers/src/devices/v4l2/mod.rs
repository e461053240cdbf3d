//! Cameras behind any grabber or bridge that offers V4L2 (the colour CCD, Kappa DX 20 in the paper).
//!
//! Sources: Linux media userspace API; `../shared/protocols/ccd-v4l2-kappa-dx20.md`; crate `v4l` 0.14.0.
//!
//! - [`config`]: what must be told: control ids, units, latency, limits
//! - [`camera`]: the async side, commands with deadlines
//! - `worker`: the one named thread that owns the camera and never stops taking pictures
//! - `negotiate`: identity and picture format; `session`: settings, stream, recovery
//! - `controls`: automatic functions off, write, read back
//! - [`flight`]: which frame is fresh and has the new settings (pure)
//! - [`formats`]: pixel formats and the one copy; `sum`: exposures beyond the driver's limit
//! - `fault`: errno to error; `sys`: the only `unsafe`

pub mod camera;
pub mod config;
mod controls;
mod fault;
pub mod flight;
pub mod formats;
mod negotiate;
mod session;
mod sum;
mod sys;
mod worker;

pub use camera::V4l2Camera;
pub use config::{ScaledControl, V4l2Config};
pub use flight::Counters;

use super::camera::{CameraConfig, Proven};
use crate::clock::Clock;
use crate::contract::Camera;
use crate::error::Result;

/// A camera as the instrument file says it.
///
/// # Errors
/// None: V4L2 tells at `open` what it offers.
pub fn make(config: CameraConfig, clock: Clock) -> Result<Box<dyn Camera>> {
    let camera = V4l2Camera::new(V4l2Config::of(&config), clock);
    Ok(Box::new(Proven::new(camera, config)))
}
