//! A bench with sensors just large enough for the painted truth, and nights on it in simulated time.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use super::common::Lab;
use goniod::archive::disk::{Disk, RealDisk};
use goniod::archive::{NewRun, RunDir};
use goniod::config::check::{Checked, Options, check};
use goniod::control::events::EventBus;
use goniod::control::plan::Plan;
use goniod::control::plan::document::RunDocument;
use goniod::control::sequencer::layout::layout;
use goniod::control::sequencer::run::Outcome;
use goniod::front::bench::{Opened, Rehearsal, Schedule, open_simulated};
use goniod::front::night::{self, Night};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_sim::faults::Counts;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::mpsc;

/// Both cameras with 224 x 64 pixels: 16 rows of painted truth over 48 rows of picture.
const TINY: [(&str, &str); 10] = [
    ("width_px = 1392", "width_px = 224"),
    ("height_px = 1040", "height_px = 64"),
    ("centre_x_px = 695.5", "centre_x_px = 111.5"),
    ("centre_y_px = 527.5", "centre_y_px = 39.5"),
    ("deg_per_px = 0.1886", "deg_per_px = 4.0"),
    ("width_px = 320", "width_px = 224"),
    ("height_px = 256", "height_px = 64"),
    ("centre_x_px = 159.5", "centre_x_px = 111.5"),
    ("centre_y_px = 135.5", "centre_y_px = 39.5"),
    ("deg_per_px = 0.7995", "deg_per_px = 4.0"),
];

/// Start of every night: the year 2026 in microseconds.
const EVENING: UtcMicros = UtcMicros(1_770_000_000_000_000);

/// A lab with tiny sensors, its runs in memory where the machine offers that.
pub struct Tiny {
    pub lab: Lab,
    pub runs: tempfile::TempDir,
    pub checked: Checked,
}

/// A night that is over.
pub struct Over {
    pub path: PathBuf,
    pub outcome: Outcome,
    pub counts: Counts,
    /// Simulated time it took.
    pub took: Duration,
}

/// A scan with `directions` directions, both transmission and reflection, both cameras.
pub fn scan_text(directions: usize) -> String {
    let list: Vec<String> = (0..directions).map(|i| format!("[{}, {}]", 4 + i % 9 * 8, (i * 37) % 360)).collect();
    format!(
        "name = \"night\"\n[sample]\nthickness_mm = 4.0\nsimulated = \"../sim/samples/lambertian_t20.toml\"\n\
         [incidence]\ndirections = [{}]\nsides = [\"transmission-front\", \"reflection-front\"]\n\
         [bands]\nuse = [\"f3\", \"f5\", \"nir1\"]\n\
         [exposure]\npolicy = \"ladder\"\nratio = 8.0\nshortest_s = 0.004\nlongest_s = 2.5\n\
         [dark]\nevery_directions = 8\nframes = 1\n[reference]\nevery_directions = 8\n",
        list.join(", ")
    )
}

// === impl Tiny ===

impl Tiny {
    /// The lab with this scan.
    pub fn new(scan: &str) -> Tiny {
        let lab = Lab::shipped();
        for file in ["instrument.sim.toml", "sim/bench.toml", "calibration/ccd.sim.toml", "calibration/ingaas.sim.toml"]
        {
            lab.edit(file, &TINY, false);
        }
        Tiny::of(lab, scan)
    }

    /// A prepared lab with this scan.
    pub fn of(lab: Lab, scan: &str) -> Tiny {
        let scan = lab.scan("night.toml", scan);
        let options = Options { drivers: Vec::new(), today: jiff::civil::date(2026, 3, 4) };
        let checked = check(&scan, &lab.instrument(), &options).unwrap_or_else(|e| panic!("{e}"));
        Tiny { lab, runs: memory_folder(), checked }
    }

    /// The plan.
    pub fn plan(&self) -> Plan {
        night::plan(&self.checked).unwrap_or_else(|e| panic!("{:?}", e.messages))
    }

    /// One night from its beginning, in simulated time, in a folder of its own.
    pub fn night(&self, seed: u64, schedule: &Schedule, disk: Arc<dyn Disk>) -> Over {
        let runs = self.runs.path().join(format!("{seed}-{}", schedule.entries.len()));
        self.run(seed, schedule, |clock, plan, _| {
            let night = self.prepare(&runs, plan, clock, seed, disk);
            (night.run.clone(), night)
        })
    }

