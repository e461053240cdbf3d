//! One open byte link with its unread bytes: sends whole requests, takes whole lines or prompts.
//!
//! Unread bytes live in the link, so a read that is cancelled or runs into its deadline loses nothing. The store is
//! bounded; an end of file is [`ErrorKind::Lost`].

use crate::clock::Clock;
use crate::error::{DeviceError, ErrorKind, Result};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::Instant;

/// Unread bytes a link keeps at most.
const MAX_UNREAD: usize = 4096;
/// Longest line taken: three times what a Zaber packet of 80 bytes needs.
const MAX_LINE: usize = 256;
/// Bytes that `drain` throws away before it gives up on a device that never stops sending.
const MAX_DRAIN: usize = 65_536;
/// Limit for writing a request; a few dozen bytes at 9600 baud take less than 0.1 s.
const WRITE_LIMIT: Duration = Duration::from_secs(1);

/// Anything a link can run over.
pub trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// An open byte link to one device (or one chain of devices).
pub struct Link {
    stream: Box<dyn Stream>,
    port: String,
    clock: Clock,
    unread: Vec<u8>,
}

// === impl Link ===

impl Link {
    /// A link over `stream`; `port` is named in errors.
    pub fn new(port: impl Into<String>, stream: impl Stream + 'static, clock: Clock) -> Link {
        Link { stream: Box::new(stream), port: port.into(), clock, unread: Vec::new() }
    }

