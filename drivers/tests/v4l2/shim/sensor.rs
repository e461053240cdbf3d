//! The sensor: its own clock of frames, a register pipeline with latency, the queue it fills, and the faults it makes.

use super::paint::Truth;
use super::twin::{Done, Fault, Stamps, Twin};
use std::collections::VecDeque;

/// Good pictures between two faults, so that each is one by itself.
const CLEAN_BETWEEN: u32 = 3;

/// A value on its way into the sensor.
#[derive(Debug, Clone, Copy)]
struct Pending {
    gain: bool,
    value: u32,
    frames: u64,
}

/// A picture being exposed.
#[derive(Debug, Clone, Copy)]
struct Exposing {
    start_ns: u64,
    end_ns: u64,
    truth: Truth,
}

/// The sensor.
#[derive(Debug)]
pub struct Sensor {
    /// Frame interval.
    pub interval_ns: u64,
    /// No pictures come, though the stream runs.
    pub silent: bool,
    running: bool,
    exposure: u32,
    gain: u32,
    pending: VecDeque<Pending>,
    exposing: Option<Exposing>,
    next_start_ns: u64,
    sequence: u32,
    number: u64,
    clean: u32,
    lost_before: u64,
    first: bool,
    history: VecDeque<(Done, Vec<u8>)>,
}

// === impl Sensor ===

impl Sensor {
    /// A sensor at rest.
    pub fn new(interval_ns: u64) -> Sensor {
        Sensor {
            interval_ns,
            silent: false,
            running: false,
            exposure: 200,
            gain: 8,
            pending: VecDeque::new(),
            exposing: None,
            next_start_ns: 0,
            sequence: 0,
            number: 0,
            clean: 0,
            lost_before: 0,
            first: true,
            history: VecDeque::new(),
        }
    }

    /// True between STREAMON and STREAMOFF.
    pub fn streams(&self) -> bool {
        self.running
    }

    /// STREAMON.
    pub fn start(&mut self, now_ns: u64) {
        self.running = true;
        self.next_start_ns = now_ns + 1_000_000;
        (self.sequence, self.clean, self.lost_before, self.first) = (0, 0, 0, true);
        self.history.clear();
    }

    /// STREAMOFF.
    pub fn stop(&mut self) {
        self.running = false;
        self.exposing = None;
    }

    /// A register write; in force with the frame after `frames` more.
    pub fn write(&mut self, gain: bool, value: u32, frames: u64) {
        if self.running {
            // Writes to one register never overtake each other.
            let before = self.pending.iter().rev().find(|p| p.gain == gain).map_or(0, |p| p.frames);
            let frames = frames.max(before);
            self.pending.push_back(Pending { gain, value, frames });
        } else if gain {
            self.gain = value;
        } else {
            self.exposure = value;
        }
    }

    /// When the next thing happens in it.
    pub fn next_event(&self) -> Option<u64> {
        if !self.running || self.silent {
            return None;
        }
        Some(self.exposing.map_or(self.next_start_ns, |e| e.end_ns))
    }

    /// Registers at the start of a frame: those due are taken, those due with the next show in its lower half.
    fn latch(&mut self, half_changed: bool) -> (u32, u32, u32) {
        let (mut exposure, mut gain) = (self.exposure, self.gain);
        let mut lower = None;
        for p in &mut self.pending {
            let value = if p.gain { &mut gain } else { &mut exposure };
            if p.frames == 0 {
                *value = p.value;
                if !p.gain {
                    lower = None;
                }
            } else if p.frames == 1 && half_changed && !p.gain {
                lower = Some(p.value);
            }
        }
        self.pending.retain_mut(|p| {
            let waits = p.frames > 0;
            p.frames = p.frames.saturating_sub(1);
            waits
        });
        (self.exposure, self.gain) = (exposure, gain);
        (exposure, lower.unwrap_or(exposure), gain)
    }
}

// === impl Twin: the passing of time ===

