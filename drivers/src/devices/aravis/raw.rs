//! The one place that touches memory of the C library: the bytes of a filled buffer.
#![allow(unsafe_code)] // Aravis gives a pointer and a length; a copy through its own getter would be a second one.

use aravis::Buffer;

/// The bytes a buffer holds, borrowed from it. Empty where the library gives none.
///
/// The buffer must have been popped from its stream: then the library writes to it no more until it is pushed back,
/// which needs the buffer by value and so cannot happen while the slice lives.
pub fn bytes(buffer: &Buffer) -> &[u8] {
    let (data, length) = buffer.data();
    if data.is_null() || length == 0 {
        return &[];
    }
    // SAFETY: pointer and length come from `arv_buffer_get_data` of a live buffer that we own; the slice borrows it.
    unsafe { std::slice::from_raw_parts(data, length) }
}
