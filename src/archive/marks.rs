//! Marks beside an open journal, by which any changed bit of a run under way or cut short is found.
//!
//! `journal.base` has the digest of `journal.sqlite`. That file stays as it is while commits go to SQLite's log; the base is
//! lifted before the log is folded into the file, and set anew after. `journal.head` tells after each commit how far the log
//! is committed. It is not synced: after a power cut it may be older than the log, never newer. Both are gone once the
//! journal is closed; the seal covers it then. `journal.sqlite-shm` is memory that processes share, no record: whoever
//! opens the journal after the last process has gone builds it anew.

use super::disk::{Disk, read_where_there, write_on};
use super::error::{ArchiveError, Result};
use super::wal::{HEADER, Walk};
use crate::digest::{sha256_hex, sha256_of_file};
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Digest of the journal's file.
const BASE: &str = "journal.base";
/// How far the journal's log is committed.
const HEAD: &str = "journal.head";
/// A log that was not this journal's, set aside.
const FOREIGN: &str = "journal.sqlite-wal.foreign";
/// Length of a head.
const HEAD_BYTES: usize = 68;
/// Looks that a check takes beside a writer that folds its log.
const LOOKS: usize = 5;

/// The marks of one journal.
pub(super) struct Marks {
    journal: PathBuf,
    disk: Arc<dyn Disk>,
    generation: Option<u64>,
    walk: Option<Walk>,
}

/// A change of an open journal since it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Damage {
    /// What is changed, as a sentence without its end.
    pub(super) what: String,
    /// True where only the log or the mark of its end is changed: what SQLite then still reads is a whole beginning of
    /// the journal.
    pub(super) of_log: bool,
}

/// Where a run's files were when they were read.
struct Seen {
    base: Option<Vec<u8>>,
    head: Vec<u8>,
    journal: Vec<u8>,
    log: Vec<u8>,
}

// === impl Marks ===

impl Marks {
    /// The marks beside `journal`; nothing is set yet.
    pub(super) fn of(journal: &Path, disk: Arc<dyn Disk>) -> Marks {
        Marks { journal: journal.to_path_buf(), disk, generation: None, walk: None }
    }

    /// Takes the base away, durably, before the journal's file changes.
    ///
    /// # Errors
    /// The disk's kinds; the file must then stay as it is.
    pub(super) fn lift(&mut self) -> Result<()> {
        let base = self.path(BASE);
        let lift = || {
            let there = base.exists();
            self.disk.discard(&base)?;
            if there { self.disk.sync_folder(folder_of(&self.journal)) } else { Ok(()) }
        };
        let before = generation_of(&fs::read(&base).unwrap_or_default());
        let head = generation_of(&fs::read(self.path(HEAD)).unwrap_or_default());
        lift().map_err(|e| ArchiveError::io("remove", &base, &e))?;
        self.generation = Some(self.generation.or(before).max(head).unwrap_or(0).wrapping_add(1));
        self.walk = None;
        Ok(())
    }

    /// Sets the base for the file as it is now. Without one, less can be judged; nothing else suffers.
    pub(super) fn set(&mut self) {
        let set = |generation| {
            let digest = sha256_of_file(&self.journal).map_err(|e| ArchiveError::io("read", &self.journal, &e))?;
            write_on(&*self.disk, &self.path(BASE), base_text(generation, &digest).as_bytes())
        };
        if self.generation.is_some_and(|generation| set(generation).is_err()) {
            let _ = self.disk.discard(&self.path(BASE));
        }
    }

    /// Tells how far the log is committed; gives the bytes it has, where that could be read. A mark that cannot be
    /// written only lets less be judged.
    pub(super) fn committed(&mut self) -> Option<u64> {
        let mut log = File::open(log_of(&self.journal)).ok()?;
        let mut header = [0; HEADER];
        log.read_exact(&mut header).ok()?;
        let mut walk = match self.walk.take().filter(|walk| walk.goes_on(&header)) {
            Some(walk) => walk,
            None => Walk::begin(&header)?,
        };
        let mut rest = Vec::new();
        log.seek(SeekFrom::Start(walk.end())).and_then(|_| log.read_to_end(&mut rest)).ok()?;
        walk.over(&rest);
        let end = walk.end();
        if let Some(generation) = self.generation {
            let _ = self.disk.mark(&self.path(HEAD), head_text(generation, walk.salts(), end).as_bytes());
        }
        self.walk = Some(walk);
        Some(end)
    }

