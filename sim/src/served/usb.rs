//! USB devices of a served bench: on a USB/IP server of this machine. Where its kernel has `vhci-hcd` they are plugged in
//! at once, else they wait there for a kernel that has.

use crate::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use crate::firmware::usb::pm100::{Pm100Model, Pm100Spec, Pm100Twin, Power};
use crate::front::usbip::{UsbIpServer, vhci};
use crate::truth::lamp::SimLamp;
use goniod_drivers::clock::Clock;
use serde_json::{Value, json};
use std::io;
use std::sync::{Arc, Mutex};

/// A USB device of a bench.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbSite {
    /// Product id, which says the model.
    pub product: u16,
    /// Serial number it reports.
    pub serial: String,
}

/// What is plugged into the server.
#[derive(Default)]
pub struct UsbDevices {
    /// The server; absent where there is no USB device.
    pub server: Option<UsbIpServer>,
    /// The power meter that looks at the lamp.
    pub meter: Option<Arc<Mutex<Pm100Twin>>>,
    /// The spectrometer.
    pub spectrometer: Option<Arc<Mutex<OceanTwin>>>,
}

// === impl UsbDevices ===

impl UsbDevices {
    /// Bus id of the power meter.
    pub const METER: &'static str = "1-1";
    /// Bus id of the spectrometer.
    pub const SPECTROMETER: &'static str = "1-2";

    /// Starts a server with these devices on any free port of 127.0.0.1; none without devices.
    ///
    /// # Errors
    /// No port can be bound.
    pub fn start(
        meter: Option<&UsbSite>,
        spectrometer: Option<&UsbSite>,
        lamp: &SimLamp,
        clock: Clock,
    ) -> io::Result<UsbDevices> {
        if meter.is_none() && spectrometer.is_none() {
            return Ok(UsbDevices::default());
        }
        let meter = meter.map(|site| {
            let lamp = lamp.clone();
            let power: Power = Arc::new(move |at| lamp.monitor_w(at));
            let model = meter_model(site.product).unwrap_or(Pm100Model::Pm100D);
            Arc::new(Mutex::new(Pm100Twin::new(Pm100Spec { model, power, ..Pm100Spec::new(&site.serial) })))
        });
        let spectrometer = spectrometer.map(|site| {
            let model = spectrometer_model(site.product).unwrap_or(OceanModel::Usb2000Plus);
            Arc::new(Mutex::new(OceanTwin::new(OceanSpec::new(model, &site.serial), clock.now())))
        });
        let devices = UsbDevices { server: Some(UsbIpServer::start("127.0.0.1:0")?), meter, spectrometer };
        devices.plug(UsbDevices::METER);
        devices.plug(UsbDevices::SPECTROMETER);
        Ok(devices)
    }

    /// Plugs the device of this bus id in, where the bench has it; waits for the kernel.
    pub fn plug(&self, busid: &'static str) {
        let Some(server) = &self.server else { return };
        match (busid, &self.meter, &self.spectrometer) {
            (UsbDevices::METER, Some(twin), _) => server.plug(busid, Arc::clone(twin)),
            (UsbDevices::SPECTROMETER, _, Some(twin)) => server.plug(busid, Arc::clone(twin)),
            _ => return,
        }
        if vhci::is_usable()
            && let Err(error) = vhci::attach(server.address(), busid)
        {
            tracing::warn!(busid, %error, "the kernel does not take the simulated USB device");
        }
    }

    /// Pulls the device of this bus id out.
    pub fn unplug(&self, busid: &str) {
        if let Some(server) = &self.server {
            server.unplug(busid);
        }
    }

    /// Where each device is, and what plugs it in where this machine's kernel has not; one line each.
    pub fn hints(&self) -> Vec<String> {
        let Some(server) = &self.server else { return Vec::new() };
        let port = server.address().port();
        let of = |busid: &str, there: bool, what: &str| {
            there.then(|| match server.is_imported(busid) {
                true => format!("{what} is plugged into this machine's kernel"),
                false => {
                    format!("{what}: modprobe vhci-hcd && usbip --tcp-port {port} attach -r 127.0.0.1 -b {busid}")
                }
            })
        };
        let meter = of(UsbDevices::METER, self.meter.is_some(), "light_monitor on USB");
        let spectrometer = of(UsbDevices::SPECTROMETER, self.spectrometer.is_some(), "spectrometer on USB");
        meter.into_iter().chain(spectrometer).collect()
    }

    /// What went over USB/IP.
    pub fn counters(&self) -> Value {
        let Some(server) = &self.server else { return json!({}) };
        let of = |busid: &str, there: bool| there.then(|| json!({ "imported": server.is_imported(busid) }));
        json!({
            "address": server.address().to_string(),
            "light_monitor": of(UsbDevices::METER, self.meter.is_some()),
            "spectrometer": of(UsbDevices::SPECTROMETER, self.spectrometer.is_some()),
        })
    }
}

/// The meter with this product id.
pub fn meter_model(product: u16) -> Option<Pm100Model> {
    match product {
        0x8078 => Some(Pm100Model::Pm100D),
        0x8076 => Some(Pm100Model::Pm100A),
        0x8072 => Some(Pm100Model::Pm100Usb),
        _ => None,
    }
}

/// The spectrometer with this product id.
pub fn spectrometer_model(product: u16) -> Option<OceanModel> {
    match product {
        0x1002 => Some(OceanModel::Usb2000),
        0x101e => Some(OceanModel::Usb2000Plus),
        0x1022 => Some(OceanModel::Usb4000),
        _ => None,
    }
}
