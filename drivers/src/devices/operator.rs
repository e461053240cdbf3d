//! Driver `operator`: a person who turns the sample over or puts a reference in, where no axis does. No wire: what is
//! asked stands on a [`Desk`], and counts as done once somebody has confirmed it there.
//!
//! Nothing is assumed about where the sample stands: the first place of a run is asked for like any other. Until it is
//! confirmed the place is [`ErrorKind::Lost`], which makes whoever moves the bench wait safely and ask again.

use super::AxisConfig;
use crate::contract::{Device, Health, Identity, RotaryAxis};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::units::{Degrees, DegreesPerSecond};
use async_trait::async_trait;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What is asked of the operator, and what was confirmed; shared with whoever hears the operator.
#[derive(Debug, Clone, Default)]
pub struct Desk(Arc<Mutex<Standing>>);

#[derive(Debug, Default)]
struct Standing {
    asked: Option<Degrees>,
    confirmed: Option<Degrees>,
}

/// What there is to do for one place.
#[derive(Debug, Clone, PartialEq)]
pub struct Place {
    /// Angle that stands for the place in plan and instrument file.
    pub at: Degrees,
    /// What the operator is to do, an imperative without full stop.
    pub words: String,
}

/// An operator as an axis whose angles are places.
pub struct Operator {
    config: AxisConfig,
    places: Vec<Place>,
    desk: Desk,
}

// === impl Desk ===

impl Desk {
    fn standing(&self) -> MutexGuard<'_, Standing> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The place that is asked for and not confirmed.
    pub fn asked(&self) -> Option<Degrees> {
        self.standing().asked
    }

    /// Somebody says that what was asked is done; false when nothing was asked.
    pub fn confirm(&self) -> bool {
        let mut standing = self.standing();
        match standing.asked.take() {
            Some(place) => {
                standing.confirmed = Some(place);
                true
            }
            None => false,
        }
    }
}

// === impl Operator ===

impl Operator {
    /// An operator who hears of wishes through `desk`. Angles beside `places` within the tolerance count as theirs.
    pub fn new(config: AxisConfig, places: Vec<Place>, desk: Desk) -> Operator {
        Operator { config, places, desk }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, format!("{} (operator)", self.config.name), message)
    }

    fn near(&self, a: Degrees, b: Degrees) -> bool {
        a.distance(b).0 <= self.config.tolerance.0
    }

    fn waits(&self, target: Degrees) -> DeviceError {
        let words = self.places.iter().find(|p| self.near(p.at, target)).map_or("bring it there", |p| p.words.as_str());
        self.error(ErrorKind::Lost, format!("the operator is asked: {words}, then confirm with `goniod resume`"))
    }
}

#[async_trait]
impl Device for Operator {
    async fn open(&mut self) -> Result<Identity> {
        match self.desk.asked() {
            Some(target) => Err(self.waits(target)),
            None => Ok(Identity {
                model: "operator".to_owned(),
                firmware: String::new(),
                serial: self.config.serial.clone(),
            }),
        }
    }

    async fn health(&mut self) -> Result<Health> {
        let warnings = self.desk.asked().map(|target| self.waits(target).message).into_iter().collect();
        Ok(Health { warnings, temperature_c: None })
    }

    /// A person who does nothing is safe.
    async fn make_safe(&mut self) -> Result<()> {
        Ok(())
    }
}

#[async_trait]
impl RotaryAxis for Operator {
    fn limits(&self) -> (Degrees, Degrees) {
        (self.config.min, self.config.max)
    }

    fn speed(&self) -> (DegreesPerSecond, f64) {
        (self.config.speed, self.config.acceleration_deg_per_s2)
    }

    /// There is no reference to find; where the sample stands is asked for with the first place.
    async fn home(&mut self) -> Result<()> {
        Ok(())
    }

    async fn move_to(&mut self, target: Degrees) -> Result<Degrees> {
        if !self.places.iter().any(|p| self.near(p.at, target)) {
            let what = format!("{target} is no place of {}; nobody was asked", self.config.name);
            return Err(self.error(ErrorKind::Refused, what));
        }
        {
            let mut standing = self.desk.standing();
            match standing.confirmed {
                Some(at) if self.near(at, target) => {
                    standing.asked = None;
                    return Ok(at);
                }
                // From here on it may be under way: the place before counts no more.
                _ => (standing.asked, standing.confirmed) = (Some(target), None),
            }
        }
        Err(self.waits(target))
    }

    async fn position(&mut self) -> Result<Option<Degrees>> {
        Ok(self.desk.standing().confirmed)
    }

    async fn stop(&mut self) -> Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::time::Duration;

    fn operator() -> (Operator, Desk) {
        let config = AxisConfig {
            name: "changer".into(),
            device: 3,
            axis: 1,
            serial: "hands".into(),
            min: Degrees(0.0),
            max: Degrees(360.0),
            speed: DegreesPerSecond(10.0),
            acceleration_deg_per_s2: 10.0,
            tolerance: Degrees(0.5),
            settle: Duration::ZERO,
        };
        let place = |at, words: &str| Place { at: Degrees(at), words: words.to_owned() };
        let places = vec![place(0.0, "interior side to the camera"), place(180.0, "exterior side to the camera")];
        let desk = Desk::default();
        (Operator::new(config, places, desk.clone()), desk)
    }

    #[tokio::test]
    async fn a_place_counts_when_it_was_asked_for_and_confirmed_and_not_before() {
        let (mut operator, desk) = operator();
        assert_eq!(operator.open().await.unwrap().serial, "hands");
        assert_eq!(operator.position().await.unwrap(), None, "nothing is assumed");
        assert!(!desk.confirm(), "nothing was asked");
        for (target, words) in [(180.0, "exterior side"), (0.0, "interior side")] {
            let error = operator.move_to(Degrees(target)).await.unwrap_err();
            assert_eq!(error.kind, ErrorKind::Lost);
            assert!(error.message.contains(words) && error.message.contains("goniod resume"), "{error}");
            assert_eq!(operator.position().await.unwrap(), None, "it may be under way");
            assert_eq!(operator.open().await.unwrap_err().message, error.message, "trying again confirms nothing");
            assert!(operator.health().await.unwrap().warnings[0].contains(words));
            assert!(desk.confirm() && !desk.confirm());
            operator.open().await.unwrap();
            assert_eq!(operator.move_to(Degrees(target)).await.unwrap(), Degrees(target));
            assert_eq!(operator.position().await.unwrap(), Some(Degrees(target)));
        }
    }

    #[tokio::test]
    async fn another_wish_replaces_the_one_that_nobody_confirmed() {
        let (mut operator, desk) = operator();
        operator.move_to(Degrees(180.0)).await.unwrap_err();
        operator.move_to(Degrees(0.0)).await.unwrap_err();
        desk.confirm();
        assert_eq!(operator.position().await.unwrap(), Some(Degrees(0.0)));
        assert_eq!(operator.move_to(Degrees(90.0)).await.unwrap_err().kind, ErrorKind::Refused);
        assert_eq!(operator.position().await.unwrap(), Some(Degrees(0.0)), "nobody was asked, nothing moved");
    }
}
