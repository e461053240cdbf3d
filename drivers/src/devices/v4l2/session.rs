//! The open camera inside its thread: negotiation, settings, stream, and one frame at a time out of the kernel's queue.

use super::config::V4l2Config;
use super::controls::{self, RawSettings};
use super::fault::Fault;
use super::flight::{self, Counters, Flight, Placed, Seen};
use super::formats::Layout;
use super::negotiate::{identify, negotiate};
use super::sum::Sum;
use super::sys::{self, Ring, Taken};
use crate::clock::Clock;
use crate::contract::{Armed, CameraInfo, CameraSettings, Health};
use crate::error::{ErrorKind, Result};
use crate::frame::{Frame, FrameInfo, FramePool, PixelFormat, Pixels};
use crate::units::ExposureTime;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::time::Instant;
use v4l::Device;

/// Input status bit: no signal (ENUMINPUT).
const NO_SIGNAL: u32 = 0x2;
/// Margin over exposure and frame interval before a missing frame is a time-out.
const MARGIN: Duration = Duration::from_secs(2);
/// Restarts in a row, without a good frame between, after which the camera counts as broken.
const MOST_RESTARTS: u32 = 3;

/// What was written and read back.
#[derive(Debug, Clone, Copy)]
struct Applied {
    settings: CameraSettings,
    raw: RawSettings,
    single: Duration,
    frames: u16,
}

/// An open camera.
pub struct Session {
    config: Arc<V4l2Config>,
    clock: Clock,
    pool: FramePool,
    device: Device,
    layout: Layout,
    curve: Option<String>,
    ring: Option<Ring>,
    /// Frame interval asked for, and what the device made of it.
    asked_s: Option<f64>,
    interval_s: Option<f64>,
    flight: Flight,
    applied: Option<Applied>,
    sum: Sum,
    scratch: Option<Pixels>,
    restarts: u32,
    waiting_since: Duration,
    anchor: (Duration, Instant),
    opened_driver: String,
}

// === impl Session: opening ===

impl Session {
    /// Opens the node and proves that it is the camera of the configuration, with its format and without
    /// automatic functions.
    ///
    /// # Errors
    /// `Lost` without a node, `WrongDevice` for another camera, `Refused` when size or format are not on offer,
    /// `Busy` when another program streams.
    pub fn open(
        config: Arc<V4l2Config>,
        clock: Clock,
        runtime: &Handle,
        pool: FramePool,
    ) -> Result<(Session, CameraInfo)> {
        let fault = Fault(&config.name);
        let what = format!("opening {}", config.node.display());
        let device = Device::with_path(&config.node).map_err(|e| fault.io(&what, &e))?;
        let identity = identify(&device, &config)?;
        let (layout, curve) = negotiate(&device, &config)?;
        controls::prepare(&device, &config)?;
        let info = CameraInfo {
            identity: identity.clone(),
            width: layout.width,
            height: layout.height,
            format: layout.format,
            shortest: ExposureTime::from_seconds(config.shortest_s),
            longest: ExposureTime::from_seconds(
                config.longest_s * f64::from(config.sum_limit.max(1)).min(f64::from(layout.summable())),
            ),
        };
        let anchor = {
            let _in = runtime.enter();
            (sys::monotonic(), clock.now())
        };
        let mut flight = Flight::new(config.settle_frames, Duration::from_secs_f64(config.readout_s.max(0.0)));
        if identity.firmware.starts_with("uvcvideo ") {
            flight.distrust_start_stamps();
        }
        let session = Session {
            clock,
            pool,
            device,
            layout,
            curve,
            ring: None,
            asked_s: None,
            interval_s: None,
            flight,
            applied: None,
            sum: Sum::default(),
            scratch: None,
            restarts: 0,
            waiting_since: Duration::ZERO,
            anchor,
            opened_driver: identity.firmware,
            config,
        };
        Ok((session, info))
    }

    /// True while frames come and must be taken.
    pub fn streams(&self) -> bool {
        self.ring.is_some()
    }

    /// Sums since opening.
    pub fn counters(&self) -> Counters {
        self.flight.counters
    }

    /// Stops the stream.
    pub fn stop(&mut self) {
        self.ring = None;
        self.flight.disarm();
        self.sum.clear();
    }

