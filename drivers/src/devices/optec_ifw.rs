//! Driver `optec-ifw`: Optec IFW, IFW2 and IFW3 filter wheels with five to nine places.
//!
//! Source: Optec IFW technical manual 17350 as collected in the protocol sheet `optec-ifw`. The box has no serial number;
//! the letter of the wheel in it stands for one, and another letter after a reconnection is another wheel. `WLOAD`, which
//! writes names into the flash, cannot be spelt.

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
pub const BAUD: u32 = 19_200;
/// Requests end with LF CR (some boxes need nothing); a reply is read to its CR, the LF before it trimmed.
const DIALECT: Dialect = Dialect { request_end: "\n\r", reply_end: b'\r', limit: Duration::from_secs(5) };
/// Entering serial mode: tries and limit of each; a box in manual mode stays silent.
const MODE_TRIES: u32 = 3;
const MODE_LIMIT: Duration = Duration::from_secs(1);
/// The search for the wheel's magnets takes 10 to 20 s.
const HOME_LIMIT: Duration = Duration::from_secs(40);
/// One turn.
const MOVE_LIMIT: Duration = Duration::from_secs(20);
/// Characters of a filter's name in `WREAD`.
const NAME_LENGTH: usize = 8;
/// Times that a place is commanded before it is a fault.
const MOVE_TRIES: u32 = 2;

/// What the box is told or asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Request {
    SerialMode,
    Home,
    Identify,
    Place,
    Goto(u8),
    Names,
    Firmware,
}

/// What it answers.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Answer {
    Accepted,
    Moved,
    Wheel(char),
    Place(u8),
    Text(String),
    /// Number of `ER=n`.
    Error(u8),
}

/// A filter wheel on its link.
pub struct OptecIfw {
    wire: LineWire,
    config: WheelConfig,
    label: String,
    open: bool,
    /// The letter of the wheel first seen.
    wheel: Option<char>,
    commanded: Option<u8>,
    restarts: u64,
}

// === impl Request ===

impl Request {
    fn words(self) -> String {
        match self {
            Request::SerialMode => "WSMODE".to_owned(),
            Request::Home => "WHOME".to_owned(),
            Request::Identify => "WIDENT".to_owned(),
            Request::Place => "WFILTR".to_owned(),
            Request::Goto(place) => format!("WGOTO{place}"),
            Request::Names => "WREAD".to_owned(),
            Request::Firmware => "WVAAAA".to_owned(),
        }
    }

    /// Reads an answer; `None` when it belongs to another request.
    fn read(self, line: &str) -> Option<Answer> {
        let whole = line;
        let line = line.trim();
        if let Some(number) = line.strip_prefix("ER=") {
            return number.trim().parse().ok().map(Answer::Error);
        }
        let mut letters = line.chars();
        let single = letters.next().filter(|_| letters.next().is_none());
        match (self, single) {
            (Request::SerialMode, Some('!')) => Some(Answer::Accepted),
            (Request::Goto(_), Some('*')) => Some(Answer::Moved),
            (Request::Home | Request::Identify, Some(letter @ 'A'..='K')) => Some(Answer::Wheel(letter)),
            (Request::Place, Some(digit @ '1'..='9')) => digit.to_digit(10).map(|d| Answer::Place(d as u8)),
            (Request::Names, None) => Some(Answer::Text(whole.to_owned())),
            (Request::Firmware, None) if line.starts_with("V=") => Some(Answer::Text(line.to_owned())),
            _ => None,
        }
    }
}

/// Kind and words of `ER=n`.
fn meaning(error: u8) -> (ErrorKind, &'static str) {
    match error {
        1 => (ErrorKind::Broken, "too many steps to find place 1"),
        2 => (ErrorKind::Broken, "a pulse of wrong width came; nothing may be wired to the camera input"),
        3 => (ErrorKind::WrongDevice, "the wheel in it is not identified"),
        4 => (ErrorKind::Broken, "the wheel is stuck"),
        5 => (ErrorKind::Refused, "there is no such place"),
        6 => (ErrorKind::Broken, "the wheel slips"),
        _ => (ErrorKind::Broken, "see the wheel's manual"),
    }
}

