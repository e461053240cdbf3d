//! Twin of Ocean Optics USB2000, USB2000+ and USB4000.
//!
//! Source: the protocol sheet `oceanoptics-usb2000`. Commands that the device does not know it ignores.

use super::detector::{Exposure, Light, Periods, bend, gather, hmi, noise, power_series};
use super::endpoint::{InEndpoint, Taken, UsbFault};
use super::oceanoptics_memory::Figures;
pub use super::oceanoptics_memory::OceanModel;
use crate::front::usb::{Answer, Descriptors, SetupPacket, UsbTwin};
use crate::truth::rng::Key;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Time until a short answer is ready, and readout and transfer of a spectrum.
const ANSWER: Duration = Duration::from_millis(1);
const READOUT: Duration = Duration::from_millis(6);
/// Spectra that the twin remembers.
const MEMORY: usize = 512;
/// Integration time after power-up, in microseconds.
const POWER_UP_US: u64 = 100_000;
/// Dark level in 12-bit counts.
const DARK: f64 = 110.0;
/// Bytes on the first endpoint of a USB4000 at high speed.
const FIRST_BYTES: usize = 2048;

/// Faults of the spectrometer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OceanFault {
    /// A fault of the next short answer.
    Query(UsbFault),
    /// A fault of the next spectrum.
    Spectrum(UsbFault),
    /// So many of the next spectra are that of an older period.
    Stale(u32),
    /// 0x01 leaves a spectrum in the endpoint (true), as the data sheet says, or not.
    InitLeavesSpectrum(bool),
    /// The status of a USB2000 has its words low byte first (true).
    LittleStatus(bool),
    /// The detector does not run: all pixels are equal.
    Dead(bool),
    /// Restart now.
    Restart,
}

/// What a unit is.
#[derive(Clone)]
pub struct OceanSpec {
    /// Model.
    pub model: OceanModel,
    /// Serial number in slot 0.
    pub serial: String,
    /// Light on its slit.
    pub light: Light,
    /// Readout and shot noise; without it equal light gives equal spectra, which no detector does.
    pub noise: bool,
    /// Seed of the noise.
    pub seed: u64,
}

/// A spectrometer.
pub struct OceanTwin {
    spec: OceanSpec,
    figures: Figures,
    slots: Vec<Vec<u8>>,
    time_us: u64,
    trigger: u16,
    lamp: bool,
    registers: [u16; 256],
    periods: Periods,
    /// A request that waits: when its spectrum is ready.
    pending: VecDeque<Instant>,
    queries: InEndpoint,
    spectra: InEndpoint,
    first: InEndpoint,
    query_faults: VecDeque<UsbFault>,
    spectrum_faults: VecDeque<UsbFault>,
    last_answer: Vec<u8>,
    last_spectrum: Vec<u8>,
    exposures: VecDeque<Exposure>,
    number: u64,
    stale: u32,
    init_leaves_spectrum: bool,
    little_status: bool,
    dead: bool,
    left_bus: bool,
}

// === impl OceanSpec ===

impl OceanSpec {
    /// A unit with this serial number in the light of a metal halide lamp.
    pub fn new(model: OceanModel, serial: &str) -> OceanSpec {
        OceanSpec { model, serial: serial.to_owned(), light: hmi(), noise: true, seed: 1 }
    }
}

// === impl OceanTwin ===

