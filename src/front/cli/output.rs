//! What a command says: text for people on standard output, or one JSON document with `--json`; errors on standard
//! error (and in the JSON document). The only place of the program that prints.

use super::exit::Exit;
use serde::Serialize;
use std::io::Write;

/// Where a command's words go.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    /// One JSON document instead of text.
    pub json: bool,
}

/// A command that cannot do what was asked: which exit code, and what to say.
#[derive(Debug)]
pub struct Failure {
    /// The exit code.
    pub exit: Exit,
    /// One or more clear sentences.
    pub messages: Vec<String>,
}

/// What a command returns: how it ended, or why it could not.
pub type Outcome = Result<Exit, Failure>;

#[derive(Serialize)]
struct Document<'a, T: Serialize> {
    outcome: &'a str,
    exit_code: u8,
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    errors: &'a [String],
    #[serde(flatten)]
    result: Option<T>,
}

// === impl Failure ===

impl Failure {
    /// A failure with one sentence.
    pub fn new(exit: Exit, message: impl Into<String>) -> Failure {
        Failure { exit, messages: vec![message.into()] }
    }
}

// === impl Output ===

impl Output {
    /// Says the result of a command: `text` for people, `result` as the fields of the JSON document.
    pub fn result<T: Serialize>(&self, exit: Exit, result: &T, text: impl FnOnce() -> String) -> Outcome {
        if self.json {
            self.document(exit, &[], Some(result));
        } else {
            self.line(&text());
        }
        Ok(exit)
    }

    /// Says the result of a command that failed in its last part, and why it failed.
    pub fn result_with<T: Serialize>(&self, failure: &Failure, result: &T, text: impl FnOnce() -> String) -> Outcome {
        if self.json {
            self.document(failure.exit, &failure.messages, Some(result));
        } else {
            self.line(&text());
        }
        Ok(self.complain(failure))
    }

    /// Says why a command failed.
    pub fn failure(&self, failure: &Failure) -> Exit {
        if self.json {
            self.document::<()>(failure.exit, &failure.messages, None);
        }
        self.complain(failure)
    }

    fn complain(&self, failure: &Failure) -> Exit {
        for message in &failure.messages {
            let _ = writeln!(std::io::stderr(), "goniod: {message}");
        }
        failure.exit
    }

    /// A line for people; silent with `--json`.
    pub fn say(&self, text: &str) {
        if !self.json {
            self.line(text);
        }
    }

    /// A line of a stream of documents, as it is.
    pub fn raw_line(&self, text: &str) {
        self.line(text);
    }

    /// A warning for people, on standard error.
    pub fn warn(&self, text: &str) {
        let _ = writeln!(std::io::stderr(), "goniod: warning: {text}");
    }

    fn line(&self, text: &str) {
        let _ = writeln!(std::io::stdout(), "{text}");
    }

    fn document<T: Serialize>(&self, exit: Exit, errors: &[String], result: Option<T>) {
        let document = Document { outcome: exit.name(), exit_code: exit.code(), errors, result };
        match serde_json::to_string_pretty(&document) {
            Ok(text) => self.line(&text),
            Err(error) => self.line(&format!("{{\"outcome\":\"failed\",\"exit_code\":1,\"errors\":[\"{error}\"]}}")),
        }
    }
}
