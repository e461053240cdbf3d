//! The safe checks: they may run on the real device, with somebody beside it.

use super::{
    COMMANDS, Check, DROPPED, Finding, HEALTH, IDENTITY, LIMITS, REFUSALS, SAFE_STATE, STATE, Subject, Value, Verdict,
};
use crate::clock::Clock;
use crate::error::{ErrorKind, Result};
use std::future::Future;
use std::time::Duration;

/// Longest time any call may take. Every call has a deadline of its own; this is where a check gives it up.
pub const PATIENCE: Duration = Duration::from_secs(300);
/// When calls are dropped on their way.
const DROPS: [Duration; 4] =
    [Duration::from_millis(2), Duration::from_millis(30), Duration::from_millis(150), Duration::from_millis(400)];
/// Rest after a dropped call, for the move that it began.
const REST: Duration = Duration::from_secs(2);
/// Tries of an order after a call was dropped.
const TRIES: u32 = 3;

/// A check's course: what was seen, or where it failed.
type Course = std::result::Result<String, String>;

/// The hand that calls a device: every call under [`PATIENCE`], every failure with the words of what was called.
struct Hand<'a> {
    subject: &'a mut Subject,
    clock: Clock,
}

/// Carries all safe checks out, one after the other; `report` hears of each as it ends. The device is opened, moved within
/// its limits, brought back to where it stood, and made safe.
pub async fn check(subject: &mut Subject, clock: Clock, report: &mut dyn FnMut(&Finding)) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut add = |check: Check, verdict: Verdict| {
        let finding = Finding { check, verdict };
        report(&finding);
        let failed = finding.verdict.failed();
        findings.push(finding);
        failed
    };
    let mut hand = Hand { subject, clock };
    if add(IDENTITY, Verdict::of(hand.identity().await)) {
        let rest = [HEALTH, LIMITS, REFUSALS, STATE, COMMANDS, DROPPED, SAFE_STATE];
        let why = "the device was not opened";
        for check in rest {
            add(check, Verdict::NotApplicable(why.into()));
        }
        return findings;
    }
    add(HEALTH, Verdict::of(hand.health().await));
    add(LIMITS, hand.limits());
    add(REFUSALS, hand.refusals().await);
    add(STATE, Verdict::of(hand.state().await));
    add(COMMANDS, Verdict::of(hand.commands().await));
    add(DROPPED, Verdict::of(hand.dropped().await));
    add(SAFE_STATE, Verdict::of(hand.safe_state().await));
    findings
}

// === impl Hand ===

