//! One device of a Zaber twin: its requests, settings and answers.
//!
//! Source: the protocol sheet `zaber-ascii`, sections 2 to 6.

use super::zaber::{MAX_REQUEST, ZaberFault, ZaberStage};
use super::zaber_axis::AxisTwin;
use super::zaber_request::{Request, checksum};
use std::collections::BTreeMap;
use tokio::time::Instant;

/// Settings that only remember their value: name, value at power-up, smallest, largest.
#[rustfmt::skip]
const KEPT: [(&str, f64, f64, f64); 26] = [
    ("system.access", 1.0, 1.0, 2.0), ("system.led.enable", 1.0, 0.0, 1.0), ("comm.next.owner", 0.0, 0.0, 99.0), ("comm.timeout", 0.0, 0.0, 65_535.0),
    ("knob.enable", 1.0, 0.0, 1.0), ("knob.mode", 0.0, 0.0, 1.0), ("knob.dir", 0.0, 0.0, 1.0), ("knob.maxspeed", 153_600.0, 1.0, 1e6),
    ("knob.distance", 12_800.0, 1.0, 1e9), ("knob.speedprofile", 1.0, 1.0, 3.0), ("knob.force", 0.0, 0.0, 1.0), ("driver.current.run", 160.0, 0.0, 200.0),
    ("driver.current.hold", 100.0, 0.0, 200.0), ("driver.current.approach", 160.0, 0.0, 200.0), ("driver.dir", 0.0, 0.0, 1.0), ("motion.accelonly", 205.0, 0.0, 32_767.0),
    ("motion.decelonly", 205.0, 0.0, 32_767.0), ("limit.approach.accel", 205.0, 0.0, 32_767.0), ("limit.home.offset", 0.0, 0.0, 1e9), ("user.data.0", 0.0, 0.0, 4e9),
    ("motion.index.dist", 128_000.0, 1.0, 1e9), ("motion.index.num", 0.0, 0.0, 1e6), ("motion.accel.ramptime", 0.0, 0.0, 1e3),
    ("limit.detect.decelonly", 205.0, 0.0, 32_767.0), ("limit.detect.maxspeed", 153_600.0, 1.0, 1e6), ("limit.hardstop.retraction", 0.0, 0.0, 1e9),
];
/// Largest message id.
const MAX_ID: u8 = 99;
/// Texts that a device keeps.
const MAX_TEXTS: usize = 256;

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
    /// Number on the chain.
    pub address: u8,
    /// Positions that `tools storepos` remembers, by number.
    stored: BTreeMap<u8, i64>,
    /// Texts that hosts keep in the device, by scope and key.
    storage: BTreeMap<String, String>,
}

/// An answer before it has an address: accepted, data.
pub(super) type Answer = (bool, String);

// === impl Stage ===

impl Stage {
    /// A device powered up at `now` with this number on the chain.
    pub fn new(spec: ZaberStage, address: u8, now: Instant) -> Stage {
        let mut axis = AxisTwin::new(spec.start_deg, now);
        axis.max_speed = f64::from(spec.max_speed);
        axis.approach_speed = f64::from(spec.max_speed);
        axis.accel = f64::from(spec.accel);
        let kept = KEPT.iter().map(|(name, value, ..)| (*name, *value)).collect();
        let (stored, storage) = Default::default();
        Stage { spec, boot: now, checksum: false, alert: false, axis, alert_at: None, kept, address, stored, storage }
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
        if request.id.is_some_and(|id| id > MAX_ID) {
            return no("BADMESSAGEID");
        }
        match request.words.as_slice() {
            [] => ok("0"),
            ["tools", "echo"] | ["help", ..] => ok("0"),
            ["tools", "echo", text @ ..] => ok(&text.join(" ")),
            ["tools", "storepos", place, rest @ ..] => self.store_position(place, rest, now),
            ["storage", rest @ ..] => self.store_text(request.axis, rest),
            ["tools", "parking", state @ ("park" | "unpark")] => {
                if self.axis.busy(now) {
                    return no("STATUSBUSY");
                }
                self.axis.parked = *state == "park";
                ok("0")
            }
            ["get" | "set", name, ..] if request.axis > 0 && of_device(name) => no("DEVICEONLY"),
            ["renumber" | "system", ..] if request.axis > 0 => no("DEVICEONLY"),
            ["get", names @ ..] if !names.is_empty() => {
                let values: Option<Vec<String>> = names.iter().map(|name| self.get(name, now)).collect();
                values.map_or(no("BADCOMMAND"), |values| ok(&values.join("; ")))
            }
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
            ["move", words @ ..] => self.travel(words, now),
            // The chain has given the new number before the reply.
            ["renumber", ..] => ok("0"),
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
            ["system", word] => self.system(word, now),
            ["io", "info", ..] => ok("0 0 0 0"),
            _ => no("BADCOMMAND"),
        }
    }

    fn system(&mut self, word: &str, now: Instant) -> Answer {
        match word {
            "reset" => self.restart(now),
            "restore" | "factoryreset" => {
                self.kept = KEPT.iter().map(|(name, value, ..)| (*name, *value)).collect();
                (self.checksum, self.alert) = (false, false);
                (self.axis.max_speed, self.axis.accel) = (f64::from(self.spec.max_speed), f64::from(self.spec.accel));
            }
            _ => return no("BADCOMMAND"),
        }
        ok("0")
    }

