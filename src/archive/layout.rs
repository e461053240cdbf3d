//! The shape of a run as the archive needs it: one array a camera, one row a planned exposure.

use goniod_drivers::frame::PixelFormat;
use serde::{Deserialize, Serialize};

/// What a run will hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunLayout {
    /// Hash of the plan, hexadecimal.
    pub plan_hash: String,
    /// Frame arrays, one a camera.
    pub arrays: Vec<ArrayLayout>,
    /// Planned exposures, numbered from 0 without gaps.
    pub steps: Vec<StepLayout>,
}

/// Shape of one camera's frame array: view x exposure x row x column.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ArrayLayout {
    /// Camera name, also the array's name.
    pub camera: String,
    /// Number of views.
    pub views: u32,
    /// Exposures a view at most.
    pub exposures: u32,
    /// Rows of a frame.
    pub rows: usize,
    /// Columns of a frame.
    pub columns: usize,
    /// Format of the pixels; decides between one and two bytes.
    pub format: PixelFormat,
}

/// Where the frame of one planned exposure goes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct StepLayout {
    /// Number in the plan.
    pub number: u32,
    /// View of the plan.
    pub view: u32,
    /// Camera name.
    pub camera: String,
    /// Index along the view dimension of the camera's array.
    pub array_index: u32,
    /// Index along the exposure dimension.
    pub exposure_index: u32,
    /// Planned integration time, microseconds.
    pub exposure_us: u64,
}
