//! What a fuzz target is, and its replay in a normal test: every seed of its corpus and thousands of deterministic
//! mutations of each.

use std::path::{Path, PathBuf};

/// A parser that eats bytes from outside, with what must hold whatever they are.
#[derive(Clone, Copy)]
pub struct Target {
    /// Folder of its corpus.
    pub name: &'static str,
    /// Eats one input. A panic is a fault; an error says which promise was broken, such as that what was read writes
    /// itself as it was.
    pub run: fn(&[u8]) -> Result<(), String>,
    /// Mutations of each seed in the replay, by what one costs.
    pub mutations: usize,
}

/// Numbers without chance: the same on every machine (xorshift64*).
pub struct Dice(u64);

/// What breaks number parsers, separators and lengths.
const NASTY: [&[u8]; 16] = [
    b"+1",
    b"-0",
    b"1e999",
    b"nan",
    b"inf",
    b"99999999999999999999",
    b"18446744073709551615",
    b"\xff\xfe",
    b"\0",
    b"\r\n",
    b"\n\r",
    b":",
    b",,",
    b"\xc3\xa9",
    b"\x80",
    b" ",
];

// === impl Dice ===

impl Dice {
    /// Dice that begin with the bytes of `name`.
    pub fn new(name: &str) -> Dice {
        Dice(name.bytes().fold(0x9E37_79B9_7F4A_7C15, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01B3)) | 1)
    }

    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// A number below `n`, 0 for none.
    pub fn below(&mut self, n: usize) -> usize {
        ((self.next() >> 33) as usize) % n.max(1)
    }
}

/// One to three changes of `seed`; now and then a piece of `other` instead.
pub fn mutate(seed: &[u8], other: &[u8], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = seed.to_vec();
    for _ in 0..=dice.below(3) {
        let at = dice.below(bytes.len() + 1);
        let end = (at + 1 + dice.below(8)).min(bytes.len()).max(at);
        match dice.below(8) {
            0 | 1 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << dice.below(8);
                }
            }
            2 => {
                if let Some(byte) = bytes.get_mut(at) {
                    *byte = dice.below(256) as u8;
                }
            }
            3 => drop(bytes.drain(at..end)),
            4 => {
                let piece: Vec<u8> = bytes.get(at..end).unwrap_or_default().to_vec();
                bytes.splice(at..at, piece);
            }
            5 => drop(bytes.splice(at..end, NASTY[dice.below(NASTY.len())].iter().copied())),
            6 => bytes.truncate(at),
            _ => {
                let from = dice.below(other.len() + 1);
                let to = (from + dice.below(32)).min(other.len());
                bytes.splice(at..end, other.get(from..to).unwrap_or_default().iter().copied());
            }
        }
    }
    bytes
}

/// The seeds of a target, by file name.
pub fn seeds(corpus: &Path, name: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = corpus.join(name);
    let listed = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut paths: Vec<PathBuf> = listed.map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.into_iter().map(|path| (path.clone(), std::fs::read(&path).unwrap())).collect()
}

/// Replays all targets; panics with every input that broke a promise, ready to be kept as a regression.
pub fn replay(corpus: &Path, targets: &[Target]) {
    let mut broken = Vec::new();
    for target in targets {
        let seeds = seeds(corpus, target.name);
        assert!(!seeds.is_empty(), "{} has no seeds", target.name);
        let mut dice = Dice::new(target.name);
        for (path, seed) in &seeds {
            let other = &seeds[dice.below(seeds.len())].1;
            let mutants = (0..target.mutations).map(|_| mutate(seed, other, &mut dice));
            for bytes in std::iter::once(seed.clone()).chain(mutants) {
                let fault = match std::panic::catch_unwind(|| (target.run)(&bytes)) {
                    Ok(Ok(())) => continue,
                    Ok(Err(promise)) => promise,
                    Err(_) => "it panics".to_owned(),
                };
                broken.push(format!("{} from {}: {fault}: \"{}\"", target.name, path.display(), bytes.escape_ascii()));
                break;
            }
        }
    }
    assert!(broken.is_empty(), "broken promises:\n{}", broken.join("\n"));
}
