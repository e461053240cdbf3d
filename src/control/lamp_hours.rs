//! For how long a lamp has burnt, kept across runs: one small file a lamp beside the run directories.
//!
//! The file holds only what was watched: a lamp is known by its serial number, so that another lamp has another file and
//! begins at its own `lamp.hours_at_start`. What is not known is told as unknown and never guessed.

use crate::archive::write_atomic;
use crate::config::instrument::{Instrument, Lamp};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where the hours of a lamp are kept, and what the instrument file says of it.
#[derive(Debug, Clone, PartialEq)]
pub struct LampLog {
    path: PathBuf,
    serial: String,
    at_start_h: Option<f64>,
    rated_h: Option<f64>,
}

/// How old a lamp is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LampAge {
    /// Its serial number.
    pub serial: String,
    /// Hours before the first run with it; absent where the instrument file does not say.
    pub at_start_h: Option<f64>,
    /// Hours it was watched burning since; absent where the file that keeps them cannot be read.
    pub watched_h: Option<f64>,
    /// Hours the maker rates it for.
    pub rated_h: Option<f64>,
}

/// The file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    serial: String,
    watched_s: f64,
}

/// Why hours cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum LampLogError {
    /// The file is there and holds no hours of this lamp.
    #[error(
        "{path}: cannot be read ({why}), so the hours of lamp {serial} are unknown; mend the file, or remove it and write \
         the lamp's hours into `lamp.hours_at_start`"
    )]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The lamp.
        serial: String,
        /// What is wrong with it.
        why: String,
    },
    /// The file cannot be written.
    #[error("the hours of lamp {serial} cannot be kept: {source}")]
    Unwritable {
        /// The lamp.
        serial: String,
        /// What the disk says.
        source: crate::archive::ArchiveError,
    },
}

// === impl LampLog ===

impl LampLog {
    /// The log of an instrument's lamp in its folder of runs; none for a lamp without a serial number.
    pub fn of(instrument: &Instrument, runs_dir: &Path) -> Option<LampLog> {
        let lamp = &instrument.lamp;
        let serial = lamp.serial.clone().filter(|serial| Lamp::is_serial(serial))?;
        let path = runs_dir.join(format!("lamp-{serial}.json"));
        Some(LampLog { path, serial, at_start_h: lamp.hours_at_start, rated_h: lamp.rated_hours })
    }

    /// How old the lamp is. A lamp without a file has not been watched yet.
    ///
    /// # Errors
    /// [`LampLogError::Unreadable`].
    pub fn age(&self) -> Result<LampAge, LampLogError> {
        self.watched().map(|watched| self.aged(Some(watched)))
    }

    /// The same, the watched hours unknown where the file cannot be read.
    pub fn age_if_known(&self) -> LampAge {
        self.aged(self.watched().ok())
    }

    /// The lamp where what was watched is not known.
    pub fn age_unknown(&self) -> LampAge {
        self.aged(None)
    }

    /// Adds what was watched; a file that cannot be read stays as it is.
    ///
    /// # Errors
    /// [`LampLogError`]; nothing was added then.
    pub fn add(&self, burnt: Duration) -> Result<LampAge, LampLogError> {
        let watched = self.watched()? + burnt;
        let kept = Kept { serial: self.serial.clone(), watched_s: watched.as_secs_f64() };
        let text = serde_json::to_string(&kept).map_err(|e| self.unreadable(&e))?;
        write_atomic(&self.path, text.as_bytes())
            .map_err(|source| LampLogError::Unwritable { serial: self.serial.clone(), source })?;
        Ok(self.aged(Some(watched)))
    }

    fn watched(&self) -> Result<Duration, LampLogError> {
        let text = match std::fs::read_to_string(&self.path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Duration::ZERO),
            Err(e) => return Err(self.unreadable(&e)),
        };
        let kept: Kept = serde_json::from_str(&text).map_err(|e| self.unreadable(&e))?;
        if kept.serial != self.serial {
            return Err(self.unreadable(&format!("it is that of lamp {}", kept.serial)));
        }
        Duration::try_from_secs_f64(kept.watched_s).map_err(|e| self.unreadable(&e))
    }

    fn aged(&self, watched: Option<Duration>) -> LampAge {
        LampAge {
            serial: self.serial.clone(),
            at_start_h: self.at_start_h,
            watched_h: watched.map(|watched| watched.as_secs_f64() / 3600.0),
            rated_h: self.rated_h,
        }
    }

    fn unreadable(&self, why: &dyn std::fmt::Display) -> LampLogError {
        LampLogError::Unreadable { path: self.path.clone(), serial: self.serial.clone(), why: why.to_string() }
    }
}

// === impl LampAge ===

impl LampAge {
    /// All its hours; `None` where a part of them is not known.
    pub fn hours(&self) -> Option<f64> {
        Some(self.at_start_h? + self.watched_h?)
    }