impl Hand<'_> {
    async fn call<T>(
        clock: Clock,
        what: &str,
        call: impl Future<Output = Result<T>>,
    ) -> std::result::Result<T, String> {
        match clock.timeout(PATIENCE, call).await {
            Ok(result) => result.map_err(|e| format!("{what}: {e}")),
            Err(_) => Err(format!("{what} did not end within {} s: it has no deadline of its own", PATIENCE.as_secs())),
        }
    }

    async fn identity(&mut self) -> Course {
        let first = Self::call(self.clock, "opening", self.subject.device().open()).await?;
        if first.model.trim().is_empty() {
            return Err("it gives no model".into());
        }
        let again = Self::call(self.clock, "opening again", self.subject.device().open()).await?;
        if first != again {
            return Err(format!("it was {first:?} and is {again:?} when opened again"));
        }
        let serial = if first.serial.is_empty() { String::new() } else { format!(", serial {}", first.serial) };
        let firmware = if first.firmware.is_empty() { String::new() } else { format!(", firmware {}", first.firmware) };
        Ok(format!("{}{serial}{firmware}", first.model))
    }

    async fn health(&mut self) -> Course {
        let mut health = Self::call(self.clock, "asking its health", self.subject.device().health()).await?;
        health = Self::call(self.clock, "asking its health again", self.subject.device().health())
            .await
            .or(Err(format!("it was well ({:?}) and does not answer when asked again", health.warnings)))?;
        Ok(if health.warnings.is_empty() { "well".into() } else { format!("says: {}", health.warnings.join(", ")) })
    }

    fn limits(&self) -> Verdict {
        let ordered = |low: f64, high: f64, unit: &str| {
            let fine = low.is_finite() && high.is_finite() && low < high;
            let text = format!("{low} to {high} {unit}");
            if fine { Verdict::Passed(text) } else { Verdict::Failed(text) }
        };
        match &*self.subject {
            Subject::Axis(axis) => {
                let ((low, high), (speed, acceleration)) = (axis.limits(), axis.speed());
                if speed.0.is_finite() && speed.0 > 0.0 && acceleration.is_finite() && acceleration >= 0.0 {
                    return ordered(low.0, high.0, "degrees");
                }
                Verdict::Failed(format!("speed {} and acceleration {acceleration} cannot be", speed.0))
            }
            Subject::Wheel(wheel) => match wheel.slots() {
                0 => Verdict::Failed("a wheel of no places".into()),
                n => Verdict::Passed(format!("1 to {n}")),
            },
            Subject::Monochromator(m) => ordered(m.limits().0.0, m.limits().1.0, "nm"),
            Subject::Spectrometer(s) => ordered(s.limits().0.seconds(), s.limits().1.seconds(), "s"),
            Subject::Camera(camera) => {
                let info = camera.info();
                if info.width == 0 || info.height == 0 {
                    return Verdict::Failed(format!("pictures of {} x {} pixels", info.width, info.height));
                }
                ordered(info.shortest.seconds(), info.longest.seconds(), "s")
            }
            Subject::Shutter(_) => Verdict::NotApplicable("open and closed are all it has".into()),
            Subject::LightMonitor(_) => Verdict::NotApplicable("the contract has no limits for this kind".into()),
        }
    }

    async fn refusals(&mut self) -> Verdict {
        let forbidden = self.subject.forbidden();
        if forbidden.is_empty() {
            return Verdict::NotApplicable("every order of its contract is allowed".into());
        }
        Verdict::of(self.refuse(forbidden).await)
    }

    async fn refuse(&mut self, forbidden: Vec<Value>) -> Course {
        // What measures cannot be compared before and after.
        let before = if self.subject.moves() { self.ask().await? } else { None };
        for order in &forbidden {
            match self.clock.timeout(PATIENCE, self.subject.carry_out(order)).await {
                Ok(Err(error)) if error.kind == ErrorKind::Refused => {}
                Ok(Err(error)) => return Err(format!("{order} was not refused but sent: {error}")),
                Ok(Ok(said)) => return Err(format!("{order} was carried out: it says {said}")),
                Err(_) => return Err(format!("{order} was not refused")),
            }
        }
        let after = if self.subject.moves() { self.ask().await? } else { None };
        match (&before, &after) {
            (Some(before), Some(after)) if !before.met_by(after) => {
                Err(format!("it stood at {before} and stands at {after} after what it refused"))
            }
            _ => Ok(format!("{} refused", forbidden.len())),
        }
    }

    async fn ask(&mut self) -> std::result::Result<Option<Value>, String> {
        // What was never ordered is unknown: a camera without settings says so by refusing.
        match self.clock.timeout(PATIENCE, self.subject.state()).await {
            Ok(Err(error)) if error.kind == ErrorKind::Refused => Ok(None),
            Ok(result) => result.map_err(|e| format!("asking its state: {e}")),
            Err(_) => Err(format!("asking its state did not end within {} s", PATIENCE.as_secs())),
        }
    }

    async fn state(&mut self) -> Course {
        Ok(match self.ask().await? {
            Some(value) => value.to_string(),
            None => "unknown, and it says so".into(),
        })
    }

    async fn commands(&mut self) -> Course {
        let stood = self.ask().await?;
        if stood.is_none() {
            Self::call(self.clock, "finding the reference", self.subject.reference()).await?;
        }
        let mut orders = self.subject.orders();
        // A device that moves comes back to where it stood, where that is a place it may be sent to.
        orders.extend(stood.filter(|v| self.subject.moves() && !matches!(v, Value::Wavelength(_))));
        for order in &orders {
            self.order(order).await?;
        }
        if let Subject::Axis(axis) = &mut *self.subject {
            Self::call(self.clock, "stopping", axis.stop()).await?;
        }
        Ok(format!("{} orders", orders.len()))
    }

    /// One order, and the question whether it holds.
    async fn order(&mut self, order: &Value) -> std::result::Result<(), String> {
        let what = format!("the order {order}");
        let said = Self::call(self.clock, &what, self.subject.carry_out(order)).await?;
        if !order.met_by(&said) {
            return Err(format!("{what} ended at {said}"));
        }
        match Self::call(self.clock, "asking afterwards", self.subject.state()).await? {
            Some(now) if order.met_by(&now) => Ok(()),
            Some(now) => Err(format!("{what} ended at {said}, and when asked it says {now}")),
            None => Err(format!("{what} ended at {said}, and when asked it does not know")),
        }
    }

    async fn dropped(&mut self) -> Course {
        let orders = self.subject.orders();
        for (drop_after, order) in DROPS.into_iter().zip(orders.iter().cycle()) {
            let given_up = self.clock.timeout(drop_after, self.subject.carry_out(order)).await.is_err();
            let asked = self.clock.timeout(drop_after, self.subject.state()).await.is_err();
            if given_up || asked {
                self.clock.sleep(REST).await;
            }
            let mut ended = self.order(order).await;
            for _ in 1..TRIES {
                if ended.is_err() {
                    Self::call(self.clock, "opening after a dropped call", self.subject.device().open()).await?;
                    ended = self.order(order).await;
                }
            }
            ended.map_err(|e| format!("after a call dropped at {} ms: {e}", drop_after.as_millis()))?;
        }
        Ok(format!("{} calls given up", 2 * DROPS.len()))
    }

    async fn safe_state(&mut self) -> Course {
        Self::call(self.clock, "making it safe", self.subject.device().make_safe()).await?;
        Self::call(self.clock, "making it safe again", self.subject.device().make_safe()).await?;
        let now = Self::call(self.clock, "asking its health afterwards", self.subject.device().health()).await;
        if now.is_err() {
            Self::call(self.clock, "opening afterwards", self.subject.device().open()).await?;
        }
        let state = if self.subject.moves() { self.ask().await? } else { None };
        if state == Some(Value::Blade(crate::contract::ShutterState::Open)) {
            return Err("a safe shutter is closed, it says open".into());
        }
        Ok(state.map_or_else(|| "safe".into(), |value| format!("safe at {value}")))
    }
}
