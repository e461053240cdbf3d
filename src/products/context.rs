//! What every product says about where it comes from: run, sample, instrument, bands, counts, uncertainty.

use crate::engine::bsdf::set::{BsdfSet, Quantity};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Provenance of the products of one run. Holds no clock: the same context gives the same bytes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ProductContext {
    /// Name of the run directory.
    pub run_id: String,
    /// Name of the scan.
    pub scan_name: String,
    /// What lay in the holder.
    pub sample: SampleHeader,
    /// Name of the instrument.
    pub instrument: String,
    /// Device and serial number, in the order to print.
    pub serials: Vec<(String, String)>,
    /// When the run began.
    pub started: Timestamp,
    /// When the last step was done; absent while steps are open.
    pub finished: Option<Timestamp>,
    /// The lamp, in words.
    pub lamp: String,
    /// Its hours at the beginning and the end of the run, in words; absent where they are not kept.
    pub lamp_hours: Option<String>,
    /// How the BSDF was normalised, in words (reference diffuser, or irradiance).
    pub normalisation: String,
    /// The bands that were measured.
    pub bands: Vec<BandRow>,
    /// Hash of the plan.
    pub plan_hash: String,
    /// Program, format or calibration, and its version.
    pub versions: Vec<(String, String)>,
    /// How many exposures were planned and what became of them.
    pub counts: Counts,
    /// What happened in the night: heading and words.
    pub night: Vec<(String, String)>,
    /// Numbers that the verdict is made from.
    pub checks: Checks,
    /// Uncertainty components.
    pub uncertainty: Vec<UncertaintyComponent>,
    /// Anything a reader must know.
    pub notes: Vec<String>,
}

/// Header data of the sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SampleHeader {
    /// Name in the exported files.
    pub name: String,
    /// Who makes it; `unknown` is written when empty.
    pub manufacturer: String,
    /// Thickness.
    pub thickness_mm: f64,
    /// Device type of the Klems file; `Other` when absent or not in its list.
    pub device_type: Option<String>,
}

/// One band of the filter wheel.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BandRow {
    /// Name, e.g. `f3`.
    pub name: String,
    /// Interval in nm.
    pub interval_nm: [f64; 2],
    /// The glass stack, in words.
    pub glasses: String,
    /// Camera that takes it.
    pub camera: String,
}

/// What became of the planned exposures.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    /// Exposures in the plan.
    pub planned: u64,
    /// Exposures stored under their label.
    pub stored: u64,
    /// Exposures listed as missing.
    pub missing: u64,
    /// Frames that the guard refused (retaken, or missing in the end).
    pub rejected: u64,
    /// Reasons of the missing ones with their numbers.
    pub missing_reasons: Vec<(String, u64)>,
}

/// Numbers that say whether the result can be trusted; absent = could not be checked.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Checks {
    /// Relative reciprocity error, weighted by projected solid angle.
    pub reciprocity: Option<f64>,
    /// Largest relative change between reference views of the same band.
    pub drift: Option<f64>,
    /// Largest share of a hemispherical value that light below the instrument's floor may be, relative (k = 2).
    pub below_floor: Option<f64>,
    /// Days by which the oldest calibration in use is past its validity; 0 or less = valid.
    pub calibration_overdue_days: Option<i64>,
}

/// One line of the uncertainty budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct UncertaintyComponent {
    /// What it comes from.
    pub name: String,
    /// Relative standard uncertainty (k = 1) of a hemispherical value, typical of this run.
    pub relative: f64,
    /// True where the error is common to all patches.
    pub correlated: bool,
    /// Where the number comes from.
    pub source: String,
}

// === impl ProductContext ===

impl ProductContext {
    /// The k = 2 summary that goes where a format has no slot for uncertainty: the normal-most incidence of each side
    /// for Visible and Solar, in one line.
    pub fn uncertainty_summary(&self, set: &BsdfSet) -> String {
        let mut parts = Vec::new();
        for (q, quantity) in set.quantities.iter().enumerate() {
            if !matches!(quantity, Quantity::Visible | Quantity::Solar { .. }) {
                continue;
            }
            for side in crate::engine::optics::side::Side::ALL {
                let of_side = set.columns.iter().filter(|c| c.side == side && c.quantity == q);
                if let Some(c) = of_side.min_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta)) {
                    let (theta, phi) = c.incident.degrees();
                    parts.push(format!(
                        "{} {} at source ({theta:.0}, {phi:.0}): {:.4} +- {:.4}",
                        quantity.name(),
                        side_words(side),
                        c.hemispherical,
                        2.0 * c.hemispherical_u
                    ));
                }
            }
        }
        if parts.is_empty() {
            "k=2 uncertainty: no Visible or Solar column measured".to_owned()
        } else {
            format!("k=2 uncertainty of hemispherical values: {}", parts.join("; "))
        }
    }
}

/// Name of a side as the Klems file writes it (Front = exterior).
pub fn side_words(side: crate::engine::optics::side::Side) -> &'static str {
    use crate::engine::optics::side::Side;
    match side {
        Side::TransmissionFront => "Transmission Front",
        Side::ReflectionFront => "Reflection Front",
        Side::TransmissionBack => "Transmission Back",
        Side::ReflectionBack => "Reflection Back",
    }
}

/// Synthetic results for the tests of this wing.
#[cfg(test)]
pub mod synthetic;
