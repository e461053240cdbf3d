//! Zaber ASCII protocol, the words on the wire: requests with id and LRC out, replies, infos and alerts in.
//!
//! Source: Zaber ASCII protocol manual (firmware 6.14 to 7.x) as collected in the protocol sheet `zaber-ascii`. The
//! request type is an enum, so words that renumber, re-address, restore or store cannot be spelt.

use std::fmt;

/// Device and axis number in a chain; axis 0 is the device itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Address {
    /// 1 to 99.
    pub device: u8,
    /// 0 to 9.
    pub axis: u8,
}

/// Settings the driver reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Setting {
    /// Model number, firmware 7.
    DeviceId,
    /// Model number, firmware 6.
    DeviceIdFirmware6,
    /// Firmware version.
    Version,
    /// Serial number of controller or integrated stage.
    SystemSerial,
    /// Serial number of the stage behind a controller.
    PeripheralSerial,
    /// Time since power-up (firmware 7.34 on); only its decrease is used.
    Uptime,
    /// 1: replies carry a checksum (firmware 6.14 on).
    Checksum,
    /// 1: the device sends alerts.
    Alert,
    /// Microsteps a turn; 0 or rejected = not rotary.
    CycleDist,
    /// Lowest position in microsteps.
    LimitMin,
    /// Highest position in microsteps.
    LimitMax,
    /// Speed towards the home sensor, in units of 1/1.6384 microstep/s.
    ApproachSpeed,
    /// Speed, in units of 1/1.6384 microstep/s.
    MaxSpeed,
    /// Acceleration, in units of 10000/1.6384 microstep/s².
    Accel,
    /// Position in microsteps.
    Position,
    /// Temperature of the drive stage in °C.
    DriverTemperature,
    /// Temperature of the controller in °C.
    SystemTemperature,
}

/// Everything the driver can say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Empty words: status and top warning.
    Poll,
    /// `tools echo` with a number: the harmless no-op.
    Echo(u32),
    /// Reads a setting.
    Get(Setting),
    /// Checksums on.
    ChecksumOn,
    /// Alerts off.
    AlertsOff,
    /// Writes the speed, in the setting's units.
    SetMaxSpeed(u64),
    /// Writes the acceleration, in the setting's units.
    SetAccel(u64),
    /// Drive stage on (firmware 7).
    DriverEnable,
    /// Leaves the parked state.
    Unpark,
    /// Finds the reference.
    Home,
    /// Moves to a position in microsteps.
    MoveAbs(i64),
    /// Stops with the ramp.
    Stop,
    /// All warnings.
    Warnings,
    /// Clears latched warnings.
    ClearWarnings,
}

/// An answer to a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reply {
    /// Who answers.
    pub at: Address,
    /// The request's id; `None` when the reply carries none.
    pub id: Option<u8>,
    /// OK (true) or RJ.
    pub accepted: bool,
    /// The axis moves.
    pub busy: bool,
    /// Top warning, `--` when there is none.
    pub warning: String,
    /// Data, `0` for setters and motions, a reason word after RJ.
    pub data: String,
}

/// A line from a chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// `@`
    Reply(Reply),
    /// `#`: who, id, text.
    Info(Address, Option<u8>, String),
    /// `!`: who and the rest of the line.
    Alert(Address, String),
}

/// Why a line is not a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Defect {
    /// The checksum does not fit.
    Checksum,
    /// Checksums are on, but the line has none.
    NoChecksum,
    /// Not in the grammar.
    Shape,
}

/// The checksum: two's complement of the low byte of the sum, over the text between type character and colon.
pub fn lrc(text: &[u8]) -> u8 {
    text.iter().fold(0_u8, |sum, &b| sum.wrapping_add(b)).wrapping_neg()
}

/// A request line with id, checksum and LF.
pub fn encode(at: Address, id: u8, command: Command) -> Vec<u8> {
    let words = command.to_string();
    let gap = if words.is_empty() { "" } else { " " };
    let body = format!("{} {} {id:02}{gap}{words}", at.device, at.axis);
    format!("/{body}:{:02X}\n", lrc(body.as_bytes())).into_bytes()
}

