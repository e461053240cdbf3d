//! Driver `newport-1830c`: optical power meter 1830-C on its RS-232 line, as light monitor.
//!
//! Source: 1830-C instruction manual (remote commands) as quoted by public clients; protocol sheet
//! `thorlabs-pm100-usbtmc`, section 4. Commands are a letter and digits ended by LF; a setting is not answered, so it is
//! asked for afterwards. No checksum: settings count when two answers agree, power is the median of several readings.
//! Never sent: O (auto-calibration, takes the signal away), Z1 (zero), S (reference).

use super::LightMonitorConfig;
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, LightMonitor, LightReading};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::{Connector, Link};
use crate::units::Nanometres;
use async_trait::async_trait;
use std::time::Duration;

/// Factory setting of the line.
pub const BAUD: u32 = 9600;
/// Limit of a query: a reading takes up to 0.5 s.
const QUERY_LIMIT: Duration = Duration::from_secs(1);
/// Quiet time that ends a drain.
const QUIET: Duration = Duration::from_millis(100);
/// Tries of everything that may be tried again.
const TRIES: u32 = 4;
/// Readings whose median is the reading, and how many when they scatter.
const READINGS: [usize; 2] = [3, 5];
/// Relative scatter above which more readings are taken.
const SCATTER: f64 = 0.01;
/// Units code of watts (sources agree on this one; on dB and dBm they do not).
pub const WATTS: u16 = 1;
/// Wavelengths that the meter takes in nanometres (one source: four digits).
pub const WAVELENGTHS_NM: (f64, f64) = (200.0, 2000.0);

/// Bits of the status byte.
pub mod status {
    /// A value was refused.
    pub const PARAMETER_ERROR: u16 = 1;
    /// A command was not understood.
    pub const COMMAND_ERROR: u16 = 2;
    /// The detector is saturated.
    pub const SATURATED: u16 = 4;
    /// The power is above the range.
    pub const OVER_RANGE: u16 = 8;
    /// The meter changes range or calibrates.
    pub const BUSY: u16 = 32;
}

/// Settings that the driver makes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Setting {
    Wavelength,
    Units,
    /// 1 slow (16 readings averaged), 2 medium (4), 3 fast (none).
    Filter,
    /// 1 measures, 0 holds.
    Go,
    /// 1: keys of the front panel do nothing. It is off after power-up, and so betrays a restart (assumed).
    Lockout,
    /// Background that is subtracted.
    Zero,
}

/// A power meter on its link.
pub struct Newport1830c {
    connector: Box<dyn Connector>,
    link: Option<Link>,
    clock: Clock,
    label: String,
    config: LightMonitorConfig,
    suspect: bool,
    wavelength: Option<u16>,
}

// === impl Setting ===

impl Setting {
    fn letter(self) -> char {
        match self {
            Setting::Wavelength => 'W',
            Setting::Units => 'U',
            Setting::Filter => 'F',
            Setting::Go => 'G',
            Setting::Lockout => 'L',
            Setting::Zero => 'Z',
        }
    }

    /// The value every reading needs, besides wavelength and filter.
    fn needed(self) -> Option<u16> {
        match self {
            Setting::Units => Some(WATTS),
            Setting::Go | Setting::Lockout => Some(1),
            Setting::Zero => Some(0),
            Setting::Wavelength | Setting::Filter => None,
        }
    }
}

// === impl Newport1830c ===

