//! Promise: a new device is one driver file, one line of the table and one twin. The files of `docs/adding-a-device.md`,
//! compiled where the document puts them and driven against each other through the ordinary contract.
#![allow(clippy::unwrap_used, clippy::expect_used)]

// The names that driver and twin find in the crates they are written for.
use goniod_drivers::{clock, contract, error, transport, units};

/// `drivers/src/devices/` with the new driver in it.
mod devices {
    pub use goniod_drivers::devices::WheelConfig;
    pub mod halden_cw6;
    #[allow(dead_code)]
    #[path = "../../../../drivers/src/devices/line_wire.rs"]
    mod line_wire;

    pub use halden_cw6::HaldenCw6;
}

/// `sim/src/firmware/` with the new twin in it.
mod firmware {
    pub use goniod_sim::firmware::{Firmware, motion, outbox};
    pub mod halden_cw6;
}

mod wheel;

use devices::{HaldenCw6, halden_cw6};
use goniod_drivers::table::{Driver, Make};
use std::path::Path;

/// The table with the new line.
#[rustfmt::skip]
pub const DRIVERS: &[Driver] = &[
    Driver { name: "halden-cw6", devices: "Halden CW6 filter wheels", baud: halden_cw6::BAUD, make: Make::FilterWheel(|c, w, k| Box::new(HaldenCw6::new(c, w, k))) },
];

fn read(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The Rust blocks of a document, each with the last word in backticks before it: where it belongs.
fn blocks(document: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut rest = document;
    while let Some((before, after)) = rest.split_once("```rust\n") {
        let (block, tail) = after.split_once("```").expect("a block that ends");
        let place = before.rsplit('`').nth(1).expect("a path before the block");
        found.push((place.to_owned(), block.to_owned()));
        rest = tail;
    }
    found
}

#[test]
fn the_document_shows_what_is_compiled_here() {
    let here = "sim/tests/adding_a_device";
    let found = blocks(&read("docs/adding-a-device.md"));
    let files = [
        ("drivers/src/devices/halden_cw6.rs", format!("{here}/devices/halden_cw6.rs")),
        ("sim/src/firmware/halden_cw6.rs", format!("{here}/firmware/halden_cw6.rs")),
    ];
    for (place, file) in &files {
        let shown = found.iter().find(|(p, _)| p == place).unwrap_or_else(|| panic!("the document lacks {place}"));
        assert!(shown.1 == read(file), "the block of {place} is not {file}");
    }
    let line = found.iter().find(|(place, _)| place == "drivers/src/table.rs").expect("the line of the table");
    assert!(read(&format!("{here}/main.rs")).contains(line.1.trim()), "the line of the table is not that of main.rs");
    assert_eq!(found.len(), files.len() + 1, "every block is compiled: {:?}", found.iter().map(|f| &f.0));
}

/// The shared lists that the document names are where and what it says.
#[test]
fn the_places_to_write_to_are_there() {
    for (file, words) in [
        ("drivers/src/table.rs", "pub const DRIVERS: &[Driver]"),
        ("drivers/src/devices/mod.rs", "pub mod optec_ifw;"),
        ("sim/src/firmware/mod.rs", "pub mod ifw;"),
        ("sim/src/firmware/models.rs", "pub enum WheelTwin"),
        ("sim/src/twins.rs", "pub const DRIVERS"),
        ("tests/other_devices.rs", "optec-ifw"),
    ] {
        assert!(read(file).contains(words), "{file} lacks {words:?}");
        assert!(read("docs/adding-a-device.md").contains(file), "the document does not name {file}");
    }
}
