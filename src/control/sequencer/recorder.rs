//! Frames and events on their way to the disk: one ordered queue, written by one blocking job after another, so that
//! the journal of two equal nights is the same byte for byte. At most two frames wait; the next is then not started.

use crate::archive::rows::{EventRow, FrameRow, Summary};
use crate::archive::{ArchiveError, RunDir};
use crate::control::events::{Event, EventBus, Stamped};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::frame::Frame;
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tokio::task::JoinHandle;

/// Frames that may wait to be written.
const UNWRITTEN_FRAMES: usize = 2;

/// Events that may wait to be written.
const UNWRITTEN_EVENTS: usize = 64;

/// Where a frame goes, with what the journal keeps of it.
pub struct FrameEntry {
    /// Camera, index of the view, index of the exposure.
    pub place: (String, u32, u32),
    /// The frame.
    pub frame: Frame,
    /// Its row, without digest and size.
    pub row: FrameRow,
}

/// How recording stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Standing {
    /// Steps by state.
    pub summary: Summary,
    /// The first error of the archive: whether the disk is full, and its sentence.
    pub failure: Option<(bool, String)>,
}

/// The sequencer's end of the queue.
pub struct Recorder {
    queue: mpsc::Sender<Entry>,
    frames: Arc<Semaphore>,
    standing: watch::Receiver<Standing>,
    task: JoinHandle<()>,
    clock: Clock,
}

enum Entry {
    Event(UtcMicros, Event),
    Frame(UtcMicros, Box<FrameEntry>, Option<OwnedSemaphorePermit>),
    Missing { utc: UtcMicros, step: u32, reason: String, event: Event },
    Flush(oneshot::Sender<()>),
}

struct Writer {
    run: Arc<RunDir>,
    events: EventBus,
    standing: watch::Sender<Standing>,
    steps: u32,
    seq: u64,
}

// === impl Recorder ===

impl Recorder {
    /// Starts recording into `run`, whose journal stands as `summary`, the next event being number `seq`.
    pub fn start(run: Arc<RunDir>, summary: Summary, seq: u64, events: EventBus, clock: Clock) -> Recorder {
        let (queue, entries) = mpsc::channel(UNWRITTEN_EVENTS);
        let (standing, watched) = watch::channel(Standing { summary, failure: None });
        let steps = summary.planned + summary.stored + summary.missing;
        let writer = Writer { run, events, standing, steps, seq };
        let task = tokio::spawn(writer.work(entries));
        Recorder { queue, frames: Arc::new(Semaphore::new(UNWRITTEN_FRAMES)), standing: watched, task, clock }
    }

    /// Puts an event into the queue.
    pub async fn event(&self, event: Event) {
        self.put(Entry::Event(self.clock.utc(), event)).await;
    }

    /// Puts a frame into the queue; waits while two are unwritten.
    pub async fn frame(&self, entry: FrameEntry) {
        let permit = Arc::clone(&self.frames).acquire_owned().await.ok();
        self.put(Entry::Frame(self.clock.utc(), Box::new(entry), permit)).await;
    }

    /// Puts a missing exposure into the queue.
    pub async fn missing(&self, step: u32, view: u32, reason: String) {
        let event = Event::StepMissing { step, view, reason: reason.clone() };
        self.put(Entry::Missing { utc: self.clock.utc(), step, reason, event }).await;
    }

    /// Waits until everything in the queue is written.
    pub async fn flush(&self) {
        let (done, flushed) = oneshot::channel();
        self.put(Entry::Flush(done)).await;
        // The writer gone means that nothing is left to wait for.
        let _ = flushed.await;
    }

    /// How recording stands now.
    pub fn standing(&self) -> Standing {
        self.standing.borrow().clone()
    }

    /// Ends recording after everything is written.
    pub async fn finish(self) -> Standing {
        let Recorder { queue, standing, task, .. } = self;
        drop(queue);
        // A writer that panicked has told its failure through what is missing in the journal.
        let _ = task.await;
        standing.borrow().clone()
    }

    async fn put(&self, entry: Entry) {
        // The writer only ends with the queue; were it gone, the standing says so.
        let _ = self.queue.send(entry).await;
    }
}