impl Newport1830c {
    /// A power meter over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: LightMonitorConfig, clock: Clock) -> Newport1830c {
        let label = format!("{} ({})", config.name, connector.port());
        Newport1830c { connector, link: None, clock, label, config, suspect: true, wavelength: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    /// The filter that averages at least what the instrument file asks for.
    fn filter(&self) -> u16 {
        match self.config.average {
            0 | 1 => 3,
            2..=4 => 2,
            _ => 1,
        }
    }

    /// Ends half a command, switches the echo off, forgets old errors, and requires one plain answer.
    async fn synchronise(&mut self) -> Result<()> {
        self.suspect = true;
        for _ in 0..TRIES {
            self.drain().await?;
            self.send("\nE0\nCS\n").await?;
            self.drain().await?;
            self.send("U?\n").await?;
            let line = self.line().await?;
            let late = self.drain().await?;
            if late == 0 && line.is_some_and(|l| matches!(l.trim(), "1" | "2" | "3" | "4")) {
                self.suspect = false;
                return Ok(());
            }
        }
        let what =
            format!("no plain answer to `U?` in {TRIES} tries; check power, cable, baud rate and the right device");
        Err(self.error(ErrorKind::Timeout, what))
    }

    /// One query and its line. After any failure the line is synchronised before the next.
    async fn ask(&mut self, query: &str) -> Result<String> {
        if !self.suspect {
            let early = match self.link.as_mut() {
                Some(link) => link.unsolicited().await,
                None => return Err(self.error(ErrorKind::Lost, "the device is not connected; open it first")),
            };
            self.suspect = early.map_err(|e| self.fail(e))? > 0;
        }
        if self.suspect {
            self.synchronise().await?;
        }
        self.suspect = true;
        self.send(&format!("{query}\n")).await?;
        let Some(line) = self.line().await? else {
            return Err(self.error(ErrorKind::Timeout, format!("no answer to `{query}` within 1 s")));
        };
        self.suspect = false;
        Ok(line.trim().to_owned())
    }

    /// A whole number that two answers in a row agree on.
    async fn number(&mut self, query: &str) -> Result<u16> {
        let mut last = None;
        let mut failure = None;
        for _ in 0..2 * TRIES {
            match self.ask(query).await {
                Ok(text) => match text.parse::<u16>() {
                    Ok(value) if last == Some(value) => return Ok(value),
                    Ok(value) => last = Some(value),
                    Err(_) => {
                        self.suspect = true;
                        let what = format!("`{query}` gave {text:?}, a whole number is needed");
                        failure = Some(self.error(ErrorKind::Garbled, what));
                    }
                },
                Err(e) if matches!(e.kind, ErrorKind::Timeout | ErrorKind::Garbled) => failure = Some(e),
                Err(e) => return Err(e),
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, format!("no two answers to `{query}` agree; check cable and earthing"))
        }))
    }

    async fn get(&mut self, setting: Setting) -> Result<u16> {
        self.number(&format!("{}?", setting.letter())).await
    }

    /// Makes a setting and proves it by asking; safe to repeat.
    async fn set(&mut self, setting: Setting, value: u16) -> Result<()> {
        let letter = setting.letter();
        for _ in 0..TRIES {
            if self.get(setting).await? == value {
                return Ok(());
            }
            if self.suspect {
                self.synchronise().await?;
            }
            self.send(&format!("{letter}{value}\n")).await?;
        }
        if self.get(setting).await? == value {
            return Ok(());
        }
        let refused = self.number("Q?").await? & status::PARAMETER_ERROR != 0;
        let (kind, why) = if refused {
            (ErrorKind::Refused, "it refuses the value")
        } else {
            (ErrorKind::Broken, "it does not keep it")
        };
        Err(self.error(kind, format!("`{letter}{value}` has no effect: {why}; check head and instrument file")))
    }

    /// One reading in watts. Any other unit has no exponent and is refused.
    async fn power(&mut self) -> Result<f64> {
        let mut failure = None;
        for _ in 0..TRIES {
            match self.ask("D?").await {
                Ok(text) => match watts(&text) {
                    Some(value) => return Ok(value),
                    None => {
                        self.suspect = true;
                        let what = format!("`D?` gave {text:?}, which is no power in watts");
                        failure = Some(self.error(ErrorKind::Garbled, what));
                    }
                },
                Err(e) if matches!(e.kind, ErrorKind::Timeout | ErrorKind::Garbled) => failure = Some(e),
                Err(e) => return Err(e),
            }
        }
        Err(failure.unwrap_or_else(|| self.error(ErrorKind::Garbled, "no reading")))
    }

    /// The median of three readings; of five when they scatter. One corrupted reading never becomes the result.
    async fn median(&mut self) -> Result<f64> {
        let mut all = Vec::new();
        for count in READINGS {
            while all.len() < count {
                all.push(self.power().await?);
            }
            all.sort_by(f64::total_cmp);
            let scatter = all.last().copied().unwrap_or(0.0) - all.first().copied().unwrap_or(0.0);
            if scatter <= SCATTER * middle(&all).abs() {
                break;
            }
        }
        Ok(middle(&all))
    }

    /// Every setting that a reading depends on is as it was made; else somebody or a restart changed it.
    async fn prove_settings(&mut self) -> Result<u16> {
        let Some(wavelength) = self.wavelength else {
            return Err(self.error(ErrorKind::Refused, "the light monitor is not open; open it first"));
        };
        let mut wanted = vec![(Setting::Wavelength, wavelength)];
        for setting in [Setting::Lockout, Setting::Units, Setting::Go, Setting::Zero] {
            wanted.extend(setting.needed().map(|value| (setting, value)));
        }
        for (setting, value) in wanted {
            // What is expected needs no second answer; anything else does.
            if self.ask(&format!("{}?", setting.letter())).await.is_ok_and(|text| text == value.to_string()) {
                continue;
            }
            let found = self.get(setting).await?;
            if found != value {
                self.wavelength = None;
                let what = format!(
                    "its {} is {found} instead of {value}: it restarted, or somebody used its keys; open it again",
                    format!("{setting:?}").to_lowercase()
                );
                return Err(self.error(ErrorKind::Broken, what));
            }
        }
        Ok(wavelength)
    }

    async fn send(&mut self, text: &str) -> Result<()> {
        let sent = match self.link.as_mut() {
            Some(link) => link.send(text.as_bytes()).await,
            None => return Err(self.error(ErrorKind::Lost, "the device is not connected; open it first")),
        };
        sent.map_err(|e| self.fail(e))
    }

    async fn line(&mut self) -> Result<Option<String>> {
        let deadline = self.clock.now() + QUERY_LIMIT;
        let read = match self.link.as_mut() {
            Some(link) => link.line(deadline).await,
            None => return Ok(None),
        };
        let line = read.map_err(|e| self.fail(e))?;
        Ok(line.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()))
    }

    async fn drain(&mut self) -> Result<usize> {
        let drained = match self.link.as_mut() {
            Some(link) => link.drain(QUIET).await,
            None => return Ok(0),
        };
        drained.map_err(|e| self.fail(e))
    }

    fn fail(&mut self, error: DeviceError) -> DeviceError {
        if error.kind == ErrorKind::Lost {
            self.link = None;
        }
        self.error(error.kind, error.message)
    }
}

