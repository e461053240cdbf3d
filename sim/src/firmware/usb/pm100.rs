//! Twin of the Thorlabs PM100D, PM100A and PM100USB power meters with a photodiode head.
//!
//! Source: the protocol sheet `thorlabs-pm100-usbtmc`; command tree of the PM100D manual, SCPI chapter.

use super::endpoint::UsbFault;
use super::pm100_tree::{COMMANDS, Command, Quantity};
use super::scpi::{self, Unit, number};
use super::tmc::{self, FrameFault, Received, TmcPort};
use crate::front::usb::{Answer, Descriptors, SetupPacket, Speed, UsbTwin};
use crate::truth::rng::Key;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Radiant power on the head in watts at an instant.
pub type Power = Arc<dyn Fn(Instant) -> f64 + Send + Sync>;

/// Time until an answer that measures nothing is ready, and time of one averaged sample.
const ANSWER: Duration = Duration::from_millis(2);
const SAMPLE: Duration = Duration::from_millis(3);
/// Looks at the light within one averaged reading.
const LOOKS: u32 = 8;
/// Entries of the error queue.
const MOST_ERRORS: usize = 30;
/// Ranges of an S120VC in watts.
const RANGES: [f64; 7] = [50e-9, 500e-9, 5e-6, 50e-6, 500e-6, 5e-3, 50e-3];
/// A reading may exceed its range by so much.
const OVER: f64 = 1.1;
/// Event of power-up.
const POWER_ON: u8 = 128;
/// What stands for a reading beyond the range.
const INFINITE: f64 = 9.9e37;
/// First reading after a change of range.
const UNSETTLED: f64 = 0.93;
/// Wavelengths of the head.
const WAVELENGTHS: (f64, f64) = (200.0, 1100.0);

/// Models of the family.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pm100Model {
    /// Handheld, with display.
    Pm100D,
    /// With a needle.
    Pm100A,
    /// Without display.
    Pm100Usb,
}

/// What a meter and its head are.
#[derive(Clone)]
pub struct Pm100Spec {
    /// Model.
    pub model: Pm100Model,
    /// Maker as `*IDN?` says it: `THORLABS` in the manual, `Thorlabs` in some units.
    pub maker: String,
    /// Serial number of the meter.
    pub serial: String,
    /// What `SYST:SENS:IDN?` says: name, serial, calibration text, type, subtype, flags; `None` without a head.
    pub head: Option<String>,
    /// Light on the head.
    pub power: Power,
    /// Wavelength of that light in nm: set another one, and the reading is off by the ratio of responsivities.
    pub wavelength_nm: f64,
    /// Standard deviation of one sample relative to its value.
    pub noise: f64,
    /// Seed of the noise.
    pub seed: u64,
}

/// Faults of the meter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pm100Fault {
    /// A fault of the next answer.
    Wire(UsbFault),
    /// A fault of the frame around the next part.
    Frame(FrameFault),
    /// The head is pulled out, or another one (its text) is plugged in.
    Head(Option<String>),
    /// Restart now: leaves the bus, comes back with its power-up settings.
    Restart,
    /// Somebody turns the wavelength by hand, in nm.
    WavelengthByHand(u32),
}

