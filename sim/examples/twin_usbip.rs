//! Puts a power meter and three spectrometers behind a USB/IP server: `twin_usbip ADDRESS`, until it is ended. A kernel's
//! `usbip attach` or a USB/IP back end of pyusb plugs them in.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::front::usbip::UsbIpServer;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use tokio::time::Instant;

fn main() -> ExitCode {
    let address = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.1:3240".to_owned());
    let server = match UsbIpServer::start(&address) {
        Ok(server) => server,
        Err(error) => {
            eprintln!("no server at {address}: {error}");
            return ExitCode::FAILURE;
        }
    };
    let mut meter = Pm100Spec::new("P0001234");
    if let Some(maker) = std::env::args().nth(2) {
        meter.maker = maker;
    }
    server.plug("1-1", Arc::new(Mutex::new(Pm100Twin::new(meter))));
    for (busid, model, serial) in [
        ("1-2", OceanModel::Usb2000, "USB2G1234"),
        ("1-3", OceanModel::Usb2000Plus, "USB2+H00001"),
        ("1-4", OceanModel::Usb4000, "USB4C00002"),
    ] {
        let twin = OceanTwin::new(OceanSpec::new(model, serial), Instant::now());
        server.plug(busid, Arc::new(Mutex::new(twin)));
    }
    println!("power meter and spectrometers at {}", server.address());
    loop {
        std::thread::park();
    }
}
