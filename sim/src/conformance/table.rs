//! The suite's outcome as text: device by check, with the reason of each check that does not apply.

use super::Conduct;
use goniod_drivers::conformance::{Check, Verdict};
use std::collections::BTreeMap;
use std::fmt::Write;

/// One line a check, one column a driver: `+` passed, a letter for a reason below, `FAIL`.
pub fn markdown(checks: &[Check], conducts: &[Conduct]) -> String {
    let mut reasons: BTreeMap<String, char> = BTreeMap::new();
    let mut text = String::from("| check |");
    for conduct in conducts {
        let _ = write!(text, " {} |", conduct.driver);
    }
    text.push_str("\n|---|");
    conducts.iter().for_each(|_| text.push_str(":-:|"));
    for check in checks {
        let _ = write!(text, "\n| {} |", check.name);
        for conduct in conducts {
            let verdict = conduct.findings.iter().find(|f| f.check.name == check.name).map(|f| &f.verdict);
            let mark = match verdict {
                Some(Verdict::Passed(_)) => "+".to_owned(),
                Some(Verdict::NotApplicable(why)) => {
                    let next = char::from(b'a' + u8::try_from(reasons.len()).unwrap_or(0) % 26);
                    reasons.entry(why.clone()).or_insert(next).to_string()
                }
                Some(Verdict::Failed(_)) => "FAIL".to_owned(),
                None => "not tried".to_owned(),
            };
            let _ = write!(text, " {mark} |");
        }
    }
    text.push_str("\n\n`+` passed. Does not apply:\n");
    let mut told: Vec<(&char, &String)> = reasons.iter().map(|(why, letter)| (letter, why)).collect();
    told.sort();
    for (letter, why) in told {
        let _ = write!(text, "\n- {letter}: {why}");
    }
    text.push_str("\n\n| check | what holds |\n|---|---|\n");
    for check in checks {
        let _ = writeln!(text, "| {} | {} |", check.name, check.promise);
    }
    text
}
