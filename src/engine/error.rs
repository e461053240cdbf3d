//! What the engine refuses to compute, in one sentence each.

use std::fmt;

/// A request the engine cannot answer; the text says what, where and what is allowed.
#[derive(Debug, Clone, PartialEq)]
pub enum EngineError {
    /// A picture or map has another number of pixels than the geometry.
    FrameSize {
        /// What was handed in.
        what: &'static str,
        /// Pixels the geometry has.
        expected: usize,
        /// Pixels handed in.
        got: usize,
    },
    /// A bracket without any exposure.
    EmptyBracket,
    /// An integration time that is not positive and finite.
    IntegrationTime {
        /// The time in seconds.
        t_s: f64,
    },
    /// A number outside what the physics allows.
    Parameter {
        /// Name of the number.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// A tabulated curve that is empty, not ascending or not finite.
    Curve {
        /// Index of the first bad row.
        row: usize,
        /// What is wrong.
        reason: &'static str,
    },
    /// Two lists that belong together have different lengths.
    Length {
        /// What was handed in.
        what: &'static str,
        /// Entries needed.
        expected: usize,
        /// Entries handed in.
        got: usize,
    },
    /// Nothing to combine, or a kernel without any sensitivity.
    NoSignal {
        /// What is empty.
        what: &'static str,
    },
}

// === impl EngineError ===

impl fmt::Display for EngineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            EngineError::FrameSize { what, expected, got } => {
                write!(f, "{what} has {got} pixels but the geometry has {expected}; use the calibration of this camera")
            }
            EngineError::EmptyBracket => write!(f, "the bracket has no exposure; at least one frame is needed"),
            EngineError::IntegrationTime { t_s } => {
                write!(f, "integration time {t_s} s is not allowed; it must be positive and finite")
            }
            EngineError::Parameter { name, value, allowed } => {
                write!(f, "{name} = {value} is not allowed; {allowed}")
            }
            EngineError::Curve { row, reason } => write!(f, "row {row} of the spectral curve {reason}; mend the table"),
            EngineError::Length { what, expected, got } => {
                write!(f, "{what} has {got} entries but {expected} are needed")
            }
            EngineError::NoSignal { what } => write!(f, "{what} is empty or zero everywhere; nothing can be computed"),
        }
    }
}

impl std::error::Error for EngineError {}
