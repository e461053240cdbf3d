//! The UVC twin behind USB/IP, the kernel's `uvcvideo` and the production V4L2 driver, all on this machine.

pub mod labels;
pub mod losses;
pub mod unplug;

use crate::v4l2::{self, Acquired};
use crate::vhci::{self, Attached};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{CameraSettings, Device};
use goniod_drivers::devices::v4l2::config::GAMMA;
use goniod_drivers::devices::v4l2::{V4l2Camera, V4l2Config};
use goniod_drivers::frame::{Frame, PixelFormat};
use goniod_sim::front::usbip::UsbIpServer;
use goniod_sim::scene::{Painted, Reading, Tag};
use goniod_sim::uvc::{Mode, Truth, UvcConfig, UvcFormat, UvcTwin};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Card name, from the twin's product string.
pub const CARD: &str = "Colour CCD twin";
/// Serial number.
pub const SERIAL: &str = "SN42";
/// Bus id at the server.
pub const BUSID: &str = "1-1";
const BRIGHTNESS: u32 = 0x0098_0900;

/// The camera with everything behind it.
pub struct Bench {
    /// The driver.
    pub camera: V4l2Camera,
    /// The server.
    pub server: UsbIpServer,
    twin: Arc<Mutex<UvcTwin>>,
    attached: Attached,
    mode: Mode,
}

/// The large mosaic.
pub fn mosaic() -> Mode {
    Mode::ALL[0]
}

/// The small picture of one value a pixel.
pub fn grey() -> Mode {
    Mode::ALL[2]
}

/// The configuration that fits the twin in `mode`: gamma and brightness neutral; N = 8 frames until a change is
/// sure, for latencies up to 5 with a half-changed and a stale frame after them, N = 4 at the large size.
pub fn config(node: PathBuf, mode: Mode) -> V4l2Config {
    let format = match mode.format {
        UvcFormat::Rggb => PixelFormat::BayerRggb8,
        UvcFormat::Yuyv => PixelFormat::Yuyv8,
        UvcFormat::Grey => PixelFormat::Mono8,
        UvcFormat::Y16 => PixelFormat::Mono16,
    };
    V4l2Config {
        card: CARD.into(),
        serial: SERIAL.into(),
        format: Some(format),
        fixed: vec![(GAMMA, 100), (BRIGHTNESS, 0)],
        settle_frames: if mode.format == UvcFormat::Rggb { 4 } else { 8 },
        frame_interval_s: if mode.format == UvcFormat::Rggb { 0.15 } else { 0.04 },
        command_limit: std::time::Duration::from_secs(30),
        ..V4l2Config::new("camera.ccd", node, u32::from(mode.width), u32::from(mode.height))
    }
}

// === impl Bench ===

impl Bench {
    /// A twin plugged into this machine, opened by the driver.
    pub async fn open(mode: Mode) -> Result<Bench, Box<dyn std::error::Error + Send + Sync>> {
        let server = UsbIpServer::start("127.0.0.1:0")?;
        let twin = Arc::new(Mutex::new(UvcTwin::new(UvcConfig::new(SERIAL), Arc::new(Painted))));
        server.plug(BUSID, Arc::clone(&twin));
        let attached = vhci::attach(server.address(), BUSID)?;
        let node = v4l2::link(CARD).await?;
        let mut camera = V4l2Camera::new(config(node, mode), Clock::system());
        camera.open().await?;
        Ok(Bench { camera, server, twin, attached, mode })
    }

    /// The twin.
    pub fn twin(&self) -> MutexGuard<'_, UvcTwin> {
        self.twin.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Pulls the plug at the device's end: the host's connection drops.
    pub fn pull(&self) {
        self.server.unplug(BUSID);
    }

    /// Plugs the same camera in again, with power-up settings.
    pub async fn plug(&mut self) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        self.server.plug(BUSID, Arc::clone(&self.twin));
        self.attached = vhci::attach(self.server.address(), BUSID)?;
        v4l2::link(CARD).await?;
        Ok(())
    }

    /// Pulls out and waits until the kernel has noticed.
    pub async fn close(mut self) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
        self.camera.make_safe().await?;
        self.attached.detach()?;
        v4l2::gone(CARD).await?;
        Ok(())
    }

    /// What a frame's pixels say.
    pub fn read(&self, frame: &Frame) -> Reading {
        let (width, height) = (usize::from(self.mode.width), usize::from(self.mode.height));
        let step = frame.info.format.values_per_pixel();
        if frame.pixels.len() != width * height * step {
            return Reading::Damaged;
        }
        Painted::read(width, height, self.mode.format.max_level(), |i| frame.pixels.level(i * step))
    }

    /// The twin's record of a picture: the first frame that showed it.
    pub fn truth(&self, tag: Tag) -> Option<Truth> {
        self.twin().truth().iter().rev().filter(|t| t.frame_number == tag.frame_number).last().cloned()
    }

    /// Frames whose label is not what the pixels and the twin's record say, each with the reason.
    pub fn wrong(&self, acquired: &Acquired, want: CameraSettings) -> Vec<String> {
        acquired.kept.iter().filter_map(|frame| self.why_wrong(frame, acquired, want)).collect()
    }

    fn why_wrong(&self, frame: &Frame, acquired: &Acquired, want: CameraSettings) -> Option<String> {
        let label = frame.info.settings;
        let Reading::Whole(tag) = self.read(frame) else {
            return Some(format!("{:?} under the label {label:?}", self.read(frame)));
        };
        let truth = self.truth(tag)?;
        let gain = f64::from(truth.settings.gain);
        if label != want || tag.exposure_us != label.exposure.0 || gain != label.gain {
            return Some(format!("asked {want:?}, label {label:?}, pixels {tag:?}, gain {gain}"));
        }
        let early = acquired.armed.not_before.checked_duration_since(truth.started);
        early.filter(|t| !t.is_zero()).map(|t| format!("began {t:?} before the bench stood: {tag:?}"))
    }
}
