//! Promise: the real program, killed with SIGKILL at any moment, is gone on with by `goniod resume` and loses nothing.

use super::common::text;
use super::scan::stored;
use super::tiny::{Tiny, scan_text};
use goniod::archive::RunDir;
use goniod::archive::verify::verify;
use goniod_sim::truth::rng::Key;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Real kills of the real program.
const KILLS: u32 = 100;
/// Times that one run is killed.
const LIVES: u32 = 5;
/// Longest time between a first sign of progress and the kill, seconds.
const LONGEST: f64 = 0.15;

/// What happened to all runs.
#[derive(Default)]
struct Tally {
    kills: AtomicU32,
    runs: AtomicU32,
    went_on: AtomicU32,
}

#[test]
fn a_program_killed_at_random_times_goes_on_where_it_was() {
    let wanted = std::env::var("GONIOD_KILLS").ok().and_then(|n| n.parse().ok()).unwrap_or(KILLS);
    let tally = Tally::default();
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            scope.spawn(|| {
                // One instrument each: nobody else works on it.
                let tiny = Tiny::new(&scan_text(6));
                while tally.kills.load(Ordering::SeqCst) < wanted {
                    one_run(&tiny, tally.runs.fetch_add(1, Ordering::SeqCst), &tally);
                }
            });
        }
    });
    let Tally { kills, runs, went_on } = tally;
    let (kills, runs, went_on) = (kills.into_inner(), runs.into_inner(), went_on.into_inner());
    eprintln!("{kills} kills over {runs} runs; {went_on} times it went on from frames before");
    assert!(went_on >= wanted * 3 / 10, "{went_on}");
}

/// Begins a run, kills it and goes on with it some times, lets it end and has the oracle judge it.
fn one_run(tiny: &Tiny, number: u32, tally: &Tally) {
    let folder = tiny.runs.path().join(format!("run-{number}"));
    let (scan, instrument) = (text(&tiny.lab.path("config/scans/night.toml")), text(&tiny.lab.instrument()));
    let draw = Key::new(11).with(u64::from(number));
    let first = ["rehearse", &scan, "--instrument", &instrument, "--runs", &text(&folder)].map(str::to_owned);
    let (mut args, mut before) = (first.to_vec(), 0);
    for life in 0..LIVES {
        let mut child = start(tiny, &args);
        // At any moment, or some moment after it got further.
        if life != 2 {
            wait_for_frames(&mut child, &folder, before);
        }
        std::thread::sleep(Duration::from_secs_f64(LONGEST * draw.uniform(u64::from(life))));
        tally.kills.fetch_add(u32::from(child.try_wait().unwrap().is_none()), Ordering::SeqCst);
        let _ = child.kill();
        child.wait().unwrap();
        let Some(run) = the_run(&folder) else { continue };
        let now = stored(&run);
        assert!(now >= before, "{now} frames after {before}");
        tally.went_on.fetch_add(u32::from(before > 0 && now > before), Ordering::SeqCst);
        before = now;
        assert!(verify(&run).unwrap().sound());
        args = ["resume", &text(&run), "--instrument", &instrument].map(str::to_owned).to_vec();
        if RunDir::open(&run).unwrap().with(|j| j.summary()).unwrap().planned == 0 {
            break;
        }
    }
    if the_run(&folder).is_none_or(|run| !verify(&run).unwrap().whole()) {
        let output = start(tiny, &args).wait_with_output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let verdict = goniod::front::oracle::judge(&the_run(&folder).unwrap()).unwrap();
    assert!(verdict.is_clean() && verdict.stored == verdict.planned, "{:?}", verdict.lines());
    fs::remove_dir_all(&folder).unwrap();
}

fn start(tiny: &Tiny, args: &[String]) -> Child {
    let args: Vec<&str> = args.iter().map(String::as_str).chain(["--no-products", "--json"]).collect();
    tiny.lab.command(&args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Until the run has files of more than `before` frames, or the program is over.
fn wait_for_frames(child: &mut Child, folder: &Path, before: usize) {
    while child.try_wait().unwrap().is_none() && the_run(folder).map_or(0, |run| frame_files(&run)) <= before {
        std::thread::sleep(Duration::from_millis(3));
    }
}

/// Files of whole frames below a folder.
fn frame_files(folder: &Path) -> usize {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => frame_files(&entry.path()),
            _ => usize::from(entry.file_name().to_string_lossy().starts_with("c.")),
        })
        .sum()
}

fn the_run(folder: &Path) -> Option<PathBuf> {
    let mut entries = fs::read_dir(folder).ok()?.flatten().map(|e| e.path());
    entries.find(|p| !p.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.')))
}
