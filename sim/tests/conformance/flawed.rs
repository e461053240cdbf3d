//! The suite can fail: drivers with one mistake each, and the check that finds it.

use crate::{paused, wired};
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{Subject, Value};
use goniod_drivers::contract::{Device, FilterWheel, Health, Identity, RotaryAxis};
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::table::Driver;
use goniod_drivers::units::{Degrees, DegreesPerSecond, Slot};
use goniod_sim::conformance::rig::{Rig, Unit, rig};
use goniod_sim::conformance::{Effort, conform};
use std::future::pending;

/// One mistake that drivers make.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Flaw {
    /// No mistake: the wrapper itself is sound.
    None,
    /// Takes any device for its own.
    TakesAnyDevice,
    /// Sends what is outside its limits.
    NoLimits,
    /// Waits without end for an answer.
    NoDeadline,
    /// Believes that an order was carried out when the answer was lost.
    BelievesLostAnswers,
    /// Says the place of its last order without asking.
    SaysWhatItOrdered,
    /// Says that it is well without asking.
    AlwaysWell,
    /// Does not connect again after a loss.
    NeverReconnects,
    /// Says another place than it reached.
    OffByOne,
    /// Says its last angle after a restart.
    RemembersItsReference,
}

/// A sound driver with a mistake put over it.
struct Flawed<D: ?Sized> {
    flaw: Flaw,
    opened: Option<Identity>,
    lost: bool,
    ordered: Option<f64>,
    inner: Box<D>,
}

// === impl Flawed ===

impl<D: Device + ?Sized> Flawed<D> {
    fn new(flaw: Flaw, inner: Box<D>) -> Flawed<D> {
        Flawed { flaw, opened: None, lost: false, ordered: None, inner }
    }

    async fn after<T>(&mut self, result: Result<T>) -> Result<T> {
        if let Err(error) = &result {
            if error.kind == ErrorKind::Timeout && self.flaw == Flaw::NoDeadline {
                pending::<()>().await;
            }
            self.lost |= error.kind == ErrorKind::Lost;
        }
        result
    }
}

#[async_trait]
impl<D: Device + ?Sized> Device for Flawed<D> {
    async fn open(&mut self) -> Result<Identity> {
        if self.flaw == Flaw::NeverReconnects && self.lost && self.opened.is_some() {
            return Err(DeviceError::new(ErrorKind::Lost, "flawed", "the old handle is dead"));
        }
        let opened = self.inner.open().await;
        let opened = self.after(opened).await;
        if let Ok(identity) = &opened {
            self.opened = Some(identity.clone());
        }
        match opened {
            Err(error) if error.kind == ErrorKind::WrongDevice && self.flaw == Flaw::TakesAnyDevice => {
                Ok(Identity { model: "any".into(), firmware: String::new(), serial: String::new() })
            }
            other => other,
        }
    }

    async fn health(&mut self) -> Result<Health> {
        if self.flaw == Flaw::AlwaysWell {
            return Ok(Health::default());
        }
        let health = self.inner.health().await;
        self.after(health).await
    }

    async fn make_safe(&mut self) -> Result<()> {
        let safe = self.inner.make_safe().await;
        self.after(safe).await
    }
}

#[async_trait]
impl FilterWheel for Flawed<dyn FilterWheel> {
    fn slots(&self) -> u8 {
        self.inner.slots()
    }

    async fn select(&mut self, slot: Slot) -> Result<Slot> {
        let to = if self.flaw == Flaw::NoLimits { Slot(slot.0.clamp(1, self.inner.slots())) } else { slot };
        let selected = self.inner.select(to).await;
        self.ordered = Some(f64::from(slot.0));
        match self.after(selected).await {
            Err(error) if error.kind != ErrorKind::Refused && self.flaw == Flaw::BelievesLostAnswers => Ok(slot),
            other => other,
        }
    }

    async fn slot(&mut self) -> Result<Option<Slot>> {
        if let (Flaw::SaysWhatItOrdered, Some(ordered)) = (self.flaw, self.ordered) {
            return Ok(Some(Slot(ordered as u8)));
        }
        let slot = self.inner.slot().await;
        let slot = self.after(slot).await?;
        if self.flaw == Flaw::OffByOne {
            return Ok(slot.map(|slot| Slot(slot.0 % self.inner.slots() + 1)));
        }
        Ok(slot)
    }
}