/// A meter.
pub struct Pm100Twin {
    spec: Pm100Spec,
    port: TmcPort,
    faults: VecDeque<UsbFault>,
    errors: VecDeque<(i32, &'static str)>,
    /// Standard events since they were last read: 128 power on, 32 command, 16 execution, 4 query error, 1 done.
    events: u8,
    /// What `READ?` and `INIT` measure.
    quantity: Quantity,
    /// Settings that are only kept, by pattern.
    kept: BTreeMap<&'static str, String>,
    wavelength: f64,
    average: u32,
    automatic: bool,
    range: usize,
    unit_dbm: bool,
    unsettled: bool,
    zero_running: Option<Instant>,
    measured: f64,
    readings: u64,
    history: VecDeque<f64>,
    left_bus: bool,
}

// === impl Pm100Spec ===

impl Pm100Spec {
    /// A PM100D with an S120VC head in steady light of 1 mW at 550 nm.
    pub fn new(serial: &str) -> Pm100Spec {
        Pm100Spec {
            model: Pm100Model::Pm100D,
            maker: "THORLABS".to_owned(),
            serial: serial.to_owned(),
            head: Some("S120VC,12345,10-Jan-2010,1,1,33".to_owned()),
            power: Arc::new(|_| 1e-3),
            wavelength_nm: 550.0,
            noise: 1e-4,
            seed: 1,
        }
    }
}

/// Responsivity of a silicon photodiode in A/W, near enough: rising to 950 nm, falling beyond.
pub fn responsivity(nm: f64) -> f64 {
    let rise = 0.05 + 0.6 * ((nm - 200.0) / 750.0).clamp(0.0, 1.0);
    let fall = ((nm - 950.0) / 150.0).clamp(0.0, 1.0);
    rise * (1.0 - 0.7 * fall)
}

// === impl Pm100Twin ===

impl Pm100Twin {
    /// A meter powered up.
    pub fn new(spec: Pm100Spec) -> Pm100Twin {
        Pm100Twin {
            spec,
            port: TmcPort::new(),
            faults: VecDeque::new(),
            errors: VecDeque::new(),
            events: POWER_ON,
            quantity: Quantity::Power,
            kept: BTreeMap::new(),
            wavelength: 635.0,
            average: 1,
            automatic: true,
            range: RANGES.len() - 1,
            unit_dbm: false,
            unsettled: false,
            zero_running: None,
            measured: 0.0,
            readings: 0,
            history: VecDeque::new(),
            left_bus: false,
        }
    }

    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        !self.faults.is_empty()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: Pm100Fault) {
        match fault {
            Pm100Fault::Wire(fault) => self.faults.push_back(fault),
            Pm100Fault::Frame(fault) => self.port.inject(fault),
            Pm100Fault::Head(head) => self.spec.head = head,
            Pm100Fault::Restart => self.restart(),
            Pm100Fault::WavelengthByHand(nm) => self.wavelength = f64::from(nm),
        }
    }

    /// What was measured, oldest first; the last 512 values as the meter wrote them.
    pub fn history(&self) -> impl DoubleEndedIterator<Item = f64> {
        self.history.iter().copied()
    }

    /// The wavelength that is set.
    pub fn wavelength(&self) -> f64 {
        self.wavelength
    }

    /// Replaces the light on the head.
    pub fn set_power(&mut self, power: Power) {
        self.spec.power = power;
    }

    fn restart(&mut self) {
        self.port.clear();
        self.errors.clear();
        self.preset();
        self.events = POWER_ON;
        self.wavelength = 635.0;
        self.left_bus = true;
    }

    /// `*RST`.
    fn preset(&mut self) {
        (self.average, self.automatic, self.unit_dbm, self.quantity) = (1, true, false, Quantity::Power);
        self.kept.clear();
        self.zero_running = None;
    }

    fn fault(&mut self, code: i32, text: &'static str) {
        self.events |= match code {
            -199..=-100 => 32,
            -299..=-200 => 16,
            -499..=-400 => 4,
            _ => 8,
        };
        if self.errors.len() < MOST_ERRORS {
            self.errors.push_back((code, text));
        }
    }

    fn message(&mut self, bytes: &[u8], now: Instant) {
        let Ok(text) = std::str::from_utf8(bytes) else { return self.fault(-101, "Invalid character") };
        let mut answers = Vec::new();
        let mut ready = now + ANSWER;
        let mut path = String::new();
        for unit in scpi::units(text) {
            let answer = self.execute(&unit, &mut path, now, &mut ready);
            answers.extend(answer);
        }
        if !answers.is_empty() {
            let fault = self.faults.pop_front().unwrap_or(UsbFault::Pass);
            let line = format!("{}\n", answers.join(";"));
            if !self.port.answer(line.into_bytes(), ready, fault) {
                self.restart();
            }
        }
    }

