//! Simulated cameras: a free-running sensor behind a register pipeline and a short queue, photographing the true pose.
//!
//! A frame is rendered only when it is read. Like a V4L2 camera it cannot tell what exposure a frame really had: the
//! frame carries the settings as read back from the registers, the painted truth carries what the sensor did.

use crate::bench::Surroundings;
use crate::paint::PaintedTruth;
use crate::pose::Pose;
use crate::stream::{Shot, Stream, Timing};
use crate::truth::config::TimingFile;
use crate::truth::photo::{Exposure, Photographer};
use async_trait::async_trait;
use goniod_drivers::contract::{Armed, Camera, CameraInfo, CameraSettings, Device, Health, Identity};
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::frame::{Frame, FrameInfo, FramePool, Pixels};
use goniod_drivers::units::ExposureTime;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// What may go wrong with the next frame that is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraFault {
    /// It never comes.
    NoFrame,
    /// It comes late by this much.
    Late(Duration),
    /// The picture before is given once more under the new id.
    Stale,
    /// The frame before is given once more, with its old id and time.
    Repeated,
    /// All levels 0, painted rows too (signal lost before the grabber).
    Black,
    /// Cut in the middle, flagged as damaged.
    Truncated,
    /// The sensor integrates this long while the registers say otherwise.
    WrongExposure(ExposureTime),
    /// One frame is lost on the way, its id with it.
    SkippedId,
    /// Nothing comes any more until the camera is opened again.
    Hang,
    /// The camera is gone until it is opened again.
    Lost,
    /// The camera is gone, and its settings with it: opened again, it has those of the factory.
    Forgets,
    /// The next setting that changes something is swallowed: the registers keep what they had.
    NotTaken,
    /// The driver panics.
    Panic,
}

/// Faults to come, in order; one is taken by each frame read. Clones share the queue.
#[derive(Debug, Clone, Default)]
pub struct FaultQueue(Arc<Mutex<VecDeque<Option<CameraFault>>>>);

/// A simulated camera.
pub struct SimCamera {
    name: String,
    photographer: Arc<Photographer>,
    surroundings: Surroundings,
    info: CameraInfo,
    pool: FramePool,
    next_id: Arc<AtomicU64>,
    faults: FaultQueue,
    registers: CameraSettings,
    stream: Option<Stream>,
    open: bool,
    last: Option<Shot>,
    held: Option<CameraFault>,
}

/// What a rendering needs; runs off the runtime.
struct Job {
    shot: Shot,
    name: String,
    surroundings: Surroundings,
}

/// One camera before its bench.
pub(crate) struct Look<'a> {
    pub(crate) photographer: &'a Photographer,
    pub(crate) surroundings: &'a Surroundings,
    pub(crate) name: &'a str,
}

/// Frames of one camera that may live at once.
const POOL: usize = 8;
/// Longest wait for a free buffer.
const POOL_WAIT: Duration = Duration::from_secs(30);
/// Slack over exposure and read-out before a frame counts as missing.
const MARGIN: Duration = Duration::from_secs(2);
/// Rest of a camera that hangs.
const HANG: Duration = Duration::from_secs(3600);
/// Instants of an exposure at which the pose is looked at.
const LOOKS: u32 = 8;

// === impl FaultQueue ===

impl FaultQueue {
    /// Adds a fault for the next frame that has none yet.
    pub fn push(&self, fault: CameraFault) {
        self.add(Some(fault));
    }

    /// Lets `frames` frames pass well before the next fault.
    pub fn pass(&self, frames: usize) {
        (0..frames).for_each(|_| self.add(None));
    }

    /// Faults and good frames still to come.
    pub fn len(&self) -> usize {
        self.0.lock().map_or(0, |q| q.len())
    }