    /// `move`: where to, then speed and acceleration for this move alone (firmware 7.25 on).
    fn travel(&mut self, words: &[&str], now: Instant) -> Answer {
        let (minimum, maximum) = (self.axis.limit_min, self.axis.limit_max);
        let here = self.axis.counter(now);
        let whole = |text: &&str| text.parse::<i64>().ok();
        let index = self.kept.get("motion.index.dist").map_or(0, |d| *d as i64);
        let (target, rest) = match words {
            ["min", rest @ ..] => (Some(minimum), rest),
            ["max", rest @ ..] => (Some(maximum), rest),
            ["abs", n, rest @ ..] => (whole(n), rest),
            ["rel", n, rest @ ..] => (whole(n).and_then(|n| n.checked_add(here)), rest),
            ["index", n, rest @ ..] => (whole(n).and_then(|n| n.checked_sub(1)?.checked_mul(index)), rest),
            ["stored", n, rest @ ..] => (n.parse().ok().and_then(|n: u8| self.stored.get(&n).copied()), rest),
            ["vel", n, rest @ ..] => return self.run(n.parse().ok(), rest, now),
            _ => return no("BADCOMMAND"),
        };
        let numbers: Option<Vec<f64>> = rest.iter().map(|text| text.parse().ok()).collect();
        let (speed, accel) = match numbers.as_deref() {
            Some([]) => (self.axis.max_speed, self.axis.accel),
            Some([speed]) => (*speed, self.axis.accel),
            Some([speed, accel]) => (*speed, *accel),
            Some(_) => return no("BADCOMMAND"),
            None => return no("BADDATA"),
        };
        if !rest.is_empty() && self.spec.firmware() < (7, 25) {
            return no("BADCOMMAND");
        }
        if let Some(why) = self.axis.refuses() {
            return no(why);
        }
        match target.filter(|n| (minimum..=maximum).contains(n)) {
            Some(n) if (1.0..=1e6).contains(&speed) && (0.0..=32_767.0).contains(&accel) => {
                self.axis.move_to(n, (speed, accel), now);
                ok("0")
            }
            _ => no("BADDATA"),
        }
    }

    /// `move vel`: in the units of `maxspeed`, until a limit; 0 stops.
    fn run(&mut self, speed: Option<f64>, accel: &[&str], now: Instant) -> Answer {
        let accel = accel.first().map_or(Some(self.axis.accel), |text| text.parse().ok());
        match (self.axis.refuses(), speed.filter(|v| v.abs() <= 1e6), accel.filter(|a| (0.0..=32_767.0).contains(a))) {
            (Some(why), ..) => return no(why),
            (None, Some(0.0), Some(_)) => self.axis.stop(now),
            (None, Some(speed), Some(accel)) => self.axis.run(speed, accel, now),
            _ => return no("BADDATA"),
        }
        ok("0")
    }

    /// `tools storepos n`: tells the position under this number; `current` or a number sets it.
    fn store_position(&mut self, place: &str, rest: &[&str], now: Instant) -> Answer {
        let Some(place) = place.parse().ok().filter(|n: &u8| (1..=16).contains(n)) else { return no("BADDATA") };
        let position = match rest {
            [] => return ok(&self.stored.get(&place).copied().unwrap_or(0).to_string()),
            ["current"] => Some(self.axis.counter(now)),
            [n] => n.parse().ok(),
            _ => None,
        };
        match position.filter(|n| (self.axis.limit_min..=self.axis.limit_max).contains(n)) {
            Some(position) => {
                self.stored.insert(place, position);
                ok("0")
            }
            None => no("BADDATA"),
        }
    }

    /// `storage [axis] set|append|get|exists|erase key [text]`.
    fn store_text(&mut self, axis: u8, words: &[&str]) -> Answer {
        let (scope, words) = match words {
            ["axis", rest @ ..] => (1, rest),
            words => (axis, words),
        };
        let [verb, key, text @ ..] = words else { return no("BADCOMMAND") };
        let key = format!("{scope} {key}");
        match (*verb, text) {
            ("set", [_, ..]) if self.storage.len() >= MAX_TEXTS && !self.storage.contains_key(&key) => {
                return no("FULL");
            }
            ("set", [_, ..]) => drop(self.storage.insert(key, text.join(" "))),
            ("append", [_, ..]) => match self.storage.get_mut(&key) {
                Some(kept) => *kept = format!("{kept} {}", text.join(" ")),
                None => return no("BADDATA"),
            },
            ("exists", []) => return ok(if self.storage.contains_key(&key) { "1" } else { "0" }),
            ("get", []) => return self.storage.get(&key).map_or(no("BADDATA"), |text| ok(text)),
            ("erase", []) if self.storage.remove(&key).is_none() => return no("BADDATA"),
            ("erase", []) => {}
            _ => return no("BADCOMMAND"),
        }
        ok("0")
    }

    fn get(&self, name: &str, now: Instant) -> Option<String> {
        let (major, minor) = self.spec.firmware();
        let axis = &self.axis;
        let flag = |on: bool| u8::from(on).to_string();
        Some(match name {
            "device.id" if major >= 7 => self.spec.device_id.to_string(),
            // Firmware 7 still knows the older name: the vendor's library asks by it.
            "deviceid" => self.spec.device_id.to_string(),
            "version" => self.spec.version.clone(),
            "system.serial" => self.spec.serial.clone(),
            "system.axiscount" => "1".into(),
            "comm.address" => self.address.to_string(),
            "version.build" => "1".into(),
            "vel" => format!("{:.0}", axis.speed(now)),
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
            ("comm.address", Some(n @ 1..=99)) => {
                self.address = n as u8;
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
            ("limit.min" | "limit.max" | "comm.address", _) => return no("BADDATA"),
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

fn ok(data: &str) -> Answer {
    (true, data.to_owned())
}

fn no(word: &str) -> Answer {
    (false, word.to_owned())
}

/// Settings of the device, not of its axis.
fn of_device(name: &str) -> bool {
    name.starts_with("system.") || name.starts_with("comm.") || matches!(name, "device.id" | "deviceid" | "version")
}
