//! A disk whose every operation is a place to cut: the run directory is copied as the cut leaves it. A killed process
//! leaves what the system was given; a power cut also loses what was not synced, drawn from a seed.
#![allow(dead_code, clippy::unwrap_used, clippy::expect_used)]

use goniod::archive::disk::{Commit, Disk, RealDisk, TEMPORARY_PREFIX};
use goniod_sim::truth::rng::Key;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Where a copy was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    Before,
    Middle,
    After,
}

/// Called at each place with its number, its name and what the disk knows.
pub type AtPoint = Box<dyn FnMut(usize, &str, &State) + Send>;

/// What is not durable yet.
#[derive(Debug, Default, Clone)]
pub struct State {
    /// Files with bytes that were not synced.
    pub unsynced: Vec<PathBuf>,
    /// Entries made, renamed or removed in a folder that was not synced since, oldest first.
    pub entries: Vec<Entry>,
    /// Length of the journal's log when the commit under way began.
    pub log_before: Option<u64>,
    /// Frames whose commit has returned.
    pub committed: usize,
}

/// A change of a folder.
#[derive(Debug, Clone)]
pub enum Entry {
    Made(PathBuf),
    Renamed(PathBuf, PathBuf),
    Removed(PathBuf, Vec<u8>),
}

/// The disk.
pub struct CutDisk {
    inner: Mutex<Inner>,
}

struct Inner {
    points: usize,
    state: State,
    at: AtPoint,
}

// === impl CutDisk ===

impl CutDisk {
    pub fn new(at: impl FnMut(usize, &str, &State) + Send + 'static) -> Arc<CutDisk> {
        Arc::new(CutDisk { inner: Mutex::new(Inner { points: 0, state: State::default(), at: Box::new(at) }) })
    }

    /// Places passed so far.
    pub fn points(&self) -> usize {
        self.inner.lock().unwrap().points
    }

    fn point(&self, what: &str, path: &Path, phase: Phase) {
        let mut inner = self.inner.lock().unwrap();
        let Inner { points, state, at } = &mut *inner;
        at(*points, &format!("{what} {}, {phase:?}", kind_of(path)), state);
        *points += 1;
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.inner.lock().unwrap().state);
    }
}

impl Disk for CutDisk {
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.point("create folder", path, Phase::Before);
        fs::create_dir(path)?;
        self.change(|s| s.entries.push(Entry::Made(path.to_owned())));
        Ok(())
    }

    fn create(&self, path: &Path) -> io::Result<File> {
        self.point("create", path, Phase::Before);
        let file = File::options().write(true).create_new(true).open(path)?;
        self.change(|s| {
            s.entries.push(Entry::Made(path.to_owned()));
            s.unsynced.push(path.to_owned());
        });
        Ok(file)
    }

    fn append(&self, file: &mut File, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.point("write", path, Phase::Before);
        let (first, second) = bytes.split_at(bytes.len() / 2);
        file.write_all(first)?;
        self.point("write", path, Phase::Middle);
        file.write_all(second)
    }

    fn reserve(&self, file: &mut File, path: &Path, bytes: u64) -> io::Result<()> {
        self.point("reserve", path, Phase::Before);
        RealDisk.reserve(file, path, bytes)
    }

    fn sync(&self, file: &File, path: &Path) -> io::Result<()> {
        self.point("sync", path, Phase::Before);
        file.sync_all()?;
        self.change(|s| s.unsynced.retain(|p| p != path));
        Ok(())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.point("rename", to, Phase::Before);
        fs::rename(from, to)?;
        self.change(|s| {
            let moved = |p: &PathBuf| p.strip_prefix(from).map_or(p.clone(), |rest| to.join(rest));
            s.unsynced = s.unsynced.iter().map(moved).collect();
            s.entries.push(Entry::Renamed(from.to_owned(), to.to_owned()));
        });
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.point("remove", path, Phase::Before);
        let bytes = fs::read(path).unwrap_or_default();
        fs::remove_file(path)?;
        self.change(|s| s.entries.push(Entry::Removed(path.to_owned(), bytes)));
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        self.point("sync folder", folder, Phase::Before);
        File::open(folder)?.sync_all()?;
        self.change(|s| {
            s.entries.retain(|entry| {
                let (Entry::Made(p) | Entry::Removed(p, _) | Entry::Renamed(_, p)) = entry;
                p.parent() != Some(folder)
            });
        });
        self.point("sync folder", folder, Phase::After);
        Ok(())
    }

    fn mark(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.point("mark", path, Phase::Before);
        self.change(|s| {
            if !path.exists() {
                s.entries.push(Entry::Made(path.to_owned()));
            }
            if !s.unsynced.iter().any(|p| p == path) {
                s.unsynced.push(path.to_owned());
            }
        });
        RealDisk.mark(path, bytes)
    }

    fn commit(&self, journal: &Path, at: Commit) -> io::Result<()> {
        let length = fs::metadata(journal.with_extension("sqlite-wal")).map_or(0, |m| m.len());
        match at {
            Commit::Begins => {
                self.point("commit", journal, Phase::Before);
                self.change(|s| s.log_before = Some(length));
            }
            Commit::Done => {
                self.point("commit", journal, Phase::Middle);
                self.change(|s| s.log_before = None);
                self.point("commit", journal, Phase::After);
            }
        }
        Ok(())
    }
}

