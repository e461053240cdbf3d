//! One open camera on its owner thread: settings, trigger, frames out of the library into our pool.

use super::counters::{Counters, tick};
use super::features::Features;
use super::frame_clock::{FrameCounter, Mark};
use super::opening::Opened;
use super::options::{AravisOptions, Trigger};
use super::raw;
use super::reception::{Filled, LinkCounts, Reception, emission_ended};
use crate::clock::Clock;
use crate::contract::{CameraInfo, CameraSettings, Health};
use crate::error::{ErrorKind, Result};
use crate::frame::{Frame, FrameInfo, FramePool, Pixels};
use crate::units::ExposureTime;
use aravis::glib::SignalHandlerId;
use aravis::glib::object::{Cast, ObjectExt};
use aravis::prelude::*;
use aravis::{Buffer, BufferStatus, Camera, ChunkParser, GvDevice};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::mpsc::Sender;
use tokio::time::Instant;

/// Control channel privilege (GigE Vision bootstrap register).
const PRIVILEGE: u64 = 0x0a00;

/// A frame with the number of the `arm` it belongs to.
pub struct Delivered {
    /// The frame.
    pub frame: Frame,
    /// Number of the last `arm` before it came.
    pub generation: u64,
}

/// What `arm` established.
#[derive(Debug, Clone, Copy)]
pub struct ArmPoint {
    /// No frame that began before counts.
    pub not_before: Instant,
    /// Frames of earlier numbers are void.
    pub generation: u64,
    /// Frames to throw away.
    pub discard: u32,
}

/// Where frames go and what they are counted in.
pub struct Outlet {
    /// Frames to the async side; as deep as the pool, so it is never full.
    pub frames: Sender<Delivered>,
    /// Where pixels live.
    pub pool: FramePool,
    /// Counters.
    pub counters: Arc<Counters>,
    /// Wall time of frames.
    pub clock: Clock,
}

/// When settings changed: on the device's own clock where it can be read. The host's idea of a device time is late by
/// as much as the latch took, so across two latches the order of frame and change could turn.
#[derive(Debug, Clone, Copy)]
enum Change {
    Device(u64),
    Host(Instant),
}

/// One open camera. Field order is drop order: the stream before the camera.
pub struct Session {
    reception: Option<Reception>,
    filled: Filled,
    told: LinkCounts,
    control_lost: SignalHandlerId,
    device_holds: u32,
    camera: Camera,
    features: Features,
    info: CameraInfo,
    options: AravisOptions,
    exposure: &'static str,
    gain: Option<&'static str>,
    warnings: Vec<String>,
    chunks: Option<ChunkParser>,
    latch: Option<(&'static str, &'static str)>,
    ns_per_tick: f64,
    mark: Option<Mark>,
    applied: Option<CameraSettings>,
    changed: Change,
    frames_since_change: u32,
    last_stamp: u64,
    counter: FrameCounter,
    generation: u64,
    running: bool,
    triggered: bool,
    outlet: Outlet,
}

// === impl Session ===

impl Session {
    /// A session over an opened camera. `filled` and `lost` are called on threads of the library.
    ///
    /// # Errors
    /// Those of [`Reception::new`].
    pub fn new(
        opened: Opened,
        options: AravisOptions,
        outlet: Outlet,
        filled: Filled,
        lost: impl Fn() + Send + 'static,
    ) -> Result<Session> {
        let Opened { camera, features, info, exposure, gain, warnings } = opened;
        let chunked = options.chunks && features.has("ChunkModeActive");
        let latch = [("TimestampLatch", "TimestampLatchValue"), ("GevTimestampControlLatch", "GevTimestampValue")]
            .into_iter()
            .find(|(command, value)| features.has(command) && features.has(value));
        let ticks = features.device().downcast_ref::<GvDevice>().and_then(|gv| gv.timestamp_tick_frequency().ok());
        let chunks = if chunked { features.device().create_chunk_parser() } else { None };
        // Before the stream: it holds the device too, and is closed first.
        let device_holds = features.device().ref_count();
        let reception = Reception::new(&camera, &features, &options, &filled)?;
        Ok(Session {
            control_lost: features.device().connect_control_lost(move |_| lost()),
            device_holds,
            reception: Some(reception),
            told: LinkCounts::default(),
            filled,
            chunks,
            ns_per_tick: ticks.filter(|f| *f > 0).map_or(1.0, |f| 1e9 / f as f64),
            camera,
            features,
            info,
            options,
            exposure,
            gain,
            warnings,
            latch,
            mark: None,
            applied: None,
            changed: Change::Host(Instant::now()),
            frames_since_change: 0,
            last_stamp: 0,
            counter: FrameCounter::default(),
            generation: 0,
            running: false,
            triggered: false,
            outlet,
        })
    }

    /// What the camera is.
    pub fn info(&self) -> &CameraInfo {
        &self.info
    }

