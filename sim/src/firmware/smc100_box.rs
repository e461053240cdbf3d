//! One SMC100 box: its state machine, settings and the stage's mechanics.

use super::motion::Track;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// Firmware text.
const VERSION: &str = "SMC100CC Controller-driver version 2. 0. 1";
/// Time to leave the configuration state: the flash is written.
const FLASH: Duration = Duration::from_secs(3);
/// Characters of a stage's identifier.
const MAX_ID: usize = 31;
/// Following error in the motor's error word.
const FOLLOWING_ERROR: u16 = 1 << 5;
/// Homing time-out in the motor's error word.
const HOME_TIMEOUT: u16 = 1 << 6;

/// Settings in the order of `ZT`: mnemonic, value at power-up, smallest, largest.
#[rustfmt::skip]
const SETTINGS: [(&str, f64, f64, f64); 25] = [
    ("AC", 40.0, 1e-6, 1e12), ("BA", 0.0, 1e-9, 1e12), ("BH", 0.0, 1e-9, 1e12), ("DV", 48.0, 12.0, 48.0), ("FD", 2000.0, 1.0, 2000.0),
    ("FE", 2.0, 1e-6, 1e12), ("FF", 0.0, 0.0, 1e12), ("FRM", 100.0, 1.0, 2000.0), ("FRS", 0.01, 1e-9, 1e12), ("HT", 2.0, 0.0, 4.0),
    ("JR", 0.04, 1e-3, 1e12), ("KD", 1.4, 0.0, 1e12), ("KI", 20.0, 0.0, 1e12), ("KP", 1.4, 0.0, 1e12), ("KV", 0.0, 0.0, 1e12),
    ("OH", 10.0, 1e-6, 1e12), ("OT", 60.0, 1.0, 1000.0), ("QIL", 0.4, 0.05, 3.0), ("QIR", 0.3, 0.05, 1.5), ("QIT", 0.8, 0.01, 100.0),
    ("SL", -360.0, -1e12, 0.0), ("SR", 720.0, 0.0, 1e12), ("SU", 0.0005, 1e-12, 1e12), ("VA", 10.0, 1e-6, 40.0),
    ("VB", 0.0, 0.0, 40.0),
];

/// Mnemonics of three letters; all others have two.
const LONG_NAMES: [&str; 5] = ["FRM", "FRS", "QIL", "QIR", "QIT"];
/// Switches that are kept and told in every state: mnemonic, value at power-up, largest. Outputs, closed loop, jog by the
/// keypad, keypad.
const SWITCHES: [(&str, f64, f64); 4] = [("SB", 0.0, 15.0), ("SC", 1.0, 1.0), ("JM", 1.0, 1.0), ("TK", 1.0, 1.0)];
/// Settings that only the configuration state takes: address on the internal line, check of the stage's memory.
const INSTALLED: [(&str, f64, f64, f64); 2] = [("SA", 2.0, 2.0, 31.0), ("ZX", 3.0, 1.0, 3.0)];

/// Where the box is, by the numbers of `TS`.
mod state {
    pub const RESET: u8 = 0x0A;
    pub const AFTER_HOMING: u8 = 0x0B;
    pub const AFTER_CONFIGURATION: u8 = 0x0C;
    pub const AFTER_MOVING: u8 = 0x0F;
    pub const CONFIGURATION: u8 = 0x14;
    pub const HOMING: u8 = 0x1E;
    pub const MOVING: u8 = 0x28;
    pub const READY_HOMED: u8 = 0x32;
    pub const READY_MOVED: u8 = 0x33;
    pub const READY_ENABLED: u8 = 0x34;
    pub const DISABLED: u8 = 0x3C;
}

/// A box and its stage.
#[derive(Debug)]
pub(super) struct SmcBox {
    /// Address on the line.
    pub address: u8,
    id: String,
    /// Where the stage really is, degrees from its home switch.
    pub track: Track,
    offset: f64,
    target: f64,
    state: u8,
    errors: u16,
    last_error: char,
    settings: BTreeMap<&'static str, f64>,
    pending: Option<(Instant, Pending)>,
    silent_until: Option<Instant>,
    /// The stage jams at this true angle.
    pub jam_at: Option<f64>,
    /// The next move ends so much off.
    pub overshoot: f64,
    /// The next move never seems to end.
    pub never_done: bool,
    /// The next home search finds nothing.
    pub home_lost: bool,
}

