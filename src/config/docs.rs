//! The page that tells every key, held against the structs.
#![allow(clippy::unwrap_used)]

use super::calibration::CameraCalibration;
use super::instrument::Instrument;
use super::scan::Scan;
use super::schema::{Schema, of};
use std::collections::BTreeMap;

const PAGE: &str = include_str!("../../docs/config.md");

/// Keys of one section of the page, with whether they are needed.
fn told(section: &str) -> BTreeMap<String, bool> {
    let body = PAGE.split("\n## ").find_map(|part| part.strip_prefix(section)).unwrap();
    let rows = body.lines().filter_map(|line| line.strip_prefix("| `"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split(" | ").collect();
        assert!(cells.len() == 5 && !cells[4].trim_matches([' ', '|']).is_empty(), "{row}");
        (cells[0].trim_end_matches('`').to_owned(), cells[1] == "needed")
    })
    .collect()
}

/// Keys of the structs; items of a list are told with the list, names of a map are needed by nobody.
fn known(schema: Schema) -> BTreeMap<String, bool> {
    let keys = schema.into_iter().filter(|(path, _)| !path.is_empty() && !path.ends_with("[]"));
    keys.map(|(path, key)| {
        let needed = key.required || path.ends_with('*');
        (path, needed)
    })
    .collect()
}

#[test]
fn the_page_tells_every_key_and_no_other() {
    assert_eq!(told("scan\n"), known(of::<Scan>()));
    assert_eq!(told("instrument\n"), known(of::<Instrument>()));
    assert_eq!(told("calibration\n"), known(of::<CameraCalibration>()));
}