#[async_trait]
impl Device for Newport1830c {
    async fn open(&mut self) -> Result<Identity> {
        self.wavelength = None;
        if !self.config.serial.is_empty() {
            let what = "a Newport 1830-C has no serial number to tell; take `serial` out of the instrument file";
            return Err(self.error(ErrorKind::Refused, what));
        }
        if self.link.is_none() || self.synchronise().await.is_err() {
            let connected = self.connector.connect().await;
            self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
            self.synchronise().await?;
        }
        for setting in [Setting::Units, Setting::Go, Setting::Zero, Setting::Lockout] {
            if let Some(value) = setting.needed() {
                self.set(setting, value).await?;
            }
        }
        self.set(Setting::Filter, self.filter()).await?;
        // Automatic range: `R?` tells the range in use, so this setting alone cannot be read back.
        self.send("R0\n").await?;
        self.apply(self.config.wavelength).await?;
        Ok(Identity { model: "Newport 1830-C".to_owned(), firmware: String::new(), serial: String::new() })
    }

    async fn health(&mut self) -> Result<Health> {
        self.prove_settings().await?;
        let status = self.number("Q?").await?;
        let told = [(status::SATURATED, "detector saturated"), (status::OVER_RANGE, "power above the range")];
        let warnings = told.iter().filter(|(bit, _)| status & bit != 0).map(|(_, word)| (*word).to_owned()).collect();
        Ok(Health { warnings, temperature_c: None })
    }

