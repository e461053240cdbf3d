//! Twin of the Newport 1830-C power meter: the photodiode that looks at the bench's lamp.
//!
//! Source: 1830-C remote commands as public clients use them. Assumptions are constants here.

use super::Firmware;
use super::outbox::{Outbox, WireFault};
use crate::truth::lamp::SimLamp;
use crate::truth::rng::Key;
use std::time::Duration;
use tokio::time::Instant;

/// Time until a request is answered.
const ANSWER: Duration = Duration::from_millis(10);
/// Time between two readings of the converter.
const SAMPLE: Duration = Duration::from_millis(50);
/// Auto-calibration takes the signal away this long (assumed).
const CALIBRATION: Duration = Duration::from_secs(5);
/// Longest line taken.
const MAX_LINE: usize = 64;
/// Full scale of range 1; each range is ten times the one before (assumed, silicon head without attenuator).
const RANGE_1_W: f64 = 1e-9;
/// The head's calibration, nanometres.
const HEAD_NM: (u16, u16) = (400, 1100);
/// Wavelength at which the lamp's power on the diode is told right.
const REFERENCE_NM: f64 = 550.0;
/// Attenuation of the head's filter.
const ATTENUATOR: f64 = 1000.0;

/// Faults of the light monitor.
#[derive(Debug, Clone, PartialEq)]
pub enum MonitorFault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// It restarts now: settings are those of power-up.
    Restart,
    /// The next request makes it restart without an answer.
    RestartOnCommand,
    /// Somebody sets the wavelength at the front panel, lockout or not.
    FrontWavelength(u16),
    /// Somebody presses the hold key.
    Hold,
    /// Somebody sets these units.
    FrontUnits(u8),
    /// The head is pulled out: it reads zero.
    NoHead(bool),
    /// The host left half a command behind.
    HalfCommand(String),
    /// The next setting is swallowed.
    SettingSwallowed,
}

/// A power meter.
#[derive(Debug)]
pub struct Newport1830cTwin {
    outbox: Outbox,
    lamp: SimLamp,
    line: Vec<u8>,
    /// Power that saturates the head without attenuator.
    pub saturates_w: f64,
    /// Relative noise of one sample of the converter.
    pub noise: f64,
    powered: Instant,
    settings: Settings,
    status: u8,
    busy_until: Instant,
    no_head: bool,
    restart_on_command: bool,
    swallow: bool,
}

/// What can be set, with its values at power-up.
#[derive(Debug, Clone)]
struct Settings {
    attenuator: bool,
    beep: bool,
    echo: bool,
    filter: u8,
    /// Since when readings are held.
    held: Option<Instant>,
    keypad: u8,
    lockout: bool,
    mask: u8,
    /// 0 = automatic.
    range: u8,
    reference_w: f64,
    units: u8,
    wavelength: u16,
    zero_w: Option<f64>,
}

// === impl Newport1830cTwin ===

impl Newport1830cTwin {
    /// A meter powered up at `now` that looks at `lamp`.
    pub fn new(lamp: SimLamp, now: Instant) -> Newport1830cTwin {
        Newport1830cTwin {
            outbox: Outbox::default(),
            lamp,
            line: Vec::new(),
            saturates_w: 5e-3,
            noise: 2e-4,
            powered: now,
            settings: Settings::default(),
            status: 0,
            busy_until: now,
            no_head: false,
            restart_on_command: false,
            swallow: false,
        }
    }

    /// Looks at another lamp from now on.
    pub fn look_at(&mut self, lamp: SimLamp) {
        self.lamp = lamp;
    }

    /// The lamp it looks at.
    pub fn lamp(&self) -> &SimLamp {
        &self.lamp
    }