    /// The tokio instant of a CLOCK_MONOTONIC time; one anchor for all, so that order is kept exactly.
    fn instant(&self, at: Duration) -> Instant {
        let (zero, instant) = self.anchor;
        match at.checked_sub(zero) {
            Some(after) => instant + after,
            None => instant.checked_sub(zero - at).unwrap_or(instant),
        }
    }
}

// === impl Session: settings ===

impl Session {
    /// Writes all settings, on a running stream, and returns them as read back.
    ///
    /// Gives the format of the frames under these settings too: that of sums where the exposure is beyond the limit.
    pub fn apply(&mut self, want: CameraSettings) -> Result<(CameraSettings, PixelFormat)> {
        let config = Arc::clone(&self.config);
        let fault = Fault(&config.name);
        let (frames, single_s) = config
            .split(want.exposure.seconds(), self.layout.summable())
            .map_err(|sentence| fault.of(ErrorKind::Refused, sentence))?;
        let exposure = controls::raw_in_range(&self.device, &config, config.exposure, single_s, "an exposure in s of")?;
        let gain = match config.gain {
            Some(c) => Some(controls::raw_in_range(&self.device, &config, c, want.gain, "a gain of")?),
            None => None,
        };
        self.flight.disarm();
        self.sum.clear();
        self.applied = None;
        controls::prepare(&self.device, &config)?;
        let raw = RawSettings { exposure, gain };
        let read = self.write_all(raw, config.period_s(single_s))?;
        let single = config.exposure.value(read.exposure).max(0.0);
        let settings = CameraSettings {
            exposure: ExposureTime::from_seconds(single * f64::from(frames)),
            gain: config.gain.zip(read.gain).map_or(want.gain, |(c, g)| c.value(g)),
        };
        let single = Duration::from_secs_f64(single);
        self.flight.changed(sys::monotonic(), single);
        self.applied = Some(Applied { settings, raw: read, single, frames });
        Ok((settings, self.format_of(frames)))
    }

    fn format_of(&self, frames: u16) -> PixelFormat {
        if frames == 1 {
            return self.layout.format;
        }
        let (mosaic, bits) = (self.layout.format.mosaic(), self.layout.format.bits());
        PixelFormat::Summed { mosaic, bits, exposures: frames }
    }

    /// Frame interval before a longer exposure, after a shorter one; the values after STREAMON, where some drivers
    /// first lose them. A driver that keeps its interval while it streams is stopped for the change.
    fn write_all(&mut self, raw: RawSettings, period_s: f64) -> Result<RawSettings> {
        let longer = self.interval_s.is_none_or(|now| period_s > now);
        if longer {
            self.interval(period_s)?;
        }
        self.start()?;
        controls::write(&self.device, &self.config, raw)?;
        if !longer {
            self.interval(period_s)?;
            if self.ring.is_none() {
                self.start()?;
                controls::write(&self.device, &self.config, raw)?;
            }
        }
        controls::read(&self.device, &self.config)
    }

    fn interval(&mut self, period_s: f64) -> Result<()> {
        // Asked again, a bridge that is busy while it streams would restart its stream for nothing.
        if self.asked_s == Some(period_s) {
            return Ok(());
        }
        let fault = Fault(&self.config.name);
        let mut set = controls::set_interval(&self.device, period_s);
        if self.ring.is_some() && set.as_ref().is_err_and(|e| e.raw_os_error() == Some(libc::EBUSY)) {
            self.ring = None;
            set = controls::set_interval(&self.device, period_s);
        }
        self.asked_s = Some(period_s);
        self.interval_s = Some(set.map_err(|e| fault.io("setting the frame interval", &e))?.unwrap_or(period_s));
        Ok(())
    }

    fn start(&mut self) -> Result<()> {
        if self.ring.is_none() {
            let ring = Ring::start(&self.device, self.config.buffers.max(2))
                .map_err(|e| Fault(&self.config.name).io("starting the stream", &e))?;
            self.flight.restarted(ring.buffers());
            self.waiting_since = sys::monotonic();
            self.ring = Some(ring);
        }
        Ok(())
    }

