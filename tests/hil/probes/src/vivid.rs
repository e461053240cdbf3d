//! `vivid`, the kernel's test driver: its fault injections, each seen by the production driver as what it is. It has no
//! exposure control; brightness stands in for one.

use crate::ensure;
use crate::report::{Outcome, Report};
use crate::v4l2::{acquire, nodes};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, CameraSettings, Device};
use goniod_drivers::devices::v4l2::config::GAIN;
use goniod_drivers::devices::v4l2::{ScaledControl, V4l2Camera, V4l2Config};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::frame::PixelFormat;
use goniod_drivers::units::ExposureTime;
use std::time::Duration;
use v4l::control::{Control, Value};

const CARD: &str = "vivid";
const BRIGHTNESS: u32 = 0x0098_0900;
const AUTOGAIN: u32 = 0x0098_0912;
const LIMIT: Duration = Duration::from_secs(90);

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("gain-under-automatic-gain", LIMIT, automatic_gain()).await;
    report.check("dropped-buffers-are-gaps", LIMIT, dropped()).await;
    report.check("error-flags-are-damage", LIMIT, flagged()).await;
    report.check("a-stream-that-fails-is-started-again", LIMIT, fatal()).await;
    report.check("a-start-that-fails-is-said", LIMIT, no_start()).await;
    report.check("a-disconnected-camera-is-lost-and-opened-again", LIMIT, disconnected()).await;
}

/// The device through a second file, as another program would have it.
struct Other(v4l::Device);

impl Other {
    fn open() -> Result<Other, Error> {
        let (node, _) = nodes(CARD).into_iter().next().ok_or("vivid has no node")?;
        Ok(Other(v4l::Device::with_path(node)?))
    }

    fn set(&self, id: u32, value: i64) -> Result<(), Error> {
        Ok(self.0.set_control(Control { id, value: Value::Integer(value) })?)
    }

    fn get(&self, id: u32) -> Result<i64, Error> {
        match self.0.control(id)?.value {
            Value::Integer(value) => Ok(value),
            Value::Boolean(value) => Ok(i64::from(value)),
            _ => Err("a control without a number".into()),
        }
    }

    /// Sets, or presses, the fault of this name.
    fn fault(&self, name: &str, value: i64) -> Result<(), Error> {
        let all = self.0.query_controls()?;
        let found = all.iter().find(|c| c.name == name).ok_or_else(|| format!("vivid has no control \"{name}\""))?;
        self.set(found.id, value)
    }
}

fn settings(brightness: u64, gain: f64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(brightness * 1000), gain }
}

async fn open() -> Result<V4l2Camera, Error> {
    let (node, _) = nodes(CARD).into_iter().next().ok_or("vivid has no node")?;
    let config = V4l2Config {
        card: CARD.into(),
        format: Some(PixelFormat::Mono8),
        exposure: ScaledControl { id: BRIGHTNESS, scale: 1e-3, offset: 0.0 },
        gain: Some(ScaledControl { id: GAIN, scale: 1.0, offset: 0.0 }),
        settle_frames: 2,
        shortest_s: 1e-3,
        longest_s: 0.255,
        command_limit: Duration::from_secs(30),
        ..V4l2Config::new("camera.ccd", node, 640, 360)
    };
    let mut camera = V4l2Camera::new(config, Clock::system());
    camera.open().await?;
    Ok(camera)
}

/// Under automatic gain a written gain is accepted and ignored: only the read-back tells.
async fn automatic_gain() -> Outcome {
    let other = Other::open()?;
    other.set(AUTOGAIN, 1)?;
    other.set(GAIN, 33)?;
    let ignored = other.get(GAIN)?;
    let mut camera = open().await?;
    other.set(AUTOGAIN, 1)?;
    let want = settings(100, 77.0);
    let acquired = acquire(&mut camera, want, 1).await?;
    ensure!(acquired.kept.iter().all(|f| f.info.settings == want), "settings {:?}", acquired.kept[0].info.settings);
    let now = (other.get(AUTOGAIN)?, other.get(GAIN)?);
    ensure!(now == (0, 77), "automatic gain and gain are {now:?}");
    other.set(AUTOGAIN, 1)?;
    let armed = camera.arm().await;
    let now = (other.get(AUTOGAIN)?, other.get(GAIN)?);
    let noticed = match &armed {
        Ok(_) => now == (0, 77),
        Err(error) => error.message.contains("changed by themselves"),
    };
    ensure!(noticed, "armed {armed:?} with automatic gain and gain {now:?}");
    acquire(&mut camera, want, 1).await?;
    camera.make_safe().await?;
    Ok(format!("a gain of 33 under automatic gain reads {ignored}; the driver switches it off and proves 77"))
}

