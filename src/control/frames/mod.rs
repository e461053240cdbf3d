//! Frames: what a picture shows at a glance, what its bracket predicts, the guard, and how a good one is taken.

pub mod acquire;
pub mod bracket;
pub mod guard;
pub mod picture;