    /// Proves the settings once more and marks the moment from which frames count.
    ///
    /// # Errors
    /// `Refused` before `apply`; `Broken` when a setting changed by itself or the input has no signal.
    pub fn arm(&mut self) -> Result<Armed> {
        let fault = Fault(&self.config.name);
        let Some(applied) = self.applied.filter(|_| self.ring.is_some()) else {
            return Err(fault.of(ErrorKind::Refused, "no settings are in force; apply them before arming"));
        };
        controls::prepare(&self.device, &self.config)?;
        let now = controls::read(&self.device, &self.config)?;
        if now != applied.raw {
            self.applied = None;
            return Err(fault.of(
                ErrorKind::Broken,
                format!("settings changed by themselves from {:?} to {now:?}; apply them again", applied.raw),
            ));
        }
        if !self.signal() {
            return Err(fault.of(ErrorKind::Broken, "the input has no signal; check the camera's cable and power"));
        }
        let at = sys::monotonic();
        self.flight.armed(at);
        self.sum.clear();
        self.waiting_since = at;
        let frames = self.flight.frames_to_settle() + 2 + u32::from(applied.frames);
        Ok(Armed { not_before: self.instant(at), discard: 0, due_within: self.patience() * frames + MARGIN })
    }

    /// Longest time from frame to frame in the present settings.
    fn patience(&self) -> Duration {
        let exposure = self.applied.map_or(Duration::ZERO, |a| a.single).max(self.flight.slowest()).as_secs_f64();
        Duration::from_secs_f64(self.config.period_s(exposure).max(self.interval_s.unwrap_or(0.0)))
    }

    fn signal(&self) -> bool {
        sys::input_status(&self.device).is_ok_and(|status| status & NO_SIGNAL == 0)
    }

    /// What an operator should know.
    pub fn health(&mut self) -> Result<Health> {
        let fault = Fault(&self.config.name);
        self.device.query_caps().map_err(|e| fault.io("asking for the capabilities", &e))?;
        let mut warnings = Vec::new();
        if !self.signal() {
            warnings.push("no signal".to_owned());
        }
        if !self.flight.stamps_usable() {
            warnings.push("no usable time stamps: frames are counted out instead".to_owned());
        }
        let node = self.config.node.to_string_lossy();
        if !node.contains("/by-id/") && !node.contains("/by-path/") {
            warnings
                .push(format!("{node} may change its number when plugged again; use its link under /dev/v4l/by-id"));
        }
        warnings.extend(self.layout.format.caution().map(str::to_owned));
        warnings.extend(self.curve.clone());
        let c = self.flight.counters;
        let odd = c.lost + c.stale + c.repeated + c.damaged + c.short + c.no_signal;
        if odd + c.restarts > 0 {
            warnings.push(format!(
                "{odd} odd frames and {} stream restarts since opening ({})",
                c.restarts, self.opened_driver
            ));
        }
        Ok(Health { warnings, temperature_c: None })
    }
}

// === impl Session: frames ===

impl Session {
    /// Waits at most `slice` for the next buffer and takes it. `None`: nothing for the reader (yet).
    pub fn pump(&mut self, slice: Duration) -> Option<Result<Frame>> {
        let ring = self.ring.as_mut()?;
        let taken = match ring.ready(slice) {
            Ok(false) => return self.overdue().map(Err),
            Ok(true) => ring.take(),
            Err(e) => Err(e),
        };
        match taken {
            Ok(taken) => self.judge(taken).map(Ok),
            Err(e) if e.raw_os_error() == Some(libc::EAGAIN) => None,
            Err(e) if e.raw_os_error() == Some(libc::EIO) => self.restart(&e).err().map(Err),
            // The buffers are ours and were queued: the stream itself has ended, as with a loopback whose source closed.
            Err(e) if e.raw_os_error() == Some(libc::EINVAL) => {
                self.stop();
                let what = format!("the source of the pictures has ended its stream ({e}); start it again");
                Some(Err(Fault(&self.config.name).of(ErrorKind::Lost, what)))
            }
            Err(e) => {
                self.stop();
                Some(Err(Fault(&self.config.name).io("taking a picture", &e)))
            }
        }
    }

    /// No frame for longer than exposure, interval and margin: said once, the stream goes on.
    fn overdue(&mut self) -> Option<crate::error::DeviceError> {
        let now = sys::monotonic();
        let waited = now.saturating_sub(self.waiting_since);
        // While a change runs through the sensor a long exposure can follow a whole frame interval after a short one.
        if waited < self.patience() * 2 + MARGIN {
            return None;
        }
        self.waiting_since = now;
        let message = format!("no picture for {:.1} s; the stream stands, it is opened again", waited.as_secs_f64());
        Some(Fault(&self.config.name).of(ErrorKind::Timeout, message))
    }

