//! One camera as the instrument file says it, for whichever driver it names: what all cameras have, the drivers' own
//! tables, and the proof at every opening that the camera is the one that was described.

use crate::contract::{Armed, Camera, CameraInfo, CameraSettings, Device, Health, Identity};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::frame::{Frame, PixelFormat};
use crate::units::ExposureTime;
use async_trait::async_trait;
use serde::{Deserialize, Serialize};

/// What the instrument file says about a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraConfig {
    /// Name for messages (`camera.ccd`).
    pub name: String,
    /// Device path, address or device id.
    pub port: String,
    /// Serial number that the camera must report.
    pub serial: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Format of its frames.
    pub format: PixelFormat,
    /// Shortest exposure that may be asked for, seconds.
    pub shortest_s: f64,
    /// Longest exposure that may be asked for, seconds.
    pub longest_s: f64,
    /// Read-out time of one frame, seconds.
    pub readout_s: f64,
    /// Shortest time from frame to frame, seconds.
    pub frame_interval_s: f64,
    /// Frames after a change of settings that may still hold old ones.
    pub discard_frames: u32,
    /// Table of the driver `v4l2`.
    pub v4l2: Option<V4l2Table>,
    /// Table of the driver `aravis`.
    pub aravis: Option<AravisTable>,
}

/// What only cameras behind V4L2 need to be told. Absent keys have the values of a plain UVC camera.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4l2Table {
    /// Text the card's name must contain; absent = any.
    pub card: Option<String>,
    /// Control of the integration time, in seconds; absent = EXPOSURE_ABSOLUTE in steps of 100 us.
    pub exposure: Option<V4l2Control>,
    /// Control of the gain; absent = GAIN in the driver's own steps.
    pub gain: Option<V4l2Control>,
    /// False: the camera has no gain control.
    pub has_gain: Option<bool>,
    /// Controls written once and proven with every setting (gamma, black level).
    #[serde(default)]
    pub controls: Vec<V4l2Fixed>,
    /// Longest integration time of one frame, seconds; absent = `longest_s` of the camera.
    pub longest_frame_s: Option<f64>,
    /// Most frames summed for longer integration times; absent = 1.
    pub sum_frames: Option<u16>,
    /// Kernel buffers; absent = 4.
    pub buffers: Option<u32>,
    /// Limit of one command to the camera, seconds; absent = 2.
    pub command_limit_s: Option<f64>,
}

/// A control whose raw value means `raw * scale + offset`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4l2Control {
    /// Control id.
    pub id: u32,
    /// Physical unit a raw step.
    pub scale: f64,
    /// Physical value of raw 0; absent = 0.
    pub offset: Option<f64>,
}

/// A control with one value for ever.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct V4l2Fixed {
    /// Control id.
    pub id: u32,
    /// Raw value, a whole number.
    pub value: f64,
}

/// What only GenICam cameras need to be told. Absent keys have sound values for a link of its own.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AravisTable {
    /// How pixels of more than 8 bits lie on the wire; absent = words.
    pub packing: Option<Packing>,
    /// How frames are begun; absent = software.
    pub trigger: Option<TriggerKind>,
    /// Frames a second of a free-running camera.
    pub frame_rate_hz: Option<f64>,
    /// What a frame may be late beyond exposure and read-out, seconds; absent = 1.5.
    pub margin_s: Option<f64>,
    /// Limit of one command to the camera, seconds; absent = 3.
    pub command_limit_s: Option<f64>,
    /// Size of stream packets with headers, bytes; absent = 8000.
    pub packet_size_bytes: Option<u32>,
    /// Pause between packets that the camera is asked for, nanoseconds; absent = 0.
    pub packet_delay_ns: Option<u32>,
    /// Heartbeat time-out that the camera is asked for, seconds; absent = 3.
    pub heartbeat_s: Option<f64>,
    /// Receive buffer of the stream's socket, bytes; absent = 4 MiB.
    pub socket_buffer_bytes: Option<u32>,
    /// How long an incomplete frame is waited for, seconds; absent = 0.5.
    pub frame_retention_s: Option<f64>,
    /// Ask for integration time and number in the frame itself, where the camera offers it; absent = true.
    pub chunks: Option<bool>,
    /// Reading that says whether the cooler holds its temperature; absent = none.
    pub cooler: Option<CoolerTable>,
}

/// A feature of the camera that tells of its cooler.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoolerTable {
    /// Feature to read.
    pub feature: String,
    /// Its value when all is well.
    pub good: String,
}

/// How pixels of more than 8 bits lie on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Packing {
    /// 16-bit words.
    Words,
    /// Two 12-bit pixels in three bytes, little-endian bit stream (PFNC `Mono12p`).
    Mono12p,
    /// Two 12-bit pixels in three bytes, high bytes outside (`Mono12Packed`).
    Mono12Packed,
}

/// How frames are begun.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerKind {
    /// One frame for each command.
    Software,
    /// The camera runs by itself.
    FreeRun,
}