    /// Takes all marks away: the journal is closed.
    pub(super) fn remove(&mut self) -> Result<()> {
        self.lift()?;
        let head = self.path(HEAD);
        self.disk.discard(&head).map_err(|e| ArchiveError::io("remove", &head, &e))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.journal.with_file_name(name)
    }
}

/// Takes the mark of the log's end away, durably: as much of the log counts from now on as is whole. Of a log that is not
/// this journal's nothing is: SQLite would read its rows all the same, so it is set aside first.
///
/// # Errors
/// The disk's kinds.
pub(super) fn accept_end(journal: &Path, disk: &dyn Disk) -> Result<()> {
    let (head, log) = (journal.with_file_name(HEAD), log_of(journal));
    let settled = |done: std::io::Result<()>| done.and_then(|()| disk.sync_folder(folder_of(journal)));
    let told = read_where_there(&head)?.filter(|bytes| is_own(bytes));
    let own = told.and_then(|bytes| claim(&bytes)).map(|(salts, _)| salts);
    let found = read_where_there(&log)?.and_then(|bytes| Walk::through(&bytes)).map(|walk| walk.salts());
    if own.is_some() && found.is_some() && own != found {
        let aside = disk.rename(&log, &journal.with_file_name(FOREIGN));
        settled(aside).map_err(|e| ArchiveError::io("set aside", &log, &e))?;
    }
    settled(disk.discard(&head)).map_err(|e| ArchiveError::io("remove", &head, &e))
}

/// What is changed in `journal` and its log since they were written; it is not closed, and may be in use.
///
/// # Errors
/// [`ArchiveError::Io`] and the disk's kinds for a file that cannot be read.
pub(super) fn check(journal: &Path) -> Result<Vec<Damage>> {
    let (base_at, head_at, log_at) = (journal.with_file_name(BASE), journal.with_file_name(HEAD), log_of(journal));
    for _ in 0..LOOKS {
        // The head before the log: what it tells is in the log by then.
        let base = read_where_there(&base_at)?;
        let head = read_where_there(&head_at)?.unwrap_or_default();
        let (file, log) = (read_where_there(journal)?, read_where_there(&log_at)?);
        // A writer that folded its log meanwhile has set another base.
        if read_where_there(&base_at)? == base {
            let seen = Seen { base, head, journal: file.unwrap_or_default(), log: log.unwrap_or_default() };
            return Ok(judge(&seen));
        }
    }
    Ok(Vec::new())
}

/// The sentences for an open journal whose marks are gone: a cut while a mark is set leaves it so.
pub(super) fn nothing_to_prove_by(journal: &Path) -> Vec<String> {
    let gone = |name: &&str| !journal.with_file_name(name).exists();
    let words = [(BASE, "a change of the journal's file"), (HEAD, "a lost end of its log")];
    let words = words.iter().filter(|(name, _)| gone(name));
    words.map(|(name, what)| format!("the journal is open and has no {name}; {what} stays unfound")).collect()
}

