//! The sensor: exposes one frame after another with the pipeline a real sensor has, and makes pictures of them. No I/O.

use super::controls::Settings;
use super::faults::{Faults, FrameFault, Truth};
use super::mode::Mode;
use crate::gige::faults::Draws;
use crate::scene::{ExposureRequest, Scene};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Longest pipeline of settings that can be simulated.
const LONGEST_PIPELINE: usize = 16;
/// Pictures that wait for the host; what comes on top is lost.
const MOST_READY: usize = 2;
/// Lost pictures after which the sensor rests until the host takes one.
const MOST_OWED: u32 = 32;
/// Frame periods the sensor catches up when nobody looked for a while.
const CATCH_UP: u32 = 8;

/// An exposure, under way or past.
#[derive(Debug, Clone)]
struct Exposure {
    number: u64,
    started: Instant,
    ends: Instant,
    settings: Settings,
    commanded: Settings,
    /// Settings of the upper half, where they differ.
    upper: Option<Settings>,
}

/// A picture on its way to the host.
#[derive(Debug, Clone)]
pub struct Outgoing {
    /// The whole picture.
    pub bytes: Arc<Vec<u8>>,
    /// Bytes that are sent.
    pub end: usize,
    /// The error bit is set.
    pub error: bool,
}

/// The sensor while it streams.
pub struct Sensor {
    scene: Arc<dyn Scene>,
    mode: Mode,
    interval: Duration,
    readout: Duration,
    commanded: VecDeque<Settings>,
    exposing: Option<Exposure>,
    next_start: Instant,
    before: Option<Exposure>,
    sent: Option<(Exposure, Arc<Vec<u8>>)>,
    ready: VecDeque<Outgoing>,
    /// Pictures lost whose headers are still to be sent.
    owed: u32,
    draws: Draws,
}

/// Counters that live longer than a stream.
#[derive(Debug, Default)]
pub struct Logbook {
    /// Exposures since power-up.
    pub exposures: u64,
    /// Frames since power-up, one by one.
    pub truth: Vec<Truth>,
}

// === impl Sensor ===

impl Sensor {
    /// A sensor that begins its first exposure at a moment and the others at the earliest an interval later.
    pub fn new(
        scene: Arc<dyn Scene>,
        mode: Mode,
        (next_start, interval): (Instant, Duration),
        readout: Duration,
        draws: Draws,
    ) -> Sensor {
        Sensor {
            scene,
            mode,
            interval,
            readout,
            commanded: VecDeque::new(),
            exposing: None,
            next_start,
            before: None,
            sent: None,
            ready: VecDeque::new(),
            owed: 0,
            draws,
        }
    }

    /// The state of its dice, for the next stream.
    pub fn draws(&self) -> Draws {
        self.draws.clone()
    }

    /// Does what is due until `now` with the settings commanded since the last call.
    pub fn advance(&mut self, now: Instant, commanded: Settings, faults: &Faults, log: &mut Logbook) {
        let behind = self.next_start + self.interval * CATCH_UP < now;
        if self.exposing.is_none() && (behind || self.owed >= MOST_OWED) {
            self.next_start = now;
        }
        if self.owed >= MOST_OWED && self.is_ready() {
            return;
        }
        loop {
            match self.exposing.take() {
                Some(exposure) if exposure.ends <= now => self.finish(exposure, faults, log),
                Some(exposure) => {
                    self.exposing = Some(exposure);
                    return;
                }
                None if self.next_start <= now => self.expose(commanded, faults, log),
                None => return,
            }
        }
    }

    /// When something happens by itself.
    pub fn due(&self) -> Instant {
        self.exposing.as_ref().map_or(self.next_start, |e| e.ends)
    }

    /// A picture waits.
    pub fn is_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    /// The next picture.
    pub fn take(&mut self) -> Option<Outgoing> {
        self.ready.pop_front()
    }

    /// Begins an exposure with the settings that have come through the pipeline.
    fn expose(&mut self, commanded: Settings, faults: &Faults, log: &mut Logbook) {
        self.commanded.push_front(commanded);
        self.commanded.truncate(LONGEST_PIPELINE + 1);
        let depth = (faults.latency_frames as usize).min(self.commanded.len() - 1);
        let settings = self.commanded.get(depth).copied().unwrap_or(commanded);
        let changed = self.before.as_ref().map(|b| b.settings).filter(|s| s.exposure != settings.exposure);
        log.exposures += 1;
        let started = self.next_start;
        let took = Duration::from_micros(u64::from(settings.exposure) * 100);
        self.next_start = started + self.interval.max(took + self.readout);
        self.exposing = Some(Exposure {
            number: log.exposures,
            started,
            ends: started + took,
            settings,
            commanded,
            upper: changed.filter(|_| faults.half_changed),
        });
    }

