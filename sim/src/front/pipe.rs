//! A twin behind an in-memory pipe, in tokio's time: a night under a paused clock takes seconds.
//!
//! The port survives reconnections and can be pulled out and put back.

use crate::firmware::Firmware;
use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::error::{DeviceError, ErrorKind, Result};
use goniod_drivers::transport::{Connector, Link};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::sync::watch;
use tokio::time::Instant;

/// Bytes the pipe holds in each direction.
const PIPE_BYTES: usize = 8192;
/// Longest rest of a twin that has nothing to say.
const IDLE: Duration = Duration::from_secs(3600);
/// Limit for handing bytes to a host that does not read; what it does not take is lost, as on a serial line.
const HAND_OVER: Duration = Duration::from_secs(1);

/// A port with a twin behind it.
pub struct PipePort<T> {
    inner: Arc<Inner<T>>,
}

struct Inner<T> {
    name: String,
    twin: Mutex<T>,
    state: watch::Sender<State>,
}

/// What the connection's task must know.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct State {
    /// The adapter is in.
    pub plugged: bool,
    /// Counts connections; a task of an older one ends.
    connection: u64,
    /// Counts touches from outside, after which the twin may have something to say.
    touches: u64,
    /// Nothing passes, and whoever opens the port waits until then.
    stuck_until: Option<Instant>,
}

/// Opens a [`PipePort`].
pub struct PipeConnector<T> {
    inner: Arc<Inner<T>>,
    clock: Clock,
}

// === impl PipePort ===

impl<T> Clone for PipePort<T> {
    fn clone(&self) -> PipePort<T> {
        PipePort { inner: Arc::clone(&self.inner) }
    }
}

impl<T: Firmware> PipePort<T> {
    /// A port called `name` (`sim:holder`).
    pub fn new(name: impl Into<String>, twin: T) -> PipePort<T> {
        let state = watch::Sender::new(State { plugged: true, connection: 0, touches: 0, stuck_until: None });
        PipePort { inner: Arc::new(Inner { name: name.into(), twin: Mutex::new(twin), state }) }
    }

    /// A connector for a driver.
    pub fn connector(&self, clock: Clock) -> PipeConnector<T> {
        PipeConnector { inner: Arc::clone(&self.inner), clock }
    }

    /// Looks at the twin, or changes it (faults); what it has to say then is sent.
    pub fn with<R>(&self, act: impl FnOnce(&mut T) -> R) -> R {
        let result = act(&mut self.inner.twin());
        self.inner.state.send_modify(|s| s.touches += 1);
        result
    }

    /// Looks at the twin's truth.
    pub fn peek<R>(&self, look: impl FnOnce(&T) -> R) -> R {
        look(&self.inner.twin())
    }

    /// The twin itself, for another front of the same port.
    pub(super) fn twin(&self) -> MutexGuard<'_, T> {
        self.inner.twin()
    }

    /// Tells when somebody touched the twin or the adapter.
    pub(super) fn changes(&self) -> watch::Receiver<State> {
        self.inner.state.subscribe()
    }

    /// Pulls the adapter out: the link dies, connecting fails.
    pub fn unplug(&self) {
        self.inner.state.send_modify(|s| {
            s.plugged = false;
            s.connection += 1;
        });
    }

    /// Puts the adapter back.
    pub fn plug(&self) {
        self.inner.state.send_modify(|s| s.plugged = true);
    }

    /// Pulls the adapter out and puts it back after `time`.
    pub fn unplug_for(&self, time: Duration) {
        self.unplug();
        let port = self.clone();
        tokio::spawn(async move {
            Clock::system().sleep(time).await;
            port.plug();
        });
    }

    /// The port hangs for `time`, as a driver of the operating system may: nothing passes, opening it takes that long.
    pub fn stick_for(&self, time: Duration) {
        self.inner.state.send_modify(|s| {
            s.stuck_until = Some(Instant::now() + time);
            s.connection += 1;
        });
    }
}

// === impl Inner ===