/// Reads a line without its CR LF. With `checked`, a line without checksum is a defect, and junk before the type
/// character is skipped (the checksum proves what follows).
pub fn parse(line: &[u8], checked: bool) -> Result<Message, Defect> {
    let is_type = |b: &u8| matches!(b, b'@' | b'#' | b'!');
    let start = if checked { line.iter().rposition(is_type) } else { line.first().filter(|b| is_type(b)).map(|_| 0) };
    let (kind, rest) = start.and_then(|s| line.get(s..)).and_then(<[u8]>::split_first).ok_or(Defect::Shape)?;
    let body = match rest.iter().rposition(|&b| b == b':') {
        None if checked => return Err(Defect::NoChecksum),
        None => rest,
        Some(colon) => {
            let (body, sum) = rest.split_at(colon);
            if sum.get(1..) != Some(format!("{:02X}", lrc(body)).as_bytes()) {
                return Err(Defect::Checksum);
            }
            body
        }
    };
    let text = std::str::from_utf8(body).map_err(|_| Defect::Shape)?;
    let mut words = text.splitn(3, ' ');
    let device = words.next().filter(|w| w.len() == 2).and_then(digits).ok_or(Defect::Shape)?;
    let axis = words.next().filter(|w| w.len() == 1).and_then(digits).ok_or(Defect::Shape)?;
    let at = Address { device, axis };
    let rest = words.next().unwrap_or_default();
    let (id, tail) = split_id(rest);
    match kind {
        b'@' => parse_reply(at, id, tail).map(Message::Reply).ok_or(Defect::Shape),
        b'#' => Ok(Message::Info(at, id, tail.to_owned())),
        _ => Ok(Message::Alert(at, rest.to_owned())),
    }
}

/// Takes a two-digit id off the front.
fn split_id(text: &str) -> (Option<u8>, &str) {
    let (word, tail) = text.split_once(' ').unwrap_or((text, ""));
    match digits(word) {
        Some(id) if word.len() == 2 => (Some(id), tail),
        _ => (None, text),
    }
}

/// A number of digits alone: no sign.
fn digits(word: &str) -> Option<u8> {
    word.bytes().all(|b| b.is_ascii_digit()).then(|| word.parse().ok()).flatten()
}

fn parse_reply(at: Address, id: Option<u8>, text: &str) -> Option<Reply> {
    let mut words = text.splitn(4, ' ');
    let accepted = match words.next()? {
        "OK" => true,
        "RJ" => false,
        _ => return None,
    };
    let busy = match words.next()? {
        "BUSY" => true,
        "IDLE" => false,
        _ => return None,
    };
    let warning = words.next().filter(|w| w.len() == 2)?.to_owned();
    let data = words.next()?.to_owned();
    Some(Reply { at, id, accepted, busy, warning, data })
}

// === impl Command ===

impl Command {
    /// True for what may be sent again when its reply was lost: queries, absolute moves, stop, switches with a value.
    pub fn repeatable(self) -> bool {
        !matches!(self, Command::Home)
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Command::Poll => Ok(()),
            Command::Echo(n) => write!(f, "tools echo {n}"),
            Command::Get(setting) => write!(f, "get {}", setting.name()),
            Command::ChecksumOn => f.write_str("set comm.checksum 1"),
            Command::AlertsOff => f.write_str("set comm.alert 0"),
            Command::SetMaxSpeed(v) => write!(f, "set maxspeed {v}"),
            Command::SetAccel(v) => write!(f, "set accel {v}"),
            Command::DriverEnable => f.write_str("driver enable"),
            Command::Unpark => f.write_str("tools parking unpark"),
            Command::Home => f.write_str("home"),
            Command::MoveAbs(n) => write!(f, "move abs {n}"),
            Command::Stop => f.write_str("stop"),
            Command::Warnings => f.write_str("warnings"),
            Command::ClearWarnings => f.write_str("warnings clear"),
        }
    }
}

// === impl Setting ===

impl Setting {
    /// The setting's name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Setting::DeviceId => "device.id",
            Setting::DeviceIdFirmware6 => "deviceid",
            Setting::Version => "version",
            Setting::SystemSerial => "system.serial",
            Setting::PeripheralSerial => "peripheral.serial",
            Setting::Uptime => "system.uptime",
            Setting::Checksum => "comm.checksum",
            Setting::Alert => "comm.alert",
            Setting::CycleDist => "limit.cycle.dist",
            Setting::LimitMin => "limit.min",
            Setting::LimitMax => "limit.max",
            Setting::ApproachSpeed => "limit.approach.maxspeed",
            Setting::MaxSpeed => "maxspeed",
            Setting::Accel => "accel",
            Setting::Position => "pos",
            Setting::DriverTemperature => "driver.temperature",
            Setting::SystemTemperature => "system.temperature",
        }
    }
}

// === impl Defect ===

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Defect::Checksum => "an answer failed its checksum",
            Defect::NoChecksum => "an answer came without the checksum that was switched on",
            Defect::Shape => "an answer is not in the protocol",
        })
    }
}

#[cfg(test)]
#[path = "zaber_protocol_tests.rs"]
mod tests;