    /// Finds the command below the path of the one before it, else from the root.
    fn execute(&mut self, unit: &Unit, path: &mut String, now: Instant, ready: &mut Instant) -> Option<String> {
        let below = format!("{path}{}", unit.header);
        let find = |header: &str| COMMANDS.iter().find(|(pattern, _)| scpi::matches(pattern, header));
        let relative = if unit.absolute { None } else { find(&below).map(|found| (found, below.as_str())) };
        let Some(((pattern, command), header)) = relative.or_else(|| Some((find(&unit.header)?, unit.header.as_str())))
        else {
            self.fault(-113, "Undefined header");
            return None;
        };
        if !unit.header.starts_with('*') {
            *path = header.rfind(':').map(|end| header.get(..=end).unwrap_or_default().to_owned()).unwrap_or_default();
        }
        match (*command, unit.query) {
            (Command::StatusByte, true) => Some(self.status(now).to_string()),
            (command, _) => self.obey(command, pattern, unit, ready),
        }
    }

    fn obey(&mut self, command: Command, pattern: &'static str, unit: &Unit, ready: &mut Instant) -> Option<String> {
        let parameter = unit.parameters.first().map(String::as_str);
        match (command, unit.query) {
            (Command::Identify, true) => {
                let model = ["PM100D", "PM100A", "PM100USB"][self.spec.model as usize];
                Some(format!("{},{model},{},2.4.0", self.spec.maker, self.spec.serial))
            }
            (Command::Head, true) => Some(self.spec.head.clone().unwrap_or_else(|| "no sensor".to_owned())),
            (Command::Error, true) => {
                let (code, text) = self.errors.pop_front().unwrap_or((0, "No error"));
                Some(format!("{code:+},\"{text}\""))
            }
            (Command::Constant(value), true) => Some(value.to_owned()),
            (Command::Clear, false) => {
                self.errors.clear();
                self.events = 0;
                None
            }
            (Command::EventStatus, true) => Some(std::mem::take(&mut self.events).to_string()),
            (Command::Reset, false) => {
                self.preset();
                None
            }
            (Command::Nothing, false) => None,
            (Command::Configure(quantity) | Command::Measure(quantity), false) => {
                self.quantity = quantity;
                if matches!(command, Command::Measure(_)) {
                    self.measure(ready);
                }
                None
            }
            (Command::Configured, false) => {
                self.quantity = Quantity::Power;
                None
            }
            (Command::Configured | Command::Configure(_), true) => Some(self.quantity.name().to_owned()),
            (Command::Measure(quantity), true) => {
                self.quantity = quantity;
                self.automatic |= quantity == Quantity::Power;
                self.read(ready)
            }
            (Command::Initiate, false) => {
                self.measure(ready);
                None
            }
            (Command::Read, true) => self.read(ready),
            (Command::Fetch, true) => self.reading(),
            (Command::Zero, false) => {
                self.zero_running = Some(*ready + Duration::from_secs(1));
                None
            }
            (Command::ZeroState, true) => Some(u8::from(self.zero_running.is_some_and(|end| *ready < end)).to_string()),
            (Command::Kept(default), true) => {
                Some(self.kept.get(pattern).cloned().unwrap_or_else(|| default.to_owned()))
            }
            (Command::Kept(_), false) => {
                self.keep(pattern, parameter);
                None
            }
            (Command::KeptNumber(default, least, most), query) => {
                let value = self.kept.get(pattern).and_then(|text| text.parse().ok()).unwrap_or(default);
                self.numeric(query, parameter, value, (least, most, default), |twin, value| {
                    twin.kept.insert(pattern, number(value));
                })
            }
            _ => self.setting(command, unit.query, parameter),
        }
    }

    /// A setting that is only kept.
    fn keep(&mut self, pattern: &'static str, parameter: Option<&str>) {
        match parameter {
            Some("ON") => drop(self.kept.insert(pattern, "1".to_owned())),
            Some("OFF") => drop(self.kept.insert(pattern, "0".to_owned())),
            Some(value) => drop(self.kept.insert(pattern, value.to_owned())),
            None => self.fault(-109, "Missing parameter"),
        }
    }

