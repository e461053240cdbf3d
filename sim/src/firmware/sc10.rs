//! Twin of the Thorlabs SC10 shutter controller with a head whose blade travels and is sensed.
//!
//! Source: the protocol sheet `thorlabs-sc10-shutter`.

use super::Firmware;
use super::motion::Track;
use super::outbox::WireFault;
use super::prompt::PromptPort;
use std::time::Duration;
use tokio::time::Instant;

/// Time until a request is answered: a short reply at 9600 baud.
const ANSWER: Duration = Duration::from_millis(8);
/// Blade travel per second (1 = the whole way): 10 ms.
const BLADE_SPEED: f64 = 100.0;

/// Faults of the shutter.
#[derive(Debug, Clone, PartialEq)]
pub enum ShutterFault {
    /// A fault of the wire, at the next reply.
    Wire(WireFault),
    /// The next request is not echoed.
    EchoLost,
    /// The next toggle is carried out, but its prompt does not come.
    PromptLostAfterToggle,
    /// The blade is stuck where it is (true) or freed.
    Stuck(bool),
    /// The sensor says open, whatever the blade does.
    SensorDead(bool),
    /// The interlock trips (true) or is restored; enable is dropped.
    Interlock(bool),
    /// Somebody presses the enable key.
    FrontKey,
    /// Somebody leaves this mode.
    Mode(u8),
    /// The next request is swallowed whole.
    FirstSwallowed,
    /// The controller restarts now.
    Restart,
    /// The next request makes it restart without an answer.
    RestartOnCommand,
}

/// A shutter controller and its head.
#[derive(Debug)]
pub struct Sc10Twin {
    port: PromptPort,
    /// 0 closed, 1 open.
    blade: Track,
    enabled: bool,
    mode: u8,
    repeats: u8,
    open_ms: u32,
    shut_ms: u32,
    trig: u8,
    xto: u8,
    baud: u8,
    /// The host set a mode that opens and closes by itself.
    timed: bool,
    /// When it next opens (true) or closes by itself, and how many openings are left.
    next: Option<(Instant, bool)>,
    left: u32,
    interlock: bool,
    stuck: bool,
    sensor_dead: bool,
    prompt_lost: bool,
    swallow: bool,
    restart_on_command: bool,
}

// === impl Sc10Twin ===

impl Sc10Twin {
    /// A controller powered up at `now`: closed, manual mode.
    pub fn new(now: Instant) -> Sc10Twin {
        Sc10Twin {
            port: PromptPort::new(ANSWER),
            blade: Track::at_rest(0.0, now),
            enabled: false,
            mode: 1,
            repeats: 1,
            open_ms: 100,
            shut_ms: 100,
            trig: 0,
            xto: 0,
            baud: 0,
            timed: false,
            next: None,
            left: 0,
            interlock: false,
            stuck: false,
            sensor_dead: false,
            prompt_lost: false,
            swallow: false,
            restart_on_command: false,
        }
    }

    /// True when light passes at `at`.
    pub fn light_passes(&self, at: Instant) -> bool {
        self.blade.position(at) >= 0.5
    }

    /// Lets a fault happen, now or at the next occasion.
    pub fn inject(&mut self, fault: ShutterFault, now: Instant) {
        self.advance(now);
        match fault {
            ShutterFault::Wire(fault) => self.port.inject(fault),
            ShutterFault::EchoLost => self.port.mute_echo = true,
            ShutterFault::PromptLostAfterToggle => self.prompt_lost = true,
            ShutterFault::Stuck(stuck) => {
                self.stuck = stuck;
                self.follow(now);
            }
            ShutterFault::SensorDead(dead) => self.sensor_dead = dead,
            ShutterFault::Interlock(tripped) => {
                self.interlock = tripped;
                self.enabled &= !tripped;
                self.follow(now);
            }
            ShutterFault::FrontKey => self.toggle(now),
            ShutterFault::Mode(mode) => self.mode = mode,
            ShutterFault::FirstSwallowed => self.swallow = true,
            ShutterFault::Restart => self.restart(now),
            ShutterFault::RestartOnCommand => self.restart_on_command = true,
        }
    }

