//! The oracle: judges every label of a run on the simulated bench from its files alone.
//!
//! The simulated cameras paint what they really saw into spare rows of each frame; the journal says what it should have
//! been. A step is *lost* when it is neither stored nor listed as missing, or its frame is not where the journal says;
//! *doubled* when the same frame stands under two labels; *mislabelled* when the painting tells of another pose, filter,
//! shutter, exposure or frame counter than the label. A second check knows nothing of the painting: within a bracket
//! counts must rise with exposure as the calibrated response says ([`brackets`]).

pub mod brackets;

use super::bench::{PaintedTruth, read_pixels};
use crate::archive::rows::{FrameRow, StepRow, StepState};
use crate::archive::{ArchiveError, RunDir};
use crate::control::plan::document::RunDocument;
use crate::control::plan::{Step, Subject, View};
use brackets::{BracketFrame, Sensor, Told};
use goniod_drivers::frame::Pixels;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;
use thiserror::Error;

/// Largest difference between commanded and true axis angle, millionths of a degree: two microsteps.
pub const ANGLE_UDEG: f64 = 500.0;

/// Why a run cannot be judged.
#[derive(Debug, Error)]
pub enum OracleError {
    /// The run directory cannot be read.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// Its plan cannot be read.
    #[error("{0}: the plan of this run cannot be read; `goniod verify` tells whether it was changed")]
    Plan(String),
}

/// What the oracle says of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Verdict {
    /// Exposures planned.
    pub planned: usize,
    /// Stored.
    pub stored: usize,
    /// Listed as missing, with a reason.
    pub missing: usize,
    /// Still to do: the run is not over.
    pub to_do: usize,
    /// Stored by the journal, not there in the store; or missing without reason.
    pub lost: Vec<String>,
    /// The same frame under two labels.
    pub doubled: Vec<String>,
    /// Another truth in the picture than on the label.
    pub mislabelled: Vec<String>,
    /// Neighbouring exposures of a bracket whose counts do not rise as the response says.
    pub off_response: Vec<String>,
    /// Pictures of zeros that came for other pictures of zeros (a dark, or the same scene at another exposure): pixel by
    /// pixel what should have come, so that nothing is wrong and nothing could be told.
    pub alike: usize,
    /// Pairs of neighbouring exposures compared by their counts.
    pub pairs: usize,
    /// Those of them that are bright and dim enough for the response to predict one from the other.
    pub pairs_telling: usize,
}

/// Frames and steps of a run, from its files alone.
pub struct Files {
    /// The run directory, opened to read.
    pub dir: RunDir,
    /// Its plan with everything it was made from.
    pub document: RunDocument,
}

/// Steps by what makes a frame itself: its picture and the start of its exposure. (A bench that was switched off counts
/// anew, so that equal pictures at other times are other frames.)
type Seen = BTreeMap<(String, i64), u32>;

/// The bracket that is being read: its view and the frames so far.
type Reading = (Option<u32>, Vec<BracketFrame>);

/// Judges the run at `path`.
///
/// # Errors
/// A run directory or plan that cannot be read; damage of single frames is in the verdict.
pub fn judge(path: &Path) -> Result<Verdict, OracleError> {
    Files::open(path)?.judge()
}

// === impl Verdict ===

impl Verdict {
    /// Every planned exposure is stored once under its true label or listed as missing, as far as the run is.
    pub fn is_clean(&self) -> bool {
        self.faults() == 0 && self.planned == self.stored + self.missing + self.to_do
    }

    /// Lost, doubled, mislabelled and off the response together.
    pub fn faults(&self) -> usize {
        self.lost.len() + self.doubled.len() + self.mislabelled.len() + self.off_response.len()
    }

