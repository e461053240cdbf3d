//! What is made good in a run before it is gone on with: frames whose files are damaged or gone are planned again, the
//! store's own metadata is written anew. Any other damage ends it here, because nobody could say what it changed.

use super::error::{ArchiveError, Result};
use super::frames::FRAMES;
use super::rows::EventRow;
use super::rundir::RunDir;
use super::space::BALLAST;
use super::verify::{Finding, verify};
use std::path::Path;

/// What was made good.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Mended {
    /// Steps whose frames are to be taken again.
    pub steps: Vec<u32>,
    /// Files of the store's metadata that were written anew.
    pub files: Vec<String>,
}

/// Proves an unfinished run against its digests, opens it to go on with it and makes good what can be. `told` makes the
/// journal's event for a step planned again, from its number and the event's. Reads every frame once.
///
/// # Errors
/// [`ArchiveError::Damaged`] for damage that cannot be made good, and those of [`verify`] and [`RunDir::resume`].
pub fn resume_mended(path: &Path, told: impl Fn(u32, u64) -> EventRow) -> Result<(RunDir, Mended)> {
    let mended = sort(path, verify(path)?.findings)?;
    let run = RunDir::resume(path)?;
    for (name, bytes) in run.frames().metadata_files()? {
        if mended.files.iter().any(|file| Path::new(file) == name) {
            run.put_back(&name, &bytes)?;
        }
    }
    run.with(|journal| {
        let first = journal.next_seq()?;
        let events: Vec<_> = (first..).zip(&mended.steps).map(|(seq, step)| (*step, told(*step, seq))).collect();
        journal.plan_steps_again(&events)
    })?;
    Ok((run, mended))
}

/// What of the findings can be made good; products are made anew anyway, foreign files harm nobody, but a folder in the
/// place of a frame would stop the run there.
fn sort(path: &Path, findings: Vec<Finding>) -> Result<Mended> {
    let (mut mended, mut beyond) = (Mended::default(), Vec::new());
    for finding in findings {
        match finding {
            Finding::ChunkMissing(step) | Finding::ChunkChanged(step) | Finding::ChunkUnreadable(step) => {
                mended.steps.push(step);
            }
            Finding::FileChanged(name) | Finding::FileMissing(name) if name.starts_with(FRAMES) => {
                mended.files.push(name);
            }
            Finding::ChunkWithoutRow(name) if path.join(&name).is_dir() => {
                let message = "a folder lies in the place of a frame".to_owned();
                let advice = "move it away or remove it, then go on with `goniod resume`";
                return Err(ArchiveError::Damaged { path: path.join(name), message, advice });
            }
            Finding::ChunkWithoutRow(_) | Finding::ProductChanged(_) | Finding::ProductMissing(_) => {}
            Finding::FileChanged(name) if name == BALLAST => {}
            Finding::FileChanged(name) => beyond.push(format!("{name} was changed")),
            Finding::FileMissing(name) => beyond.push(format!("{name} is gone")),
            Finding::RowsDisagree(step) => beyond.push(format!("the rows of step {step} contradict each other")),
            // `RunDir::resume` refuses it, with what can be done.
            Finding::JournalDamaged(_) | Finding::SealBroken(_) => {}
        }
    }
    if beyond.is_empty() {
        return Ok(mended);
    }
    Err(ArchiveError::damaged(path, beyond.join("; ")))
}
