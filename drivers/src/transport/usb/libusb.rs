//! USB devices through libusb (crate `rusb`): found by ids and serial number, first interface with bulk endpoints claimed.
//!
//! Source: libusb 1.0 API documentation. A limit of 0 means for ever there, so every limit is at least 1 ms; a time-out
//! after part of the data gives that part; a halted endpoint is `Pipe`, a device that is gone `NoDevice` or `Io`.

use super::{BulkEndpoint, Transfer, UsbAddress, UsbError, UsbInfo, UsbOpener, UsbPort, UsbRequest};
use crate::error::{DeviceError, ErrorKind, Result};
use rusb::{Context, Device, DeviceDescriptor, DeviceHandle, TransferType, UsbContext};
use std::time::Duration;

/// Shortest limit of a transfer.
const SHORTEST: Duration = Duration::from_millis(1);
/// The configuration of every device we speak to.
const CONFIGURATION: u8 = 1;
/// Who may open USB instruments.
const GROUP: &str = "goniophot";

/// Finds one device on the bus.
#[derive(Debug, Clone)]
pub struct LibUsb {
    address: UsbAddress,
    port: String,
}

/// A claimed interface.
struct LibUsbPort {
    handle: DeviceHandle<Context>,
    info: UsbInfo,
}

// === impl LibUsb ===

impl LibUsb {
    /// An opener of the device at `address`.
    pub fn new(address: UsbAddress) -> LibUsb {
        let port = address.to_string();
        LibUsb { address, port }
    }

    fn error(&self, kind: ErrorKind, message: impl Into<String>) -> DeviceError {
        DeviceError::new(kind, &self.port, message)
    }

    /// All devices with our ids.
    fn candidates(&self) -> Result<Vec<(Device<Context>, DeviceDescriptor)>> {
        let context = Context::new()
            .map_err(|e| self.error(ErrorKind::Broken, format!("libusb cannot start ({e}); is /dev/bus/usb there?")))?;
        let devices = context
            .devices()
            .map_err(|e| self.error(ErrorKind::Broken, format!("the USB devices cannot be listed ({e})")))?;
        let ours =
            |d: &DeviceDescriptor| d.vendor_id() == self.address.vendor && d.product_id() == self.address.product;
        let described = devices.iter().filter_map(|device| Some((device.device_descriptor().ok()?, device)));
        Ok(described.filter(|(d, _)| ours(d)).map(|(d, device)| (device, d)).collect())
    }

    /// The one device that the address means, opened.
    fn find(&self) -> Result<(DeviceHandle<Context>, DeviceDescriptor)> {
        let found = self.candidates()?;
        let only = found.len() == 1;
        let (mut serials, mut fitting, mut refused) = (Vec::new(), Vec::new(), None);
        for (device, descriptor) in found {
            match device.open() {
                Ok(handle) => {
                    let serial = handle.read_serial_number_string_ascii(&descriptor).unwrap_or_default();
                    // A device that tells no serial number here tells it the driver, which compares.
                    let fits = match &self.address.serial {
                        Some(wanted) => serial == *wanted || (serial.is_empty() && only),
                        None => true,
                    };
                    if fits {
                        fitting.push((handle, descriptor));
                    }
                    serials.push(if serial.is_empty() { "one without serial number".to_owned() } else { serial });
                }
                Err(error) => refused = Some(error),
            }
        }
        match (fitting.len(), refused) {
            (1, _) => fitting.pop().ok_or_else(|| self.absent(&serials)),
            (0, Some(error)) => Err(self.refused("opened", error)),
            (0, None) => Err(self.absent(&serials)),
            (n, _) => Err(self.error(
                ErrorKind::WrongDevice,
                format!("{n} devices fit ({}); write the serial number into `port`", serials.join(", ")),
            )),
        }
    }

    fn absent(&self, serials: &[String]) -> DeviceError {
        let there = if serials.is_empty() {
            "no device with these ids is connected".to_owned()
        } else {
            format!("with these ids there is only {}", serials.join(", "))
        };
        let what = format!("USB device {} is not there ({there}); plug it in or correct `port`", self.port);
        self.error(ErrorKind::Lost, what)
    }

    fn refused(&self, what: &str, error: rusb::Error) -> DeviceError {
        let (kind, hint) = match error {
            rusb::Error::Access => (
                ErrorKind::Refused,
                format!("this user may not; install the udev rules of systemd/ and add the user to group {GROUP}"),
            ),
            rusb::Error::Busy => (ErrorKind::Busy, "another program uses it; close that program".to_owned()),
            rusb::Error::NoDevice => (ErrorKind::Lost, "it is gone; check cable and power".to_owned()),
            _ => (ErrorKind::Lost, "pull the cable and plug it in again".to_owned()),
        };
        self.error(kind, format!("USB device {} is there but cannot be {what} ({error}): {hint}", self.port))
    }
}

impl UsbOpener for LibUsb {
    fn port(&self) -> &str {
        &self.port
    }

