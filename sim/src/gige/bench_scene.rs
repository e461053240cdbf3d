//! The simulated bench before a GigE Vision twin: the picture of the true pose during the exposure that the sensor really
//! made, with the truth painted into the reserved rows, as the in-process camera paints it.

use crate::bench::Surroundings;
use crate::camera::Look;
use crate::scene::{ExposureRequest, Scene};
use crate::truth::photo::Photographer;
use goniod_drivers::frame::Pixels;
use goniod_drivers::units::ExposureTime;
use std::sync::Arc;

/// Noise of its own: the in-process camera of the same seed and the same frame number draws another.
const NOISE: u64 = 1 << 40;

/// What one camera of the bench sees.
pub struct BenchScene {
    name: String,
    photographer: Arc<Photographer>,
    surroundings: Surroundings,
}

// === impl BenchScene ===

impl BenchScene {
    /// The scene of camera `name`; its optics are traced now, so that no first frame is late.
    pub fn new(name: &str, photographer: Arc<Photographer>, surroundings: Surroundings) -> BenchScene {
        photographer.raster();
        BenchScene { name: name.to_owned(), photographer, surroundings }
    }
}

impl Scene for BenchScene {
    /// Levels are scaled to those of the pixel format in force; a size that is not the camera's gives a black picture.
    fn render(&self, request: &ExposureRequest, out: &mut [u16]) {
        let file = &self.photographer.file;
        if (request.width, request.height) != (file.width_px, file.height_px) {
            out.fill(0);
            return;
        }
        let look = Look { photographer: &self.photographer, surroundings: &self.surroundings, name: &self.name };
        let exposure = ExposureTime(request.exposure_us.round() as u64);
        // Painted is what the host counts, which begins anew with each host; the noise never comes again.
        let noise = request.frame_number + NOISE;
        let pixels = look.picture(request.started, exposure, [request.host_count, noise], None);
        let (from, to) = (file.levels(), u32::from(request.max_level) + 1);
        let scaled = |level: u16| (u64::from(level) * u64::from(to) / u64::from(from)) as u16;
        match pixels {
            Pixels::U8(v) => out.iter_mut().zip(v).for_each(|(o, level)| *o = scaled(u16::from(level))),
            Pixels::U16(v) => out.iter_mut().zip(v).for_each(|(o, level)| *o = scaled(level)),
        }
    }
}
