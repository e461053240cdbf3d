//! Driver `thorlabs-fw212c`: motorised filter wheels FW212C (12 places) and FW102C (6 places).
//!
//! Source: Thorlabs FW102C/FW212C manual Rev H, command chapter. Never sent: `pcount=`, `baud=`, `save`, `trig=`, ESC.
//! The shutter is closed by the sequencer before a turn; the wheel's own sensors are switched off when idle, since
//! their light is stray light.

use super::WheelConfig;
use super::prompt::PromptWire;
use crate::clock::Clock;
use crate::contract::{Device, FilterWheel, Health, Identity};
use crate::error::{ErrorKind, Result};
use crate::transport::Connector;
use crate::units::Slot;
use async_trait::async_trait;
use std::time::Duration;

/// Factory setting of the line.
pub const BAUD: u32 = 115_200;
/// Limit of one turn: half a turn takes 2.9 s fast, 6.8 s slow.
const MOVE_LIMIT: Duration = Duration::from_secs(10);
/// A prompt may come before arrival: how long, and how often, the place is asked for then.
const ARRIVAL_LIMIT: Duration = Duration::from_secs(4);
/// A wheel seen on its way may still be half a place short when it tells the place: one slow place more.
const LAST_PLACE: Duration = Duration::from_secs(2);
/// Pause between those questions.
const ARRIVAL_POLL: Duration = Duration::from_millis(200);
/// Times that a place is commanded before it is a fault.
const MOVE_TRIES: u32 = 2;

/// A filter wheel on its link.
pub struct Fw212c {
    wire: PromptWire,
    config: WheelConfig,
    open: bool,
    /// The place last proven by a command.
    commanded: Option<u8>,
}

// === impl Fw212c ===

impl Fw212c {
    /// A wheel over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: WheelConfig, clock: Clock) -> Fw212c {
        Fw212c { wire: PromptWire::new(&config.name, connector, clock), config, open: false, commanded: None }
    }

    /// Place now; `None` when the wheel gives nothing or a place it cannot have.
    async fn read_place(&mut self) -> Result<Option<u8>> {
        let text = self.wire.value("pos?").await?;
        Ok(text.parse().ok().filter(|place| (1..=self.config.places).contains(place)))
    }

    /// Asks for the place until it is `place` or the limit passes. A wheel that was seen elsewhere meanwhile, or whose
    /// prompt was not its own (`turning`), turns: it is given time to finish and asked once more.
    async fn arrived(&mut self, place: u8, mut turning: bool) -> Result<Option<u8>> {
        let deadline = self.wire.clock.now() + ARRIVAL_LIMIT;
        loop {
            let now = self.read_place().await?;
            if now == Some(place) && turning {
                self.wire.clock.sleep(LAST_PLACE).await;
                return self.read_place().await;
            }
            if now == Some(place) || self.wire.clock.now() > deadline {
                return Ok(now);
            }
            turning = true;
            self.wire.clock.sleep(ARRIVAL_POLL).await;
        }
    }

    /// Commands a place, at most twice, and proves it. The command is absolute, so a repeat is safe.
    async fn turn_to(&mut self, place: u8) -> Result<()> {
        let mut seen = None;
        for _ in 0..MOVE_TRIES {
            let mut turning = false;
            match self.wire.exchange(&format!("pos={place}"), MOVE_LIMIT).await {
                Ok(_) => {}
                Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => {
                    tracing::warn!(%error, place, "the wheel's answer was lost, asking where it is");
                    turning = true;
                }
                Err(error) => return Err(error),
            }
            match self.arrived(place, turning).await {
                Ok(now) if now == Some(place) => {
                    self.commanded = Some(place);
                    return Ok(());
                }
                Ok(now) => seen = now,
                Err(error) if error.kind == ErrorKind::Timeout => seen = None,
                Err(error) => return Err(error),
            }
        }
        let at = seen.map_or("no known place".to_owned(), |p| format!("slot {p}"));
        let what =
            format!("told twice to turn to slot {place}, it stands at {at}; check that nothing blocks the wheel");
        Err(self.wire.error(ErrorKind::Broken, what))
    }

    fn check_open(&self) -> Result<()> {
        if self.open { Ok(()) } else { Err(self.wire.error(ErrorKind::Lost, "the wheel is not open; open it first")) }
    }

    /// The place now, with a note in the log when another hand moved it.
    async fn look(&mut self) -> Result<Option<u8>> {
        let now = self.read_place().await?;
        if let (Some(was), Some(is)) = (self.commanded, now)
            && was != is
        {
            tracing::warn!(device = self.wire.label, was, is, "the wheel was moved by hand");
        }
        Ok(now)
    }
}

#[async_trait]
impl Device for Fw212c {
    async fn open(&mut self) -> Result<Identity> {
        self.open = false;
        self.commanded = None;
        self.wire.ensure().await?;
        let text = self.wire.value("*idn?").await?;
        if !["FW102C", "FW212C"].iter().any(|model| text.contains(model)) {
            let what =
                format!("it says {text:?}, a Thorlabs FW102C or FW212C is needed; connect the wheel or correct `port`");
            return Err(self.wire.error(ErrorKind::WrongDevice, what));
        }
        let places = self.wire.number("pcount?").await?;
        if places != self.config.places {
            let what = format!(
                "the wheel is set to {places} places, the instrument file says {}; set the wheel with the vendor's program or correct `places`",
                self.config.places
            );
            return Err(self.wire.error(ErrorKind::WrongDevice, what));
        }
        self.wire.write("speed", 1).await?;
        self.wire.write("sensors", 0).await?;
        self.open = true;
        let firmware = text.rsplit(' ').next().unwrap_or_default().to_owned();
        Ok(Identity { model: format!("Thorlabs FW102C/FW212C, {places} places"), firmware, serial: String::new() })
    }

    async fn health(&mut self) -> Result<Health> {
        self.check_open()?;
        let mut warnings: Vec<String> = WheelConfig::astray(self.commanded, self.look().await?).into_iter().collect();
        if self.wire.number("sensors?").await? != 0 {
            warnings.push("restarted: the position sensors shine again; open the wheel again".to_owned());
        }
        if self.wire.unsolicited > 0 {
            warnings.push(format!("{} times bytes came unasked", self.wire.unsolicited));
        }
        Ok(Health { warnings, temperature_c: None })
    }

    async fn make_safe(&mut self) -> Result<()> {
        self.wire.ensure().await?;
        let dark = self.config.dark;
        match dark {
            Some(dark) if self.read_place().await? != Some(dark.0) => self.turn_to(dark.0).await,
            _ => Ok(()),
        }
    }
}

#[async_trait]
impl FilterWheel for Fw212c {
    fn slots(&self) -> u8 {
        self.config.places
    }

    async fn select(&mut self, slot: Slot) -> Result<Slot> {
        if let Some(what) = self.config.beyond(slot) {
            return Err(self.wire.error(ErrorKind::Refused, what));
        }
        self.check_open()?;
        self.turn_to(slot.0).await?;
        self.wire.clock.sleep(self.config.settle).await;
        Ok(slot)
    }

    async fn slot(&mut self) -> Result<Option<Slot>> {
        self.check_open()?;
        Ok(self.look().await?.map(Slot))
    }
}
