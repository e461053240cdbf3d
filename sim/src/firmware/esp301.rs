//! Twin of a Newport ESP300/ESP301 controller with up to three rotation stages.
//!
//! Source: the protocol sheet `newport-esp301`. Setters and motions are silent; what is wrong goes into an error queue
//! of ten. Replies leave after 5 to 15 ms, spaced by the baud rate.

use super::Firmware;
use super::esp301_axis::EspAxis;
use super::esp301_programs::{Done, MOST_STEPS, Programs};
use super::esp301_settings::{defaults, error_text, number, setting};
use super::outbox::{Outbox, WireFault};
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Version text.
const VERSION: &str = "ESP301 Version 3.0.1 6/1/99";
/// Entries of the error queue; the oldest is lost.
const QUEUE: usize = 10;
/// Characters of a line.
const MAX_LINE: usize = 80;
/// Commands that wait behind a `WS`.
const MAX_WAITING: usize = 256;
/// Servo tick of the time stamps.
const TICK: Duration = Duration::from_micros(400);

/// What one stage is.
#[derive(Debug, Clone, PartialEq)]
pub struct EspStage {
    /// Model as its memory says it.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// True angle at power-up, from the home switch.
    pub start_deg: f64,
}

/// Faults of the controller; axes are counted from 1.
#[derive(Debug, Clone, PartialEq)]
pub enum Esp301Fault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The next reply comes without its CR.
    LostCr,
    /// The next reply comes without its end, so that the one after it is glued to it.
    Glued,
    /// A line `E37` comes right before the next reply.
    Unsolicited,
    /// The stage jams when it next passes this true angle: following error, motor off.
    Jam(u8, f64),
    /// A limit switch is reached now (true: the positive one).
    LimitSwitch(u8, bool),
    /// The motor goes off.
    MotorOff(u8),
    /// The axis seems to rest between the phases of a home search.
    HomeGlitch(u8),
    /// The next move ends so many degrees off.
    Overshoot(u8, f64),
    /// The next move never seems to end.
    NeverDone(u8),
    /// Another hand turns the stage.
    Hand(u8, f64),
    /// The axis is set to other units.
    Units(u8, u8),
    /// The stage's plug is out (no model, no serial number).
    Unknown(u8),
    /// The emergency stop is pressed (true) or released.
    EmergencyStop(bool),
    /// A stage cable is out (true) or back.
    CableInterlock(bool),
    /// The controller restarts now.
    Restart,
    /// The next line makes it restart without an answer.
    RestartOnCommand,
}

/// A controller and its stages.
#[derive(Debug)]
pub struct Esp301Twin {
    axes: Vec<EspAxis>,
    outbox: Outbox,
    line: Vec<u8>,
    waiting: VecDeque<String>,
    programs: Programs,
    /// Address on the instrument bus.
    bus_address: u8,
    blocked_until: Option<Instant>,
    errors: VecDeque<(u16, Instant)>,
    boot: Instant,
    baud: u32,
    last_reply: Instant,
    replies: u64,
    ends: VecDeque<Esp301Fault>,
    stopped: bool,
    interlock: bool,
    restart_on_command: bool,
}

// === impl EspStage ===

impl EspStage {
    /// A rotation stage 37 degrees from its home switch.
    pub fn new(serial: impl Into<String>) -> EspStage {
        EspStage { model: "URS100BCC".to_owned(), serial: serial.into(), start_deg: 37.0 }
    }
}

// === impl Esp301Twin ===

impl Esp301Twin {
    /// A controller powered up at `now`, on a line of `baud`.
    pub fn new(stages: Vec<EspStage>, baud: u32, now: Instant) -> Esp301Twin {
        let axes = stages.iter().map(|s| EspAxis::new(&s.model, &s.serial, s.start_deg, now)).collect();
        Esp301Twin {
            axes,
            outbox: Outbox::default(),
            line: Vec::new(),
            waiting: VecDeque::new(),
            programs: Programs::default(),
            bus_address: 1,
            blocked_until: None,
            errors: VecDeque::new(),
            boot: now,
            baud,
            last_reply: now,
            replies: 0,
            ends: VecDeque::new(),
            stopped: false,
            interlock: false,
            restart_on_command: false,
        }
    }