    /// Writes settings and reads them back.
    pub fn apply(&mut self, settings: CameraSettings) -> Result<CameraSettings> {
        let asked_us = settings.exposure.0 as f64;
        // Cameras round to their own tick; more than that is not what was ordered.
        let tolerance = (asked_us * 1e-3).max(1.0);
        let exposure_us = self.features.set_float(self.exposure, asked_us, tolerance)?;
        let gain = match self.gain {
            Some(name) => self.features.set_float(name, settings.gain, 0.05)?,
            None => 0.0,
        };
        let applied = CameraSettings { exposure: ExposureTime(exposure_us.round().max(0.0) as u64), gain };
        if self.applied != Some(applied) {
            self.frames_since_change = 0;
            let host = self.mark_time()?;
            self.changed = self.mark.map_or(Change::Host(host), |mark| Change::Device(mark.device_ns));
        }
        self.applied = Some(applied);
        Ok(applied)
    }

    /// Proves control and settings, empties the queue, marks the moment and triggers.
    pub fn arm(&mut self) -> Result<ArmPoint> {
        let Some(applied) = self.applied else {
            return Err(self.features.fail(ErrorKind::Refused, "settings must be applied before frames are taken"));
        };
        self.prove_ours(applied)?;
        if !self.running {
            self.start()?;
        } else if self.triggered {
            self.stop()?;
            self.start()?;
        }
        let drained = self.drain();
        self.generation += 1;
        let not_before = self.mark_time()?;
        if self.options.trigger == Trigger::Software {
            self.trigger()?;
        }
        // Frames thrown away unseen could be sent once more under a fresh time stamp. The first frame after them is
        // given up, so that its pixels are known when they come again.
        let unseen = drained > 0 || self.options.trigger != Trigger::Software;
        let discard = self.options.discard_frames.saturating_sub(self.frames_since_change).max(u32::from(unseen));
        Ok(ArmPoint { not_before, generation: self.generation, discard })
    }

    /// A camera that restarted behind our back reads fine and has its power-up settings: only asking tells.
    fn prove_ours(&self, applied: CameraSettings) -> Result<()> {
        if self.features.device().downcast_ref::<GvDevice>().is_some() {
            let (_, privilege) = self
                .features
                .device()
                .read_register(PRIVILEGE)
                .map_err(|e| self.features.wrap("reading the control privilege", &e))?;
            if privilege & 3 == 0 {
                return Err(self
                    .features
                    .fail(ErrorKind::Lost, "the camera has dropped our control; it must be opened again"));
            }
        }
        let now_us = self.features.float(self.exposure)?;
        let held = ExposureTime(now_us.round().max(0.0) as u64) == applied.exposure;
        let trigger = match self.options.trigger {
            Trigger::Software => self.features.text("TriggerMode")? == "On",
            Trigger::FreeRun { .. } => true,
        };
        if held && trigger {
            return Ok(());
        }
        let message = format!(
            "the integration time reads {now_us} µs where {} was applied: the camera restarted; it must be opened again",
            applied.exposure
        );
        Err(self.features.fail(ErrorKind::Lost, message))
    }

    fn mark_time(&mut self) -> Result<Instant> {
        let Some((command, value)) = self.latch else {
            self.mark = None;
            return Ok(Instant::now());
        };
        self.features.execute(command)?;
        let ticks = self.features.integer(value)?;
        let host = Instant::now();
        let device_ns = (ticks.max(0) as f64 * self.ns_per_tick) as u64;
        self.mark =
            Some(Mark { device_ns: if self.ns_per_tick == 1.0 { ticks.max(0) as u64 } else { device_ns }, host });
        Ok(host)
    }

    /// Triggers one frame.
    pub fn trigger(&mut self) -> Result<()> {
        self.features.execute("TriggerSoftware")?;
        self.triggered = true;
        Ok(())
    }

    fn start(&mut self) -> Result<()> {
        if self.reception.is_none() {
            self.reception = Some(Reception::new(&self.camera, &self.features, &self.options, &self.filled)?);
        }
        self.counter.restarted();
        self.camera.start_acquisition().map_err(|e| self.features.wrap("starting acquisition", &e))?;
        self.running = true;
        self.triggered = false;
        Ok(())
    }

    /// Stops acquisition; frames under way are thrown away.
    pub fn stop(&mut self) -> Result<()> {
        if !self.running {
            return Ok(());
        }
        self.camera.stop_acquisition().map_err(|e| self.features.wrap("stopping acquisition", &e))?;
        self.drain();
        self.count_link();
        if let Some(reception) = self.reception.take() {
            self.told = LinkCounts::default();
            reception.close();
        }
        self.running = false;
        self.triggered = false;
        Ok(())
    }

    /// Throws filled buffers away; says how many.
    fn drain(&mut self) -> u32 {
        let mut drained = 0;
        let Some(reception) = &self.reception else { return 0 };
        while let Some(buffer) = reception.pop() {
            if buffer.frame_id() != 0 {
                self.counter.count(buffer.frame_id());
                tick(&self.outlet.counters.drained);
                drained += 1;
            }
            reception.push(buffer);
        }
        drained
    }

    /// Moves filled buffers into the pool and on. True where frames wait because the pool is empty.
    pub fn pump(&mut self) -> bool {
        loop {
            let Some((used, permit)) = self.outlet.pool.try_take() else { return true };
            let Some(buffer) = self.reception.as_ref().and_then(Reception::pop) else { return false };
            self.deliver(buffer, used, permit);
        }
    }

