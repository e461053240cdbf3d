//! Promise: the house stays as its plan says. Reads the code: sizes, first lines, layering, words that may not stand there.

use std::fs;
use std::path::{Path, PathBuf};

const LONGEST_FILE: usize = 600;
const LONGEST_FUNCTION: usize = 70;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rust_files(dir: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            if !["target", ".git", ".venv"].iter().any(|skip| path.ends_with(skip)) {
                rust_files(&path, into);
            }
        } else if path.extension().is_some_and(|e| e == "rs") {
            into.push(path);
        }
    }
}

/// Every Rust file of the workspace: path relative to the root, text.
fn sources() -> Vec<(String, String)> {
    let mut files = Vec::new();
    for wing in ["src", "drivers", "sim", "tests", "benches", "fuzz"] {
        rust_files(&root().join(wing), &mut files);
    }
    files.sort();
    files
        .into_iter()
        .filter_map(|p| {
            let name = p.strip_prefix(root()).ok()?.to_string_lossy().into_owned();
            Some((name, fs::read_to_string(&p).ok()?))
        })
        .collect()
}

/// Code of a file without its test module.
fn production(text: &str) -> &str {
    text.find("#[cfg(test)]").map_or(text, |i| &text[..i])
}

/// Files that only tests compile.
fn is_test(name: &str) -> bool {
    let file = name.rsplit('/').next().unwrap_or(name);
    let helpers = ["tests.rs", "fakes.rs", "testing.rs", "testdata.rs"];
    ["tests/", "fuzz/"].iter().any(|room| name.starts_with(room))
        || name.contains("/tests/")
        || file.ends_with("_tests.rs")
        || helpers.contains(&file)
}

fn report(what: &str, found: Vec<String>) {
    assert!(found.is_empty(), "{what}:\n  {}", found.join("\n  "));
}

#[test]
fn every_file_says_first_what_it_is_for() {
    let found = sources().into_iter().filter(|(_, text)| !text.starts_with("//!")).map(|(name, _)| name).collect();
    report("files without a `//!` first line", found);
}

#[test]
fn files_stay_readable_in_one_sitting() {
    let mut sizes: Vec<(usize, String)> =
        sources().into_iter().map(|(name, text)| (text.lines().count(), name)).collect();
    sizes.sort();
    let long = sizes.iter().filter(|(n, _)| *n > LONGEST_FILE).map(|(n, f)| format!("{f}: {n}")).collect();
    report("files longer than 600 lines", long);
    let ninety = sizes[sizes.len() * 9 / 10].0;
    assert!(ninety <= 400, "90 % of the files should stay under 400 lines, now {ninety}");
}

/// Length of every function: from its `fn` line to the line that closes its block at the same indentation.
#[test]
fn functions_fit_on_a_screen() {
    let mut found = Vec::new();
    for (name, text) in sources() {
        let lines: Vec<&str> = text.lines().collect();
        for (i, line) in lines.iter().enumerate() {
            let code = line.trim_start();
            let is_fn =
                ["fn ", "pub fn ", "async fn ", "pub async fn ", "pub(crate) fn ", "pub(super) fn ", "const fn "]
                    .iter()
                    .any(|p| code.starts_with(p));
            if !is_fn || line.ends_with(';') {
                continue;
            }
            let indent = &line[..line.len() - code.len()];
            let close = format!("{indent}}}");
            let length = lines[i..].iter().position(|l| *l == close).unwrap_or(0) + 1;
            if length > LONGEST_FUNCTION {
                found.push(format!("{name}:{}: {length} lines", i + 1));
            }
        }
    }
    report("functions longer than 70 lines", found);
}

