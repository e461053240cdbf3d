//! How instrument files name a USB device: `usb:VID:PID` or `usb:VID:PID:SERIAL`, ids in hexadecimal.

use crate::error::{DeviceError, ErrorKind, Result};
use std::fmt;
use std::str::FromStr;

/// A device on the bus by what it is, not by where it is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbAddress {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// Serial number as the device's string descriptor tells it; `None` takes the only device with these ids.
    pub serial: Option<String>,
}

// === impl UsbAddress ===

impl FromStr for UsbAddress {
    type Err = DeviceError;

    fn from_str(port: &str) -> Result<UsbAddress> {
        let id = |text: Option<&str>| {
            text.filter(|t| t.len() <= 4 && t.bytes().all(|b| b.is_ascii_hexdigit()))
                .and_then(|t| u16::from_str_radix(t, 16).ok())
        };
        let mut parts = port.splitn(4, ':');
        let scheme = parts.next();
        let (vendor, product, serial) = (id(parts.next()), id(parts.next()), parts.next());
        match (scheme, vendor, product) {
            (Some("usb"), Some(vendor), Some(product)) if serial != Some("") => {
                Ok(UsbAddress { vendor, product, serial: serial.map(str::to_owned) })
            }
            _ => Err(DeviceError::new(
                ErrorKind::Refused,
                port,
                format!(
                    "`{port}` does not name a USB device; write `usb:VID:PID` or `usb:VID:PID:SERIAL` with hexadecimal ids, such as `usb:1313:8078:P0001234`"
                ),
            )),
        }
    }
}

impl fmt::Display for UsbAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "usb:{:04x}:{:04x}", self.vendor, self.product)?;
        self.serial.iter().try_for_each(|serial| write!(f, ":{serial}"))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ids_are_hexadecimal_and_the_serial_is_free_text() {
        let address: UsbAddress = "usb:1313:8078:P0001234".parse().unwrap();
        assert_eq!(address, UsbAddress { vendor: 0x1313, product: 0x8078, serial: Some("P0001234".into()) });
        assert_eq!("usb:2457:101e".parse::<UsbAddress>().unwrap().serial, None);
        assert_eq!("usb:1313:8078:a:b".parse::<UsbAddress>().unwrap().serial.as_deref(), Some("a:b"));
    }

    #[test]
    fn what_is_not_an_address_is_answered_with_what_is() {
        for port in ["", "usb", "usb:1313", "usb:1313:8078:", "usb:xyzt:8078", "usb:13137:8078", "usb:+1:2", "/dev/usb"]
        {
            let error = port.parse::<UsbAddress>().unwrap_err();
            assert_eq!(error.kind, ErrorKind::Refused);
            assert!(error.message.contains("usb:VID:PID:SERIAL"), "{error}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_an_address_that_prints_itself_or_an_error(text in "(usb)?[:0-9a-fxP ]{0,24}") {
            if let Ok(address) = text.parse::<UsbAddress>() {
                prop_assert_eq!(address.to_string().parse::<UsbAddress>().unwrap(), address);
            }
        }
    }
}