    fn open(&self) -> Result<Box<dyn UsbPort>> {
        let (handle, descriptor) = self.find()?;
        // Not everywhere supported; then a kernel driver in the way shows as `Busy` below.
        let _ = handle.set_auto_detach_kernel_driver(true);
        if handle.active_configuration() != Ok(CONFIGURATION) {
            handle.set_active_configuration(CONFIGURATION).map_err(|e| self.refused("configured", e))?;
        }
        let mut info = UsbInfo {
            vendor: descriptor.vendor_id(),
            product: descriptor.product_id(),
            manufacturer: handle.read_manufacturer_string_ascii(&descriptor).unwrap_or_default(),
            name: handle.read_product_string_ascii(&descriptor).unwrap_or_default(),
            serial: handle.read_serial_number_string_ascii(&descriptor).unwrap_or_default(),
            ..UsbInfo::default()
        };
        describe_interface(&handle.device(), &mut info).map_err(|e| self.refused("described", e))?;
        if info.endpoints.is_empty() {
            let what = "the device has no interface with bulk endpoints; is it the right one?";
            return Err(self.error(ErrorKind::WrongDevice, what));
        }
        handle.claim_interface(info.interface).map_err(|e| self.refused("claimed", e))?;
        Ok(Box::new(LibUsbPort { handle, info }))
    }
}

/// Fills in the first interface that has bulk endpoints.
fn describe_interface(device: &Device<Context>, info: &mut UsbInfo) -> rusb::Result<()> {
    let configuration = device.active_config_descriptor().or_else(|_| device.config_descriptor(0))?;
    for interface in configuration.interfaces() {
        let Some(setting) = interface.descriptors().next() else { continue };
        let bulk = setting.endpoint_descriptors().filter(|e| e.transfer_type() == TransferType::Bulk);
        let endpoints: Vec<BulkEndpoint> =
            bulk.map(|e| BulkEndpoint { address: e.address(), packet: usize::from(e.max_packet_size()) }).collect();
        if !endpoints.is_empty() {
            info.interface = interface.number();
            info.class = (setting.class_code(), setting.sub_class_code(), setting.protocol_code());
            info.endpoints = endpoints;
            return Ok(());
        }
    }
    Ok(())
}

// === impl LibUsbPort ===

impl UsbPort for LibUsbPort {
    fn info(&self) -> UsbInfo {
        self.info.clone()
    }

    fn transfer(&mut self, request: &UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        let limit = limit.max(SHORTEST);
        let read = |length: usize, call: &dyn Fn(&mut [u8]) -> rusb::Result<usize>| {
            let mut buffer = vec![0; length];
            let n = call(&mut buffer).map_err(failure)?;
            buffer.truncate(n);
            Ok(buffer)
        };
        let wrote = |whole: usize, taken: rusb::Result<usize>| match taken {
            Ok(n) if n < whole => Err(UsbError::Partial(n)),
            Ok(_) => Ok(Vec::new()),
            Err(error) => Err(failure(error)),
        };
        match request {
            UsbRequest::BulkOut(endpoint, bytes) => wrote(bytes.len(), self.handle.write_bulk(*endpoint, bytes, limit)),
            UsbRequest::BulkIn(endpoint, length) => {
                read(*length, &|buffer| self.handle.read_bulk(*endpoint, buffer, limit))
            }
            UsbRequest::ControlOut(s, bytes) => {
                wrote(bytes.len(), self.handle.write_control(s.request_type, s.request, s.value, s.index, bytes, limit))
            }
            UsbRequest::ControlIn(s, length) => read(*length, &|buffer| {
                self.handle.read_control(s.request_type, s.request, s.value, s.index, buffer, limit)
            }),
            UsbRequest::ClearHalt(endpoint) => self.handle.clear_halt(*endpoint).map(|()| Vec::new()).map_err(failure),
        }
    }
}

fn failure(error: rusb::Error) -> UsbError {
    match error {
        // A signal ends a wait early; for the driver that is a transfer that did not come.
        rusb::Error::Timeout | rusb::Error::Interrupted => UsbError::Timeout,
        rusb::Error::Pipe => UsbError::Stall,
        rusb::Error::Overflow => UsbError::Overflow,
        rusb::Error::NoDevice | rusb::Error::NotFound => UsbError::Gone,
        _ => UsbError::Other,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::clock::Clock;
    use crate::transport::UsbConnector;
    use crate::transport::usb::UsbThread;

    #[tokio::test]
    async fn a_device_that_is_not_there_says_what_to_do() {
        let address: UsbAddress = "usb:ffff:fffe:NONE".parse().unwrap();
        let error = UsbThread::new(LibUsb::new(address), Clock::system()).connect().await.err().unwrap();
        assert!(matches!(error.kind, ErrorKind::Lost | ErrorKind::Broken), "{error}");
        assert!(error.message.contains("plug it in") || error.message.contains("/dev/bus/usb"), "{error}");
    }

    #[test]
    fn only_what_means_a_dead_device_is_a_loss() {
        for error in [rusb::Error::Timeout, rusb::Error::Pipe, rusb::Error::Overflow, rusb::Error::Interrupted] {
            assert!(!failure(error).is_loss(), "{error:?}");
        }
        for error in [rusb::Error::NoDevice, rusb::Error::Io, rusb::Error::Other] {
            assert!(failure(error).is_loss(), "{error:?}");
        }
    }
}
