//! What the driver must be told about a camera: where it is, who it is, how it is to stream.

use super::wire_format::WireFormat;
use crate::devices::camera::{CameraConfig, Packing, TriggerKind};
use crate::error::{DeviceError, ErrorKind, Result};
use std::time::Duration;

/// How frames are begun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trigger {
    /// One frame for each command: no old frames, exact counting. Use it wherever the camera has it.
    Software,
    /// The camera runs by itself at this rate; frames are chosen by their time stamps.
    FreeRun {
        /// Frames a second; the camera lowers it where the exposure is longer.
        frame_rate_hz: f64,
    },
}

/// A reading that says whether the sensor's cooler holds its temperature (vendors name it differently).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cooler {
    /// Feature to read.
    pub feature: String,
    /// Its value when all is well.
    pub good: String,
}

/// All the driver must know. Start from [`AravisOptions::new`] and change what differs.
#[derive(Debug, Clone, PartialEq)]
pub struct AravisOptions {
    /// The device as the instrument file names it.
    pub name: String,
    /// IP address (fast, no discovery) or Aravis device id (`Vendor-Serial`, USB3 Vision).
    pub address: String,
    /// Serial number it must report.
    pub serial: String,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixel format on the wire.
    pub format: WireFormat,
    /// How frames are begun.
    pub trigger: Trigger,
    /// Read-out and transfer of one frame.
    pub readout: Duration,
    /// Frames after a change of settings that may still hold old ones.
    pub discard_frames: u32,
    /// What a frame may be late beyond exposure and read-out.
    pub margin: Duration,
    /// Limit for one command to the camera.
    pub command_limit: Duration,
    /// GVSP packet size with headers.
    pub packet_size: u32,
    /// Pause between packets that the camera is asked for, in nanoseconds.
    pub packet_delay_ns: u32,
    /// Heartbeat time-out the camera is asked for.
    pub heartbeat: Duration,
    /// Receive buffer of the stream's UDP socket.
    pub socket_buffer_bytes: i32,
    /// How long an incomplete frame is waited for before it is given up; later frames wait behind it.
    pub frame_retention: Duration,
    /// Buffers the camera library fills.
    pub buffers: usize,
    /// Frames that may live at once on our side.
    pub frames_in_flight: usize,
    /// Ask for integration time and frame id in the frame itself, where the camera offers it.
    pub chunks: bool,
    /// Reading of the cooler, where there is one.
    pub cooler: Option<Cooler>,
}

// === impl AravisOptions ===

impl AravisOptions {
    /// A software-triggered camera with sound settings for a link of its own.
    pub fn new(name: &str, address: &str, serial: &str) -> AravisOptions {
        AravisOptions {
            name: name.to_owned(),
            address: address.to_owned(),
            serial: serial.to_owned(),
            width: 320,
            height: 256,
            format: WireFormat::Mono12,
            trigger: Trigger::Software,
            readout: Duration::from_millis(50),
            discard_frames: 0,
            margin: Duration::from_millis(1500),
            command_limit: Duration::from_secs(3),
            packet_size: 8000,
            packet_delay_ns: 0,
            heartbeat: Duration::from_secs(3),
            socket_buffer_bytes: 4 << 20,
            frame_retention: Duration::from_millis(500),
            buffers: 16,
            frames_in_flight: 16,
            chunks: true,
            cooler: None,
        }
    }

    /// The camera of an instrument file.
    ///
    /// # Errors
    /// `Refused`: a pixel format that is not read.
    pub fn of(camera: &CameraConfig) -> Result<AravisOptions> {
        let table = camera.aravis.clone().unwrap_or_default();
        let plain = AravisOptions::new(&camera.name, &camera.port, &camera.serial);
        let packing = table.packing.unwrap_or(Packing::Words);
        let format = WireFormat::of(camera.format, packing).ok_or_else(|| {
            let message =
                format!("the driver `aravis` reads no {:?} packed as {packing:?}; change `format`", camera.format);
            DeviceError::new(ErrorKind::Refused, &camera.name, message)
        })?;
        let seconds = |s: Option<f64>, plain: Duration| s.map_or(plain, Duration::from_secs_f64);
        Ok(AravisOptions {
            width: camera.width,
            height: camera.height,
            format,
            trigger: match table.trigger {
                Some(TriggerKind::FreeRun) => {
                    let fastest = 1.0 / camera.frame_interval_s.max(1e-4);
                    Trigger::FreeRun { frame_rate_hz: table.frame_rate_hz.unwrap_or(fastest) }
                }
                _ => Trigger::Software,
            },
            readout: Duration::from_secs_f64(camera.readout_s),
            discard_frames: camera.discard_frames,
            margin: seconds(table.margin_s, plain.margin),
            command_limit: seconds(table.command_limit_s, plain.command_limit),
            packet_size: table.packet_size_bytes.unwrap_or(plain.packet_size),
            packet_delay_ns: table.packet_delay_ns.unwrap_or(plain.packet_delay_ns),
            heartbeat: seconds(table.heartbeat_s, plain.heartbeat),
            socket_buffer_bytes: table.socket_buffer_bytes.map_or(plain.socket_buffer_bytes, |b| b as i32),
            frame_retention: seconds(table.frame_retention_s, plain.frame_retention),
            chunks: table.chunks.unwrap_or(plain.chunks),
            cooler: table.cooler.map(|c| Cooler { feature: c.feature, good: c.good }),
            ..plain
        })
    }

    /// The device and where it is, for messages.
    pub fn label(&self) -> String {
        format!("{} ({})", self.name, self.address)
    }
}