    /// Reads the sensor out: a picture goes on its way, with the faults that fall due.
    fn finish(&mut self, exposure: Exposure, faults: &Faults, log: &mut Logbook) {
        let mut shown = exposure.clone();
        let mut fault = exposure.upper.map(|_| FrameFault::HalfChanged);
        let mut copy = None;
        if self.ready.len() >= MOST_READY {
            fault = Some(FrameFault::Overrun);
        } else if self.draws.happens(faults.stale_per_1000)
            && let Some(before) = self.before.clone()
        {
            (shown, fault) = (before, Some(FrameFault::Stale));
        } else if self.draws.happens(faults.repeated_per_1000)
            && let Some((sent, bytes)) = self.sent.clone()
        {
            (shown, copy, fault) = (sent, Some(bytes), Some(FrameFault::Repeated));
        } else if self.draws.happens(faults.short_per_1000) {
            fault = Some(FrameFault::Short);
        } else if self.draws.happens(faults.error_per_1000) {
            fault = Some(FrameFault::ErrorBit);
        } else if self.draws.happens(faults.dropped_per_1000) {
            fault = Some(FrameFault::Dropped);
        }
        log.truth.push(Truth {
            sequence: log.truth.last().map_or(0, |t| t.sequence) + 1,
            frame_number: shown.number,
            started: shown.started,
            settings: shown.settings,
            commanded: exposure.commanded,
            fault,
        });
        self.before = Some(exposure);
        if matches!(fault, Some(FrameFault::Dropped | FrameFault::Overrun)) {
            self.owed += 1;
            return;
        }
        for _ in 0..std::mem::take(&mut self.owed) {
            self.ready.push_back(Outgoing { bytes: Arc::default(), end: 0, error: false });
        }
        let bytes = copy.unwrap_or_else(|| Arc::new(self.photograph(&shown)));
        let end = if fault == Some(FrameFault::Short) { bytes.len() / 2 } else { bytes.len() };
        if fault != Some(FrameFault::Short) {
            self.sent = Some((shown, Arc::clone(&bytes)));
        }
        self.ready.push_back(Outgoing { bytes, end, error: fault == Some(FrameFault::ErrorBit) });
    }

    fn photograph(&self, exposure: &Exposure) -> Vec<u8> {
        let mut levels = self.levels(exposure, exposure.settings);
        if let Some(settings) = exposure.upper {
            let half = self.mode.pixels() / 2;
            let upper = self.levels(exposure, settings);
            levels.iter_mut().zip(upper).take(half).for_each(|(level, old)| *level = old);
        }
        self.mode.format.encode(&levels)
    }

    fn levels(&self, exposure: &Exposure, settings: Settings) -> Vec<u16> {
        let max_level = self.mode.format.max_level();
        let mut levels = vec![0; self.mode.pixels()];
        let request = ExposureRequest {
            frame_number: exposure.number,
            host_count: exposure.number,
            exposure_us: f64::from(settings.exposure) * 100.0,
            gain_db: f64::from(settings.gain) * 0.1,
            started: exposure.started,
            width: usize::from(self.mode.width),
            height: usize::from(self.mode.height),
            max_level,
        };
        self.scene.render(&request, &mut levels);
        if settings.gamma != 100 || settings.brightness != 0 {
            let curve: Vec<u16> = (0..=max_level).map(|level| developed(level, max_level, settings)).collect();
            levels.iter_mut().for_each(|v| *v = curve.get(usize::from(*v)).copied().unwrap_or(max_level));
        }
        levels
    }
}

/// A level after gamma and brightness.
fn developed(level: u16, max_level: u16, settings: Settings) -> u16 {
    let top = f64::from(max_level);
    let curved = top * (f64::from(level) / top).powf(100.0 / f64::from(settings.gamma.max(1)));
    (curved + f64::from(settings.brightness)).round().clamp(0.0, top) as u16
}
