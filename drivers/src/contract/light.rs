//! The kinds that make, split or measure light without a picture: monochromator, light monitor, spectrometer.

use super::Device;
use crate::error::Result;
use crate::units::{ExposureTime, Nanometres};
use async_trait::async_trait;
use tokio::time::Instant;

/// A monochromator.
#[async_trait]
pub trait Monochromator: Device {
    /// Shortest and longest wavelength that may be commanded: what the grating allows and the configuration permits.
    fn limits(&self) -> (Nanometres, Nanometres);
    /// Turns to a wavelength, waits until it stands, asks and proves it.
    async fn tune(&mut self, target: Nanometres) -> Result<Nanometres>;
    /// The wavelength now; `None` until proven.
    async fn wavelength(&mut self) -> Result<Option<Nanometres>>;
}

/// One reading of a light monitor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LightReading {
    /// Optical power in watts; negative values are noise around a zero.
    pub power_w: f64,
    /// Wavelength the device corrected for.
    pub wavelength: Nanometres,
    /// True when the device says that the range was exceeded; the value is then no measurement.
    pub saturated: bool,
    /// When it was read.
    pub at: Instant,
}

/// A power meter that watches the lamp.
#[async_trait]
pub trait LightMonitor: Device {
    /// Sets the wavelength of the responsivity correction, reads it back, returns it as applied.
    async fn apply(&mut self, wavelength: Nanometres) -> Result<Nanometres>;
    /// One reading.
    async fn read(&mut self) -> Result<LightReading>;
}

/// One spectrum as counts, before any division by responsivity.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Wavelength of each pixel in nanometres, from the device's own coefficients; ascending.
    pub wavelength_nm: Vec<f64>,
    /// Counts of each pixel, less the dark pixels' mean, with the device's non-linearity corrected.
    pub counts: Vec<f64>,
    /// Integration time as applied.
    pub exposure: ExposureTime,
    /// Pixels at or above saturation.
    pub saturated: usize,
    /// When it was complete.
    pub at: Instant,
}

/// An array spectrometer.
#[async_trait]
pub trait Spectrometer: Device {
    /// Shortest and longest integration time.
    fn limits(&self) -> (ExposureTime, ExposureTime);
    /// Sets the integration time; the first spectrum after a change is thrown away by the driver.
    async fn apply(&mut self, exposure: ExposureTime) -> Result<ExposureTime>;
    /// Takes one spectrum that began after this call.
    async fn acquire(&mut self) -> Result<Spectrum>;
}
