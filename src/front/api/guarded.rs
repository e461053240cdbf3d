//! A listener with bounds: so many connections at once, and none that stays silent for long. Clients that hang on take
//! places from each other, never from the night, nor from an operator who comes last.

use axum::serve::Listener;
use goniod_drivers::clock::Clock;
use std::future::Future;
use std::io;
use std::os::fd::AsFd;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, Interest, ReadBuf};
use tokio::net::unix::pipe::Receiver;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};
use tokio::time::Instant;

/// Connections at once; for one more, the one that has been silent longest is closed.
pub const MOST_CONNECTIONS: usize = 64;
/// A connection on which nothing moves for so long is closed. Event streams send a comment more often.
pub const SILENCE: Duration = Duration::from_secs(40);
/// How long a connection that is to be closed may take before the next one is asked to go, too.
const LEAVING: Duration = Duration::from_millis(200);

/// The bounds around another listener.
pub struct Guarded<L> {
    listener: L,
    places: Arc<Semaphore>,
    taken: Vec<Weak<Place>>,
    clock: Clock,
}

/// A connection that counts and is closed when it stays silent.
pub struct GuardedIo<I> {
    io: I,
    clock: Clock,
    alarm: Pin<Box<dyn Future<Output = ()> + Send>>,
    place: Arc<Place>,
}

/// Tells an answer that goes on for ever when to end.
pub struct Watch {
    place: Arc<Place>,
    /// The connection once more, as something to wait for; absent where the system gives no more descriptors.
    line: Option<Receiver>,
}

/// One connection's place.
struct Place {
    moved: Mutex<Instant>,
    leaves: AtomicBool,
    wake: Notify,
    /// As `wake`, for the watch.
    wanted: Notify,
    _permit: Option<OwnedSemaphorePermit>,
}

// === impl Guarded ===

impl<L> Guarded<L> {
    /// Bounds a listener.
    pub fn new(listener: L, clock: Clock) -> Guarded<L> {
        Guarded { listener, places: Arc::new(Semaphore::new(MOST_CONNECTIONS)), taken: Vec::new(), clock }
    }

    /// A place for one more.
    async fn place(&mut self) -> Arc<Place> {
        self.taken.retain(|place| place.strong_count() > 0);
        let free = loop {
            if let Ok(permit) = Arc::clone(&self.places).try_acquire_owned() {
                break Some(permit);
            }
            let staying = self.taken.iter().filter_map(Weak::upgrade).filter(|place| !place.leaves());
            if let Some(silent) = staying.min_by_key(|place| place.moved()) {
                silent.leave();
            }
            let permit = self.clock.timeout(LEAVING, Arc::clone(&self.places).acquire_owned()).await;
            if let Ok(permit) = permit {
                // The semaphore is never closed.
                break permit.ok();
            }
        };
        let place = Arc::new(Place::new(self.clock.now(), free));
        self.taken.push(Arc::downgrade(&place));
        place
    }
}

impl<L: Listener> Listener for Guarded<L> {
    type Io = GuardedIo<L::Io>;
    type Addr = L::Addr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        let (io, address) = self.listener.accept().await;
        (GuardedIo::new(io, self.clock, self.place().await), address)
    }

    fn local_addr(&self) -> io::Result<Self::Addr> {
        self.listener.local_addr()
    }
}

// === impl Place ===

impl Place {
    fn new(now: Instant, permit: Option<OwnedSemaphorePermit>) -> Place {
        let (moved, wake, wanted) = (Mutex::new(now), Notify::new(), Notify::new());
        Place { moved, leaves: AtomicBool::new(false), wake, wanted, _permit: permit }
    }

    fn moved(&self) -> Instant {
        *self.moved.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn leaves(&self) -> bool {
        self.leaves.load(Ordering::SeqCst)
    }

    fn leave(&self) {
        self.leaves.store(true, Ordering::SeqCst);
        self.wake.notify_one();
        self.wanted.notify_one();
    }
}

// === impl GuardedIo ===

impl<I> GuardedIo<I> {
    fn new(io: I, clock: Clock, place: Arc<Place>) -> GuardedIo<I> {
        let alarm = alarm(clock, Arc::clone(&place), place.moved() + SILENCE);
        GuardedIo { io, clock, alarm, place }
    }

    /// What an operation gave; waiting for it too long is an error.
    fn guard<T>(&mut self, polled: Poll<io::Result<T>>, cx: &mut Context<'_>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            *self.place.moved.lock().unwrap_or_else(PoisonError::into_inner) = self.clock.now();
            return polled;
        }
        while self.alarm.as_mut().poll(cx).is_ready() {
            let due = self.place.moved() + SILENCE;
            if due <= self.clock.now() || self.place.leaves() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            self.alarm = alarm(self.clock, Arc::clone(&self.place), due);
        }
        Poll::Pending
    }
}

