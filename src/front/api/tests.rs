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

/// Kinds of events that a source file names in its `kind` function.
fn kinds(source: &str) -> BTreeSet<String> {
    let body = source.split("pub fn kind(&self)").nth(1).unwrap();
    let body = body.split("\n    }\n").next().unwrap();
    let kinds: BTreeSet<String> =
        body.split("=> \"").skip(1).filter_map(|s| s.split('"').next().map(str::to_owned)).collect();
    assert!(kinds.len() >= 6, "{kinds:?}");
    kinds
}

/// The live page listens to every kind of event but those that tell progress, which it asks for.
#[test]
fn the_live_page_listens_to_every_kind_of_event() {
    let page = include_str!("page.html");
    let list = page.split("const kinds = [").nth(1).unwrap().split("];").next().unwrap();
    let asked = ["step-started", "progress", "frame-stored"];
    let sources = [include_str!("../../control/events.rs"), include_str!("../daemon/hub.rs")];
    for kind in sources.iter().flat_map(|source| kinds(source)).filter(|kind| !asked.contains(&kind.as_str())) {
        assert!(list.contains(&format!("\"{kind}\"")), "{kind} is not shown");
    }
}
