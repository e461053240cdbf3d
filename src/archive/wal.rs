//! SQLite's write-ahead log, walked by its own checksums (sqlite.org/fileformat2.html, section 4): how far it is whole
//! and committed. Every bit of it is in a checksum, or is one, or is the header's salt repeated.

/// Length of the log's header, bytes.
pub(super) const HEADER: usize = 32;
/// Length of a frame's header; a page follows.
const FRAME: usize = 24;
/// Smallest and largest page of SQLite.
const PAGES: std::ops::RangeInclusive<usize> = 512..=65536;

/// A walk through a log, frame by frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Walk {
    salts: [u8; 8],
    little: bool,
    page: usize,
    sum: Sum,
    end: u64,
}

/// The running checksum.
type Sum = (u32, u32);

// === impl Walk ===

impl Walk {
    /// Begins behind a header; `None` where that is not whole.
    pub(super) fn begin(header: &[u8; HEADER]) -> Option<Walk> {
        let little = match word(header, 0)? {
            0x377f_0682 => true,
            0x377f_0683 => false,
            _ => return None,
        };
        let page = word(header, 8)? as usize;
        let salts = *header.get(16..)?.first_chunk::<8>()?;
        let sum = checksum(little, (0, 0), header.get(..24)?);
        let whole = (word(header, 24)?, word(header, 28)?) == sum && PAGES.contains(&page);
        whole.then_some(Walk { salts, little, page, sum, end: HEADER as u64 })
    }

    /// A walk through a whole log; `None` where its header is not whole.
    pub(super) fn through(log: &[u8]) -> Option<Walk> {
        let (header, frames) = log.split_first_chunk::<HEADER>()?;
        let mut walk = Walk::begin(header)?;
        walk.over(frames);
        Some(walk)
    }

    /// True when this header is that of the log walked so far.
    pub(super) fn goes_on(&self, header: &[u8; HEADER]) -> bool {
        Walk::begin(header).is_some_and(|begun| begun.salts == self.salts)
    }

    /// Goes on over frames that begin at [`Walk::end`], as far as they are whole.
    pub(super) fn over(&mut self, frames: &[u8]) {
        let (mut rest, mut sum, mut end) = (frames, self.sum, self.end);
        while let Some((frame, page)) = self.frame(rest) {
            sum = checksum(self.little, checksum(self.little, sum, frame.get(..8).unwrap_or_default()), page);
            let whole = frame.get(8..16) == Some(&self.salts[..]) && (word(frame, 16), word(frame, 20)) == some(sum);
            if !whole {
                return;
            }
            rest = rest.get(FRAME + self.page..).unwrap_or_default();
            end += (FRAME + self.page) as u64;
            // The last frame of a commit tells the size of the database.
            if word(frame, 4) != Some(0) {
                (self.sum, self.end) = (sum, end);
            }
        }
    }

    /// Bytes of the log that are whole and committed.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// The salts that all frames of this log repeat.
    pub(super) fn salts(&self) -> [u8; 8] {
        self.salts
    }

    fn frame<'a>(&self, bytes: &'a [u8]) -> Option<(&'a [u8], &'a [u8])> {
        let (frame, rest) = bytes.split_at_checked(FRAME)?;
        Some((frame, rest.get(..self.page)?))
    }
}

fn some((a, b): Sum) -> (Option<u32>, Option<u32>) {
    (Some(a), Some(b))
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk::<4>()?))
}

/// Two interlaced sums over pairs of words, in the byte order that the header's magic number tells.
fn checksum(little: bool, sum: Sum, bytes: &[u8]) -> Sum {
    let read = |word: [u8; 4]| if little { u32::from_le_bytes(word) } else { u32::from_be_bytes(word) };
    let pairs = bytes.as_chunks::<8>().0.iter();
    pairs.fold(sum, |(a, b), &[p, q, r, s, t, u, v, w]| {
        let a = a.wrapping_add(read([p, q, r, s])).wrapping_add(b);
        (a, b.wrapping_add(read([t, u, v, w])).wrapping_add(a))
    })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use rusqlite::Connection;
    use std::path::Path;

    /// The log of a few commits, and where each ends.
    fn log(path: &Path) -> (Vec<u8>, Vec<usize>) {
        let db = Connection::open(path).unwrap();
        db.pragma_update_and_check(None, "journal_mode", "WAL", |_| Ok(())).unwrap();
        let log = path.with_extension("sqlite-wal");
        db.execute_batch("CREATE TABLE t(a)").unwrap();
        let mut ends = Vec::new();
        for i in 0..4 {
            db.execute("INSERT INTO t VALUES(?1)", [vec![i as u8; 3000]]).unwrap();
            ends.push(std::fs::metadata(&log).unwrap().len() as usize);
        }
        (std::fs::read(&log).unwrap(), ends)
    }

    #[test]
    fn a_log_is_whole_to_its_last_commit_and_every_bit_of_it_counts() {
        let folder = tempfile::tempdir().unwrap();
        let (log, ends) = log(&folder.path().join("a.sqlite"));
        let last = *ends.last().unwrap();
        assert_eq!(Walk::through(&log).unwrap().end(), last as u64);
        for end in &ends {
            assert_eq!(Walk::through(&log[..*end]).unwrap().end(), *end as u64);
            assert!(Walk::through(&log[..end - 1]).unwrap().end() < *end as u64, "a torn commit is none");
        }
        for bit in (0..HEADER * 8).chain((HEADER * 8..log.len() * 8).step_by(97)) {
            let mut bad = log.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(Walk::through(&bad).is_none_or(|walk| walk.end() < last as u64), "bit {bit}");
        }
    }

    #[test]
    fn a_walk_goes_on_where_it_stopped() {
        let folder = tempfile::tempdir().unwrap();
        let (log, ends) = log(&folder.path().join("a.sqlite"));
        let header = log.first_chunk::<HEADER>().unwrap();
        let mut walk = Walk::through(&log[..ends[0]]).unwrap();
        assert!(walk.goes_on(header));
        walk.over(&log[ends[0]..]);
        assert_eq!(walk, Walk::through(&log).unwrap());
        let mut other = *header;
        other[16] ^= 1;
        assert!(!walk.goes_on(&other));
    }
}