impl OceanTwin {
    /// A unit powered up at `now`.
    pub fn new(spec: OceanSpec, now: Instant) -> OceanTwin {
        let figures = spec.model.figures();
        OceanTwin {
            figures,
            slots: spec.model.slots(&spec.serial),
            time_us: POWER_UP_US,
            trigger: 0,
            lamp: false,
            registers: [0; 256],
            periods: Periods::new(Duration::from_micros(POWER_UP_US), now),
            pending: VecDeque::new(),
            queries: InEndpoint::new(figures.packet),
            spectra: InEndpoint::new(figures.packet),
            first: InEndpoint::new(figures.packet),
            query_faults: VecDeque::new(),
            spectrum_faults: VecDeque::new(),
            last_answer: Vec::new(),
            last_spectrum: Vec::new(),
            exposures: VecDeque::new(),
            number: 0,
            stale: 0,
            init_leaves_spectrum: false,
            little_status: false,
            dead: false,
            left_bus: false,
            spec,
        }
    }

    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        !self.query_faults.is_empty() || !self.spectrum_faults.is_empty()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: OceanFault, now: Instant) {
        match fault {
            OceanFault::Query(fault) => self.query_faults.push_back(fault),
            OceanFault::Spectrum(fault) => self.spectrum_faults.push_back(fault),
            OceanFault::Stale(times) => self.stale = times,
            OceanFault::InitLeavesSpectrum(leaves) => self.init_leaves_spectrum = leaves,
            OceanFault::LittleStatus(little) => self.little_status = little,
            OceanFault::Dead(dead) => self.dead = dead,
            OceanFault::Restart => self.restart(now),
        }
    }

    /// The spectra that were read out, oldest first; the last 512.
    pub fn exposures(&self) -> impl DoubleEndedIterator<Item = &Exposure> {
        self.exposures.iter()
    }

    /// Writes a slot of the EEPROM, as the maker does.
    pub fn set_slot(&mut self, slot: usize, bytes: &[u8]) {
        if let Some(place) = self.slots.get_mut(slot) {
            *place = bytes.to_vec();
        }
    }

    /// Integration time in force after the running period, in microseconds.
    pub fn time_us(&self) -> u64 {
        self.time_us
    }

    /// The lamp output is on.
    pub fn lamp(&self) -> bool {
        self.lamp
    }

    /// Leaves the bus and comes back with its power-up settings.
    fn restart(&mut self, now: Instant) {
        self.reset(now);
        self.initialise(now);
        self.registers = [0; 256];
        self.left_bus = true;
    }

    fn initialise(&mut self, now: Instant) {
        (self.time_us, self.trigger, self.lamp) = (POWER_UP_US, 0, false);
        self.periods.set(Duration::from_micros(POWER_UP_US), now);
    }

    fn words(&self) -> bool {
        self.spec.model != OceanModel::Usb2000
    }

    fn command(&mut self, bytes: &[u8], now: Instant) {
        let argument = |at: usize| bytes.get(at).copied().unwrap_or(0);
        let word = u16::from_le_bytes([argument(1), argument(2)]);
        match argument(0) {
            0x01 => {
                self.initialise(now);
                if self.init_leaves_spectrum {
                    self.request(now);
                }
            }
            0x02 => self.set_time(bytes, now),
            0x03 => self.lamp = word != 0,
            0x05 => self.answer_slot(argument(1), now),
            0x06 => self.set_slot(usize::from(argument(1)), bytes.get(2..).unwrap_or_default()),
            0x07 => self.set_slot(0, bytes.get(1..).unwrap_or_default()),
            0x08 => {
                let mut answer = vec![0x08];
                answer.extend(self.slots.first().into_iter().flatten());
                answer.resize(17, 0);
                self.answer(answer, now);
            }
            0x09 => self.request(now),
            0x0A => self.trigger = word,
            0x0B => self.answer(vec![0], now),
            0x0C => self.answer(vec![0; 7], now),
            0x6A if self.words() => {
                let value = u16::from_le_bytes([argument(2), argument(3)]);
                self.registers.iter_mut().skip(argument(1).into()).take(1).for_each(|r| *r = value);
            }
            0x6B if self.words() => {
                let value = self.registers.get(usize::from(argument(1))).copied().unwrap_or(0);
                let [low, high] = value.to_le_bytes();
                self.answer(vec![argument(1), low, high], now);
            }
            // Temperature of the board, 0.003906 degrees a digit: 25 degrees.
            0x6C if self.words() => self.answer(vec![0x08, 0x00, 0x19], now),
            0xFE => self.answer(self.status(), now),
            _ => {}
        }
    }

    /// Three bytes hold 16 bits, five 32; what is out of range changes nothing.
    fn set_time(&mut self, bytes: &[u8], now: Instant) {
        let value = match bytes {
            [_, low, high] => u32::from(u16::from_le_bytes([*low, *high])),
            [_, a, b, c, d, ..] => u32::from_le_bytes([*a, *b, *c, *d]),
            _ => return,
        };
        let (range, unit) = match self.spec.model {
            OceanModel::Usb2000 => (3..=65_535, 1000),
            OceanModel::Usb2000Plus => (1000..=65_535_000, 1),
            OceanModel::Usb4000 => (10..=65_535_000, 1),
        };
        if range.contains(&value) {
            self.time_us = u64::from(value) * unit;
            self.periods.set(Duration::from_micros(self.time_us), now);
        }
    }

    fn answer_slot(&mut self, slot: u8, now: Instant) {
        let mut answer = vec![0x05, slot];
        answer.extend(self.slots.get(usize::from(slot)).into_iter().flatten());
        answer.resize(17, 0);
        self.answer(answer, now);
    }

    fn status(&self) -> Vec<u8> {
        let pixels = self.figures.pixels as u16;
        let busy = u8::from(!self.pending.is_empty());
        let (lamp, trigger) = (u8::from(self.lamp), self.trigger as u8);
        if self.words() {
            let mut status = pixels.to_le_bytes().to_vec();
            status.extend((self.time_us as u32).to_le_bytes());
            let packets = (2 * self.figures.pixels / self.figures.packet) as u8;
            status.extend([lamp, trigger, busy, packets, 0, 0, 0, 0, 0x80, 0]);
            return status;
        }
        let time = (self.time_us / 1000) as u16;
        let order = |word: u16| if self.little_status { word.to_le_bytes() } else { word.to_be_bytes() };
        let mut status = [order(pixels), order(time)].concat();
        status.extend([lamp, trigger, busy, 0, u8::from(!self.spectra.is_empty())]);
        status.resize(16, 0);
        status
    }

    /// A short answer, with the fault that waits for it.
    fn answer(&mut self, mut answer: Vec<u8>, now: Instant) {
        let mut at = now + ANSWER;
        let previous = std::mem::replace(&mut self.last_answer, answer.clone());
        match self.query_faults.pop_front().unwrap_or(UsbFault::Pass) {
            UsbFault::Pass => {}
            UsbFault::Late(by) => at += by,
            UsbFault::NoReply => return,
            UsbFault::Cut(keep) => answer.truncate(keep),
            UsbFault::Corrupt(place, mask) => {
                let place = place % answer.len().max(1);
                answer.iter_mut().skip(place).take(1).for_each(|byte| *byte ^= mask);
            }
            UsbFault::Junk(junk) => self.queries.push(&junk, false, at),
            UsbFault::Previous => answer = previous,
            UsbFault::Duplicate => self.queries.push(&answer, false, at),
            UsbFault::Stall => return self.queries.halt(at),
            UsbFault::Babble => answer.resize(self.figures.packet + 1, 0xAA),
            UsbFault::Restart => return self.restart(now),
        }
        // Seventeen bytes are a packet; a longer one is the babble.
        if !answer.is_empty() {
            self.queries.push_packet(answer, at);
        }
    }

    /// Latches the running period: its spectrum is ready when it has ended and is read out.
    fn request(&mut self, now: Instant) {
        let (began, length) = self.periods.running(now);
        let ready = began + length + READOUT;
        let raw = self.expose(began, length);
        self.remember(Exposure { began, ended: began + length, raw });
        let mut bytes = self.pack();
        let stale = self.stale > 0;
        self.stale = self.stale.saturating_sub(1);
        if stale && !self.last_spectrum.is_empty() {
            bytes.clone_from(&self.last_spectrum);
        }
        let previous = std::mem::replace(&mut self.last_spectrum, bytes.clone());
        let mut at = ready;
        match self.spectrum_faults.pop_front().unwrap_or(UsbFault::Pass) {
            UsbFault::Pass => {}
            UsbFault::Late(by) => at += by,
            UsbFault::NoReply => return self.pending.push_back(at),
            UsbFault::Cut(keep) => bytes.truncate(keep),
            UsbFault::Corrupt(_, mask) => bytes.iter_mut().rev().take(1).for_each(|byte| *byte ^= mask),
            UsbFault::Junk(junk) => self.spectra.push(&junk, false, at),
            UsbFault::Previous if previous.is_empty() => return,
            UsbFault::Previous => bytes = previous,
            UsbFault::Duplicate => self.push_spectrum(&bytes.clone(), at),
            UsbFault::Stall => return self.spectra.halt(at),
            UsbFault::Babble => {
                let size = self.figures.packet + 1;
                bytes.truncate(size - 1);
                bytes.push(0xAA);
                self.spectra.push_packet(bytes, at);
                return self.pending.push_back(at);
            }
            UsbFault::Restart => return self.restart(now),
        }
        self.pending.push_back(at);
        self.push_spectrum(&bytes, at);
    }

    fn push_spectrum(&mut self, bytes: &[u8], at: Instant) {
        if self.spec.model == OceanModel::Usb4000 {
            let (first, rest) = bytes.split_at(FIRST_BYTES.min(bytes.len()));
            self.first.push(first, false, at);
            self.spectra.push(rest, false, at);
        } else {
            self.spectra.push(bytes, false, at);
        }
    }

    fn remember(&mut self, exposure: Exposure) {
        if self.exposures.len() >= MEMORY {
            self.exposures.pop_front();
        }
        self.exposures.push_back(exposure);
    }

    /// Raw counts of one period.
    fn expose(&mut self, began: Instant, length: Duration) -> Vec<u16> {
        self.number += 1;
        let f = self.figures;
        // The truth's light is in counts of 12 bits; a unit that saturates below its full scale divides its counts there.
        let level = self.slots.get(17).and_then(|s| Some(u16::from_le_bytes([*s.get(4)?, *s.get(5)?]))).unwrap_or(0);
        let top = if self.words() && level > 0 { level } else { f.full };
        let (scale, gain) = (f64::from(f.full) / 4095.0, f64::from(top) / f64::from(f.full));
        let wavelengths = self.polynomial(1..5);
        let linearity = self.polynomial(6..14);
        let key = Key::new(self.spec.seed).named("spectrometer");
        let pixel = |p: usize| {
            if self.dead {
                return DARK as u16;
            }
            let lit = (f.active.0..f.active.1).contains(&p);
            let nm = power_series(&wavelengths, p as f64);
            let light = if lit { gather(&self.spec.light, nm, began, length) } else { 0.0 };
            let counts = bend(light * scale, &linearity) / scale;
            let noise = if self.spec.noise { noise(key, self.number, p as u64, counts) } else { 0.0 };
            ((DARK + counts + noise) * scale * gain).round().clamp(0.0, f64::from(top)) as u16
        };
        (0..f.pixels).map(pixel).collect()
    }

    /// The coefficients in a range of slots; what is no number counts as zero.
    fn polynomial(&self, slots: std::ops::Range<usize>) -> Vec<f64> {
        let text = |slot: &Vec<u8>| {
            let end = slot.iter().position(|&b| b == 0).unwrap_or(slot.len());
            String::from_utf8_lossy(slot.get(..end).unwrap_or_default()).trim().parse().unwrap_or(0.0)
        };
        self.slots.get(slots).unwrap_or_default().iter().map(text).collect()
    }

    /// The last exposure as the bytes of its model.
    fn pack(&self) -> Vec<u8> {
        let raw = self.exposures.back().map(|e| e.raw.as_slice()).unwrap_or_default();
        let mut bytes = Vec::with_capacity(2 * raw.len() + 1);
        if self.words() {
            bytes.extend(raw.iter().flat_map(|count| count.to_le_bytes()));
        } else {
            for pixels in raw.chunks(64) {
                bytes.extend(pixels.iter().map(|count| count.to_le_bytes()[0]));
                // The upper four bits are not driven: here they carry the pixel's lowest.
                bytes.extend(pixels.iter().map(|count| count.to_le_bytes()[1] | (*count as u8) << 4));
            }
        }
        bytes.push(0x69);
        bytes
    }
}

