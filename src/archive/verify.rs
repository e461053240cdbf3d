//! Proves a run whole: every file, chunk and row against the digests taken when it was written.

use super::disk::{Disk, TEMPORARY_PREFIX, read_where_there};
use super::error::{ArchiveError, Result};
use super::frames::FRAMES;
use super::journal::Journal;
use super::marks;
use super::rows::{FileRow, FrameRow, StepRow, StepState, Summary};
use super::rundir::{JOURNAL, RunDir};
use super::seal::{PRODUCTS, PRODUCTS_SEAL, ProductFault, SEAL, check_products, frames_digest, journal_seal};
use super::space::{BALLAST, ballast_changed};
use crate::digest::{sha256_hex, sha256_of_file};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// What to do where the end of the log is lost.
const TAKE_AGAIN: &str =
    "`goniod verify` lists it, and `goniod resume RUN --accept-loss` takes the exposures whose rows are lost again";

/// One thing that is not as it was written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Finding {
    /// A file copied in at the start (plan, calibration, array metadata) has other bytes.
    FileChanged(String),
    /// A file copied in at the start is gone.
    FileMissing(String),
    /// A stored step's chunk is gone.
    ChunkMissing(u32),
    /// A stored step's chunk has other bytes.
    ChunkChanged(u32),
    /// A stored step's chunk has the right bytes and yet gives no frame.
    ChunkUnreadable(u32),
    /// A file in the frame store that no row speaks of.
    ChunkWithoutRow(String),
    /// Step and frame rows contradict each other.
    RowsDisagree(u32),
    /// SQLite finds damage, or the journal cannot be read.
    JournalDamaged(String),
    /// A product has other bytes than were written.
    ProductChanged(String),
    /// A sealed product is gone.
    ProductMissing(String),
    /// The closed journal or the seal of the products is not as it was sealed.
    SealBroken(String),
}

/// What `verify` found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verification {
    /// Damage; empty for a sound run.
    pub findings: Vec<Finding>,
    /// Steps by state, as the journal tells.
    pub summary: Summary,
    /// Steps that the run has.
    pub steps: u32,
    /// The journal was closed and sealed; false while a run is under way or after it was cut short.
    pub sealed: bool,
    /// Unfinished writes of a run that was cut short; harmless.
    pub leftovers: Vec<String>,
    /// What nothing is left to prove it by, as a cut may leave it, and products of other frames than the run has now; each
    /// a sentence without its end.
    pub unproven: Vec<String>,
}

// === impl Verification ===

impl Verification {
    /// Nothing that was written is changed or lost.
    pub fn sound(&self) -> bool {
        self.findings.is_empty()
    }

    /// Sound, closed, proven, and every planned exposure is stored or listed as missing.
    pub fn whole(&self) -> bool {
        self.sound()
            && self.sealed
            && self.unproven.is_empty()
            && self.summary.planned == 0
            && self.summary.stored + self.summary.missing == self.steps
    }
}

/// Reads everything in a run directory and compares; writes nothing.
///
/// # Errors
/// [`ArchiveError::NotARun`] for a folder without journal, [`ArchiveError::Io`] when a folder cannot be read. Damage is no
/// error: it is in the report.
pub fn verify(path: &Path) -> Result<Verification> {
    let mut report = verify_journal(path)?;
    if !report.sealed && ballast_changed(path) {
        report.findings.push(Finding::FileChanged(BALLAST.to_owned()));
    }
    let checked = check_run(path, &mut report);
    told(checked, &mut report)?;
    Ok(report)
}

/// As [`verify`], of the journal alone: its file, log, marks and seal.
///
/// # Errors
/// As [`verify`].
fn verify_journal(path: &Path) -> Result<Verification> {
    if !path.join(JOURNAL).is_file() {
        let message = format!("there is no {JOURNAL} in it");
        return Err(ArchiveError::NotARun { path: path.to_path_buf(), message });
    }
    let mut report = Verification { sealed: path.join(SEAL).exists(), ..Verification::default() };
    let checked = check_journal(path, &mut report);
    told(checked, &mut report)?;
    Ok(report)
}

