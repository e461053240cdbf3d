//! The hours of the lamp during a run: told at its beginning and its end, kept on the disk in between.

use super::stage::Stage;
use crate::control::events::Event;
use crate::control::lamp_hours::{LampAge, LampLog, LampLogError};
use std::time::Duration;

/// How often they are written: what a killed process loses at most.
const WRITTEN_EVERY: Duration = Duration::from_secs(60);
/// A disk that takes longer is not waited for.
const WRITE_LIMIT: Duration = Duration::from_secs(5);

/// The hours of the lamp of a run under way.
pub(super) struct Hours {
    log: LampLog,
    /// Burning time of this run that is on the disk.
    kept: Duration,
    begun: bool,
    /// A failure was told; once is enough.
    failed: bool,
}

// === impl Hours ===

impl Hours {
    /// Nothing is told or written yet.
    pub(super) fn new(log: LampLog) -> Hours {
        Hours { log, kept: Duration::ZERO, begun: false, failed: false }
    }

    /// The lamp has burnt for so long since the run began; at its `end` that is written and told whatever it is.
    pub(super) async fn note(&mut self, burnt: Duration, end: bool, stage: &Stage) {
        if !self.begun {
            self.begun = true;
            let age = self.with_log(stage, |log| log.age()).await;
            self.tell(age.unwrap_or_default(), stage).await;
        }
        let more = burnt.saturating_sub(self.kept);
        if end || (more >= WRITTEN_EVERY && !self.failed) {
            let age = self.with_log(stage, move |log| log.add(more)).await;
            if age.is_ok() {
                self.kept = burnt;
            }
            if end {
                self.tell(age.unwrap_or_default(), stage).await;
            }
        }
    }

    async fn tell(&self, age: Option<LampAge>, stage: &Stage) {
        let age = age.unwrap_or_else(|| self.log.age_unknown());
        stage.recorder().event(Event::LampHours { age }).await;
    }

    /// Does `work` off the async threads; a failure is told and costs nothing but the hours. `Ok(None)`: it takes too long,
    /// and may still come to its end, so that it is not done again.
    ///
    /// # Errors
    /// Nothing was read or written.
    async fn with_log(
        &mut self,
        stage: &Stage,
        work: impl FnOnce(&LampLog) -> Result<LampAge, LampLogError> + Send + 'static,
    ) -> Result<Option<LampAge>, LampLogError> {
        let log = self.log.clone();
        let done = stage.clock().timeout(WRITE_LIMIT, tokio::task::spawn_blocking(move || work(&log))).await;
        let Ok(Ok(done)) = done else { return Ok(None) };
        if let Err(e) = &done
            && !std::mem::replace(&mut self.failed, true)
        {
            stage.recorder().event(Event::ArchiveError { message: e.to_string() }).await;
        }
        done.map(Some)
    }
}
