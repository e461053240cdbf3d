//! The V4L2 calls that crate `v4l` does not offer safely, each behind a safe function: the driver's only `unsafe`.
//!
//! Why not the crate's `MmapStream` (0.14.0): after a time-out its `next` fails with EINVAL for ever, its `Drop`
//! panics when STREAMOFF fails with EIO, and its `set_control` passes size 8 for 32-bit integers.
//! Source: Linux media userspace API, "Streaming I/O (Memory Mapping)" and "User Controls".

#![allow(unsafe_code)] // ioctl, mmap and the kernel's monotonic clock are C

use std::io;
use std::os::raw::c_void;
use std::sync::Arc;
use std::time::Duration;
use v4l::buffer::Type::VideoCapture;
use v4l::device::{Device, Handle};
use v4l::memory::Memory;
use v4l::v4l_sys as c;
use v4l::v4l2::{self, vidioc};

/// Range of a control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlRange {
    /// Smallest raw value.
    pub minimum: i64,
    /// Largest raw value.
    pub maximum: i64,
    /// Disabled or read-only: writing it has no sense.
    pub fixed: bool,
}

/// What the kernel says about a dequeued buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BufferMeta {
    /// Bytes of the picture.
    pub bytesused: usize,
    /// V4L2_BUF_FLAG bits.
    pub flags: u32,
    /// Field order of the picture.
    pub field: u32,
    /// Time stamp, of the clock that the flags name.
    pub stamp: Duration,
    /// The device's frame counter.
    pub sequence: u32,
}

/// A buffer that belongs to the program until it is queued again.
#[derive(Debug)]
pub struct Taken {
    index: u32,
    /// What the kernel says about it.
    pub meta: BufferMeta,
}

/// Buffers shared with the kernel, all queued and streaming. Dropping it stops the stream and gives all back.
pub struct Ring {
    handle: Arc<Handle>,
    maps: Vec<(*mut c_void, usize)>,
}

/// CLOCK_MONOTONIC, the clock of the buffers' stamps. Asked of the kernel by system call, the same door as the
/// ioctls, so that a stand-in for the device answers for its clock too.
pub fn monotonic() -> Duration {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the kernel fills one timespec that outlives the call.
    unsafe { libc::syscall(libc::SYS_clock_gettime, libc::CLOCK_MONOTONIC, &mut now as *mut libc::timespec) };
    Duration::new(now.tv_sec.unsigned_abs(), now.tv_nsec.unsigned_abs() as u32)
}

/// Range and flags of control `id`; EINVAL when the device has no such control.
pub fn query_control(device: &Device, id: u32) -> io::Result<ControlRange> {
    let mut query = c::v4l2_query_ext_ctrl { id, ..zeroed() };
    call(&device.handle(), vidioc::VIDIOC_QUERY_EXT_CTRL, &mut query)?;
    let fixed = query.flags & (c::V4L2_CTRL_FLAG_DISABLED | c::V4L2_CTRL_FLAG_READ_ONLY) != 0;
    Ok(ControlRange { minimum: query.minimum, maximum: query.maximum, fixed })
}

/// The control's value now.
pub fn get_control(device: &Device, id: u32) -> io::Result<i32> {
    let mut control = c::v4l2_control { id, value: 0 };
    call(&device.handle(), vidioc::VIDIOC_G_CTRL, &mut control)?;
    Ok(control.value)
}

/// Writes the control; what the device made of it only [`get_control`] tells.
pub fn set_control(device: &Device, id: u32, value: i32) -> io::Result<()> {
    let mut control = c::v4l2_control { id, value };
    call(&device.handle(), vidioc::VIDIOC_S_CTRL, &mut control)
}

/// Status bits of the selected input (0x2 = no signal); 0 where the device has no inputs to tell of.
pub fn input_status(device: &Device) -> io::Result<u32> {
    let mut index: std::os::raw::c_int = 0;
    let handle = device.handle();
    if let Err(error) = call(&handle, vidioc::VIDIOC_G_INPUT, &mut index) {
        return if error.raw_os_error() == Some(libc::ENOTTY) { Ok(0) } else { Err(error) };
    }
    let mut input = c::v4l2_input { index: index.unsigned_abs(), ..zeroed() };
    call(&handle, vidioc::VIDIOC_ENUMINPUT, &mut input)?;
    Ok(input.status)
}

/// A plain C structure of the V4L2 interface with all bytes zero.
fn zeroed<T>() -> T {
    // SAFETY: only used for the kernel's own C structures, for which all zero bytes are the documented start.
    unsafe { std::mem::zeroed() }
}

