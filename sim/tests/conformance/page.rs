//! `docs/devices.md`: its tables are made from the driver table, the facts and the suite, between two markers.

use goniod_drivers::conformance::{Check, facts};
use goniod_drivers::table::DRIVERS;
use goniod_sim::conformance::{Conduct, table};
use std::fmt::Write;

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/devices.md");
const BEGIN: &str = "<!-- generated: begin -->\n";
const END: &str = "<!-- generated: end -->\n";

/// Writes the page where that is asked for, compares it else.
pub fn compare(checks: &[Check], conducts: &[Conduct]) {
    if !conducts.iter().any(|conduct| conduct.driver == "aravis") {
        println!("*** SKIPPED: docs/devices.md is not compared, this build lacks the feature `aravis` ***");
        return;
    }
    let page = std::fs::read_to_string(PAGE).expect("docs/devices.md is there");
    let (head, rest) = page.split_once(BEGIN).expect("the page has its first marker");
    let (is, tail) = rest.split_once(END).expect("the page has its second marker");
    let made = format!("\n{}\n{}\n", table::markdown(checks, conducts), known(conducts));
    if std::env::var_os("GONIOD_WRITE_DOCS").is_some_and(|v| v == "1") {
        std::fs::write(PAGE, format!("{head}{BEGIN}{made}{END}{tail}")).expect("the page can be written");
        return;
    }
    let differs = is.lines().zip(made.lines()).find(|(a, b)| a != b);
    assert!(
        is == made,
        "docs/devices.md is not what the suite found ({differs:?}); write it again with GONIOD_WRITE_DOCS=1"
    );
}

/// What is known of each driver.
fn known(conducts: &[Conduct]) -> String {
    let mut text = String::new();
    for conduct in conducts {
        let facts = facts::of(conduct.driver).expect("every driver has its facts");
        let of_another_build = "cameras behind any V4L2 node";
        let devices = DRIVERS.iter().find(|d| d.name == conduct.driver).map_or(of_another_build, |d| d.devices);
        let _ = writeln!(text, "## {}\n\n{devices}.\n", conduct.driver);
        for (what, is) in [
            ("wire", facts.wire),
            ("source", facts.source),
            ("assumed", facts.assumed),
            ("a power cycle shows by", facts.power_cycle),
            ("never sent", facts.never_sent),
        ] {
            let _ = writeln!(text, "- {what}: {is}");
        }
        text.push('\n');
    }
    text
}