    /// True while an injected fault waits for its occasion.
    pub fn faults_wait(&self) -> bool {
        self.port.faults_wait() || self.prompt_lost || self.swallow || self.restart_on_command
    }

    fn toggle(&mut self, now: Instant) {
        self.enabled = !self.enabled && !self.interlock;
        self.follow(now);
    }

    /// The blade follows enable, in the modes auto, single and repeat by the times that are set. Those of an external
    /// trigger or gate wait for it here for ever: nothing is plugged in.
    fn follow(&mut self, now: Instant) {
        self.next = None;
        if !self.timed || !self.enabled {
            return self.blade_to(self.enabled, now);
        }
        let waits = self.trig == 1 || self.mode == 5;
        self.left = match self.mode {
            2 => u32::MAX,
            3 => 1,
            _ => u32::from(self.repeats),
        };
        self.blade_to(!waits, now);
        self.next = Some((now + self.time(self.open_ms), false)).filter(|_| !waits);
    }

    /// Moves the blade, unless it is stuck.
    fn blade_to(&mut self, open: bool, at: Instant) {
        if !self.stuck {
            self.blade.go(at, f64::from(u8::from(open)), BLADE_SPEED, 0.0);
        }
    }

    fn time(&self, ms: u32) -> Duration {
        Duration::from_millis(u64::from(ms.max(1)))
    }

    /// Lets the openings and closings happen that were due.
    fn advance(&mut self, now: Instant) {
        while let Some((at, open)) = self.next.take_if(|(at, _)| *at <= now) {
            self.blade_to(open, at);
            if open {
                self.next = Some((at + self.time(self.open_ms), false));
                continue;
            }
            self.left = self.left.saturating_sub(u32::from(self.mode != 2));
            if self.left > 0 {
                self.next = Some((at + self.time(self.shut_ms), true));
            } else {
                self.enabled = false;
            }
        }
    }

    fn restart(&mut self, now: Instant) {
        self.enabled = false;
        self.mode = 1;
        self.timed = false;
        self.follow(now);
        self.port.reset();
        self.port.unasked(b"\0> ", now);
    }

    fn request(&mut self, line: &str, now: Instant) {
        if std::mem::take(&mut self.swallow) {
            return self.port.silence();
        }
        if std::mem::take(&mut self.restart_on_command) {
            return self.restart(now);
        }
        match line {
            "id?" | "*idn?" => self.port.value("THORLABS SC10 VERSION 1.07", now),
            "ens?" => self.port.value(u8::from(self.enabled), now),
            "mode?" => self.port.value(self.mode, now),
            "rep?" => self.port.value(self.repeats, now),
            "open?" => self.port.value(self.open_ms, now),
            "shut?" => self.port.value(self.shut_ms, now),
            "trig?" => self.port.value(self.trig, now),
            "xto?" => self.port.value(self.xto, now),
            "baud?" => self.port.value(self.baud, now),
            // Nothing is stored: a restart brings the factory's settings.
            "save" | "savp" | "resp" => self.port.done(now),
            "default" => {
                (self.mode, self.repeats, self.open_ms, self.shut_ms, self.trig, self.xto) = (1, 1, 100, 100, 0, 0);
                self.set_timed(now);
                self.port.done(now);
            }
            "interlock?" => self.port.value(u8::from(self.interlock), now),
            "closed?" => {
                let closed = !self.sensor_dead && !self.light_passes(now);
                self.port.value(u8::from(closed), now);
            }
            "ens" => {
                self.toggle(now);
                if std::mem::take(&mut self.prompt_lost) { self.port.silence() } else { self.port.done(now) }
            }
            _ => self.assign(line, now),
        }
    }

    /// The host chose a mode: from now on the blade goes by it.
    fn set_timed(&mut self, now: Instant) {
        let before = std::mem::replace(&mut self.timed, self.mode != 1);
        if before || self.timed {
            self.follow(now);
        }
    }

