//! A camera on its twin, and a small acquire loop that keeps the contract: arm, then take only frames that prove themselves.

use crate::shim::doors::{self, locked};
use crate::shim::paint::Truth;
use crate::shim::twin::{Plan, Twin};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, CameraSettings, Device};
use goniod_drivers::devices::v4l2::{V4l2Camera, V4l2Config};
use goniod_drivers::frame::{Frame, Pixels};
use goniod_drivers::units::ExposureTime;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

/// A camera and its twin.
pub struct Bench {
    /// The driver.
    pub camera: V4l2Camera,
    twin: Arc<Mutex<Twin>>,
}

/// What the acquire loop saw for one exposure.
pub struct Acquired {
    /// The frames it kept.
    pub frames: Vec<Frame>,
    /// Frames it rejected among them.
    pub rejected: u64,
}

/// Node of a twin by name; stable, with a serial number.
pub fn node(name: &str) -> String {
    format!("/dev/v4l/by-id/usb-Kappa_{name}_SN42-video-index0")
}

/// The configuration that fits the twin, with N = 6 for latencies up to 5.
pub fn config(name: &str) -> V4l2Config {
    V4l2Config {
        card: "Kappa DX".into(),
        serial: "SN42".into(),
        settle_frames: 6,
        command_limit: Duration::from_secs(20),
        ..V4l2Config::new(name, node(name), 64, 48)
    }
}

/// Settings of a raw exposure (100 us) and a gain.
pub fn settings(raw_exposure: u64, gain: f64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(raw_exposure * 100), gain }
}

/// The truth painted into a frame of 8-bit values.
pub fn truth(frame: &Frame) -> Option<Truth> {
    match &frame.pixels {
        Pixels::U8(v) => Truth::read(v),
        Pixels::U16(v) => Truth::read(&v.iter().map(|w| *w as u8).collect::<Vec<_>>()),
    }
}

/// The frame shows in both halves what its label says.
pub fn label_is_true(frame: &Frame) -> bool {
    let label = frame.info.settings;
    let raw = (label.exposure.0 / 100) as u32;
    truth(frame).is_some_and(|t| t.upper == raw && t.lower == raw && f64::from(t.gain) == label.gain)
}

// === impl Bench ===

impl Bench {
    /// A twin of this plan, plugged in, and a camera with this configuration, not yet opened.
    pub fn closed(plan: Plan, config: V4l2Config) -> Bench {
        let twin = doors::plug(&config.node.to_string_lossy(), Twin::new(plan));
        Bench { camera: V4l2Camera::new(config, Clock::system()), twin }
    }

    /// The same, opened.
    pub async fn open(plan: Plan, config: V4l2Config) -> Bench {
        let mut bench = Bench::closed(plan, config);
        bench.camera.open().await.expect("the twin opens");
        bench
    }

    /// The twin.
    pub fn twin(&self) -> MutexGuard<'_, Twin> {
        locked(&self.twin)
    }

    /// One frame under these settings that proves itself.
    pub async fn acquire(&mut self, want: CameraSettings) -> Frame {
        self.acquire_several(want, 1).await.frames.remove(0)
    }

    /// Applies, arms and takes frames until `count` have proven themselves: not odd, next in number, started after the
    /// arming, with the settings asked for.
    pub async fn acquire_several(&mut self, want: CameraSettings, count: usize) -> Acquired {
        let applied = self.camera.apply(want).await.expect("settings apply");
        assert_eq!(applied, want, "read back as commanded");
        let armed = self.camera.arm().await.expect("arms");
        let mut acquired = Acquired { frames: Vec::new(), rejected: 0 };
        let mut last = None;
        while acquired.frames.len() < count {
            let frame = self.camera.next_frame().await.expect("a frame comes");
            let id = frame.info.device_frame_id;
            let gap = last.is_some_and(|l: u64| id != l + 1);
            last = Some(last.unwrap_or(0).max(id));
            let early = frame.info.exposure_start < armed.not_before;
            if frame.info.damaged || gap || early || frame.info.settings != want {
                acquired.rejected += 1;
            } else {
                acquired.frames.push(frame);
            }
        }
        acquired
    }
}
