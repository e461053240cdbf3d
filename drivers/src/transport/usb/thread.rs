//! The one named thread that owns an open USB device, because libusb's calls block.
//!
//! A call that does not come back is left to itself with its thread; the next `connect` starts a new thread, up to a
//! bound. So the async side never blocks and never waits longer than a transfer's limit and a margin.

use super::{Transfer, UsbConnector, UsbError, UsbInfo, UsbLink, UsbOpener, UsbPipe, UsbPort, UsbRequest};
use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use async_trait::async_trait;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};

/// Added to a transfer's own limit; reached only when the call itself hangs.
const MARGIN: Duration = Duration::from_secs(3);
/// Limit for finding, opening and claiming.
const OPEN_LIMIT: Duration = Duration::from_secs(10);
/// Threads of one device that may hang before no new one is started.
const MOST_HANGING: usize = 4;
/// Requests that wait for the thread. One caller waits for its answer, so more only come from calls that were dropped.
const QUEUE: usize = 2;

/// Opens a device on a thread of its own.
pub struct UsbThread {
    opener: Arc<dyn UsbOpener>,
    clock: Clock,
    alive: Arc<AtomicUsize>,
}

/// One request on its way to the thread.
struct Job {
    request: UsbRequest,
    limit: Duration,
    reply: oneshot::Sender<Transfer<Vec<u8>>>,
}

/// The async end of a thread.
struct ThreadPipe {
    jobs: mpsc::Sender<Job>,
    clock: Clock,
    dead: Option<UsbError>,
}

/// Counts a thread as alive until it ends, also by a panic.
struct Alive(Arc<AtomicUsize>);

// === impl UsbThread ===

impl UsbThread {
    /// A connector that opens devices by `opener`.
    pub fn new(opener: impl UsbOpener + 'static, clock: Clock) -> UsbThread {
        UsbThread { opener: Arc::new(opener), clock, alive: Arc::default() }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, self.opener.port(), message)
    }
}

#[async_trait]
impl UsbConnector for UsbThread {
    fn port(&self) -> &str {
        self.opener.port()
    }

    async fn connect(&mut self) -> Result<UsbLink> {
        if self.alive.load(Ordering::SeqCst) >= MOST_HANGING {
            let what = format!("{MOST_HANGING} calls into the USB library hang; restart the daemon or the machine");
            return Err(self.error(ErrorKind::Broken, what));
        }
        let (jobs, receiver) = mpsc::channel(QUEUE);
        let (opened, answer) = oneshot::channel();
        let alive = Alive::new(&self.alive);
        let opener = Arc::clone(&self.opener);
        let thread = std::thread::Builder::new().name(thread_name(self.opener.port()));
        let started = thread.spawn(move || {
            let _alive = alive;
            own(&*opener, opened, receiver);
        });
        if let Err(cause) = started {
            return Err(self.error(ErrorKind::Broken, format!("no thread for the USB device: {cause}")));
        }
        match self.clock.timeout(OPEN_LIMIT, answer).await {
            Ok(Ok(Ok(info))) => Ok(UsbLink::new(ThreadPipe { jobs, clock: self.clock, dead: None }, info)),
            Ok(Ok(Err(error))) => Err(error),
            Ok(Err(_)) => Err(self.error(ErrorKind::Broken, "the USB thread ended while it opened the device")),
            Err(_) => {
                let what = format!("opening hangs for {} s and is left; open it again", OPEN_LIMIT.as_secs());
                Err(self.error(ErrorKind::Timeout, what))
            }
        }
    }
}

/// The system shows 15 bytes of a thread's name.
fn thread_name(port: &str) -> String {
    port.chars().filter(|&c| c != '\0').take(15).collect()
}

/// Opens the device, then carries out requests until nobody can ask any more or the device is gone.
fn own(opener: &dyn UsbOpener, opened: oneshot::Sender<Result<UsbInfo>>, mut jobs: mpsc::Receiver<Job>) {
    let mut port: Box<dyn UsbPort> = match opener.open() {
        Ok(port) => port,
        Err(error) => {
            let _ = opened.send(Err(error));
            return;
        }
    };
    if opened.send(Ok(port.info())).is_err() {
        return;
    }
    while let Some(job) = jobs.blocking_recv() {
        // Nobody waits any more: what was asked is not begun.
        if job.reply.is_closed() {
            continue;
        }
        let result = port.transfer(&job.request, job.limit);
        let gone = result.as_ref().is_err_and(|error| error.is_loss());
        if gone {
            // The handle is closed before anybody learns of the loss, so that a new one finds the interface free.
            drop(port);
            let _ = job.reply.send(result);
            return;
        }
        let _ = job.reply.send(result);
    }
}

// === impl Alive ===

impl Alive {
    fn new(count: &Arc<AtomicUsize>) -> Alive {
        count.fetch_add(1, Ordering::SeqCst);
        Alive(Arc::clone(count))
    }
}

