//! Twin of a Zaber daisy chain (ASCII protocol, firmware 6.14 to 7.x): integrated rotary stages with one axis each.
//!
//! Source: the protocol sheet `zaber-ascii`, sections 1 to 9. Written from the device's side with a codec of its own.

use super::Firmware;
use super::outbox::{Outbox, WireFault};
use super::zaber_axis::AxisTwin;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Longest request taken.
const MAX_REQUEST: usize = 80;
/// Time a turned knob stays a warning.
const KNOB_TIME: Duration = Duration::from_secs(1);

/// What one stage of the chain is.
#[derive(Debug, Clone, PartialEq)]
pub struct ZaberStage {
    /// Model number.
    pub device_id: u32,
    /// Serial number.
    pub serial: String,
    /// Firmware version, for example `7.38`; decides which words are known.
    pub version: String,
    /// True angle at power-up, from the home sensor.
    pub start_deg: f64,
    /// `maxspeed` at power-up.
    pub max_speed: u32,
    /// `accel` at power-up.
    pub accel: u32,
}

/// Faults of the chain; devices are counted from 1.
#[derive(Debug, Clone, PartialEq)]
pub enum ZaberFault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The next reply carries another request's id.
    WrongId,
    /// The next reply's checksum is wrong.
    WrongLrc,
    /// An alert comes right before the next reply.
    AlertBetween,
    /// The next reply is continued over two lines.
    SplitReply,
    /// The next so many requests are rejected with AGAIN.
    Again(u8),
    /// The device restarts now.
    Restart(u8),
    /// The next request makes its device restart without an answer.
    RestartOnCommand,
    /// The stage stalls when it next passes this true angle.
    Stall(u8, f64),
    /// The stage is pushed while it stands.
    Displaced(u8, f64),
    /// The knob is turned.
    Knob(u8, f64),
    /// The drive stage goes off.
    DriverOff(u8),
    /// The next move begins, but never ends.
    NeverArrives(u8),
    /// This warning is told by `warnings` only.
    HiddenWarning(u8, String),
    /// The device is parked.
    Parked(u8),
}

/// A chain of stages on one line.
#[derive(Debug)]
pub struct ZaberChainTwin {
    devices: Vec<Stage>,
    outbox: Outbox,
    line: Vec<u8>,
    shapes: VecDeque<ZaberFault>,
    again: u8,
    restart_on_command: bool,
    replies: u64,
}

#[derive(Debug)]
struct Stage {
    spec: ZaberStage,
    boot: Instant,
    checksum: bool,
    alert: bool,
    axis: AxisTwin,
}

/// A request as it came: who is meant, which id, which words.
struct Request<'a> {
    device: u8,
    axis: u8,
    id: Option<u8>,
    words: Vec<&'a str>,
}

/// An answer before it has an address: accepted, data.
type Answer = (bool, String);

// === impl ZaberStage ===

impl ZaberStage {
    /// An integrated rotary stage with the usual settings, standing 37 degrees from its home sensor.
    pub fn new(serial: impl Into<String>) -> ZaberStage {
        let serial = serial.into();
        ZaberStage {
            device_id: 50_081,
            serial,
            version: "7.38".into(),
            start_deg: 37.0,
            max_speed: 153_600,
            accel: 205,
        }
    }

    /// Major and minor firmware number.
    fn firmware(&self) -> (u32, u32) {
        let mut parts = self.version.split('.').map(|p| p.parse().unwrap_or(0));
        (parts.next().unwrap_or(0), parts.next().unwrap_or(0))
    }
}

// === impl ZaberChainTwin ===

impl ZaberChainTwin {
    /// A chain powered up at `now`; the first stage is device 1.
    pub fn new(stages: Vec<ZaberStage>, now: Instant) -> ZaberChainTwin {
        let devices = stages.into_iter().map(|spec| Stage::new(spec, now)).collect();
        ZaberChainTwin {
            devices,
            outbox: Outbox::default(),
            line: Vec::new(),
            shapes: VecDeque::new(),
            again: 0,
            restart_on_command: false,
            replies: 0,
        }
    }