impl<T> Inner<T> {
    fn twin(&self) -> MutexGuard<'_, T> {
        self.twin.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

// === impl PipeConnector ===

#[async_trait]
impl<T: Firmware> Connector for PipeConnector<T> {
    fn port(&self) -> &str {
        &self.inner.name
    }

    async fn connect(&mut self) -> Result<Link> {
        let stuck_until = self.inner.state.borrow().stuck_until;
        if let Some(until) = stuck_until {
            self.clock.sleep_until(until).await;
        }
        if !self.inner.state.borrow().plugged {
            let what = format!("port {} is not there; plug the adapter in", self.inner.name);
            return Err(DeviceError::new(ErrorKind::Lost, &self.inner.name, what));
        }
        self.inner.state.send_modify(|s| s.connection += 1);
        self.inner.twin().connected(Instant::now());
        let (near, far) = tokio::io::duplex(PIPE_BYTES);
        tokio::spawn(serve(Arc::clone(&self.inner), far, self.inner.state.subscribe(), self.clock));
        Ok(Link::new(self.inner.name.clone(), near, self.clock))
    }
}

/// Carries bytes until the host closes, the adapter is pulled or a newer connection is made.
async fn serve<T: Firmware>(
    inner: Arc<Inner<T>>,
    mut pipe: DuplexStream,
    mut state: watch::Receiver<State>,
    clock: Clock,
) {
    let connection = state.borrow_and_update().connection;
    let mut chunk = [0_u8; 256];
    loop {
        let now = Instant::now();
        let bytes = inner.twin().take(now);
        if !bytes.is_empty() {
            match clock.timeout(HAND_OVER, pipe.write_all(&bytes)).await {
                Ok(Ok(())) | Err(_) => {}
                Ok(Err(_)) => return,
            }
        }
        let due = inner.twin().due().unwrap_or(now + IDLE);
        tokio::select! {
            read = pipe.read(&mut chunk) => match read {
                Ok(0) | Err(_) => return,
                Ok(n) => {
                    let bytes = chunk.get(..n).unwrap_or_default();
                    inner.twin().receive(bytes, Instant::now());
                }
            },
            () = clock.sleep_until(due) => {}
            changed = state.changed() => {
                let s = *state.borrow_and_update();
                if let Some(until) = s.stuck_until.filter(|_| s.connection == connection + 1) {
                    // The host's end stays open and silent.
                    clock.sleep_until(until).await;
                }
                if changed.is_err() || !s.plugged || s.connection != connection {
                    return;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use goniod_drivers::clock::UtcMicros;

    /// Says back what it hears.
    struct Echo(Vec<u8>);

    impl Firmware for Echo {
        fn receive(&mut self, bytes: &[u8], _: Instant) {
            self.0.extend_from_slice(bytes);
        }
        fn due(&self) -> Option<Instant> {
            None
        }
        fn take(&mut self, _: Instant) -> Vec<u8> {
            std::mem::take(&mut self.0)
        }
        fn connected(&mut self, _: Instant) {}
    }

    #[tokio::test(start_paused = true)]
    async fn a_port_that_hangs_passes_nothing_and_opens_only_afterwards() {
        let clock = Clock::starting_at(UtcMicros(0));
        let port = PipePort::new("sim:echo", Echo(Vec::new()));
        let mut connector = port.connector(clock);
        let second = Duration::from_secs(1);
        let mut link = connector.connect().await.unwrap();
        link.send(b"one\n").await.unwrap();
        assert!(link.line(clock.now() + second).await.unwrap().is_some());
        let stuck = clock.now();
        port.stick_for(10 * second);
        tokio::task::yield_now().await;
        link.send(b"two\n").await.unwrap();
        assert_eq!(link.line(clock.now() + second).await.unwrap(), None);
        let mut link = connector.connect().await.unwrap();
        assert!(clock.now() >= stuck + 10 * second);
        link.send(b"three\n").await.unwrap();
        assert!(link.line(clock.now() + second).await.unwrap().is_some());
    }
}
