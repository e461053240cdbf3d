//! What can be wrong with what people write: one enum, every fault with file, line, column, key and what to do.

use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// Longest piece of a source line that is shown under a message.
const SHOWN_CHARS: usize = 120;

/// Why configuration files cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ConfigError {
    /// The file is not there.
    #[error("{path}: there is no such {role} file; check the path, or make one after the examples in config/", path = .path.display())]
    NotFound {
        /// The path as asked for.
        path: PathBuf,
        /// What the file was wanted for: `scan`, `instrument`, `calibration`.
        role: &'static str,
    },
    /// The file is there but cannot be read as text.
    #[error("{path}: the {role} file cannot be read: {reason}", path = .path.display())]
    Unreadable {
        /// The path as asked for.
        path: PathBuf,
        /// What the file was wanted for.
        role: &'static str,
        /// The reason and what to do.
        reason: String,
    },
    /// The files say something that cannot be done; all faults that were found, in the order of the files.
    #[error("{}", listed(.issues))]
    Faulty {
        /// Faults (and warnings found on the way); at least one is an error.
        issues: Vec<Issue>,
    },
}

/// How grave an issue is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// The scan cannot be run.
    Error,
    /// The scan can be run, but somebody should know.
    Warning,
}

/// One thing that is wrong, with its place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Issue {
    /// Error or warning.
    pub severity: Severity,
    /// File, as it was asked for.
    pub path: PathBuf,
    /// Line, counted from 1.
    pub line: usize,
    /// Column in characters, counted from 1.
    pub column: usize,
    /// Key with its tables, e.g. `exposure.longest_s`; empty where no key can be named.
    pub key: String,
    /// What is wrong, what is allowed, what to do: one sentence.
    pub message: String,
    /// The line of the file.
    pub source_line: String,
    /// Characters to underline.
    pub width: usize,
}

// === impl ConfigError ===

impl ConfigError {
    /// The issues of a faulty file; empty for a file that could not be read at all.
    pub fn issues(&self) -> &[Issue] {
        match self {
            ConfigError::Faulty { issues } => issues,
            ConfigError::NotFound { .. } | ConfigError::Unreadable { .. } => &[],
        }
    }
}

fn listed(issues: &[Issue]) -> String {
    issues.iter().map(Issue::to_string).collect::<Vec<_>>().join("\n")
}

// === impl Issue ===

impl Issue {
    /// The source line cut to a readable piece around the place, with the column of the caret in it (from 0).
    fn shown(&self) -> (String, usize) {
        let chars: Vec<char> = self.source_line.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        let at = self.column.saturating_sub(1).min(chars.len());
        if chars.len() <= SHOWN_CHARS {
            return (chars.into_iter().collect(), at);
        }
        let from = at.saturating_sub(SHOWN_CHARS / 2);
        let cut: String = chars.into_iter().skip(from).take(SHOWN_CHARS).collect();
        (cut, at - from)
    }
}

impl fmt::Display for Issue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        writeln!(f, "{}:{}:{}: {kind}: {}", self.path.display(), self.line, self.column, self.message)?;
        let number = self.line.to_string();
        let gutter = " ".repeat(number.len());
        let (text, at) = self.shown();
        let width = self.width.clamp(1, text.chars().count().saturating_sub(at).max(1));
        writeln!(f, "  {number} | {text}")?;
        write!(f, "  {gutter} | {}{}", " ".repeat(at), "^".repeat(width))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_caret_stands_under_the_value_even_in_a_long_line() {
        let line = format!("{}bad{}", "x".repeat(300), "y".repeat(300));
        let issue = Issue {
            severity: Severity::Error,
            path: "a.toml".into(),
            line: 7,
            column: 301,
            key: "k".into(),
            message: "`k` is bad".into(),
            source_line: line,
            width: 3,
        };
        let text = issue.to_string();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "a.toml:7:301: error: `k` is bad");
        assert_eq!(lines[1].find("bad"), lines[2].find("^^^"));
        assert!(lines[1].len() < 140);
    }
}
