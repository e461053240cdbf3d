//! Driver `thorlabs-pm100`: power meter PM100D, PM100A or PM100USB with its head, over USBTMC.
//!
//! Source: PM100D and PM100USB manuals, SCPI chapters; USBTMC 1.0. USB carries a checksum, but nothing binds an answer to
//! its question, so a reading counts only between proofs: after `READ?` the head and the wavelength must be the known
//! ones, and `FETC?` must repeat the very text. The four answers differ in shape, so a device that is behind shows.
//! Never sent: `*RST`, calibration and adapter commands, zeroing (the lamp would have to be dark).

use super::LightMonitorConfig;
use super::thorlabs_pm100_text::{Head, Meter, no_error, number};
use super::usbtmc::{Tmc, TmcError};
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, LightMonitor, LightReading};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::UsbConnector;
use crate::transport::usb::UsbError;
use crate::units::Nanometres;
use async_trait::async_trait;
use std::time::Duration;

/// Vendor and product ids of PM100USB, PM100A (assumed) and PM100D.
pub const IDS: [(u16, u16); 3] = [(0x1313, 0x8072), (0x1313, 0x8076), (0x1313, 0x8078)];
/// Limit of a query that measures nothing.
const QUERY_LIMIT: Duration = Duration::from_secs(1);
/// Duration of one averaged sample; ten times the manual's 3 ms, since ranging adds to it.
const SAMPLE_LIMIT: Duration = Duration::from_millis(30);
/// Tries to clear the messages and get the identity; queries for two agreeing answers; rounds for a proven reading.
const SYNC_TRIES: u32 = 3;
const AGREE_TRIES: u32 = 6;
const READ_TRIES: u32 = 5;
/// Entries of the device's error queue that are read at most.
const MOST_ERRORS: usize = 32;
/// The device rounds a wavelength; it must come back within this.
const WAVELENGTH_TOLERANCE_NM: f64 = 0.1;
/// What any head of the family can be asked for, nanometres; the head in use tells its own limits.
pub const WAVELENGTHS_NM: (f64, f64) = (100.0, 30_000.0);
/// SCPI's infinity is 9.9E+37: beyond the range. Assumed on this device.
const OVERRANGE_W: f64 = 9.0e37;

/// A power meter on its link.
pub struct Pm100 {
    connector: Box<dyn UsbConnector>,
    config: LightMonitorConfig,
    clock: Clock,
    label: String,
    tmc: Option<Tmc>,
    /// The last exchange has no proven end: clear before the next.
    suspect: bool,
    /// The head's own words, proven at `open`.
    head: Option<String>,
    wavelength: Option<Nanometres>,
    /// The range must be chosen before the next reading.
    range_open: bool,
    /// Times that messages were out of step since `open`.
    out_of_step: u64,
}

// === impl Pm100 ===

impl Pm100 {
    /// A meter over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn UsbConnector>, config: LightMonitorConfig, clock: Clock) -> Pm100 {
        let label = format!("{} ({})", config.name, connector.port());
        Pm100 {
            connector,
            config,
            clock,
            label,
            tmc: None,
            suspect: true,
            head: None,
            wavelength: None,
            range_open: true,
            out_of_step: 0,
        }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn tmc(&mut self) -> Result<&mut Tmc> {
        let error = DeviceError::new(ErrorKind::Lost, &self.label, "the device is not connected; open it first");
        self.tmc.as_mut().ok_or(error)
    }

    /// Names the device in an error; a lost link is dropped.
    fn fail(&mut self, error: &TmcError, doing: &str) -> DeviceError {
        match error {
            TmcError::Usb(usb) => {
                if usb.is_loss() {
                    self.tmc = None;
                }
                let mut error = usb.of(&self.label, doing);
                // A halt is the class's way of saying that a message was not understood.
                if *usb == UsbError::Stall {
                    error.kind = ErrorKind::Garbled;
                }
                error
            }
            TmcError::Frame(why) => self.error(ErrorKind::Garbled, format!("{doing}: {why}")),
        }
    }