    /// Settings that bear on what is measured.
    fn setting(&mut self, command: Command, query: bool, parameter: Option<&str>) -> Option<String> {
        match (command, query) {
            (Command::Wavelength, query) => {
                let limits = (WAVELENGTHS.0, WAVELENGTHS.1, 635.0);
                self.numeric(query, parameter, self.wavelength, limits, |twin, nm| twin.wavelength = nm)
            }
            (Command::Average, query) => {
                let count = f64::from(self.average);
                let set = |twin: &mut Pm100Twin, n: f64| twin.average = n as u32;
                let answer = self.numeric(query, parameter, count, (1.0, 3000.0, 1.0), set)?;
                Some(format!("{}", answer.parse::<f64>().unwrap_or(count)))
            }
            (Command::Range, query) => {
                let limits = (RANGES[0], RANGES[RANGES.len() - 1], RANGES[RANGES.len() - 1]);
                self.numeric(query, parameter, RANGES[self.range.min(RANGES.len() - 1)], limits, |twin, upper| {
                    twin.automatic = false;
                    twin.choose(upper);
                })
            }
            (Command::AutoRange, true) => Some(u8::from(self.automatic).to_string()),
            (Command::AutoRange, false) => {
                match parameter {
                    Some("ON" | "1") => self.automatic = true,
                    Some("OFF" | "0") => self.automatic = false,
                    Some(_) => self.fault(-104, "Data type error"),
                    None => self.fault(-109, "Missing parameter"),
                }
                None
            }
            (Command::Unit, true) => Some(if self.unit_dbm { "DBM" } else { "W" }.to_owned()),
            (Command::Unit, false) => {
                match parameter {
                    Some("W") => self.unit_dbm = false,
                    Some("DBM") => self.unit_dbm = true,
                    Some(_) => self.fault(-224, "Illegal parameter value"),
                    None => self.fault(-109, "Missing parameter"),
                }
                None
            }
            _ => {
                self.fault(-113, "Undefined header");
                None
            }
        }
    }

    /// A setting that is a number: read with `MIN`, `MAX`, `DEF` or alone, written within its limits.
    fn numeric(
        &mut self,
        query: bool,
        parameter: Option<&str>,
        value: f64,
        (least, most, default): (f64, f64, f64),
        set: impl FnOnce(&mut Pm100Twin, f64),
    ) -> Option<String> {
        let named = match parameter {
            Some("MIN" | "MINIMUM") => Some(least),
            Some("MAX" | "MAXIMUM") => Some(most),
            Some("DEF" | "DEFAULT") => Some(default),
            _ => None,
        };
        if query {
            return Some(number(named.unwrap_or(value)));
        }
        match named.or_else(|| parameter?.parse().ok()) {
            Some(value) if (least..=most).contains(&value) => set(self, value),
            Some(_) => self.fault(-222, "Data out of range"),
            None if parameter.is_some() => self.fault(-104, "Data type error"),
            None => self.fault(-109, "Missing parameter"),
        }
        None
    }

    /// Takes the smallest range that holds `upper`; the first reading in a new one is off.
    fn choose(&mut self, upper: f64) {
        let range = RANGES.iter().position(|&range| upper.abs() <= range * 1.000_001).unwrap_or(RANGES.len() - 1);
        self.unsettled |= range != self.range;
        self.range = range;
    }

    /// Measures for as long as the average takes.
    fn measure(&mut self, ready: &mut Instant) {
        let window = SAMPLE * self.average;
        let looks = (0..LOOKS).map(|i| *ready + window.mul_f64((f64::from(i) + 0.5) / f64::from(LOOKS)));
        let mean = looks.map(|at| (self.spec.power)(at)).sum::<f64>() / f64::from(LOOKS);
        *ready += window;
        self.readings += 1;
        if self.spec.head.is_none() {
            self.measured = 0.0;
            return self.remember();
        }
        let noise = self.spec.noise / f64::from(self.average).sqrt();
        let random = Key::new(self.spec.seed).named("power meter").normal(self.readings);
        let corrected = mean * responsivity(self.spec.wavelength_nm) / responsivity(self.wavelength);
        let value = corrected * (1.0 + noise * random) + 1e-11 * random;
        if self.automatic {
            self.choose(value);
        }
        let upper = RANGES.get(self.range).copied().unwrap_or(f64::MAX);
        self.measured = match std::mem::take(&mut self.unsettled) {
            _ if value > upper * OVER => INFINITE,
            true => value * UNSETTLED,
            false => value,
        };
        self.remember();
    }

