//! The plan's hash: SHA-256 over a canonical text of its views and steps.

use super::build::PlanError;
use super::{Plan, Step, View};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::fmt::Write;

/// Changes with the canonical text, so that hashes of different rules never meet.
const RULES: &str = "goniod plan 1\n";

/// What is hashed; the forecast is not part of it, it may be improved without making another plan.
#[derive(Serialize)]
struct Canonical<'a> {
    views: &'a [View],
    steps: &'a [Step],
}

/// SHA-256, hexadecimal, over one line of rules and the compact JSON of views and steps (fields in the order of the
/// structs, numbers in their shortest decimal form).
///
/// # Errors
/// A number that has no text (not finite).
pub fn hash(views: &[View], steps: &[Step]) -> Result<String, PlanError> {
    let finite = |v: &View| [v.tilt_deg, v.spin_deg, v.changer_deg.unwrap_or(0.0)].iter().all(|a| a.is_finite());
    if let Some(view) = views.iter().find(|v| !finite(v)) {
        return Err(PlanError::NotWritable { reason: format!("view {} has an angle that is no number", view.id) });
    }
    let text = serde_json::to_string(&Canonical { views, steps })
        .map_err(|e| PlanError::NotWritable { reason: e.to_string() })?;
    let mut digest = Sha256::new();
    digest.update(RULES);
    digest.update(text);
    let mut hex = String::with_capacity(64);
    for byte in digest.finalize() {
        // Writing into a String cannot fail.
        let _ = write!(hex, "{byte:02x}");
    }
    Ok(hex)
}

// === impl Plan ===

impl Plan {
    /// True where the hash is that of the views and steps.
    pub fn is_whole(&self) -> bool {
        hash(&self.views, &self.steps).is_ok_and(|h| h == self.hash)
    }

    /// The plan as TOML text.
    ///
    /// # Errors
    /// A value that TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, PlanError> {
        toml::to_string(self).map_err(|e| PlanError::NotWritable { reason: e.to_string() })
    }

    /// Reads what [`Plan::to_toml`] wrote and compares the hash.
    ///
    /// # Errors
    /// Text that is no plan, or a plan that was changed.
    pub fn from_toml(text: &str) -> Result<Plan, PlanError> {
        let plan: Plan = toml::from_str(text).map_err(|e| PlanError::NotReadable { reason: e.to_string() })?;
        if plan.is_whole() {
            Ok(plan)
        } else {
            Err(PlanError::NotReadable { reason: "its hash does not fit its views and steps: it was changed".into() })
        }
    }
}