/// One ioctl on a structure that fits it.
fn call<T>(handle: &Handle, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
    // SAFETY: each caller pairs the request with the structure the kernel's header names for it.
    unsafe { v4l2::ioctl(handle.fd(), request, argument as *mut T as *mut c_void) }
}

fn buffer(index: u32) -> c::v4l2_buffer {
    c::v4l2_buffer { index, type_: VideoCapture as u32, memory: Memory::Mmap as u32, ..zeroed() }
}

// === impl Ring ===

impl Ring {
    /// Asks for `count` buffers, maps and queues them and starts the stream.
    pub fn start(device: &Device, count: u32) -> io::Result<Ring> {
        let handle = device.handle();
        let mut request = requestbuffers(count);
        call(&handle, vidioc::VIDIOC_REQBUFS, &mut request)?;
        let mut ring = Ring { handle, maps: Vec::new() };
        for index in 0..request.count {
            ring.map(index)?;
            call(&ring.handle, vidioc::VIDIOC_QBUF, &mut buffer(index))?;
        }
        if ring.maps.is_empty() {
            return Err(io::Error::from_raw_os_error(libc::ENOMEM));
        }
        call(&ring.handle, vidioc::VIDIOC_STREAMON, &mut (VideoCapture as std::os::raw::c_int))?;
        Ok(ring)
    }

    fn map(&mut self, index: u32) -> io::Result<()> {
        let mut asked = buffer(index);
        call(&self.handle, vidioc::VIDIOC_QUERYBUF, &mut asked)?;
        let length = asked.length as usize;
        // SAFETY: a new mapping of the length and offset that the kernel just named; unmapped in Drop only.
        let at = unsafe {
            v4l2::mmap(
                std::ptr::null_mut(),
                length,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                self.handle.fd(),
                libc::off_t::from(asked.m.offset),
            )
        }?;
        self.maps.push((at, length));
        Ok(())
    }

    /// Number of buffers the device granted.
    pub fn buffers(&self) -> usize {
        self.maps.len()
    }

    /// True when a buffer can be taken (or the device has failed) within `slice`.
    pub fn ready(&self, slice: Duration) -> io::Result<bool> {
        match self.handle.poll(libc::POLLIN, slice.as_millis().min(10_000) as i32) {
            Ok(n) => Ok(n > 0),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => Ok(false),
            Err(e) => Err(e),
        }
    }

    /// Takes the oldest filled buffer; EAGAIN when there is none.
    pub fn take(&mut self) -> io::Result<Taken> {
        let mut b = buffer(0);
        call(&self.handle, vidioc::VIDIOC_DQBUF, &mut b)?;
        if b.index as usize >= self.maps.len() {
            return Err(io::Error::from_raw_os_error(libc::EIO));
        }
        let stamp = Duration::new(
            b.timestamp.tv_sec.unsigned_abs(),
            (b.timestamp.tv_usec.unsigned_abs() % 1_000_000) as u32 * 1000,
        );
        let meta =
            BufferMeta { bytesused: b.bytesused as usize, flags: b.flags, field: b.field, stamp, sequence: b.sequence };
        Ok(Taken { index: b.index, meta })
    }

    /// The picture in a taken buffer: at most as long as the device filled it.
    pub fn bytes(&self, taken: &Taken) -> &[u8] {
        let Some((at, length)) = self.maps.get(taken.index as usize) else { return &[] };
        // SAFETY: the mapping lives as long as the ring; the kernel does not write a dequeued buffer, and `give`
        // consumes `taken`, so no reader is left when it is queued again.
        unsafe { std::slice::from_raw_parts(*at as *const u8, (*length).min(taken.meta.bytesused)) }
    }

    /// Gives a buffer back to the device.
    pub fn give(&mut self, taken: Taken) -> io::Result<()> {
        call(&self.handle, vidioc::VIDIOC_QBUF, &mut buffer(taken.index))
    }
}

impl Drop for Ring {
    /// Whatever the device answers, every mapping is undone: a leaked mapping would keep the node busy.
    fn drop(&mut self) {
        let _ = call(&self.handle, vidioc::VIDIOC_STREAMOFF, &mut (VideoCapture as std::os::raw::c_int));
        for (at, length) in self.maps.drain(..) {
            // SAFETY: mapped by this ring with this length and not handed out any more.
            let _ = unsafe { v4l2::munmap(at, length) };
        }
        let _ = call(&self.handle, vidioc::VIDIOC_REQBUFS, &mut requestbuffers(0));
    }
}

fn requestbuffers(count: u32) -> c::v4l2_requestbuffers {
    c::v4l2_requestbuffers { count, type_: VideoCapture as u32, memory: Memory::Mmap as u32, ..zeroed() }
}
