//! The bench's true pose at an instant: what a photograph taken then really sees.

use tokio::time::Instant;

pub use crate::truth::pose::Pose;

/// Anything that knows the true pose, past or present (the firmware twins together).
pub trait PoseSource: Send + Sync {
    /// The pose at `at`, which is not later than now.
    fn pose(&self, at: Instant) -> Pose;
}