/// Which rooms a room must not touch. No arrow runs back up.
#[test]
fn no_arrow_runs_back_up() {
    let forbidden: &[(&str, &[&str])] = &[
        (
            "src/engine/",
            &[
                "crate::config",
                "crate::control",
                "crate::archive",
                "crate::products",
                "crate::front",
                "tokio",
                "goniod_sim",
                "goniod_drivers",
                "std::fs",
                "std::time",
            ],
        ),
        (
            "src/config/",
            &["crate::control", "crate::archive", "crate::products", "crate::front", "goniod_sim", "tokio"],
        ),
        ("src/archive/", &["crate::products", "crate::front", "goniod_sim", "crate::engine"]),
        ("src/control/plan/", &["tokio", "std::fs", "goniod_sim", "crate::archive", "crate::front"]),
        ("src/control/", &["crate::products", "crate::front", "goniod_sim"]),
        ("src/products/", &["crate::front", "goniod_sim"]),
        ("drivers/", &["goniod::", "goniod_sim"]),
        ("sim/", &["goniod::"]),
    ];
    let mut found = Vec::new();
    for (name, text) in sources() {
        for (room, words) in forbidden {
            if !name.starts_with(room) || is_test(&name) {
                continue;
            }
            for (i, line) in production(&text).lines().enumerate() {
                let code = line.split("//").next().unwrap_or("");
                for word in *words {
                    if code.contains(word) {
                        found.push(format!("{name}:{}: touches {word}", i + 1));
                    }
                }
            }
        }
    }
    report("rooms that reach into what they must not touch", found);
}

/// Time has one door: everything else asks the clock.
#[test]
fn only_the_clock_reads_the_time() {
    let mut found = Vec::new();
    for (name, text) in sources() {
        if is_test(&name) || name.ends_with("clock.rs") {
            continue;
        }
        for (i, line) in production(&text).lines().enumerate() {
            let code = line.split("//").next().unwrap_or("");
            for word in [
                "SystemTime::now",
                "std::time::Instant",
                "tokio::time::sleep",
                "tokio::time::timeout",
                "std::thread::sleep",
            ] {
                if code.contains(word) {
                    found.push(format!("{name}:{}: {word}", i + 1));
                }
            }
        }
    }
    report("time read or waited for past the clock", found);
}

#[test]
fn no_unfinished_or_private_words() {
    let words = ["todo!(", "unimplemented!(", "TODO", "FIXME", "XXX", "/work/", "/root/"];
    let mut found = Vec::new();
    for (name, text) in sources() {
        if name == "tests/tidy.rs" {
            continue;
        }
        for (i, line) in text.lines().enumerate() {
            for word in words.iter().filter(|w| line.contains(**w)) {
                found.push(format!("{name}:{}: {word}", i + 1));
            }
        }
    }
    report("words that may not stand in the code", found);
}

/// `docs/reliability.md` names a test for every promise, and each of them is there.
#[test]
fn every_promise_of_the_night_names_a_test_that_exists() {
    let text = fs::read_to_string(root().join("docs/reliability.md")).unwrap_or_default();
    let mut found = Vec::new();
    let rows: Vec<&str> =
        text.lines().filter(|line| line.starts_with("| ") && !line.starts_with("| promise")).collect();
    for row in &rows {
        let names: Vec<(&str, &str)> = row.split('`').filter_map(|word| word.split_once("::")).collect();
        if names.is_empty() {
            found.push(format!("no test: {row}"));
        }
        for (file, test) in names {
            let source = fs::read_to_string(root().join(file)).unwrap_or_default();
            if !source.contains(&format!("fn {test}(")) {
                found.push(format!("{file} has no test {test}"));
            }
        }
    }
    assert!(rows.len() >= 20, "the table is gone");
    report("promises without their test", found);
}

#[test]
fn every_room_of_the_tree_is_on_the_map() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap_or_default();
    let missing = [
        "src/config",
        "src/control",
        "src/archive",
        "src/engine",
        "src/products",
        "src/front",
        "drivers",
        "sim",
        "config",
        "systemd",
        "tests",
        "docs",
    ]
    .iter()
    .filter(|room| !readme.contains(&format!("`{room}/`")))
    .map(|room| (*room).to_owned())
    .collect();
    report("rooms that README's \"Finding your way\" does not name", missing);
}
