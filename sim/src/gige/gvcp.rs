//! GVCP, the control channel: requests in, answers out, all numbers big-endian. Pure; sockets live in `control`.

use super::registers::status;

/// A request that was understood.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Who is there?
    Discovery,
    /// Values of registers.
    ReadRegisters(Vec<u32>),
    /// New values of registers.
    WriteRegisters(Vec<(u32, u32)>),
    /// Bytes from an address.
    ReadMemory {
        /// First byte.
        address: u32,
        /// How many.
        count: usize,
    },
    /// Bytes to an address.
    WriteMemory {
        /// First byte.
        address: u32,
        /// The bytes.
        data: Vec<u8>,
    },
    /// Stream packets `first..=last` of a block, once more.
    Resend {
        /// Block id.
        block: u16,
        /// First packet.
        first: u32,
        /// Last packet.
        last: u32,
    },
    /// A command the twin does not know.
    Unknown,
}

/// A request with what its answer needs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Envelope {
    /// The command code; the answer's is one higher.
    pub command: u16,
    /// Request id, repeated in the answer.
    pub id: u16,
    /// The sender wants an answer.
    pub wants_answer: bool,
    /// What is asked.
    pub request: Request,
}

const KEY: u8 = 0x42;
/// Most bytes in one READMEM answer.
const MOST: usize = 536;

fn words(data: &[u8]) -> Vec<u32> {
    data.chunks_exact(4).map(|c| u32::from_be_bytes([c[0], c[1], c[2], c[3]])).collect()
}

/// Takes a datagram apart.
///
/// # Errors
/// A status to answer with, where the header is whole and the body is not; `None` where there is nobody to answer.
pub fn parse(datagram: &[u8]) -> Result<Envelope, Option<(u16, u16, u16)>> {
    let header = datagram.get(..8).filter(|h| h[0] == KEY).ok_or(None)?;
    let word = |i: usize| u16::from_be_bytes([header[i], header[i + 1]]);
    let (command, length, id) = (word(2), word(4) as usize, word(6));
    let bad = |code: u16| Some((code, command, id));
    let data = datagram.get(8..8 + length).ok_or(bad(status::INVALID_PARAMETER))?;
    let numbers = words(data);
    let request = match command {
        0x0002 => Request::Discovery,
        0x0080 if !numbers.is_empty() => Request::ReadRegisters(numbers),
        0x0082 if numbers.len() >= 2 && numbers.len().is_multiple_of(2) => {
            Request::WriteRegisters(numbers.chunks_exact(2).map(|p| (p[0], p[1])).collect())
        }
        0x0084 if numbers.len() == 2 => {
            let count = (numbers[1] & 0xffff) as usize;
            if count == 0 || !count.is_multiple_of(4) || count > MOST {
                return Err(bad(status::INVALID_PARAMETER));
            }
            Request::ReadMemory { address: numbers[0], count }
        }
        0x0086 if data.len() > 4 => Request::WriteMemory { address: numbers[0], data: data[4..].to_vec() },
        0x0040 if numbers.len() >= 3 => Request::Resend {
            block: (numbers[0] & 0xffff) as u16,
            first: numbers[1] & 0xff_ffff,
            last: numbers[2] & 0xff_ffff,
        },
        0x0080 | 0x0082 | 0x0084 | 0x0086 | 0x0040 => return Err(bad(status::INVALID_PARAMETER)),
        _ => Request::Unknown,
    };
    Ok(Envelope { command, id, wants_answer: header[1] & 1 == 1, request })
}

/// An answer: status 0 with data, or an error status.
pub fn answer(code: u16, command: u16, id: u16, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(8 + data.len());
    for word in [code, command.wrapping_add(1), data.len() as u16, id] {
        out.extend_from_slice(&word.to_be_bytes());
    }
    out.extend_from_slice(data);
    out
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_worked_exchange_of_the_protocol_sheet_parses() {
        let control = [0x42, 1, 0, 0x82, 0, 8, 0, 2, 0, 0, 0x0a, 0, 0, 0, 0, 2];
        let e = parse(&control).unwrap();
        assert_eq!((e.id, e.wants_answer), (2, true));
        assert_eq!(e.request, Request::WriteRegisters(vec![(0x0a00, 2)]));
        assert_eq!(answer(0, e.command, e.id, &[0, 0, 0, 1]), [0, 0, 0, 0x83, 0, 4, 0, 2, 0, 0, 0, 1]);
        let resend = [0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0, 0, 0x15, 0, 0, 0, 7, 0, 0, 0, 9];
        assert_eq!(parse(&resend).unwrap().request, Request::Resend { block: 0x15, first: 7, last: 9 });
    }

    proptest! {
        #[test]
        fn no_datagram_makes_the_parser_fail(bytes in prop::collection::vec(any::<u8>(), 0..64), key in any::<bool>()) {
            let mut bytes = bytes;
            if key && let Some(first) = bytes.first_mut() {
                *first = KEY;
            }
            if let Ok(e) = parse(&bytes) {
                prop_assert!(bytes.len() >= 8);
                prop_assert_eq!(u16::from_be_bytes([bytes[6], bytes[7]]), e.id);
            }
        }
    }
}
