//! The owner thread of one camera and the async side's end of it: bounded channels, deadlines, a stuck call abandoned.

use super::counters::{Counters, tick};
use super::opening;
use super::options::AravisOptions;
use super::reception::Filled;
use super::session::{ArmPoint, Delivered, Outlet, Session};
use crate::clock::Clock;
use crate::contract::{CameraInfo, CameraSettings, Health};
use crate::error::{DeviceError, ErrorKind, Result};
use crate::frame::FramePool;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::{mpsc, oneshot, watch};

/// Where a command's result goes.
pub type Reply<T> = oneshot::Sender<Result<T>>;

/// What the owner thread can be asked.
pub enum Command {
    /// Write settings, read them back.
    Apply(CameraSettings, Reply<CameraSettings>),
    /// Empty the queue, mark the moment, trigger.
    Arm(Reply<ArmPoint>),
    /// Trigger one more frame.
    Trigger(Reply<()>),
    /// Stop acquisition.
    Stop(Reply<()>),
    /// Readings.
    Health(Reply<Health>),
}

enum Message {
    Command(Command),
    /// The library has filled a buffer.
    Filled,
    /// The link ends.
    End,
}

/// The async side's end of an open camera. Dropping it makes the thread close the camera and end, when it can.
pub struct Link {
    messages: SyncSender<Message>,
    /// Frames in order.
    pub frames: mpsc::Receiver<Delivered>,
    /// True once the camera's heartbeat is lost.
    pub lost: watch::Receiver<bool>,
    abandoned: Arc<AtomicBool>,
}

/// Messages that may wait for the owner thread; wake-ups beyond are not needed.
const QUEUE: usize = 32;
/// How long the thread sleeps when nothing happens.
const IDLE: Duration = Duration::from_millis(100);
/// How often it looks again while the pool is empty.
const STARVED: Duration = Duration::from_millis(2);

struct Alive(Arc<AtomicUsize>);

// === impl Link ===

impl Link {
    /// Starts the owner thread of a camera and opens it. `threads` counts owner threads alive, abandoned ones too.
    ///
    /// # Errors
    /// Those of [`opening::open`]; `Timeout` when the library does not come back within `limit`.
    pub async fn open(
        options: &AravisOptions,
        clock: Clock,
        counters: Arc<Counters>,
        threads: &Arc<AtomicUsize>,
        limit: Duration,
    ) -> Result<(Link, CameraInfo)> {
        let (messages, inbox) = sync_channel(QUEUE);
        let (frames_in, frames) = mpsc::channel(options.frames_in_flight.max(1));
        let (lost_in, lost) = watch::channel(false);
        let (opened_in, opened) = oneshot::channel();
        let abandoned = Arc::new(AtomicBool::new(false));
        let owner = Owner {
            options: options.clone(),
            outlet: Outlet {
                frames: frames_in,
                pool: FramePool::new(options.frames_in_flight.max(1)),
                counters,
                clock,
            },
            inbox,
            wake: messages.clone(),
            lost: lost_in,
            abandoned: Arc::clone(&abandoned),
            runtime: Handle::current(),
        };
        threads.fetch_add(1, Ordering::SeqCst);
        let alive = Alive(Arc::clone(threads));
        let link = Link { messages, frames, lost, abandoned };
        std::thread::Builder::new()
            .name(format!("camera-{}", options.name))
            .spawn(move || {
                let _alive = alive;
                owner.run(opened_in);
            })
            .map_err(|e| {
                DeviceError::new(ErrorKind::Broken, options.label(), format!("no thread for the camera: {e}"))
            })?;
        match clock.timeout(limit, opened).await {
            Ok(Ok(Ok(info))) => Ok((link, info)),
            Ok(Ok(Err(error))) => Err(error),
            Ok(Err(_)) => Err(gone(options)),
            Err(_) => Err(stuck(options, "opening", limit)),
        }
    }

    /// Sends a command and waits for its result.
    ///
    /// # Errors
    /// The command's own; `Timeout` past `limit` (the link is then useless), `Lost` where the thread has ended.
    pub async fn call<T>(
        &self,
        options: &AravisOptions,
        clock: Clock,
        limit: Duration,
        command: impl FnOnce(Reply<T>) -> Command,
    ) -> Result<T> {
        let (reply, answer) = oneshot::channel();
        // Only a thread stuck in the library lets this bounded queue fill.
        self.messages
            .try_send(Message::Command(command(reply)))
            .map_err(|_| stuck(options, "a command before this one", limit))?;
        match clock.timeout(limit, answer).await {
            Ok(Ok(result)) => result,
            Ok(Err(_)) => Err(gone(options)),
            Err(_) => Err(stuck(options, "a command", limit)),
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.abandoned.store(true, Ordering::SeqCst);
        let _ = self.messages.try_send(Message::End);
    }
}

impl Drop for Alive {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

fn gone(options: &AravisOptions) -> DeviceError {
    DeviceError::new(ErrorKind::Lost, options.label(), "the camera's thread has ended; it must be opened again")
}

fn stuck(options: &AravisOptions, what: &str, limit: Duration) -> DeviceError {
    let message = format!("{what} did not come back within {} s; the camera must be opened again", limit.as_secs_f64());
    DeviceError::new(ErrorKind::Timeout, options.label(), message)
}

// === impl Owner ===

/// The thread that owns the library's objects.
struct Owner {
    options: AravisOptions,
    outlet: Outlet,
    inbox: Receiver<Message>,
    wake: SyncSender<Message>,
    lost: watch::Sender<bool>,
    abandoned: Arc<AtomicBool>,
    runtime: Handle,
}

impl Owner {
    fn run(self, opened: oneshot::Sender<Result<CameraInfo>>) {
        // Instants of frames are those of the runtime's clock.
        let runtime = self.runtime.clone();
        let _entered = runtime.enter();
        let Owner { options, outlet, inbox, wake, lost, abandoned, .. } = self;
        let counters = Arc::clone(&outlet.counters);
        // These run on threads of the library: they only post.
        let filled: Filled = Arc::new(move || drop(wake.try_send(Message::Filled)));
        let lost = move || {
            lost.send_replace(true);
        };
        match opening::open(&options).and_then(|device| Session::new(device, options, outlet, filled, lost)) {
            Err(error) => {
                let _ = opened.send(Err(error));
            }
            Ok(mut session) => {
                tick(&counters.opened);
                if opened.send(Ok(session.info().clone())).is_ok() {
                    serve(&mut session, &inbox, &abandoned);
                }
                session.close();
            }
        }
    }
}

fn serve(session: &mut Session, inbox: &Receiver<Message>, abandoned: &AtomicBool) {
    let mut starved = false;
    loop {
        match inbox.recv_timeout(if starved { STARVED } else { IDLE }) {
            Ok(Message::Command(command)) => obey(session, command),
            Ok(Message::End) | Err(RecvTimeoutError::Disconnected) => return,
            Ok(Message::Filled) => {}
            Err(RecvTimeoutError::Timeout) => session.count_link(),
        }
        if abandoned.load(Ordering::SeqCst) {
            return;
        }
        starved = session.pump();
    }
}

fn obey(session: &mut Session, command: Command) {
    // A caller that has given up leaves its reply unread: that is its right.
    match command {
        Command::Apply(settings, reply) => drop(reply.send(session.apply(settings))),
        Command::Arm(reply) => drop(reply.send(session.arm())),
        Command::Trigger(reply) => drop(reply.send(session.trigger())),
        Command::Stop(reply) => drop(reply.send(session.stop())),
        Command::Health(reply) => drop(reply.send(session.health())),
    }
}