    /// True angle of an axis at `at`, `None` when there is no such axis.
    pub fn angle_deg(&self, axis: u8, at: Instant) -> Option<f64> {
        self.axes.get(usize::from(axis).checked_sub(1)?).map(|a| a.track.position(at))
    }

    /// True while a fault of the wire waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.outbox.faults_wait()
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: Esp301Fault, now: Instant) {
        match fault {
            Esp301Fault::Wire(fault) => self.outbox.inject(fault),
            Esp301Fault::LostCr | Esp301Fault::Glued | Esp301Fault::Unsolicited => self.ends.push_back(fault),
            Esp301Fault::Jam(n, angle) => self.with(n, |a| a.jam_at = Some(angle)),
            Esp301Fault::LimitSwitch(n, positive) => {
                self.with(n, |a| {
                    a.stop("AE", now);
                });
                self.fail(u16::from(n) * 100 + if positive { 4 } else { 5 }, now);
            }
            Esp301Fault::MotorOff(n) => self.with(n, |a| a.motor_off(now)),
            Esp301Fault::HomeGlitch(n) => self.with(n, |a| a.home_glitch = true),
            Esp301Fault::Overshoot(n, by) => self.with(n, |a| a.overshoot = by),
            Esp301Fault::NeverDone(n) => self.with(n, |a| a.never_done = true),
            Esp301Fault::Hand(n, by) => self.with(n, |a| a.turned_by_hand(by, now)),
            Esp301Fault::Units(n, code) => self.with(n, |a| {
                a.settings.insert("SN", f64::from(code));
            }),
            Esp301Fault::Unknown(n) => self.with(n, |a| a.model = "Unknown".to_owned()),
            Esp301Fault::EmergencyStop(pressed) => self.all_off(pressed, 4, now),
            Esp301Fault::CableInterlock(out) => self.all_off(out, 8, now),
            Esp301Fault::Restart => self.restart(now),
            Esp301Fault::RestartOnCommand => self.restart_on_command = true,
        }
    }

    fn with(&mut self, axis: u8, act: impl FnOnce(&mut EspAxis)) {
        if let Some(axis) = usize::from(axis).checked_sub(1).and_then(|i| self.axes.get_mut(i)) {
            act(axis);
        }
    }

    fn all_off(&mut self, active: bool, code: u16, now: Instant) {
        if code == 4 {
            self.stopped = active
        } else {
            self.interlock = active
        }
        if active {
            self.axes.iter_mut().for_each(|a| a.motor_off(now));
            self.fail(code, now);
        }
    }

    fn restart(&mut self, now: Instant) {
        let saved = defaults();
        self.axes.iter_mut().for_each(|a| a.restart(&saved, now));
        self.outbox.clear();
        self.line.clear();
        self.waiting.clear();
        self.programs.power_cycle();
        self.blocked_until = None;
        self.errors.clear();
        self.boot = now;
    }

    pub(super) fn fail(&mut self, code: u16, now: Instant) {
        if self.errors.len() >= QUEUE {
            self.errors.pop_front();
        }
        self.errors.push_back((code, now));
    }

    fn reply(&mut self, text: &str, now: Instant) {
        self.replies += 1;
        let end = self.ends.pop_front();
        let bytes = match end {
            Some(Esp301Fault::LostCr) => format!("{text}\n"),
            Some(Esp301Fault::Glued) => text.to_owned(),
            Some(Esp301Fault::Unsolicited) => format!("E37\r\n{text}\r\n"),
            _ => format!("{text}\r\n"),
        };
        let wire = Duration::from_secs(10) * bytes.len() as u32 / self.baud.max(1);
        let at = (now + Duration::from_millis(5 + self.replies % 3 * 2)).max(self.last_reply) + wire;
        self.last_reply = at;
        self.outbox.reply(at, bytes.as_bytes());
    }

    /// Carries out what waits, until a `WS`, `WT` or `WP` blocks.
    fn run(&mut self, now: Instant) {
        for n in 0..self.axes.len() {
            let codes = self.axes.get_mut(n).map(|a| a.update(now)).unwrap_or_default();
            codes.into_iter().for_each(|code| self.fail((n as u16 + 1) * 100 + code, now));
        }
        while self.blocked_until.is_none_or(|until| until <= now) {
            self.blocked_until = None;
            let Some(command) = self.waiting.pop_front() else { return };
            if std::mem::take(&mut self.restart_on_command) {
                return self.restart(now);
            }
            if let Err(code) = self.command(&command, now) {
                self.fail(code, now);
            }
        }
    }

    /// Carries out one command; the error number where it cannot.
    fn command(&mut self, text: &str, now: Instant) -> Result<(), u16> {
        let digits = text.bytes().take_while(u8::is_ascii_digit).count();
        let (axis, rest) = text.split_at(digits);
        let (name, parameter) = rest.split_at_checked(2).ok_or(6_u16)?;
        let name = name.to_ascii_uppercase();
        let parameter = parameter.trim();
        let axis = if axis.is_empty() { None } else { Some(axis.parse::<usize>().map_err(|_| 9_u16)?) };
        match self.programs.take(text, axis, &name, parameter)? {
            Done::Other => {}
            Done::Quiet => return Ok(()),
            Done::Told(lines) => {
                lines.iter().for_each(|line| self.reply(line, now));
                return Ok(());
            }
            Done::Run(steps) => {
                let room = (MAX_WAITING + MOST_STEPS).saturating_sub(self.waiting.len());
                steps.into_iter().take(room).rev().for_each(|step| self.waiting.push_front(step));
                return Ok(());
            }
        }
        if self.controller(&name, axis, parameter, now)? {
            return Ok(());
        }
        if !is_axis_word(&name) {
            return Err(6);
        }
        let number = axis.ok_or(37_u16)?;
        if number == 0 || number > self.axes.len() {
            return Err(9);
        }
        let (stopped, interlock) = (self.stopped, self.interlock);
        let Some(axis) = self.axes.get_mut(number - 1) else { return Err(9) };
        if name == "MO" && parameter.is_empty() && (stopped || interlock) {
            return Err(if stopped { 4 } else { 8 });
        }
        match act(axis, &name, parameter, now) {
            Ok(Some(answer)) => self.reply(&answer, now),
            Ok(None) => {}
            Err(code) if code <= 30 => return Err(number as u16 * 100 + code),
            Err(code) => return Err(code),
        }
        Ok(())
    }

    /// Commands of the controller as a whole; false for any other.
    fn controller(&mut self, name: &str, axis: Option<usize>, parameter: &str, now: Instant) -> Result<bool, u16> {
        match name {
            "VE" => self.reply(VERSION, now),
            "TE" => {
                let code = self.errors.pop_front().map_or(0, |(code, _)| code);
                self.reply(&code.to_string(), now);
            }
            "TB" => {
                let (code, at) = self.errors.pop_front().unwrap_or((0, now));
                let ticks = at.saturating_duration_since(self.boot).as_micros() / TICK.as_micros();
                self.reply(&format!("{code}, {ticks}, {}", error_text(code)), now);
            }
            "PH" => {
                let (first, second) = self.hardware(now);
                self.reply(&format!("{first:X}H, {second:X}H"), now);
            }
            "TS" => {
                let status = char::from(self.status(now));
                self.reply(&status.to_string(), now);
            }
            "TX" => self.reply("@", now),
            "ZU" => self.reply(&format!("{:X}H", (1_u32 << self.axes.len()).wrapping_sub(1) << 8), now),
            "SA" if parameter == "?" => self.reply(&self.bus_address.to_string(), now),
            "SA" => self.bus_address = parameter.parse().ok().filter(|n| (1..=30).contains(n)).ok_or(7_u16)?,
            "BO" | "SB" | "DI" if parameter == "?" => self.reply("0H", now),
            "ST" if axis.is_none() => self.axes.iter_mut().for_each(|a| {
                a.stop("AG", now);
            }),
            "AB" => self.axes.iter_mut().for_each(|a| {
                a.stop("AE", now);
            }),
            "RS" => self.restart(now),
            "WS" | "WP" => self.wait(axis, parameter, now)?,
            "WT" => {
                let ms: f64 = parameter.parse().map_err(|_| 38_u16)?;
                self.blocked_until = Some(now + Duration::try_from_secs_f64(ms / 1e3).map_err(|_| 7_u16)?);
            }
            "AP" => self.waiting.clear(),
            // Nothing to save, no digital outputs, no data acquisition.
            "SM" | "SB" | "BO" | "BG" | "UH" | "UL" | "ES" | "DC" | "DG" | "DF" | "DD" => {}
            _ if name.starts_with('H') => return Err(if axis.is_none() { 13 } else { 15 }),
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// `WSn`: until the axis (or all) rests and n ms more; `WPx`: until it has passed x, here until it rests.
    fn wait(&mut self, axis: Option<usize>, parameter: &str, now: Instant) -> Result<(), u16> {
        if axis.is_some_and(|n| n == 0 || n > self.axes.len()) {
            return Err(9);
        }
        let ms: f64 = if parameter.is_empty() { 0.0 } else { parameter.parse().map_err(|_| 7_u16)? };
        let concerned = self.axes.iter().enumerate().filter(|(n, _)| axis.is_none_or(|a| a == n + 1));
        let end = concerned.filter_map(|(_, a)| a.track.end().into_iter().chain(a.due()).max()).max().unwrap_or(now);
        self.blocked_until = Some(end.max(now) + Duration::try_from_secs_f64(ms / 1e3).map_err(|_| 7_u16)?);
        Ok(())
    }

    /// Limit switches, then home switches and index.
    fn hardware(&self, now: Instant) -> (u32, u32) {
        let mut words = (0, 0);
        for (n, axis) in self.axes.iter().enumerate() {
            let at = axis.counter(now);
            words.0 |= u32::from(at > axis.get("SR") + 1.0) << n;
            words.0 |= u32::from(at < axis.get("SL") - 1.0) << (n + 8);
            words.1 |= u32::from(axis.track.position(now).abs() < 0.5) << n;
        }
        if self.stopped {
            words.0 |= 1 << 27;
        }
        words
    }

    /// Bits 0 to 2 axis moving, 4 any motor on, 6 always.
    fn status(&self, now: Instant) -> u8 {
        let moving = self.axes.iter().enumerate().map(|(n, a)| u8::from(!a.done(now)) << n).sum::<u8>();
        moving | u8::from(self.axes.iter().any(|a| a.motor)) << 4 | 1 << 6
    }
}

impl Firmware for Esp301Twin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if byte == b'\r' {
                let line = String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned();
                let commands = line.split(';').map(str::trim).filter(|c| !c.is_empty()).map(str::to_owned);
                self.waiting.extend(commands);
                self.waiting.truncate(MAX_WAITING);
                self.run(now);
            } else if byte != b'\n' && self.line.len() < MAX_LINE {
                self.line.push(byte);
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        let blocked = self.blocked_until.filter(|_| !self.waiting.is_empty());
        [self.outbox.due(), blocked].into_iter().flatten().min()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.run(now);
        self.outbox.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.outbox.clear();
        self.line.clear();
    }
}

