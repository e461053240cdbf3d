//! The queue on the disk: a folder an entry, `entry.json` written atomically, copies of the scan's files beside it.
//!
//! ```text
//! <state>/queue/000007/entry.json
//!                      files/…        until its run is over
//! <state>/held                        why no entry is begun, where something holds the queue
//! ```
//! An entry appears by one rename, whole or not at all; a kill at any moment loses none and doubles none.

use super::entry::{Entry, EntryState, Products, Work};
use super::error::DaemonError;
use super::snapshot;
use crate::archive::disk::{Disk, RealDisk, TEMPORARY_PREFIX, make_folders};
use crate::archive::write_atomic;
use crate::config::check::Checked;
use crate::config::error::ConfigError;
use crate::config::source::read_bytes;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Entries that may wait.
pub const MOST_WAITING: usize = 500;
/// Entries that are over and still told.
const MOST_OVER: usize = 200;
const ENTRY: &str = "entry.json";
const HELD: &str = "held";
/// Largest file of the queue that is read, bytes.
const LARGEST_ENTRY: u64 = 1 << 20;

/// The queue of one state folder.
#[derive(Debug)]
pub struct Queue {
    state: PathBuf,
    folder: PathBuf,
    entries: BTreeMap<u32, Entry>,
    bad: Vec<BadEntry>,
    held: Option<String>,
    highest: u32,
    claimed: Option<u32>,
}

/// A folder of the queue that cannot be read; it is left as it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct BadEntry {
    /// The folder.
    pub path: PathBuf,
    /// What is wrong with it.
    pub reason: String,
}

/// A number of the queue with a place for copies, which are written without holding anybody up. What is staged and not
/// added is removed again.
#[derive(Debug)]
pub struct Staged {
    id: u32,
    building: PathBuf,
}

// === impl Staged ===

impl Staged {
    /// Writes the copies of every file of a check.
    ///
    /// # Errors
    /// Storage failures.
    pub fn copy(&self, checked: &Checked) -> Result<(), DaemonError> {
        snapshot::write(&self.building, checked)
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        // Renamed into the queue there is nothing left; what is left after a failure only takes space.
        let _ = fs::remove_dir_all(&self.building);
    }
}

// === impl Queue ===

impl Queue {
    /// Opens the queue of a state folder; makes it where there is none. What cannot be read is named, not fatal.
    ///
    /// # Errors
    /// A folder that cannot be made or listed.
    pub fn open(state: &Path) -> Result<Queue, DaemonError> {
        let folder = state.join("queue");
        make_folders(&RealDisk, &folder)?;
        let mut queue = Queue {
            state: state.to_owned(),
            folder: folder.clone(),
            entries: BTreeMap::new(),
            bad: Vec::new(),
            held: read_hold(&state.join(HELD)),
            highest: 0,
            claimed: None,
        };
        let listed = fs::read_dir(&folder).map_err(|source| DaemonError::Io { path: folder, source })?;
        let mut paths: Vec<PathBuf> = listed.flatten().map(|e| e.path()).collect();
        paths.sort();
        for path in paths {
            queue.adopt(path);
        }
        Ok(queue)
    }

    /// All entries in their order.
    pub fn entries(&self) -> impl DoubleEndedIterator<Item = &Entry> {
        self.entries.values()
    }

    /// One entry.
    pub fn get(&self, id: u32) -> Option<&Entry> {
        self.entries.get(&id)
    }

    /// Folders that could not be read.
    pub fn bad(&self) -> &[BadEntry] {
        &self.bad
    }

    /// Why no entry is begun, where something holds the queue.
    pub fn held(&self) -> Option<&str> {
        self.held.as_deref()
    }

    /// How many entries wait.
    pub fn waiting(&self) -> usize {
        self.entries.values().filter(|e| e.state == EntryState::Waiting).count()
    }

    /// The folder of an entry, with the copies in it.
    pub fn folder_of(&self, id: u32) -> PathBuf {
        self.folder.join(format!("{id:06}"))
    }

    /// What is to be done now: a run that was cut short first, then the entry that waits longest.
    pub fn next(&self) -> Option<&Entry> {
        let running = self.entries.values().find(|e| matches!(e.state, EntryState::Running { .. }));
        running.or_else(|| self.entries.values().find(|e| e.state == EntryState::Waiting))
    }

