//! Seals: digests over what is finished, so that any changed bit shows. `journal.seal` covers the closed journal,
//! `products/products.seal` every product; each line of a seal is itself covered.

use super::disk::{Disk, RealDisk, read_where_there, write_on};
use super::error::{ArchiveError, Result};
use super::rows::FrameRow;
use crate::digest::{TextDigest, sha256_hex};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Component, Path, PathBuf};

/// Digests over the closed journal.
pub const SEAL: &str = "journal.seal";
/// Folder of the products inside a run directory.
pub const PRODUCTS: &str = "products";
/// Digests over the products, inside their folder.
pub const PRODUCTS_SEAL: &str = "products.seal";

/// Line that tells the frames which the products were made from.
const FROM: &str = "frames";
/// Line that covers the lines above it.
const LAST: &str = "seal";

/// What is wrong with the products of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum ProductFault {
    /// The seal contradicts itself.
    Seal,
    /// Other bytes than were written.
    Changed(String),
    /// Gone.
    Missing(String),
    /// There is no seal: a cut while products are made leaves them so.
    NoSeal,
    /// The run has other frames now than the products were made from.
    OtherFrames,
}

/// The seal of a run's products, taken off while they are made: what a cut then leaves is unproven, not damaged.
#[derive(Debug)]
pub struct ProductSeal {
    folder: PathBuf,
    sealed: Sealed,
}

/// What the seal of the products tells.
#[derive(Debug, Default)]
struct Sealed {
    /// Digest of each product by its name.
    entries: BTreeMap<String, String>,
    /// Digest of the frames they were made from; the first seals did not tell it.
    frames: Option<String>,
}

// === impl ProductSeal ===

impl ProductSeal {
    /// Takes the seal off the products of the run directory `run`, durably, before one of them is made from `frames`
    /// (their [`frames_digest`]). What was made from the same frames before stays sealed; what was made from other frames,
    /// and was not touched since, is removed: it would contradict what is made now.
    ///
    /// # Errors
    /// [`ArchiveError::Io`] and the disk's kinds.
    pub fn lift(run: &Path, frames: String) -> Result<ProductSeal> {
        let folder = run.join(PRODUCTS);
        let path = folder.join(PRODUCTS_SEAL);
        let mut earlier = Sealed::default();
        if let Some(bytes) = read_where_there(&path)? {
            earlier = Sealed::read(bytes).unwrap_or_default();
            let gone = RealDisk.discard(&path).and_then(|()| RealDisk.sync_folder(&folder));
            gone.map_err(|e| ArchiveError::io("remove", &path, &e))?;
        }
        let mut entries = BTreeMap::new();
        if earlier.frames.as_ref() == Some(&frames) {
            entries = earlier.entries;
            entries.retain(|name, _| folder.join(name).is_file());
        } else if earlier.frames.is_some() {
            remove_untouched(&folder, &earlier.entries)?;
        }
        Ok(ProductSeal { folder, sealed: Sealed { entries, frames: Some(frames) } })
    }

    /// Puts the seal on again, over the products `written` (full paths) too.
    ///
    /// # Errors
    /// [`ArchiveError::Io`] and the disk's kinds.
    pub fn set(mut self, written: &[PathBuf]) -> Result<()> {
        for file in written {
            let bytes = fs::read(file).map_err(|e| ArchiveError::io("read", file, &e))?;
            self.sealed.entries.insert(name_in(&self.folder, file), sha256_hex(&bytes));
        }
        write_on(&RealDisk as &dyn Disk, &self.folder.join(PRODUCTS_SEAL), self.sealed.text().as_bytes())
    }
}

// === impl Sealed ===

impl Sealed {
    fn text(&self) -> String {
        let mut lines: String = self.entries.iter().map(|(name, digest)| format!("{digest} {name}\n")).collect();
        if let Some(frames) = &self.frames {
            lines += &format!("{frames} {FROM}\n");
        }
        let last = sha256_hex(lines.as_bytes());
        format!("{lines}{last} {LAST}\n")
    }

    /// `None` where the bytes are not what was written.
    fn read(bytes: Vec<u8>) -> Option<Sealed> {
        let text = String::from_utf8(bytes).ok()?;
        let mut lines: Vec<(&str, &str)> = text.lines().map(|line| line.split_once(' ')).collect::<Option<_>>()?;
        let (_, LAST) = lines.pop()? else { return None };
        let frames = lines.pop_if(|(_, name)| *name == FROM).map(|(digest, _)| digest.to_owned());
        let entries = lines.into_iter().map(|(digest, name)| (name.to_owned(), digest.to_owned())).collect();
        let sealed = Sealed { entries, frames };
        (sealed.text() == text).then_some(sealed)
    }
}

/// The text of the journal's seal: digest of the journal file, digest of its rows.
pub(super) fn journal_seal(file: &str, rows: &str) -> String {
    format!("journal.sqlite sha256 {file}\nrows sha256 {rows}\n")
}

/// SHA-256 over the frames that products are made from: which step has which. In the order of their steps.
pub fn frames_digest<'a>(frames: impl Iterator<Item = &'a FrameRow>) -> String {
    let mut text = TextDigest::default();
    for frame in frames {
        // Writing to a digest cannot fail.
        let _ = writeln!(text, "{} {}", frame.step, frame.digest);
    }
    text.hex()
}