/// What a file or folder is to a run, in one word.
fn kind_of(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    match name.trim_start_matches(TEMPORARY_PREFIX) {
        name if name.starts_with("c.") => "frame".to_owned(),
        name if name.starts_with("journal.") => name.to_owned(),
        _ if path.is_dir() => "folder".to_owned(),
        _ => "file".to_owned(),
    }
}

/// Copies the run directory `from` to `to` as a kill leaves it. A commit in its middle has written part of its log.
pub fn killed(from: &Path, to: &Path, state: &State, draw: Key) {
    copy(from, to);
    if let Some(before) = state.log_before {
        tear_log(to, before, draw);
    }
}

/// Copies the run directory `from` to `to` as a power cut leaves it: unsynced bytes are cut off, zeroed or kept, unsynced
/// entries of a folder are lost from some moment on.
pub fn powerless(from: &Path, to: &Path, state: &State, draw: Key) {
    killed(from, to, state, draw.named("log"));
    let place = |path: &Path| path.strip_prefix(from).map(|rest| to.join(rest)).ok();
    for (i, path) in state.unsynced.iter().enumerate() {
        let Some(path) = place(path).filter(|p| p.is_file()) else { continue };
        let mut bytes = fs::read(&path).unwrap();
        let kept = (draw.named("kept").uniform(i as u64) * (bytes.len() + 1) as f64) as usize;
        match draw.named("how").bits(i as u64) % 3 {
            0 => bytes.truncate(kept),
            1 => bytes[kept..].fill(0),
            _ => {}
        }
        fs::write(&path, bytes).unwrap();
    }
    let mut folders: BTreeMap<PathBuf, Vec<&Entry>> = BTreeMap::new();
    for entry in &state.entries {
        let (Entry::Made(p) | Entry::Removed(p, _) | Entry::Renamed(_, p)) = entry;
        folders.entry(p.parent().unwrap().to_owned()).or_default().push(entry);
    }
    for (i, entries) in folders.values().enumerate() {
        let kept = draw.named("entries").bits(i as u64) as usize % (entries.len() + 1);
        for entry in entries[kept..].iter().rev() {
            undo(entry, place);
        }
    }
}

fn undo(entry: &Entry, place: impl Fn(&Path) -> Option<PathBuf>) {
    match entry {
        Entry::Made(path) => {
            if let Some(path) = place(path) {
                let _ = fs::remove_file(&path).or_else(|_| fs::remove_dir_all(&path));
            }
        }
        Entry::Renamed(from, to) => {
            if let (Some(from), Some(to)) = (place(from), place(to)) {
                let _ = fs::rename(to, from);
            }
        }
        Entry::Removed(path, bytes) => {
            if let Some(path) = place(path) {
                let _ = fs::write(path, bytes);
            }
        }
    }
}

/// Keeps part of what the commit under way has written, the rest cut off or garbage.
fn tear_log(run: &Path, before: u64, draw: Key) {
    let path = run.join("journal.sqlite-wal");
    let Ok(mut bytes) = fs::read(&path) else { return };
    let before = (before as usize).min(bytes.len());
    let kept = before + (draw.uniform(0) * (bytes.len() - before) as f64) as usize;
    match draw.bits(1) % 2 {
        0 => bytes.truncate(kept),
        _ => bytes[kept..].iter_mut().enumerate().for_each(|(i, b)| *b ^= draw.bits(2 + i as u64) as u8 | 1),
    }
    fs::write(&path, bytes).unwrap();
}

/// Copies a folder; the journal's shared memory is no file on a disk.
pub fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().flatten() {
        let (source, target) = (entry.path(), to.join(entry.file_name()));
        if source.is_dir() {
            copy(&source, &target);
        } else if !entry.file_name().to_string_lossy().ends_with("-shm") {
            fs::copy(source, target).unwrap();
        }
    }
}
