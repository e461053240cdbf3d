//! A bench with sensors just large enough for the painted truth, and nights on it in simulated time.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

#[path = "rough.rs"]
mod rough;

use super::common::Lab;
use goniod::archive::disk::{Disk, RealDisk};
use goniod::archive::{NewRun, RunDir};
use goniod::config::check::{Checked, Options, check};
use goniod::control::events::EventBus;
use goniod::control::plan::Plan;
use goniod::control::plan::document::RunDocument;
use goniod::control::sequencer::layout::layout;
use goniod::control::sequencer::run::Outcome;
use goniod::control::sequencer::state::Ending;
use goniod::front::bench::{Rehearsal, Schedule, open_simulated};
use goniod::front::night::{self, Night};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_sim::faults::Kind;
use goniod_sim::faults::catalogue::ProcessKind;
use rough::{RoughDisk, Surroundings};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::pin::pin;
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

/// Interlocks of a night with a light monitor.
const INTERLOCKS: &str =
    "period_s = 30.0\nlamp_drift_warning = 0.06\ndrift_per_view = 0.01\nlongest_suspension_s = 7200.0";

/// How long a run rests before it is gone on with.
const REST_US: i64 = 60_000_000;
const HOUR_US: i64 = 3_600_000_000;
/// Lives of one run at most.
const LIVES: u32 = 64;

/// A night that is over.
pub struct Over {
    pub path: PathBuf,
    pub outcome: Outcome,
    /// Faults that really happened.
    pub fired: BTreeMap<Kind, u32>,
    /// How often the run was gone on with.
    pub resumed: u32,
    /// What must not be.
    pub wrong: Vec<String>,
}

/// One process that works on a run, from its start to its end.
struct Life {
    ended: Result<Outcome, ProcessKind>,
    fired: BTreeMap<Kind, u32>,
    /// Faults begun, and the time that passed.
    begun: usize,
    took: Duration,
    utc: UtcMicros,
    wrong: Vec<String>,
}

