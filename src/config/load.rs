//! A file becomes a struct: read, compare every key with the schema (all faults at once), then deserialise.

use super::error::{ConfigError, Issue, Severity};
use super::hint;
use super::schema::{self, Key, Kind, Schema};
use super::source::{Source, join};
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A file's value with the text it came from.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded<T> {
    /// The value.
    pub value: T,
    /// Text and places of the keys.
    pub source: Source,
}

/// Compares a parsed file with a schema.
struct Walk<'a> {
    source: &'a Source,
    schema: &'a Schema,
    issues: Vec<Issue>,
}

/// Reads the file at `path`; `role` (`scan`, `instrument`, `calibration`) is for the messages.
///
/// # Errors
/// `NotFound`, `Unreadable`, or `Faulty` with every unknown, missing or mistyped key.
pub fn load<T: DeserializeOwned>(path: &Path, role: &'static str) -> Result<Loaded<T>, ConfigError> {
    parse(Source::read(path, role)?)
}

/// The same for a text already read.
///
/// # Errors
/// `Faulty` with every unknown, missing or mistyped key.
pub fn parse<T: DeserializeOwned>(source: Source) -> Result<Loaded<T>, ConfigError> {
    let schema = schema::of::<T>();
    let issues = {
        let mut walk = Walk { source: &source, schema: &schema, issues: Vec::new() };
        if let Ok(table) = DeTable::parse(&source.text) {
            walk.table(table.get_ref(), "", "");
        }
        walk.issues
    };
    if !issues.is_empty() {
        return Err(ConfigError::Faulty { issues });
    }
    match toml::from_str::<T>(&source.text) {
        Ok(value) => Ok(Loaded { value, source }),
        Err(e) => {
            let message = format!("this cannot be read: {}", e.message().trim().replace('\n', ", "));
            let issue = source.issue_at(Severity::Error, e.span().unwrap_or(0..0), "", message);
            Err(ConfigError::Faulty { issues: vec![issue] })
        }
    }
}

// === impl Walk ===

