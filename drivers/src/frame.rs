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
    /// Number of digital levels the format can carry (2^bits).
    pub fn levels(self) -> u32 {
        match self {
            PixelFormat::BayerRggb8 | PixelFormat::Mono8 => 1 << 8,
            PixelFormat::Mono10 => 1 << 10,
            PixelFormat::Mono12 => 1 << 12,
            PixelFormat::Mono14 => 1 << 14,
            PixelFormat::Mono16 => 1 << 16,
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

    /// A free place at once, or `None`: for threads that must not wait.
    pub fn try_take(&self) -> Option<(Option<Pixels>, OwnedSemaphorePermit)> {
        let permit = Arc::clone(&self.permits).try_acquire_owned().ok()?;
        Some((self.free.lock().ok().and_then(|mut free| free.pop()), permit))
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