    /// Goes on with a run.
    pub fn resume(&self, path: &Path, seed: u64, disk: Arc<dyn Disk>) -> Over {
        self.run(seed, &Schedule { entries: Vec::new() }, |_, plan, _| {
            let run = Arc::new(RunDir::resume_on(path, disk).unwrap());
            run.with(|j| j.plan_missing_again()).unwrap();
            (run.clone(), night_of(plan, run, path.to_owned()))
        })
    }

    fn prepare(&self, runs: &Path, plan: Plan, clock: Clock, seed: u64, disk: Arc<dyn Disk>) -> Night {
        let checked = &self.checked;
        let document = RunDocument {
            run_id: "night".to_owned(),
            goniod_version: "test".to_owned(),
            simulated_seed: Some(seed),
            virtual_time: true,
            started: night::stamp(clock.utc()).to_string(),
            files: Vec::new(),
            scan: checked.scan.clone(),
            instrument: checked.instrument.clone(),
            calibrations: checked.calibrations.clone(),
            plan: plan.clone(),
        };
        let text = toml::to_string(&document).unwrap();
        let shape = layout(&plan, &checked.instrument.camera).unwrap();
        let new = NewRun { run_id: "night", plan_toml: &text, files: &[], layout: &shape };
        let run = Arc::new(RunDir::create_on(runs, &new, disk).unwrap());
        night_of(plan, run, runs.join("night"))
    }

    fn run(
        &self,
        seed: u64,
        schedule: &Schedule,
        begin: impl FnOnce(Clock, Plan, &Opened) -> (Arc<RunDir>, Night),
    ) -> Over {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
        runtime.block_on(async {
            let clock = Clock::starting_at(EVENING);
            let rehearsal = Rehearsal { seed: Some(seed), ..Rehearsal::default() };
            let mut opened = open_simulated(&self.checked, &rehearsal, clock).unwrap();
            let (run, night) = begin(clock, self.plan(), &opened);
            drop(run);
            let (verbs, asked) = mpsc::channel(8);
            let faults = opened.faults.as_ref().unwrap();
            let counts = faults.carry_out(schedule.clone(), verbs, clock);
            let outcome = night::measure(&self.checked, &night, &mut opened, clock, asked, &EventBus::default()).await;
            let outcome = outcome.unwrap_or_else(|e| panic!("{:?}", e.messages));
            Over { path: night.path, outcome, counts, took: clock.elapsed() }
        })
    }
}

fn night_of(plan: Plan, run: Arc<RunDir>, path: PathBuf) -> Night {
    let lock = night::hold(&path).unwrap_or_else(|e| panic!("{:?}", e.messages));
    Night { plan, run, path, serials: BTreeMap::new(), lock }
}

/// No faults.
pub fn quiet() -> Schedule {
    Schedule { entries: Vec::new() }
}

/// The real disk.
pub fn real() -> Arc<dyn Disk> {
    Arc::new(RealDisk)
}

/// A temporary folder in memory where the machine has one, else on the disk.
pub fn memory_folder() -> tempfile::TempDir {
    let shm = Path::new("/dev/shm");
    if shm.is_dir() { tempfile::tempdir_in(shm).unwrap() } else { tempfile::tempdir().unwrap() }
}

/// A disk that takes its time over each write, and counts them.
pub struct SlowDisk {
    pause: Duration,
    writes: AtomicU64,
}

// === impl SlowDisk ===

impl SlowDisk {
    pub fn new(pause: Duration) -> SlowDisk {
        SlowDisk { pause, writes: AtomicU64::new(0) }
    }

    pub fn writes(&self) -> u64 {
        self.writes.load(Ordering::SeqCst)
    }
}

impl Disk for SlowDisk {
    fn append(&self, file: &mut File, _: &Path, bytes: &[u8]) -> io::Result<()> {
        self.writes.fetch_add(1, Ordering::SeqCst);
        std::thread::sleep(self.pause);
        file.write_all(bytes)
    }
}
