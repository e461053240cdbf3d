//! A picture with what the camera says about it, and the bounded pool its pixels come from.

use crate::clock::UtcMicros;
use crate::contract::CameraSettings;
use std::sync::{Arc, Mutex};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// How the sensor's values lie in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PixelFormat {
    /// Red-green / green-blue mosaic, 8 bit a pixel.
    BayerRggb8,
    /// One value a pixel, 8 bit.
    Mono8,
    /// One value a pixel, 10 bit in little-endian 16-bit words.
    Mono10,
    /// One value a pixel, 12 bit in little-endian 16-bit words.
    Mono12,
    /// One value a pixel, 14 bit in little-endian 16-bit words.
    Mono14,
    /// One value a pixel, 16-bit little-endian words.
    Mono16,
    /// Green-red / blue-green mosaic, 8 bit a pixel.
    BayerGrbg8,
    /// Green-blue / red-green mosaic, 8 bit a pixel.
    BayerGbrg8,
    /// Blue-green / green-red mosaic, 8 bit a pixel.
    BayerBggr8,
    /// Red-green / green-blue mosaic, 10 bit in little-endian 16-bit words.
    BayerRggb10,
    /// Green-red / blue-green mosaic, 10 bit in words.
    BayerGrbg10,
    /// Green-blue / red-green mosaic, 10 bit in words.
    BayerGbrg10,
    /// Blue-green / green-red mosaic, 10 bit in words.
    BayerBggr10,
    /// Red-green / green-blue mosaic, 12 bit in little-endian 16-bit words.
    BayerRggb12,
    /// Green-red / blue-green mosaic, 12 bit in words.
    BayerGrbg12,
    /// Green-blue / red-green mosaic, 12 bit in words.
    BayerGbrg12,
    /// Blue-green / green-red mosaic, 12 bit in words.
    BayerBggr12,
    /// Red-green / green-blue mosaic, 16-bit little-endian words.
    BayerRggb16,
    /// Green-red / blue-green mosaic, 16-bit words.
    BayerGrbg16,
    /// Green-blue / red-green mosaic, 16-bit words.
    BayerGbrg16,
    /// Blue-green / green-red mosaic, 16-bit words.
    BayerBggr16,
    /// Three values a pixel (red, green, blue), 8 bit each, already demosaiced by the camera.
    Rgb8,
    /// Luma and shared chroma, two values a pixel: not linear in light, last resort.
    Yuyv8,
    /// Sums of consecutive exposures of equal time in 16-bit words. `settings.exposure` is the whole time; each
    /// of the `exposures` took its share, and value / levels is the mean NDL of one of them.
    Summed {
        /// Mosaic of the summed frames; `None` for one value a pixel.
        mosaic: Option<BayerOrder>,
        /// Bits of one summed frame.
        bits: u8,
        /// Number of frames in the sum.
        exposures: u16,
    },
}

/// Colours of a mosaic's first two rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BayerOrder {
    /// Red-green / green-blue.
    Rggb,
    /// Green-red / blue-green.
    Grbg,
    /// Green-blue / red-green.
    Gbrg,
    /// Blue-green / green-red.
    Bggr,
}

/// Pixel values, row by row; the variant follows the format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pixels {
    /// One byte a pixel.
    U8(Vec<u8>),
    /// One 16-bit word a pixel.
    U16(Vec<u16>),
}

/// What a camera says about one picture.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameInfo {
    /// Serial number of the camera that took it.
    pub camera_serial: String,
    /// The device's own frame counter; a step of more than one means lost frames.
    pub device_frame_id: u64,
    /// Monotonic instant at which the exposure started, as well as the device can tell.
    pub exposure_start: tokio::time::Instant,
    /// Monotonic instant at which the frame reached the host.
    pub received: tokio::time::Instant,
    /// Wall time of `exposure_start`.
    pub utc: UtcMicros,
    /// The settings in force, as read back or as the frame's own metadata tells.
    pub settings: CameraSettings,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Format of the pixels.
    pub format: PixelFormat,
    /// The device flagged the buffer as damaged or short.
    pub damaged: bool,
}

/// One picture. Dropping it gives its buffer back to the pool.
#[derive(Debug)]
pub struct Frame {
    /// What the camera says about it.
    pub info: FrameInfo,
    /// The pixels, row by row.
    pub pixels: Pixels,
    _slot: Option<OwnedSemaphorePermit>,
    home: Option<Arc<Mutex<Vec<Pixels>>>>,
}

/// A bounded store of pixel buffers: a camera that finds it empty waits, it never allocates more.
#[derive(Debug, Clone)]
pub struct FramePool {
    permits: Arc<Semaphore>,
    free: Arc<Mutex<Vec<Pixels>>>,
}

// === impl PixelFormat ===

impl PixelFormat {
    /// Number of digital levels the format can carry: 2^bits, times the number of frames for a sum.
    pub fn levels(self) -> u32 {
        (1 << u32::from(self.bits())) * self.exposures()
    }

