//! What a subject found out, line by line: `PASS subject/check: figures`, `FAIL subject/check: reason`.

use goniod_drivers::clock::Clock;
use std::future::Future;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

/// What a check gives: its figures, or why it failed.
pub type Outcome = Result<String, Box<dyn std::error::Error + Send + Sync>>;

/// A failure unless the condition holds.
#[macro_export]
macro_rules! ensure {
    ($holds:expr, $($why:tt)+) => {
        if !$holds {
            return Err(format!($($why)+).into());
        }
    };
}

/// The lines of one subject.
pub struct Report {
    subject: String,
    failed: u32,
}

// === impl Report ===

impl Report {
    /// Nothing checked yet.
    pub fn new(subject: &str) -> Report {
        Report { subject: subject.to_owned(), failed: 0 }
    }

    /// Runs a check; it has failed when it takes longer than `limit`, by far longer than ever seen.
    pub async fn check(&mut self, name: &str, limit: Duration, check: impl Future<Output = Outcome>) {
        let clock = Clock::system();
        match clock.timeout(limit, check).await {
            Ok(Ok(figures)) => self.line("PASS", name, &format!("{figures} ({:.1} s)", clock.elapsed().as_secs_f64())),
            Ok(Err(why)) => self.fail(name, &why.to_string()),
            Err(_) => self.fail(name, &format!("not done within {} s", limit.as_secs())),
        }
    }

    /// A failed check.
    pub fn fail(&mut self, name: &str, why: &str) {
        self.failed += 1;
        self.line("FAIL", name, why);
    }

    fn line(&self, verdict: &str, name: &str, text: &str) {
        let mut out = std::io::stdout().lock();
        let _ = writeln!(out, "{verdict} {}/{name}: {}", self.subject, text.replace('\n', " "));
        let _ = out.flush();
    }

    /// Zero when nothing failed.
    pub fn end(self) -> ExitCode {
        ExitCode::from(u8::from(self.failed > 0))
    }
}