/// Proves the journal at `path` as it was written, so that the run may be gone on with.
///
/// # Errors
/// [`ArchiveError::Damaged`] for any damage, else as [`verify`].
pub fn journal_must_be_sound(path: &Path) -> Result<()> {
    let report = verify_journal(path)?;
    let words = |finding: &Finding| match finding {
        Finding::JournalDamaged(what) | Finding::SealBroken(what) => what.clone(),
        other => format!("{other:?}"),
    };
    let found: Vec<String> = report.findings.iter().map(words).collect();
    if found.is_empty() {
        return Ok(());
    }
    let (journal, message) = (path.join(JOURNAL), found.join("; "));
    if only_of_log(path, &report)? {
        return Err(ArchiveError::Damaged { path: journal, message, advice: TAKE_AGAIN });
    }
    Err(ArchiveError::damaged(&journal, message))
}

/// Proves journal, plan and inputs as they were written, so that products may be made from them; frames are proven where
/// they are read.
///
/// # Errors
/// As [`journal_must_be_sound`].
pub fn records_must_be_sound(path: &Path) -> Result<()> {
    journal_must_be_sound(path)?;
    let files = RunDir::open(path)?.with(|journal| journal.files())?;
    let not_frames: Vec<FileRow> = files.into_iter().filter(|file| !file.path.starts_with(FRAMES)).collect();
    match changed(path, &not_frames)?.first() {
        Some(Finding::FileMissing(name)) => Err(ArchiveError::damaged(path, format!("{name} is gone"))),
        Some(Finding::FileChanged(name)) => Err(ArchiveError::damaged(path, format!("{name} was changed"))),
        _ => Ok(()),
    }
}

/// Files of a run that are not as their rows tell.
///
/// # Errors
/// One that is there and cannot be read: nobody knows whether it is changed.
fn changed(path: &Path, files: &[FileRow]) -> Result<Vec<Finding>> {
    let mut found = Vec::new();
    for file in files {
        match read_where_there(&path.join(&file.path))? {
            Some(bytes) if sha256_hex(&bytes) == file.digest => {}
            Some(_) => found.push(Finding::FileChanged(file.path.clone())),
            None => found.push(Finding::FileMissing(file.path.clone())),
        }
    }
    Ok(found)
}

/// Where only the end of an open journal's log is damaged, lets as much count as is whole: the exposures whose rows are lost
/// are planned again. Any other damage stays.
///
/// # Errors
/// As [`verify`], and the disk's kinds.
pub fn accept_loss(path: &Path, disk: &dyn Disk) -> Result<()> {
    let report = verify_journal(path)?;
    if only_of_log(path, &report)? { marks::accept_end(&path.join(JOURNAL), disk) } else { Ok(()) }
}

/// True where the log, or the mark of its end, is all that is damaged.
fn only_of_log(path: &Path, report: &Verification) -> Result<bool> {
    let damage = if report.sealed { Vec::new() } else { marks::check(&path.join(JOURNAL))? };
    Ok(!damage.is_empty() && damage.iter().all(|d| d.of_log) && damage.len() == report.findings.len())
}

/// Takes damage that ended a check into the report.
fn told(checked: Result<()>, report: &mut Verification) -> Result<()> {
    match checked {
        Ok(()) => {}
        Err(e @ (ArchiveError::Io { .. } | ArchiveError::Failing { .. })) => return Err(e),
        Err(damage) => report.findings.push(Finding::JournalDamaged(damage.to_string())),
    }
    Ok(())
}

fn check_journal(path: &Path, report: &mut Verification) -> Result<()> {
    let file = path.join(JOURNAL);
    let seal = read_where_there(&path.join(SEAL))?.unwrap_or_default();
    let digest = sha256_of_file(&file).map_err(|e| ArchiveError::io("read", &file, &e))?;
    let journal = Journal::open_read_only(&file)?;
    if !report.sealed {
        report.findings.extend(marks::check(&file)?.into_iter().map(|damage| Finding::JournalDamaged(damage.what)));
        report.unproven.extend(marks::nothing_to_prove_by(&file));
    }
    let damage = journal.integrity()?;
    report.findings.extend(damage.into_iter().map(Finding::JournalDamaged));
    if report.sealed && seal != journal_seal(&digest, &journal.row_digest()?).as_bytes() {
        let message = format!("{JOURNAL} or {SEAL} was changed after the run was closed");
        report.findings.push(Finding::SealBroken(message));
    }
    Ok(())
}

