//! USBTMC: text messages over two bulk endpoints, and the requests that bring a device back when the messages are out of step.
//!
//! Source: USB Test and Measurement Class 1.0, tables 1-9 (bulk headers) and 15-37 (control requests). A read names the
//! most bytes it takes and a tag that the answer repeats; an answer ends with its end-of-message bit. The tag binds an
//! answer to the read, not to the question: a device that is one answer behind still tags it right.

use crate::clock::Clock;
use crate::transport::usb::{Setup, Transfer, UsbError, UsbLink};
use std::time::Duration;

/// Bytes of a bulk header.
pub const HEADER: usize = 12;
/// Message ids.
const DEV_DEP_MSG_OUT: u8 = 1;
const DEV_DEP_MSG_IN: u8 = 2;
/// End of message.
const EOM: u8 = 1;
/// Longest answer taken.
const MOST_ANSWER: usize = 4096;
/// Bytes asked for with one read.
const READ_SIZE: usize = 1024;
/// Padding that may follow the data of an answer.
const MOST_PADDING: usize = 3;
/// Class requests: to the interface and to an endpoint, both with an answer.
const TO_INTERFACE: u8 = 0xA1;
const TO_ENDPOINT: u8 = 0xA2;
const INITIATE_ABORT_BULK_IN: u8 = 3;
const CHECK_ABORT_BULK_IN: u8 = 4;
const INITIATE_CLEAR: u8 = 5;
const CHECK_CLEAR: u8 = 6;
/// Status words of the answers.
const SUCCESS: u8 = 1;
const PENDING: u8 = 2;
/// Looks at a status that stays "pending", and the pause between them.
const MOST_CHECKS: usize = 50;
const CHECK_PAUSE: Duration = Duration::from_millis(20);
/// Limit of a control request.
const CONTROL_LIMIT: Duration = Duration::from_secs(1);
/// Limit of a message to the device.
const SEND_LIMIT: Duration = Duration::from_secs(1);
/// Quiet time that ends a drain.
const QUIET: Duration = Duration::from_millis(30);

/// Why a message did not get through.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TmcError {
    /// The transfer failed.
    Usb(UsbError),
    /// Bytes came that are no answer to this read; with the reason.
    Frame(String),
}

/// One read's worth of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Part {
    /// The bytes.
    pub data: Vec<u8>,
    /// The message ends here.
    pub end: bool,
}

/// The message layer over an open link.
pub struct Tmc {
    link: UsbLink,
    clock: Clock,
    out: u8,
    input: u8,
    tag: u8,
}

impl From<UsbError> for TmcError {
    fn from(error: UsbError) -> TmcError {
        TmcError::Usb(error)
    }
}

/// A message to the device: header, text, zeros up to a multiple of four.
pub fn message(tag: u8, text: &[u8]) -> Vec<u8> {
    let mut bytes = vec![DEV_DEP_MSG_OUT, tag, !tag, 0];
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend([EOM, 0, 0, 0]);
    bytes.extend(text);
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    bytes
}

/// The request for at most `size` bytes of an answer.
pub fn request(tag: u8, size: u32) -> Vec<u8> {
    let mut bytes = vec![DEV_DEP_MSG_IN, tag, !tag, 0];
    bytes.extend(size.to_le_bytes());
    bytes.extend([0; 4]);
    bytes
}

/// What came on a read with this tag that asked for at most `most` bytes.
///
/// # Errors
/// The reason why it is not an answer to that read.
pub fn part(bytes: &[u8], tag: u8, most: usize) -> Result<Part, String> {
    let Some((head, body)) = bytes.split_first_chunk::<HEADER>() else {
        return Err(format!("{} bytes came, fewer than a header", bytes.len()));
    };
    let [id, its_tag, inverse, zero, s0, s1, s2, s3, attributes, rest @ ..] = *head;
    if id != DEV_DEP_MSG_IN || zero != 0 || rest != [0; 3] || attributes & !3 != 0 {
        return Err(format!("the header {head:02X?} is not that of an answer"));
    }
    if its_tag != !inverse || its_tag != tag {
        return Err(format!("the answer has tag {its_tag} (inverse {inverse:#04X}), the read had {tag}"));
    }
    let size = u32::from_le_bytes([s0, s1, s2, s3]) as usize;
    if size > most {
        return Err(format!("the answer says {size} bytes, {most} were asked for"));
    }
    let data = body.get(..size).ok_or_else(|| format!("the answer says {size} bytes, {} came", body.len()))?;
    if body.len() > size + MOST_PADDING {
        return Err(format!("the answer says {size} bytes, {} came", body.len()));
    }
    Ok(Part { data: data.to_vec(), end: attributes & EOM != 0 })
}

// === impl Tmc ===

impl Tmc {
    /// The layer over `link`; `None` when the device has no pair of bulk endpoints.
    pub fn new(link: UsbLink, clock: Clock) -> Option<Tmc> {
        let (out, input) = link.info().bulk_pair()?;
        Some(Tmc { link, clock, out: out.address, input: input.address, tag: 0 })
    }

    /// Sends one message.
    pub async fn send(&mut self, text: &str) -> Result<(), TmcError> {
        let tag = self.next_tag();
        Ok(self.link.send(self.out, &message(tag, text.as_bytes()), SEND_LIMIT).await?)
    }