/// Compares the products of `run` with their seal and with the run's frames, of which `frames` is the digest.
///
/// # Errors
/// [`ArchiveError::Io`] and the disk's kinds for what is there and cannot be read.
pub(super) fn check_products(run: &Path, frames: &str) -> Result<Vec<ProductFault>> {
    let folder = run.join(PRODUCTS);
    let Some(bytes) = read_where_there(&folder.join(PRODUCTS_SEAL))? else {
        return Ok(if folder.exists() { vec![ProductFault::NoSeal] } else { Vec::new() });
    };
    let Some(sealed) = Sealed::read(bytes) else { return Ok(vec![ProductFault::Seal]) };
    let (mut faults, shown) = (Vec::new(), |name: &String| format!("{PRODUCTS}/{name}"));
    for (name, digest) in &sealed.entries {
        match read_where_there(&folder.join(name))? {
            Some(bytes) if sha256_hex(&bytes) == *digest => {}
            Some(_) => faults.push(ProductFault::Changed(shown(name))),
            None => faults.push(ProductFault::Missing(shown(name))),
        }
    }
    if sealed.frames.as_deref().is_some_and(|made_from| made_from != frames) {
        faults.push(ProductFault::OtherFrames);
    }
    Ok(faults)
}

/// Removes products that still have the bytes that their seal told.
fn remove_untouched(folder: &Path, entries: &BTreeMap<String, String>) -> Result<()> {
    let ours = |name: &str| Path::new(name).components().all(|c| matches!(c, Component::Normal(_)));
    for (name, digest) in entries.iter().filter(|(name, _)| ours(name)) {
        let path = folder.join(name);
        if read_where_there(&path)?.is_some_and(|bytes| sha256_hex(&bytes) == *digest) {
            RealDisk.discard(&path).map_err(|e| ArchiveError::io("remove", &path, &e))?;
        }
    }
    Ok(())
}

/// The name of a file below `folder`, with `/`.
fn name_in(folder: &Path, file: &Path) -> String {
    let parts = file.strip_prefix(folder).unwrap_or(file).components();
    parts.map(|c| c.as_os_str().to_string_lossy().into_owned()).collect::<Vec<_>>().join("/")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn seal(run: &Path, frames: &str, written: &[PathBuf]) {
        ProductSeal::lift(run, frames.to_owned()).unwrap().set(written).unwrap();
    }

    fn two_products(run: &Path) -> (PathBuf, PathBuf) {
        let (one, two) = (run.join("products/a.xml"), run.join("products/plots/b c.png"));
        fs::create_dir_all(two.parent().unwrap()).unwrap();
        fs::write(&one, b"one").unwrap();
        fs::write(&two, b"two").unwrap();
        (one, two)
    }

    #[test]
    fn products_stay_sealed_and_every_bit_of_them_and_of_the_seal_counts() {
        let run = tempfile::tempdir().unwrap();
        let check = || check_products(run.path(), "f").unwrap();
        assert!(check().is_empty());
        let (one, two) = two_products(run.path());
        assert_eq!(check(), [ProductFault::NoSeal]);
        seal(run.path(), "f", std::slice::from_ref(&one));
        seal(run.path(), "f", std::slice::from_ref(&two));
        assert!(check().is_empty());
        for file in [&one, &two, &run.path().join("products").join(PRODUCTS_SEAL)] {
            let good = fs::read(file).unwrap();
            for bit in 0..good.len() * 8 {
                let mut bad = good.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                fs::write(file, bad).unwrap();
                assert!(!check().is_empty(), "{} bit {bit}", file.display());
            }
            fs::write(file, good).unwrap();
        }
        fs::remove_file(&one).unwrap();
        assert_eq!(check(), [ProductFault::Missing("products/a.xml".to_owned())]);
    }

    #[test]
    fn products_of_other_frames_and_products_half_made_are_told() {
        let run = tempfile::tempdir().unwrap();
        let check = |frames| check_products(run.path(), frames).unwrap();
        let (one, two) = two_products(run.path());
        seal(run.path(), "few", &[one.clone(), two.clone()]);
        assert_eq!((check("few"), check("all")), (vec![], vec![ProductFault::OtherFrames]));
        // Cut while they are made again, one of them touched by somebody before.
        fs::write(&two, b"touched").unwrap();
        let lifted = ProductSeal::lift(run.path(), "all".to_owned()).unwrap();
        assert!(!one.exists() && two.exists(), "only what is as it was made is removed");
        fs::write(&one, b"another one").unwrap();
        assert_eq!(check("all"), [ProductFault::NoSeal]);
        lifted.set(std::slice::from_ref(&one)).unwrap();
        assert!(check("all").is_empty() && two.exists());
    }

    #[test]
    fn the_first_seals_which_tell_no_frames_are_read() {
        let run = tempfile::tempdir().unwrap();
        let (one, two) = two_products(run.path());
        let entries = [(&one, "a.xml"), (&two, "plots/b c.png")];
        let entries = entries.map(|(file, name)| (name.to_owned(), sha256_hex(&fs::read(file).unwrap())));
        let first = Sealed { entries: entries.into(), frames: None };
        fs::write(run.path().join("products").join(PRODUCTS_SEAL), first.text()).unwrap();
        assert!(check_products(run.path(), "any").unwrap().is_empty());
    }
}