    fn deliver(&mut self, buffer: Buffer, used: Option<Pixels>, permit: OwnedSemaphorePermit) {
        let whole = buffer.status() == BufferStatus::Success && self.fits(&buffer);
        if buffer.frame_id() == 0 {
            self.give_back(buffer);
            return;
        }
        let format = self.options.format;
        let count = self.options.width * self.options.height;
        let pixels = if whole { format.unpack(raw::bytes(&buffer), count, used) } else { None };
        let damaged = pixels.is_none();
        let info = self.describe(&buffer, damaged);
        let stamp = buffer.timestamp();
        self.give_back(buffer);
        self.triggered = false;
        let counters = &self.outlet.counters;
        tick(if damaged { &counters.incomplete } else { &counters.complete });
        // Distinct time stamps are distinct exposures; a picture sent twice has gone through the sensor once.
        let after_change = match self.changed {
            Change::Device(ns) => stamp >= ns,
            Change::Host(at) => info.exposure_start >= at,
        };
        if stamp > self.last_stamp && after_change {
            self.frames_since_change = self.frames_since_change.saturating_add(1);
        }
        self.last_stamp = stamp;
        let pixels = pixels.unwrap_or_else(|| format.empty());
        let frame = self.outlet.pool.frame(info, pixels, Some(permit));
        // The channel is as deep as the pool: it is full only when nobody listens any more.
        let _ = self.outlet.frames.try_send(Delivered { frame, generation: self.generation });
    }

    fn give_back(&self, buffer: Buffer) {
        if let Some(reception) = &self.reception {
            reception.push(buffer);
        }
    }

    fn fits(&self, buffer: &Buffer) -> bool {
        buffer.image_pixel_format().raw() == self.options.format.code()
            && buffer.image_width() == self.options.width as i32
            && buffer.image_height() == self.options.height as i32
    }

    fn describe(&mut self, buffer: &Buffer, damaged: bool) -> FrameInfo {
        let received = Instant::now();
        let mut settings = self.applied.unwrap_or(CameraSettings { exposure: ExposureTime(0), gain: 0.0 });
        if !damaged
            && let Some(parser) = &self.chunks
            && let Ok(us) = parser.float_value(buffer, "ChunkExposureTime")
        {
            settings.exposure = ExposureTime(us.round().max(0.0) as u64);
        }
        let exposure_start = match self.mark {
            Some(mark) => mark.host(buffer.timestamp()),
            None => received.checked_sub(self.options.readout + settings.exposure.duration()).unwrap_or(received),
        };
        FrameInfo {
            camera_serial: self.info.identity.serial.clone(),
            device_frame_id: self.counter.count(buffer.frame_id()),
            exposure_start,
            received,
            utc: self.outlet.clock.utc_at(exposure_start),
            settings,
            width: self.options.width,
            height: self.options.height,
            format: self.info.format,
            damaged,
        }
    }

    /// Closes the camera, so that no thread of the library lets go of an object last ([`emission_ended`]). An emission that
    /// never ends leaves the objects alive for good.
    pub fn close(mut self) {
        let received = self.reception.take().is_none_or(Reception::close);
        self.features.device().disconnect(self.control_lost);
        if !received || !emission_ended(self.features.device(), self.device_holds) {
            tracing::warn!(camera = %self.options.label(), "a signal of the camera library never ended; its objects stay");
            std::mem::forget((self.features, self.camera));
        }
    }

    /// Temperature, cooler, link.
    pub fn health(&mut self) -> Result<Health> {
        let f = &self.features;
        let mut health = Health { warnings: self.warnings.clone(), temperature_c: None };
        if f.has("DeviceTemperature") {
            if f.has("DeviceTemperatureSelector") {
                f.set_text("DeviceTemperatureSelector", "Sensor")?;
            }
            health.temperature_c = Some(f.float("DeviceTemperature")?);
        } else {
            f.text("DeviceModelName")?;
        }
        if let Some(cooler) = &self.options.cooler {
            let state = f.text(&cooler.feature)?;
            if state != cooler.good {
                health.warnings.push(format!("cooler is {state}, not {}", cooler.good));
            }
        }
        self.count_link();
        let incomplete = self.outlet.counters.incomplete.load(Ordering::Relaxed);
        if incomplete > 0 {
            health.warnings.push(format!("{incomplete} frames came incomplete and were not used"));
        }
        Ok(health)
    }

    /// Brings the counters up to the library's statistics, which begin at 0 with each stream.
    pub fn count_link(&mut self) {
        let Some(now) = self.reception.as_ref().map(Reception::counts) else { return };
        let counters = &self.outlet.counters;
        let add = |counter: &AtomicU64, now: u64, told: u64| {
            counter.fetch_add(now.saturating_sub(told), Ordering::Relaxed);
        };
        add(&counters.resent_packets, now.resent_packets, self.told.resent_packets);
        add(&counters.missing_packets, now.missing_packets, self.told.missing_packets);
        add(&counters.underruns, now.underruns, self.told.underruns);
        self.told = now;
    }
}
