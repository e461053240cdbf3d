//! Scan -> numbered steps in travel order, with a hash and a forecast. Pure.
//!
//! [`build`](build::build) makes the plan, [`order`] finds the way, [`forecast`] plays it through, [`hash`] seals it.

pub mod build;
pub mod forecast;
pub mod hash;
pub mod order;
#[cfg(test)]
mod tests;

use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use goniod_drivers::units::{ExposureTime, Slot};
use serde::{Deserialize, Serialize};

/// What a view looks at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// Shutter closed.
    Dark,
    /// The known diffuser of this kind of geometry.
    Reference {
        /// Transmitting (true) or reflecting diffuser.
        transmission: bool,
    },
    /// The sample.
    Sample {
        /// Hemisphere pair.
        side: Side,
        /// Vector to the source, sample frame.
        incident: Direction,
    },
}

/// One bracket of one camera: a view and the poses that make it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Index in the plan; also the view index of the camera's frame array through `array_index`.
    pub id: u32,
    /// Index along the view dimension of this camera's frame array.
    pub array_index: u32,
    /// Camera name.
    pub camera: String,
    /// What it looks at.
    pub subject: Subject,
    /// Which time it is repeated (references and darks come again and again).
    pub repeat: u32,
    /// Band name; absent for darks.
    pub band: Option<String>,
    /// Wheel place.
    pub slot: Slot,
    /// Axis angle of the tilt.
    pub tilt_deg: f64,
    /// Axis angle of the spin.
    pub spin_deg: f64,
    /// Axis angle of the changer, where there is one.
    pub changer_deg: Option<f64>,
}

/// One planned exposure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Number, counted from 0 in the order of execution.
    pub number: u32,
    /// View it belongs to.
    pub view: u32,
    /// Index along the exposure dimension of the camera's frame array.
    pub exposure_index: u32,
    /// Integration time.
    pub exposure: ExposureTime,
}

/// Forecast by kind, in seconds, and of disk.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Forecast {
    /// Axes moving and settling.
    pub moving_s: f64,
    /// Wheel turning and settling.
    pub filter_s: f64,
    /// Shutter.
    pub shutter_s: f64,
    /// Exposures that are kept.
    pub exposing_s: f64,
    /// Frames thrown away and read-out.
    pub overhead_s: f64,
    /// Opening and homing at the start.
    pub start_s: f64,
    /// Bytes of raw frames before compression.
    pub raw_bytes: u64,
}

/// The scan as numbered steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// SHA-256 over views and steps, hexadecimal.
    pub hash: String,
    /// Brackets in order of execution.
    pub views: Vec<View>,
    /// Exposures in order of execution.
    pub steps: Vec<Step>,
    /// Forecast.
    pub forecast: Forecast,
    /// Longest ladder of each camera: name, number of views, number of exposures a view.
    pub arrays: Vec<FrameArray>,
}

/// Shape of one camera's frame array.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameArray {
    /// Camera name.
    pub camera: String,
    /// Number of views.
    pub views: u32,
    /// Exposures a view at most.
    pub exposures: u32,
}

// === impl Forecast ===

impl Forecast {
    /// All kinds together, seconds.
    pub fn total_s(&self) -> f64 {
        self.moving_s + self.filter_s + self.shutter_s + self.exposing_s + self.overhead_s + self.start_s
    }
}