    fn judge(&mut self, taken: Taken) -> Option<Frame> {
        let dequeued = sys::monotonic();
        self.waiting_since = dequeued;
        let signal = self.signal();
        let ring = self.ring.as_mut()?;
        let bytes = ring.bytes(&taken);
        let (digest, picture_bytes) = (flight::digest(bytes), self.layout.picture_bytes());
        let placed = self.flight.place(&Seen { meta: taken.meta, dequeued, picture_bytes, digest, signal });
        if !placed.odd {
            self.restarts = 0;
        }
        let frame = if placed.deliver { self.deliver(&taken, &placed, dequeued) } else { None };
        if let Some(ring) = self.ring.as_mut()
            && let Err(e) = ring.give(taken)
        {
            tracing::warn!(camera = %self.config.name, error = %e, "a buffer could not be given back");
        }
        frame
    }

    /// The one copy: from the kernel's buffer into the pool's.
    fn deliver(&mut self, taken: &Taken, placed: &Placed, dequeued: Duration) -> Option<Frame> {
        let applied = self.applied?;
        if applied.frames > 1 {
            return self.deliver_sum(applied, taken, placed, dequeued);
        }
        let bytes = self.ring.as_ref()?.bytes(taken);
        let Some((buffer, permit)) = self.pool.try_take() else {
            self.flight.counters.unread += 1;
            return None;
        };
        let pixels = self.layout.unpack(bytes, buffer);
        let info = self.info(applied, placed.id, (placed.start, dequeued), self.layout.format, placed.odd);
        Some(self.pool.frame(info, pixels, Some(permit)))
    }

    /// Adds a frame to the sum under way and hands the sum out, under the number of its last frame, when it is complete.
    fn deliver_sum(&mut self, applied: Applied, taken: &Taken, placed: &Placed, dequeued: Duration) -> Option<Frame> {
        if placed.odd || placed.after_loss {
            self.sum.clear();
        }
        if placed.odd {
            return None;
        }
        let bytes = self.ring.as_ref()?.bytes(taken);
        let one = self.layout.unpack(bytes, self.scratch.take());
        let start = self.sum.add(&one, placed.start, applied.frames);
        self.scratch = Some(one);
        let start = start?;
        let Some((buffer, permit)) = self.pool.try_take() else {
            self.flight.counters.unread += 1;
            return None;
        };
        let pixels = self.sum.copy(buffer);
        let info = self.info(applied, placed.id, (start, dequeued), self.format_of(applied.frames), false);
        Some(self.pool.frame(info, pixels, Some(permit)))
    }

    fn info(
        &self,
        applied: Applied,
        id: u64,
        at: (Duration, Duration),
        format: PixelFormat,
        damaged: bool,
    ) -> FrameInfo {
        let (start, dequeued) = at;
        let exposure_start = self.instant(start);
        FrameInfo {
            camera_serial: self.config.serial.clone(),
            device_frame_id: id,
            exposure_start,
            received: self.instant(dequeued),
            utc: self.clock.utc_at(exposure_start),
            settings: applied.settings,
            width: self.layout.width,
            height: self.layout.height,
            format,
            damaged,
        }
    }

    /// After EIO: stop, start, write and prove everything again; frames settle anew before one is handed out.
    fn restart(&mut self, why: &std::io::Error) -> Result<()> {
        let config = Arc::clone(&self.config);
        let fault = Fault(&config.name);
        self.restarts += 1;
        self.flight.counters.restarts += 1;
        tracing::warn!(camera = %config.name, error = %why, "stream restart");
        self.ring = None;
        self.sum.clear();
        let Some(applied) = self.applied else { return Ok(()) };
        if self.restarts > MOST_RESTARTS {
            self.stop();
            return Err(fault.of(
                ErrorKind::Broken,
                format!(
                    "{MOST_RESTARTS} stream restarts brought no picture ({why}); unplug the camera and plug it again"
                ),
            ));
        }
        self.start()?;
        controls::prepare(&self.device, &config)?;
        controls::write(&self.device, &config, applied.raw)?;
        let read = controls::read(&self.device, &config)?;
        if read != applied.raw {
            self.stop();
            return Err(
                fault.of(ErrorKind::Broken, format!("after a restart {:?} reads back as {read:?}", applied.raw))
            );
        }
        self.flight.resettle(sys::monotonic());
        Ok(())
    }
}
