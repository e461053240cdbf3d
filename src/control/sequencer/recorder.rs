//! Frames and events on their way to the disk: one ordered queue, written by one blocking job after another, so that
//! the journal of two equal nights is the same byte for byte. At most two frames wait; the next is then not started.
//! A full disk is waited for: what could not be written is written when there is room.

use crate::archive::rows::{EventRow, FrameRow, Summary};
use crate::archive::{ArchiveError, RunDir};
use crate::control::events::{Event, EventBus, Stamped};
use crate::control::plan::{Step, View};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::frame::Frame;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, oneshot, watch};
use tokio::task::JoinHandle;

/// Frames that may wait to be written.
const UNWRITTEN_FRAMES: usize = 2;

/// Events that may wait to be written.
const UNWRITTEN_EVENTS: usize = 64;

/// How often a full disk is tried again.
const FULL_DISK_RHYTHM: Duration = Duration::from_secs(5);

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
    /// The first error of the archive that was not waited out: whether the disk is full, and its sentence.
    pub failure: Option<(bool, String)>,
    /// The disk is full and is waited for.
    pub full: bool,
}

/// The sequencer's end of the queue.
pub struct Recorder {
    queue: mpsc::Sender<Entry>,
    frames: Arc<Semaphore>,
    standing: watch::Receiver<Standing>,
    task: JoinHandle<()>,
    clock: Clock,
    patient: watch::Sender<bool>,
    untold: AtomicU64,
    waits: AtomicU64,
}

/// Room for one frame in the queue.
pub struct FramePlace<'a> {
    queue: mpsc::Permit<'a, Entry>,
    unwritten: Option<OwnedSemaphorePermit>,
    utc: UtcMicros,
}

enum Entry {
    Event(UtcMicros, Event),
    Frame(UtcMicros, Arc<FrameEntry>, Option<OwnedSemaphorePermit>),
    Missing(UtcMicros, Lacking),
    Retake(UtcMicros, u32, Event),
    Flush(oneshot::Sender<()>),
}

/// An exposure that cannot be had.
struct Lacking {
    step: u32,
    /// Camera, array index and exposure index of its frame, where the plan has its view.
    place: Option<(String, u32, u32)>,
    reason: String,
    event: Event,
}

struct Writer {
    run: Arc<RunDir>,
    events: EventBus,
    standing: watch::Sender<Standing>,
    /// False from when a full disk is no longer waited for.
    patient: watch::Receiver<bool>,
    clock: Clock,
    steps: u32,
    seq: u64,
}

// === impl Recorder ===

impl Recorder {
    /// Starts recording into `run`, whose journal stands as `summary`, the next event being number `seq`.
    pub fn start(run: Arc<RunDir>, summary: Summary, seq: u64, events: EventBus, clock: Clock) -> Recorder {
        let (queue, entries) = mpsc::channel(UNWRITTEN_EVENTS);
        let (standing, watched) = watch::channel(Standing { summary, failure: None, full: false });
        let (patient, patience) = watch::channel(true);
        let steps = summary.planned + summary.stored + summary.missing;
        let writer = Writer { run, events, standing, patient: patience, clock, steps, seq };
        let task = tokio::spawn(writer.work(entries));
        let frames = Arc::new(Semaphore::new(UNWRITTEN_FRAMES));
        let (untold, waits) = (AtomicU64::new(0), AtomicU64::new(0));
        Recorder { queue, frames, standing: watched, task, clock, patient, untold, waits }
    }

    /// Puts an event into the queue. While the disk is full, one that finds no room is dropped and counted: the run
    /// must stay answerable.
    pub async fn event(&self, event: Event) {
        match self.queue.try_send(Entry::Event(self.clock.utc(), event)) {
            Err(mpsc::error::TrySendError::Full(_)) if self.standing.borrow().full => {
                self.untold.fetch_add(1, Ordering::Relaxed);
            }
            Err(mpsc::error::TrySendError::Full(entry)) => self.put(entry).await,
            // The writer only ends with the queue; were it gone, the standing says so.
            Ok(()) | Err(mpsc::error::TrySendError::Closed(_)) => {}
        }
    }

    /// Events that found no room in the queue.
    pub fn untold(&self) -> u64 {
        self.untold.load(Ordering::Relaxed)
    }

    /// Frames that found no room at once: the disk was slower than the cameras.
    pub fn waits(&self) -> u64 {
        self.waits.load(Ordering::Relaxed)
    }

