//! A twin and a driver on one loopback address, and the guard that decides what counts as data.

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Armed, Camera, CameraSettings, Device};
use goniod_drivers::devices::aravis::{AravisCamera, AravisOptions, WireFormat};
use goniod_drivers::frame::Frame;
use goniod_drivers::units::ExposureTime;
use goniod_sim::gige::{GigeTwin, Painted, PixelCode, Reading, Sensor, TwinConfig};
use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use tokio::sync::{Mutex, MutexGuard};
use tokio::time::Instant;

/// Real time and two cores: one test at a time.
static ONE_AT_A_TIME: Mutex<()> = Mutex::const_new(());
static NEXT: AtomicU8 = AtomicU8::new(1);

/// True where the full counts were asked for.
pub fn full() -> bool {
    std::env::var_os("GONIOD_FULL").is_some_and(|v| v == "1")
}

/// Waits until no other test of this program runs.
pub async fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().await
}

/// A loopback address that no other test has, in this process or another one.
pub fn address() -> Ipv4Addr {
    let [.., high, low] = std::process::id().to_be_bytes();
    Ipv4Addr::new(127, 1 + high % 250, low, NEXT.fetch_add(1, Ordering::SeqCst))
}

/// A 320 x 256 twin whose exposures take no time, after `change`.
pub fn twin(change: impl FnOnce(&mut TwinConfig)) -> GigeTwin {
    let mut config = TwinConfig::quick(address(), "SU320-0042");
    change(&mut config);
    GigeTwin::start(config, Arc::new(Painted)).expect("the loopback address is free")
}

/// A sensor of this size and format.
pub fn sensor(width: u32, height: u32, format: PixelCode) -> Sensor {
    Sensor { width, height, format, ..Sensor::default() }
}

/// Options that fit `twin` after `change`; patient, since a busy machine can hold a thread for seconds.
pub fn options(twin: &GigeTwin, change: impl FnOnce(&mut AravisOptions)) -> AravisOptions {
    let mut options = AravisOptions::new("camera.ingaas", &twin.address(), "SU320-0042");
    options.margin = std::time::Duration::from_secs(10);
    change(&mut options);
    options
}

/// A driver over `options`, open.
pub async fn open(options: AravisOptions) -> AravisCamera {
    let mut camera = AravisCamera::new(options, Clock::system());
    camera.open().await.expect("the twin opens");
    camera
}

/// Settings with this integration time.
pub fn settings(exposure_us: u64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(exposure_us), gain: 0.0 }
}

/// Applies, arms and takes one frame; an incomplete one, which a busy machine can cause, is retaken.
pub async fn snap(camera: &mut AravisCamera, exposure_us: u64) -> goniod_drivers::error::Result<Frame> {
    camera.apply(settings(exposure_us)).await?;
    camera.arm().await?;
    for _ in 0..4 {
        let frame = camera.next_frame().await?;
        if !frame.info.damaged {
            return Ok(frame);
        }
    }
    camera.next_frame().await
}

/// What a frame's pixels say about it.
pub fn read(frame: &Frame, format: WireFormat) -> Reading {
    let top = (format.frame_format().levels() - 1) as u16;
    let pixels = frame.info.width * frame.info.height;
    if frame.pixels.len() != pixels {
        return Reading::Damaged;
    }
    Painted::read(frame.info.width, frame.info.height, top, |i| frame.pixels.level(i))
}

/// Why a frame is not data.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reject {
    /// Incomplete or of the wrong shape.
    Damaged,
    /// Began before the arm, or not after the frame before.
    Old,
    /// The device's frame counter jumped.
    Gap,
    /// Equal to a frame seen lately.
    Repeated,
    /// Carries other settings than ordered.
    Settings,
}

/// The rules by which a frame is data, as the daemon's guard has them.
#[derive(Default)]
pub struct Guard {
    last_id: Option<u64>,
    last_start: Option<Instant>,
    recent: VecDeque<u64>,
}

impl Guard {
    /// Judges a frame that follows the last one judged. `ordered`: `None` while frames are only thrown away.
    pub fn judge(&mut self, frame: &Frame, armed: &Armed, ordered: Option<CameraSettings>) -> Result<(), Reject> {
        let info = &frame.info;
        let jumped = self.last_id.is_some_and(|last| info.device_frame_id != last + 1);
        let advanced = self.last_start.is_none_or(|last| info.exposure_start > last);
        self.last_id = Some(info.device_frame_id);
        self.last_start = self.last_start.max(Some(info.exposure_start));
        if info.damaged {
            return Err(Reject::Damaged);
        }
        let mut hasher = DefaultHasher::new();
        match &frame.pixels {
            goniod_drivers::frame::Pixels::U8(v) => v.hash(&mut hasher),
            goniod_drivers::frame::Pixels::U16(v) => v.hash(&mut hasher),
        }
        let digest = hasher.finish();
        let seen = self.recent.contains(&digest);
        self.recent.push_front(digest);
        self.recent.truncate(16);
        match () {
            () if info.exposure_start < armed.not_before || !advanced => Err(Reject::Old),
            () if seen => Err(Reject::Repeated),
            () if jumped => Err(Reject::Gap),
            () if ordered.is_some_and(|o| o != info.settings) => Err(Reject::Settings),
            () => Ok(()),
        }
    }

    /// An arm threw frames away: their number is not known here.
    pub fn armed(&mut self) {
        self.last_id = None;
    }
}
