//! Copies of everything a scan was checked with, so that nothing edited later changes what runs.
//!
//! The copies lie in a tree of their own under the paths they had (`files/etc/goniod/scans/a.toml`), so that relative
//! paths between them still hold.

use super::error::DaemonError;
use crate::archive::write_atomic;
use crate::config::check::{Checked, Options, check};
use crate::control::plan::document::KeptFile;
use crate::front::daemon::entry::{QueuedScan, SimulatedBench};
use std::path::{Component, Path, PathBuf};

/// Folder of an entry that holds the copies.
pub const FILES: &str = "files";

/// The absolute path without `.` and `..`, by its words alone.
pub fn plain(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let mut out = PathBuf::new();
    for part in absolute.components() {
        match part {
            Component::ParentDir => {
                out.pop();
            }
            Component::CurDir => {}
            other => out.push(other),
        }
    }
    out
}

/// Where the copy of `path` lies in the entry's folder.
fn copy_of(folder: &Path, path: &Path) -> PathBuf {
    let mut copy = folder.join(FILES);
    copy.extend(plain(path).components().filter(|c| matches!(c, Component::Normal(_))));
    copy
}

/// Names and digests of the files of a check.
pub fn kept(checked: &Checked) -> Vec<KeptFile> {
    let kept = |f: &crate::config::check::InputFile| KeptFile {
        role: f.role.clone(),
        name: f.name.clone(),
        sha256: f.sha256.clone(),
    };
    checked.files.iter().map(kept).collect()
}

/// The simulated bench of a check, by absolute paths.
pub fn simulated(checked: &Checked) -> Option<SimulatedBench> {
    let bench = plain(checked.bench.as_ref()?);
    Some(SimulatedBench { bench, sample: checked.simulated_sample.as_deref().map(plain) })
}

/// Writes the copies of every file into an entry's folder.
///
/// # Errors
/// Storage failures.
pub fn write(folder: &Path, checked: &Checked) -> Result<(), DaemonError> {
    for file in &checked.files {
        write_atomic(&copy_of(folder, &file.path), &file.bytes)?;
    }
    Ok(())
}

/// Checks the copies again and proves that they are what was put into the queue. The simulated bench, which is no
/// configuration, is the one that stands there now.
///
/// # Errors
/// [`DaemonError::Snapshot`] where a copy is damaged, or where a file that the copies name by an absolute path is
/// another one now.
pub fn read(folder: &Path, scan: &QueuedScan, options: &Options) -> Result<Checked, DaemonError> {
    let refused = |why: String| DaemonError::Snapshot { why };
    let found = check(&copy_of(folder, &scan.scan), &copy_of(folder, &scan.instrument), options);
    let mut checked = found.map_err(|e| refused(e.to_string()))?;
    for (now, then) in kept(&checked).iter().zip(&scan.files) {
        if (&now.role, &now.sha256) != (&then.role, &then.sha256) {
            return Err(refused(format!(
                "`{}` ({}) has other content than when the scan was queued",
                then.name, then.role
            )));
        }
    }
    if checked.files.len() != scan.files.len() {
        return Err(refused(format!("{} files were queued, {} are there", scan.files.len(), checked.files.len())));
    }
    if let Some(simulated) = &scan.simulated {
        checked.bench = Some(simulated.bench.clone());
        checked.simulated_sample.clone_from(&simulated.sample);
    }
    Ok(checked)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_stand_to_each_other_as_the_files_did() {
        let folder = Path::new("/state/queue/000001");
        let scan = copy_of(folder, Path::new("/etc/goniod/scans/../scans/./a.toml"));
        assert_eq!(scan, Path::new("/state/queue/000001/files/etc/goniod/scans/a.toml"));
        let above = copy_of(folder, Path::new("/etc/../../../sample.toml"));
        assert_eq!(above, Path::new("/state/queue/000001/files/sample.toml"), "nothing leaves the tree");
    }
}