async fn dropped() -> Outcome {
    let other = Other::open()?;
    let mut camera = open().await?;
    let first = acquire(&mut camera, settings(100, 10.0), 1).await?.kept.remove(0).info.device_frame_id;
    let before = camera.counters().await?;
    other.fault("Percentage of Dropped Buffers", 30)?;
    let (mut last, mut gaps) = (first, 0);
    for _ in 0..40 {
        let id = camera.next_frame().await?.info.device_frame_id;
        gaps += id - last - 1;
        last = id;
    }
    other.fault("Percentage of Dropped Buffers", 0)?;
    let after = camera.counters().await?;
    camera.make_safe().await?;
    ensure!(gaps > 0, "no frame was lost");
    ensure!(after.lost - before.lost >= gaps, "{gaps} in the frames' numbers, {after:?}");
    Ok(format!("{gaps} frames missing among 40, all visible in the numbers; {after:?}"))
}

async fn flagged() -> Outcome {
    let other = Other::open()?;
    let mut camera = open().await?;
    acquire(&mut camera, settings(100, 10.0), 1).await?;
    let mut damaged = 0;
    for _ in 0..3 {
        other.fault("Inject V4L2_BUF_FLAG_ERROR", 1)?;
        for _ in 0..6 {
            damaged += u32::from(camera.next_frame().await?.info.damaged);
        }
    }
    let counters = camera.counters().await?;
    camera.make_safe().await?;
    ensure!(damaged == 3 && counters.damaged == 3, "3 flags, {damaged} frames marked, {counters:?}");
    Ok(format!("3 flags, 3 frames marked; {counters:?}"))
}

async fn fatal() -> Outcome {
    let other = Other::open()?;
    let mut camera = open().await?;
    let want = settings(100, 10.0);
    acquire(&mut camera, want, 1).await?;
    other.fault("Inject Fatal Streaming Error", 1)?;
    let mut said = Vec::new();
    let mut good = 0;
    for _ in 0..20 {
        match camera.next_frame().await {
            Ok(frame) if !frame.info.damaged => good += 1,
            Ok(_) => {}
            Err(error) => {
                said.push(error.to_string());
                acquire(&mut camera, want, 1).await?;
            }
        }
    }
    let counters = camera.counters().await?;
    camera.make_safe().await?;
    ensure!(good > 0, "no frame after the error: {said:?}");
    ensure!(counters.restarts > 0 || !said.is_empty(), "the error went unnoticed: {counters:?}");
    Ok(format!("{good} good frames, said {said:?}; {counters:?}"))
}

async fn no_start() -> Outcome {
    let other = Other::open()?;
    let mut said = Vec::new();
    for fault in ["Inject VIDIOC_REQBUFS Error", "Inject VIDIOC_QBUF Error", "Inject VIDIOC_STREAMON Error"] {
        let mut camera = open().await?;
        other.fault(fault, 1)?;
        let error = camera.apply(settings(100, 10.0)).await.err().ok_or_else(|| format!("{fault} went unnoticed"))?;
        said.push(format!("{:?}", error.kind));
        acquire(&mut camera, settings(100, 10.0), 1).await?;
        camera.make_safe().await?;
    }
    Ok(format!("three failing starts said as {said:?}, the next ones work"))
}

async fn disconnected() -> Outcome {
    let mut camera = open().await?;
    let want = settings(100, 10.0);
    acquire(&mut camera, want, 1).await?;
    // The node comes back when the last program has closed it.
    Other::open()?.fault("Disconnect", 1)?;
    let mut said = None;
    for _ in 0..20 {
        if let Err(error) = camera.next_frame().await {
            said = Some(error);
            break;
        }
    }
    let said = said.ok_or("frames come from a disconnected camera")?;
    ensure!(said.kind == ErrorKind::Lost, "{:?}: {said}", said.kind);
    camera.open().await?;
    acquire(&mut camera, want, 1).await?;
    camera.make_safe().await?;
    Ok(said.message)
}
