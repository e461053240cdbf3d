//! Stored programs of an ESP301: lines kept under a number, written between `EP` and `QP`, run by `EX`.
//!
//! Source: the protocol sheet `newport-esp301` (names and error numbers) and public clients that write and run programs.
//! That questions are answered at once while a program is written, and that erasing what is not there is no error, is
//! assumed: clients ask for errors after each line.

use std::collections::BTreeMap;

/// Numbers that a program may have.
const NUMBERS: std::ops::RangeInclusive<usize> = 1..=100;
/// Lines of one program.
const MOST_LINES: usize = 200;
/// Lines that one run may come to, its loops unrolled.
pub(super) const MOST_STEPS: usize = 256;

/// The program store.
#[derive(Debug, Default)]
pub(super) struct Programs {
    lines: BTreeMap<usize, Vec<String>>,
    /// The program that is being written.
    writing: Option<usize>,
    /// The program that runs at power-up.
    at_power_up: usize,
}

/// What a program command does besides.
#[derive(Debug, PartialEq)]
pub(super) enum Done {
    /// Not a command about programs.
    Other,
    /// Nothing more.
    Quiet,
    /// Lines to be told.
    Told(Vec<String>),
    /// Commands to be carried out.
    Run(Vec<String>),
}

// === impl Programs ===

impl Programs {
    /// Power goes and comes back: what was written stays, the one that was being written ends.
    pub fn power_cycle(&mut self) {
        self.writing = None;
    }

    /// Takes a command: keeps it while a program is written, or does what it says about programs.
    ///
    /// # Errors
    /// The controller's error number.
    pub fn take(&mut self, text: &str, number: Option<usize>, name: &str, parameter: &str) -> Result<Done, u16> {
        if let Some(writing) = self.writing.filter(|_| name != "QP" && !text.contains('?')) {
            let lines = self.lines.entry(writing).or_default();
            if lines.len() >= MOST_LINES {
                return Err(28);
            }
            lines.push(text.to_owned());
            return Ok(Done::Quiet);
        }
        if name == "QP" {
            return self.writing.take().map(|_| Done::Quiet).ok_or(26);
        }
        if matches!(name, "DL" | "JL") {
            return Err(27);
        }
        if !matches!(name, "EP" | "EX" | "XX" | "LP" | "EO") {
            return Ok(Done::Other);
        }
        if (name, parameter) == ("EO", "?") {
            return Ok(Done::Told(vec![self.at_power_up.to_string()]));
        }
        let number = number.ok_or(38_u16)?;
        if !NUMBERS.contains(&number) {
            return Err(7);
        }
        match name {
            "EP" => {
                self.lines.entry(number).or_default();
                self.writing = Some(number);
                Ok(Done::Quiet)
            }
            "XX" => {
                self.lines.remove(&number);
                Ok(Done::Quiet)
            }
            "LP" => self.lines.get(&number).cloned().map(Done::Told).ok_or(35),
            "EO" if !self.lines.contains_key(&number) => Err(35),
            "EO" => {
                self.at_power_up = number;
                Ok(Done::Quiet)
            }
            _ => {
                let times = if parameter.is_empty() { 1 } else { parameter.parse().map_err(|_| 7_u16)? };
                let program = self.lines.get(&number).ok_or(35_u16)?;
                Ok(Done::Run(unrolled(program, times)))
            }
        }
    }
}

/// The commands of so many runs; labels (`1DL`) are left out, jumps (`1JL5`: five times) are followed.
fn unrolled(program: &[String], times: usize) -> Vec<String> {
    let split = |line: &str| {
        let digits = line.bytes().take_while(u8::is_ascii_digit).count();
        let (number, rest) = line.split_at(digits);
        let (name, parameter) = rest.split_at_checked(2).unwrap_or((rest, ""));
        (number.to_owned(), name.to_ascii_uppercase(), parameter.trim().parse::<usize>().unwrap_or(usize::MAX))
    };
    let mut steps = Vec::new();
    for _ in 0..times.min(MOST_STEPS) {
        let mut jumps: BTreeMap<usize, usize> = BTreeMap::new();
        let (mut at, mut turns) = (0, 0);
        while let Some(line) = program.get(at).filter(|_| steps.len() < MOST_STEPS && turns < 16 * MOST_STEPS) {
            (at, turns) = (at + 1, turns + 1);
            let (number, name, limit) = split(line);
            let label = || program.iter().position(|l| split(l) == (number.clone(), "DL".to_owned(), usize::MAX));
            match name.as_str() {
                "DL" => {}
                "JL" => {
                    let done = jumps.entry(at).or_default();
                    if let Some(place) = label().filter(|_| *done < limit) {
                        *done += 1;
                        at = place;
                    }
                }
                _ => steps.push(line.clone()),
            }
        }
    }
    steps
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;

    fn say(programs: &mut Programs, text: &str) -> Result<Done, u16> {
        let digits = text.bytes().take_while(u8::is_ascii_digit).count();
        let (number, rest) = text.split_at(digits);
        programs.take(text, number.parse().ok(), &rest[..2], &rest[2..])
    }

    #[test]
    fn a_program_is_written_listed_run_and_erased() {
        let mut p = Programs::default();
        assert_eq!(say(&mut p, "5EX"), Err(35));
        assert_eq!(say(&mut p, "QP"), Err(26));
        assert_eq!(say(&mut p, "101EP"), Err(7));
        assert_eq!(say(&mut p, "1DL"), Err(27));
        for line in ["5XX", "5EP", "1PR1", "1WS", "QP"] {
            assert_eq!(say(&mut p, line), Ok(Done::Quiet), "{line}");
        }
        assert_eq!(say(&mut p, "1PR1"), Ok(Done::Other));
        assert_eq!(say(&mut p, "5LP"), Ok(Done::Told(vec!["1PR1".into(), "1WS".into()])));
        assert_eq!(say(&mut p, "5EX2"), Ok(Done::Run(["1PR1", "1WS", "1PR1", "1WS"].map(String::from).into())));
        assert_eq!(say(&mut p, "5XX"), Ok(Done::Quiet));
        assert_eq!(say(&mut p, "5LP"), Err(35));
    }

    #[test]
    fn questions_are_answered_while_a_program_is_written() {
        let mut p = Programs::default();
        say(&mut p, "1EP").unwrap();
        assert_eq!(say(&mut p, "TB?"), Ok(Done::Other));
        assert_eq!(say(&mut p, "1MO"), Ok(Done::Quiet));
    }

    #[test]
    fn loops_end_even_when_they_say_no_number() {
        let lines = |text: &[&str]| text.iter().map(|t| (*t).to_owned()).collect::<Vec<_>>();
        let three = unrolled(&lines(&["1DL", "1PR1", "1JL2", "1ST"]), 1);
        assert_eq!(three, lines(&["1PR1", "1PR1", "1PR1", "1ST"]));
        assert_eq!(unrolled(&lines(&["1DL", "1PR1", "1JL"]), 1).len(), MOST_STEPS);
        assert!(unrolled(&lines(&["1DL", "1JL"]), 1).is_empty());
    }
}