// === impl Writer ===

impl Writer {
    async fn work(mut self, mut entries: mpsc::Receiver<Entry>) {
        while let Some(entry) = entries.recv().await {
            match entry {
                Entry::Event(utc, event) => self.event(utc, event).await,
                Entry::Frame(utc, entry, permit) => self.frame(utc, *entry, permit).await,
                Entry::Missing { utc, step, reason, event } => self.missing(utc, step, reason, event).await,
                Entry::Flush(done) => drop(done),
            }
        }
    }

    async fn event(&mut self, utc: UtcMicros, event: Event) {
        if event.journalled() {
            let row = row(self.seq, utc, &event);
            let written = self.blocking(move |run| run.with(|journal| journal.event(&row))).await;
            self.note(written.err());
        }
        self.tell(utc, event);
    }

    async fn frame(&mut self, utc: UtcMicros, entry: FrameEntry, permit: Option<OwnedSemaphorePermit>) {
        if self.standing.borrow().failure.is_some() {
            return;
        }
        let (step, attempts, rejected) = (entry.row.step, entry.row.attempts, entry.row.rejected);
        let stored = move |bytes| Event::FrameStored { step, bytes, attempts, rejected };
        let seq = self.seq;
        let work = move |run: &RunDir| {
            let FrameEntry { place, frame, row: frame_row } = entry;
            let place = (place.0.as_str(), place.1, place.2);
            run.store(place, &frame.pixels, frame_row, |chunk| row(seq, utc, &stored(chunk.bytes)))
        };
        match self.blocking(work).await {
            Ok(frame) => {
                self.standing.send_modify(|s| {
                    s.summary.planned = s.summary.planned.saturating_sub(1);
                    s.summary.stored += 1;
                    s.summary.rejected += rejected;
                    s.summary.bytes += frame.bytes;
                });
                self.tell(utc, stored(frame.bytes));
                self.progress(utc);
            }
            Err(e) => self.note(Some(e)),
        }
        drop(permit);
    }

    async fn missing(&mut self, utc: UtcMicros, step: u32, reason: String, event: Event) {
        if self.standing.borrow().failure.is_some() {
            return;
        }
        let row = row(self.seq, utc, &event);
        let written = self.blocking(move |run| run.with(|journal| journal.step_missing(step, &reason, &row))).await;
        if written.is_ok() {
            self.standing.send_modify(|s| {
                s.summary.planned = s.summary.planned.saturating_sub(1);
                s.summary.missing += 1;
            });
            self.tell(utc, event);
            self.progress(utc);
        }
        self.note(written.err());
    }

    async fn blocking<T: Send + 'static>(
        &self,
        work: impl FnOnce(&RunDir) -> Result<T, ArchiveError> + Send + 'static,
    ) -> Result<T, ArchiveError> {
        let run = Arc::clone(&self.run);
        let path = run.path().to_path_buf();
        tokio::task::spawn_blocking(move || work(&run))
            .await
            .unwrap_or_else(|e| Err(ArchiveError::Io { what: "finish writing", path, message: e.to_string() }))
    }

    fn note(&self, error: Option<ArchiveError>) {
        if let Some(e) = error {
            self.standing.send_if_modified(|s| {
                let first = s.failure.is_none();
                if first {
                    s.failure = Some((e.is_full(), e.to_string()));
                }
                first
            });
        }
    }

    fn tell(&mut self, utc: UtcMicros, event: Event) {
        self.events.tell(Stamped { seq: self.seq, utc, event });
        self.seq += 1;
    }

    fn progress(&mut self, utc: UtcMicros) {
        let Summary { stored, missing, .. } = self.standing.borrow().summary;
        self.tell(utc, Event::Progress { stored, missing, steps: self.steps });
    }
}

fn row(seq: u64, utc: UtcMicros, event: &Event) -> EventRow {
    // Events are plain data of ours: JSON always holds them.
    let json = serde_json::to_string(event).unwrap_or_default();
    EventRow { seq, utc_us: utc.0, kind: event.kind().to_owned(), json }
}
