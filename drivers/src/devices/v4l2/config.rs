//! What the driver must be told about a camera behind V4L2: control ids, units and latency are declared, never guessed.

use crate::devices::camera::{CameraConfig, V4l2Control, V4l2Table};
use crate::frame::PixelFormat;
use std::path::PathBuf;
use std::time::Duration;

/// EXPOSURE_ABSOLUTE, unit 100 us.
pub const EXPOSURE_ABSOLUTE: u32 = 0x009A_0902;
/// EXPOSURE, unit of the driver (often lines).
pub const EXPOSURE: u32 = 0x0098_0911;
/// GAIN, unit of the driver.
pub const GAIN: u32 = 0x0098_0913;
/// GAMMA, unit of the driver, often hundredths.
pub const GAMMA: u32 = 0x0098_0910;

/// Automatic functions with the value that means "off"; written first and read back. A device without one is fine.
/// (EXPOSURE_AUTO = manual, EXPOSURE_AUTO_PRIORITY, AUTOGAIN, AUTO_WHITE_BALANCE)
pub const AUTOMATIC_OFF: [(u32, i32, &str); 4] = [
    (0x009A_0901, 1, "automatic exposure"),
    (0x009A_0903, 0, "automatic frame rate"),
    (0x0098_0912, 0, "automatic gain"),
    (0x0098_090C, 0, "automatic white balance"),
];

/// A control whose raw value means `value = raw * scale + offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScaledControl {
    /// Control id.
    pub id: u32,
    /// Physical unit a raw step.
    pub scale: f64,
    /// Physical value of raw 0.
    pub offset: f64,
}

/// One camera behind a V4L2 node.
#[derive(Debug, Clone, PartialEq)]
pub struct V4l2Config {
    /// The device as the instrument file names it, for messages.
    pub name: String,
    /// Node; a path under `/dev/v4l/by-id` stays the same when the bridge is plugged again.
    pub node: PathBuf,
    /// Text the card's name must contain; empty = any.
    pub card: String,
    /// Serial number; V4L2 itself has none, so it must stand in the node's by-id name. Empty = not proven.
    pub serial: String,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Format to use; `None` = the best on offer (raw mosaic or mono, then RGB, then YUYV).
    pub format: Option<PixelFormat>,
    /// Integration time in seconds.
    pub exposure: ScaledControl,
    /// Gain; `None` for a camera without.
    pub gain: Option<ScaledControl>,
    /// Controls written once and proven with every setting, raw: gamma, black level, ...
    pub fixed: Vec<(u32, i32)>,
    /// N: the first frame that may be kept is the N-th one started after a change of settings (at least 1).
    pub settle_frames: u32,
    /// Read-out time of one frame.
    pub readout_s: f64,
    /// Shortest time from frame to frame.
    pub frame_interval_s: f64,
    /// Shortest integration time.
    pub shortest_s: f64,
    /// Longest integration time of one frame.
    pub longest_s: f64,
    /// Most frames summed for integration times beyond `longest_s`; 1 = none, longer times are refused.
    pub sum_limit: u16,
    /// Kernel buffers asked for.
    pub buffers: u32,
    /// Frames that may wait for their reader.
    pub pool: usize,
    /// Limit of one command to the camera's thread; a call that hangs longer is abandoned.
    pub command_limit: Duration,
}

// === impl ScaledControl ===

impl From<V4l2Control> for ScaledControl {
    fn from(c: V4l2Control) -> ScaledControl {
        ScaledControl { id: c.id, scale: c.scale, offset: c.offset.unwrap_or_default() }
    }
}

impl ScaledControl {
    /// Nearest raw value to a physical one.
    pub fn raw(self, value: f64) -> i64 {
        ((value - self.offset) / self.scale).round() as i64
    }

    /// Physical value of a raw one.
    pub fn value(self, raw: i32) -> f64 {
        f64::from(raw) * self.scale + self.offset
    }
}

// === impl V4l2Config ===