    fn remember(&mut self) {
        if self.history.len() >= 512 {
            self.history.pop_front();
        }
        self.history.push_back(self.last().parse().unwrap_or(f64::NAN));
    }

    fn read(&mut self, ready: &mut Instant) -> Option<String> {
        self.measure(ready);
        self.reading()
    }

    /// The last measurement as the quantity that is configured; what a photodiode cannot give is an error.
    fn reading(&mut self) -> Option<String> {
        let watts = self.measured;
        match self.quantity {
            Quantity::Power => Some(self.last()),
            Quantity::Current => Some(number(watts * responsivity(self.wavelength))),
            Quantity::PowerDensity => {
                let beam = self.kept.get("[SENSe]:CORRection:BEAMdiameter");
                let diameter_cm = beam.and_then(|text| text.parse::<f64>().ok()).unwrap_or(9.5) / 10.0;
                Some(number(watts / (std::f64::consts::FRAC_PI_4 * diameter_cm * diameter_cm)))
            }
            Quantity::Frequency => Some(number(0.0)),
            Quantity::Other(_) => {
                self.fault(-221, "Settings conflict");
                None
            }
        }
    }

    fn last(&self) -> String {
        let watts = self.measured;
        number(if self.unit_dbm && watts < INFINITE { 10.0 * (watts.max(1e-15) / 1e-3).log10() } else { watts })
    }

    fn status(&self, now: Instant) -> u8 {
        let (available, errors) = (self.port.message_available(now), !self.errors.is_empty());
        let mask: u8 = self.kept.get("*ESE").and_then(|text| text.parse().ok()).unwrap_or(0);
        u8::from(available) << 4 | u8::from(errors) << 2 | u8::from(self.events & mask != 0) << 5
    }
}

impl UsbTwin for Pm100Twin {
    fn descriptors(&self) -> Descriptors {
        let [p0, p1] = [0x8078_u16, 0x8076, 0x8072][self.spec.model as usize].to_le_bytes();
        let device = vec![18, 1, 0, 2, 0, 0, 0, 64, 0x13, 0x13, p0, p1, 0x00, 0x01, 1, 2, 3, 1];
        let mut configuration = vec![9, 2, 32, 0, 1, 1, 0, 0x80, 250];
        configuration.extend([9, 4, 0, 0, 2, 0xFE, 0x03, 0x01, 0]);
        for endpoint in [tmc::OUT, tmc::IN] {
            configuration.extend([7, 5, endpoint, 2, tmc::PACKET as u8, 0, 0]);
        }
        let name = ["PM100D", "PM100A", "PM100USB"][self.spec.model as usize];
        let strings = vec!["Thorlabs".to_owned(), name.to_owned(), self.spec.serial.clone()];
        Descriptors { device, configuration, strings, speed: Speed::Full }
    }

    fn control(&mut self, setup: SetupPacket, _bytes: &[u8], now: Instant) -> Answer {
        let status = self.status(now);
        self.port.control(setup, status, now)
    }

    fn bulk_out(&mut self, endpoint: u8, bytes: &[u8], now: Instant) -> Answer {
        if endpoint != tmc::OUT {
            return Answer::Stall;
        }
        match self.port.receive(bytes) {
            Received::Message(message) => self.message(&message, now),
            Received::Unterminated => self.fault(-420, "Query UNTERMINATED"),
            Received::Nothing => {}
            Received::Halted => return Answer::Stall,
        }
        Answer::Data(Vec::new())
    }

    fn bulk_in(&mut self, endpoint: u8, length: usize, now: Instant) -> Answer {
        if endpoint == tmc::IN { self.port.give(length, now) } else { Answer::Stall }
    }

    fn clear_halt(&mut self, endpoint: u8, _now: Instant) {
        self.port.clear_halt(endpoint);
    }

    fn reset(&mut self, _now: Instant) {
        self.port.clear();
    }

    fn due(&self) -> Option<Instant> {
        self.port.due()
    }

    fn left_bus(&mut self) -> bool {
        std::mem::take(&mut self.left_bus)
    }
}
