//! Driver `halden-cw6`: Halden CW6 filter wheel with six places.
//!
//! Source: the sheet in `docs/adding-a-device.md`. There is no word on this wire that writes into the device's memory.

use super::WheelConfig;
use super::line_wire::{Dialect, LineWire, NoOp};
use crate::clock::Clock;
use crate::contract::{Device, FilterWheel, Health, Identity};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::transport::Connector;
use crate::units::Slot;
use async_trait::async_trait;
use std::time::Duration;

/// Line of the box.
pub const BAUD: u32 = 9600;
/// Requests and replies end with CR.
const DIALECT: Dialect = Dialect { request_end: "\r", reply_end: b'\r', limit: Duration::from_secs(1) };
/// Places of every CW6.
const PLACES: u8 = 6;
/// Five places, the longest turn, take 4 s.
const MOVE_LIMIT: Duration = Duration::from_secs(8);
/// Pause between questions to a wheel that turns.
const MOVE_POLL: Duration = Duration::from_millis(200);
/// Times that a place is commanded before it is a fault.
const MOVE_TRIES: u32 = 2;

/// A filter wheel on its link.
pub struct HaldenCw6 {
    wire: LineWire,
    config: WheelConfig,
    label: String,
    open: bool,
    /// The place last proven by a command.
    commanded: Option<u8>,
}

/// Firmware and serial number from `CW6,1.3,40213`.
fn identity(line: &str) -> Option<(&str, &str)> {
    line.strip_prefix("CW6,")?.split_once(',')
}

/// The place from `P4`; 0 while the wheel turns.
fn place(line: &str) -> Option<u8> {
    match line.as_bytes() {
        [b'P', digit @ b'0'..=b'6'] => Some(digit - b'0'),
        _ => None,
    }
}

// === impl HaldenCw6 ===

impl HaldenCw6 {
    /// A wheel over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: WheelConfig, clock: Clock) -> HaldenCw6 {
        let label = format!("{} ({})", config.name, connector.port());
        HaldenCw6 { wire: LineWire::new(connector, DIALECT, clock), config, label, open: false, commanded: None }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn own(&self, error: DeviceError) -> DeviceError {
        self.error(error.kind, error.message)
    }

    fn check_open(&self) -> Result<()> {
        if self.open { Ok(()) } else { Err(self.error(ErrorKind::Refused, "the wheel is not open; open it first")) }
    }

    /// A synchronised line to a proven CW6; its whole identity is the answer that proves the line from now on.
    async fn connect(&mut self) -> Result<Identity> {
        self.wire.connect().await.map_err(|e| self.own(e))?;
        let line = self.wire.agreed("I?", |line| Some(line.to_owned())).await.map_err(|e| self.own(e))?;
        let Some((firmware, serial)) = identity(&line) else {
            let what = format!("it says {line:?}, a Halden CW6 is needed; connect the wheel or correct `port`");
            return Err(self.error(ErrorKind::WrongDevice, what));
        };
        let told =
            Identity { model: "Halden CW6".to_owned(), firmware: firmware.to_owned(), serial: serial.to_owned() };
        self.wire.trust(NoOp { request: "I?".to_owned(), answer: line });
        Ok(told)
    }

    async fn read_place(&mut self) -> Result<Option<u8>> {
        let told = self.wire.agreed("P?", place).await.map_err(|e| self.own(e))?;
        Ok(Some(told).filter(|&p| p > 0))
    }

    /// Sends the order once. A lost answer is no fault: the place is asked for in any case, and the order is absolute.
    async fn order(&mut self, place: u8) -> Result<()> {
        let told = match self.wire.ask(&format!("G{place}"), DIALECT.limit).await {
            Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => None,
            told => told.map_err(|e| self.own(e))?,
        };
        match told.as_deref() {
            Some("K") => Ok(()),
            Some("E1") => Err(self.error(ErrorKind::Refused, format!("the wheel answers E1: it has no slot {place}"))),
            Some("E2") => Err(self.error(ErrorKind::Broken, "the wheel answers E2: it is stuck; free it")),
            _ => {
                self.wire.distrust();
                Ok(())
            }
        }
    }

    /// The place where the wheel stands; `None` when it turns for longer than it can.
    async fn standing(&mut self) -> Result<Option<u8>> {
        let deadline = self.wire.clock.now() + MOVE_LIMIT;
        loop {
            let now = self.read_place().await?;
            if now.is_some() || self.wire.clock.now() > deadline {
                return Ok(now);
            }
            self.wire.clock.sleep(MOVE_POLL).await;
        }
    }

    /// Commands a place, at most twice, and proves it by asking.
    async fn turn_to(&mut self, place: u8) -> Result<()> {
        let mut seen = None;
        for _ in 0..MOVE_TRIES {
            self.order(place).await?;
            seen = self.standing().await?;
            if seen == Some(place) {
                self.commanded = seen;
                return Ok(());
            }
        }
        let at = seen.map_or("no known place".to_owned(), |p| format!("slot {p}"));
        let what =
            format!("told twice to turn to slot {place}, it stands at {at}; check that nothing blocks the wheel");
        Err(self.error(ErrorKind::Broken, what))
    }
}

#[async_trait]
impl Device for HaldenCw6 {
    async fn open(&mut self) -> Result<Identity> {
        self.open = false;
        self.commanded = None;
        let identity = self.connect().await?;
        if self.config.places != PLACES {
            let what =
                format!("a CW6 has {PLACES} places, the instrument file says {}; correct `places`", self.config.places);
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        self.open = true;
        Ok(identity)
    }

    async fn health(&mut self) -> Result<Health> {
        self.check_open()?;
        let place = self.read_place().await?;
        let mut warnings: Vec<String> = WheelConfig::astray(self.commanded, place).into_iter().collect();
        if self.wire.unsolicited > 0 {
            warnings.push(format!("{} times bytes came unasked", self.wire.unsolicited));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    async fn make_safe(&mut self) -> Result<()> {
        if !self.wire.alive().await {
            self.connect().await?;
        }
        let dark = self.config.dark;
        match dark {
            Some(dark) if self.read_place().await? != Some(dark.0) => self.turn_to(dark.0).await,
            _ => Ok(()),
        }
    }
}

#[async_trait]
impl FilterWheel for HaldenCw6 {
    fn slots(&self) -> u8 {
        PLACES
    }

    async fn select(&mut self, slot: Slot) -> Result<Slot> {
        if let Some(what) = self.config.beyond(slot) {
            return Err(self.error(ErrorKind::Refused, what));
        }
        self.check_open()?;
        self.turn_to(slot.0).await?;
        self.wire.clock.sleep(self.config.settle).await;
        Ok(slot)
    }

    async fn slot(&mut self) -> Result<Option<Slot>> {
        self.check_open()?;
        Ok(self.read_place().await?.map(Slot))
    }
}