    /// Takes what is to be done now, unless the queue is held; nobody can take it out of the queue until it is let go.
    pub fn claim(&mut self) -> Option<Entry> {
        let entry = if self.held.is_some() { None } else { self.next().cloned() };
        self.claimed = entry.as_ref().map(|e| e.id);
        entry
    }

    /// Lets go of what was claimed.
    pub fn let_go(&mut self) {
        self.claimed = None;
    }

    /// Puts an entry back to those that wait, as the disk still has it.
    pub fn put_back(&mut self, id: u32) {
        if let Some(entry) = self.entries.get_mut(&id) {
            entry.state = EntryState::Waiting;
        }
    }

    /// Gives a number and a place for copies away; nothing is in the queue yet.
    ///
    /// # Errors
    /// [`DaemonError::Full`], [`DaemonError::NumbersEnd`].
    pub fn stage(&mut self) -> Result<Staged, DaemonError> {
        if self.waiting() >= MOST_WAITING {
            return Err(DaemonError::Full(MOST_WAITING));
        }
        let id = self.highest.checked_add(1).ok_or(DaemonError::NumbersEnd(self.highest))?;
        self.highest = id;
        Ok(Staged { id, building: self.folder.join(format!("{TEMPORARY_PREFIX}{id:06}")) })
    }

    /// Puts work at the end of the queue, with the copies that were staged.
    ///
    /// # Errors
    /// Storage failures; the queue is then as it was.
    pub fn add(&mut self, staged: Staged, work: Work, added: String) -> Result<Entry, DaemonError> {
        let Staged { id, building } = &staged;
        let entry = Entry { id: *id, added, work, state: EntryState::Waiting, begun: false, products: Products::None };
        make_folders(&RealDisk, building)?;
        save(building, &entry)?;
        let path = self.folder_of(*id);
        let io = |source| DaemonError::Io { path: path.clone(), source };
        fs::rename(building, &path).map_err(io)?;
        RealDisk.sync_folder(&self.folder).map_err(io)?;
        self.entries.insert(*id, entry.clone());
        Ok(entry)
    }

    /// Writes what became of an entry.
    ///
    /// # Errors
    /// [`DaemonError::NoEntry`], storage failures; in memory the new state holds all the same.
    pub fn set(&mut self, id: u32, change: impl FnOnce(&mut Entry)) -> Result<Entry, DaemonError> {
        let entry = self.entries.get_mut(&id).ok_or(DaemonError::NoEntry(id))?;
        change(entry);
        let entry = entry.clone();
        save(&self.folder_of(id), &entry)?;
        if entry.is_over() {
            // The run keeps copies of its own. Left over after a crash they only take space.
            let _ = fs::remove_dir_all(self.folder_of(id).join(snapshot::FILES));
            self.forget_old();
        }
        Ok(entry)
    }

    /// Takes a waiting entry out.
    ///
    /// # Errors
    /// [`DaemonError::NoEntry`], [`DaemonError::NotWaiting`], storage failures.
    pub fn cancel(&mut self, id: u32) -> Result<Entry, DaemonError> {
        let entry = self.entries.get(&id).ok_or(DaemonError::NoEntry(id))?;
        match &entry.state {
            EntryState::Waiting if self.claimed != Some(id) => self.set(id, |e| e.state = EntryState::Cancelled),
            state => {
                let running = matches!(state, EntryState::Running { .. } | EntryState::Waiting);
                let hint = if running { "; `goniod stop` ends the run" } else { "" };
                let state = if *state == EntryState::Waiting { "beginning" } else { state.name() };
                Err(DaemonError::NotWaiting { id, state, hint })
            }
        }
    }

    /// Holds the queue, or lets it go on with `None`.
    ///
    /// # Errors
    /// Storage failures; in memory it holds all the same.
    pub fn hold(&mut self, why: Option<String>) -> Result<(), DaemonError> {
        let path = self.state.join(HELD);
        self.held.clone_from(&why);
        match why {
            Some(why) => Ok(write_atomic(&path, why.as_bytes())?),
            None => match fs::remove_file(&path) {
                Err(source) if source.kind() != std::io::ErrorKind::NotFound => Err(DaemonError::Io { path, source }),
                _ => Ok(()),
            },
        }
    }

