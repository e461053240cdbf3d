//! Promise: no file and no request, however broken, makes the daemon panic, stay away or take what it cannot write
//! itself. Replays the corpora of `fuzz/` and mutations of them; `fuzz/README.md`.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../fuzz/targets/harness.rs"]
mod harness;
#[path = "../fuzz/targets/house.rs"]
mod house;
#[path = "../fuzz/targets/requests.rs"]
mod requests;

use std::collections::BTreeSet;
use std::path::PathBuf;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus")
}

#[test]
fn broken_files_are_refused_in_words_and_read_files_come_back_as_they_were() {
    harness::replay(&corpus(), house::TARGETS);
    house::tidy_up();
}

#[test]
fn broken_requests_are_refused_and_the_daemon_goes_on() {
    harness::replay(&corpus(), requests::TARGETS);
    requests::tidy_up();
}

/// Each corpus has a target; those of the wires are counted where they are replayed.
#[test]
fn every_corpus_is_replayed() {
    let texts =
        ["fuzz/targets/protocols.rs", "fuzz/targets/wires.rs", "fuzz/targets/house.rs", "fuzz/targets/requests.rs"]
            .map(|file| std::fs::read_to_string(PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap());
    let all = texts.concat();
    let folders: BTreeSet<String> = std::fs::read_dir(corpus())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|name| !all.contains(&format!("\"{}\"", name.strip_prefix("wire-").unwrap_or(name))))
        .collect();
    assert!(folders.is_empty(), "no target eats {folders:?}");
}