    /// Connects when nothing is connected, and brings the messages into step.
    async fn connect(&mut self) -> Result<()> {
        if self.tmc.is_some() && self.synchronise().await.is_ok() {
            return Ok(());
        }
        self.tmc = None;
        let link = self.connector.connect().await.map_err(|e| self.error(e.kind, e.message))?;
        let ids = (link.info().vendor, link.info().product);
        if !IDS.contains(&ids) {
            let what = format!("ids {:04x}:{:04x} are not those of a PM100D, PM100A or PM100USB", ids.0, ids.1);
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        self.tmc = Tmc::new(link, self.clock);
        if self.tmc.is_none() {
            return Err(self.error(ErrorKind::WrongDevice, "the device has no pair of bulk endpoints"));
        }
        self.synchronise().await
    }

    /// Clears all messages and asks for the identity until a whole one comes.
    async fn synchronise(&mut self) -> Result<()> {
        self.suspect = true;
        let mut failure = None;
        for _ in 0..SYNC_TRIES {
            let once = async {
                let tmc = self.tmc()?;
                match tmc.clear().await {
                    Ok(()) => self.once("*IDN?", QUERY_LIMIT).await,
                    Err(error) => Err(self.fail(&TmcError::Usb(error), "clearing the messages")),
                }
            };
            match once.await {
                Ok(text) if Meter::parse(&text).is_some() => {
                    self.suspect = false;
                    return Ok(());
                }
                Ok(text) => {
                    let what = format!("`*IDN?` gave {text:?}; is this a Thorlabs power meter?");
                    failure = Some(self.error(ErrorKind::Garbled, what));
                }
                Err(error) if self.tmc.is_none() => return Err(error),
                Err(error) => failure = Some(error),
            }
        }
        Err(failure.unwrap_or_else(|| self.error(ErrorKind::Timeout, "no answer to `*IDN?`")))
    }

    /// One question and its answer, without any proof that they belong together.
    async fn once(&mut self, query: &str, limit: Duration) -> Result<String> {
        let tmc = self.tmc()?;
        let exchange = match tmc.send(&format!("{query}\n")).await {
            Ok(()) => tmc.receive(limit).await,
            Err(error) => Err(error),
        };
        exchange.map_err(|error| self.fail(&error, &format!("`{query}`")))
    }

    /// One question and its answer on a synchronised link.
    async fn ask(&mut self, query: &str, limit: Duration) -> Result<String> {
        self.in_step().await?;
        // Stays set when this future is dropped.
        self.suspect = true;
        let answer = self.once(query, limit).await?;
        self.suspect = false;
        Ok(answer)
    }

    async fn in_step(&mut self) -> Result<()> {
        if self.suspect {
            self.out_of_step += 1;
            self.synchronise().await?;
        }
        Ok(())
    }

    /// Sends a setting.
    async fn tell(&mut self, command: &str) -> Result<()> {
        self.in_step().await?;
        self.suspect = true;
        let tmc = self.tmc()?;
        let sent = tmc.send(&format!("{command}\n")).await;
        sent.map_err(|error| self.fail(&error, &format!("`{command}`")))?;
        self.suspect = false;
        Ok(())
    }

    /// The answer to a query, asked until two in a row agree and `good` takes it. Between any two stands the question
    /// for the identity, whose answer looks like no other, so that one answer too many or too few shows.
    async fn value<T>(&mut self, query: &str, good: impl Fn(&str) -> Option<T>) -> Result<T> {
        let (mut last, mut failure) = (None, None);
        for _ in 0..AGREE_TRIES {
            let pair = match self.ask(query, QUERY_LIMIT).await {
                Ok(answer) => self.ask("*IDN?", QUERY_LIMIT).await.map(|idn| (answer, idn)),
                Err(error) => Err(error),
            };
            match pair {
                Ok((answer, idn)) if Meter::parse(&idn).is_some() && (query == "*IDN?" || answer != idn) => {
                    if last.as_ref() == Some(&answer) {
                        let what = format!("`{query}` gave {answer:?}, which is not an answer to it");
                        return good(&answer).ok_or_else(|| self.error(ErrorKind::Garbled, what));
                    }
                    last = Some(answer);
                }
                Ok(_) => {
                    self.suspect = true;
                    last = None;
                }
                Err(error) if retry(&error) => failure = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, format!("no two answers to `{query}` agree; check the cable"))
        }))
    }

    /// Writes a setting until it reads back as `good` says; settings are absolute, so repeating is safe.
    async fn set(&mut self, command: &str, query: &str, good: impl Fn(&str) -> bool) -> Result<()> {
        let mut last = String::new();
        for _ in 0..SYNC_TRIES {
            match self.tell(command).await {
                Ok(()) => {}
                Err(error) if retry(&error) => continue,
                Err(error) => return Err(error),
            }
            last = self.value(query, |text| Some(text.to_owned())).await?;
            if good(&last) {
                return Ok(());
            }
        }
        let why = self.errors().await.unwrap_or_default().join("; ");
        let what = format!("the device does not keep `{command}`: `{query}` gives {last:?} ({why})");
        Err(self.error(ErrorKind::Broken, what))
    }

    /// Reads the device's error queue empty.
    async fn errors(&mut self) -> Result<Vec<String>> {
        let mut errors = Vec::new();
        while errors.len() < MOST_ERRORS {
            let text = self.ask("SYST:ERR?", QUERY_LIMIT).await?;
            match no_error(&text) {
                Some(true) => break,
                Some(false) => errors.push(text),
                None => {
                    self.suspect = true;
                    return Err(self.error(ErrorKind::Garbled, format!("`SYST:ERR?` gave {text:?}")));
                }
            }
        }
        Ok(errors)
    }

    /// The head that is plugged in now.
    async fn read_head(&mut self) -> Result<Head> {
        match self.value("SYST:SENS:IDN?", |text| Some(Head::parse(text))).await? {
            Some(head) if head.measures_power() && head.wavelength_settable() => Ok(head),
            Some(head) => {
                let what = format!("head {} does not measure power with a settable wavelength", head.name);
                Err(self.error(ErrorKind::WrongDevice, what))
            }
            None => Err(self.error(ErrorKind::Broken, "no head is plugged in (`SYST:SENS:IDN?`); plug the head in")),
        }
    }

    async fn identify(&mut self) -> Result<Identity> {
        let meter = self.value("*IDN?", Meter::parse).await?;
        let head = self.read_head().await?;
        let serial = format!("{}+{}", meter.serial, head.serial);
        let wanted = &self.config.serial;
        if !wanted.is_empty() && ![&meter.serial, &head.serial, &serial].contains(&wanted) {
            let what = format!(
                "meter and head have serial number {serial}, the instrument file says {wanted} (the meter's, the head's or both with `+`); plug the right ones in or correct the file"
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        self.head = Some(head.text);
        Ok(Identity { model: format!("{} with {}", meter.model, head.name), firmware: meter.firmware, serial })
    }

    fn read_limit(&self) -> Duration {
        QUERY_LIMIT + SAMPLE_LIMIT * self.config.average.max(1)
    }

    /// One round: the reading, then the proofs. `None` when anything is out of step.
    async fn round(&mut self) -> Result<Option<f64>> {
        let limit = self.read_limit();
        let first = self.ask("READ?", limit).await?;
        let head = self.ask("SYST:SENS:IDN?", QUERY_LIMIT).await?;
        let wavelength = self.ask("SENS:CORR:WAV?", QUERY_LIMIT).await?;
        let second = self.ask("FETC?", limit).await?;
        if self.head.as_deref() != Some(head.as_str()) {
            // Another head, or an answer that was garbled: two agreeing answers decide.
            self.suspect = true;
            let now = self.read_head().await?;
            if self.head.as_ref() == Some(&now.text) {
                return Ok(None);
            }
            let what = format!("the head was changed to {} {}; open the device again", now.name, now.serial);
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let (Some(power), Some(nm), true) = (number(&first), number(&wavelength), first == second) else {
            return Ok(None);
        };
        match self.wavelength {
            Some(set) if (set.0 - nm).abs() <= WAVELENGTH_TOLERANCE_NM => Ok(Some(power)),
            Some(set) => {
                self.suspect = true;
                let now = self.value("SENS:CORR:WAV?", number).await?;
                if (set.0 - now).abs() <= WAVELENGTH_TOLERANCE_NM {
                    return Ok(None);
                }
                let what =
                    format!("the wavelength is {now} nm, {set} was set: it was restarted or changed; open it again");
                Err(self.error(ErrorKind::Broken, what))
            }
            None => Err(self.error(ErrorKind::Refused, "the wavelength was never set; apply it first")),
        }
    }

    /// A reading that all proofs agree on.
    async fn proven(&mut self) -> Result<f64> {
        let mut failure = None;
        for _ in 0..READ_TRIES {
            match self.round().await {
                Ok(Some(power)) => return Ok(power),
                Ok(None) => self.suspect = true,
                Err(error) if retry(&error) => failure = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| {
            self.error(ErrorKind::Garbled, "no reading is repeated by `FETC?`; check the cable and the firmware")
        }))
    }

    /// Lets the device choose its range once, then holds it: ranging in an exposure gives wrong samples.
    async fn choose_range(&mut self) -> Result<()> {
        self.set("SENS:POW:RANG:AUTO ON", "SENS:POW:RANG:AUTO?", |t| t == "1").await?;
        self.proven().await?;
        self.proven().await?;
        self.set("SENS:POW:RANG:AUTO OFF", "SENS:POW:RANG:AUTO?", |t| t == "0").await?;
        // The first sample in a range is not to be trusted.
        self.proven().await?;
        self.range_open = false;
        Ok(())
    }

    fn check_open(&self) -> Result<()> {
        if self.head.is_some() && self.tmc.is_some() {
            return Ok(());
        }
        Err(self.error(ErrorKind::Lost, "the device is not open; open it first"))
    }
}

/// What may go better when it is asked again after a clear.
fn retry(error: &DeviceError) -> bool {
    matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled)
}

#[async_trait]
impl Device for Pm100 {
    async fn open(&mut self) -> Result<Identity> {
        self.head = None;
        self.wavelength = None;
        self.range_open = true;
        self.out_of_step = 0;
        self.connect().await?;
        let identity = self.identify().await?;
        self.errors().await?;
        self.set("SENS:POW:UNIT W", "SENS:POW:UNIT?", |t| t == "W").await?;
        let count = self.config.average.max(1);
        let kept = |text: &str| number(text) == Some(f64::from(count));
        self.set(&format!("SENS:AVER:COUN {count}"), "SENS:AVER:COUN?", kept).await?;
        self.tell("CONF:POW").await?;
        // Low bandwidth for steady light; heads without a photodiode refuse it.
        self.tell("INP:PDI:FILT:LPAS:STAT 1").await?;
        self.errors().await?;
        self.apply(self.config.wavelength).await?;
        Ok(identity)
    }

    async fn health(&mut self) -> Result<Health> {
        self.check_open()?;
        let mut warnings = self.errors().await?;
        let head = self.read_head().await?;
        if self.head.as_ref() != Some(&head.text) {
            let what = format!("the head was changed to {} {}; open the device again", head.name, head.serial);
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let unit = self.value("SENS:POW:UNIT?", |t| Some(t.to_owned())).await?;
        let count = self.value("SENS:AVER:COUN?", number).await?;
        let automatic = self.value("SENS:POW:RANG:AUTO?", |t| Some(t.to_owned())).await?;
        if unit != "W" || count != f64::from(self.config.average.max(1)) || (automatic == "1" && !self.range_open) {
            let what = format!(
                "unit {unit}, average {count}, automatic range {automatic} are not what was set: it was restarted or changed by hand; open it again"
            );
            return Err(self.error(ErrorKind::Broken, what));
        }
        if self.out_of_step > 0 {
            warnings.push(format!("messages were out of step {} times", self.out_of_step));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    /// A meter has nothing to make safe.
    async fn make_safe(&mut self) -> Result<()> {
        Ok(())
    }
}

#[async_trait]
impl LightMonitor for Pm100 {
    async fn apply(&mut self, wavelength: Nanometres) -> Result<Nanometres> {
        self.check_open()?;
        let (low, high) = WAVELENGTHS_NM;
        if !(low..=high).contains(&wavelength.0) {
            let what =
                format!("{wavelength} is no wavelength of any head, {low} to {high} nm is allowed; nothing was sent");
            return Err(self.error(ErrorKind::Refused, what));
        }
        let shortest = self.value("SENS:CORR:WAV? MIN", number).await?;
        let longest = self.value("SENS:CORR:WAV? MAX", number).await?;
        if !(shortest..=longest).contains(&wavelength.0) {
            let what = format!("{wavelength} is outside what the head measures, {shortest} to {longest} nm");
            return Err(self.error(ErrorKind::Refused, what));
        }
        let command = format!("SENS:CORR:WAV {}", wavelength.0);
        let near = |text: &str| number(text).is_some_and(|nm| (nm - wavelength.0).abs() <= WAVELENGTH_TOLERANCE_NM);
        self.wavelength = None;
        self.set(&command, "SENS:CORR:WAV?", near).await?;
        let applied = Nanometres(self.value("SENS:CORR:WAV?", number).await?);
        self.wavelength = Some(applied);
        self.choose_range().await?;
        Ok(applied)
    }

    async fn read(&mut self) -> Result<LightReading> {
        self.check_open()?;
        if self.range_open {
            self.choose_range().await?;
        }
        let power_w = self.proven().await?;
        let saturated = power_w.abs() >= OVERRANGE_W;
        self.range_open = saturated;
        let wavelength = self.wavelength.unwrap_or(self.config.wavelength);
        Ok(LightReading { power_w, wavelength, saturated, at: self.clock.now() })
    }
}
