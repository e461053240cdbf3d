//! One exposure: pose, frame, proof, with bounded recovery from what devices do.

use super::memory::{Aid, Held, Memory};
use super::recovery::{Case, Decision, Part, Phase, decide};
use super::run::Job;
use super::stage::Stage;
use super::state::{Ending, Input};
use crate::control::devices::bench::{Bench, DeviceId, Fault};
use crate::control::events::Event;
use crate::control::frames::acquire::{AcquireError, Acquired, Request, acquire};
use crate::control::frames::bracket::Bracket;
use crate::control::plan::{Step, Subject, View};
use goniod_drivers::contract::CameraSettings;
use goniod_drivers::error::{DeviceError, ErrorKind};
use std::time::Duration;

/// How an exposure ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum StepEnd {
    /// Its frame is on its way to the disk.
    Taken,
    /// It cannot be had, for this reason.
    Missing(String),
    /// A device is lost; it is opened anew after this time, or when somebody asks.
    Lost(DeviceId, Option<Duration>),
    /// The run must end.
    End(Ending, String),
}

/// Everything one exposure needs.
pub(super) struct Hands<'a> {
    pub(super) job: &'a Job<'a>,
    pub(super) bench: &'a mut Bench,
    pub(super) memory: &'a mut Memory,
    pub(super) stage: &'a Stage,
}

/// How the tries of an exposure came out.
enum Tried {
    Passed(Acquired, u32),
    Unfit(AcquireError, u32),
    Ended(StepEnd),
}

enum Failure {
    Fault(Fault),
    Unfit(AcquireError),
}

// === impl Hands ===

