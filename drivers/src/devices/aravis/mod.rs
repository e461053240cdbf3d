//! GigE Vision and USB3 Vision cameras through Aravis 0.8 (SFNC feature names), among them the SU320 behind a GigE grabber.
//!
//! One named thread owns the library's objects ([`link`], [`session`]); this side sends it commands with a deadline and
//! takes frames from a bounded channel. After any loss the whole handle is thrown away: a restarted camera answers on the
//! old one with its power-up settings. `open` then finds it by address, proves serial number and control, and writes and
//! reads back every feature ([`opening`]).
//!
//! Facts about the library that shape this driver (Aravis 0.8.26): a dead camera blocks each register access for 2.5 s;
//! range and access checks are off until asked for; opening succeeds read-only while another holds control.

mod counters;
mod features;
mod frame_clock;
mod link;
mod opening;
mod options;
mod raw;
mod reception;
mod session;
mod wire_format;

pub use counters::Counts;
pub use options::{AravisOptions, Cooler, Trigger};
pub use wire_format::WireFormat;

use super::camera::{CameraConfig, Proven};
use crate::clock::Clock;
use crate::contract::{Armed, Camera, CameraInfo, CameraSettings, Device, Health, Identity};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::frame::Frame;
use crate::units::ExposureTime;
use async_trait::async_trait;
use counters::Counters;
use link::{Command, Link, Reply};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// A camera as the instrument file says it.
///
/// # Errors
/// `Refused`: a pixel format that the driver does not read.
pub fn make(config: CameraConfig, clock: Clock) -> Result<Box<dyn Camera>> {
    let camera = AravisCamera::new(AravisOptions::of(&config)?, clock);
    Ok(Box::new(Proven::new(camera, config)))
}

/// Longest time for opening: control may be waited for one heartbeat, a dead camera blocks 2.5 s a step.
const OPEN_LIMIT: Duration = Duration::from_secs(8);
/// How long a new opening waits for the old handle to be closed: it still writes to the camera while it closes.
const CLOSING: Duration = Duration::from_secs(2);
/// Owner threads that may hang in the library before opening once more is refused.
const MOST_THREADS: usize = 8;

const HEARTBEAT_LOST: &str = "the camera no longer obeys us (heartbeat lost); open it again";

/// A camera behind Aravis.
pub struct AravisCamera {
    options: AravisOptions,
    clock: Clock,
    counters: Arc<Counters>,
    threads: Arc<AtomicUsize>,
    link: Option<Link>,
    info: CameraInfo,
    applied: Option<CameraSettings>,
    generation: u64,
    awaiting: bool,
}

// === impl AravisCamera ===

impl AravisCamera {
    /// A camera that is not open yet.
    pub fn new(options: AravisOptions, clock: Clock) -> AravisCamera {
        let nobody = Identity { model: String::new(), firmware: String::new(), serial: options.serial.clone() };
        let info = CameraInfo {
            identity: nobody,
            width: options.width,
            height: options.height,
            format: options.format.frame_format(),
            shortest: ExposureTime(0),
            longest: ExposureTime(0),
        };
        AravisCamera {
            options,
            clock,
            counters: Arc::default(),
            threads: Arc::default(),
            link: None,
            info,
            applied: None,
            generation: 0,
            awaiting: false,
        }
    }

    /// What the link has counted.
    pub fn counts(&self) -> Counts {
        self.counters.now()
    }

