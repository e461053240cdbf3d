//! Promise: memory stands still: a night of any length needs no more than its beginning did.
//!
//! The program itself rehearses a night with small frames; its resident memory is looked at from outside. The long form,
//! 100,000 frames, runs with `cargo test --test soak -- --ignored`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/tiny.rs"]
mod tiny;

use common::text;
use std::fs;
use std::process::Stdio;
use std::time::Duration;
use tiny::{Tiny, memory_folder, scan_text};

/// What memory may grow by after the first third of the night, bytes.
const MOST_GROWTH: u64 = 32 << 20;

/// Bytes in the page that `statm` counts.
const PAGE: u64 = 4096;

/// Rehearses a night of `directions` directions; frames stored, largest resident memory in its first third and at all.
fn night(directions: usize) -> (u64, u64, u64) {
    let lab = Tiny::new(&scan_text(directions)).lab;
    let (scan, runs) = (text(&lab.path("config/scans/night.toml")), memory_folder());
    let (instrument, folder) = (text(&lab.instrument()), text(runs.path()));
    let args = ["rehearse", &scan, "--instrument", &instrument, "--runs", &folder, "--no-products", "--json"];
    let mut child = lab.command(&args).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut resident = Vec::new();
    while child.try_wait().unwrap().is_none() {
        let statm = fs::read_to_string(format!("/proc/{}/statm", child.id())).unwrap_or_default();
        let pages: Option<u64> = statm.split_whitespace().nth(1).and_then(|n| n.parse().ok());
        resident.extend(pages.filter(|n| *n > 0).map(|n| n * PAGE));
        std::thread::sleep(Duration::from_millis(50));
    }
    let output = child.wait_with_output().unwrap();
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((document["missing"].as_u64(), document["planned"].as_u64()), (Some(0), Some(0)));
    let largest = |samples: &[u64]| samples.iter().copied().max().unwrap();
    let stored = document["stored"].as_u64().unwrap();
    (stored, largest(&resident[..resident.len() / 3]), largest(&resident))
}

fn stands_still(directions: usize, frames: u64) {
    let (stored, warm, at_all) = night(directions);
    eprintln!("{stored} frames: {} MB after a third, {} MB at most", warm >> 20, at_all >> 20);
    assert!(stored >= frames, "{stored}");
    assert!(at_all - warm <= MOST_GROWTH, "{warm} bytes after a third of the night, {at_all} at most");
}

#[test]
fn memory_stands_still_through_a_night() {
    stands_still(60, 1500);
}

#[test]
#[ignore = "takes many minutes"]
fn memory_stands_still_over_a_hundred_thousand_frames() {
    stands_still(3200, 100_000);
}
