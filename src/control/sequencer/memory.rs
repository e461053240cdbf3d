//! What outlives an exposure: the streams' histories, the bracket, the frame kept back, and the devices' troubles.

use super::recorder::{FrameEntry, Recorder};
use crate::archive::rows::FrameRow;
use crate::control::devices::bench::{Bench, DeviceId, Fault, Known};
use crate::control::frames::acquire::{AcquireError, Acquired};
use crate::control::frames::bracket::Bracket;
use crate::control::frames::guard::{Rejection, StreamHistory};
use crate::control::plan::{Step, View};
use std::collections::BTreeMap;
use tokio::time::Instant;

/// What outlives an exposure.
#[derive(Debug, Default)]
pub(super) struct Memory {
    pub(super) histories: BTreeMap<String, StreamHistory>,
    pub(super) bracket: Bracket,
    pub(super) bracket_view: Option<u32>,
    /// The last frame of the bracket, kept back until the next one agrees with it.
    pub(super) held: Option<Held>,
    /// A frame that the looks at the next contradict; it is to be taken again.
    pub(super) doubted: Option<Held>,
    /// What must be done to a device before it is used.
    aids: BTreeMap<DeviceId, Aid>,
    troubles: BTreeMap<DeviceId, Trouble>,
    /// The view that is given up, and why.
    given_up: Option<(u32, String)>,
}

/// A frame that passed the guard, and where it belongs.
#[derive(Debug)]
pub(super) struct Held {
    pub(super) view: View,
    pub(super) step: Step,
    pub(super) acquired: Acquired,
    pub(super) rejected: u32,
}

/// What brings a device back into a known condition, from the gentlest on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Aid {
    /// It is asked whether it is well.
    Ask,
    /// It finds its reference.
    Home,
    /// It is opened anew.
    Reopen,
}

/// What a device failed since its last success.
#[derive(Debug, Clone, Copy)]
pub(super) struct Trouble {
    /// Failures in the exposure under way.
    pub(super) failures: u32,
    /// First failure that no success followed.
    pub(super) since: Instant,
    /// Views given up in a row.
    pub(super) given_up: u32,
}

// === impl Memory ===

impl Memory {
    /// Hands the held frame to the recorder: nothing more can be said against it. Dropping the future keeps it held.
    pub(super) async fn release(&mut self, recorder: &Recorder) {
        if self.held.is_none() {
            return;
        }
        let Some(room) = recorder.frame_place().await else { return };
        let Some(Held { view, step, acquired, rejected }) = self.held.take() else { return };
        let Acquired { frame, attempts, .. } = acquired;
        let info = &frame.info;
        let row = FrameRow {
            step: step.number,
            digest: String::new(),
            bytes: 0,
            utc_us: info.utc.0,
            device_frame_id: info.device_frame_id,
            exposure_us: info.settings.exposure.0,
            camera_serial: info.camera_serial.clone(),
            attempts,
            rejected,
        };
        let place = (view.camera, view.array_index, step.exposure_index);
        room.put(FrameEntry { place, frame, row });
    }

    /// Forgets the bracket with the frame kept back: its view is taken again.
    pub(super) fn forget_bracket(&mut self) {
        (self.held, self.doubted, self.bracket_view) = (None, None, None);
        self.bracket = Bracket::default();
    }

    /// Doubts the held frame where it is what the looks at the next one contradict; tells its step and the contradiction.
    pub(super) fn doubt_held(&mut self, view: &View, error: &AcquireError) -> Option<(u32, Rejection)> {
        let AcquireError::Rejected { last: reason @ Rejection::Bracket(contradiction), .. } = error else {
            return None;
        };
        let concerns = |held: &Held| held.view.id == view.id && held.step.exposure.0 == contradiction.other_us;
        let held = self.held.take_if(|held| concerns(held))?;
        self.bracket.remove(held.step.exposure);
        let number = held.step.number;
        self.doubted = Some(held);
        Some((number, reason.clone()))
    }

    /// A device failed once more.
    pub(super) fn fails(&mut self, id: &DeviceId, now: Instant) -> Trouble {
        let trouble = self.troubles.entry(id.clone()).or_insert(Trouble { failures: 0, since: now, given_up: 0 });
        trouble.failures += 1;
        *trouble
    }

    /// A device did what an exposure needs of it.
    pub(super) fn works(&mut self, id: &DeviceId) {
        self.troubles.remove(id);
    }

    /// The view cannot be had because of a device; the next one begins with fresh attempts.
    pub(super) fn give_up(&mut self, id: &DeviceId, view: u32, why: &Fault) {
        self.given_up = Some((view, why.to_string()));
        if let Some(trouble) = self.troubles.get_mut(id) {
            (trouble.failures, trouble.given_up) = (0, trouble.given_up + 1);
        }
    }

    /// Why this view was given up, where it was.
    pub(super) fn given_up(&self, view: u32) -> Option<String> {
        self.given_up.as_ref().filter(|(id, _)| *id == view).map(|(_, why)| why.clone())
    }

    /// A device needs this before it is used; something harder that it needs already stays.
    pub(super) fn needs(&mut self, id: &DeviceId, aid: Aid) {
        let needed = self.aids.entry(id.clone()).or_insert(aid);
        *needed = (*needed).max(aid);
    }

    /// What a device needs before it is used.
    pub(super) fn aid(&self, id: &DeviceId) -> Option<Aid> {
        self.aids.get(id).copied()
    }

    /// A device got what it needed.
    pub(super) fn aided(&mut self, id: &DeviceId) {
        self.aids.remove(id);
    }

    /// Something was interrupted in the middle: every device is opened anew before it is used.
    pub(super) fn doubt_all(&mut self, bench: &mut Bench) {
        bench.known = Known::default();
        for id in bench.ids() {
            self.needs(&id, Aid::Reopen);
        }
    }
}
