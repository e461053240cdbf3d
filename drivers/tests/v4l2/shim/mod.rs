//! A V4L2 camera in software, behind the C library's own doors, so that the driver and crate `v4l` run unchanged on a
//! machine without video devices and kernel modules.
//!
//! The test program defines `open`, `close`, `poll` and `syscall` itself; the linker takes those before the C library's,
//! and what does not concern the twin is passed on. Time is the twin's own: `poll` turns its clock to the next picture.

pub mod doors;
pub mod ioctl;
pub mod paint;
pub mod sensor;
pub mod twin;
