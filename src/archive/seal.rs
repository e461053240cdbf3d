//! Seals: digests over what is finished, so that any changed bit shows. `journal.seal` covers the closed journal,
//! `products/products.seal` every product; each line of a seal is itself covered.

use super::disk::{Disk, RealDisk, write_on};
use super::error::{ArchiveError, Result};
use crate::digest::sha256_hex;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Digests over the closed journal.
pub const SEAL: &str = "journal.seal";
/// Folder of the products inside a run directory.
pub const PRODUCTS: &str = "products";
/// Digests over the products, inside their folder.
pub const PRODUCTS_SEAL: &str = "products.seal";

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
}

/// The text of the journal's seal: digest of the journal file, digest of its rows.
pub(super) fn journal_seal(file: &str, rows: &str) -> String {
    format!("journal.sqlite sha256 {file}\nrows sha256 {rows}\n")
}

/// Takes `written` products (full paths) into the seal of the run directory `run`; earlier ones stay in it.
///
/// # Errors
/// [`ArchiveError::Io`] and the disk's kinds.
pub fn seal_products(run: &Path, written: &[PathBuf]) -> Result<()> {
    let folder = run.join(PRODUCTS);
    let path = folder.join(PRODUCTS_SEAL);
    let mut entries = fs::read_to_string(&path).ok().and_then(|text| parse(&text)).unwrap_or_default();
    entries.retain(|name, _| folder.join(name).is_file());
    for file in written {
        let bytes = fs::read(file).map_err(|e| ArchiveError::io("read", file, &e))?;
        let parts = file.strip_prefix(&folder).unwrap_or(file).components();
        let name: Vec<_> = parts.map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
        entries.insert(name.join("/"), sha256_hex(&bytes));
    }
    write_on(&RealDisk as &dyn Disk, &path, text(&entries).as_bytes())
}

/// Compares the products of `run` with their seal; `None` when there is no seal.
pub(super) fn check_products(run: &Path) -> Option<Vec<ProductFault>> {
    let folder = run.join(PRODUCTS);
    let bytes = fs::read(folder.join(PRODUCTS_SEAL)).ok()?;
    let Some(entries) = String::from_utf8(bytes).ok().and_then(|text| parse(&text)) else {
        return Some(vec![ProductFault::Seal]);
    };
    let fault = |(name, digest): (&String, &String)| match fs::read(folder.join(name)) {
        Ok(bytes) if sha256_hex(&bytes) == *digest => None,
        Ok(_) => Some(ProductFault::Changed(format!("{PRODUCTS}/{name}"))),
        Err(_) => Some(ProductFault::Missing(format!("{PRODUCTS}/{name}"))),
    };
    Some(entries.iter().filter_map(fault).collect())
}

fn text(entries: &BTreeMap<String, String>) -> String {
    let lines: String = entries.iter().map(|(name, digest)| format!("{digest} {name}\n")).collect();
    let last = sha256_hex(lines.as_bytes());
    format!("{lines}{last} {LAST}\n")
}

/// Digests by name; `None` where the text is not what was written.
fn parse(sealed: &str) -> Option<BTreeMap<String, String>> {
    let lines: Vec<(&str, &str)> = sealed.lines().map(|line| line.split_once(' ')).collect::<Option<_>>()?;
    let ((_, LAST), entries) = lines.split_last()? else { return None };
    let entries = entries.iter().map(|(digest, name)| ((*name).to_owned(), (*digest).to_owned())).collect();
    (text(&entries) == sealed).then_some(entries)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn products_stay_sealed_and_every_bit_of_them_and_of_the_seal_counts() {
        let run = tempfile::tempdir().unwrap();
        let (one, two) = (run.path().join("products/a.xml"), run.path().join("products/plots/b c.png"));
        fs::create_dir_all(two.parent().unwrap()).unwrap();
        fs::write(&one, b"one").unwrap();
        fs::write(&two, b"two").unwrap();
        assert_eq!(check_products(run.path()), None);
        seal_products(run.path(), std::slice::from_ref(&one)).unwrap();
        seal_products(run.path(), std::slice::from_ref(&two)).unwrap();
        assert_eq!(check_products(run.path()), Some(vec![]));
        for file in [&one, &two, &run.path().join("products").join(PRODUCTS_SEAL)] {
            let good = fs::read(file).unwrap();
            for bit in 0..good.len() * 8 {
                let mut bad = good.clone();
                bad[bit / 8] ^= 1 << (bit % 8);
                fs::write(file, bad).unwrap();
                assert!(!check_products(run.path()).unwrap().is_empty(), "{} bit {bit}", file.display());
            }
            fs::write(file, good).unwrap();
        }
        fs::remove_file(&one).unwrap();
        assert_eq!(check_products(run.path()), Some(vec![ProductFault::Missing("products/a.xml".to_owned())]));
    }
}