    /// The wavelength of the correction that is set, in nanometres.
    pub fn wavelength_nm(&self) -> f64 {
        f64::from(self.settings.wavelength)
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: MonitorFault, now: Instant) {
        match fault {
            MonitorFault::Wire(fault) => self.outbox.inject(fault),
            MonitorFault::Restart => self.restart(now),
            MonitorFault::RestartOnCommand => self.restart_on_command = true,
            MonitorFault::FrontWavelength(nm) => self.settings.wavelength = nm,
            MonitorFault::Hold => self.settings.held = Some(now),
            MonitorFault::FrontUnits(units) => self.settings.units = units.clamp(1, 4),
            MonitorFault::NoHead(gone) => self.no_head = gone,
            MonitorFault::HalfCommand(text) => self.line = text.into_bytes(),
            MonitorFault::SettingSwallowed => self.swallow = true,
        }
    }

    /// True while a fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait() || self.restart_on_command || self.swallow
    }

    fn restart(&mut self, now: Instant) {
        self.settings = Settings::default();
        self.status = 0;
        self.powered = now;
        self.line.clear();
        self.outbox.clear();
    }

    /// Power that a reading at `at` shows in watts: the mean of the filter's samples, corrected for the wavelength set.
    pub fn power_w(&self, at: Instant) -> f64 {
        let at = self.settings.held.map_or(at, |held| held.min(at));
        let depth: u128 = [16, 4, 1][usize::from(self.settings.filter.clamp(1, 3)) - 1];
        let last = at.saturating_duration_since(self.powered).as_nanos() / SAMPLE.as_nanos();
        let first = last.saturating_sub(depth - 1);
        let sum: f64 = (first..=last).map(|n| self.sample(n as u64)).sum();
        sum / (last - first + 1) as f64 * correction(self.settings.wavelength) - self.settings.zero_w.unwrap_or(0.0)
    }

    fn sample(&self, n: u64) -> f64 {
        if self.no_head {
            return 0.0;
        }
        let at = self.powered + SAMPLE * u32::try_from(n).unwrap_or(u32::MAX);
        let noise = 1.0 + self.noise * Key::new(0).named("light monitor").normal(n);
        self.lamp.monitor_w(at) * noise
    }

    /// Range in use, 1 to 8.
    fn range(&self, power: f64) -> u8 {
        match self.settings.range {
            0 => (1..8).find(|r| power.abs() <= full_scale(*r)).unwrap_or(8),
            set => set,
        }
    }

    fn request(&mut self, line: &str, now: Instant) {
        if std::mem::take(&mut self.restart_on_command) {
            return self.restart(now);
        }
        let mut letters = line.trim().chars();
        let Some(letter) = letters.next() else { return };
        let argument = letters.as_str().trim();
        match (letter.to_ascii_uppercase(), argument) {
            (letter, "?") => self.query(letter, now),
            ('C', "S" | "s") => self.status = 0,
            ('S', "") => self.settings.reference_w = self.power_w(now),
            ('O', "") => self.busy_until = now + CALIBRATION,
            (letter, value) => match value.parse::<u16>() {
                Ok(value) if std::mem::take(&mut self.swallow) => tracing::debug!(%letter, value, "swallowed"),
                Ok(value) => self.set(letter, value, now),
                Err(_) => self.status |= 2,
            },
        }
    }

    fn query(&mut self, letter: char, now: Instant) {
        let power = self.power_w(now);
        let s = &self.settings;
        let value = match letter {
            'A' => u16::from(s.attenuator),
            'B' => u16::from(s.beep),
            'E' => u16::from(s.echo),
            'F' => u16::from(s.filter),
            'G' => u16::from(s.held.is_none()),
            'K' => u16::from(s.keypad),
            'L' => u16::from(s.lockout),
            'M' => u16::from(s.mask),
            'R' => u16::from(self.range(power)),
            'U' => u16::from(s.units),
            'W' => s.wavelength,
            'Z' => u16::from(s.zero_w.is_some()),
            'Q' => u16::from(self.status_byte(power, now)),
            'D' => return self.answer(&self.reading(power), now),
            'S' => return self.answer(&scientific(s.reference_w), now),
            _ => {
                self.status |= 2;
                return;
            }
        };
        self.answer(&value.to_string(), now);
    }

    fn set(&mut self, letter: char, value: u16, now: Instant) {
        let flag = value == 1;
        let power = self.power_w(now);
        let s = &mut self.settings;
        let byte = u8::try_from(value).unwrap_or(u8::MAX);
        match (letter, value) {
            ('A', 0 | 1) => s.attenuator = flag,
            ('B', 0 | 1) => s.beep = flag,
            ('E', 0 | 1) => s.echo = flag,
            ('F', 1..=3) => s.filter = byte,
            ('G', 0) => s.held = s.held.or(Some(now)),
            ('G', 1) => s.held = None,
            ('K', 0..=2) => s.keypad = byte,
            ('L', 0 | 1) => s.lockout = flag,
            ('M', 0..=255) => s.mask = byte,
            ('R', 0..=8) => s.range = byte,
            ('U', 1..=4) => s.units = byte,
            ('W', nm) if (HEAD_NM.0..=HEAD_NM.1).contains(&nm) => s.wavelength = nm,
            ('Z', 0) => s.zero_w = None,
            ('Z', 1) => s.zero_w = Some(power + s.zero_w.unwrap_or(0.0)),
            ('A' | 'B' | 'E' | 'F' | 'G' | 'K' | 'L' | 'M' | 'R' | 'U' | 'W' | 'Z', _) => self.status |= 1,
            _ => self.status |= 2,
        }
    }

    fn saturation_w(&self) -> f64 {
        self.saturates_w * if self.settings.attenuator { ATTENUATOR } else { 1.0 }
    }

    fn status_byte(&self, power: f64, now: Instant) -> u8 {
        let saturated = u8::from(power > self.saturation_w()) * 4;
        let over = u8::from(power > full_scale(self.range(power))) * 8;
        let busy = u8::from(now < self.busy_until) * 32;
        self.status | saturated | over | busy | 0x80
    }

    /// A reading in the units set (3 is dBm here; sources conflict on 2 and 3).
    fn reading(&self, power: f64) -> String {
        let power = power.min(self.saturation_w()).min(full_scale(self.range(power)));
        let decibels = |reference: f64| format!("{:+.2}", 10.0 * (power.abs().max(1e-15) / reference).log10());
        match self.settings.units {
            2 => decibels(self.settings.reference_w),
            3 => decibels(1e-3),
            4 => scientific(power / self.settings.reference_w),
            _ => scientific(power),
        }
    }

    fn answer(&mut self, text: &str, now: Instant) {
        self.outbox.reply(now + ANSWER, format!("{text}\n").as_bytes());
    }
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            attenuator: false,
            beep: true,
            echo: false,
            filter: 2,
            held: None,
            keypad: 1,
            lockout: false,
            mask: 0,
            range: 0,
            reference_w: 1e-3,
            units: 1,
            wavelength: 633,
            zero_w: None,
        }
    }
}

/// Silicon: the response rises with the wavelength; a wrong wavelength set makes the reading wrong by the ratio.
fn correction(wavelength: u16) -> f64 {
    REFERENCE_NM / f64::from(wavelength.max(1))
}

fn full_scale(range: u8) -> f64 {
    RANGE_1_W * 10_f64.powi(i32::from(range) - 1)
}

/// Five digits and an exponent that is a multiple of three: `+1.0012E-3`.
fn scientific(value: f64) -> String {
    let exponent = if value == 0.0 { 0 } else { (value.abs().log10() / 3.0).floor() as i32 * 3 };
    format!("{:+.4}E{exponent}", value / 10_f64.powi(exponent))
}

impl Firmware for Newport1830cTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if self.settings.echo {
                self.outbox.unasked(now, &[byte]);
            }
            match byte {
                b'\n' => {
                    let line = std::mem::take(&mut self.line);
                    self.request(&String::from_utf8_lossy(&line), now);
                }
                _ if self.line.len() < MAX_LINE => self.line.push(byte),
                _ => {}
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        self.outbox.due()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.outbox.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.outbox.clear();
    }
}
