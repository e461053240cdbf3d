//! Pictures: one hemisphere, all hemispheres on one sheet, the spectrum. PNG, fonts bundled, the same bytes each time.
//!
//! Emergent azimuths are drawn as the files tell them: x to the right, y up, as seen from the interior, on all sides.

pub mod canvas;
pub mod colour;
pub mod hemisphere;
pub mod overview;
pub mod spectrum;

use thiserror::Error;

/// Why a plot was not made.
#[derive(Debug, Error)]
pub enum PlotError {
    /// There is nothing to draw.
    #[error("nothing to plot: {0}")]
    Empty(String),
    /// The drawing library refused.
    #[error("cannot draw the plot: {0}")]
    Drawing(String),
    /// The file could not be written.
    #[error(transparent)]
    File(#[from] crate::products::export::ExportError),
}