    /// Waits for room for a frame; while two are unwritten there is none. Dropping the future loses nothing. `None`
    /// when nothing is recorded any more.
    pub async fn frame_place(&self) -> Option<FramePlace<'_>> {
        if self.frames.available_permits() == 0 {
            self.waits.fetch_add(1, Ordering::Relaxed);
        }
        let unwritten = Arc::clone(&self.frames).acquire_owned().await.ok();
        let queue = self.queue.reserve().await.ok()?;
        Some(FramePlace { queue, unwritten, utc: self.clock.utc() })
    }

    /// Waits until the archive fails or its disk is full.
    pub async fn until_trouble(&self) {
        let mut standing = self.standing.clone();
        // The writer gone is no trouble of the disk; nothing more will be told.
        if standing.wait_for(|s| s.full || s.failure.is_some()).await.is_err() {
            std::future::pending().await
        }
    }

    /// From now on a full disk is a failure like any other.
    pub fn lose_patience(&self) {
        self.patient.send_replace(false);
    }

    /// Puts a missing exposure into the queue.
    pub async fn missing(&self, step: &Step, view: Option<&View>, reason: String) {
        let place = view.map(|view| (view.camera.clone(), view.array_index, step.exposure_index));
        let event = Event::StepMissing { step: step.number, view: step.view, reason: reason.clone() };
        self.put(Entry::Missing(self.clock.utc(), Lacking { step: step.number, place, reason, event })).await;
    }

    /// Has the frames of a view forgotten and its steps planned again.
    pub async fn retake(&self, view: u32, change: Option<f64>) {
        self.put(Entry::Retake(self.clock.utc(), view, Event::ViewRetaken { view, change })).await;
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

// === impl FramePlace ===

impl FramePlace<'_> {
    /// Puts the frame into its place.
    pub fn put(self, entry: FrameEntry) {
        self.queue.send(Entry::Frame(self.utc, Arc::new(entry), self.unwritten));
    }
}

// === impl Writer ===

impl Writer {
    async fn work(mut self, mut entries: mpsc::Receiver<Entry>) {
        while let Some(entry) = entries.recv().await {
            match entry {
                Entry::Event(utc, event) => self.event(utc, event).await,
                Entry::Frame(utc, entry, permit) => self.frame(utc, entry, permit).await,
                Entry::Missing(utc, lacking) => self.missing(utc, lacking).await,
                Entry::Retake(utc, view, event) => self.retake(utc, view, event).await,
                Entry::Flush(done) => drop(done),
            }
        }
    }

    async fn event(&mut self, utc: UtcMicros, event: Event) {
        if event.journalled() {
            let row = row(self.seq, utc, &event);
            let written = self.persist(move |run| run.with(|journal| journal.event(&row))).await;
            self.note(written.err());
        }
        self.tell(utc, event);
    }

