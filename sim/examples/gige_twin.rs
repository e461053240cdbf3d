//! A camera to try GigE Vision programs on: `cargo run -p goniod-sim --example gige_twin -- 127.0.0.30`, until its input ends.
#![allow(clippy::print_stdout)]

use goniod_sim::gige::{GigeTwin, Painted, TwinConfig};
use std::io::Read;
use std::net::Ipv4Addr;
use std::sync::Arc;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let address: Ipv4Addr = std::env::args().nth(1).unwrap_or_else(|| "127.0.0.30".to_owned()).parse()?;
    let mut config = TwinConfig::quick(address, "SU320-0042");
    (config.real_exposure, config.discoverable) = (true, true);
    let twin = GigeTwin::start(config, Arc::new(Painted))?;
    println!("GigE Vision camera at {}; it is switched off at the end of input", twin.address());
    std::io::stdin().read_to_end(&mut Vec::new())?;
    println!("{:?}", twin.traffic());
    Ok(())
}
