//! A listener with bounds: so many connections at once, and none that stays silent for long. Clients that hang on take
//! file descriptors from each other, never from the night.

use axum::serve::Listener;
use goniod_drivers::clock::Clock;
use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Instant;

/// Connections at once; one more waits until one ends.
pub const MOST_CONNECTIONS: usize = 64;
/// A connection on which nothing moves for so long is closed. Event streams send a comment more often.
pub const SILENCE: Duration = Duration::from_secs(40);

/// The bounds around another listener.
pub struct Guarded<L> {
    listener: L,
    places: Arc<Semaphore>,
    clock: Clock,
}

/// A connection that counts and is closed when it stays silent.
pub struct GuardedIo<I> {
    io: I,
    clock: Clock,
    moved: Instant,
    alarm: Pin<Box<dyn Future<Output = ()> + Send>>,
    _place: Option<OwnedSemaphorePermit>,
}

// === impl Guarded ===

impl<L> Guarded<L> {
    /// Bounds a listener.
    pub fn new(listener: L, clock: Clock) -> Guarded<L> {
        Guarded { listener, places: Arc::new(Semaphore::new(MOST_CONNECTIONS)), clock }
    }
}

impl<L: Listener> Listener for Guarded<L> {
    type Io = GuardedIo<L::Io>;
    type Addr = L::Addr;

    async fn accept(&mut self) -> (Self::Io, Self::Addr) {
        // The semaphore is never closed.
        let place = Arc::clone(&self.places).acquire_owned().await.ok();
        let (io, address) = self.listener.accept().await;
        (GuardedIo::new(io, self.clock, place), address)
    }

    fn local_addr(&self) -> io::Result<Self::Addr> {
        self.listener.local_addr()
    }
}

// === impl GuardedIo ===

impl<I> GuardedIo<I> {
    fn new(io: I, clock: Clock, place: Option<OwnedSemaphorePermit>) -> GuardedIo<I> {
        let moved = clock.now();
        GuardedIo { io, clock, moved, alarm: alarm(clock, moved + SILENCE), _place: place }
    }

    /// What an operation gave; waiting for it too long is an error.
    fn guard<T>(&mut self, polled: Poll<io::Result<T>>, cx: &mut Context<'_>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.moved = self.clock.now();
            return polled;
        }
        while self.alarm.as_mut().poll(cx).is_ready() {
            let due = self.moved + SILENCE;
            if due <= self.clock.now() {
                return Poll::Ready(Err(io::ErrorKind::TimedOut.into()));
            }
            self.alarm = alarm(self.clock, due);
        }
        Poll::Pending
    }
}

fn alarm(clock: Clock, at: Instant) -> Pin<Box<dyn Future<Output = ()> + Send>> {
    Box::pin(async move { clock.sleep_until(at).await })
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

    #[tokio::test(start_paused = true)]
    async fn a_silent_connection_is_closed_and_a_moving_one_is_not() {
        let clock = Clock::system();
        let (near, mut far) = tokio::io::duplex(64);
        let mut guarded = GuardedIo::new(near, clock, None);
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
        let mut guarded = GuardedIo::new(near, Clock::system(), None);
        assert_eq!(guarded.write_all(&[0; 1000]).await.unwrap_err().kind(), io::ErrorKind::TimedOut);
    }
}