    /// A meter only looks; it is safe when it answers.
    async fn make_safe(&mut self) -> Result<()> {
        if self.link.is_none() {
            let connected = self.connector.connect().await;
            self.link = Some(connected.map_err(|e| self.error(e.kind, e.message))?);
        }
        self.synchronise().await
    }
}

#[async_trait]
impl LightMonitor for Newport1830c {
    /// Whole nanometres; the meter itself refuses what its head is not calibrated for.
    async fn apply(&mut self, wavelength: Nanometres) -> Result<Nanometres> {
        let (min, max) = WAVELENGTHS_NM;
        if !(wavelength.0 >= min && wavelength.0 <= max) {
            let what = format!("a wavelength of {wavelength} is refused; {min} to {max} nm is allowed");
            return Err(self.error(ErrorKind::Refused, what));
        }
        let whole = wavelength.0.round() as u16;
        self.wavelength = None;
        self.set(Setting::Wavelength, whole).await?;
        self.wavelength = Some(whole);
        Ok(Nanometres(f64::from(whole)))
    }

    async fn read(&mut self) -> Result<LightReading> {
        let wavelength = self.prove_settings().await?;
        self.send("CS\n").await?;
        for _ in 0..TRIES {
            let power_w = self.median().await?;
            let at = self.clock.now();
            let status = self.number("Q?").await?;
            if status & status::BUSY == 0 {
                let saturated = status & (status::SATURATED | status::OVER_RANGE) != 0;
                return Ok(LightReading { power_w, wavelength: Nanometres(f64::from(wavelength)), saturated, at });
            }
        }
        Err(self.error(ErrorKind::Busy, "it keeps changing its range; is the lamp flickering?"))
    }
}

/// `+.11E-9`, `5E-9`, `-1.234E-3`: sign, digits with or without a point, E, exponent; nothing else.
fn watts(text: &str) -> Option<f64> {
    let (mantissa, exponent) = text.split_once('E')?;
    let digits = mantissa.strip_prefix(['+', '-']).unwrap_or(mantissa);
    let plain = |c: char| c.is_ascii_digit() || c == '.';
    if !digits.chars().all(plain) || !digits.contains(|c: char| c.is_ascii_digit()) {
        return None;
    }
    exponent.parse::<i8>().ok()?;
    text.parse::<f64>().ok().filter(|value| value.is_finite())
}

fn middle(sorted: &[f64]) -> f64 {
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn powers_are_read_as_the_meter_writes_them() {
        for (text, value) in [("+.11E-9", 0.11e-9), ("5E-9", 5e-9), ("-1.234E-3", -1.234e-3), ("+12.34E-06", 12.34e-6)]
        {
            assert_eq!(watts(text), Some(value), "{text}");
        }
        for text in ["-15.24", "E-9", "1.2.3E-3", "1E", "nanE1", "", "1E-999", "D?", "+-1E-3"] {
            assert_eq!(watts(text), None, "{text}");
        }
    }

    /// Values that rest on one source or on none.
    #[test]
    fn assumptions_are_pinned() {
        assert_eq!((WATTS, WAVELENGTHS_NM, BAUD), (1, (200.0, 2000.0), 9600));
        use status::*;
        assert_eq!((PARAMETER_ERROR, COMMAND_ERROR, SATURATED, OVER_RANGE, BUSY), (1, 2, 4, 8, 32));
    }
}