impl Hands<'_> {
    /// Opens every device, with the same recovery as an exposure. At the beginning of a run a device that cannot be had
    /// ends it: somebody is still there to look. A run that is gone on with has worked before and may have nobody beside
    /// it: what cannot be had is waited for where it is needed, as in its middle.
    pub(super) async fn check(&mut self, goes_on: bool) -> Result<(), (Ending, String)> {
        let phase = if goes_on { Phase::Exposure } else { Phase::Start };
        for id in self.bench.ids() {
            let end = loop {
                let Err(fault) = self.aid(&id, Aid::Reopen).await else { break None };
                if let Some(end) = self.recover(fault, phase, None).await {
                    break Some(end);
                }
            };
            match end {
                None => self.memory.works(&id),
                Some(StepEnd::End(ending, why)) => return Err((ending, why)),
                Some(StepEnd::Lost(..) | StepEnd::Missing(_) | StepEnd::Taken) => {}
            }
        }
        Ok(())
    }

    /// Takes the frame of one step. It goes to the recorder when the next of its bracket agrees with it; where several
    /// looks at the next contradict it, it is the one to be doubted and is taken again, once. Dropping the future loses
    /// no frame that was taken before.
    pub(super) async fn take(&mut self, view: &View, step: &Step) -> StepEnd {
        if self.memory.bracket_view != Some(view.id) {
            self.memory.release(self.stage.recorder()).await;
            self.memory.bracket = Bracket::default();
            self.memory.bracket_view = Some(view.id);
        }
        if let Some(why) = self.memory.given_up(view.id) {
            return StepEnd::Missing(why);
        }
        if let Some(end) = self.settle_doubt(view).await {
            return end;
        }
        let (mut doubted, mut before) = (false, 0);
        loop {
            let error = match self.tries(view, step).await {
                Tried::Passed(acquired, rejected) => {
                    self.hold(view, step, acquired, before + rejected).await;
                    return StepEnd::Taken;
                }
                Tried::Ended(end) => return end,
                Tried::Unfit(error, rejected) => {
                    before += rejected;
                    error
                }
            };
            let Some((number, reason)) = (!doubted).then(|| self.memory.doubt_held(view, &error)).flatten() else {
                return StepEnd::Missing(error.to_string());
            };
            doubted = true;
            self.stage.recorder().event(Event::FrameRejected { step: number, reason }).await;
            if let Some(end) = self.settle_doubt(view).await {
                return end;
            }
        }
    }

    /// Takes a doubted frame again, where there is one; `Some` when this exposure cannot go on.
    async fn settle_doubt(&mut self, view: &View) -> Option<StepEnd> {
        let (step, already) = self.memory.doubted.as_ref().map(|held| (held.step.clone(), held.rejected))?;
        let reason = match self.tries(view, &step).await {
            Tried::Passed(acquired, rejected) => {
                self.memory.doubted = None;
                self.hold(view, &step, acquired, already + 1 + rejected).await;
                return None;
            }
            Tried::Unfit(error, _) => error.to_string(),
            Tried::Ended(StepEnd::Missing(reason)) => reason,
            Tried::Ended(end) => return Some(end),
        };
        self.stage.recorder().missing(&step, Some(view), reason).await;
        self.memory.doubted = None;
        self.memory.given_up(view.id).map(StepEnd::Missing)
    }

    /// Tries an exposure until it passes, with bounded recovery.
    async fn tries(&mut self, view: &View, step: &Step) -> Tried {
        let mut rejected = 0;
        loop {
            match self.try_once(view, step, &mut rejected).await {
                Ok(acquired) => {
                    needed(view).iter().for_each(|id| self.memory.works(id));
                    self.stage.go(Input::Recovered).await;
                    return Tried::Passed(acquired, rejected);
                }
                Err(Failure::Unfit(error)) => {
                    self.stage.go(Input::Recovered).await;
                    return Tried::Unfit(error, rejected);
                }
                Err(Failure::Fault(fault)) => {
                    if let Some(end) = self.recover(fault, Phase::Exposure, Some(view.id)).await {
                        return Tried::Ended(end);
                    }
                }
            }
        }
    }

    /// Opens a lost device anew. `None`: it is there again.
    pub(super) async fn try_lost(&mut self, id: &DeviceId, view: u32) -> Option<StepEnd> {
        let fault = self.aid(id, Aid::Reopen).await.err()?;
        let (decision, why) = self.judge(fault, Phase::Exposure).await;
        match decision {
            Decision::Suspend(after) => Some(StepEnd::Lost(id.clone(), Some(after))),
            Decision::Hold => Some(StepEnd::Lost(id.clone(), None)),
            Decision::GiveUp => {
                self.memory.give_up(id, view, &why);
                None
            }
            Decision::End => Some(StepEnd::End(ending(&why.error, Phase::Exposure), why.to_string())),
            // The policy still has gentler aid; it is due at once, because the run stands still.
            _ => Some(StepEnd::Lost(id.clone(), Some(decision.wait()))),
        }
    }

    /// Decides about a fault and waits where it is to be tried again; `Some` when it is not.
    async fn recover(&mut self, fault: Fault, phase: Phase, view: Option<u32>) -> Option<StepEnd> {
        let (decision, fault) = self.judge(fault, phase).await;
        let id = fault.device.clone();
        let aid = match decision {
            Decision::Retry(_) => None,
            Decision::Resynchronise(_) | Decision::Retake(_) => Some(Aid::Ask),
            Decision::Rehome(_) => Some(Aid::Home),
            _ => Some(Aid::Reopen),
        };
        if let Some(aid) = aid {
            self.bench.forget(&id);
            self.memory.needs(&id, aid);
        }
        match decision {
            Decision::GiveUp => {
                if let Some(view) = view {
                    self.memory.give_up(&id, view, &fault);
                }
                self.stage.go(Input::Recovered).await;
                Some(StepEnd::Missing(fault.to_string()))
            }
            Decision::End => Some(StepEnd::End(ending(&fault.error, phase), fault.to_string())),
            Decision::Suspend(after) => Some(StepEnd::Lost(id, Some(after))),
            Decision::Hold => Some(StepEnd::Lost(id, None)),
            _ => {
                self.stage.clock().sleep(decision.wait()).await;
                None
            }
        }
    }

    /// Decides about a fault and records it.
    async fn judge(&mut self, fault: Fault, phase: Phase) -> (Decision, Fault) {
        let Fault { device, error } = &fault;
        let now = self.stage.clock().now();
        let trouble = self.memory.fails(device, now);
        let case = Case {
            kind: error.kind,
            part: Part::of(device),
            phase,
            failures: trouble.failures,
            outage: now - trouble.since,
            given_up: trouble.given_up,
        };
        let decision = decide(&case, &self.job.recovery.of_device(device));
        let (name, message) = (device.to_string(), error.to_string());
        let event = Event::DeviceError { device: name, error: error.kind, message, decision: decision.words() };
        self.stage.recorder().event(event).await;
        self.stage.go(Input::Fault).await;
        (decision, fault)
    }

    async fn try_once(&mut self, view: &View, step: &Step, rejected: &mut u32) -> Result<Acquired, Failure> {
        for id in needed(view) {
            if let Some(aid) = self.memory.aid(&id) {
                self.aid(&id, aid).await.map_err(Failure::Fault)?;
            }
        }
        let clock = self.stage.clock();
        self.bench.pose_for(view, clock).await.map_err(Failure::Fault)?;
        let acquired = self.acquire(view, step, rejected).await?;
        self.bench.prove(view, clock).await.map_err(Failure::Fault)?;
        Ok(acquired)
    }

    async fn acquire(&mut self, view: &View, step: &Step, rejected: &mut u32) -> Result<Acquired, Failure> {
        let id = DeviceId::Camera(view.camera.clone());
        let Some(camera) = self.bench.devices.cameras.get_mut(&view.camera) else {
            let message = "the bench has no such camera; compare scan and instrument file";
            let error = DeviceError::new(ErrorKind::Refused, view.camera.clone(), message);
            return Err(Failure::Fault(Fault { device: id, error }));
        };
        let request = Request {
            camera: &view.camera,
            settings: CameraSettings {
                exposure: step.exposure,
                gain: self.job.gains.get(&view.camera).copied().unwrap_or(0.0),
            },
            dark: view.subject == Subject::Dark,
            skip_rows: self.job.reserved_rows.get(&view.camera).copied().unwrap_or(0),
            attempts: self.job.attempts,
            bracket: &self.memory.bracket,
        };
        let history = self.memory.histories.entry(view.camera.clone()).or_default();
        let mut reasons = Vec::new();
        let taken = acquire(camera.as_mut(), history, &request, self.stage.clock(), &mut reasons).await;
        *rejected += reasons.len() as u32;
        for reason in reasons {
            self.stage.recorder().event(Event::FrameRejected { step: step.number, reason }).await;
        }
        taken.map_err(|e| match e {
            AcquireError::Device(error) => Failure::Fault(Fault { device: id, error }),
            unfit @ AcquireError::Rejected { .. } => Failure::Unfit(unfit),
        })
    }

    /// Brings a device back into a known condition. Where it stands is unknown afterwards, so that it is commanded anew.
    async fn aid(&mut self, id: &DeviceId, aid: Aid) -> Result<(), Fault> {
        let clock = self.stage.clock();
        match aid {
            Aid::Ask => self.bench.resynchronise(id, clock).await?,
            Aid::Home => self.bench.rehome(id, clock).await?,
            Aid::Reopen => {
                let identity = self.bench.open(id, clock).await?;
                let name = id.to_string();
                if let Some(serial) = self.job.serials.get(&name).filter(|s| **s != identity.serial) {
                    let message = format!("has serial number {}, the run began with {serial}", identity.serial);
                    let error = DeviceError::new(ErrorKind::WrongDevice, name, message);
                    return Err(Fault { device: id.clone(), error });
                }
                if let DeviceId::Camera(name) = id {
                    self.memory.histories.entry(name.clone()).or_default().reopened();
                }
                self.stage.recorder().event(Event::DeviceOpened { device: name, identity }).await;
            }
        }
        self.memory.aided(id);
        Ok(())
    }

    /// Hands the frame held so far to the recorder and holds this one.
    async fn hold(&mut self, view: &View, step: &Step, acquired: Acquired, rejected: u32) {
        self.memory.release(self.stage.recorder()).await;
        self.memory.bracket.add(step.exposure, acquired.picture.clone());
        self.memory.held = Some(Held { view: view.clone(), step: step.clone(), acquired, rejected });
    }
}

/// What a run that ends because of a device is told to have ended by.
fn ending(error: &DeviceError, phase: Phase) -> Ending {
    match (error.kind, phase) {
        (ErrorKind::Refused | ErrorKind::WrongDevice, _) => Ending::DeviceRefused,
        (_, Phase::Start) => Ending::NotReady,
        (_, Phase::Exposure) => Ending::DeviceLost,
    }
}

/// The devices that a view needs.
fn needed(view: &View) -> Vec<DeviceId> {
    let mut ids = vec![DeviceId::Shutter, DeviceId::FilterWheel];
    if view.changer_deg.is_some() {
        ids.push(DeviceId::Changer);
    }
    ids.extend([DeviceId::Tilt, DeviceId::Spin, DeviceId::Camera(view.camera.clone())]);
    ids
}
