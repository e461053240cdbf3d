//! Where light goes: directions, angle bases and patches, fisheye, hemi-ellipsoid map.

pub mod basis;
pub mod direction;
pub mod ellipsoid;
pub mod fisheye;
pub mod pixel_map;
pub mod side;
mod split;