fn check_run(path: &Path, report: &mut Verification) -> Result<()> {
    if report.findings.iter().any(|f| matches!(f, Finding::JournalDamaged(_))) {
        return Ok(());
    }
    let run = RunDir::open(path)?;
    let (steps, frames, files, summary) = run.with(|j| Ok((j.steps()?, j.frames()?, j.files()?, j.summary()?)))?;
    report.summary = summary;
    report.steps = steps.len() as u32;
    report.findings.extend(changed(path, &files)?);
    let mut known: BTreeSet<PathBuf> =
        files.iter().map(|f| path.join(&f.path)).filter(|f| f.starts_with(path.join(FRAMES))).collect();
    let frames: BTreeMap<u32, FrameRow> = frames.into_iter().map(|f| (f.step, f)).collect();
    for step in &steps {
        check_step(&run, step, frames.get(&step.layout.number), &mut known, report)?;
    }
    for step in frames.keys().filter(|n| !steps.iter().any(|s| s.layout.number == **n)) {
        report.findings.push(Finding::RowsDisagree(*step));
    }
    check_orphans(path, &path.join(FRAMES), &known, report)?;
    for fault in check_products(path, &frames_digest(frames.values()))? {
        tell_product(fault, report);
    }
    Ok(())
}

fn tell_product(fault: ProductFault, report: &mut Verification) {
    let again = "`goniod reduce RUN` makes them again";
    let unproven = match fault {
        ProductFault::Seal => {
            let what = format!("{PRODUCTS}/{PRODUCTS_SEAL} was changed");
            return report.findings.push(Finding::SealBroken(what));
        }
        ProductFault::Changed(name) => return report.findings.push(Finding::ProductChanged(name)),
        ProductFault::Missing(name) => return report.findings.push(Finding::ProductMissing(name)),
        ProductFault::NoSeal => format!("{PRODUCTS} have no {PRODUCTS_SEAL}; {again}"),
        ProductFault::OtherFrames => format!("the products were made from other frames; {again}"),
    };
    report.unproven.push(unproven);
}

fn check_step(
    run: &RunDir,
    step: &StepRow,
    frame: Option<&FrameRow>,
    known: &mut BTreeSet<PathBuf>,
    report: &mut Verification,
) -> Result<()> {
    let at = &step.layout;
    let path = run.frames().chunk_path(&at.camera, at.array_index, at.exposure_index);
    let there = fs::metadata(&path).ok();
    let name = path.strip_prefix(run.path()).unwrap_or(&path).to_string_lossy().into_owned();
    let foreign = there.as_ref().is_some_and(|meta| !meta.is_file());
    if foreign {
        // A folder: no frame could be written in its place.
        report.findings.push(Finding::ChunkWithoutRow(name.clone()));
    }
    let frame = match (&step.state, frame) {
        (StepState::Stored, Some(frame)) => frame,
        (StepState::Stored, None) | (_, Some(_)) => {
            report.findings.push(Finding::RowsDisagree(at.number));
            return Ok(());
        }
        (StepState::Planned, None) => {
            // Written when the run was cut short, before its row was: the step stays to be done and writes it anew.
            if there.is_some() && !foreign {
                report.leftovers.push(name);
                known.insert(path);
            }
            return Ok(());
        }
        (StepState::Missing(_), None) => return Ok(()),
    };
    if foreign {
        report.findings.push(Finding::ChunkMissing(at.number));
        return Ok(());
    }
    let length = there.map_or(frame.bytes, |meta| meta.len());
    match run.frames().read_proven(&at.camera, at.array_index, at.exposure_index, &frame.digest) {
        Ok(None) => report.findings.push(Finding::ChunkMissing(at.number)),
        // It may be as good as ever, so it is not given up.
        Err(e @ (ArchiveError::Io { .. } | ArchiveError::Failing { .. })) => return Err(e),
        Err(ArchiveError::Damaged { .. }) => report.findings.push(Finding::ChunkChanged(at.number)),
        Ok(Some(_)) if length != frame.bytes => report.findings.push(Finding::ChunkChanged(at.number)),
        Ok(Some(_)) => {}
        Err(_) => report.findings.push(Finding::ChunkUnreadable(at.number)),
    }
    known.insert(path);
    Ok(())
}