    /// Its hours in words: `512.3 h`, `at least 12.3 h`, `unknown`.
    pub fn hours_in_words(&self) -> String {
        match (self.hours(), self.at_start_h.or(self.watched_h)) {
            (Some(hours), _) => format!("{hours:.1} h"),
            (None, Some(known)) => format!("at least {known:.1} h"),
            (None, None) => "unknown".to_owned(),
        }
    }

    /// The lamp in one line.
    pub fn words(&self) -> String {
        let rated = self.rated_h.map_or_else(String::new, |rated| format!(" of {rated:.0} h rated"));
        format!("lamp {}: {}{rated}", self.serial, self.hours_in_words())
    }

    /// What to know before a run of `run_s` seconds: the rated hours are over, or will be before its end.
    pub fn warning(&self, run_s: f64) -> Option<String> {
        let rated = self.rated_h?;
        // What is known is the least that it can have.
        let least = self.at_start_h.unwrap_or(0.0) + self.watched_h.unwrap_or(0.0);
        let words = self.hours_in_words();
        if least >= rated {
            Some(format!("lamp {} has burnt for {words}, longer than its rated {rated:.0} h: replace it", self.serial))
        } else if least + run_s / 3600.0 > rated {
            let run_h = run_s / 3600.0;
            Some(format!(
                "lamp {} has burnt for {words} and will exceed its rated {rated:.0} h during this run of {run_h:.1} h: \
                 replace it before",
                self.serial
            ))
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::config::testing::instrument;

    const HOUR: Duration = Duration::from_secs(3600);

    fn log(folder: &Path, serial: &str, at_start_h: Option<f64>) -> LampLog {
        let mut i = instrument();
        i.lamp.serial = Some(serial.to_owned());
        (i.lamp.hours_at_start, i.lamp.rated_hours) = (at_start_h, Some(750.0));
        LampLog::of(&i, folder).unwrap()
    }

    #[test]
    fn hours_are_kept_across_runs_and_another_lamp_begins_at_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let old = log(folder.path(), "A-1", Some(700.0));
        assert_eq!(old.age().unwrap().hours(), Some(700.0), "nothing was watched yet");
        assert_eq!(old.add(10 * HOUR).unwrap().hours(), Some(710.0));
        assert_eq!(
            log(folder.path(), "A-1", Some(700.0)).add(HOUR / 2).unwrap().words(),
            "lamp A-1: 710.5 h of 750 h rated"
        );
        assert_eq!(log(folder.path(), "A-2", Some(0.0)).age().unwrap().hours(), Some(0.0));
        assert_eq!(log(folder.path(), "A-1", Some(700.0)).age().unwrap().hours(), Some(710.5), "the old one put back");
    }

    #[test]
    fn what_is_not_known_is_not_guessed() {
        let folder = tempfile::tempdir().unwrap();
        let age = log(folder.path(), "A-1", None).add(12 * HOUR).unwrap();
        assert_eq!((age.hours(), age.hours_in_words()), (None, "at least 12.0 h".to_owned()));
        for text in ["", "{}", r#"{"serial":"A-1","watched_s":-3}"#, r#"{"serial":"B","watched_s":3}"#, "\u{0}"] {
            let file = folder.path().join("lamp-A-1.json");
            std::fs::write(&file, text).unwrap();
            let log = log(folder.path(), "A-1", Some(700.0));
            let error = log.add(HOUR).unwrap_err().to_string();
            assert!(error.contains("lamp-A-1.json: cannot be read") && error.contains("unknown"), "{error}");
            assert_eq!(std::fs::read_to_string(&file).unwrap(), text, "it stays as it is");
            let age = log.age_if_known();
            assert_eq!((age.hours(), age.hours_in_words()), (None, "at least 700.0 h".to_owned()));
        }
        let mut i = instrument();
        assert_eq!(LampLog::of(&i, folder.path()), None, "a lamp without a serial number has no log");
        i.lamp.serial = Some("../a".to_owned());
        assert_eq!(LampLog::of(&i, folder.path()), None);
    }

    #[test]
    fn rated_hours_that_are_over_or_will_be_are_warned_of() {
        let age =
            |at_start_h, watched_h| LampAge { serial: "A".to_owned(), at_start_h, watched_h, rated_h: Some(750.0) };
        assert_eq!(age(Some(730.0), Some(5.0)).warning(14.0 * 3600.0), None);
        assert!(age(Some(730.0), Some(5.0)).warning(16.0 * 3600.0).unwrap().contains("735.0 h and will exceed"));
        assert!(age(Some(730.0), Some(20.0)).warning(0.0).unwrap().contains("longer than its rated 750 h"));
        assert!(age(None, Some(800.0)).warning(0.0).unwrap().contains("at least 800.0 h"));
        assert_eq!(age(None, None).warning(1e6), None, "how old it is nobody knows, and 278 h are not 750 h");
        assert_eq!(LampAge { rated_h: None, ..age(Some(1e4), None) }.warning(1e6), None);
    }
}
