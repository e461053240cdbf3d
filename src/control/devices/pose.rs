//! Brings the bench into the pose of a view: only what must move, the shutter closed meanwhile, each place proven.

use super::bench::{AxisCare, Bench, DeviceId, Fault, QUESTION_LIMIT, fault, limited};
use crate::control::plan::{Subject, View};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::ShutterState;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::units::{Degrees, Slot};
use std::time::Duration;

/// Limit for turning the wheel or the shutter, beyond the driver's own.
const SWITCH_LIMIT: Duration = Duration::from_secs(60);

/// Added to twice the nominal time of a move.
const MOVE_MARGIN: Duration = Duration::from_secs(30);

// === impl Bench ===

impl Bench {
    /// Brings the bench into the view's pose, the shutter open unless the view is a dark.
    ///
    /// # Errors
    /// The fault of the first device that does not reach its place; that device's place is then unknown.
    pub async fn pose_for(&mut self, view: &View, clock: Clock) -> Result<(), Fault> {
        if !self.stands_for(view) {
            self.set_shutter(ShutterState::Closed, clock).await?;
            self.select(view.slot, clock).await?;
            if let Some(target) = view.changer_deg {
                self.turn(&DeviceId::Changer, target, clock).await?;
            }
            self.turn(&DeviceId::Tilt, view.tilt_deg, clock).await?;
            self.turn(&DeviceId::Spin, view.spin_deg, clock).await?;
        }
        self.set_shutter(shutter_of(view), clock).await
    }

    /// Asks shutter, wheel and axes again whether they stand as the view needs them: what may trip silently, be pushed or
    /// be turned by hand is proven after each exposure, before its frame is kept.
    ///
    /// # Errors
    /// `Broken` of the device that stands elsewhere; its place is then unknown.
    pub async fn prove(&mut self, view: &View, clock: Clock) -> Result<(), Fault> {
        let id = DeviceId::Shutter;
        let state = limited(clock, QUESTION_LIMIT, &id, self.devices.shutter.state()).await?;
        if state != Some(shutter_of(view)) {
            self.forget(&id);
            return Err(fault(&id, ErrorKind::Broken, format!("was {state:?} at the end of an exposure")));
        }
        let id = DeviceId::FilterWheel;
        let slot = limited(clock, QUESTION_LIMIT, &id, self.devices.wheel.slot()).await?;
        if slot != Some(view.slot) {
            self.forget(&id);
            let message = format!("stood at {slot:?} instead of {} at the end of an exposure", view.slot);
            return Err(fault(&id, ErrorKind::Broken, message));
        }
        if let Some(at_deg) = view.changer_deg {
            self.prove_axis(&DeviceId::Changer, at_deg, self.settle.changer, clock).await?;
        }
        self.prove_axis(&DeviceId::Tilt, view.tilt_deg, self.settle.tilt, clock).await?;
        self.prove_axis(&DeviceId::Spin, view.spin_deg, self.settle.spin, clock).await
    }

    async fn prove_axis(&mut self, id: &DeviceId, at_deg: f64, care: AxisCare, clock: Clock) -> Result<(), Fault> {
        let axis = self.axis(id)?;
        let position = limited(clock, QUESTION_LIMIT, id, axis.position()).await?;
        if position.is_some_and(|p| p.distance(Degrees(at_deg)).0 <= care.tolerance_deg) {
            return Ok(());
        }
        self.forget(id);
        let stood = position.map_or("without reference".to_owned(), |p| format!("at {p}"));
        let message = format!("stood {stood} instead of at {at_deg}° at the end of an exposure");
        Err(fault(id, ErrorKind::Broken, message))
    }

    /// Brings the shutter to `state`, proves it and waits for it to settle; does nothing when it is known to be there.
    ///
    /// # Errors
    /// The shutter's own; its state is then unknown.
    pub async fn set_shutter(&mut self, state: ShutterState, clock: Clock) -> Result<(), Fault> {
        let id = DeviceId::Shutter;
        if self.known.shutter == Some(state) {
            return Ok(());
        }
        self.forget(&id);
        limited(clock, SWITCH_LIMIT, &id, self.devices.shutter.set(state)).await?;
        clock.sleep(self.settle.shutter).await;
        self.known.shutter = Some(state);
        Ok(())
    }

    fn stands_for(&self, view: &View) -> bool {
        let known = &self.known;
        let changer = view.changer_deg.is_none() || known.changer_deg == view.changer_deg;
        let table = known.tilt_deg == Some(view.tilt_deg) && known.spin_deg == Some(view.spin_deg);
        changer && table && known.slot == Some(view.slot)
    }

    async fn select(&mut self, slot: Slot, clock: Clock) -> Result<(), Fault> {
        let id = DeviceId::FilterWheel;
        if self.known.slot == Some(slot) {
            return Ok(());
        }
        self.forget(&id);
        let reached = limited(clock, SWITCH_LIMIT, &id, self.devices.wheel.select(slot)).await?;
        if reached != slot {
            return Err(fault(&id, ErrorKind::Broken, format!("stands at {reached} instead of {slot}")));
        }
        clock.sleep(self.settle.wheel).await;
        self.known.slot = Some(slot);
        Ok(())
    }

    async fn turn(&mut self, id: &DeviceId, target_deg: f64, clock: Clock) -> Result<(), Fault> {
        let (known, care) = match id {
            DeviceId::Changer => (self.known.changer_deg, self.settle.changer),
            DeviceId::Tilt => (self.known.tilt_deg, self.settle.tilt),
            _ => (self.known.spin_deg, self.settle.spin),
        };
        if known == Some(target_deg) {
            return Ok(());
        }
        self.forget(id);
        self.move_axis(id, target_deg, care, clock).await?;
        match id {
            DeviceId::Changer => self.known.changer_deg = Some(target_deg),
            DeviceId::Tilt => self.known.tilt_deg = Some(target_deg),
            _ => self.known.spin_deg = Some(target_deg),
        }
        Ok(())
    }

    async fn move_axis(&mut self, id: &DeviceId, target_deg: f64, care: AxisCare, clock: Clock) -> Result<(), Fault> {
        let axis = self.axis(id)?;
        let (lowest, highest) = axis.limits();
        let (speed, acceleration) = axis.speed();
        // The whole range at nominal speed and both ramps: the place before the move may be unknown.
        let nominal_s = (highest.0 - lowest.0) / speed.0 + 2.0 * speed.0 / acceleration;
        let limit = Duration::try_from_secs_f64(2.0 * nominal_s).unwrap_or(MOVE_MARGIN) + MOVE_MARGIN;
        let reached = limited(clock, limit, id, axis.move_to(Degrees(target_deg))).await?;
        let off = reached.distance(Degrees(target_deg));
        if off.0.is_nan() || off.0 > care.tolerance_deg {
            let message = format!("stands at {reached} instead of {target_deg}°, allowed is {}°", care.tolerance_deg);
            return Err(fault(id, ErrorKind::Broken, message));
        }
        clock.sleep(care.settle).await;
        Ok(())
    }
}

/// The shutter's state during the view's exposures.
fn shutter_of(view: &View) -> ShutterState {
    match view.subject {
        Subject::Dark => ShutterState::Closed,
        Subject::Reference { .. } | Subject::Sample { .. } => ShutterState::Open,
    }
}
