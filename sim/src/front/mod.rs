//! Fronts: what carries a twin's bytes to a driver.

pub mod pipe;
pub mod usb;
pub mod usb_memory;
pub mod usbip;

pub use pipe::{PipeConnector, PipePort};
pub use usb_memory::UsbBus;