    /// Owner threads alive; more than one means that an abandoned one still hangs in the library.
    pub fn threads(&self) -> usize {
        self.threads.load(Ordering::SeqCst)
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.options.label(), message)
    }

    fn closed(&self) -> DeviceError {
        self.error(ErrorKind::Lost, "the camera is not open; open it first")
    }

    /// Throws the handle away; its thread closes the camera in its own time.
    fn void(&mut self) {
        self.link = None;
        self.applied = None;
        self.awaiting = false;
    }

    async fn call<T>(&mut self, command: impl FnOnce(Reply<T>) -> Command) -> Result<T> {
        let link = self.link.as_ref().ok_or_else(|| self.closed())?;
        let control_lost = *link.lost.borrow();
        if control_lost {
            self.void();
            return Err(self.error(ErrorKind::Lost, HEARTBEAT_LOST));
        }
        let result = link.call(&self.options, self.clock, self.options.command_limit, command).await;
        if let Err(error) = &result
            && !matches!(error.kind, ErrorKind::Refused | ErrorKind::Busy)
        {
            self.void();
        }
        result
    }

    /// Time in which one frame must come: exposure and read-out; a free-running camera may have just begun another.
    fn frame_time(&self) -> Duration {
        let exposure = self.applied.map_or(Duration::ZERO, |s| s.exposure.duration());
        let one = exposure + self.options.readout;
        match self.options.trigger {
            Trigger::Software => one,
            Trigger::FreeRun { frame_rate_hz } => one.max(Duration::from_secs_f64(1.0 / frame_rate_hz.max(1e-3))),
        }
    }

    fn frame_limit(&self) -> Duration {
        let under_way = match self.options.trigger {
            Trigger::Software => Duration::ZERO,
            Trigger::FreeRun { .. } => self.frame_time(),
        };
        self.frame_time() + under_way + self.options.margin
    }

    async fn wait_frame(&mut self) -> Result<Frame> {
        let limit = self.frame_limit();
        let deadline = self.clock.now() + limit;
        let (clock, generation) = (self.clock, self.generation);
        let Some(link) = self.link.as_mut() else { return Err(self.closed()) };
        let (kind, message) = loop {
            tokio::select! {
                biased;
                delivered = link.frames.recv() => match delivered {
                    Some(d) if d.generation == generation => {
                        self.awaiting = false;
                        return Ok(d.frame);
                    }
                    Some(_) => {}
                    None => break (ErrorKind::Lost, "the camera's thread has ended; open it again".to_owned()),
                },
                _ = link.lost.wait_for(|lost| *lost) => break (ErrorKind::Lost, HEARTBEAT_LOST.to_owned()),
                () = clock.sleep_until(deadline) => break (ErrorKind::Timeout, silent(limit)),
            }
        };
        let error = self.error(kind, message);
        self.void();
        Err(error)
    }
}

fn silent(limit: Duration) -> String {
    let seconds = limit.as_secs_f64();
    format!(
        "no frame within {seconds:.1} s; check power and cable, then firewall and reverse-path filter for its UDP stream"
    )
}

#[async_trait]
impl Device for AravisCamera {
    async fn open(&mut self) -> Result<Identity> {
        self.void();
        let give_up = self.clock.now() + CLOSING;
        while self.threads() > 0 && self.clock.now() < give_up {
            self.clock.sleep(Duration::from_millis(5)).await;
        }
        if self.threads() >= MOST_THREADS {
            let message =
                format!("{MOST_THREADS} earlier calls into the camera library never came back; restart the daemon");
            return Err(self.error(ErrorKind::Broken, message));
        }
        let counters = Arc::clone(&self.counters);
        let (link, info) = Link::open(&self.options, self.clock, counters, &self.threads, OPEN_LIMIT).await?;
        self.info = info;
        self.link = Some(link);
        Ok(self.info.identity.clone())
    }

    async fn health(&mut self) -> Result<Health> {
        self.call(Command::Health).await
    }

    async fn make_safe(&mut self) -> Result<()> {
        if self.link.is_some() { Camera::stop(self).await } else { Ok(()) }
    }
}

#[async_trait]
impl Camera for AravisCamera {
    fn info(&self) -> &CameraInfo {
        &self.info
    }

    async fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        let applied = self.call(|reply| Command::Apply(settings, reply)).await?;
        self.applied = Some(applied);
        Ok(applied)
    }

    async fn arm(&mut self) -> Result<Armed> {
        let point = self.call(Command::Arm).await?;
        self.generation = point.generation;
        self.awaiting = true;
        let due_within = self.frame_time() * point.discard + self.frame_limit();
        Ok(Armed { not_before: point.not_before, discard: point.discard, due_within })
    }

    async fn next_frame(&mut self) -> Result<Frame> {
        if !self.awaiting && self.options.trigger == Trigger::Software {
            // Set first: a caller that drops this future must not trigger twice.
            self.awaiting = true;
            self.call(Command::Trigger).await?;
        }
        self.wait_frame().await
    }

    async fn stop(&mut self) -> Result<()> {
        self.awaiting = false;
        self.generation += 1;
        self.call(Command::Stop).await
    }
}