    /// One line for people, and one for each fault.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "oracle: {} planned = {} stored + {} missing + {} to do; {} lost, {} doubled, {} mislabelled, {} off the response, \
             {} black for black",
            self.planned,
            self.stored,
            self.missing,
            self.to_do,
            self.lost.len(),
            self.doubled.len(),
            self.mislabelled.len(),
            self.off_response.len(),
            self.alike
        )];
        for list in [&self.lost, &self.doubled, &self.mislabelled, &self.off_response] {
            lines.extend(list.iter().cloned());
        }
        lines
    }
}

// === impl Files ===

impl Files {
    /// Opens a run, finished or not.
    ///
    /// # Errors
    /// [`OracleError`].
    pub fn open(path: &Path) -> Result<Files, OracleError> {
        let dir = RunDir::open(path)?;
        let text = dir.plan_toml()?;
        let document = toml::from_str(&text).map_err(|e| OracleError::Plan(format!("{}: {e}", path.display())))?;
        Ok(Files { dir, document })
    }

    /// Steps with their views, in order.
    pub fn steps(&self) -> impl Iterator<Item = (&Step, &View)> {
        let plan = &self.document.plan;
        plan.steps.iter().filter_map(|step| Some((step, plan.views.get(step.view as usize)?)))
    }

    /// The stored frame of a step; `None` where there is none or it cannot be read.
    pub fn pixels(&self, step: &Step, view: &View) -> Option<Pixels> {
        self.dir.frames().read_frame(&view.camera, view.array_index, step.exposure_index).ok().flatten()
    }

    /// Pixels at the top of a view's frames that are painted.
    pub fn reserved_pixels(&self, view: &View) -> usize {
        let rows = self.document.calibrations.get(&view.camera).map_or(0, |c| c.geometry.reserved_rows);
        rows * self.shape(view).0
    }

    /// Judges every step.
    ///
    /// # Errors
    /// A journal that cannot be read.
    pub fn judge(&self) -> Result<Verdict, OracleError> {
        let (rows, frames) = self.dir.with(|j| Ok((j.steps()?, j.frames()?)))?;
        let frames: BTreeMap<u32, FrameRow> = frames.into_iter().map(|f| (f.step, f)).collect();
        let rows: BTreeMap<u32, StepRow> = rows.into_iter().map(|r| (r.layout.number, r)).collect();
        let mut verdict = Verdict { planned: self.document.plan.steps.len(), ..Verdict::default() };
        let (mut seen, mut reading) = (Seen::new(), Reading::default());
        for (step, view) in self.steps() {
            self.begin_bracket(Some(view), &mut reading, &mut verdict);
            match rows.get(&step.number).map(|row| &row.state) {
                None => verdict.lost.push(format!("step {}: the journal does not know it", step.number)),
                Some(StepState::Planned) => verdict.to_do += 1,
                Some(StepState::Missing(reason)) if reason.is_empty() => {
                    verdict.lost.push(format!("step {}: missing without reason", step.number));
                }
                Some(StepState::Missing(_)) => verdict.missing += 1,
                Some(StepState::Stored) => {
                    verdict.stored += 1;
                    self.judge_frame((step, view), frames.get(&step.number), (&mut seen, &mut reading.1), &mut verdict);
                }
            }
        }
        self.begin_bracket(None, &mut reading, &mut verdict);
        Ok(verdict)
    }

    /// Where another bracket begins, the one that was read is judged.
    fn begin_bracket(&self, next: Option<&View>, reading: &mut Reading, verdict: &mut Verdict) {
        if next.map(|view| view.id) == reading.0 {
            return;
        }
        let (before, mut frames) = std::mem::replace(reading, (next.map(|view| view.id), Vec::new()));
        let view = before.and_then(|id| self.document.plan.views.get(id as usize));
        let Some((view, sensor)) = view.and_then(|view| Some((view, self.sensor(view)?))) else { return };
        frames.sort_by_key(|frame| frame.exposure_us);
        for pair in frames.windows(2) {
            let [short, long] = pair else { continue };
            verdict.pairs += 1;
            let told = sensor.compare(short, long);
            verdict.pairs_telling += usize::from(told != Told::Little);
            if let Told::Contradicts(why) = told {
                verdict.off_response.push(format!("view {}: {why}", view.id));
            }
        }
    }

