//! The manual of the API against the table of routes and the verbs.
#![allow(clippy::unwrap_used)]

use super::routes::ROUTES;
use super::verbs::VERBS;
use std::collections::BTreeSet;

const PAGE: &str = include_str!("../../../docs/api.md");

#[test]
fn the_page_tells_every_route_and_no_other() {
    let rows = PAGE.lines().filter(|line| ["| GET |", "| POST |", "| DELETE |"].iter().any(|m| line.starts_with(m)));
    let told: BTreeSet<String> = rows
        .map(|row| {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            assert!(!cells[3].is_empty(), "{row}");
            format!("{} {}", cells[1], cells[2].trim_matches('`'))
        })
        .collect();
    let known: BTreeSet<String> = ROUTES.iter().map(|r| format!("{} {}", r.method, r.path)).collect();
    assert_eq!(told, known);
}

#[test]
fn the_page_tells_every_verb() {
    let row = PAGE.lines().find(|line| line.contains("/v1/verbs/{verb}")).unwrap();
    for (name, _) in VERBS {
        assert!(row.contains(&format!("`{name}`")), "{name}");
    }
}
