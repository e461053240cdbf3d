//! A configuration file as text, with the place of every key, so that any later finding can point at line and column.

use super::error::{ConfigError, Issue, Severity};
use std::collections::BTreeMap;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Largest configuration file that is read, bytes.
const LARGEST_FILE: u64 = 8 << 20;

/// Text of a file and where its keys stand.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// The path as asked for.
    pub path: PathBuf,
    /// The text.
    pub text: String,
    /// Byte ranges by full key, e.g. `camera.ccd.serial`, `incidence.directions[3]`.
    places: BTreeMap<String, Range<usize>>,
}

// === impl Source ===

impl Source {
    /// Reads a text file of at most 8 MiB.
    ///
    /// # Errors
    /// `NotFound`, `Unreadable`, or `Faulty` with one issue where the text is not TOML.
    pub fn read(path: &Path, role: &'static str) -> Result<Source, ConfigError> {
        let bytes = read_bytes(path, role, LARGEST_FILE)?;
        let text = String::from_utf8(bytes).map_err(|e| ConfigError::Unreadable {
            path: path.to_owned(),
            role,
            reason: format!("byte {} is not UTF-8; save the file as UTF-8 text", e.utf8_error().valid_up_to()),
        })?;
        Source::parse(path, text)
    }

    /// Finds the place of every key in a TOML text.
    ///
    /// # Errors
    /// `Faulty` with one issue where the text is not TOML.
    pub fn parse(path: &Path, text: String) -> Result<Source, ConfigError> {
        let mut source = Source { path: path.to_owned(), text, places: BTreeMap::new() };
        let mut places = BTreeMap::new();
        let failure = match DeTable::parse(&source.text) {
            Ok(table) => {
                places_of(table.get_ref(), "", &mut places);
                None
            }
            Err(e) => Some((e.span().unwrap_or(0..0), e.message().to_owned())),
        };
        if let Some((span, message)) = failure {
            let message = format!("this is not TOML: {}; correct the line", message.trim().replace('\n', ", "));
            let issue = source.issue_at(Severity::Error, span, "", message);
            return Err(ConfigError::Faulty { issues: vec![issue] });
        }
        source.places = places;
        Ok(source)
    }

    /// An issue at `key`, or at the nearest table above it where the key is not written in the file.
    pub fn issue(&self, severity: Severity, key: &str, message: impl Into<String>) -> Issue {
        let mut at = key;
        loop {
            if let Some(range) = self.places.get(at) {
                return self.issue_at(severity, range.clone(), key, message);
            }
            match at.rfind(['.', '[']) {
                Some(cut) => at = &at[..cut],
                None => return self.issue_at(severity, 0..0, key, message),
            }
        }
    }

    /// An issue at a byte range of the text.
    pub fn issue_at(&self, severity: Severity, range: Range<usize>, key: &str, message: impl Into<String>) -> Issue {
        let start = floor_char(&self.text, range.start);
        let before = &self.text[..start];
        let line_start = before.rfind('\n').map_or(0, |n| n + 1);
        let source_line = self.text[line_start..].lines().next().unwrap_or("").to_owned();
        let end = floor_char(&self.text, range.end.max(start)).min(line_start + source_line.len()).max(start);
        Issue {
            severity,
            path: self.path.clone(),
            line: before.matches('\n').count() + 1,
            column: self.text[line_start..start].chars().count() + 1,
            key: key.to_owned(),
            message: message.into(),
            source_line,
            width: self.text[start..end].chars().count().max(1),
        }
    }

    /// True where the key is written in the file.
    pub fn has(&self, key: &str) -> bool {
        self.places.contains_key(key)
    }
}

/// Reads a file of bounded size.
///
/// # Errors
/// `NotFound` or `Unreadable`, with what to do.
pub fn read_bytes(path: &Path, role: &'static str, largest: u64) -> Result<Vec<u8>, ConfigError> {
    let unreadable = |reason: String| ConfigError::Unreadable { path: path.to_owned(), role, reason };
    let meta = std::fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => ConfigError::NotFound { path: path.to_owned(), role },
        _ => unreadable(format!("{e}; check the rights of the file and its folders")),
    })?;
    if meta.is_dir() {
        return Err(unreadable("it is a folder; name the file in it".into()));
    }
    // A pipe would be waited for, a device read without end.
    if !meta.is_file() {
        return Err(unreadable("it is no regular file but a device, a pipe or a socket; name a file".into()));
    }
    let mut bytes = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(largest + 1).read_to_end(&mut bytes));
    read.map_err(|e| unreadable(format!("{e}; check the rights of the file")))?;
    if bytes.len() as u64 > largest {
        let size = meta.len().max(largest + 1);
        return Err(unreadable(format!("it has {size} bytes, more than the {largest} allowed; is it the right file?")));
    }
    Ok(bytes)
}

/// The full name of `key` under `table`.
pub fn join(table: &str, key: &str) -> String {
    if table.is_empty() { key.to_owned() } else { format!("{table}.{key}") }
}

fn places_of(table: &DeTable<'_>, name: &str, out: &mut BTreeMap<String, Range<usize>>) {
    for (key, value) in table {
        let full = join(name, key.get_ref());
        // A table is shown by its header's key, a value by itself: the eye goes to what must be changed.
        let is_table = matches!(value.get_ref(), DeValue::Table(_));
        out.insert(full.clone(), if is_table { key.span() } else { value.span() });
        places_of_value(value, &full, out);
    }
}

fn places_of_value(value: &Spanned<DeValue<'_>>, name: &str, out: &mut BTreeMap<String, Range<usize>>) {
    match value.get_ref() {
        DeValue::Table(table) => places_of(table, name, out),
        DeValue::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                let full = format!("{name}[{i}]");
                out.insert(full.clone(), item.span());
                places_of_value(item, &full, out);
            }
        }
        _ => {}
    }
}

fn floor_char(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn places_are_lines_and_columns_in_characters() {
        let text = "name = \"µ\"\n[a.b]\nlist = [1, [2, 3]]\n";
        let s = Source::parse(Path::new("x.toml"), text.into()).unwrap();
        let at = |key: &str| {
            let i = s.issue(Severity::Error, key, "m");
            (i.line, i.column, i.width)
        };
        assert_eq!(at("name"), (1, 8, 3));
        assert_eq!(at("a.b.list[1][0]"), (3, 13, 1));
        assert_eq!(at("a.b.list[9].z"), (3, 8, 11), "a key that is not there points at what holds it");
        assert_eq!(at("a.b.missing"), (2, 4, 1));
        assert_eq!(at("nowhere").0, 1);
    }

    #[test]
    fn broken_toml_points_at_the_place() {
        let error = Source::parse(Path::new("x.toml"), "a = 1\nb = = 2\n".into()).unwrap_err();
        let issue = &error.issues()[0];
        assert_eq!((issue.line, issue.column), (2, 5));
        assert!(issue.message.starts_with("this is not TOML"), "{}", issue.message);
    }

    #[test]
    fn files_that_cannot_be_read_say_why() {
        let dir = tempfile::tempdir().unwrap();
        let missing = Source::read(&dir.path().join("no.toml"), "scan").unwrap_err();
        assert!(missing.to_string().contains("no such scan file"));
        let folder = Source::read(dir.path(), "scan").unwrap_err();
        assert!(folder.to_string().contains("folder"));
        let path = dir.path().join("latin1.toml");
        std::fs::write(&path, b"name = \"\xe9\"").unwrap();
        assert!(Source::read(&path, "scan").unwrap_err().to_string().contains("UTF-8"));
    }
}
