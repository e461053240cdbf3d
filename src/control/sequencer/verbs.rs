//! What an operator or a signal may ask of a run under way.

use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;

/// A request to a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verb {
    /// Finish the exposure under way, close the shutter, wait.
    Pause,
    /// Go on.
    Resume,
    /// Finish the exposure under way, then end safely.
    Stop,
    /// Give the exposure under way up and end safely.
    Abort,
}

/// The requests of a run, sorted by when they matter.
#[derive(Debug)]
pub struct Listener {
    verbs: mpsc::Receiver<Verb>,
    open: bool,
    /// A pause holds.
    pub paused: bool,
    /// A stop was asked for.
    pub stopped: bool,
    /// An abort was asked for.
    pub aborted: bool,
}

// === impl Listener ===

impl Listener {
    /// Listens on a channel; when its other end is gone, nothing more is asked.
    pub fn new(verbs: mpsc::Receiver<Verb>) -> Listener {
        Listener { verbs, open: true, paused: false, stopped: false, aborted: false }
    }

    /// Takes note of requests until one asks to abort; otherwise never ends.
    pub async fn until_abort(&mut self) {
        while !self.aborted {
            self.next().await;
        }
    }

    /// Waits until a pause is over: by resume, stop or abort. Without anybody who could resume it is over at once.
    pub async fn until_resumed(&mut self) {
        while self.paused && self.open && !self.stopped && !self.aborted {
            match self.verbs.recv().await {
                Some(verb) => self.note(verb),
                None => self.open = false,
            }
        }
        self.paused = false;
    }

    /// Takes note of everything asked so far, without waiting.
    pub fn catch_up(&mut self) {
        while let Ok(verb) = self.verbs.try_recv() {
            self.note(verb);
        }
    }

    async fn next(&mut self) {
        if !self.open {
            return std::future::pending().await;
        }
        match self.verbs.recv().await {
            Some(verb) => self.note(verb),
            None => self.open = false,
        }
    }

    fn note(&mut self, verb: Verb) {
        match verb {
            Verb::Pause => self.paused = true,
            Verb::Resume => self.paused = false,
            Verb::Stop => self.stopped = true,
            Verb::Abort => self.aborted = true,
        }
    }
}

/// Turns SIGINT into stop, a second SIGINT and SIGTERM into abort, for as long as the runtime lives.
///
/// # Errors
/// When the operating system refuses the handlers.
pub fn listen_to_signals(verbs: mpsc::Sender<Verb>) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    tokio::spawn(async move {
        let mut interrupted = false;
        loop {
            let verb = tokio::select! {
                _ = terminate.recv() => Verb::Abort,
                _ = interrupt.recv() => if interrupted { Verb::Abort } else { Verb::Stop },
            };
            interrupted = true;
            if verbs.send(verb).await.is_err() {
                return;
            }
        }
    });
    Ok(())
}
