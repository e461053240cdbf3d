//! What `goniod device` answers, as text and as JSON.

use crate::front::bench::by_hand::Entry;
use goniod_drivers::contract::{Health, Identity};
use serde::Serialize;
use std::collections::BTreeMap;

/// One device that was opened.
#[derive(Debug, Serialize)]
pub struct Report {
    /// Its name.
    pub name: String,
    driver: String,
    port: String,
    identity: Identity,
    /// How it is, where that was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub health: Option<Health>,
    /// Where it stands, or `unknown`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub state: Option<String>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    reading: BTreeMap<&'static str, f64>,
    /// What the operator should know besides.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// One line of the list.
#[derive(Debug, Serialize)]
pub struct Listed {
    name: String,
    driver: String,
    port: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    identity: Option<Identity>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

/// All devices.
#[derive(Debug, Serialize)]
pub struct List {
    /// In the order a run opens them.
    pub devices: Vec<Listed>,
}

// === impl Report ===

impl Report {
    /// A device that said who it is.
    pub fn new(entry: &Entry, identity: Identity) -> Report {
        Report {
            name: entry.name.clone(),
            driver: entry.driver.clone(),
            port: entry.port.clone(),
            identity,
            health: None,
            state: None,
            reading: BTreeMap::new(),
            notes: Vec::new(),
        }
    }

    /// Adds a value; the unit stands in its name.
    pub fn reading(&mut self, name: &'static str, value: f64) {
        self.reading.insert(name, value);
    }

    /// For people.
    pub fn text(&self) -> String {
        let mut lines = vec![format!("{}  {}  {}  {}", self.name, self.driver, self.port, who(&self.identity))];
        lines.extend(self.state.iter().map(|state| format!("  state        {state}")));
        if let Some(health) = &self.health {
            let well = if health.warnings.is_empty() { "well".to_owned() } else { health.warnings.join("; ") };
            lines.push(format!("  health       {well}"));
            lines.extend(health.temperature_c.map(|t| format!("  temperature  {t} °C")));
        }
        lines.extend(self.reading.iter().map(|(name, value)| format!("  {name:<17} {}", number(*value))));
        lines.extend(self.notes.iter().map(|note| format!("  note: {note}")));
        lines.join("\n")
    }
}

// === impl Listed ===

impl Listed {
    /// A device and who it is, or why it cannot be opened.
    pub fn new(entry: Entry, opened: Result<Identity, String>) -> Listed {
        let (identity, error) = match opened {
            Ok(identity) => (Some(identity), None),
            Err(error) => (None, Some(error)),
        };
        Listed { name: entry.name, driver: entry.driver, port: entry.port, identity, error }
    }

    /// It could be opened.
    pub fn is_there(&self) -> bool {
        self.error.is_none()
    }
}

// === impl List ===

impl List {
    /// For people.
    pub fn text(&self) -> String {
        let line = |d: &Listed| {
            let said = d.identity.as_ref().map(who).or_else(|| d.error.as_ref().map(|e| format!("NOT THERE: {e}")));
            format!("{:<14} {:<16} {:<20} {}", d.name, d.driver, d.port, said.unwrap_or_default())
        };
        self.devices.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

fn who(identity: &Identity) -> String {
    let mut text = identity.model.clone();
    if !identity.firmware.is_empty() {
        text.push_str(&format!(", firmware {}", identity.firmware));
    }
    if !identity.serial.is_empty() {
        text.push_str(&format!(", serial number {}", identity.serial));
    }
    text
}

fn number(value: f64) -> String {
    if value != 0.0 && value.abs() < 1e-3 { format!("{value:e}") } else { value.to_string() }
}
