//! SHA-256 as text: what names the content of a file everywhere in a run.

use sha2::{Digest, Sha256};
use std::fs::File;
use std::io;
use std::path::Path;

/// SHA-256 of bytes, hexadecimal, lower case.
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// SHA-256 of a file, read piece by piece.
///
/// # Errors
/// A file that cannot be read.
pub fn sha256_of_file(path: &Path) -> io::Result<String> {
    let mut digest = Sha256::new();
    io::copy(&mut File::open(path)?, &mut digest)?;
    Ok(hex(&digest.finalize()))
}

/// SHA-256 of a text that is written bit by bit and never held as a whole.
#[derive(Default)]
pub struct TextDigest(Sha256);

impl TextDigest {
    /// The digest, as [`sha256_hex`] gives it.
    pub fn hex(self) -> String {
        hex(&self.0.finalize())
    }
}

impl std::fmt::Write for TextDigest {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.update(text.as_bytes());
        Ok(())
    }
}

fn hex(digest: &[u8]) -> String {
    let mut text = String::with_capacity(64);
    for byte in digest {
        text.push(char::from_digit(u32::from(byte >> 4), 16).unwrap_or('0'));
        text.push(char::from_digit(u32::from(byte & 15), 16).unwrap_or('0'));
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    #[test]
    fn a_text_written_bit_by_bit_has_the_digest_of_the_whole() {
        use std::fmt::Write;
        let mut text = TextDigest::default();
        write!(text, "a{:?}", [1, 2]).unwrap();
        assert_eq!(text.hex(), sha256_hex(b"a[1, 2]"));
    }

    #[test]
    fn a_file_has_the_digest_of_its_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (path, bytes) = (folder.path().join("f"), vec![7; 100_000]);
        std::fs::write(&path, &bytes).unwrap();
        assert_eq!(sha256_of_file(&path).unwrap(), sha256_hex(&bytes));
        assert!(sha256_of_file(&folder.path().join("none")).is_err());
    }

    #[test]
    fn digests_are_those_of_the_standard() {
        // FIPS 180-4, message "abc".
        assert_eq!(sha256_hex(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
