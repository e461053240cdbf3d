//! Fronts: what carries a twin's bytes to a driver.

pub mod pipe;
pub mod pty;
pub mod usb;
pub mod usb_memory;
pub mod usbip;

pub use pipe::{PipeConnector, PipePort};
pub use pty::PtyPort;
pub use usb_memory::UsbBus;
