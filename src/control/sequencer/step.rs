//! One exposure: pose, frame, proof, with bounded recovery from what devices do.

use super::recorder::{FrameEntry, Recorder};
use super::recovery::{Decision, decide};
use super::run::Job;
use super::state::Ending;
use crate::archive::rows::FrameRow;
use crate::control::devices::bench::{Bench, DeviceId, Fault};
use crate::control::events::Event;
use crate::control::frames::acquire::{AcquireError, Acquired, Request, acquire};
use crate::control::frames::bracket::Bracket;
use crate::control::frames::guard::StreamHistory;
use crate::control::plan::{Step, Subject, View};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::CameraSettings;
use goniod_drivers::error::{DeviceError, ErrorKind};
use std::collections::{BTreeMap, BTreeSet};

/// How an exposure ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum StepEnd {
    /// Its frame is on its way to the disk.
    Taken,
    /// It cannot be had, for this reason.
    Missing(String),
    /// The run must end.
    End(Ending, String),
}

/// What outlives an exposure.
#[derive(Debug, Default)]
pub(super) struct Memory {
    histories: BTreeMap<String, StreamHistory>,
    bracket: Bracket,
    bracket_view: Option<u32>,
    /// Devices to be opened anew before they are used.
    broken: BTreeSet<DeviceId>,
    /// Exposures given up in a row, by device.
    given_up: BTreeMap<DeviceId, u32>,
}

/// Everything one exposure needs.
pub(super) struct Hands<'a> {
    pub(super) job: &'a Job<'a>,
    pub(super) bench: &'a mut Bench,
    pub(super) memory: &'a mut Memory,
    pub(super) recorder: &'a Recorder,
    pub(super) clock: Clock,
}

enum Failure {
    Fault(Fault),
    Unfit(AcquireError),
}

// === impl Hands ===

impl Hands<'_> {
    /// Opens every device, with the same recovery as an exposure.
    pub(super) async fn check(&mut self) -> Result<(), (Ending, String)> {
        for id in self.bench.ids() {
            let mut failed = 0;
            while let Err(fault) = self.open(&id).await {
                failed += 1;
                match self.recover(fault, failed).await {
                    None => {}
                    Some(StepEnd::End(ending, why)) => return Err((ending, why)),
                    Some(StepEnd::Missing(why)) => return Err((Ending::NotReady, why)),
                    Some(StepEnd::Taken) => break,
                }
            }
        }
        Ok(())
    }

    /// Takes the frame of one step and hands it to the recorder.
    pub(super) async fn take(&mut self, view: &View, step: &Step) -> StepEnd {
        if self.memory.bracket_view != Some(view.id) {
            self.memory.bracket = Bracket::default();
            self.memory.bracket_view = Some(view.id);
        }
        let (mut failed, mut rejected) = (0, 0);
        loop {
            match self.try_once(view, step, &mut rejected).await {
                Ok(acquired) => {
                    for id in needed(view) {
                        self.memory.given_up.remove(&id);
                    }
                    self.keep(view, step, acquired, rejected).await;
                    return StepEnd::Taken;
                }
                Err(Failure::Unfit(error)) => return StepEnd::Missing(error.to_string()),
                Err(Failure::Fault(fault)) => {
                    failed += 1;
                    let device = fault.device.clone();
                    if let Some(end) = self.recover(fault, failed).await {
                        *self.memory.given_up.entry(device).or_default() += 1;
                        return end;
                    }
                }
            }
        }
    }

    /// Decides about a fault and waits where it is to be tried again; `Some` when it is not.
    async fn recover(&mut self, fault: Fault, failed: u32) -> Option<StepEnd> {
        let Fault { device, error } = fault;
        let given_up = self.memory.given_up.get(&device).copied().unwrap_or(0);
        let decision = decide(error.kind, failed, self.job.retries, given_up);
        let sentence = match decision {
            Decision::Retry { after, reopen: true } => format!("opened anew in {} s", after.as_secs()),
            Decision::Retry { after, reopen: false } => format!("tried again in {} s", after.as_secs()),
            Decision::GiveUp => "given up for this exposure".to_owned(),
            Decision::End => "the run ends".to_owned(),
        };
        let (name, message) = (device.to_string(), error.to_string());
        let kind = error.kind.into();
        self.recorder.event(Event::DeviceError { device: name, error: kind, message, decision: sentence }).await;
        if error.kind != ErrorKind::Busy {
            self.bench.forget(&device);
            self.memory.broken.insert(device.clone());
        }
        match decision {
            Decision::Retry { after, .. } => {
                self.clock.sleep(after).await;
                None
            }
            Decision::GiveUp => Some(StepEnd::Missing(format!("{device}: {error}"))),
            Decision::End => Some(StepEnd::End(Ending::DeviceRefused, format!("{device}: {error}"))),
        }
    }

    async fn try_once(&mut self, view: &View, step: &Step, rejected: &mut u32) -> Result<Acquired, Failure> {
        for id in needed(view) {
            if self.memory.broken.contains(&id) {
                self.open(&id).await.map_err(Failure::Fault)?;
            }
        }
        self.bench.pose_for(view, self.clock).await.map_err(Failure::Fault)?;
        let acquired = self.acquire(view, step, rejected).await?;
        self.bench.prove(view, self.clock).await.map_err(Failure::Fault)?;
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
        let taken = acquire(camera.as_mut(), history, &request, self.clock, &mut reasons).await;
        *rejected += reasons.len() as u32;
        for reason in reasons {
            self.recorder.event(Event::FrameRejected { step: step.number, reason }).await;
        }
        taken.map_err(|e| match e {
            AcquireError::Device(error) => Failure::Fault(Fault { device: id, error }),
            unfit @ AcquireError::Rejected { .. } => Failure::Unfit(unfit),
        })
    }

    async fn open(&mut self, id: &DeviceId) -> Result<(), Fault> {
        let identity = self.bench.open(id, self.clock).await?;
        self.memory.broken.remove(id);
        if let DeviceId::Camera(name) = id {
            self.memory.histories.entry(name.clone()).or_default().reopened();
        }
        self.recorder.event(Event::DeviceOpened { device: id.to_string(), identity }).await;
        Ok(())
    }

    async fn keep(&mut self, view: &View, step: &Step, acquired: Acquired, rejected: u32) {
        let Acquired { frame, picture, attempts } = acquired;
        self.memory.bracket.add(step.exposure, picture);
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
        let place = (view.camera.clone(), view.array_index, step.exposure_index);
        self.recorder.frame(FrameEntry { place, frame, row }).await;
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