/// What happens by itself at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Pending {
    HomeFound,
    HomeLost,
    Arrived,
    Jammed,
}

// === impl SmcBox ===

impl SmcBox {
    /// A box powered up at `now`.
    pub fn new(address: u8, id: String, start_deg: f64, now: Instant) -> SmcBox {
        SmcBox {
            address,
            id,
            track: Track::at_rest(start_deg, now),
            offset: start_deg,
            target: 0.0,
            state: state::RESET,
            errors: 0,
            last_error: '@',
            settings: defaults(address),
            pending: None,
            silent_until: None,
            jam_at: None,
            overshoot: 0.0,
            never_done: false,
            home_lost: false,
        }
    }

    fn get(&self, name: &str) -> f64 {
        self.settings.get(name).copied().unwrap_or(0.0)
    }

    fn counter(&self, now: Instant) -> f64 {
        self.track.position(now) - self.offset
    }

    fn ready(&self) -> bool {
        (state::READY_HOMED..=0x35).contains(&self.state)
    }

    /// Lets happen what was due.
    pub fn update(&mut self, now: Instant) {
        let Some((at, what)) = self.pending.take_if(|(at, _)| *at <= now) else { return };
        match what {
            Pending::HomeFound => {
                self.offset = self.track.position(at);
                self.target = 0.0;
                self.state = state::READY_HOMED;
            }
            Pending::HomeLost => {
                self.track.freeze(at);
                self.errors |= HOME_TIMEOUT;
                self.state = state::AFTER_HOMING;
            }
            Pending::Arrived => self.state = state::READY_MOVED,
            Pending::Jammed => {
                self.errors |= FOLLOWING_ERROR;
                self.state = state::AFTER_MOVING;
            }
        }
    }

    /// Power goes and comes back.
    pub fn restart(&mut self, now: Instant) {
        self.track.freeze(now);
        self.offset = self.track.position(now);
        self.target = 0.0;
        self.pending = None;
        self.errors = 0;
        self.last_error = '@';
        self.state = state::RESET;
    }

    /// The motor goes off, the reference stays.
    pub fn disable(&mut self, now: Instant) {
        self.track.freeze(now);
        self.pending = None;
        self.state = state::DISABLED;
    }

    /// Another hand turns the stage; the encoder follows.
    pub fn turned_by_hand(&mut self, by_deg: f64, now: Instant) {
        self.track.jump(now, self.track.position(now) + by_deg);
    }

    /// Carries out a command and gives the lines of its answer.
    pub fn command(&mut self, words: &str, now: Instant) -> Vec<String> {
        if self.silent_until.is_some_and(|until| now < until) {
            return Vec::new();
        }
        match self.act(words, now) {
            Ok(lines) => lines.into_iter().map(|line| format!("{}{line}", self.address)).collect(),
            Err(letter) => {
                self.last_error = letter;
                Vec::new()
            }
        }
    }

