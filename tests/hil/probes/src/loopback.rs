//! `v4l2loopback`: a program feeds the node with painted pictures, the production driver reads it. Its frames carry no
//! numbers, and its "timeout" control stands in for an exposure.

use crate::ensure;
use crate::report::{Outcome, Report};
use crate::v4l2::acquire;
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{Camera, CameraSettings, Device};
use goniod_drivers::devices::v4l2::{ScaledControl, V4l2Camera, V4l2Config};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::frame::PixelFormat;
use goniod_drivers::units::ExposureTime;
use goniod_sim::scene::{ExposureRequest, Painted, Reading, Scene};
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::time::Instant;
use v4l::video::Output;
use v4l::{Format, FourCC};

const NODE: &str = "/dev/video20";
/// "timeout" of v4l2loopback, in milliseconds.
const TIMEOUT: u32 = 0x0098_f902;
const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Time from frame to frame.
const PERIOD: Duration = Duration::from_millis(50);
const LIMIT: Duration = Duration::from_secs(90);

/// A program that feeds the node with what the control asks for.
struct Producer {
    stop: Arc<AtomicBool>,
    frames: Arc<AtomicU64>,
    thread: Option<JoinHandle<std::io::Result<()>>>,
}

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("without-a-producer-it-is-no-camera", LIMIT, empty()).await;
    report.check("labels-without-frame-numbers", LIMIT, labels()).await;
    report.check("a-producer-that-ends-is-noticed", LIMIT, ends()).await;
}

fn config() -> V4l2Config {
    V4l2Config {
        format: Some(PixelFormat::Mono8),
        exposure: ScaledControl { id: TIMEOUT, scale: 1e-3, offset: 0.0 },
        gain: None,
        settle_frames: 8,
        frame_interval_s: PERIOD.as_secs_f64(),
        shortest_s: 1e-3,
        command_limit: Duration::from_secs(30),
        ..V4l2Config::new("camera.ccd", NODE, WIDTH as u32, HEIGHT as u32)
    }
}

fn settings(exposure_ms: u64) -> CameraSettings {
    CameraSettings { exposure: ExposureTime(exposure_ms * 1000), gain: 0.0 }
}

async fn empty() -> Outcome {
    let mut camera = V4l2Camera::new(config(), Clock::system());
    match camera.open().await {
        Err(error) if error.kind == ErrorKind::WrongDevice => Ok(error.message),
        other => Err(format!("opened: {other:?}").into()),
    }
}

async fn labels() -> Outcome {
    let mut producer = Producer::start()?;
    producer.wait(3).await?;
    let mut camera = V4l2Camera::new(config(), Clock::system());
    camera.open().await?;
    let (mut kept, mut refused, mut wrong) = (0, 0, Vec::new());
    for exposure_ms in [300, 700, 400, 900, 350] {
        let want = settings(exposure_ms);
        let acquired = acquire(&mut camera, want, 2).await?;
        refused += acquired.refused;
        for frame in &acquired.kept {
            kept += 1;
            match Painted::read(WIDTH, HEIGHT, 0xff, |i| frame.pixels.level(i)) {
                Reading::Whole(tag) if tag.exposure_us == frame.info.settings.exposure.0 => {}
                reading => wrong.push(format!("{reading:?} under {:?}", frame.info.settings)),
            }
        }
    }
    let counters = camera.counters().await?;
    camera.make_safe().await?;
    producer.end()?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    Ok(format!("{kept} frames kept, 0 wrong labels, {refused} refused; {counters:?}"))
}

async fn ends() -> Outcome {
    let mut producer = Producer::start()?;
    producer.wait(3).await?;
    let mut camera = V4l2Camera::new(config(), Clock::system());
    camera.open().await?;
    let want = settings(90_000);
    let refused = camera.apply(want).await.err().ok_or("90 s are beyond the configured longest exposure")?;
    ensure!(refused.kind == ErrorKind::Refused, "{refused}");
    acquire(&mut camera, settings(300), 1).await?;
    producer.end()?;
    camera.arm().await?;
    let clock = Clock::system();
    // What the module shows without a producer is its own business; a frame that is data it must not be.
    while clock.elapsed() < Duration::from_secs(20) {
        match camera.next_frame().await {
            Ok(frame) => {
                let reading = Painted::read(WIDTH, HEIGHT, 0xff, |i| frame.pixels.level(i));
                let flat = (1..frame.pixels.len()).all(|i| frame.pixels.level(i) == frame.pixels.level(0));
                ensure!(frame.info.damaged || flat, "an old picture passed as a new one: {reading:?}");
            }
            Err(error) => {
                ensure!(matches!(error.kind, ErrorKind::Lost | ErrorKind::Timeout), "{:?}: {error}", error.kind);
                camera.make_safe().await?;
                return Ok(format!("{:?}: {}", error.kind, error.message));
            }
        }
    }
    camera.make_safe().await?;
    Ok("only flat or marked pictures".to_owned())
}

// === impl Producer ===

impl Producer {
    fn start() -> std::io::Result<Producer> {
        let (stop, frames) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let (stopping, counting) = (Arc::clone(&stop), Arc::clone(&frames));
        let thread =
            std::thread::Builder::new().name("producer".into()).spawn(move || produce(&stopping, &counting))?;
        Ok(Producer { stop, frames, thread: Some(thread) })
    }

    async fn wait(&mut self, frames: u64) -> Result<(), String> {
        let clock = Clock::system();
        while self.frames.load(Ordering::SeqCst) < frames {
            if clock.elapsed() > Duration::from_secs(30) {
                return Err(format!("the producer made no frames: {:?}", self.end()));
            }
            clock.sleep(Duration::from_millis(20)).await;
        }
        Ok(())
    }

    fn end(&mut self) -> std::io::Result<()> {
        self.stop.store(true, Ordering::SeqCst);
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(std::io::Error::other("the producer panicked")),
            None => Ok(()),
        }
    }
}

fn produce(stop: &AtomicBool, frames: &AtomicU64) -> std::io::Result<()> {
    let mut device = v4l::Device::with_path(NODE)?;
    Output::set_format(&device, &Format::new(WIDTH as u32, HEIGHT as u32, FourCC::new(b"GREY")))?;
    // Written, not mapped: then the module takes its buffers in turn, and a reader has many frames' time for its copy.
    let (mut levels, mut picture) = (vec![0_u16; WIDTH * HEIGHT], vec![0_u8; WIDTH * HEIGHT]);
    while !stop.load(Ordering::SeqCst) {
        let exposure_ms = match device.control(TIMEOUT)?.value {
            v4l::control::Value::Integer(value) => value,
            _ => 0,
        };
        let request = ExposureRequest {
            frame_number: frames.load(Ordering::SeqCst) + 1,
            host_count: frames.load(Ordering::SeqCst) + 1,
            exposure_us: exposure_ms as f64 * 1e3,
            gain_db: 0.0,
            started: Instant::now(),
            width: WIDTH,
            height: HEIGHT,
            max_level: 0xff,
        };
        Painted.render(&request, &mut levels);
        picture.iter_mut().zip(&levels).for_each(|(byte, level)| *byte = *level as u8);
        device.write_all(&picture)?;
        frames.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(PERIOD);
    }
    Ok(())
}
