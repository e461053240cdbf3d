//! The bench's true pose: what a photograph taken in it really sees.

/// True state of everything that moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Tilt angle as the axis stands (axis angle, before any zero offset).
    pub tilt_deg: f64,
    /// Spin axis angle.
    pub spin_deg: f64,
    /// Changer axis angle; 0 where the bench has none.
    pub changer_deg: f64,
    /// Wheel place in the beam; `None` while the wheel turns.
    pub slot: Option<u8>,
    /// Light passes the shutter.
    pub shutter_open: bool,
}
