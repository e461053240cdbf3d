//! A Zaber request as it comes: checksum, address, words, and the lines that continue a long one.
//!
//! Source: the protocol sheet `zaber-ascii`, sections 1 and 2.

/// Longest request that continued lines may make.
const MAX_WHOLE: usize = 1024;

/// A request as it came: who is meant, which id, which words.
#[derive(Debug)]
pub(super) struct Request<'a> {
    /// Address; 0 = every device.
    pub device: u8,
    /// Axis; 0 = the device.
    pub axis: u8,
    /// Message id that the reply repeats.
    pub id: Option<u8>,
    /// What is wanted.
    pub words: Vec<&'a str>,
}

/// Puts requests together that come in several lines: each but the last ends in `\`, each but the first says `cont N`.
#[derive(Debug, Default)]
pub(super) struct Continued {
    whole: Option<String>,
}

/// The text between `/` and checksum of a line; `None` for what is no request or came garbled.
pub(super) fn body(line: &[u8]) -> Option<&str> {
    let start = line.iter().rposition(|&b| b == b'/')?;
    let text = std::str::from_utf8(line.get(start + 1..)?).ok()?;
    match text.split_once(':') {
        None => Some(text),
        Some((body, sum)) if sum == format!("{:02X}", checksum(body)) => Some(body),
        Some(_) => None,
    }
}

/// Number that makes the sum of all bytes zero modulo 256.
pub(super) fn checksum(body: &str) -> u8 {
    let sum: u32 = body.bytes().map(u32::from).sum();
    ((256 - sum % 256) % 256) as u8
}

// === impl Request ===

impl<'a> Request<'a> {
    /// Reads `[device [axis [id]]] words`.
    pub fn of(body: &'a str) -> Request<'a> {
        let mut words: Vec<&str> = body.split_ascii_whitespace().collect();
        let mut number = || {
            let n = words.first().and_then(|w| w.parse::<u8>().ok());
            if n.is_some() || words.first() == Some(&"--") {
                words.remove(0);
            }
            n
        };
        let device = number();
        let axis = device.and_then(|_| number());
        let id = axis.and_then(|_| number());
        Request { device: device.unwrap_or(0), axis: axis.unwrap_or(0), id, words }
    }
}

// === impl Continued ===

impl Continued {
    /// Takes the body of a line and gives the whole request once its last line has come.
    pub fn take(&mut self, body: &str) -> Option<String> {
        let (text, more) = body.strip_suffix('\\').map_or((body, false), |text| (text, true));
        let whole = match (self.whole.take(), Request::of(text).words.as_slice()) {
            (Some(begun), ["cont", _, rest @ ..]) => format!("{begun} {}", rest.join(" ")),
            _ => text.to_owned(),
        };
        if !more {
            return Some(whole);
        }
        self.whole = Some(whole).filter(|text| text.len() <= MAX_WHOLE);
        None
    }

    /// Forgets what was begun.
    pub fn clear(&mut self) {
        self.whole = None;
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn checksums_of_the_sheet_are_taken_and_others_are_not() {
        assert_eq!(checksum("01 tools echo"), 0x8F);
        assert_eq!(checksum("1 1 04 get pos"), 0x28);
        assert_eq!(body(b"/1 1 04 get pos:28"), Some("1 1 04 get pos"));
        assert_eq!(body(b"junk/1 1 04 get pos"), Some("1 1 04 get pos"));
        assert_eq!(body(b"/1 1 04 get pos:29"), None);
        assert_eq!(body(b"get pos"), None);
    }

    #[test]
    fn addresses_may_be_left_out_from_the_right() {
        let of = |text| {
            let r = Request::of(text);
            (r.device, r.axis, r.id, r.words.len())
        };
        assert_eq!(of(""), (0, 0, None, 0));
        assert_eq!(of("get pos"), (0, 0, None, 2));
        assert_eq!(of("2 home"), (2, 0, None, 1));
        assert_eq!(of("2 1 -- home"), (2, 1, None, 1));
        assert_eq!(of("02 1 07 move abs 5"), (2, 1, Some(7), 3));
    }

    #[test]
    fn a_request_may_go_on_over_lines() {
        let mut lines = Continued::default();
        assert_eq!(lines.take("1 0 05 tools echo a\\"), None);
        assert_eq!(lines.take("1 0 05 cont 1 b\\"), None);
        assert_eq!(lines.take("1 0 05 cont 2 c").as_deref(), Some("1 0 05 tools echo a b c"));
        assert_eq!(lines.take("1 0 05 cont 1 c").as_deref(), Some("1 0 05 cont 1 c"), "nothing was begun");
        lines.take("1 tools echo a\\");
        assert_eq!(lines.take("2 home").as_deref(), Some("2 home"), "another request ends it");
    }
}