// === impl OptecIfw ===

impl OptecIfw {
    /// A wheel over `connector`; nothing is sent before `open`.
    pub fn new(connector: Box<dyn Connector>, config: WheelConfig, clock: Clock) -> OptecIfw {
        let label = format!("{} ({})", config.name, connector.port());
        let wire = LineWire::new(connector, DIALECT, clock);
        OptecIfw { wire, config, label, open: false, wheel: None, commanded: None, restarts: 0 }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.label, message)
    }

    fn own(&self, error: DeviceError) -> DeviceError {
        self.error(error.kind, error.message)
    }

    /// One request, one answer; `None` when none came or it is no answer to this request.
    async fn once(&mut self, request: Request, limit: Duration) -> Result<Option<Answer>> {
        let asked = self.wire.ask(&request.words(), limit).await;
        let line = match asked {
            Ok(line) => line,
            Err(error) if matches!(error.kind, ErrorKind::Timeout | ErrorKind::Garbled) => None,
            Err(error) => return Err(self.own(error)),
        };
        let answer = line.as_deref().and_then(|l| request.read(l));
        if answer.is_none() {
            self.wire.distrust();
        }
        Ok(answer)
    }

    /// The answer to a question, once two in a row agree.
    async fn agreed(&mut self, request: Request) -> Result<Answer> {
        let answer = self.wire.agreed(&request.words(), |line| request.read(line)).await;
        match answer.map_err(|e| self.own(e))? {
            Answer::Error(number) => Err(self.refused(number)),
            answer => Ok(answer),
        }
    }

    fn refused(&self, number: u8) -> DeviceError {
        let (kind, what) = meaning(number);
        self.error(kind, format!("the wheel answers ER={number}: {what}"))
    }

    /// Enters serial mode; harmless when the box is in it already.
    async fn enter(&mut self) -> Result<()> {
        for _ in 0..MODE_TRIES {
            if self.once(Request::SerialMode, MODE_LIMIT).await? == Some(Answer::Accepted) {
                return Ok(());
            }
        }
        let what = "no `!` to WSMODE in 3 tries; check power, cable and that the right device is connected";
        Err(self.error(ErrorKind::Timeout, what))
    }

    /// Finds the wheel's magnets and proves which wheel it is.
    async fn home(&mut self) -> Result<char> {
        // The answer may be lost; the letter is asked for in any case.
        if let Some(Answer::Error(number)) = self.once(Request::Home, HOME_LIMIT).await? {
            return Err(self.refused(number));
        }
        match self.agreed(Request::Identify).await? {
            Answer::Wheel(letter) => Ok(letter),
            other => Err(self.error(ErrorKind::Garbled, format!("{other:?} is no wheel"))),
        }
    }

    /// Serial mode again and the same wheel found again, after a restart or a slip.
    async fn find_again(&mut self) -> Result<()> {
        self.wire.forget();
        self.enter().await?;
        let letter = self.home().await?;
        self.wire.trust(NoOp { request: Request::Identify.words(), answer: letter.to_string() });
        match self.wheel {
            Some(known) if known != letter => Err(self.other_wheel(known, letter)),
            _ => Ok(()),
        }
    }

    fn other_wheel(&self, known: char, letter: char) -> DeviceError {
        let what =
            format!("wheel {letter} is in the box, wheel {known} was before; put it back, or start the run anew");
        self.error(ErrorKind::WrongDevice, what)
    }

    async fn read_place(&mut self) -> Result<Option<u8>> {
        match self.agreed(Request::Place).await {
            Ok(Answer::Place(place)) => Ok(Some(place).filter(|p| (1..=self.config.places).contains(p))),
            Ok(_) => Ok(None),
            Err(error) if error.kind == ErrorKind::Broken => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Commands a place, at most twice, and proves it by asking. A silent box was restarted: it is homed again.
    async fn turn_to(&mut self, place: u8) -> Result<()> {
        let mut seen = None;
        for again in 1..=MOVE_TRIES {
            match self.once(Request::Goto(place), MOVE_LIMIT).await? {
                Some(Answer::Error(number @ (1 | 4 | 6))) if again < MOVE_TRIES => {
                    tracing::warn!(device = self.label, number, "the wheel lost its way, homing it");
                    self.find_again().await?;
                    continue;
                }
                Some(Answer::Error(number)) => return Err(self.refused(number)),
                _ => {}
            }
            match self.read_place().await {
                Ok(now) if now == Some(place) => {
                    self.commanded = Some(place);
                    return Ok(());
                }
                Ok(now) => seen = now,
                Err(error) if error.kind == ErrorKind::Timeout => {
                    self.restarts += 1;
                    self.find_again().await?;
                }
                Err(error) => return Err(error),
            }
        }
        let at = seen.map_or("no known place".to_owned(), |p| format!("slot {p}"));
        let what =
            format!("told twice to turn to slot {place}, it stands at {at}; check that nothing blocks the wheel");
        Err(self.error(ErrorKind::Broken, what))
    }

    /// Version of the firmware, when two answers agree; empty for an old box that does not tell it.
    async fn firmware(&mut self) -> Result<String> {
        let first = self.once(Request::Firmware, MODE_LIMIT).await?;
        let Some(Answer::Text(text)) = &first else { return Ok(String::new()) };
        let version = text.trim_start_matches("V=").trim().to_owned();
        let agree = self.once(Request::Firmware, MODE_LIMIT).await? == first;
        Ok(if agree { version } else { String::new() })
    }

    fn check_open(&self) -> Result<()> {
        if self.open { Ok(()) } else { Err(self.error(ErrorKind::Refused, "the wheel is not open; open it first")) }
    }

    async fn connect(&mut self) -> Result<char> {
        self.wire.connect().await.map_err(|e| self.own(e))?;
        self.enter().await?;
        let letter = self.home().await?;
        self.wire.trust(NoOp { request: Request::Identify.words(), answer: letter.to_string() });
        Ok(letter)
    }
}

#[async_trait]
impl Device for OptecIfw {
    async fn open(&mut self) -> Result<Identity> {
        self.open = false;
        self.commanded = None;
        let letter = self.connect().await?;
        if let Some(known) = self.wheel
            && known != letter
        {
            return Err(self.other_wheel(known, letter));
        }
        let names = match self.agreed(Request::Names).await? {
            Answer::Text(text) => text,
            other => return Err(self.error(ErrorKind::Garbled, format!("{other:?} are no filter names"))),
        };
        // Some boxes leave the blanks at the end of the last name out.
        let places = names.chars().count().div_ceil(NAME_LENGTH);
        if places != usize::from(self.config.places) {
            let what = format!(
                "wheel {letter} has {places} places, the instrument file says {}; put the right wheel in or correct `places`",
                self.config.places
            );
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        let firmware = self.firmware().await?;
        self.wheel = Some(letter);
        self.open = true;
        Ok(Identity { model: format!("Optec IFW, {places} places"), firmware, serial: format!("wheel {letter}") })
    }

    async fn health(&mut self) -> Result<Health> {
        self.check_open()?;
        let mut warnings: Vec<String> =
            WheelConfig::astray(self.commanded, self.read_place().await?).into_iter().collect();
        if self.restarts > 0 {
            warnings.push(format!("restarted {} times and homed again", self.restarts));
        }
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
impl FilterWheel for OptecIfw {
    fn slots(&self) -> u8 {
        self.config.places
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn requests_and_answers_are_the_worked_exchange() {
        assert_eq!(Request::Goto(4).words(), "WGOTO4");
        assert_eq!(Request::SerialMode.read("!"), Some(Answer::Accepted));
        assert_eq!(Request::Home.read("A"), Some(Answer::Wheel('A')));
        assert_eq!(Request::Place.read("1"), Some(Answer::Place(1)));
        assert_eq!(Request::Goto(4).read("*"), Some(Answer::Moved));
        assert_eq!(Request::Goto(9).read("ER=5"), Some(Answer::Error(5)));
        assert_eq!(Request::Place.read("*"), None, "the answer to another request");
        assert_eq!(Request::Identify.read("L"), None);
    }
}