    async fn frame(&mut self, utc: UtcMicros, entry: Arc<FrameEntry>, permit: Option<OwnedSemaphorePermit>) {
        if self.standing.borrow().failure.is_some() {
            return;
        }
        let (step, attempts, rejected) = (entry.row.step, entry.row.attempts, entry.row.rejected);
        let stored = move |bytes| Event::FrameStored { step, bytes, attempts, rejected };
        let seq = self.seq;
        let work = move |run: &RunDir| {
            let place = (entry.place.0.as_str(), entry.place.1, entry.place.2);
            run.store(place, &entry.frame.pixels, entry.row.clone(), |chunk| row(seq, utc, &stored(chunk.bytes)))
        };
        match self.persist(work).await {
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

    async fn missing(&mut self, utc: UtcMicros, Lacking { step, place, reason, event }: Lacking) {
        if self.standing.borrow().failure.is_some() {
            return;
        }
        let row = row(self.seq, utc, &event);
        let write = move |run: &RunDir| {
            place.iter().try_for_each(|(camera, array, exposure)| run.forget_frame(camera, *array, *exposure))?;
            run.with(|journal| journal.step_missing(step, &reason, &row))
        };
        let written = self.persist(write).await;
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

    async fn retake(&mut self, utc: UtcMicros, view: u32, event: Event) {
        let row = row(self.seq, utc, &event);
        let again = move |run: &RunDir| {
            run.with(|journal| {
                journal.plan_view_again(view, &row)?;
                journal.summary()
            })
        };
        match self.persist(again).await {
            Ok(summary) => {
                self.standing.send_modify(|s| s.summary = summary);
                self.tell(utc, event);
                self.progress(utc);
            }
            Err(e) => self.note(Some(e)),
        }
    }

    /// Does `work` on a blocking thread; while the disk is full it is done again and again, as long as there is patience.
    async fn persist<T: Send + 'static>(
        &mut self,
        work: impl Fn(&RunDir) -> Result<T, ArchiveError> + Send + Sync + 'static,
    ) -> Result<T, ArchiveError> {
        let work = Arc::new(work);
        loop {
            let (run, job) = (Arc::clone(&self.run), Arc::clone(&work));
            let path = run.path().to_path_buf();
            let done = tokio::task::spawn_blocking(move || job(&run))
                .await
                .unwrap_or_else(|e| Err(ArchiveError::Io { what: "finish writing", path, message: e.to_string() }));
            let full = done.as_ref().is_err_and(ArchiveError::is_full);
            let wait = full && *self.patient.borrow() && self.standing.borrow().failure.is_none();
            self.standing.send_if_modified(|s| std::mem::replace(&mut s.full, wait) != wait);
            if !wait {
                return done;
            }
            let _ = self.clock.timeout(FULL_DISK_RHYTHM, self.patient.wait_for(|patient| !patient)).await;
        }
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

/// The journal's row of an event.
pub fn row(seq: u64, utc: UtcMicros, event: &Event) -> EventRow {
    // Events are plain data of ours: JSON always holds them.
    let json = serde_json::to_string(event).unwrap_or_default();
    EventRow { seq, utc_us: utc.0, kind: event.kind().to_owned(), json }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::archive::disk::{Disk, RealDisk};
    use crate::archive::{ArrayLayout, NewRun, RunLayout, StepLayout};
    use goniod_drivers::contract::CameraSettings;
    use goniod_drivers::frame::{FrameInfo, PixelFormat, Pixels};
    use goniod_drivers::units::ExposureTime;
    use std::fs::File;
    use std::io::{self, Write};
    use std::path::Path;
    use std::sync::Mutex;

    /// A disk that writes only while its gate is open.
    struct Gated(Arc<Mutex<()>>);

    impl Disk for Gated {
        fn append(&self, file: &mut File, _: &Path, bytes: &[u8]) -> io::Result<()> {
            drop(self.0.lock().unwrap());
            file.write_all(bytes)
        }
    }

    fn entry(clock: Clock, step: u32) -> FrameEntry {
        let settings = CameraSettings { exposure: ExposureTime(1000), gain: 0.0 };
        let info = FrameInfo {
            camera_serial: "S1".to_owned(),
            device_frame_id: u64::from(step),
            exposure_start: clock.now(),
            received: clock.now(),
            utc: clock.utc(),
            settings,
            width: 4,
            height: 4,
            format: PixelFormat::Mono8,
            damaged: false,
        };
        let row = FrameRow {
            step,
            digest: String::new(),
            bytes: 0,
            utc_us: 0,
            device_frame_id: u64::from(step),
            exposure_us: 1000,
            camera_serial: "S1".to_owned(),
            attempts: 1,
            rejected: 0,
        };
        let frame = Frame::detached(info, Pixels::U8(vec![step as u8; 16]));
        FrameEntry { place: ("ccd".to_owned(), 0, step), frame, row }
    }

    fn layout() -> RunLayout {
        let (camera, format) = ("ccd".to_owned(), PixelFormat::Mono8);
        let step = |number| StepLayout {
            number,
            view: 0,
            camera: camera.clone(),
            array_index: 0,
            exposure_index: number,
            exposure_us: 1000,
        };
        RunLayout {
            plan_hash: "h".to_owned(),
            arrays: vec![ArrayLayout { camera: camera.clone(), views: 1, exposures: 6, rows: 4, columns: 4, format }],
            steps: (0..6).map(step).collect(),
        }
    }

    // The gate is shut on purpose while the scan waits; only the recorder's own thread locks it.
    #[allow(clippy::await_holding_lock)]
    #[tokio::test]
    async fn while_two_frames_are_unwritten_the_third_waits_and_is_counted() {
        let runs = tempfile::tempdir().unwrap();
        let gate = Arc::new(Mutex::new(()));
        let new = NewRun { run_id: "night", plan_toml: "", files: &[], layout: &layout() };
        drop(RunDir::create_on(runs.path(), &new, Arc::new(RealDisk)).unwrap());
        let path = runs.path().join("night");
        let run = Arc::new(RunDir::resume_on(&path, Arc::new(Gated(Arc::clone(&gate)))).unwrap());
        let summary = run.with(|j| j.summary()).unwrap();
        let clock = Clock::system();
        let recorder = Recorder::start(Arc::clone(&run), summary, 0, EventBus::default(), clock);
        let closed = gate.lock().unwrap();
        for step in 0..2 {
            recorder.frame_place().await.unwrap().put(entry(clock, step));
        }
        assert_eq!(recorder.waits(), 0);
        let soon = Duration::from_millis(50);
        assert!(clock.timeout(soon, recorder.frame_place()).await.is_err(), "the scan waits for the disk");
        assert_eq!(recorder.waits(), 1);
        drop(closed);
        for step in 2..6 {
            recorder.frame_place().await.unwrap().put(entry(clock, step));
        }
        let standing = recorder.finish().await;
        assert_eq!((standing.summary.stored, standing.failure), (6, None), "nothing is dropped");
    }
}