impl Walk<'_> {
    fn fault(&mut self, name: &str, message: String) {
        self.issues.push(self.source.issue(Severity::Error, name, message));
    }

    /// `name` is the table as written, `pattern` the same in the schema.
    fn table(&mut self, table: &DeTable<'_>, name: &str, pattern: &str) {
        let mut meant = Vec::new();
        let is_map = self.schema.get(pattern).is_some_and(|k| k.kind == Kind::Map);
        for (key, value) in table {
            let key_text: &str = key.get_ref();
            let full = join(name, key_text);
            let child = join(pattern, if is_map { "*" } else { key_text });
            match self.schema.get(&child) {
                Some(known) => self.value(value, &full, &child, known),
                None => {
                    meant.extend(hint::meant(self.schema, pattern, key_text));
                    let message = hint::unknown_key(self.schema, pattern, name, key_text);
                    self.issues.push(self.source.issue_at(Severity::Error, key.span(), &full, message));
                }
            }
        }
        if is_map {
            return;
        }
        for (child, key) in schema::children(self.schema, pattern) {
            if key.required && !table.contains_key(child) && !meant.contains(&child) {
                let message = hint::missing_key(self.schema, pattern, name, child, &key.kind);
                self.issues.push(self.source.issue(Severity::Error, &join(name, child), message));
            }
        }
    }

    fn value(&mut self, value: &Spanned<DeValue<'_>>, name: &str, pattern: &str, key: &Key) {
        let fits = match (&key.kind, value.get_ref()) {
            (Kind::Number, DeValue::Float(_) | DeValue::Integer(_)) | (Kind::Flag, DeValue::Boolean(_)) => true,
            (Kind::Whole { max }, DeValue::Integer(i)) => {
                i64::from_str_radix(i.as_str(), i.radix()).is_ok_and(|v| u64::try_from(v).is_ok_and(|v| v <= *max))
            }
            (Kind::Text, DeValue::String(_)) => true,
            (Kind::Day, DeValue::String(s)) => s.parse::<jiff::civil::Date>().is_ok(),
            (Kind::Choice(words), DeValue::String(s)) => words.contains(&s.as_ref()),
            (Kind::Table | Kind::Map, DeValue::Table(table)) => {
                self.table(table, name, pattern);
                true
            }
            (Kind::List, DeValue::Array(items)) => self.items(items.iter(), name, pattern),
            (Kind::Tuple(len), DeValue::Array(items)) if items.len() == *len => self.items(items.iter(), name, pattern),
            _ => false,
        };
        if !fits {
            let message = hint::wrong_value(name, &key.kind, value.get_ref());
            self.fault(name, message);
        }
    }

    fn items<'i>(&mut self, items: impl Iterator<Item = &'i Spanned<DeValue<'i>>>, name: &str, pattern: &str) -> bool {
        let child = format!("{pattern}[]");
        if let Some(key) = self.schema.get(&child) {
            for (i, item) in items.enumerate() {
                self.value(item, &format!("{name}[{i}]"), &child, key);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::config::scan::Scan;

    const GOOD: &str = r#"
name = "n"
[sample]
thickness_mm = 3
[incidence]
directions = [[0, 0], [30.5, 180]]
sides = ["transmission-front"]
[bands]
use = ["f5"]
[exposure]
policy = "ladder"
ratio = 8.0
shortest_s = 0.001
longest_s = 4.0
"#;

    fn faults(text: &str) -> Vec<Issue> {
        let source = Source::parse(Path::new("s.toml"), text.into()).unwrap();
        parse::<Scan>(source).unwrap_err().issues().to_vec()
    }

    /// One fault made by replacing `from` with `to`, which must be at `to`'s line and say every word.
    fn one(from: &str, to: &str, words: &[&str]) {
        assert!(GOOD.contains(from));
        let text = GOOD.replace(from, to);
        let found = faults(&text);
        assert_eq!(found.len(), 1, "{found:?}");
        let needle = to.lines().last().unwrap();
        let line = text.lines().position(|l| l.contains(needle)).unwrap() + 1;
        assert_eq!(found[0].line, line, "{}", found[0]);
        for word in words {
            assert!(found[0].message.contains(word), "{:?} lacks {word:?}", found[0].message);
        }
    }

    #[test]
    fn a_good_file_is_read_and_whole_numbers_are_numbers() {
        let loaded = parse::<Scan>(Source::parse(Path::new("s.toml"), GOOD.into()).unwrap()).unwrap();
        assert_eq!(loaded.value.sample.thickness_mm, 3.0);
        assert_eq!(loaded.value.incidence.directions.unwrap()[1], [30.5, 180.0]);
    }

    #[test]
    fn unknown_keys_name_the_nearest_and_the_unit() {
        one("ratio = 8.0", "ratio = 8.0\nlongst_s = 1.0", &["longst_s", "did you mean `longest_s`"]);
        one("longest_s = 4.0", "longest_s = 4.0\nshortest_ms = 1", &["`shortest_s`", "seconds", "0.001"]);
        one("longest_s = 4.0", "longest_s = 4.0\nexposure_ms = 30", &["seconds", "`longest_s`", "`shortest_s`"]);
        one("policy = \"ladder\"", "policy = \"ladder\"\nthickness_mm = 1.0", &["[sample]"]);
        one("longest_s = 4.0", "longest_s = 4.0\n[exposur]", &["did you mean `exposure`"]);
    }

    #[test]
    fn wrong_types_say_what_to_write() {
        one("4.0", "\"30 s\"", &["exposure.longest_s", "seconds", "write 30.0"]);
        one("4.0", "\"500 ms\"", &["write 0.5"]);
        one("4.0", "\"4\"", &["write 4.0"]);
        one("4.0", "true", &["a number"]);
        one("\"ladder\"", "\"auto\"", &["\"ladder\""]);
        one("\"transmission-front\"", "\"transmision-front\"", &["did you mean \"transmission-front\"", "sides[0]"]);
        one("[0, 0]", "[0, 0, 1]", &["directions[0]", "2 values"]);
        one("[\"f5\"]", "\"f5\"", &["list", "[\"f5\"]"]);
        one("name = \"n\"", "name = 3", &["text", "\"3\""]);
    }

    #[test]
    fn missing_keys_are_all_told_at_their_table() {
        let text = GOOD.replace("ratio = 8.0\n", "").replace("[sample]\nthickness_mm = 3\n", "");
        let found = faults(&text);
        let keys: Vec<&str> = found.iter().map(|i| i.key.as_str()).collect();
        assert_eq!(keys, ["exposure.ratio", "sample"]);
        assert_eq!(found[0].source_line, "[exposure]");
    }
}