    /// Reads one answer up to its end of message, without its line end; each of its parts within `limit`.
    pub async fn receive(&mut self, limit: Duration) -> Result<String, TmcError> {
        let mut whole = Vec::new();
        while whole.len() < MOST_ANSWER {
            let tag = self.next_tag();
            self.link.send(self.out, &request(tag, READ_SIZE as u32), SEND_LIMIT).await?;
            let bytes = self.link.read(self.input, HEADER + READ_SIZE + MOST_PADDING, limit).await?;
            let part = part(&bytes, tag, READ_SIZE).map_err(TmcError::Frame)?;
            let (none, end) = (part.data.is_empty(), part.end);
            whole.extend(part.data);
            if end {
                let text =
                    String::from_utf8(whole).map_err(|_| TmcError::Frame("the answer is not text".to_owned()))?;
                return Ok(text.trim_end_matches(['\r', '\n']).to_owned());
            }
            if none {
                return Err(TmcError::Frame("an answer without data does not end".to_owned()));
            }
        }
        Err(TmcError::Frame(format!("the answer has more than {MOST_ANSWER} bytes")))
    }

    /// Throws away all messages on both sides: abort the read, clear, clear both halts, drain (USBTMC 4.2.1.4-4.2.1.7).
    pub async fn clear(&mut self) -> Transfer<()> {
        self.abort_read().await?;
        if self.class_request(TO_INTERFACE, INITIATE_CLEAR, 0, 1).await?.first() == Some(&SUCCESS) {
            self.until_done(TO_INTERFACE, CHECK_CLEAR, 2).await?;
        }
        self.link.clear_halt(self.out).await?;
        self.link.clear_halt(self.input).await?;
        self.link.drain(self.input, READ_SIZE, QUIET).await?;
        Ok(())
    }

    /// Ends the read under way. A device that says there is none is already where it should be.
    async fn abort_read(&mut self) -> Transfer<()> {
        let value = u16::from(self.tag);
        let answer = match self.class_request(TO_ENDPOINT, INITIATE_ABORT_BULK_IN, value, 2).await {
            Ok(answer) => answer,
            Err(UsbError::Stall) => return Ok(()),
            Err(error) => return Err(error),
        };
        if answer.first() == Some(&SUCCESS) {
            self.link.drain(self.input, READ_SIZE, QUIET).await?;
            self.until_done(TO_ENDPOINT, CHECK_ABORT_BULK_IN, 8).await?;
        }
        Ok(())
    }

    /// Asks until the device has finished what was initiated.
    async fn until_done(&mut self, to: u8, request: u8, length: usize) -> Transfer<()> {
        for _ in 0..MOST_CHECKS {
            let answer = self.class_request(to, request, 0, length).await?;
            // Bit 0 of the second byte: bytes wait and must be read first.
            if answer.get(1).is_some_and(|more| more & 1 != 0) {
                self.link.drain(self.input, READ_SIZE, QUIET).await?;
            }
            if answer.first() != Some(&PENDING) {
                return Ok(());
            }
            self.clock.sleep(CHECK_PAUSE).await;
        }
        Err(UsbError::Timeout)
    }

    async fn class_request(&mut self, to: u8, request: u8, value: u16, length: usize) -> Transfer<Vec<u8>> {
        let index = if to == TO_INTERFACE { self.link.info().interface } else { self.input };
        let setup = Setup { request_type: to, request, value, index: u16::from(index) };
        self.link.control_in(setup, length, CONTROL_LIMIT).await
    }

    /// Tags run from 1 to 255.
    fn next_tag(&mut self) -> u8 {
        self.tag = self.tag.checked_add(1).unwrap_or(1);
        self.tag
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headers_are_the_worked_exchange() {
        assert_eq!(message(1, b"*IDN?\n"), b"\x01\x01\xFE\x00\x06\x00\x00\x00\x01\x00\x00\x00*IDN?\n\x00\x00");
        assert_eq!(request(2, 1024), b"\x02\x02\xFD\x00\x00\x04\x00\x00\x00\x00\x00\x00");
        let answer = b"\x02\x02\xFD\x00\x1D\x00\x00\x00\x01\x00\x00\x00THORLABS,PM100D,P0001234,2.4\n\x00\x00\x00";
        let part = part(answer, 2, 1024).unwrap();
        assert_eq!((part.data.as_slice(), part.end), (&b"THORLABS,PM100D,P0001234,2.4\n"[..], true));
    }

    fn answer(tag: u8, data: &[u8], padding: usize) -> Vec<u8> {
        let mut bytes = vec![2, tag, !tag, 0];
        bytes.extend((data.len() as u32).to_le_bytes());
        bytes.extend([1, 0, 0, 0]);
        bytes.extend(data);
        bytes.resize(bytes.len() + padding, 0);
        bytes
    }

    proptest! {
        #[test]
        fn any_bytes_are_an_answer_or_a_reason(bytes in proptest::collection::vec(any::<u8>(), 0..64), tag in 1_u8.., most in 0_usize..64) {
            if let Ok(part) = part(&bytes, tag, most) {
                prop_assert!(part.data.len() <= most);
                prop_assert_eq!(bytes[1], tag);
                prop_assert_eq!(&bytes[12..12 + part.data.len()], part.data.as_slice());
            }
        }

        #[test]
        fn an_answer_comes_through_and_a_changed_header_does_not(
            tag in 1_u8.., data in proptest::collection::vec(any::<u8>(), 0..80), padding in 0_usize..4,
            place in 0_usize..8, mask in 1_u8..,
        ) {
            let bytes = answer(tag, &data, padding);
            prop_assert_eq!(part(&bytes, tag, 1024).unwrap().data, data.clone());
            prop_assert!(part(&bytes, tag.wrapping_add(1), 1024).is_err());
            let mut changed = bytes;
            changed[place] ^= mask;
            // A length that shrinks by less than the padding allows is the one change a header cannot show.
            if let Ok(part) = part(&changed, tag, 1024) {
                prop_assert!(place == 4 && part.data.len() < data.len() + 4 && part.data.len() != data.len());
            }
        }
    }
}