    fn adopt(&mut self, path: PathBuf) {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if name.starts_with(TEMPORARY_PREFIX) {
            // An entry that was never acknowledged.
            let _ = fs::remove_dir_all(&path);
            return;
        }
        let number: Option<u32> = name.parse().ok().filter(|n| format!("{n:06}") == name);
        self.highest = self.highest.max(number.unwrap_or(0));
        let read = read_bytes(&path.join(ENTRY), "queue", LARGEST_ENTRY).map_err(|e| e.to_string());
        let entry = read.and_then(|text| serde_json::from_slice::<Entry>(&text).map_err(|e| format!("{ENTRY}: {e}")));
        match entry {
            Ok(entry) if Some(entry.id) == number => {
                self.entries.insert(entry.id, entry);
            }
            Ok(entry) => self.bad.push(BadEntry { path, reason: format!("its {ENTRY} says number {}", entry.id) }),
            Err(reason) => self.bad.push(BadEntry { path, reason }),
        }
    }

    /// Keeps the list of what is over short.
    fn forget_old(&mut self) {
        let done = |e: &&Entry| e.is_over() && e.products != Products::Pending && e.id != self.highest;
        let over: Vec<u32> = self.entries.values().filter(done).map(|e| e.id).collect();
        for id in over.iter().take(over.len().saturating_sub(MOST_OVER)) {
            self.entries.remove(id);
            // What is left only takes space; the next start tells it as over again.
            let _ = fs::remove_dir_all(self.folder_of(*id));
        }
    }
}

/// Why the queue is held. A note that cannot be read holds it all the same: somebody wanted it held.
fn read_hold(path: &Path) -> Option<String> {
    match read_bytes(path, "hold", LARGEST_ENTRY) {
        Err(ConfigError::NotFound { .. }) => None,
        Ok(bytes) if !bytes.trim_ascii().is_empty() && bytes.iter().all(|b| *b != 0) => {
            Some(String::from_utf8_lossy(bytes.trim_ascii()).into_owned())
        }
        _ => Some(format!("why cannot be read from {}", path.display())),
    }
}