/// Words that need an axis, besides the settings.
fn is_axis_word(name: &str) -> bool {
    let words =
        ["MO", "MF", "OR", "DH", "PA", "PR", "MV", "MT", "ST", "MD", "TP", "DP", "TV", "DV", "ID", "UF", "QD", "TA"];
    words.contains(&name) || setting(name).is_some()
}

/// What one axis does or says; error numbers below 37 are those of the axis.
fn act(axis: &mut EspAxis, name: &str, parameter: &str, now: Instant) -> Result<Option<String>, u16> {
    let ask = parameter == "?";
    let value = || parameter.parse::<f64>().ok().filter(|v| v.is_finite());
    let flag = |on: bool| Ok(Some(u8::from(on).to_string()));
    match name {
        "MD" => return flag(axis.done(now)),
        "MO" if ask => return flag(axis.motor),
        "MF" if ask => return flag(!axis.motor),
        "TP" => return Ok(Some(format!("{:.4}", axis.counter(now) + 0.0))),
        "DP" => return Ok(Some(format!("{:.4}", axis.target + 0.0))),
        "TV" | "DV" => return Ok(Some(format!("{:.4}", axis.velocity(now)))),
        "TA" => return Ok(Some("0.0000".to_owned())),
        "DH" if ask => return Ok(Some(number(axis.get("SH")))),
        "ID" if axis.model == "Unknown" => return Ok(Some("Unknown".to_owned())),
        "ID" => return Ok(Some(format!("{}, SN{}", axis.model, axis.serial))),
        "UF" | "QD" => return Ok(None),
        _ if axis.homing() && !matches!(name, "ST" | "MF") && !ask => return Err(30),
        "MO" => axis.motor = true,
        "MF" => axis.motor_off(now),
        "DH" if parameter.is_empty() => axis.define(0.0, now),
        "DH" => axis.define(value().ok_or(1_u16)?, now),
        "ST" => {
            if axis.stop("AG", now) {
                return Err(20);
            }
        }
        "PA" | "PR" | "MV" | "MT" | "OR" if ask => return axis_report(axis, name),
        "PA" | "PR" | "MV" | "MT" | "OR" => move_axis(axis, name, parameter, now)?,
        _ => return change(axis, name, parameter),
    }
    Ok(None)
}