    /// True angle of a device's stage at `at`; `None` when there is no such device.
    pub fn angle_deg(&self, device: u8, at: Instant) -> Option<f64> {
        self.stage(device).map(|s| s.axis.track.position(at))
    }

    /// True when the stage moves at `at`.
    pub fn moving(&self, device: u8, at: Instant) -> bool {
        self.stage(device).is_some_and(|s| s.axis.track.moving(at))
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: ZaberFault, now: Instant) {
        match fault {
            ZaberFault::Wire(fault) => self.outbox.inject(fault),
            ZaberFault::WrongId | ZaberFault::WrongLrc | ZaberFault::AlertBetween | ZaberFault::SplitReply => {
                self.shapes.push_back(fault);
            }
            ZaberFault::Again(times) => self.again = times,
            ZaberFault::RestartOnCommand => self.restart_on_command = true,
            ZaberFault::Restart(d) => self.with(d, now, |s| s.restart(now)),
            ZaberFault::Stall(d, angle) => self.with(d, now, |s| s.axis.stall_at = Some(angle)),
            ZaberFault::Displaced(d, by) => self.with(d, now, |s| s.axis.displace(by, now)),
            ZaberFault::Knob(d, by) => self.with(d, now, |s| s.axis.turn_knob(by, now + KNOB_TIME, now)),
            ZaberFault::DriverOff(d) => self.with(d, now, |s| s.axis.driver_on = false),
            ZaberFault::NeverArrives(d) => self.with(d, now, |s| s.axis.never_arrives = true),
            ZaberFault::HiddenWarning(d, code) => self.with(d, now, |s| {
                s.axis.hidden.insert(code);
            }),
            ZaberFault::Parked(d) => self.with(d, now, |s| s.axis.parked = true),
        }
    }

    /// True while an injected fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        let axes = self.devices.iter().any(|s| s.axis.stall_at.is_some() || s.axis.never_arrives);
        axes || self.outbox.faults_wait() || !self.shapes.is_empty() || self.again > 0 || self.restart_on_command
    }

    fn stage(&self, device: u8) -> Option<&Stage> {
        self.devices.get(usize::from(device).checked_sub(1)?)
    }

    fn with(&mut self, device: u8, now: Instant, act: impl FnOnce(&mut Stage)) {
        if let Some(stage) = usize::from(device).checked_sub(1).and_then(|i| self.devices.get_mut(i)) {
            stage.axis.update(now);
            act(stage);
        }
    }

    /// A whole line has come; a wrong checksum is met with silence.
    fn request(&mut self, line: &[u8], now: Instant) {
        let Some(text) = line.iter().rposition(|&b| b == b'/').and_then(|s| line.get(s + 1..)) else { return };
        let Ok(text) = std::str::from_utf8(text) else { return };
        let body = match text.split_once(':') {
            None => text,
            Some((body, sum)) if sum == format!("{:02X}", checksum(body)) => body,
            Some(_) => return,
        };
        let request = Request::of(body);
        let numbers: Vec<u8> = match request.device {
            0 => (1..=self.devices.len() as u8).collect(),
            one => vec![one],
        };
        for (order, device) in numbers.into_iter().enumerate() {
            self.serve(device, &request, now + Duration::from_millis(order as u64));
        }
    }

    fn serve(&mut self, device: u8, request: &Request<'_>, now: Instant) {
        let Some(stage) = usize::from(device).checked_sub(1).and_then(|i| self.devices.get_mut(i)) else { return };
        if std::mem::take(&mut self.restart_on_command) {
            return stage.restart(now);
        }
        if stage.axis.update(now) && stage.alert {
            self.outbox.unasked(now, &stage.line('!', &format!("{device:02} 1 IDLE FS")));
        }
        let (accepted, data) = if self.again > 0 {
            self.again -= 1;
            (false, "AGAIN".to_owned())
        } else {
            stage.answer(request, now)
        };
        self.replies += 1;
        let at = now + Duration::from_millis(2 + self.replies % 3);
        let shape = self.shapes.pop_front();
        let lines = stage.reply(device, request, accepted, &data, shape, now);
        self.outbox.reply(at, &lines);
    }
}