fn check_orphans(run: &Path, folder: &Path, known: &BTreeSet<PathBuf>, report: &mut Verification) -> Result<()> {
    let read = |e: &std::io::Error| ArchiveError::io("read the folder", folder, e);
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(|e| read(&e))? {
        paths.push(entry.map_err(|e| read(&e))?.path());
    }
    paths.sort();
    for path in paths {
        if path.is_dir() {
            check_orphans(run, &path, known, report)?;
        } else if !known.contains(&path) {
            let name = path.strip_prefix(run).unwrap_or(&path).to_string_lossy().into_owned();
            let temporary = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(TEMPORARY_PREFIX));
            if temporary {
                report.leftovers.push(name);
            } else {
                report.findings.push(Finding::ChunkWithoutRow(name));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::archive::mend::resume_mended;
    use crate::archive::rows::EventRow;
    use crate::archive::{ArrayLayout, NewRun, RunLayout, StepLayout};
    use goniod_drivers::frame::{PixelFormat, Pixels};

    fn layout() -> RunLayout {
        let format = PixelFormat::BayerRggb8;
        let camera = "ccd".to_owned();
        let step = |number| StepLayout {
            number,
            view: 0,
            camera: camera.clone(),
            array_index: 0,
            exposure_index: number,
            exposure_us: 1000 << number,
        };
        RunLayout {
            plan_hash: "abc".to_owned(),
            arrays: vec![ArrayLayout { camera: camera.clone(), views: 1, exposures: 3, rows: 4, columns: 4, format }],
            steps: (0..3).map(step).collect(),
        }
    }

    fn row(step: u32) -> FrameRow {
        FrameRow {
            step,
            digest: String::new(),
            bytes: 0,
            utc_us: 1_000_000 + i64::from(step),
            device_frame_id: u64::from(step),
            exposure_us: 1000,
            camera_serial: "S1".to_owned(),
            attempts: 1,
            rejected: 0,
        }
    }

    fn event(seq: u64) -> EventRow {
        EventRow { seq, utc_us: 5, kind: "frame-stored".to_owned(), json: "{}".to_owned() }
    }

    fn begun(runs: &Path) -> RunDir {
        RunDir::create(runs, &NewRun { run_id: "r", plan_toml: "", files: &[], layout: &layout() }).unwrap()
    }

    fn closed_run(runs: &Path) -> PathBuf {
        let files = [(PathBuf::from("calibration/ccd.toml"), b"version = 1\n".to_vec())];
        let new = NewRun { run_id: "night", plan_toml: "name = \"x\"\n", files: &files, layout: &layout() };
        let run = RunDir::create(runs, &new).unwrap();
        for step in 0..2 {
            let pixels = Pixels::U8((0..16).map(|i| i * 3 + step as u8).collect());
            run.store(("ccd", 0, step), &pixels, row(step), |_| event(u64::from(step))).unwrap();
        }
        run.with(|j| j.step_missing(2, "the camera was lost", &event(2))).unwrap();
        run.close().unwrap();
        run.path().to_path_buf()
    }

    fn all_files(folder: &Path) -> Vec<PathBuf> {
        let mut files = Vec::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() { files.extend(all_files(&path)) } else { files.push(path) }
        }
        files.sort();
        files
    }

    #[test]
    fn a_finished_run_is_whole_and_reading_it_leaves_no_trace() {
        let runs = tempfile::tempdir().unwrap();
        let path = closed_run(runs.path());
        let before = all_files(&path);
        let report = verify(&path).unwrap();
        assert!(report.whole(), "{report:?}");
        assert_eq!((report.summary.stored, report.summary.missing, report.summary.planned), (2, 1, 0));
        let run = RunDir::open(&path).unwrap();
        assert!(run.frames().read_frame("ccd", 0, 1).unwrap().is_some());
        assert!(run.frames().read_frame("ccd", 0, 2).unwrap().is_none());
        run.close().unwrap();
        assert_eq!(all_files(&path), before);
        assert!(!before.iter().any(|f| f.to_string_lossy().ends_with("-wal")));
    }

    #[test]
    fn every_flipped_bit_in_every_file_is_found() {
        let runs = tempfile::tempdir().unwrap();
        let path = closed_run(runs.path());
        for file in all_files(&path) {
            let good = fs::read(&file).unwrap();
            // Every bit of the small files, a spread of bits over the larger ones and all pages of the journal.
            let stride = match good.len() {
                0..=128 => 1,
                129..=4096 => 31,
                _ => 4099,
            };
            for bit in (0..good.len() * 8).step_by(stride) {
                let mut bad = good.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                fs::write(&file, &bad).unwrap();
                let report = verify(&path).unwrap();
                assert!(!report.sound(), "{} bit {bit}", file.display());
            }
            fs::write(&file, &good).unwrap();
        }
        assert!(verify(&path).unwrap().whole());
    }

    #[test]
    fn lost_and_foreign_chunks_are_found_and_unfinished_writes_are_harmless() {
        let runs = tempfile::tempdir().unwrap();
        let path = closed_run(runs.path());
        let chunk = path.join("frames.zarr/ccd/c.0.0.0.0");
        fs::write(path.join("frames.zarr/ccd/.tmp-c.0.2.0.0"), b"cut").unwrap();
        assert!(verify(&path).unwrap().whole());
        fs::copy(&chunk, path.join("frames.zarr/ccd/c.0.2.0.0")).unwrap();
        fs::remove_file(&chunk).unwrap();
        let findings = verify(&path).unwrap().findings;
        let foreign = Finding::ChunkWithoutRow("frames.zarr/ccd/c.0.2.0.0".to_owned());
        assert_eq!(findings, [Finding::ChunkMissing(0), foreign]);
    }

    #[test]
    fn a_run_cut_short_is_sound_but_not_whole_until_it_is_gone_on_with() {
        let runs = tempfile::tempdir().unwrap();
        let run = begun(runs.path());
        run.store(("ccd", 0, 0), &Pixels::U8(vec![9; 16]), row(0), |_| event(0)).unwrap();
        let path = run.path().to_path_buf();
        // Killed between a frame and its row.
        run.frames().put_frame("ccd", 0, 1, &Pixels::U8(vec![7; 16])).unwrap();
        drop(run);
        let report = verify(&path).unwrap();
        assert!(report.sound() && !report.sealed && !report.whole(), "{report:?}");
        assert_eq!(report.leftovers, ["frames.zarr/ccd/c.0.1.0.0"]);
        fs::remove_file(path.join("frames.zarr/ccd/c.0.1.0.0")).unwrap();
        let run = RunDir::resume(&path).unwrap();
        assert_eq!(run.with(|j| j.next_seq()).unwrap(), 1);
        run.with(|j| j.step_missing(1, "x", &event(1))).unwrap();
        run.with(|j| j.step_missing(2, "x", &event(2))).unwrap();
        run.close().unwrap();
        assert!(verify(&path).unwrap().whole());
    }

    #[test]
    fn a_run_whose_folder_is_moved_away_takes_no_more_frames_and_makes_no_folder_anew() {
        let runs = tempfile::tempdir().unwrap();
        let run = begun(runs.path());
        let (here, elsewhere) = (run.path().to_path_buf(), runs.path().join("elsewhere"));
        let store = |run: &RunDir, step: u32| {
            let (pixels, told) = (Pixels::U8(vec![1; 16]), event(u64::from(step)));
            run.store(("ccd", 0, step), &pixels, row(step), |_| told).map(drop)
        };
        let moved = |end: Result<()>| {
            assert!(matches!(end, Err(ArchiveError::Moved { .. })), "{end:?}");
            assert!(!here.exists());
            fs::rename(&elsewhere, &here).unwrap();
        };
        fs::rename(&here, &elsewhere).unwrap();
        moved(store(&run, 0));
        store(&run, 0).unwrap();
        fs::rename(&here, &elsewhere).unwrap();
        moved(run.close());
        drop(run);
        // Put back it is what a killed process leaves: sound, and gone on with.
        let report = verify(&here).unwrap();
        assert!(report.sound() && report.unproven.is_empty() && !report.sealed, "{report:?}");
        assert_eq!((report.summary.stored, report.summary.planned), (1, 2));
        let run = RunDir::resume(&here).unwrap();
        store(&run, 1).and_then(|()| store(&run, 2)).and_then(|()| run.close()).unwrap();
        assert!(verify(&here).unwrap().whole());
    }

    #[test]
    fn what_is_there_and_cannot_be_read_is_neither_gone_nor_changed() {
        let runs = tempfile::tempdir().unwrap();
        let path = closed_run(runs.path());
        for file in ["frames.zarr/ccd/c.0.0.0.0", "calibration/ccd.toml"] {
            let (file, aside) = (path.join(file), runs.path().join("aside"));
            fs::rename(&file, &aside).unwrap();
            // A link to itself: an error of the file system that whoever runs this meets.
            std::os::unix::fs::symlink(&file, &file).unwrap();
            let refused = verify(&path);
            assert!(matches!(refused, Err(ArchiveError::Io { .. })), "{refused:?}");
            fs::rename(&aside, &file).unwrap();
        }
        assert!(verify(&path).unwrap().whole());
    }

    #[test]
    fn a_folder_in_the_place_of_a_frame_is_found_and_named_before_the_run_goes_on() {
        let runs = tempfile::tempdir().unwrap();
        let run = begun(runs.path());
        run.store(("ccd", 0, 0), &Pixels::U8(vec![9; 16]), row(0), |_| event(0)).unwrap();
        let path = run.path().to_path_buf();
        drop(run);
        let (stored, planned) = ("frames.zarr/ccd/c.0.0.0.0", "frames.zarr/ccd/c.0.1.0.0");
        let go_on = || resume_mended(&path, |_, seq| event(seq)).map(drop);
        fs::create_dir(path.join(planned)).unwrap();
        assert_eq!(verify(&path).unwrap().findings, [Finding::ChunkWithoutRow(planned.to_owned())]);
        let told = go_on().unwrap_err().to_string();
        assert!(told.contains(planned) && told.contains("remove it"), "{told}");
        fs::remove_dir(path.join(planned)).unwrap();
        fs::remove_file(path.join(stored)).unwrap();
        fs::create_dir(path.join(stored)).unwrap();
        let found = verify(&path).unwrap().findings;
        assert_eq!(found, [Finding::ChunkWithoutRow(stored.to_owned()), Finding::ChunkMissing(0)]);
        assert!(go_on().unwrap_err().to_string().contains(stored));
        fs::remove_dir(path.join(stored)).unwrap();
        go_on().unwrap();
    }

    #[test]
    fn two_equal_runs_give_byte_equal_files() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (one, two) = (closed_run(a.path()), closed_run(b.path()));
        let (files_one, files_two) = (all_files(&one), all_files(&two));
        assert_eq!(files_one.len(), files_two.len());
        for (x, y) in files_one.iter().zip(&files_two) {
            assert_eq!(x.strip_prefix(&one).unwrap(), y.strip_prefix(&two).unwrap());
            assert_eq!(fs::read(x).unwrap(), fs::read(y).unwrap(), "{}", x.display());
        }
    }

    #[test]
    fn a_run_is_made_once_and_whole_or_not_at_all() {
        let runs = tempfile::tempdir().unwrap();
        closed_run(runs.path());
        let files = [(PathBuf::from("../out"), Vec::new())];
        let make =
            |run_id, files| RunDir::create(runs.path(), &NewRun { run_id, plan_toml: "", files, layout: &layout() });
        assert!(matches!(make("night", &[]).err().unwrap(), ArchiveError::Exists { .. }));
        assert!(matches!(make("a/b", &[]).err().unwrap(), ArchiveError::BadRunId { .. }));
        assert!(matches!(make("other", &files).err().unwrap(), ArchiveError::BadPath { .. }));
        let left: Vec<_> = fs::read_dir(runs.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["night"]);
        let file = runs.path().join("file");
        fs::write(&file, b"").unwrap();
        let none = RunDir::create(&file, &NewRun { run_id: "x", plan_toml: "", files: &[], layout: &layout() });
        assert!(none.err().unwrap().to_string().contains("file"));
    }
}