impl Drop for Alive {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

// === impl ThreadPipe ===

#[async_trait]
impl UsbPipe for ThreadPipe {
    async fn transfer(&mut self, request: UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        if let Some(error) = self.dead {
            return Err(error);
        }
        let (reply, answer) = oneshot::channel();
        let exchange = async {
            self.jobs.send(Job { request, limit, reply }).await.map_err(|_| UsbError::Gone)?;
            answer.await.unwrap_or(Err(UsbError::Gone))
        };
        let result = match self.clock.timeout(limit + MARGIN, exchange).await {
            Ok(result) => result,
            Err(_) => Err(UsbError::Hangs),
        };
        if let Err(error) = result
            && error.is_loss()
        {
            self.dead = Some(error);
        }
        result
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use std::sync::Mutex;
    use std::sync::mpsc as std_mpsc;

    /// Opens ports that echo what was written; 0xFF hangs until released, 0xEE is an unplug.
    struct Echo {
        release: Arc<Mutex<Vec<std_mpsc::Sender<()>>>>,
    }

    struct EchoPort {
        kept: Vec<u8>,
        release: Arc<Mutex<Vec<std_mpsc::Sender<()>>>>,
    }

    impl UsbOpener for Echo {
        fn port(&self) -> &str {
            "usb:0000:0001"
        }

        fn open(&self) -> Result<Box<dyn UsbPort>> {
            Ok(Box::new(EchoPort { kept: Vec::new(), release: Arc::clone(&self.release) }))
        }
    }

    impl UsbPort for EchoPort {
        fn info(&self) -> UsbInfo {
            UsbInfo { serial: "echo".into(), ..UsbInfo::default() }
        }

        fn transfer(&mut self, request: &UsbRequest, _limit: Duration) -> Transfer<Vec<u8>> {
            match request {
                UsbRequest::BulkOut(_, bytes) => match bytes.first() {
                    Some(0xFF) => {
                        let (sender, receiver) = std_mpsc::channel();
                        self.release.lock().unwrap().push(sender);
                        let _ = receiver.recv();
                        Ok(Vec::new())
                    }
                    Some(0xEE) => Err(UsbError::Gone),
                    _ => {
                        self.kept.clone_from(bytes);
                        Ok(Vec::new())
                    }
                },
                UsbRequest::BulkIn(..) => Ok(std::mem::take(&mut self.kept)),
                _ => Err(UsbError::Stall),
            }
        }
    }

    const LIMIT: Duration = Duration::from_millis(100);

    fn threads() -> (UsbThread, Arc<Mutex<Vec<std_mpsc::Sender<()>>>>) {
        let release = Arc::new(Mutex::new(Vec::new()));
        (UsbThread::new(Echo { release: Arc::clone(&release) }, Clock::system()), release)
    }

    #[tokio::test]
    async fn transfers_go_through_the_thread_and_back() {
        let (mut usb, _) = threads();
        let mut link = usb.connect().await.unwrap();
        assert_eq!(link.info().serial, "echo");
        link.send(2, b"abc", LIMIT).await.unwrap();
        assert_eq!(link.read(0x82, 64, LIMIT).await.unwrap(), b"abc");
        assert_eq!(link.clear_halt(2).await, Err(UsbError::Stall));
        assert_eq!(link.send(2, &[0xEE], LIMIT).await, Err(UsbError::Gone));
        assert_eq!(link.send(2, b"abc", LIMIT).await, Err(UsbError::Gone));
        usb.connect().await.unwrap().send(2, b"abc", LIMIT).await.unwrap();
    }

    #[tokio::test]
    async fn a_hanging_call_is_left_and_a_new_thread_takes_over_up_to_a_bound() {
        let (mut usb, release) = threads();
        tokio::time::pause();
        for number in 1..=MOST_HANGING {
            // Real threads answer `connect` in real time, so the clock stands still only while the call hangs.
            tokio::time::resume();
            let mut link = usb.connect().await.unwrap();
            tokio::time::pause();
            // The clock stands still while a task is ready to run: until the call hangs.
            let hanging = async {
                while release.lock().unwrap().len() < number {
                    tokio::task::yield_now().await;
                }
            };
            let (sent, ()) = tokio::join!(link.send(2, &[0xFF], LIMIT), hanging);
            assert_eq!(sent, Err(UsbError::Hangs));
            assert_eq!(link.send(2, b"abc", LIMIT).await, Err(UsbError::Hangs));
        }
        tokio::time::resume();
        let error = usb.connect().await.err().unwrap();
        assert_eq!(error.kind, ErrorKind::Broken);
        assert!(error.message.contains("hang"), "{error}");
        release.lock().unwrap().clear();
        while usb.alive.load(Ordering::SeqCst) > 0 {
            tokio::task::yield_now().await;
        }
        usb.connect().await.unwrap().send(2, b"abc", LIMIT).await.unwrap();
    }
}
