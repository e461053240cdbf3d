//! Driver `oceanoptics-usb`: array spectrometers USB2000, USB2000+ and USB4000, told apart by their product id.
//!
//! Source: the OEM data sheets. The detector runs freely: a request gives the period that runs when it comes, which may
//! have begun before the light or the time changed. So every spectrum is the second of two, and began after the call.
//! Setters have no acknowledge: time and trigger mode are read back with the status. What decides something (slots,
//! status) is asked until two answers agree.

use super::SpectrometerConfig;
use super::oceanoptics_protocol::{self as protocol, Model, Status};
use super::oceanoptics_scale::Scale;
use crate::clock::Clock;
use crate::contract::{Device, Health, Identity, Spectrometer, Spectrum};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::UsbConnector;
use crate::transport::usb::{Transfer, UsbError, UsbLink};
use crate::units::ExposureTime;
use async_trait::async_trait;
use std::time::Duration;

/// Limit of a command and of a short answer.
const QUERY_LIMIT: Duration = Duration::from_millis(500);
/// Time the device needs after 0x01.
const INITIALISE_WAIT: Duration = Duration::from_millis(150);
/// Quiet time that ends a drain at opening and after a failure; before a request only what is there already goes.
const QUIET: Duration = Duration::from_millis(50);
const AT_ONCE: Duration = Duration::from_millis(1);
/// Integration time after opening.
const FIRST_TIME: ExposureTime = ExposureTime(100_000);
/// Added to two integration times for one spectrum.
const MARGIN: Duration = Duration::from_millis(500);
/// Questions for two agreeing answers; tries for one spectrum; writes of one setting.
const AGREE_TRIES: u32 = 6;
const SPECTRUM_TRIES: u32 = 4;
const WRITE_TRIES: u32 = 3;
/// Looks at a device that is still busy with an old request, four in one integration time.
const BUSY_LOOKS: u32 = 12;
/// Bytes that come on the other endpoint at high speed.
const FIRST_BYTES: usize = 2048;

/// A spectrometer on its link.
pub struct OceanOptics {
    connector: Box<dyn UsbConnector>,
    config: SpectrometerConfig,
    clock: Clock,
    label: String,
    open: Option<Open>,
}

/// What is known of an open device.
struct Open {
    link: UsbLink,
    model: &'static Model,
    high_speed: bool,
    scale: Scale,
    exposure: ExposureTime,
    /// The status tells when a request is under way; a device that says so while it rests does not.
    busy_tells: bool,
    /// Something went wrong or was left unfinished: bring the device into a known state first.
    suspect: bool,
    /// The last spectrum that the device took may not be the last that came: it could be one behind.
    behind: bool,
    /// Spectra that were thrown away because they were not right, since opening.
    bad: u64,
    /// Raw counts of the last kept spectrum.
    last: Vec<u16>,
}

// === impl OceanOptics ===