impl Twin {
    /// Lets the clock run to `until_ns`, with all that happens in between.
    pub fn advance(&mut self, until_ns: u64) {
        while let Some(at) = self.sensor.next_event().filter(|at| *at <= until_ns) {
            self.now_ns = self.now_ns.max(at);
            match self.sensor.exposing.take() {
                Some(done) => self.finish(&done),
                None => self.begin(at),
            }
        }
        self.now_ns = self.now_ns.max(until_ns);
    }

    fn begin(&mut self, at_ns: u64) {
        let (upper, lower, gain) = self.sensor.latch(self.plan.half_changed);
        let exposure_ns = u64::from(upper.max(lower)) * 100_000;
        let end_ns = at_ns + exposure_ns + self.plan.readout_ns;
        self.sensor.number += 1;
        let truth = Truth { number: self.sensor.number, upper, lower, gain };
        self.sensor.exposing = Some(Exposing { start_ns: at_ns, end_ns, truth });
        self.sensor.next_start_ns = end_ns.max(at_ns + self.sensor.interval_ns);
    }

    fn finish(&mut self, exposed: &Exposing) {
        let sequence = self.sensor.sequence;
        self.sensor.sequence = sequence.wrapping_add(1);
        let fault = self.draw_fault();
        let (index, false) = (self.queued.front().copied(), fault == Some(Fault::Lost)) else {
            self.sensor.lost_before += 1;
            self.sensor.clean = 0;
            return;
        };
        let Some(index) = index else {
            // The program holds all buffers: the picture is lost.
            self.sensor.lost_before += 1;
            return;
        };
        self.queued.pop_front();
        let (_, stride, height, word) = self.format;
        let mut picture = exposed.truth.picture(stride, height, word, &mut self.dice);
        let stamp_ns = match self.plan.stamps {
            Stamps::End => exposed.end_ns,
            Stamps::Start => exposed.start_ns,
            Stamps::Unknown => 0,
        };
        let lost_before = if self.sensor.first { 0 } else { self.sensor.lost_before };
        (self.sensor.first, self.sensor.lost_before) = (false, 0);
        let mut done =
            Done { index, sequence, stamp_ns, bytesused: picture.len() as u32, flags: 0, fault: None, lost_before };
        match fault {
            Some(Fault::Error) => {
                done.flags = 0x40;
                let half = picture.len() / 2;
                picture[half..].fill(0);
            }
            Some(Fault::Short) => done.bytesused /= 2,
            Some(Fault::Frozen) => picture.clone_from(&self.sensor.history[0].1),
            _ => {}
        }
        done.fault = fault.filter(|f| matches!(f, Fault::Error | Fault::Short | Fault::Frozen));
        self.fill(done, &picture);
        self.sensor.history.push_front((done, picture));
        self.sensor.history.truncate(3);
        match fault {
            Some(Fault::Twice) => self.fill_again(0, Fault::Twice),
            Some(Fault::Stale) => self.fill_again(2, Fault::Stale),
            _ => {}
        }
    }

    /// A buffer of the past once more.
    fn fill_again(&mut self, back: usize, fault: Fault) {
        let (Some(index), Some((old, picture))) = (self.queued.pop_front(), self.sensor.history.get(back).cloned())
        else {
            return;
        };
        self.fill(Done { index, fault: Some(fault), lost_before: 0, ..old }, &picture);
    }

    fn draw_fault(&mut self) -> Option<Fault> {
        self.sensor.clean += 1;
        // What may come again must be good itself, or one fault would count as two.
        let all_good =
            self.sensor.history.len() == 3 && self.sensor.history.iter().all(|(done, _)| done.fault.is_none());
        if self.plan.fault_every == 0 || self.sensor.clean <= CLEAN_BETWEEN || !all_good {
            return None;
        }
        if self.dice.below(self.plan.fault_every) != 0 {
            return None;
        }
        self.sensor.clean = 0;
        let all = [Fault::Lost, Fault::Error, Fault::Short, Fault::Twice, Fault::Stale, Fault::Frozen];
        Some(all[self.dice.below(6) as usize])
    }
}