    /// Bits of one value as the sensor gave it.
    pub fn bits(self) -> u8 {
        use PixelFormat::*;
        match self {
            BayerRggb8 | BayerGrbg8 | BayerGbrg8 | BayerBggr8 | Mono8 | Rgb8 | Yuyv8 => 8,
            BayerRggb10 | BayerGrbg10 | BayerGbrg10 | BayerBggr10 | Mono10 => 10,
            BayerRggb12 | BayerGrbg12 | BayerGbrg12 | BayerBggr12 | Mono12 => 12,
            Mono14 => 14,
            BayerRggb16 | BayerGrbg16 | BayerGbrg16 | BayerBggr16 | Mono16 => 16,
            Summed { bits, .. } => bits,
        }
    }

    /// Order of the colour mosaic; `None` for mono, RGB and YUYV.
    pub fn mosaic(self) -> Option<BayerOrder> {
        use PixelFormat::*;
        match self {
            BayerRggb8 | BayerRggb10 | BayerRggb12 | BayerRggb16 => Some(BayerOrder::Rggb),
            BayerGrbg8 | BayerGrbg10 | BayerGrbg12 | BayerGrbg16 => Some(BayerOrder::Grbg),
            BayerGbrg8 | BayerGbrg10 | BayerGbrg12 | BayerGbrg16 => Some(BayerOrder::Gbrg),
            BayerBggr8 | BayerBggr10 | BayerBggr12 | BayerBggr16 => Some(BayerOrder::Bggr),
            Summed { mosaic, .. } => mosaic,
            _ => None,
        }
    }

    /// Values a pixel: 3 for RGB, 2 for YUYV, else 1.
    pub fn values_per_pixel(self) -> usize {
        match self {
            PixelFormat::Rgb8 => 3,
            PixelFormat::Yuyv8 => 2,
            _ => 1,
        }
    }

    /// Exposures in one frame: more than one for a sum.
    pub fn exposures(self) -> u32 {
        match self {
            PixelFormat::Summed { exposures, .. } => u32::from(exposures),
            _ => 1,
        }
    }

    /// What must be said beside every product made from this format; `None` for values linear in the sensor's levels.
    pub fn caution(self) -> Option<&'static str> {
        match self {
            PixelFormat::Yuyv8 => {
                Some("YUYV: chroma shared between two pixels and not linear, radiance from it is an estimate")
            }
            PixelFormat::Rgb8 => Some("RGB: demosaiced by the camera, neighbouring pixels are not independent"),
            _ => None,
        }
    }
}

// === impl Pixels ===

impl Pixels {
    /// Number of pixels.
    pub fn len(&self) -> usize {
        match self {
            Pixels::U8(v) => v.len(),
            Pixels::U16(v) => v.len(),
        }
    }

    /// True without pixels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The value of pixel `i` as a digital level.
    pub fn level(&self, i: usize) -> u16 {
        match self {
            Pixels::U8(v) => u16::from(v[i]),
            Pixels::U16(v) => v[i],
        }
    }
}

// === impl FramePool ===

impl FramePool {
    /// A pool that lets at most `capacity` frames live at once.
    pub fn new(capacity: usize) -> FramePool {
        FramePool { permits: Arc::new(Semaphore::new(capacity)), free: Arc::default() }
    }

    /// Waits for a free place and gives a buffer: a used one (contents arbitrary) or an empty vector.
    pub async fn take(&self) -> (Option<Pixels>, Option<OwnedSemaphorePermit>) {
        let permit = Arc::clone(&self.permits).acquire_owned().await.ok();
        let buffer = self.free.lock().ok().and_then(|mut free| free.pop());
        (buffer, permit)
    }

    /// A free place without waiting, as [`FramePool::take`]; `None` when all are in use.
    pub fn try_take(&self) -> Option<(Option<Pixels>, OwnedSemaphorePermit)> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok()?;
        let buffer = self.free.lock().ok().and_then(|mut free| free.pop());
        Some((buffer, permit))
    }

    /// A frame whose buffer returns to this pool when it is dropped.
    pub fn frame(&self, info: FrameInfo, pixels: Pixels, permit: Option<OwnedSemaphorePermit>) -> Frame {
        Frame { info, pixels, _slot: permit, home: Some(Arc::clone(&self.free)) }
    }

    /// Places free now.
    pub fn available(&self) -> usize {
        self.permits.available_permits()
    }
}

// === impl Frame ===

impl Frame {
    /// A frame outside any pool (tests and offline readers).
    pub fn detached(info: FrameInfo, pixels: Pixels) -> Frame {
        Frame { info, pixels, _slot: None, home: None }
    }
}

impl Drop for Frame {
    fn drop(&mut self) {
        if let Some(home) = &self.home
            && let Ok(mut free) = home.lock()
        {
            free.push(std::mem::replace(&mut self.pixels, Pixels::U8(Vec::new())));
        }
    }
}
