//! What people take away: the BSDF in the formats other tools read, plots, and a report that says whether to trust it.
//!
//! [`reduce`] makes the BSDF from a run; [`make`] writes its products; [`context`] is what a product says about its run, [`night`] what happened in it; [`export`] one file a format; [`plots`] the pictures;
//! [`report`] the page with the verdict first. All are pure functions of the result and the context: the same
//! input gives the same bytes.

pub mod context;
pub mod error;
pub mod export;
mod facts;
pub mod make;
mod markup;
pub mod night;
pub mod plots;
pub mod reduce;
pub mod report;