/// A run's folder, and whether it is gone on with.
#[derive(Clone, Copy)]
enum Begin<'a> {
    New(&'a Path),
    Again(&'a Path),
}

/// A scan with `directions` directions, both transmission and reflection, both cameras.
pub fn scan_text(directions: usize) -> String {
    // After 360 directions the same azimuths come at other elevations.
    let theta = |i: usize| (4 + i % 9 * 8) as f64 + (i / 360) as f64 * 0.5;
    let list: Vec<String> = (0..directions).map(|i| format!("[{}, {}]", theta(i), (i * 37) % 360)).collect();
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
        Tiny::in_lab(Lab::shipped(), scan)
    }

    fn in_lab(lab: Lab, scan: &str) -> Tiny {
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

    /// The lab with this scan and a light monitor.
    pub fn with_light(scan: &str) -> Tiny {
        let lab = Lab::shipped();
        lab.add_light(INTERLOCKS);
        Tiny::in_lab(lab, scan)
    }

    /// The plan.
    pub fn plan(&self) -> Plan {
        night::plan(&self.checked).unwrap_or_else(|e| panic!("{:?}", e.messages))
    }

    /// One night from its beginning, in simulated time, in a folder of its own. What a fault of the plan ends, another
    /// process goes on with.
    pub fn night(&self, seed: u64, schedule: &Schedule, disk: Arc<dyn Disk>) -> Over {
        self.night_until(seed, schedule, disk, |outcome| !is_to_go_on(outcome))
    }

    /// The same where another process goes on with the run until its outcome is `over`.
    pub fn night_until(
        &self,
        seed: u64,
        schedule: &Schedule,
        disk: Arc<dyn Disk>,
        over: impl Fn(&Outcome) -> bool,
    ) -> Over {
        let runs = self.runs.path().join(format!("{seed}-{}", schedule.entries.len()));
        let path = runs.join("night");
        let disk = Arc::new(RoughDisk::over(disk));
        let mut life = self.life(seed, schedule, Begin::New(&runs), EVENING, &disk);
        let (mut fired, mut wrong, mut resumed) = (BTreeMap::new(), Vec::new(), 0);
        let (mut begun, mut passed) = (0, Duration::ZERO);
        loop {
            life.fired.iter().for_each(|(kind, n)| *fired.entry(*kind).or_default() += n);
            wrong.append(&mut life.wrong);
            (begun, passed) = (begun + life.begun, passed + life.took);
            match life.ended {
                Ok(outcome) if over(&outcome) => return Over { path, outcome, fired, resumed, wrong },
                _ => {}
            }
            resumed += 1;
            assert!(resumed < LIVES, "night {seed} does not come to its end");
            let step = match life.ended {
                Err(ProcessKind::ClockBack) => -HOUR_US,
                Err(ProcessKind::ClockForward) => HOUR_US,
                _ => 0,
            };
            let start = UtcMicros(life.utc.0 + REST_US + step);
            disk.mend();
            life = self.life(seed, &schedule.rest(begun, passed), Begin::Again(&path), start, &disk);
        }
    }

    fn life(&self, seed: u64, schedule: &Schedule, begin: Begin<'_>, start: UtcMicros, disk: &Arc<RoughDisk>) -> Life {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
        // A process that is killed takes its tasks with it, each where it stands.
        runtime.block_on(async {
            let clock = Clock::starting_at(start);
            let rehearsal = Rehearsal { seed: Some(seed), ..Rehearsal::default() };
            let mut opened = open_simulated(&self.checked, &rehearsal, clock).unwrap();
            let night = match begin {
                Begin::New(runs) => self.prepare(runs, clock, seed, disk.clone()),
                Begin::Again(path) => {
                    let run = RunDir::resume_on(path, disk.clone()).unwrap_or_else(|e| panic!("night {seed}: {e}"));
                    night_of(self.plan(), Arc::new(run), path.to_owned())
                }
            };
            let (verbs, asked) = mpsc::channel(8);
            let (kill, mut killed) = mpsc::channel(1);
            let config = self.lab.path("config");
            let around = Surroundings::new(&night.path, &config, (disk.clone(), verbs, kill));
            let wrong = around.wrong();
            let faults = opened.faults.as_ref().unwrap();
            let counts = faults.carry_out(schedule.clone(), Arc::new(move |what| around.is_done(what)), clock);
            let events = EventBus::default();
            let mut measured = pin!(night::measure(&self.checked, &night, &mut opened, clock, asked, &events));
            let ended = tokio::select! {
                biased;
                Some(kind) = killed.recv() => Err(kind),
                outcome = &mut measured => Ok(outcome.unwrap_or_else(|e| panic!("night {seed}: {:?}", e.messages))),
            };
            if ended.is_err() {
                // What the system was given before is on the disk: time passes when no write is under way.
                clock.sleep(Duration::from_millis(1)).await;
            }
            let wrong = wrong.lock().unwrap().clone();
            let (fired, begun) = (counts.fired(), counts.begun());
            Life { ended, fired, begun, took: clock.elapsed(), utc: clock.utc(), wrong }
        })
    }

    fn prepare(&self, runs: &Path, clock: Clock, seed: u64, disk: Arc<dyn Disk>) -> Night {
        let (checked, plan) = (&self.checked, self.plan());
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
}

/// True when the run was ended by something that the fault plan asked for.
fn is_to_go_on(outcome: &Outcome) -> bool {
    let told = |words: &str| outcome.message.as_ref().is_some_and(|message| message.contains(words));
    match outcome.ending {
        Ending::Stopped | Ending::Aborted | Ending::MadeSafe => true,
        Ending::ArchiveFailed | Ending::DiskFull => true,
        Ending::Crashed => told("as the fault plan wants it"),
        _ => false,
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