impl UsbTwin for OceanTwin {
    fn descriptors(&self) -> Descriptors {
        self.spec.model.descriptors()
    }

    /// The device has no class or vendor requests.
    fn control(&mut self, _setup: SetupPacket, _bytes: &[u8], _now: Instant) -> Answer {
        Answer::Stall
    }

    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], now: Instant) -> Answer {
        while self.pending.pop_front_if(|at| *at <= now).is_some() {}
        if endpoint == self.figures.endpoints[0] {
            self.command(bytes, now);
        }
        Answer::Data(Vec::new())
    }

    fn bulk_in(&mut self, endpoint: u8, length: usize, now: Instant) -> Answer {
        let [_, query, spectrum, fourth] = self.figures.endpoints;
        let taken = match endpoint {
            e if e == query => self.queries.take(length, now),
            e if e == spectrum => self.spectra.take(length, now),
            e if e == fourth => self.first.take(length, now),
            _ => return Answer::Stall,
        };
        match taken {
            Taken::Bytes(bytes) => Answer::Data(bytes),
            Taken::Nothing => Answer::Nak,
            Taken::Halted => Answer::Stall,
        }
    }

    fn clear_halt(&mut self, endpoint: u8, _now: Instant) {
        let [_, query, spectrum, fourth] = self.figures.endpoints;
        match endpoint {
            e if e == query => self.queries.clear_halt(),
            e if e == spectrum => self.spectra.clear_halt(),
            e if e == fourth => self.first.clear_halt(),
            _ => {}
        }
    }

    fn reset(&mut self, _now: Instant) {
        self.queries.clear();
        self.spectra.clear();
        self.first.clear();
        self.pending.clear();
    }

    fn due(&self) -> Option<Instant> {
        [&self.queries, &self.spectra, &self.first].into_iter().filter_map(InEndpoint::due).min()
    }

    fn left_bus(&mut self) -> bool {
        std::mem::take(&mut self.left_bus)
    }
}