/// A camera that is compared with its description at every opening.
pub struct Proven<C> {
    inner: C,
    config: CameraConfig,
}

// === impl V4l2Table ===

impl V4l2Table {
    /// Frames that are summed for an exposure of `total_s`, where one frame takes at most `longest_s`: what the driver
    /// does, and what a stored frame of that exposure is.
    pub fn frames_in(total_s: f64, longest_s: f64) -> f64 {
        (total_s / longest_s - 1e-9).ceil().max(1.0)
    }
}

// === impl CameraConfig ===

impl CameraConfig {
    /// Compares the camera as it described itself with this configuration.
    ///
    /// # Errors
    /// `WrongDevice` with the first difference.
    pub fn prove(&self, info: &CameraInfo) -> Result<()> {
        let wrong = |message: String| Err(DeviceError::new(ErrorKind::WrongDevice, &self.name, message));
        let end = "correct the instrument file or connect the camera it describes";
        if info.identity.serial != self.serial {
            let (is, should) = (&info.identity.serial, &self.serial);
            return wrong(format!("the camera has serial number \"{is}\", the instrument file \"{should}\"; {end}"));
        }
        if (info.width, info.height) != (self.width, self.height) {
            let (w, h, ww, hh) = (info.width, info.height, self.width, self.height);
            return wrong(format!(
                "the camera makes pictures of {w} x {h} pixels, the instrument file says {ww} x {hh}; {end}"
            ));
        }
        if info.format != self.format {
            let (is, should) = (info.format, self.format);
            return wrong(format!("the camera's pixel format is {is:?}, the instrument file says {should:?}; {end}"));
        }
        let (shortest, longest) =
            (ExposureTime::from_seconds(self.shortest_s), ExposureTime::from_seconds(self.longest_s));
        if shortest < info.shortest || longest > info.longest {
            let (low, high) = (info.shortest, info.longest);
            return wrong(format!(
                "the camera exposes from {low} to {high}, the instrument file promises {shortest} to {longest}; {end}"
            ));
        }
        Ok(())
    }
}

// === impl Proven ===

impl<C: Camera> Proven<C> {
    /// `inner` as a camera that proves itself to be what `config` says.
    pub fn new(inner: C, config: CameraConfig) -> Proven<C> {
        Proven { inner, config }
    }
}

#[async_trait]
impl<C: Camera> Device for Proven<C> {
    async fn open(&mut self) -> Result<Identity> {
        let identity = self.inner.open().await?;
        self.config.prove(self.inner.info())?;
        Ok(identity)
    }

    async fn health(&mut self) -> Result<Health> {
        self.inner.health().await
    }

    async fn make_safe(&mut self) -> Result<()> {
        self.inner.make_safe().await
    }
}

#[async_trait]
impl<C: Camera> Camera for Proven<C> {
    fn info(&self) -> &CameraInfo {
        self.inner.info()
    }

    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        self.inner.apply(settings).await
    }

    async fn arm(&mut self) -> Result<Armed> {
        self.inner.arm().await
    }

    async fn next_frame(&mut self) -> Result<Frame> {
        self.inner.next_frame().await
    }

    async fn stop(&mut self) -> Result<()> {
        self.inner.stop().await
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn config() -> CameraConfig {
        CameraConfig {
            name: "camera.ingaas".into(),
            port: "127.0.0.1".into(),
            serial: "S1".into(),
            width: 320,
            height: 256,
            format: PixelFormat::Mono12,
            shortest_s: 1e-4,
            longest_s: 60.0,
            readout_s: 0.01,
            frame_interval_s: 0.02,
            discard_frames: 1,
            v4l2: None,
            aravis: None,
        }
    }

    fn info() -> CameraInfo {
        CameraInfo {
            identity: Identity { model: "M".into(), firmware: "1".into(), serial: "S1".into() },
            width: 320,
            height: 256,
            format: PixelFormat::Mono12,
            shortest: ExposureTime(100),
            longest: ExposureTime(60_000_000),
        }
    }

    type Edit = fn(&mut CameraInfo);

    #[test]
    fn each_difference_from_the_description_is_a_wrong_device_in_one_sentence() {
        assert_eq!(config().prove(&info()), Ok(()));
        let changes: [(Edit, &str); 6] = [
            (|i| i.identity.serial = "S2".into(), "serial number \"S2\""),
            (|i| i.width = 640, "640 x 256"),
            (|i| i.height = 240, "320 x 240"),
            (|i| i.format = PixelFormat::Mono14, "Mono14"),
            (|i| i.shortest = ExposureTime(101), "exposes from"),
            (|i| i.longest = ExposureTime(59_999_999), "promises"),
        ];
        for (change, words) in changes {
            let mut other = info();
            change(&mut other);
            let error = config().prove(&other).unwrap_err();
            assert_eq!(error.kind, ErrorKind::WrongDevice);
            assert!(error.message.contains(words) && error.message.contains("instrument file"), "{error}");
        }
    }
}
