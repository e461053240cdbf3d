//! Twins of USB instruments: state machines of time behind endpoints.
//!
//! - [`endpoint`]: packets that wait in an IN endpoint, and the faults that meet an answer
//! - [`pm100`]: Thorlabs PM100 over USBTMC ([`tmc`]: its messages, [`scpi`]: its command tree)
//! - [`oceanoptics`]: USB2000, USB2000+, USB4000 ([`detector`]: light, time and noise)

pub mod detector;
pub mod endpoint;
pub mod oceanoptics;
mod oceanoptics_memory;
pub mod pm100;
mod pm100_tree;
pub mod scpi;
pub mod tmc;

pub use endpoint::UsbFault;
