//! Twin of a Zaber daisy chain (ASCII protocol, firmware 6.14 to 7.x): integrated rotary stages with one axis each.
//!
//! Source: the protocol sheet `zaber-ascii`, sections 1 to 9. Written from the device's side with a codec of its own.

use super::Firmware;
use super::outbox::{Outbox, WireFault};
use super::zaber_request::{Continued, Request, body};
use super::zaber_stage::Stage;
use std::collections::VecDeque;
use std::time::Duration;
use tokio::time::Instant;

/// Longest request taken.
pub(super) const MAX_REQUEST: usize = 80;
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
    continued: Continued,
    shapes: VecDeque<ZaberFault>,
    again: u8,
    restart_on_command: bool,
    replies: u64,
    /// When the last reply leaves; the chain answers a broadcast in its order.
    last_reply: Instant,
}

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
    pub(super) fn firmware(&self) -> (u32, u32) {
        let mut parts = self.version.split('.').map(|p| p.parse().unwrap_or(0));
        (parts.next().unwrap_or(0), parts.next().unwrap_or(0))
    }
}

// === impl ZaberChainTwin ===

impl ZaberChainTwin {
    /// A chain powered up at `now`; the first stage is device 1.
    pub fn new(stages: Vec<ZaberStage>, now: Instant) -> ZaberChainTwin {
        let devices = stages.into_iter().zip(1..=99).map(|(spec, address)| Stage::new(spec, address, now)).collect();
        ZaberChainTwin {
            devices,
            outbox: Outbox::default(),
            line: Vec::new(),
            continued: Continued::default(),
            shapes: VecDeque::new(),
            again: 0,
            restart_on_command: false,
            replies: 0,
            last_reply: now,
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
        let Some(whole) = body(line).and_then(|body| self.continued.take(body)) else { return };
        let request = Request::of(&whole);
        let meant = |stage: &Stage| request.device == 0 || request.device == stage.address;
        let places: Vec<usize> = (0..self.devices.len()).filter(|&n| self.devices.get(n).is_some_and(meant)).collect();
        for (order, place) in places.into_iter().enumerate() {
            let at = now + Duration::from_millis(order as u64);
            if let (0, ["renumber", rest @ ..]) = (request.axis, request.words.as_slice())
                && let Some(stage) = self.devices.get_mut(place)
            {
                let first: u8 = rest.first().and_then(|n| n.parse().ok()).unwrap_or(1);
                stage.address = first.saturating_add(order as u8).clamp(1, 99);
            }
            self.serve(place, &request, at);
        }
    }

    fn serve(&mut self, place: usize, request: &Request<'_>, now: Instant) {
        let Some(stage) = self.devices.get_mut(place) else { return };
        let device = stage.address;
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
        let at = (now + Duration::from_millis(2 + self.replies % 3)).max(self.last_reply);
        self.last_reply = at;
        stage.plan_alert();
        let shape = self.shapes.pop_front();
        let lines = stage.reply(device, request, accepted, &data, shape, now);
        self.outbox.reply(at, &lines);
    }
}

impl Firmware for ZaberChainTwin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        for &byte in bytes {
            if byte == b'\n' || byte == b'\r' {
                // A line that is too long is lost.
                let line = std::mem::take(&mut self.line);
                if line.len() <= MAX_REQUEST {
                    self.request(&line, now);
                }
            } else if self.line.len() <= MAX_REQUEST {
                self.line.push(byte);
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        self.devices.iter().filter_map(|s| s.alert_at).chain(self.outbox.due()).min()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        for stage in &mut self.devices {
            if stage.alert_at.take_if(|at| *at <= now).is_some() {
                stage.axis.update(now);
                let text = format!("{:02} 1 IDLE {}", stage.address, stage.top_warning());
                self.outbox.unasked(now, &stage.line('!', &text));
            }
        }
        self.outbox.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.outbox.clear();
        self.line.clear();
        self.continued.clear();
    }
}