    fn act(&mut self, words: &str, now: Instant) -> Result<Vec<String>, char> {
        let letters = if LONG_NAMES.iter().any(|name| words.starts_with(name)) { 3 } else { 2 };
        let (name, value) = words.split_at_checked(letters).unwrap_or((words, ""));
        let value = value.trim();
        let one = |text: String| Ok(vec![text]);
        match name {
            "TS" => one(format!("TS{:04X}{:02X}", self.errors, self.state)),
            "TE" => one(format!("TE{}", std::mem::replace(&mut self.last_error, '@'))),
            "TB" => {
                let letter = if value.len() == 1 { value.chars().next() } else { None };
                let letter = letter.filter(|c| *c != '?').unwrap_or(self.last_error);
                one(format!("TB{letter} {}", error_text(letter)))
            }
            "TP" => one(format!("TP{}", decimal(self.counter(now)))),
            "TH" => one(format!("TH{}", decimal(self.target))),
            "VE" => one(format!("VE {VERSION}")),
            "ID" if value == "?" || value.is_empty() => one(format!("ID{}", self.id)),
            "MM" if value == "?" => one(format!("MM{:X}", self.state)),
            "PW" if value == "?" => one(format!("PW{}", u8::from(self.state == state::CONFIGURATION))),
            "PA" if value == "?" => one(format!("PA{}", decimal(self.target))),
            "PT" => {
                let distance = finite(value)?;
                let mut trial = Track::at_rest(0.0, now);
                trial.go(now, distance.abs(), self.get("VA"), self.get("AC"));
                let seconds = trial.end().map_or(0.0, |end| (end - now).as_secs_f64());
                one(format!("PT{}", decimal(seconds)))
            }
            "RA" | "RB" => one(format!("{name}0")),
            "ZT" => Ok(self.all_settings()),
            "RS" => {
                self.restart(now);
                Ok(Vec::new())
            }
            "ST" => self.stop(now),
            "OR" | "PA" | "PR" | "MM" | "PW" => self.go(name, value, now),
            "ID" if self.state != state::CONFIGURATION => Err(refusal(self.state)),
            "ID" if value.len() > MAX_ID => Err('C'),
            "ID" => {
                self.id = value.to_owned();
                Ok(Vec::new())
            }
            // Nothing was prepared that could start together, and no keypad jogs.
            "SE" => Ok(Vec::new()),
            "JD" => Err(refusal(self.state)),
            _ => self.setting(name, value),
        }
    }

    fn setting(&mut self, name: &str, value: &str) -> Result<Vec<String>, char> {
        let switch = SWITCHES.iter().find(|(n, ..)| *n == name).map(|&(n, at, most)| (n, at, 0.0, most));
        let known = switch.or_else(|| SETTINGS.iter().chain(&INSTALLED).find(|(n, ..)| *n == name).copied());
        let (name, _, low, high) = known.ok_or('A')?;
        if value == "?" {
            return Ok(vec![format!("{name}{}", decimal(self.get(name)))]);
        }
        let number = finite(value)?;
        if number < low || number > high {
            return Err('C');
        }
        match self.state {
            _ if switch.is_some() => {}
            state::CONFIGURATION => {}
            state::DISABLED..=0x3E if !INSTALLED.iter().any(|(n, ..)| *n == name) => {}
            _ if self.ready() && matches!(name, "AC" | "VA" | "SL" | "SR" | "JR" | "FE" | "KP" | "KI" | "KD") => {}
            other => return Err(refusal(other)),
        }
        self.settings.insert(name, number);
        Ok(Vec::new())
    }

    /// All settings of a stepper box, as `ZT` lists them.
    fn all_settings(&self) -> Vec<String> {
        let listed =
            ["AC", "BA", "BH", "FRM", "FRS", "HT", "JR", "OH", "OT", "QIL", "SA", "SL", "SR", "VA", "VB", "ZX"];
        let mut lines = vec!["PW1".to_owned(), format!("ID{}", self.id)];
        lines.extend(listed.iter().map(|name| format!("{name}{}", decimal(self.get(name)))));
        lines.push("PW0".to_owned());
        lines
    }

    fn stop(&mut self, now: Instant) -> Result<Vec<String>, char> {
        match self.state {
            state::MOVING => {
                self.track.brake(now, self.get("AC"));
                let end = self.track.end().unwrap_or(now);
                self.target = self.counter(end);
                self.pending = Some((end, Pending::Arrived));
            }
            state::HOMING => {
                self.track.freeze(now);
                self.pending = None;
                self.state = state::AFTER_HOMING;
            }
            _ => {}
        }
        Ok(Vec::new())
    }

    fn go(&mut self, name: &str, value: &str, now: Instant) -> Result<Vec<String>, char> {
        match (name, value) {
            ("OR", _) if self.state <= 0x11 => self.home(now),
            ("OR", _) if self.state == state::HOMING => return Err('E'),
            ("MM", "0") if self.ready() => self.disable(now),
            ("MM", "1") if (state::DISABLED..=0x3E).contains(&self.state) => self.state = state::READY_ENABLED,
            ("MM", "0" | "1") if self.state == state::DISABLED || self.ready() => {}
            ("PW", "1") if self.state <= 0x11 => self.state = state::CONFIGURATION,
            ("PW", "0") if self.state == state::CONFIGURATION => {
                self.state = state::AFTER_CONFIGURATION;
                self.silent_until = Some(now + FLASH);
            }
            ("PA" | "PR", _) if self.ready() => {
                let number = finite(value)?;
                let target = if name == "PR" { self.target + number } else { number };
                if !(self.get("SL")..=self.get("SR")).contains(&target) {
                    return Err('G');
                }
                self.move_to(target, now);
            }
            ("MM" | "PW", "0" | "1") | ("OR" | "PA" | "PR", _) => return Err(refusal(self.state)),
            _ => return Err('C'),
        }
        Ok(Vec::new())
    }

