//! One device of a Zaber twin: its requests, settings and answers.
//!
//! Source: the protocol sheet `zaber-ascii`, sections 2 to 6.

use super::zaber::{MAX_REQUEST, ZaberFault, ZaberStage};
use super::zaber_axis::AxisTwin;
use std::collections::BTreeMap;
use tokio::time::Instant;

/// Settings that only remember their value: name, value at power-up, smallest, largest.
#[rustfmt::skip]
const KEPT: [(&str, f64, f64, f64); 20] = [
    ("system.access", 1.0, 1.0, 2.0), ("system.led.enable", 1.0, 0.0, 1.0), ("comm.next.owner", 0.0, 0.0, 99.0), ("comm.timeout", 0.0, 0.0, 65_535.0),
    ("knob.enable", 1.0, 0.0, 1.0), ("knob.mode", 0.0, 0.0, 1.0), ("knob.dir", 0.0, 0.0, 1.0), ("knob.maxspeed", 153_600.0, 1.0, 1e6),
    ("knob.distance", 12_800.0, 1.0, 1e9), ("knob.speedprofile", 1.0, 1.0, 3.0), ("knob.force", 0.0, 0.0, 1.0), ("driver.current.run", 160.0, 0.0, 200.0),
    ("driver.current.hold", 100.0, 0.0, 200.0), ("driver.current.approach", 160.0, 0.0, 200.0), ("driver.dir", 0.0, 0.0, 1.0), ("motion.accelonly", 205.0, 0.0, 32_767.0),
    ("motion.decelonly", 205.0, 0.0, 32_767.0), ("limit.approach.accel", 205.0, 0.0, 32_767.0), ("limit.home.offset", 0.0, 0.0, 1e9), ("user.data.0", 0.0, 0.0, 4e9),
];

/// One device of the chain.
#[derive(Debug)]
pub(super) struct Stage {
    spec: ZaberStage,
    boot: Instant,
    checksum: bool,
    pub alert: bool,
    pub axis: AxisTwin,
    /// When the end of a motion is told unasked.
    pub alert_at: Option<Instant>,
    /// Settings that only remember their value.
    kept: BTreeMap<&'static str, f64>,
}

/// A request as it came: who is meant, which id, which words.
pub(super) struct Request<'a> {
    pub device: u8,
    axis: u8,
    id: Option<u8>,
    words: Vec<&'a str>,
}

/// An answer before it has an address: accepted, data.
pub(super) type Answer = (bool, String);

// === impl Stage ===

impl Stage {
    /// A device powered up at `now`.
    pub fn new(spec: ZaberStage, now: Instant) -> Stage {
        let mut axis = AxisTwin::new(spec.start_deg, now);
        axis.max_speed = f64::from(spec.max_speed);
        axis.approach_speed = f64::from(spec.max_speed);
        axis.accel = f64::from(spec.accel);
        let kept = KEPT.iter().map(|(name, value, ..)| (*name, *value)).collect();
        Stage { spec, boot: now, checksum: false, alert: false, axis, alert_at: None, kept }
    }

    /// Power goes and comes back.
    pub fn restart(&mut self, now: Instant) {
        self.alert_at = None;
        self.boot = now;
        self.axis.restart(now);
    }

    /// A line with its checksum (when that is on) and CR LF.
    pub fn line(&self, kind: char, body: &str) -> Vec<u8> {
        let sum = if self.checksum { format!(":{:02X}", checksum(body)) } else { String::new() };
        format!("{kind}{body}{sum}\r\n").into_bytes()
    }

    /// The code that lines show.
    pub fn top_warning(&self) -> String {
        self.axis.codes(false).into_iter().next().unwrap_or("--".to_owned())
    }

    /// With alerts on, the end of the motion under way will be told.
    pub fn plan_alert(&mut self) {
        self.alert_at = self.axis.end_of_motion().filter(|_| self.alert);
    }

