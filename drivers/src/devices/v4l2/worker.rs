//! The one named thread that owns the camera: takes commands, and between them keeps taking pictures so that none grows old.

use super::config::V4l2Config;
use super::flight::Counters;
use super::session::Session;
use crate::clock::Clock;
use crate::contract::{Armed, CameraInfo, CameraSettings, Health};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::frame::{Frame, FramePool, PixelFormat};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot};

/// Longest wait for a picture before the thread looks at its commands again.
const SLICE: Duration = Duration::from_millis(20);
/// Threads of one camera that may hang in the kernel before no new one is started.
pub const MOST_HANGING: usize = 4;

/// Where an answer goes.
pub type Reply<T> = oneshot::Sender<Result<T>>;

/// What the thread can be asked. Each arm counts a generation up, so that frames of an earlier one are told apart.
pub enum Command {
    /// Open and prove.
    Open(Reply<CameraInfo>),
    /// Write and read back; with the format of the frames that follow.
    Apply(CameraSettings, Reply<(CameraSettings, PixelFormat)>),
    /// Mark the moment; frames from now on carry this generation.
    Arm(u64, Reply<Armed>),
    /// Stop streaming.
    Stop(Reply<()>),
    /// Look.
    Health(Reply<Health>),
    /// Sums since opening.
    Counters(Reply<Counters>),
}

/// A frame or the camera's failure, with the generation it belongs to.
pub type Item = (u64, Result<Frame>);

/// The async side's ends.
pub struct Worker {
    /// Commands, one at a time.
    pub commands: mpsc::Sender<Command>,
    /// Frames in order.
    pub frames: mpsc::Receiver<Item>,
}

/// What the thread needs.
struct Context {
    config: Arc<V4l2Config>,
    clock: Clock,
    pool: FramePool,
    runtime: Handle,
    frames: mpsc::Sender<Item>,
    alive: Arc<AtomicUsize>,
}

// === impl Worker ===

impl Worker {
    /// Starts the thread. `alive` counts the threads of this camera that have not ended.
    ///
    /// # Errors
    /// `Broken` when too many earlier threads hang in the kernel, or the system gives no thread.
    pub fn start(config: &Arc<V4l2Config>, clock: Clock, alive: &Arc<AtomicUsize>) -> Result<Worker> {
        let broken = |message: String| DeviceError::new(ErrorKind::Broken, &config.name, message);
        if alive.load(Ordering::SeqCst) >= MOST_HANGING {
            return Err(broken(format!(
                "{MOST_HANGING} calls to the camera's driver hang; restart the daemon or the machine"
            )));
        }
        let (commands, receiver) = mpsc::channel(4);
        let (sender, frames) = mpsc::channel(config.pool.max(2));
        let context = Context {
            config: Arc::clone(config),
            clock,
            pool: FramePool::new(config.pool.max(2)),
            runtime: Handle::current(),
            frames: sender,
            alive: Arc::clone(alive),
        };
        alive.fetch_add(1, Ordering::SeqCst);
        let thread = std::thread::Builder::new().name(format!("v4l2-{}", config.name));
        if let Err(e) = thread.spawn(move || context.run(receiver)) {
            alive.fetch_sub(1, Ordering::SeqCst);
            return Err(broken(format!("no thread for the camera: {e}")));
        }
        Ok(Worker { commands, frames })
    }
}

// === impl Context ===

impl Drop for Context {
    /// Also when the thread ends by a panic inside crate `v4l` (it unwraps what a driver says).
    fn drop(&mut self) {
        self.alive.fetch_sub(1, Ordering::SeqCst);
    }
}

impl Context {
    fn run(&self, mut commands: mpsc::Receiver<Command>) {
        let mut session: Option<Session> = None;
        let mut generation = 0;
        loop {
            let streams = session.as_ref().is_some_and(Session::streams);
            let command = if streams {
                match commands.try_recv() {
                    Ok(command) => Some(command),
                    Err(mpsc::error::TryRecvError::Empty) => None,
                    Err(mpsc::error::TryRecvError::Disconnected) => return,
                }
            } else {
                match commands.blocking_recv() {
                    Some(command) => Some(command),
                    None => return,
                }
            };
            match (command, session.as_mut()) {
                (Some(command), _) => self.obey(command, &mut session, &mut generation),
                (None, Some(open)) => {
                    if let Some(item) = open.pump(SLICE) {
                        let lost = item.as_ref().is_err_and(|e| e.kind == ErrorKind::Lost);
                        // Full: nobody reads; the frame goes back to the pool and shows as a step of the counter.
                        let _ = self.frames.try_send((generation, item));
                        if lost {
                            session = None;
                        }
                    }
                }
                (None, None) => {}
            }
        }
    }

    fn obey(&self, command: Command, session: &mut Option<Session>, generation: &mut u64) {
        match command {
            Command::Open(reply) => {
                *session = None;
                let opened = Session::open(Arc::clone(&self.config), self.clock, &self.runtime, self.pool.clone());
                let _ = reply.send(opened.map(|(open, info)| {
                    *session = Some(open);
                    info
                }));
            }
            Command::Apply(settings, reply) => self.answer(reply, session, |s| s.apply(settings)),
            Command::Arm(next, reply) => {
                *generation = next;
                self.answer(reply, session, Session::arm);
            }
            Command::Stop(reply) => {
                if let Some(open) = session {
                    open.stop();
                }
                let _ = reply.send(Ok(()));
            }
            Command::Health(reply) => self.answer(reply, session, Session::health),
            Command::Counters(reply) => self.answer(reply, session, |s| Ok(s.counters())),
        }
    }

    /// Runs one command on the open camera; a camera that is gone is closed.
    fn answer<T>(&self, reply: Reply<T>, session: &mut Option<Session>, act: impl FnOnce(&mut Session) -> Result<T>) {
        let result = match session.as_mut() {
            Some(open) => act(open),
            None => Err(DeviceError::new(ErrorKind::Lost, &self.config.name, "the camera is not open; open it first")),
        };
        if result.as_ref().is_err_and(|e| e.kind == ErrorKind::Lost) {
            *session = None;
        }
        let _ = reply.send(result);
    }
}