    fn home(&mut self, now: Instant) {
        self.errors = 0;
        self.state = state::HOMING;
        self.begin(0.0, self.get("OH"), now);
        let end = self.track.end().unwrap_or(now);
        let lost = now + Duration::try_from_secs_f64(self.get("OT")).unwrap_or_default();
        self.pending = self.pending.or(Some(match std::mem::take(&mut self.home_lost) {
            true => (lost, Pending::HomeLost),
            false => (end, Pending::HomeFound),
        }));
    }

    fn move_to(&mut self, target: f64, now: Instant) {
        self.errors = 0;
        self.target = target;
        self.state = state::MOVING;
        self.pending = None;
        let off = std::mem::take(&mut self.overshoot);
        self.begin(target + self.offset + off, self.get("VA"), now);
        let end = self.track.end().unwrap_or(now);
        if !std::mem::take(&mut self.never_done) {
            self.pending = self.pending.or(Some((end, Pending::Arrived)));
        }
    }

    fn begin(&mut self, target: f64, speed: f64, now: Instant) {
        self.pending = None;
        self.track.go(now, target, speed, self.get("AC"));
        if let Some(angle) = self.jam_at
            && let Some(at) = self.track.passes(now, angle)
        {
            self.track.freeze(at);
            self.jam_at = None;
            self.pending = Some((at, Pending::Jammed));
        }
    }
}

/// All settings at power-up. A box that is addressed as 1 hangs on the host's line itself.
fn defaults(address: u8) -> BTreeMap<&'static str, f64> {
    let settings = SETTINGS.iter().chain(&INSTALLED).map(|(name, value, ..)| (*name, *value));
    let mut all: BTreeMap<_, _> = settings.chain(SWITCHES.iter().map(|(name, value, _)| (*name, *value))).collect();
    all.insert("SA", f64::from(address.max(2)));
    all
}

/// The letter for a command that a state does not allow.
fn refusal(state: u8) -> char {
    match state {
        0..=0x11 => 'H',
        state::CONFIGURATION => 'I',
        state::HOMING | 0x1F => 'L',
        state::MOVING => 'M',
        0x32..=0x35 => 'K',
        state::DISABLED..=0x3E => 'J',
        _ => 'D',
    }
}

/// A value; what is none is a parameter missing or out of range.
fn finite(text: &str) -> Result<f64, char> {
    text.parse().ok().filter(|value: &f64| value.is_finite()).ok_or('C')
}

/// A decimal with at most six places.
fn decimal(value: f64) -> String {
    let text = format!("{value:.6}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".to_owned() } else { text.to_owned() }
}

fn error_text(letter: char) -> &'static str {
    match letter {
        '@' => "No error",
        'A' => "Unknown message code or floating point controller address",
        'B' => "Controller address not correct",
        'C' => "Parameter missing or out of range",
        'D' => "Execution not allowed",
        'E' => "Home sequence already started",
        'F' => "ESP stage name unknown",
        'G' => "Displacement out of limits",
        'H' => "Execution not allowed in NOT REFERENCED state",
        'I' => "Execution not allowed in CONFIGURATION state",
        'J' => "Execution not allowed in DISABLE state",
        'K' => "Execution not allowed in READY state",
        'L' => "Execution not allowed in HOMING state",
        'M' => "Execution not allowed in MOVING state",
        'N' => "Current position out of software limit",
        'S' => "Communication Time Out",
        'U' => "Error during EEPROM access",
        'V' => "Error during command execution",
        'W' => "Command not allowed for PP version",
        'X' => "Command not allowed for CC version",
        _ => "Error during command execution",
    }
}