    /// The port's name.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// Writes a whole request. `Lost` when the link is gone, `Timeout` when nobody takes the bytes within 1 s.
    pub async fn send(&mut self, bytes: &[u8]) -> Result<()> {
        let stream = &mut self.stream;
        let write = async {
            stream.write_all(bytes).await?;
            stream.flush().await
        };
        match self.clock.timeout(WRITE_LIMIT, write).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(cause)) => Err(self.lost(&format!("writing failed ({cause})"))),
            Err(_) => Err(DeviceError::new(
                ErrorKind::Timeout,
                &self.port,
                "the port takes no bytes; check cable and power of the device",
            )),
        }
    }

    /// The next line without its CR LF, or `None` at `deadline`. A line over 256 bytes is thrown away: `Garbled`.
    pub async fn line(&mut self, deadline: Instant) -> Result<Option<Vec<u8>>> {
        let mut line = self.until(b'\n', deadline).await?;
        if let Some(text) = line.as_mut().filter(|l| l.last() == Some(&b'\r')) {
            text.pop();
        }
        Ok(line)
    }

    /// Everything up to the next byte `end` (without it), or `None` at `deadline`. More than 256 bytes are thrown away:
    /// `Garbled`.
    pub async fn until(&mut self, end: u8, deadline: Instant) -> Result<Option<Vec<u8>>> {
        loop {
            if let Some(at) = self.unread.iter().position(|&b| b == end) {
                let mut line: Vec<u8> = self.unread.drain(..=at).collect();
                line.pop();
                if line.len() > MAX_LINE {
                    return Err(self.garbled("a line of more than 256 bytes came"));
                }
                return Ok(Some(line));
            }
            if self.unread.len() > MAX_LINE {
                self.unread.clear();
                return Err(self.garbled("more than 256 bytes came without a line end"));
            }
            if !self.fill(deadline).await? {
                return Ok(None);
            }
        }
    }

    /// Everything up to the next ready prompt `> ` (without it), or `None` at `deadline`.
    pub async fn prompt(&mut self, deadline: Instant) -> Result<Option<Vec<u8>>> {
        loop {
            if let Some(at) = self.unread.windows(2).position(|w| w == b"> ") {
                let mut text: Vec<u8> = self.unread.drain(..at + 2).collect();
                text.truncate(at);
                return Ok(Some(text));
            }
            if !self.fill(deadline).await? {
                return Ok(None);
            }
        }
    }

    /// Exactly `count` bytes (binary protocols: read by length), or `None` at `deadline`; fewer bytes stay unread.
    pub async fn exactly(&mut self, count: usize, deadline: Instant) -> Result<Option<Vec<u8>>> {
        while self.unread.len() < count {
            if !self.fill(deadline).await? {
                return Ok(None);
            }
        }
        Ok(Some(self.unread.drain(..count).collect()))
    }

    /// Throws away what is there and what comes until the line has been quiet for `quiet`; gives the number of bytes.
    /// `Garbled` when the device does not stop sending.
    pub async fn drain(&mut self, quiet: Duration) -> Result<usize> {
        let mut thrown = 0;
        loop {
            thrown += self.unread.len();
            self.unread.clear();
            if thrown > MAX_DRAIN {
                return Err(
                    self.garbled("it does not stop sending; check baud rate and that the right device is connected")
                );
            }
            if !self.fill(self.clock.now() + quiet).await? {
                return Ok(thrown);
            }
        }
    }

    /// Number of bytes that came without being asked for; they are kept.
    pub async fn unsolicited(&mut self) -> Result<usize> {
        self.fill(self.clock.now()).await?;
        Ok(self.unread.len())
    }

    /// Reads once; false at the deadline.
    async fn fill(&mut self, deadline: Instant) -> Result<bool> {
        let mut chunk = [0_u8; 256];
        let left = deadline.saturating_duration_since(self.clock.now());
        match self.clock.timeout(left, self.stream.read(&mut chunk)).await {
            Err(_) => Ok(false),
            Ok(Ok(0)) => Err(self.lost("the link was closed")),
            Ok(Err(cause)) => Err(self.lost(&format!("reading failed ({cause})"))),
            Ok(Ok(n)) => {
                self.unread.extend(chunk.iter().take(n));
                if self.unread.len() > MAX_UNREAD {
                    self.unread.clear();
                    return Err(self.garbled("more than 4096 bytes came without an end"));
                }
                Ok(true)
            }
        }
    }

    fn lost(&self, what: &str) -> DeviceError {
        DeviceError::new(
            ErrorKind::Lost,
            &self.port,
            format!("{what}; check cable, adapter and power, then open the device again"),
        )
    }

    fn garbled(&self, what: &str) -> DeviceError {
        DeviceError::new(ErrorKind::Garbled, &self.port, what)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use tokio::io::DuplexStream;

    fn pair() -> (Link, DuplexStream, Clock) {
        let clock = Clock::system();
        let (near, far) = tokio::io::duplex(16_384);
        (Link::new("test", near, clock), far, clock)
    }

    #[tokio::test(start_paused = true)]
    async fn a_line_survives_the_deadline_that_cut_it() {
        let (mut link, mut far, clock) = pair();
        far.write_all(b"@01 1 0").await.unwrap();
        assert_eq!(link.line(clock.now() + Duration::from_millis(50)).await.unwrap(), None);
        far.write_all(b"4 OK\r\nnext").await.unwrap();
        let line = link.line(clock.now() + Duration::from_millis(50)).await.unwrap().unwrap();
        assert_eq!(line, b"@01 1 04 OK");
    }

    #[tokio::test(start_paused = true)]
    async fn a_prompt_ends_a_reply_and_the_next_reply_stays() {
        let (mut link, mut far, clock) = pair();
        far.write_all(b"pos?\r3\r> pcount?\r12\r> ").await.unwrap();
        let soon = clock.now() + Duration::from_millis(10);
        assert_eq!(link.prompt(soon).await.unwrap().unwrap(), b"pos?\r3\r");
        assert_eq!(link.prompt(soon).await.unwrap().unwrap(), b"pcount?\r12\r");
        assert_eq!(link.prompt(soon).await.unwrap(), None);
    }

    #[tokio::test(start_paused = true)]
    async fn bytes_are_read_by_length_and_a_part_of_them_stays() {
        let (mut link, mut far, clock) = pair();
        far.write_all(&[0x18, 0x18, 0x02]).await.unwrap();
        let soon = clock.now() + Duration::from_millis(10);
        assert_eq!(link.exactly(4, soon).await.unwrap(), None);
        far.write_all(&[0x18, 0x1b]).await.unwrap();
        assert_eq!(link.exactly(4, soon).await.unwrap().unwrap(), [0x18, 0x18, 0x02, 0x18]);
        assert_eq!(link.exactly(1, soon).await.unwrap().unwrap(), [0x1b]);
    }

    #[tokio::test(start_paused = true)]
    async fn the_end_of_the_stream_is_a_lost_link() {
        let (mut link, far, clock) = pair();
        drop(far);
        assert_eq!(link.line(clock.now()).await.unwrap_err().kind, ErrorKind::Lost);
        assert_eq!(link.drain(Duration::from_millis(1)).await.unwrap_err().kind, ErrorKind::Lost);
    }

    #[tokio::test(start_paused = true)]
    async fn lines_and_prompts_are_bounded() {
        let (mut link, mut far, clock) = pair();
        far.write_all(&[b'x'; 600]).await.unwrap();
        assert_eq!(link.line(clock.now()).await.unwrap_err().kind, ErrorKind::Garbled);
        far.write_all(&[b'x'; 9000]).await.unwrap();
        assert_eq!(link.prompt(clock.now()).await.unwrap_err().kind, ErrorKind::Garbled);
        assert!(link.drain(Duration::from_millis(5)).await.unwrap() > 0);
        assert_eq!(link.unsolicited().await.unwrap(), 0);
    }
}