impl OceanOptics {
    /// A spectrometer over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn UsbConnector>, config: SpectrometerConfig, clock: Clock) -> OceanOptics {
        let label = format!("{} ({})", config.name, connector.port());
        OceanOptics { connector, config, clock, label, open: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn device(&mut self) -> Result<&mut Open> {
        let error = DeviceError::new(ErrorKind::Lost, &self.label, "the device is not open; open it first");
        self.open.as_mut().ok_or(error)
    }

    /// Names the device in an error; a lost device is dropped.
    fn fail(&mut self, error: UsbError, doing: &str) -> DeviceError {
        if error.is_loss() {
            self.open = None;
        }
        let mut error = error.of(&self.label, doing);
        if error.kind == ErrorKind::Refused {
            // A halt: the device lost track of its transfers, which clearing it repairs.
            error.kind = ErrorKind::Garbled;
        }
        error
    }

    async fn command(&mut self, bytes: &[u8], doing: &str) -> Result<()> {
        let device = self.device()?;
        let sent = device.link.send(device.model.command, bytes, QUERY_LIMIT).await;
        sent.map_err(|error| self.fail(error, doing))
    }

    /// One short question and its answer.
    async fn once(&mut self, question: &[u8], doing: &str) -> Result<Vec<u8>> {
        let device = self.device()?;
        let drained = device.link.drain(device.model.query, 64, AT_ONCE).await;
        drained.map_err(|error| self.fail(error, doing))?;
        self.command(question, doing).await?;
        let device = self.device()?;
        let answer = device.link.read(device.model.query, 64, QUERY_LIMIT).await;
        answer.map_err(|error| self.fail(error, doing))
    }

    /// What two answers in a row say; answers that `read` refuses, that are late or cut are asked again.
    async fn ask<T: PartialEq>(
        &mut self,
        question: &[u8],
        doing: &str,
        read: impl Fn(&[u8]) -> Option<T>,
    ) -> Result<T> {
        let (mut last, mut failure) = (None, None);
        for _ in 0..AGREE_TRIES {
            match self.once(question, doing).await {
                Ok(answer) => match read(&answer) {
                    Some(value) if last.as_ref() == Some(&value) => return Ok(value),
                    Some(value) => last = Some(value),
                    None => {
                        failure = Some(self.error(ErrorKind::Garbled, format!("{doing}: {answer:02X?} is no answer")));
                        last = None;
                        self.quiet_queries().await?;
                    }
                },
                Err(error) if retry(&error) => {
                    failure = Some(error);
                    last = None;
                    self.quiet_queries().await?;
                }
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| self.error(ErrorKind::Garbled, format!("{doing}: no two answers agree"))))
    }

    /// Throws away short answers that nobody waits for.
    async fn quiet_queries(&mut self) -> Result<()> {
        let device = self.device()?;
        let (command, query) = (device.model.command, device.model.query);
        let quiet = async {
            device.link.clear_halt(command).await?;
            device.link.clear_halt(query).await?;
            device.link.drain(query, 64, QUIET).await
        };
        quiet.await.map(drop).map_err(|error| self.fail(error, "draining the answers"))
    }

    /// Throws away spectra that nobody waits for.
    async fn quiet_spectra(&mut self) -> Result<()> {
        let device = self.device()?;
        let (room, ends) = (device.model.spectrum_bytes(), device.spectrum_endpoints());
        let quiet = async {
            for endpoint in ends {
                device.link.clear_halt(endpoint).await?;
                device.link.drain(endpoint, room, QUIET).await?;
            }
            Ok(())
        };
        quiet.await.map_err(|error| self.fail(error, "draining the spectra"))
    }

    async fn slot(&mut self, slot: u8) -> Result<Vec<u8>> {
        let doing = format!("reading slot {slot}");
        let whole = |answer: &[u8]| protocol::slot_bytes(answer, slot).map(<[u8]>::to_vec);
        self.ask(&protocol::query_slot(slot), &doing, whole).await
    }

    async fn number(&mut self, slot: u8, what: &str) -> Result<f64> {
        let body = self.slot(slot).await?;
        protocol::slot_number(&body).ok_or_else(|| {
            let text = String::from_utf8_lossy(&body).into_owned();
            let what = format!("slot {slot} holds {text:?}, {what} is needed; the device's calibration is lost");
            self.error(ErrorKind::Broken, what)
        })
    }

    async fn status(&mut self) -> Result<Status> {
        let model = self.device()?.model;
        self.ask(&protocol::query_status(), "reading the status", |answer| model.status(answer)).await
    }

    /// Wavelengths, non-linearity and saturation from the device's memory.
    async fn read_scale(&mut self) -> Result<Scale> {
        let model = self.device()?.model;
        let mut wavelength = Vec::new();
        for slot in protocol::SLOT_WAVELENGTH {
            wavelength.push(self.number(slot, "a wavelength coefficient").await?);
        }
        let order = self.number(protocol::SLOT_ORDER, "the order of the non-linearity polynomial").await?;
        let slots = protocol::SLOT_LINEARITY;
        if order.fract() != 0.0 || !(0.0..f64::from(slots.end - slots.start)).contains(&order) {
            return Err(self.error(ErrorKind::Broken, format!("slot 14 holds order {order}, 0 to 7 are possible")));
        }
        let mut linearity = Vec::new();
        for slot in slots.take(order as usize + 1) {
            linearity.push(self.number(slot, "a non-linearity coefficient").await?);
        }
        let saturation = match model.layout {
            protocol::Layout::Interleaved => Some(model.full),
            protocol::Layout::Words => {
                protocol::saturation_level(&self.slot(protocol::SLOT_SATURATION).await?, model.full)
            }
        };
        let scale = Scale::new(model, &wavelength, linearity, saturation.unwrap_or(model.full));
        scale.map_err(|why| self.error(ErrorKind::Broken, why))
    }

    /// Brings a connected device into its working state and reads what it is.
    async fn set_up(&mut self) -> Result<Identity> {
        self.restart().await?;
        let serial = protocol::slot_text(&self.slot(protocol::SLOT_SERIAL).await?).map(str::to_owned);
        let serial = serial.ok_or_else(|| self.error(ErrorKind::Broken, "slot 0 holds no serial number"))?;
        if !self.config.serial.is_empty() && serial != self.config.serial {
            let what = format!(
                "the spectrometer has serial number {serial}, the instrument file says {}; connect the right one or correct the file",
                self.config.serial
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let scale = self.read_scale().await?;
        let status = self.status().await?;
        let device = self.device()?;
        device.scale = scale;
        device.high_speed = status.high_speed;
        device.busy_tells = !status.busy;
        let firmware = device.link.info().manufacturer.clone();
        let identity = Identity { model: device.model.name.to_owned(), firmware, serial };
        self.set_time(FIRST_TIME).await?;
        Ok(identity)
    }

    /// Both queues empty, halts cleared, power-up state, lamp off, free running.
    async fn restart(&mut self) -> Result<()> {
        self.quiet_queries().await?;
        self.quiet_spectra().await?;
        self.command(&protocol::initialise(), "initialising").await?;
        self.clock.sleep(INITIALISE_WAIT).await;
        // Some firmware takes a spectrum by itself then.
        self.quiet_spectra().await?;
        self.command(&protocol::lamp_off(), "switching the lamp off").await?;
        self.command(&protocol::trigger(protocol::FREE_RUNNING), "setting the trigger mode").await
    }

    /// Writes the integration time until the status shows it.
    async fn set_time(&mut self, exposure: ExposureTime) -> Result<ExposureTime> {
        let model = self.device()?.model;
        let time = (exposure.0 + model.unit_us / 2) / model.unit_us;
        self.device()?.suspect = true;
        let mut kept = 0;
        for _ in 0..WRITE_TRIES {
            self.command(&model.set_time(time), "setting the integration time").await?;
            let status = self.status().await?;
            kept = status.time;
            if status.trigger != 0 {
                self.command(&protocol::trigger(protocol::FREE_RUNNING), "setting the trigger mode").await?;
            } else if kept == time {
                let exposure = ExposureTime(time * model.unit_us);
                let device = self.device()?;
                device.exposure = exposure;
                device.suspect = false;
                return Ok(exposure);
            }
        }
        let what = format!(
            "the device does not keep an integration time of {exposure}, it has {}",
            ExposureTime(kept * model.unit_us)
        );
        Err(self.error(ErrorKind::Broken, what))
    }

    /// A request that was made is not answered yet.
    async fn is_busy(&mut self) -> Result<bool> {
        Ok(self.device()?.busy_tells && self.status().await?.busy)
    }

    /// After a failure: wait until the device is done with what it was asked, drain, prove the settings; `hard` also
    /// puts it into its power-up state first.
    async fn recover(&mut self, hard: bool) -> Result<()> {
        let exposure = self.device()?.exposure;
        self.device()?.behind = true;
        if hard {
            self.restart().await?;
        }
        for _ in 0..BUSY_LOOKS {
            self.quiet_spectra().await?;
            if !self.is_busy().await? {
                self.quiet_spectra().await?;
                self.set_time(exposure).await?;
                return Ok(());
            }
            self.clock.sleep(exposure.duration() / 4).await;
        }
        Err(self.error(ErrorKind::Timeout, "the device does not end an old request for a spectrum"))
    }

    /// One spectrum: the period that runs when the request comes.
    async fn take(&mut self) -> Result<Vec<u16>> {
        let clock = self.clock;
        let device = self.device()?;
        device.suspect = true;
        let (model, limit) = (device.model, device.exposure.duration() * 2 + MARGIN);
        let bytes = device.exchange(limit, clock).await.map_err(|error| self.fail(error, "taking a spectrum"))?;
        let Some(counts) = model.counts(&bytes) else {
            let what = format!(
                "{} bytes came that end with {:02X?}, a spectrum has {} and ends with 69",
                bytes.len(),
                bytes.last(),
                model.spectrum_bytes()
            );
            return Err(self.error(ErrorKind::Garbled, what));
        };
        self.device()?.suspect = false;
        Ok(counts)
    }

    /// Two spectra in a row: the first may have begun before this call, the second has not. Three where the device could
    /// be one behind; where it could not, a device that is shows by the last spectrum coming again.
    async fn take_fresh(&mut self) -> Result<Vec<u16>> {
        let mut early = self.take().await?;
        if self.device()?.behind {
            early = self.take().await?;
        }
        let counts = self.take().await?;
        if self.is_busy().await? {
            // Then these were the answers to older requests, and the last one is still to come.
            self.device()?.suspect = true;
            return Err(self.error(ErrorKind::Garbled, "more spectra are under way than were asked for"));
        }
        let device = self.device()?;
        let flat = counts.windows(2).all(|pair| matches!(pair, [a, b] if a == b));
        // A detector has noise: two equal spectra are one that was sent twice.
        if counts == early || early == device.last || counts == device.last || flat {
            device.suspect = true;
            let what = if flat { "all pixels are equal" } else { "the same spectrum came twice" };
            return Err(self.error(ErrorKind::Garbled, format!("{what}; the detector does not run")));
        }
        Ok(counts)
    }
}

#[async_trait]
impl Device for OceanOptics {
    async fn open(&mut self) -> Result<Identity> {
        self.open = None;
        let link = self.connector.connect().await.map_err(|e| self.error(e.kind, e.message))?;
        let (vendor, product) = (link.info().vendor, link.info().product);
        let model = Model::of(product).filter(|_| vendor == protocol::VENDOR).ok_or_else(|| {
            let what = format!("ids {vendor:04x}:{product:04x} are not those of a USB2000, USB2000+ or USB4000");
            self.error(ErrorKind::WrongDevice, what)
        })?;
        self.open = Some(Open {
            link,
            model,
            high_speed: false,
            busy_tells: false,
            scale: Scale::default(),
            exposure: FIRST_TIME,
            suspect: true,
            behind: true,
            bad: 0,
            last: Vec::new(),
        });
        let identity = self.set_up().await;
        if identity.is_err() {
            self.open = None;
        }
        identity
    }

    async fn health(&mut self) -> Result<Health> {
        let status = self.status().await?;
        let device = self.device()?;
        let mut warnings = Vec::new();
        if status.time * device.model.unit_us != device.exposure.0 {
            let has = ExposureTime(status.time * device.model.unit_us);
            warnings.push(format!("integration time is {has}, {} was set: it was restarted", device.exposure));
            device.suspect = true;
        }
        if device.bad > 0 {
            warnings.push(format!("{} spectra were not right and taken again", device.bad));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    /// Lamp output off; there is nothing else to make safe.
    async fn make_safe(&mut self) -> Result<()> {
        self.command(&protocol::lamp_off(), "switching the lamp off").await
    }
}

#[async_trait]
impl Spectrometer for OceanOptics {
    /// Those of the model; before `open`, what all three models can do.
    fn limits(&self) -> (ExposureTime, ExposureTime) {
        match &self.open {
            Some(device) => device.model.limits(),
            None => (ExposureTime(3000), ExposureTime(65_535_000)),
        }
    }

    async fn apply(&mut self, exposure: ExposureTime) -> Result<ExposureTime> {
        let (shortest, longest) = self.device()?.model.limits();
        if exposure < shortest || exposure > longest {
            let what = format!("an integration time of {exposure} is not possible, {shortest} to {longest} are");
            return Err(self.error(ErrorKind::Refused, what));
        }
        if self.device()?.suspect {
            self.recover(false).await?;
        }
        self.set_time(exposure).await
    }

    async fn acquire(&mut self) -> Result<Spectrum> {
        let mut failure = None;
        for attempt in 0..SPECTRUM_TRIES {
            if self.device()?.suspect {
                match self.recover(attempt > 1).await {
                    Ok(()) => {}
                    Err(error) if retry(&error) => {
                        failure = Some(error);
                        continue;
                    }
                    Err(error) => return Err(error),
                }
            }
            match self.take_fresh().await {
                Ok(counts) => {
                    let at = self.clock.now();
                    let device = self.device()?;
                    let spectrum = device.scale.spectrum(device.model, &counts, device.exposure, at);
                    device.last = counts;
                    device.behind = false;
                    return Ok(spectrum);
                }
                Err(error) if retry(&error) => {
                    tracing::warn!(%error, "a spectrum is taken again");
                    self.device()?.bad += 1;
                    failure = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        Err(failure.unwrap_or_else(|| self.error(ErrorKind::Timeout, "no spectrum came")))
    }
}

// === impl Open ===

impl Open {
    /// Endpoints that spectra come on, first one first.
    fn spectrum_endpoints(&self) -> Vec<u8> {
        self.model.first.into_iter().chain([self.model.spectrum]).collect()
    }

    /// Requests a spectrum and reads it whole; gives what came.
    async fn exchange(&mut self, limit: Duration, clock: Clock) -> Transfer<Vec<u8>> {
        for endpoint in self.spectrum_endpoints() {
            self.link.drain(endpoint, self.model.spectrum_bytes(), AT_ONCE).await?;
        }
        self.link.send(self.model.command, &protocol::request_spectrum(), QUERY_LIMIT).await?;
        let deadline = clock.now() + limit;
        let split = if self.high_speed { self.model.first } else { None };
        let mut bytes = Vec::new();
        if let Some(first) = split {
            self.collect(&mut bytes, first, FIRST_BYTES, deadline, clock).await?;
            if bytes.len() != FIRST_BYTES {
                return Ok(bytes);
            }
        }
        self.collect(&mut bytes, self.model.spectrum, self.model.spectrum_bytes(), deadline, clock).await?;
        Ok(bytes)
    }

    /// Reads until `whole` bytes are there or the deadline has passed; part of them is a success.
    async fn collect(
        &mut self,
        bytes: &mut Vec<u8>,
        endpoint: u8,
        whole: usize,
        deadline: tokio::time::Instant,
        clock: Clock,
    ) -> Transfer<()> {
        while bytes.len() < whole {
            let left = deadline.saturating_duration_since(clock.now());
            match self.link.read(endpoint, whole - bytes.len(), left).await {
                Ok(more) if more.is_empty() => {}
                // A sync byte alone is the rest of a spectrum whose reading was cut.
                Ok(more) if bytes.is_empty() && more == [protocol::SYNC] => {}
                Ok(more) => bytes.extend(more),
                Err(UsbError::Timeout) if !bytes.is_empty() => return Ok(()),
                Err(error) => return Err(error),
            }
            if left.is_zero() {
                return if bytes.is_empty() { Err(UsbError::Timeout) } else { Ok(()) };
            }
        }
        Ok(())
    }
}

// === impl Model ===

impl Model {
    fn limits(&self) -> (ExposureTime, ExposureTime) {
        (ExposureTime(self.times.0 * self.unit_us), ExposureTime(self.times.1 * self.unit_us))
    }
}

/// What may go better when it is asked again.
fn retry(error: &DeviceError) -> bool {
    matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled)
}
