//! Where a camera's frames come in: one stream with its buffers, for one run of acquisition.
//!
//! A run has a socket of its own. The library tells blocks apart by numbers that begin at 1 with each run, so a late packet
//! of the run before would be taken into a frame of this one; on a port that is closed nobody takes it.

use super::features::Features;
use super::options::AravisOptions;
use crate::error::{ErrorKind, Result};
use aravis::glib;
use aravis::glib::SignalHandlerId;
use aravis::glib::object::{Cast, IsA, ObjectExt};
use aravis::prelude::*;
use aravis::{Buffer, Camera, GvStream, GvStreamPacketResend, GvStreamSocketBuffer, Stream};
use std::sync::Arc;
use std::time::Duration;

/// What is called, on a thread of the library, when a buffer has been filled.
pub type Filled = Arc<dyn Fn() + Send + Sync>;

/// How often and how long an emission under way is waited for.
const EMISSION_TRIES: u32 = 2_000;
const EMISSION_PAUSE: Duration = Duration::from_millis(1);

/// An open stream.
pub struct Reception {
    stream: Stream,
    signal: SignalHandlerId,
    holds: u32,
}

/// What a stream has counted.
#[derive(Debug, Clone, Copy, Default)]
pub struct LinkCounts {
    /// Packets asked for again.
    pub resent_packets: u64,
    /// Packets that never came.
    pub missing_packets: u64,
    /// Frames the library had no buffer for.
    pub underruns: u64,
}

/// Waits until no signal of `object` is in emission: one holds it beyond `holds`. False when it never ends.
///
/// Were an emission the last to hold, the object would be torn down by its own heartbeat or receive thread, which then
/// waits for itself: the library ends the whole process. Disconnect the signal first.
pub fn emission_ended(object: &impl IsA<glib::Object>, holds: u32) -> bool {
    for _ in 0..EMISSION_TRIES {
        if object.ref_count() <= holds {
            return true;
        }
        std::thread::park_timeout(EMISSION_PAUSE);
    }
    false
}

// === impl Reception ===

impl Reception {
    /// Opens a stream on a new port and tells the camera; `filled` is called for every buffer.
    ///
    /// # Errors
    /// `WrongDevice` where the camera's blocks cannot hold a picture, and those of the library.
    pub fn new(camera: &Camera, features: &Features, options: &AravisOptions, filled: &Filled) -> Result<Reception> {
        let wrap = |doing: &str, e: &glib::Error| features.wrap(doing, e);
        let payload = camera.payload().map_err(|e| wrap("reading the payload size", &e))?;
        let image = options.format.bytes(options.width * options.height);
        if (payload as usize) < image {
            let message =
                format!("blocks of {payload} bytes cannot hold a picture of {image}; check width, height and format");
            return Err(features.fail(ErrorKind::WrongDevice, message));
        }
        let stream = camera.create_stream().map_err(|e| wrap("opening the stream", &e))?;
        if let Some(gv) = stream.downcast_ref::<GvStream>() {
            // Before the first buffer: the default of 208 KiB loses nearly every frame of an unpaced sender.
            gv.set_socket_buffer(GvStreamSocketBuffer::Fixed);
            gv.set_socket_buffer_size(options.socket_buffer_bytes);
            gv.set_packet_resend(GvStreamPacketResend::Always);
            gv.set_packet_request_ratio(1.0);
            // A camera remembers few frames: what was lost must be asked for again soon.
            gv.set_packet_timeout(5_000);
            gv.set_frame_retention(options.frame_retention.as_micros() as u32);
        }
        for _ in 0..options.buffers.max(2) {
            stream.push_buffer(Buffer::new_allocate(payload as usize));
        }
        let holds = stream.ref_count();
        let filled = Arc::clone(filled);
        let signal = stream.connect_new_buffer(move |_| filled());
        stream.set_emit_signals(true);
        Ok(Reception { stream, signal, holds })
    }

    /// The next filled buffer, if there is one. It must come back by [`push`](Self::push).
    pub fn pop(&self) -> Option<Buffer> {
        self.stream.try_pop_buffer()
    }

    /// Gives a buffer back to be filled.
    pub fn push(&self, buffer: Buffer) {
        self.stream.push_buffer(buffer);
    }

    /// What it has counted.
    pub fn counts(&self) -> LinkCounts {
        let (_, _, underruns) = self.stream.statistics();
        let (resent_packets, missing_packets) =
            self.stream.downcast_ref::<GvStream>().map_or((0, 0), |gv| gv.statistics());
        LinkCounts { resent_packets, missing_packets, underruns }
    }

    /// Closes the stream and its port. False where the library never let go of it: then it stays for good.
    pub fn close(self) -> bool {
        self.stream.set_emit_signals(false);
        self.stream.disconnect(self.signal);
        let free = emission_ended(&self.stream, self.holds);
        if !free {
            std::mem::forget(self.stream);
        }
        free
    }
}