#[async_trait]
impl RotaryAxis for Flawed<dyn RotaryAxis> {
    fn limits(&self) -> (Degrees, Degrees) {
        self.inner.limits()
    }

    fn speed(&self) -> (DegreesPerSecond, f64) {
        self.inner.speed()
    }

    async fn home(&mut self) -> Result<()> {
        self.inner.home().await
    }

    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        let (low, high) = self.inner.limits();
        let to = if self.flaw == Flaw::NoLimits { Degrees(target.0.max(low.0).min(high.0)) } else { target };
        let moved = self.inner.move_to(to).await;
        let moved = self.after(moved).await;
        if moved.is_ok() {
            self.ordered = Some(target.0);
        }
        moved
    }

    async fn position(&mut self) -> Result<Option<Degrees>> {
        let position = self.inner.position().await;
        match self.after(position).await? {
            None if self.flaw == Flaw::RemembersItsReference => Ok(self.ordered.or(Some(0.0)).map(Degrees)),
            other => Ok(other),
        }
    }

    async fn stop(&mut self) -> Result<()> {
        self.inner.stop().await
    }
}

fn flawed(driver: &Driver, flaw: Flaw, unit: Unit) -> Option<Rig> {
    let mut rig = rig(driver, unit, Clock::system()).unwrap()?;
    rig.subject = match rig.subject {
        Subject::Wheel(inner) => Subject::Wheel(Box::new(Flawed::new(flaw, inner))),
        Subject::Axis(inner) => Subject::Axis(Box::new(Flawed::new(flaw, inner))),
        other => other,
    };
    Some(rig)
}

fn found(driver: &str, flaw: Flaw) -> Vec<String> {
    let driver = wired().into_iter().find(|d| d.name == driver).unwrap();
    let effort = Effort { commands: 30, exchanges: 0, seed: 3 };
    let conduct = paused().block_on(conform(driver, &|unit| flawed(driver, flaw, unit), effort));
    conduct.failures()
}

#[test]
fn each_mistake_is_found_by_the_check_made_for_it() {
    let mut missed = Vec::new();
    for (driver, flaw, check) in [
        ("thorlabs-fw212c", Flaw::TakesAnyDevice, "another device"),
        ("thorlabs-fw212c", Flaw::NoLimits, "nothing sent"),
        ("thorlabs-fw212c", Flaw::NoDeadline, "silence"),
        ("thorlabs-fw212c", Flaw::BelievesLostAnswers, "silence"),
        ("thorlabs-fw212c", Flaw::SaysWhatItOrdered, "before opening"),
        ("thorlabs-fw212c", Flaw::AlwaysWell, "unplug"),
        ("thorlabs-fw212c", Flaw::NeverReconnects, "unplug"),
        ("thorlabs-fw212c", Flaw::OffByOne, "commands"),
        ("zaber-ascii", Flaw::NoLimits, "nothing sent"),
        ("zaber-ascii", Flaw::RemembersItsReference, "power-up"),
    ] {
        let failures = found(driver, flaw);
        let named = failures.iter().any(|failure| failure.contains(&format!("{driver}: {check}:")));
        if !named {
            missed.push(format!("{flaw:?} of {driver} is not found by `{check}`, but by {failures:#?}"));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn a_sound_driver_in_the_same_dress_passes() {
    for driver in ["thorlabs-fw212c", "zaber-ascii"] {
        assert_eq!(found(driver, Flaw::None), Vec::<String>::new());
    }
}

#[test]
fn an_order_that_ends_elsewhere_is_no_fulfilled_order() {
    assert!(Value::Place(Slot(3)).met_by(&Value::Place(Slot(3))));
    assert!(!Value::Place(Slot(3)).met_by(&Value::Place(Slot(4))));
    assert!(!Value::Angle(Degrees(10.0)).met_by(&Value::Angle(Degrees(10.2))));
    assert!(!Value::Angle(Degrees(f64::NAN)).met_by(&Value::Angle(Degrees(0.0))));
}