fn judge(seen: &Seen) -> Vec<Damage> {
    let Some(base) = &seen.base else { return Vec::new() };
    let mut found = Vec::new();
    let generation = generation_of(base);
    let expected = generation.map(|g| base_text(g, &sha256_hex(&seen.journal)));
    if !is_own(base) {
        found.push(Damage { what: format!("{BASE} was changed"), of_log: false });
    } else if expected.as_deref().map(str::as_bytes) != Some(base) {
        let what = "the file was changed since its log was last folded into it".to_owned();
        found.push(Damage { what, of_log: false });
    }
    // What a power cut has left of a head has no end.
    let cut = seen.head.len() != HEAD_BYTES || seen.head.last() == Some(&0);
    if cut {
        return found;
    }
    if !is_own(&seen.head) {
        found.push(Damage { what: format!("{HEAD} was changed"), of_log: true });
    } else if generation_of(&seen.head) == generation
        && let Some((salts, end)) = claim(&seen.head)
    {
        let whole = Walk::through(&seen.log).filter(|walk| walk.salts() == salts).map_or(0, |walk| walk.end());
        if whole < end {
            let what = format!("its log was changed: {end} bytes were committed, the first {whole} are whole");
            found.push(Damage { what, of_log: true });
        }
    }
    found
}

/// Text, then its own digest as the last word.
fn owned(text: &str) -> String {
    format!("{text} {}\n", sha256_hex(text.as_bytes()).get(..16).unwrap_or_default())
}

fn is_own(bytes: &[u8]) -> bool {
    let text = std::str::from_utf8(bytes).ok().and_then(|text| text.strip_suffix('\n'));
    let parts = text.and_then(|text| text.rsplit_once(' '));
    parts.is_some_and(|(text, _)| owned(text).as_bytes() == bytes)
}

fn base_text(generation: u64, digest: &str) -> String {
    owned(&format!("{generation:016x} journal.sqlite sha256 {digest}"))
}

fn head_text(generation: u64, salts: [u8; 8], end: u64) -> String {
    owned(&format!("{generation:016x} {:016x} {end:016x}", u64::from_be_bytes(salts)))
}

fn generation_of(bytes: &[u8]) -> Option<u64> {
    number(std::str::from_utf8(bytes).ok()?, 0)
}

/// Salts and end that a head tells.
fn claim(head: &[u8]) -> Option<([u8; 8], u64)> {
    let text = std::str::from_utf8(head).ok()?;
    Some((number(text, 1)?.to_be_bytes(), number(text, 2)?))
}

fn number(text: &str, word: usize) -> Option<u64> {
    u64::from_str_radix(text.split(' ').nth(word)?, 16).ok()
}

fn folder_of(journal: &Path) -> &Path {
    journal.parent().unwrap_or(Path::new(""))
}

fn log_of(journal: &Path) -> PathBuf {
    journal.with_extension("sqlite-wal")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn marks_have_their_length_and_every_bit_of_them_counts() {
        let head = head_text(3, [9; 8], 1 << 40);
        assert_eq!(head.len(), HEAD_BYTES);
        assert_eq!(claim(head.as_bytes()), Some(([9; 8], 1 << 40)));
        for text in [head, base_text(u64::MAX, &sha256_hex(b"x"))] {
            assert!(is_own(text.as_bytes()));
            for bit in 0..text.len() * 8 {
                let mut bad = text.clone().into_bytes();
                bad[bit / 8] ^= 1 << (bit % 8);
                assert!(!is_own(&bad) && bad.last() != Some(&0), "bit {bit}");
            }
        }
    }

    #[test]
    fn what_a_power_cut_leaves_of_a_head_is_no_damage() {
        let base = base_text(1, &sha256_hex(b"journal"));
        let head = head_text(1, [1; 8], 4152);
        let seen = |head: &[u8], log: &[u8]| Seen {
            base: Some(base.clone().into_bytes()),
            head: head.to_vec(),
            journal: b"journal".to_vec(),
            log: log.to_vec(),
        };
        for kept in 0..head.len() {
            let mut zeroed = head.clone().into_bytes();
            zeroed[kept..].fill(0);
            assert!(judge(&seen(&head.as_bytes()[..kept], b"")).is_empty(), "cut after {kept}");
            assert!(judge(&seen(&zeroed, b"")).is_empty(), "zeroes from {kept}");
        }
        assert!(judge(&seen(head_text(2, [1; 8], 4152).as_bytes(), b"")).is_empty(), "of another base");
        assert_eq!(judge(&seen(head.as_bytes(), b"")).len(), 1, "a log that is gone");
    }
}