impl<I: AsFd> GuardedIo<I> {
    /// A watch over this connection.
    pub fn watch(&self) -> Watch {
        let line = self.io.as_fd().try_clone_to_owned().and_then(Receiver::from_owned_fd_unchecked);
        Watch { place: Arc::clone(&self.place), line: line.ok() }
    }
}

// === impl Watch ===

impl Watch {
    /// Until the client has closed its end, or its place is wanted. A client that only sends no more (`nc -N`) is there
    /// still; over TCP the two look the same, and the next write tells.
    pub async fn over(&self) {
        let closed = async {
            match &self.line {
                // A receiver is told of writing only when both ways are closed. Nothing is read here.
                Some(line) => drop(line.ready(Interest::WRITABLE).await),
                None => std::future::pending::<()>().await,
            }
        };
        tokio::select! {
            () = closed => {}
            () = self.place.wanted.notified() => {}
        }
    }
}

/// Ends at `at`, or when the place is wanted.
fn alarm(clock: Clock, place: Arc<Place>, at: Instant) -> Pin<Box<dyn Future<Output = ()> + Send>> {
    Box::pin(async move {
        tokio::select! {
            () = clock.sleep_until(at) => {}
            () = place.wake.notified() => {}
        }
    })
}

impl<I: AsyncRead + Unpin> AsyncRead for GuardedIo<I> {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.io).poll_read(cx, buf);
        self.guard(polled, cx)
    }
}

impl<I: AsyncWrite + Unpin> AsyncWrite for GuardedIo<I> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let polled = Pin::new(&mut self.io).poll_write(cx, buf);
        self.guard(polled, cx)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        // A flush that is ready at once moves nothing.
        Pin::new(&mut self.io).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let polled = Pin::new(&mut self.io).poll_shutdown(cx);
        self.guard(polled, cx)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};

    fn place(clock: Clock) -> Arc<Place> {
        Arc::new(Place::new(clock.now(), None))
    }

    /// The one who comes last may be the operator who wants the bench safe.
    #[tokio::test(start_paused = true)]
    async fn one_connection_too_many_closes_the_one_that_was_silent_longest() {
        let clock = Clock::system();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s");
        let mut guarded = Guarded::new(tokio::net::UnixListener::bind(&path).unwrap(), clock);
        let (mut near, mut far) = (Vec::new(), Vec::new());
        for _ in 0..MOST_CONNECTIONS {
            far.push(tokio::net::UnixStream::connect(&path).await.unwrap());
            near.push(guarded.accept().await.0);
            clock.sleep(Duration::from_millis(1)).await;
        }
        // The first moves, so that the second is the one.
        far[0].write_all(b"x").await.unwrap();
        near[0].read_u8().await.unwrap();
        let silent = near.remove(1);
        let closed = tokio::spawn(async move { { silent }.read_u8().await.unwrap_err().kind() });
        far.push(tokio::net::UnixStream::connect(&path).await.unwrap());
        let (mut last, _) = guarded.accept().await;
        assert_eq!(closed.await.unwrap(), io::ErrorKind::TimedOut);
        far[MOST_CONNECTIONS].write_all(b"y").await.unwrap();
        assert_eq!(last.read_u8().await.unwrap(), b'y');
    }

    #[tokio::test(start_paused = true)]
    async fn a_silent_connection_is_closed_and_a_moving_one_is_not() {
        let clock = Clock::system();
        let (near, mut far) = tokio::io::duplex(64);
        let mut guarded = GuardedIo::new(near, clock, place(clock));
        for _ in 0..5 {
            clock.sleep(SILENCE / 2).await;
            far.write_all(b"x").await.unwrap();
            let mut byte = [0];
            guarded.read_exact(&mut byte).await.unwrap();
        }
        let since = clock.now();
        assert_eq!(guarded.read_u8().await.unwrap_err().kind(), io::ErrorKind::TimedOut);
        assert_eq!(clock.now() - since, SILENCE);
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_never_reads_is_given_up() {
        let (near, _far) = tokio::io::duplex(64);
        let clock = Clock::system();
        let mut guarded = GuardedIo::new(near, clock, place(clock));
        assert_eq!(guarded.write_all(&[0; 1000]).await.unwrap_err().kind(), io::ErrorKind::TimedOut);
    }
}