    /// The whole answer with its shape faults.
    pub fn reply(
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
        let warning = self.top_warning();
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

    /// Carries out a request.
    pub fn answer(&mut self, request: &Request<'_>, now: Instant) -> Answer {
        if request.axis > 1 {
            return no("BADAXIS");
        }
        match request.words.as_slice() {
            [] => ok("0"),
            ["tools", "echo", text @ ..] => ok(&text.join(" ")),
            ["tools", "parking", state @ ("park" | "unpark")] => {
                if self.axis.busy(now) {
                    return no("STATUSBUSY");
                }
                self.axis.parked = *state == "park";
                ok("0")
            }
            ["get" | "set", name, ..] if request.axis > 0 && of_device(name) => no("DEVICEONLY"),
            ["get", name] => self.get(name, now).map_or(no("BADCOMMAND"), |v| ok(&v)),
            ["set", name, value] => self.set(name, value, now),
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
            ["move", "min"] => self.go(Some(self.axis.limit_min), now),
            ["move", "max"] => self.go(Some(self.axis.limit_max), now),
            ["move", "vel", n] => self.run(n.parse().ok(), now),
            ["move", "rel", n] => self.go(n.parse::<i64>().ok().map(|n| n + self.axis.counter(now)), now),
            ["stop"] => {
                self.axis.stop(now);
                ok("0")
            }
            ["estop"] => {
                self.axis.estop(now);
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
            ["system", "restore" | "factoryreset"] => {
                self.kept = KEPT.iter().map(|(name, value, ..)| (*name, *value)).collect();
                (self.checksum, self.alert) = (false, false);
                (self.axis.max_speed, self.axis.accel) = (f64::from(self.spec.max_speed), f64::from(self.spec.accel));
                ok("0")
            }
            ["io", "info", ..] => ok("0 0 0 0"),
            ["storage", "get" | "erase", ..] | ["storage", "axis", "get" | "erase", ..] => no("BADDATA"),
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

    /// `move vel`: in the units of `maxspeed`, until a limit; 0 stops.
    fn run(&mut self, speed: Option<f64>, now: Instant) -> Answer {
        match (self.axis.refuses(), speed.filter(|v| v.abs() <= 1e6)) {
            (Some(why), _) => return no(why),
            (None, None) => return no("BADDATA"),
            (None, Some(0.0)) => self.axis.stop(now),
            (None, Some(speed)) => self.axis.run(speed, now),
        }
        ok("0")
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
            "parking.state" => flag(axis.parked),
            "system.voltage" => "24.1".into(),
            "system.current" => "0.31".into(),
            "system.platform" => "655363".into(),
            "device.hw.modified" | "lockstep.numgroups" | "stream.numstreams" | "virtual.numvirtual" => "0".into(),
            "comm.protocol" => "2".into(),
            "comm.rs232.baud" => "115200".into(),
            other => self.kept.get(other)?.to_string(),
        })
    }

    fn set(&mut self, name: &str, value: &str, now: Instant) -> Answer {
        let limit = |text: &str| text.parse::<i64>().ok().filter(|n| n.abs() <= 1_000_000_000);
        match (name, limit(value)) {
            ("limit.min", Some(n)) if n <= self.axis.limit_max => {
                self.axis.limit_min = n;
                return ok("0");
            }
            ("limit.max", Some(n)) if n >= self.axis.limit_min => {
                self.axis.limit_max = n;
                return ok("0");
            }
            ("pos", Some(n)) => {
                self.axis.set_counter(n, now);
                return ok("0");
            }
            _ => {}
        }
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
            ("limit.min" | "limit.max", _) => return no("BADDATA"),
            _ => return self.keep(name, f64::from(number)),
        }
        ok("0")
    }

    /// Settings that only remember their value.
    fn keep(&mut self, name: &str, number: f64) -> Answer {
        let Some((name, _, low, high)) = KEPT.iter().find(|(known, ..)| *known == name) else {
            return no("BADCOMMAND");
        };
        if number < *low || number > *high {
            return no("BADDATA");
        }
        self.kept.insert(name, number);
        ok("0")
    }
}

// === impl Request ===

impl<'a> Request<'a> {
    /// Reads `[device [axis [id]]] words`.
    pub fn of(body: &'a str) -> Request<'a> {
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
pub(super) fn checksum(body: &str) -> u8 {
    let sum: u32 = body.bytes().map(u32::from).sum();
    ((256 - sum % 256) % 256) as u8
}

/// Settings of the device, not of its axis.
fn of_device(name: &str) -> bool {
    name.starts_with("system.") || name.starts_with("comm.") || matches!(name, "device.id" | "deviceid" | "version")
}