fn save(folder: &Path, entry: &Entry) -> Result<(), DaemonError> {
    let path = folder.join(ENTRY);
    let text = serde_json::to_vec_pretty(entry)
        .map_err(|e| DaemonError::Io { path: path.clone(), source: std::io::Error::other(e) })?;
    Ok(write_atomic(&path, &text)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn work(run: &str) -> Work {
        Work::Resume { run: run.to_owned() }
    }

    fn filled(state: &Path, entries: usize) -> Queue {
        let mut queue = Queue::open(state).unwrap();
        for i in 0..entries {
            let staged = queue.stage().unwrap();
            queue.add(staged, work(&format!("run-{i}")), "2026-01-01T18:00:00Z".to_owned()).unwrap();
        }
        queue
    }

    fn ids(queue: &Queue) -> Vec<(u32, &'static str)> {
        queue.entries().map(|e| (e.id, e.state.name())).collect()
    }

    #[test]
    fn order_and_states_survive_a_restart() {
        let state = tempfile::tempdir().unwrap();
        let mut queue = filled(state.path(), 3);
        queue.cancel(2).unwrap();
        queue.set(1, |e| e.state = EntryState::Running { run: "r".to_owned() }).unwrap();
        queue.hold(Some("stopped by the operator".to_owned())).unwrap();
        let mut again = Queue::open(state.path()).unwrap();
        assert_eq!(ids(&again), [(1, "running"), (2, "cancelled"), (3, "waiting")]);
        assert_eq!(again.held(), Some("stopped by the operator"));
        assert_eq!(again.next().unwrap().id, 1, "what was cut short comes first");
        again.set(1, |e| e.state = EntryState::Failed { run: None, reason: "-".to_owned() }).unwrap();
        assert_eq!(again.next().unwrap().id, 3);
        again.hold(None).unwrap();
        assert_eq!(Queue::open(state.path()).unwrap().held(), None);
    }

    #[test]
    fn what_is_claimed_cannot_be_taken_out_and_a_held_queue_gives_nothing_away() {
        let state = tempfile::tempdir().unwrap();
        let mut queue = filled(state.path(), 2);
        assert_eq!(queue.claim().unwrap().id, 1);
        assert!(queue.cancel(1).unwrap_err().to_string().contains("beginning"));
        queue.cancel(2).unwrap();
        queue.let_go();
        queue.hold(Some("-".to_owned())).unwrap();
        assert!(queue.claim().is_none());
        queue.cancel(1).unwrap();
    }

    #[test]
    fn numbers_are_never_used_twice() {
        let state = tempfile::tempdir().unwrap();
        filled(state.path(), 2).cancel(2).unwrap();
        let mut again = Queue::open(state.path()).unwrap();
        let staged = again.stage().unwrap();
        assert_eq!(again.add(staged, work("x"), String::new()).unwrap().id, 3);
        assert!(matches!(again.cancel(2), Err(DaemonError::NotWaiting { .. })));
        assert!(matches!(again.cancel(9), Err(DaemonError::NoEntry(9))));
    }

    #[test]
    fn damaged_entries_are_named_and_the_others_stay() {
        let state = tempfile::tempdir().unwrap();
        drop(filled(state.path(), 3));
        let folder = state.path().join("queue");
        fs::write(folder.join("000001/entry.json"), b"{\"id\": 1").unwrap();
        fs::write(folder.join("000002/entry.json"), fs::read(folder.join("000003/entry.json")).unwrap()).unwrap();
        fs::create_dir(folder.join("000008")).unwrap();
        fs::write(folder.join("notes.txt"), b"\xff\xfe").unwrap();
        fs::create_dir_all(folder.join(".tmp-000009/files")).unwrap();
        let mut queue = Queue::open(state.path()).unwrap();
        assert_eq!(ids(&queue), [(3, "waiting")]);
        assert_eq!(queue.bad().len(), 4, "{:?}", queue.bad());
        assert!(!folder.join(".tmp-000009").exists());
        let staged = queue.stage().unwrap();
        assert_eq!(queue.add(staged, work("x"), String::new()).unwrap().id, 9, "not the number of a damaged one");
    }

    #[test]
    fn whatever_a_cut_leaves_of_the_queue_is_read_or_named_and_a_torn_hold_holds() {
        let state = tempfile::tempdir().unwrap();
        let mut queue = filled(state.path(), 2);
        queue.hold(Some("an interlock gave the alarm".to_owned())).unwrap();
        let (entry, held) = (state.path().join("queue/000001/entry.json"), state.path().join("held"));
        let good = fs::read(&entry).unwrap();
        for kept in 0..good.len() {
            let mut zeroed = good.clone();
            zeroed[kept..].fill(0);
            for bad in [good[..kept].to_vec(), zeroed] {
                fs::write(&entry, bad).unwrap();
                let queue = Queue::open(state.path()).unwrap();
                assert_eq!((ids(&queue), queue.bad().len()), (vec![(2, "waiting")], 1), "cut after {kept}");
                assert_eq!(queue.next().unwrap().id, 2, "the others are carried out");
            }
        }
        fs::write(&entry, good).unwrap();
        for torn in [&b""[..], b"\0\0\0\0", b"an interlock\0\0", b"\xff\xfe"] {
            fs::write(&held, torn).unwrap();
            assert!(Queue::open(state.path()).unwrap().held().is_some_and(|why| !why.is_empty()), "{torn:?}");
        }
        Queue::open(state.path()).unwrap().hold(None).unwrap();
        assert_eq!(Queue::open(state.path()).unwrap().held(), None);
    }

    #[test]
    fn the_queue_is_bounded() {
        let state = tempfile::tempdir().unwrap();
        let mut queue = filled(state.path(), 1);
        let entry = queue.get(1).unwrap().clone();
        queue.entries.extend((2..=MOST_WAITING as u32).map(|id| (id, Entry { id, ..entry.clone() })));
        assert!(matches!(queue.stage(), Err(DaemonError::Full(_))));
    }
}