    fn sensor(&self, view: &View) -> Option<Sensor> {
        let camera = self.document.instrument.camera.get(&view.camera)?;
        Sensor::of(camera, self.document.calibrations.get(&view.camera)?)
    }

    fn judge_frame(
        &self,
        (step, view): (&Step, &View),
        row: Option<&FrameRow>,
        (seen, bracket): (&mut Seen, &mut Vec<BracketFrame>),
        verdict: &mut Verdict,
    ) {
        let number = step.number;
        let (Some(row), Some(pixels)) = (row, self.pixels(step, view)) else {
            verdict.lost.push(format!("step {number}: the journal has it, the store has not"));
            return;
        };
        let (width, levels) = self.shape(view);
        let first = self.reserved_pixels(view);
        // A picture of zeros has no painting either where it came for another one; whether there was light to see is for
        // the bracket to tell.
        let (mut found, harmless) = match read_pixels(&pixels, width, levels) {
            Ok(truth) => {
                let found = differences(&truth, (step, view), row.device_frame_id);
                let harmless = view.subject == Subject::Dark || same_pose(&found);
                (found, harmless)
            }
            Err(e) => (vec![e.to_string()], true),
        };
        if !found.is_empty() && harmless && (first..pixels.len()).all(|i| pixels.level(i) == 0) {
            verdict.alike += 1;
            found.clear();
        } else if let Some(other) = seen.insert((row.digest.clone(), row.utc_us), number) {
            verdict.doubled.push(format!("steps {other} and {number}: the same frame"));
        }
        verdict.mislabelled.extend(found.into_iter().map(|what| format!("step {number}: {what}")));
        if view.subject != Subject::Dark {
            let count = pixels.len().saturating_sub(first);
            bracket.push(BracketFrame::of(step.exposure.0, count, |i| pixels.level(first + i)));
        }
    }

    /// Width and levels of a view's frames.
    fn shape(&self, view: &View) -> (usize, u32) {
        let camera = self.document.instrument.camera.get(&view.camera);
        camera.map_or((0, 0), |c| (c.width_px, c.format.levels()))
    }
}

/// How the truth in a picture differs from its label.
pub fn differences(truth: &PaintedTruth, (step, view): (&Step, &View), id: u64) -> Vec<String> {
    let mut found = Vec::new();
    let mut angle = |what: &str, true_udeg: i32, label_deg: f64| {
        if (f64::from(true_udeg) - label_deg * 1e6).abs() > ANGLE_UDEG {
            found.push(format!("{what} {} instead of {label_deg}", f64::from(true_udeg) / 1e6));
        }
    };
    angle("tilt", truth.tilt_udeg, view.tilt_deg);
    angle("spin", truth.spin_udeg, view.spin_deg);
    if let Some(changer_deg) = view.changer_deg {
        angle("changer", truth.changer_udeg, changer_deg);
    }
    let mut same = |what: &str, fits: bool, is: String, label: String| {
        if !fits {
            found.push(format!("{what} {is} instead of {label}"));
        }
    };
    same("slot", truth.slot == Some(view.slot.0), format!("{:?}", truth.slot), view.slot.0.to_string());
    let open = view.subject != Subject::Dark;
    same("shutter open", truth.shutter_open == open, truth.shutter_open.to_string(), open.to_string());
    same("moved", !truth.moved, "during the exposure".to_owned(), "standing".to_owned());
    same("exposure", truth.exposure == step.exposure, truth.exposure.to_string(), step.exposure.to_string());
    same("frame counter", truth.frame == id as u32, truth.frame.to_string(), id.to_string());
    found
}

/// Only exposure or counter differ.
fn same_pose(found: &[String]) -> bool {
    found.iter().all(|what| what.starts_with("exposure") || what.starts_with("frame counter"))
}
