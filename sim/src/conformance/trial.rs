//! What every check is made of: calls under a deadline, answers held against the truth, and the way back after a failure.

use super::rig::{Rig, Unit};
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{PATIENCE, Subject, Value};
use goniod_drivers::contract::Identity;
use goniod_drivers::error::{DeviceError, Result};
use std::future::Future;
use std::time::Duration;
use tokio::time::Instant;

/// Rounds of opening, referencing and ordering that bring any device back whose fault is over.
const ROUNDS: u32 = 5;
/// Rest between them: a device that restarted needs a moment.
const REST: Duration = Duration::from_secs(8);

/// A violation in words.
pub type Violation = String;
/// How an honest call ended: with the error it gave, or well.
pub type Honest = std::result::Result<Option<DeviceError>, Violation>;

/// Makes fresh rigs of one driver; `None` for a unit that cannot tell which one it is.
pub type MakeRig<'a> = dyn Fn(Unit) -> Option<Rig> + 'a;

/// A rig under trial.
pub struct Trial {
    /// The rig.
    pub rig: Rig,
    clock: Clock,
    /// Orders in turn, so that two in a row differ.
    orders: Vec<Value>,
    next: usize,
}

// === impl Trial ===

impl Trial {
    /// A fresh rig; nothing is open.
    ///
    /// # Errors
    /// There is no such rig.
    pub fn new(make: &MakeRig<'_>) -> std::result::Result<Trial, Violation> {
        let rig = make(Unit::Ours).ok_or("the driver has no twin")?;
        Ok(Trial { rig, clock: Clock::system(), orders: Vec::new(), next: 0 })
    }

    /// A fresh rig, open and referenced.
    ///
    /// # Errors
    /// It is not opened without any fault.
    pub async fn ready(make: &MakeRig<'_>) -> std::result::Result<Trial, Violation> {
        let mut trial = Trial::new(make)?;
        if let Err(error) = trial.open().await? {
            return Err(format!("it is not opened: {error}"));
        }
        trial.recover().await?;
        Ok(trial)
    }

    /// Waits.
    pub async fn rest(&self, time: Duration) {
        self.clock.sleep(time).await;
    }

    /// A call with a limit that no honest one needs.
    async fn call<T>(clock: Clock, what: &str, call: impl Future<Output = T>) -> std::result::Result<T, Violation> {
        let ended = clock.timeout(PATIENCE, call).await;
        ended.map_err(|_| format!("{what} did not end within {} s", PATIENCE.as_secs()))
    }

    /// Opens.
    pub async fn open(&mut self) -> std::result::Result<Result<Identity>, Violation> {
        Self::call(self.clock, "opening", self.rig.subject.device().open()).await
    }

    /// Asks for its health.
    pub async fn health(&mut self) -> Honest {
        let ended = Self::call(self.clock, "asking for its health", self.rig.subject.device().health()).await?;
        Ok(ended.err())
    }

    /// Makes it safe.
    pub async fn make_safe(&mut self) -> Honest {
        let ended = Self::call(self.clock, "making it safe", self.rig.subject.device().make_safe()).await?;
        Ok(ended.err())
    }

    /// An order that differs from the one before.
    pub fn another_order(&mut self) -> Value {
        if self.orders.is_empty() {
            self.orders = self.rig.subject.orders();
        }
        self.next += 1;
        let order = self.orders.get(self.next % self.orders.len().max(1)).cloned();
        order.unwrap_or(Value::Blade(goniod_drivers::contract::ShutterState::Closed))
    }

    /// Carries an order out; what is said to be done must be what was ordered, and true.
    pub async fn order(&mut self, order: &Value) -> Honest {
        let ended = Self::call(self.clock, &format!("the order {order}"), self.rig.subject.carry_out(order)).await?;
        self.judge_order(order, ended)
    }

    /// Holds the end of an order against the truth.
    pub fn judge_order(&self, order: &Value, ended: Result<Value>) -> Honest {
        let said = match ended {
            Ok(said) => said,
            Err(error) => return Ok(Some(error)),
        };
        if !order.met_by(&said) {
            return Err(format!("the order {order} is said to have ended at {said}"));
        }
        match self.rig.stand.judge(&said, Instant::now()) {
            Ok(()) => Ok(None),
            Err(truth) => Err(format!("the order {order} is said to have ended at {said}, but {truth}")),
        }
    }

    /// Asks where it stands; what is said must be true.
    pub async fn ask(&mut self) -> Honest {
        self.tell().await.map(std::result::Result::err)
    }

    /// Asks where it stands and gives what is said, which is true.
    pub async fn tell(&mut self) -> std::result::Result<Result<Option<Value>>, Violation> {
        let since = Instant::now();
        let ended = Self::call(self.clock, "asking where it stands", self.rig.subject.state()).await?;
        match &ended {
            Ok(Some(said)) => match self.rig.stand.judge(said, since) {
                Ok(()) => Ok(ended),
                Err(truth) => Err(format!("it says {said}, but {truth}")),
            },
            _ => Ok(ended),
        }
    }

    /// Brings it back by what an operator or the daemon may do: order again, open again, find the reference again.
    ///
    /// # Errors
    /// It does not come back, or something untrue was said on the way.
    pub async fn recover(&mut self) -> std::result::Result<(), Violation> {
        let mut last = None;
        for round in 0..ROUNDS {
            if round > 0 {
                self.rest(REST).await;
                // What is refused while it is still away may be granted in the next round.
                let _ = self.open().await?;
            }
            if matches!(self.rig.subject, Subject::Axis(_)) && matches!(self.tell().await?, Ok(None)) {
                let home = self.rig.subject.reference();
                // An axis that found none refuses the order that follows, and says why.
                let _ = Self::call(self.clock, "finding the reference", home).await?;
            }
            let order = self.another_order();
            match self.order(&order).await? {
                None => return Ok(()),
                Some(error) => last = Some(error),
            }
        }
        let last = last.map_or_else(String::new, |e| format!(": {e}"));
        Err(format!("it does not come back after {ROUNDS} openings{last}"))
    }
}

/// True for the same device. A firmware that was not told is no other firmware.
pub fn same(ours: &Identity, told: &Identity) -> bool {
    let firmware = told.firmware.is_empty() || told.firmware == ours.firmware;
    ours.model == told.model && ours.serial == told.serial && firmware
}