fn axis_report(axis: &EspAxis, name: &str) -> Result<Option<String>, u16> {
    match name {
        "PA" => Ok(Some(format!("{:.4}", axis.target + 0.0))),
        "OR" => Ok(Some(number(axis.get("OM")))),
        _ => Err(38),
    }
}

fn move_axis(axis: &mut EspAxis, name: &str, parameter: &str, now: Instant) -> Result<(), u16> {
    let value = parameter.parse::<f64>().ok().filter(|v| v.is_finite());
    if parameter.is_empty() && name != "OR" {
        return Err(38);
    }
    if !axis.motor {
        return Err(13);
    }
    match name {
        "OR" => {
            let mode =
                if parameter.is_empty() { axis.get("OM") as u8 } else { parameter.parse().map_err(|_| 1_u16)? };
            if mode > 6 {
                return Err(1);
            }
            axis.home(mode, now);
        }
        "MV" | "MT" => match parameter {
            "+" => axis.run(true, name == "MT", now),
            "-" => axis.run(false, name == "MT", now),
            _ => return Err(1),
        },
        _ => {
            let value = value.ok_or(1_u16)?;
            let target = if name == "PR" { axis.target + value } else { value };
            if target > axis.get("SR") {
                return Err(6);
            }
            if target < axis.get("SL") {
                return Err(7);
            }
            axis.move_to(target, now);
        }
    }
    Ok(())
}

/// Reads or writes a setting.
fn change(axis: &mut EspAxis, name: &str, parameter: &str) -> Result<Option<String>, u16> {
    let setting = setting(name).ok_or(1_u16)?;
    if parameter == "?" {
        return Ok(Some(setting.text(axis.get(name))));
    }
    if parameter.is_empty() {
        return Err(38);
    }
    let value = setting.read(parameter.split(',').next().unwrap_or_default()).ok_or(1_u16)?;
    if value < setting.range.0 || value > setting.range.1 {
        return Err(1);
    }
    if let Some((by, error)) = setting.below
        && value > axis.get(by)
    {
        return Err(error);
    }
    axis.settings.insert(setting.name, value);
    Ok(None)
}