impl Firmware for ZaberChainTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if byte == b'\n' || byte == b'\r' {
                let line = std::mem::take(&mut self.line);
                self.request(&line, now);
            } else if self.line.len() < MAX_REQUEST {
                self.line.push(byte);
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
        self.line.clear();
    }
}

// === impl Stage ===

impl Stage {
    fn new(spec: ZaberStage, now: Instant) -> Stage {
        let mut axis = AxisTwin::new(spec.start_deg, now);
        axis.max_speed = f64::from(spec.max_speed);
        axis.approach_speed = f64::from(spec.max_speed);
        axis.accel = f64::from(spec.accel);
        Stage { spec, boot: now, checksum: false, alert: false, axis }
    }

    fn restart(&mut self, now: Instant) {
        self.boot = now;
        self.axis.restart(now);
    }

    /// A line with its checksum (when that is on) and CR LF.
    fn line(&self, kind: char, body: &str) -> Vec<u8> {
        let sum = if self.checksum { format!(":{:02X}", checksum(body)) } else { String::new() };
        format!("{kind}{body}{sum}\r\n").into_bytes()
    }

    /// The whole answer with its shape faults.
    fn reply(
        &self,
        device: u8,
        request: &Request<'_>,
        accepted: bool,
        data: &str,
        shape: Option<ZaberFault>,
        now: Instant,
    ) -> Vec<u8> {
        let id = request.id.map(|id| if shape == Some(ZaberFault::WrongId) { (id + 57) % 100 } else { id });
        let id = id.map_or(String::new(), |id| format!(" {id:02}"));
        let head = format!("{device:02} {}{id}", request.axis);
        let verdict = if accepted { "OK" } else { "RJ" };
        let status = if self.axis.busy(now) { "BUSY" } else { "IDLE" };
        let warning = self.axis.codes(false).into_iter().next().unwrap_or("--".to_owned());
        let body = |data: &str| format!("{head} {verdict} {status} {warning} {data}");
        match shape {
            Some(ZaberFault::WrongLrc) => {
                let body = body(data);
                format!("@{body}:{:02X}\r\n", checksum(&body).wrapping_add(1)).into_bytes()
            }
            Some(ZaberFault::AlertBetween) => {
                [self.line('!', &format!("{device:02} 1 {status} {warning}")), self.line('@', &body(data))].concat()
            }
            Some(ZaberFault::SplitReply) => {
                [self.line('@', &body("\\")), self.line('#', &format!("{head} cont 1 {data}"))].concat()
            }
            _ => self.line('@', &body(data)),
        }
    }

    fn answer(&mut self, request: &Request<'_>, now: Instant) -> Answer {
        if request.axis > 1 {
            return no("BADAXIS");
        }
        match request.words.as_slice() {
            [] => ok("0"),
            ["tools", "echo", text @ ..] => ok(&text.join(" ")),
            ["tools", "parking", "unpark"] => {
                self.axis.parked = false;
                ok("0")
            }
            ["get", name] => self.get(name, now).map_or(no("BADCOMMAND"), |v| ok(&v)),
            ["set", name, value] => self.set(name, value),
            ["driver", "enable"] if self.spec.firmware().0 >= 7 => {
                self.axis.driver_on = true;
                ok("0")
            }
            ["driver", "disable"] if self.spec.firmware().0 >= 7 => {
                self.axis.driver_on = false;
                ok("0")
            }
            ["home"] => self.axis.refuses().map_or_else(
                || {
                    self.axis.home(now);
                    ok("0")
                },
                no,
            ),
            ["move", "abs", n] => self.go(n.parse().ok(), now),
            ["move", "rel", n] => self.go(n.parse::<i64>().ok().map(|n| n + self.axis.counter(now)), now),
            ["stop"] => {
                self.axis.stop(now);
                ok("0")
            }
            ["estop"] => {
                self.axis.track.freeze(now);
                ok("0")
            }
            ["warnings", rest @ ..] => {
                if *rest == ["clear"] {
                    self.axis.latched.clear();
                }
                let codes = self.axis.codes(true);
                ok(format!("{:02} {}", codes.len(), codes.join(" ")).trim_end())
            }
            ["system", "reset"] => {
                self.restart(now);
                ok("0")
            }
            _ => no("BADCOMMAND"),
        }
    }

