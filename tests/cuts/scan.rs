//! The scan that is cut: sixty small frames of two cameras, taken as the recorder takes them, the same each time.

use goniod::archive::disk::{Disk, RealDisk};
use goniod::archive::rows::{EventRow, FrameRow, StepState};
use goniod::archive::verify::verify;
use goniod::archive::{ArchiveError, ArrayLayout, NewRun, RunDir, RunLayout, StepLayout};
use goniod_drivers::frame::{PixelFormat, Pixels};
use goniod_sim::truth::rng::Key;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Exposures of the scan.
const EXPOSURES: u32 = 60;

pub fn layout() -> RunLayout {
    let format = PixelFormat::Mono8;
    let array =
        |camera: &str| ArrayLayout { camera: camera.into(), views: 5, exposures: 6, rows: 8, columns: 16, format };
    let step = |number: u32| StepLayout {
        number,
        view: number / 6,
        camera: if number < EXPOSURES / 2 { "ccd" } else { "ingaas" }.to_owned(),
        array_index: number % (EXPOSURES / 2) / 6,
        exposure_index: number % 6,
        exposure_us: 1000 << (number % 6),
    };
    RunLayout {
        plan_hash: "cuts".to_owned(),
        arrays: vec![array("ccd"), array("ingaas")],
        steps: (0..EXPOSURES).map(step).collect(),
    }
}

/// The frame of a step: the same whenever it is taken.
pub fn pixels(step: u32) -> Pixels {
    let key = Key::new(u64::from(step));
    Pixels::U8((0..128).map(|i| key.bits(i) as u8).collect())
}

pub fn create(runs: &Path, disk: Arc<dyn Disk>) -> Result<RunDir, ArchiveError> {
    let files = [(PathBuf::from("inputs/scan.toml"), b"name = \"cuts\"\n".to_vec())];
    RunDir::create_on(
        runs,
        &NewRun { run_id: "run", plan_toml: "name = \"cuts\"\n", files: &files, layout: &layout() },
        disk,
    )
}

pub fn event(seq: u64, kind: &str) -> EventRow {
    EventRow { seq, utc_us: seq as i64, kind: kind.to_owned(), json: format!("{{\"kind\":\"{kind}\"}}") }
}

/// Takes what is to do, as the recorder does: events, frames, and one step in ten is listed as missing first.
pub fn write(run: &RunDir) -> Result<(), ArchiveError> {
    let (steps, mut seq) = run.with(|j| Ok((j.steps()?, j.next_seq()?)))?;
    for step in steps.iter().filter(|s| s.state == StepState::Planned).map(|s| &s.layout) {
        if step.number % 10 == 3 {
            run.with(|j| j.event(&event(seq, "device-error")))?;
            seq += 1;
        }
        store(run, step, seq)?;
        seq += 1;
    }
    Ok(())
}

pub fn store(run: &RunDir, step: &StepLayout, seq: u64) -> Result<(), ArchiveError> {
    let row = FrameRow {
        step: step.number,
        digest: String::new(),
        bytes: 0,
        utc_us: i64::from(step.number),
        device_frame_id: u64::from(step.number),
        exposure_us: step.exposure_us,
        camera_serial: "S1".to_owned(),
        attempts: 1,
        rejected: 0,
    };
    let place = (step.camera.as_str(), step.array_index, step.exposure_index);
    run.store(place, &pixels(step.number), row, |_| event(seq, "frame-stored")).map(drop)
}

/// What must be the same however often the run was cut: steps, frame rows, every chunk.
pub fn content(run: &Path) -> String {
    let dir = RunDir::open(run).unwrap();
    let (steps, frames) = dir.with(|j| Ok((j.steps()?, j.frames()?))).unwrap();
    let mut text = format!("{steps:?}\n{frames:?}\n");
    for step in layout().steps {
        let path = dir.frames().chunk_path(&step.camera, step.array_index, step.exposure_index);
        text += &format!("{:?}\n", fs::read(path).unwrap());
    }
    text
}

pub fn stored(run: &Path) -> usize {
    RunDir::open(run).unwrap().with(|j| j.summary()).unwrap().stored as usize
}

/// An uninterrupted run.
pub fn reference(folder: &Path) -> String {
    let run = create(&folder.join("reference"), Arc::new(RealDisk)).unwrap();
    write(&run).unwrap();
    run.close().unwrap();
    content(run.path())
}

/// Goes on with a cut run to its end and compares; `committed` frames must have survived.
pub fn goes_on(run: &Path, expected: &str, committed: usize, what: &str) {
    if !run.join("journal.sqlite").exists() {
        assert_eq!(committed, 0, "{what}: the run was there and is gone");
        return;
    }
    let before = verify(run).unwrap();
    assert!(before.sound(), "{what}: {:?}", before.findings);
    assert!(stored(run) >= committed, "{what}: {} of {committed} committed frames are left", stored(run));
    let dir = RunDir::resume(run).unwrap_or_else(|e| panic!("{what}: {e}"));
    write(&dir).unwrap_or_else(|e| panic!("{what}: {e}"));
    dir.close().unwrap_or_else(|e| panic!("{what}: {e}"));
    let report = verify(run).unwrap();
    assert!(report.whole() && report.leftovers.is_empty(), "{what}: {report:?}");
    assert!(content(run) == expected, "{what}: other frames or rows than without the cut");
}
