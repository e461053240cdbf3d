//! Byte links and what is spoken over them: a [`Link`] reads whole lines or whole prompts, bounded and cancel-safe.
//!
//! A driver holds a [`Connector`], never a port: after a loss it connects again through the same object, whether that
//! opens a serial line or a pipe to a firmware twin.

mod link;
#[cfg(feature = "serial")]
mod serial;
pub mod usb;

pub use link::{Link, Stream};
#[cfg(feature = "serial")]
pub use serial::SerialConnector;
pub use usb::{UsbConnector, UsbLink};

use crate::error::Result;
use async_trait::async_trait;
use serde::{Deserialize, Serialize};

/// How a serial line holds back a sender that is too fast.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FlowControl {
    /// It does not.
    #[default]
    None,
    /// By the wires RTS and CTS, which the cable must have.
    RtsCts,
    /// By the characters XON and XOFF.
    XonXoff,
}

/// Opens a link, again and again.
#[async_trait]
pub trait Connector: Send {
    /// The port as the instrument file names it, for messages.
    fn port(&self) -> &str;
    /// Opens the port; `Lost` when it is not there or cannot be opened.
    async fn connect(&mut self) -> Result<Link>;
}