    /// Nothing is to come.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn add(&self, entry: Option<CameraFault>) {
        if let Ok(mut queue) = self.0.lock() {
            queue.push_back(entry);
        }
    }

    /// The fault of the frame that is read next; one that waits for a setting stays.
    fn take(&self) -> Option<CameraFault> {
        let mut queue = self.0.lock().ok()?;
        if queue.front() == Some(&Some(CameraFault::NotTaken)) { None } else { queue.pop_front().flatten() }
    }

    /// True when the setting that is made now is to be swallowed.
    fn swallows(&self) -> bool {
        let swallows = |queue: &mut VecDeque<Option<CameraFault>>| {
            let next = queue.front() == Some(&Some(CameraFault::NotTaken));
            next && queue.pop_front().is_some()
        };
        self.0.lock().is_ok_and(|mut queue| swallows(&mut queue))
    }
}

// === impl SimCamera ===

impl SimCamera {
    /// The camera `name`; frame ids go on where `next_id` stands.
    pub fn new(
        name: &str,
        photographer: Arc<Photographer>,
        surroundings: Surroundings,
        next_id: Arc<AtomicU64>,
        faults: FaultQueue,
    ) -> SimCamera {
        let file = &photographer.file;
        let (shortest, longest) = (file.timing.shortest_s, file.timing.longest_s);
        let info = CameraInfo {
            identity: Identity { model: file.model.clone(), firmware: "sim 1".to_owned(), serial: file.serial.clone() },
            width: file.width_px,
            height: file.height_px,
            format: file.format,
            shortest: ExposureTime::from_seconds(shortest),
            longest: ExposureTime::from_seconds(longest),
        };
        let registers = factory_settings(&photographer.file.timing);
        SimCamera {
            name: name.to_owned(),
            pool: FramePool::new(POOL),
            info,
            next_id,
            faults,
            registers,
            stream: None,
            open: false,
            last: None,
            held: None,
            photographer,
            surroundings,
        }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, format!("camera.{} (sim:{})", self.name, self.name), message)
    }

    fn factory_settings(&self) -> CameraSettings {
        factory_settings(&self.photographer.file.timing)
    }

    fn must_be_open(&self) -> Result<()> {
        if self.open { Ok(()) } else { Err(self.error(ErrorKind::Lost, "the camera is gone; open it again")) }
    }

    fn timing(&self) -> Timing {
        let timing = &self.photographer.file.timing;
        Timing {
            readout: Duration::from_secs_f64(timing.readout_s),
            interval: Duration::from_secs_f64(timing.frame_interval_s),
            latency: u64::from(timing.latency_frames),
            restart: timing.restart_s.map(Duration::from_secs_f64),
        }
    }

    /// Starts the stream where none runs; settings written before hold from the first frame.
    fn start(&mut self, now: Instant) -> &mut Stream {
        let (timing, registers, id) = (self.timing(), self.registers, self.next_id.load(Ordering::Relaxed));
        self.stream.get_or_insert_with(|| Stream::new(timing, id, now + timing.restart.unwrap_or_default(), registers))
    }

    /// Throws frames under way away; their ids are used up.
    fn halt(&mut self) {
        let now = self.surroundings.clock.now();
        if let Some(mut stream) = self.stream.take() {
            stream.advance(now);
            self.next_id.store(stream.id() + 1, Ordering::Relaxed);
        }
        self.held = None;
    }

    fn check(&self, settings: &CameraSettings) -> Result<()> {
        let (low, high) = (self.info.shortest, self.info.longest);
        if settings.exposure < low || settings.exposure > high {
            let message = format!("exposure {} is refused; {low} to {high} is allowed", settings.exposure);
            return Err(self.error(ErrorKind::Refused, message));
        }
        let gain = self.photographer.file.timing.gain;
        if settings.gain != gain {
            let message = format!("gain {} is refused; this camera has the fixed gain {gain}", settings.gain);
            return Err(self.error(ErrorKind::Refused, message));
        }
        Ok(())
    }

    /// Waits until a frame is in the queue and tells which; it stays there.
    async fn wait(&mut self) -> Result<Shot> {
        let clock = self.surroundings.clock;
        loop {
            let now = clock.now();
            let Some(stream) = self.stream.as_mut() else {
                return Err(self.error(ErrorKind::Refused, "no frames are taken; arm the camera first"));
            };
            stream.advance(now);
            if let Some(shot) = stream.front() {
                return Ok(shot);
            }
            let due = stream.next_done();
            clock.sleep_until(due).await;
        }
    }

    /// Renders `shot` as it was (or with a fault), without touching the queue.
    async fn render(&self, shot: Shot, fault: Option<CameraFault>) -> Result<Frame> {
        let clock = self.surroundings.clock;
        let Ok((buffer, permit)) = clock.timeout(POOL_WAIT, self.pool.take()).await else {
            let message = format!("all {POOL} frame buffers are in use; drop frames that are no longer needed");
            return Err(self.error(ErrorKind::Busy, message));
        };
        let mut seen = match (fault, self.last) {
            (Some(CameraFault::Stale | CameraFault::Repeated), Some(last)) => last,
            _ => shot,
        };
        if let Some(CameraFault::WrongExposure(exposure)) = fault {
            seen.settings.exposure = exposure;
        }
        let job = Job { shot: seen, name: self.name.clone(), surroundings: self.surroundings.clone() };
        let photographer = Arc::clone(&self.photographer);
        let pixels = tokio::task::spawn_blocking(move || job.run(&photographer, buffer, fault)).await;
        let pixels = pixels.map_err(|e| self.error(ErrorKind::Broken, format!("rendering failed: {e}")))?;
        let done = self.stream.as_ref().map_or(shot.start, |s| s.done(&shot));
        let told = match (fault, self.last) {
            (Some(CameraFault::Repeated), Some(last)) => last,
            _ => shot,
        };
        let info = FrameInfo {
            camera_serial: self.info.identity.serial.clone(),
            device_frame_id: told.id,
            exposure_start: told.start,
            received: if matches!(fault, Some(CameraFault::Late(_))) { clock.now() } else { done },
            utc: clock.utc_at(told.start),
            settings: self.registers,
            width: self.info.width,
            height: self.info.height,
            format: self.info.format,
            damaged: fault == Some(CameraFault::Truncated),
        };
        Ok(self.pool.frame(info, pixels, permit))
    }
}