impl V4l2Config {
    /// A camera with the standard controls (exposure in 100 us, gain in driver units), N = 4, no sums.
    pub fn new(name: &str, node: impl Into<PathBuf>, width: u32, height: u32) -> V4l2Config {
        V4l2Config {
            name: name.to_owned(),
            node: node.into(),
            card: String::new(),
            serial: String::new(),
            width,
            height,
            format: None,
            exposure: ScaledControl { id: EXPOSURE_ABSOLUTE, scale: 1e-4, offset: 0.0 },
            gain: Some(ScaledControl { id: GAIN, scale: 1.0, offset: 0.0 }),
            fixed: Vec::new(),
            settle_frames: 4,
            readout_s: 0.03,
            frame_interval_s: 0.04,
            shortest_s: 1e-4,
            longest_s: 10.0,
            sum_limit: 1,
            buffers: 4,
            pool: 8,
            command_limit: Duration::from_secs(2),
        }
    }

    /// The camera of an instrument file.
    pub fn of(camera: &CameraConfig) -> V4l2Config {
        let table = camera.v4l2.clone().unwrap_or_default();
        let plain = V4l2Config::new(&camera.name, &camera.port, camera.width as u32, camera.height as u32);
        let gain = table.gain.map(ScaledControl::from).or(plain.gain);
        V4l2Config {
            card: table.card.unwrap_or_default(),
            serial: camera.serial.clone(),
            format: Some(camera.format),
            exposure: table.exposure.map_or(plain.exposure, ScaledControl::from),
            gain: gain.filter(|_| table.has_gain != Some(false)),
            fixed: table.controls.iter().map(|c| (c.id, c.value.round() as i32)).collect(),
            settle_frames: camera.discard_frames + 1,
            readout_s: camera.readout_s,
            frame_interval_s: camera.frame_interval_s,
            shortest_s: camera.shortest_s,
            longest_s: table.longest_frame_s.unwrap_or(camera.longest_s),
            sum_limit: table.sum_frames.unwrap_or(plain.sum_limit),
            buffers: table.buffers.unwrap_or(plain.buffers),
            command_limit: table.command_limit_s.map_or(plain.command_limit, Duration::from_secs_f64),
            ..plain
        }
    }

    /// How a total exposure is split: number of frames and time of each; the sentence of refusal otherwise.
    pub fn split(&self, total_s: f64, most_in_words: u32) -> Result<(u16, f64), String> {
        if !total_s.is_finite() || total_s < self.shortest_s - 1e-9 {
            return Err(format!("an exposure of {total_s} s is shorter than the camera's {} s", self.shortest_s));
        }
        let frames = V4l2Table::frames_in(total_s, self.longest_s);
        let most = f64::from(self.sum_limit.max(1)).min(f64::from(most_in_words));
        if frames > most {
            let longest = self.longest_s * most;
            return Err(format!(
                "an exposure of {total_s} s is longer than the {longest} s that {most} frame(s) of at most {} s give; \
                 shorten it or raise the camera's limit of summed frames",
                self.longest_s
            ));
        }
        Ok((frames as u16, total_s / frames))
    }

    /// Time from frame to frame at an integration time.
    pub fn period_s(&self, exposure_s: f64) -> f64 {
        (exposure_s + self.readout_s).max(self.frame_interval_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_exposures_split_into_equal_frames_or_are_refused() {
        let mut config = V4l2Config::new("ccd", "/dev/video0", 8, 8);
        assert_eq!(config.split(10.0, 257), Ok((1, 10.0)));
        assert!(config.split(10.1, 257).is_err_and(|e| e.contains("10.1 s is longer than the 10 s")));
        config.sum_limit = 8;
        assert_eq!(config.split(60.0, 257), Ok((6, 10.0)));
        assert_eq!(config.split(25.0, 257), Ok((3, 25.0 / 3.0)));
        assert!(config.split(60.0, 1).is_err(), "16-bit words hold one 16-bit frame");
        assert!(config.split(f64::NAN, 257).is_err());
        assert!(config.split(9e-5, 257).is_err_and(|e| e.contains("shorter than the camera's 0.0001 s")));
        assert_eq!(config.split(100.0 * 1e-6, 257).map(|s| s.0), Ok(1), "100 us is not shorter than 0.1 ms");
    }
}
