//! What the daemon may ask of a device. At most six methods a kind: what physics needs, not what an SDK offers.
//!
//! Rules that every driver keeps:
//! - unknown is a value: position and slot are `None` until proven;
//! - settings are given whole, applied, read back and returned as applied;
//! - every call ends within a deadline of its own making (link time-out, distance / speed + margin, exposure + margin);
//! - identity is proven before anything is trusted.

mod light;

pub use light::{LightMonitor, LightReading, Monochromator, Spectrometer, Spectrum};

use crate::error::Result;
use crate::frame::{Frame, PixelFormat};
use crate::units::{Degrees, DegreesPerSecond, ExposureTime, Slot};
use async_trait::async_trait;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Who a device says it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Model name or number.
    pub model: String,
    /// Firmware version.
    pub firmware: String,
    /// Serial number; empty where the device has none to tell.
    pub serial: String,
}

/// How a device is: readings that an operator or an interlock may look at.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Conditions the device reports, in its own short words; empty when all is well.
    pub warnings: Vec<String>,
    /// Temperature in degrees Celsius, where the device has a sensor.
    pub temperature_c: Option<f64>,
}

/// What every device can do.
#[async_trait]
pub trait Device: Send {
    /// Connects (or reconnects), resynchronises, proves the identity and puts the device into its working
    /// state. After it, position and slot are unknown until read.
    async fn open(&mut self) -> Result<Identity>;
    /// A harmless question whose answer tells that device and link are well.
    async fn health(&mut self) -> Result<Health>;
    /// Brings the device into its safe state and proves it (axis stopped, shutter closed, wheel on its dark place).
    async fn make_safe(&mut self) -> Result<()>;
}

/// One rotation axis of the sample holder.
#[async_trait]
pub trait RotaryAxis: Device {
    /// Soft limits from the configuration, checked before a byte is sent.
    fn limits(&self) -> (Degrees, Degrees);
    /// Nominal speed and acceleration (degrees per second squared), for deadlines and forecasts.
    fn speed(&self) -> (DegreesPerSecond, f64);
    /// Finds the reference; needed after power-up before any absolute move.
    async fn home(&mut self) -> Result<()>;
    /// Moves to an absolute angle, waits until the axis stands, reads the position and proves it.
    async fn move_to(&mut self, target: Degrees) -> Result<Degrees>;
    /// The angle now; `None` while the axis has no reference.
    async fn position(&mut self) -> Result<Option<Degrees>>;
    /// Stops with the device's ramp and reads the position.
    async fn stop(&mut self) -> Result<()>;
}

/// A filter wheel.
#[async_trait]
pub trait FilterWheel: Device {
    /// Number of places.
    fn slots(&self) -> u8;
    /// Turns to a place, waits until it has arrived and proves it by asking.
    async fn select(&mut self, slot: Slot) -> Result<Slot>;
    /// The place now; `None` while it turns or cannot tell.
    async fn slot(&mut self) -> Result<Option<Slot>>;
}

/// What a shutter's sensor says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ShutterState {
    /// Light passes.
    Open,
    /// No light passes.
    Closed,
}

/// A shutter in the beam.
#[async_trait]
pub trait Shutter: Device {
    /// Brings the blade to `state` and proves it by its sensor.
    async fn set(&mut self, state: ShutterState) -> Result<()>;
    /// Where the blade is now; `None` where sensor and command disagree or cannot be read.
    async fn state(&mut self) -> Result<Option<ShutterState>>;
}

/// What a camera is: read from the device at `open`, or from the configuration where it cannot tell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Who it is.
    pub identity: Identity,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Format of its frames.
    pub format: PixelFormat,
    /// Shortest exposure.
    pub shortest: ExposureTime,
    /// Longest exposure.
    pub longest: ExposureTime,
}

/// All settings of a camera that bear on what a level means. Automatic functions are always off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraSettings {
    /// Integration time.
    pub exposure: ExposureTime,
    /// Gain in the driver's units.
    pub gain: f64,
}

/// What `arm` promises about the frames that follow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Armed {
    /// No frame whose exposure started before this instant may be used.
    pub not_before: tokio::time::Instant,
    /// Frames to throw away after that instant, because the sensor's register pipeline may still hold old settings.
    pub discard: u32,
    /// The next good frame is due within this time.
    pub due_within: Duration,
}

/// A camera. Blocking SDKs live behind one named thread that owns the handle and keeps dequeuing into a
/// bounded channel; these methods are its command side and never block the runtime. A camera that is gone gives
/// `Lost`; the handle is then useless until `open` has proven identity and settings again.
#[async_trait]
pub trait Camera: Device {
    /// What it is; known after `open`.
    fn info(&self) -> &CameraInfo;
    /// Writes all settings, reads them back, and returns them as applied.
    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings>;
    /// Empties the queue of frames taken before now, triggers (or marks the moment in a free-running stream) and
    /// says which frames count. Every later change of bench or settings needs a new `arm`.
    async fn arm(&mut self) -> Result<Armed>;
    /// The next frame in order, good or not (the guard decides); `Timeout` when none comes within exposure +
    /// readout + margin. Dropping the future loses no frame.
    async fn next_frame(&mut self) -> Result<Frame>;
    /// Stops streaming; frames under way are thrown away.
    async fn stop(&mut self) -> Result<()>;
}