// === impl Job ===

impl Job {
    fn run(&self, photographer: &Photographer, buffer: Option<Pixels>, fault: Option<CameraFault>) -> Pixels {
        let view = Look { photographer, surroundings: &self.surroundings, name: &self.name };
        let (exposure, id) = (self.shot.settings.exposure, self.shot.id);
        let mut pixels = view.picture(self.shot.start, exposure, [id, id], buffer);
        match fault {
            Some(CameraFault::Black) => blacken(&mut pixels, 0),
            Some(CameraFault::Truncated) => {
                let half = pixels.len() / 2;
                blacken(&mut pixels, half);
            }
            _ => {}
        }
        pixels
    }
}

// === impl Look ===

impl Look<'_> {
    /// What the camera sees from `start` on for so long, with the truth painted into its reserved rows. `ids`: the frame
    /// counter that is painted, and the key of the noise.
    pub(crate) fn picture(
        &self,
        start: Instant,
        exposure_time: ExposureTime,
        [id, noise]: [u64; 2],
        buffer: Option<Pixels>,
    ) -> Pixels {
        let length = exposure_time.duration();
        let mut poses: Vec<(f64, Pose)> = Vec::new();
        for i in 0..LOOKS {
            let pose = self.surroundings.poses.pose(start + length * (2 * i + 1) / (2 * LOOKS));
            match poses.iter_mut().find(|(_, p)| *p == pose) {
                Some((share, _)) => *share += 1.0 / f64::from(LOOKS),
                None => poses.push((1.0 / f64::from(LOOKS), pose)),
            }
        }
        let middle = start + length / 2;
        let lamp = self.surroundings.lamp.exposure(start, length, self.name, noise);
        let truth = PaintedTruth::new(&self.surroundings.poses.pose(middle), poses.len() > 1, exposure_time, id);
        let exposure = Exposure { poses, seconds: exposure_time.seconds(), lamp };
        let mut pixels = self.photographer.photograph(&exposure, noise, buffer);
        let file = &self.photographer.file;
        truth.paint(&mut pixels, file.width_px, file.fisheye.reserved_rows, file.levels());
        pixels
    }
}