    fn assign(&mut self, line: &str, now: Instant) {
        let Some((name, value)) = line.split_once('=') else { return self.port.error("CMD_NOT_DEFINED", now) };
        match (name, value.parse::<u32>().unwrap_or(u32::MAX)) {
            ("mode", v @ 1..=5) => {
                self.mode = v as u8;
                self.set_timed(now);
            }
            // Not in the manual's page, but a public client enables so.
            ("ens", v @ (0 | 1)) if self.enabled == (v == 1) => {}
            ("ens", 0 | 1) => self.toggle(now),
            ("rep", v @ 1..=99) => self.repeats = v as u8,
            ("open", v @ 0..=999_999) => self.open_ms = v,
            ("shut", v @ 0..=999_999) => self.shut_ms = v,
            ("trig", v @ (0 | 1)) => self.trig = v as u8,
            ("xto", v @ (0 | 1)) => self.xto = v as u8,
            ("baud", v @ (0 | 1)) => self.baud = v as u8,
            ("ens" | "mode" | "rep" | "open" | "shut" | "trig" | "xto" | "baud", _) => {
                return self.port.error("CMD_ARG_INVALID", now);
            }
            _ => return self.port.error("CMD_NOT_DEFINED", now),
        }
        self.port.done(now);
    }
}

impl Firmware for Sc10Twin {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        self.advance(now);
        for &byte in bytes {
            if let Some(line) = self.port.byte(byte, now) {
                self.request(&line, now);
            }
        }
    }

    fn due(&self) -> Option<Instant> {
        [self.port.due(), self.next.map(|(at, _)| at)].into_iter().flatten().min()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        self.advance(now);
        self.port.take(now)
    }

    fn connected(&mut self, _now: Instant) {
        self.port.reset();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn ms(n: u64) -> Duration {
        Duration::from_millis(n)
    }

    /// Sends a request at `at` and gives the answer without echo and prompt.
    fn ask(twin: &mut Sc10Twin, request: &str, at: Instant) -> String {
        twin.receive(format!("{request}\r").as_bytes(), at);
        let answer = String::from_utf8(twin.take(at + ANSWER)).unwrap();
        answer.strip_prefix(&format!("{request}\r")).unwrap().trim_end_matches("> ").trim_end().to_owned()
    }

    #[tokio::test(start_paused = true)]
    async fn the_repeat_mode_opens_so_many_times_and_disables_itself() {
        let t0 = Instant::now();
        let mut twin = Sc10Twin::new(t0);
        for request in ["mode=4", "rep=2", "open=100", "shut=50", "ens"] {
            assert_eq!(ask(&mut twin, request, t0), "", "{request}");
        }
        for (at, closed, enabled) in
            [(50, "0", "1"), (130, "1", "1"), (200, "0", "1"), (290, "1", "0"), (900, "1", "0")]
        {
            let at = t0 + ms(at);
            assert_eq!((ask(&mut twin, "closed?", at), ask(&mut twin, "ens?", at)), (closed.into(), enabled.into()));
        }
        assert!(twin.light_passes(t0 + ms(50)) && !twin.light_passes(t0 + ms(130)), "the past stays");
    }

    #[tokio::test(start_paused = true)]
    async fn auto_goes_on_until_disabled_and_an_external_trigger_never_comes() {
        let t0 = Instant::now();
        let mut twin = Sc10Twin::new(t0);
        ask(&mut twin, "mode=2", t0);
        ask(&mut twin, "ens=1", t0);
        for n in [0, 2, 40, 4000] {
            assert_eq!(ask(&mut twin, "closed?", t0 + ms(n * 100 + 50)), "0", "opening {n}");
            assert_eq!(ask(&mut twin, "closed?", t0 + ms(n * 100 + 150)), "1", "closing {n}");
        }
        let later = t0 + ms(500_000);
        assert_eq!(ask(&mut twin, "ens=0", later), "");
        assert_eq!(ask(&mut twin, "closed?", later + ms(20)), "1");
        ask(&mut twin, "mode=5", later);
        ask(&mut twin, "ens", later + ms(30));
        assert_eq!(ask(&mut twin, "closed?", later + ms(90)), "1");
        ask(&mut twin, "mode=1", later + ms(100));
        assert_eq!(ask(&mut twin, "closed?", later + ms(150)), "0", "enabled and manual is open");
        assert_eq!(ask(&mut twin, "ens=2", later), "Command error CMD_ARG_INVALID");
    }
}