    fn go(&mut self, steps: Option<i64>, now: Instant) -> Answer {
        if let Some(why) = self.axis.refuses() {
            return no(why);
        }
        match steps.filter(|n| (self.axis.limit_min..=self.axis.limit_max).contains(n)) {
            Some(n) => {
                self.axis.move_to(n, now);
                ok("0")
            }
            None => no("BADDATA"),
        }
    }

    fn get(&self, name: &str, now: Instant) -> Option<String> {
        let (major, minor) = self.spec.firmware();
        let axis = &self.axis;
        let flag = |on: bool| u8::from(on).to_string();
        Some(match name {
            "device.id" if major >= 7 => self.spec.device_id.to_string(),
            "deviceid" if major < 7 => self.spec.device_id.to_string(),
            "version" => self.spec.version.clone(),
            "system.serial" => self.spec.serial.clone(),
            "system.axiscount" | "comm.address" => "1".into(),
            "system.uptime" if (major, minor) >= (7, 34) => {
                now.saturating_duration_since(self.boot).as_secs().to_string()
            }
            "system.temperature" => "31.5".into(),
            "driver.temperature" => "34.2".into(),
            "driver.enabled" if major >= 7 => flag(axis.driver_on),
            "comm.checksum" if (major, minor) >= (6, 14) => flag(self.checksum),
            "comm.alert" => flag(self.alert),
            "comm.packet.size.max" => MAX_REQUEST.to_string(),
            "pos" => axis.counter(now).to_string(),
            "maxspeed" => axis.max_speed.to_string(),
            "accel" => axis.accel.to_string(),
            "limit.approach.maxspeed" => axis.approach_speed.to_string(),
            "limit.min" => axis.limit_min.to_string(),
            "limit.max" => axis.limit_max.to_string(),
            "limit.home.triggered" => flag(axis.track.position(now).abs() < 0.1),
            "limit.home.preset" => "0".into(),
            "limit.cycle.dist" => "1536000".into(),
            "resolution" => "64".into(),
            _ => return None,
        })
    }

    fn set(&mut self, name: &str, value: &str) -> Answer {
        let Ok(number) = value.parse::<u32>() else { return no("BADDATA") };
        match (name, number) {
            ("comm.checksum", 0 | 1) => self.checksum = number == 1,
            ("comm.alert", 0 | 1) => self.alert = number == 1,
            ("maxspeed", 1..=1_000_000) => self.axis.max_speed = f64::from(number),
            ("accel", 0..=32_767) => self.axis.accel = f64::from(number),
            ("limit.approach.maxspeed", 1..=1_000_000) => self.axis.approach_speed = f64::from(number),
            ("comm.checksum" | "comm.alert" | "maxspeed" | "accel" | "limit.approach.maxspeed", _) => {
                return no("BADDATA");
            }
            _ => return no("BADCOMMAND"),
        }
        ok("0")
    }
}

// === impl Request ===

impl<'a> Request<'a> {
    /// Reads `[device [axis [id]]] words`.
    fn of(body: &'a str) -> Request<'a> {
        let mut words: Vec<&str> = body.split_ascii_whitespace().collect();
        let mut number = || {
            let n = words.first().and_then(|w| w.parse::<u8>().ok());
            if n.is_some() || words.first() == Some(&"--") {
                words.remove(0);
            }
            n
        };
        let device = number();
        let axis = device.and_then(|_| number());
        let id = axis.and_then(|_| number());
        Request { device: device.unwrap_or(0), axis: axis.unwrap_or(0), id, words }
    }
}

fn ok(data: &str) -> Answer {
    (true, data.to_owned())
}

fn no(word: &str) -> Answer {
    (false, word.to_owned())
}

/// Number that makes the sum of all bytes zero modulo 256.
fn checksum(body: &str) -> u8 {
    let sum: u32 = body.bytes().map(u32::from).sum();
    ((256 - sum % 256) % 256) as u8
}