/// Settings after power-up.
fn factory_settings(timing: &TimingFile) -> CameraSettings {
    let exposure = ExposureTime::from_seconds(0.01f64.clamp(timing.shortest_s, timing.longest_s));
    CameraSettings { exposure, gain: timing.gain }
}

/// Zeroes all pixels from `from` on.
fn blacken(pixels: &mut Pixels, from: usize) {
    match pixels {
        Pixels::U8(v) => v.iter_mut().skip(from).for_each(|p| *p = 0),
        Pixels::U16(v) => v.iter_mut().skip(from).for_each(|p| *p = 0),
    }
}

#[async_trait]
impl Device for SimCamera {
    async fn open(&mut self) -> Result<Identity> {
        self.halt();
        self.open = true;
        self.last = None;
        Ok(self.info.identity.clone())
    }

    async fn health(&mut self) -> Result<Health> {
        self.must_be_open()?;
        Ok(Health::default())
    }

    async fn make_safe(&mut self) -> Result<()> {
        self.halt();
        Ok(())
    }
}

#[async_trait]
impl Camera for SimCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        self.must_be_open()?;
        self.check(&settings)?;
        let now = self.surroundings.clock.now();
        if settings != self.registers && self.faults.swallows() {
            return Ok(self.registers);
        }
        if settings != self.registers
            && let Some(stream) = self.stream.as_mut()
        {
            stream.write(settings, now);
        }
        self.registers = settings;
        Ok(self.registers)
    }

    async fn arm(&mut self) -> Result<Armed> {
        self.must_be_open()?;
        let now = self.surroundings.clock.now();
        let armed = self.start(now).arm(now);
        let due_within = (armed.due - now) + MARGIN;
        Ok(Armed { not_before: armed.not_before, discard: armed.discard, due_within })
    }

    async fn next_frame(&mut self) -> Result<Frame> {
        self.must_be_open()?;
        let clock = self.surroundings.clock;
        let shot = self.wait().await?;
        // A fault stays held until its frame is given, so that a dropped future loses neither.
        if self.held.is_none() {
            self.held = self.faults.take();
        }
        let fault = self.held;
        match fault {
            Some(CameraFault::NoFrame) => {
                clock.sleep(shot.settings.exposure.duration() + self.timing().readout + MARGIN).await;
                self.held = None;
                self.stream.as_mut().and_then(Stream::pop);
                let message = format!("no frame within {} + readout + 2 s; is the link up", shot.settings.exposure);
                return Err(self.error(ErrorKind::Timeout, message));
            }
            Some(CameraFault::Hang) => loop {
                // Nobody but the caller's deadline ends this; opened anew, the camera is well.
                clock.sleep(HANG).await;
            },
            Some(lost @ (CameraFault::Lost | CameraFault::Forgets)) => {
                self.halt();
                self.open = false;
                if lost == CameraFault::Forgets {
                    self.registers = self.factory_settings();
                }
                return Err(self.error(ErrorKind::Lost, "the camera is gone; open it again"));
            }
            Some(CameraFault::Late(by)) => clock.sleep(by).await,
            Some(CameraFault::Panic) => {
                self.held = None;
                // As a panic, without the message that one prints.
                std::panic::resume_unwind(Box::new("a camera's driver panics as the fault plan wants it".to_owned()));
            }
            Some(CameraFault::SkippedId) => {
                self.held = None;
                self.stream.as_mut().and_then(Stream::pop);
                self.wait().await?;
            }
            _ => {}
        }
        let shot = self.wait().await?;
        let frame = self.render(shot, fault).await?;
        self.held = None;
        self.last = Some(shot);
        self.stream.as_mut().and_then(Stream::pop);
        Ok(frame)
    }

    async fn stop(&mut self) -> Result<()> {
        self.halt();
        Ok(())
    }
}

#[cfg(test)]
#[path = "camera_tests.rs"]
mod tests;
