//! Every driver against its firmware twin, over the wire, in paused time.
#![allow(clippy::unwrap_used, clippy::expect_used)]

mod esp301;
mod holder;
mod ifw;
mod light_monitor;
mod monochromator;
mod noise;
mod open_shutter;
mod shutter;
mod smc100;
mod wheel;

use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{FilterWheel, LightMonitor, Monochromator, RotaryAxis, Shutter};
use goniod_drivers::devices::{AxisConfig, LightMonitorConfig, MonochromatorConfig, ShutterConfig, WheelConfig};
use goniod_drivers::table;
use goniod_drivers::units::{Degrees, DegreesPerSecond, Nanometres, Slot};
use goniod_sim::twins::{Twins, TwinsSpec};
use std::time::Duration;

/// A bench with its drivers, nothing open yet.
struct Bench {
    twins: Twins,
    axes: Vec<Box<dyn RotaryAxis>>,
    wheel: Box<dyn FilterWheel>,
    shutter: Box<dyn Shutter>,
    monochromator: Box<dyn Monochromator>,
    light_monitor: Box<dyn LightMonitor>,
}

/// Configuration of an axis: 10 degrees a second, 20 degrees a second squared.
fn axis(name: &str, device: u8, serial: &str) -> AxisConfig {
    AxisConfig {
        name: name.into(),
        device,
        axis: 1,
        serial: serial.into(),
        min: Degrees(-5.0),
        max: Degrees(365.0),
        speed: DegreesPerSecond(10.0),
        acceleration_deg_per_s2: 20.0,
        tolerance: Degrees(0.01),
        settle: Duration::from_millis(200),
    }
}

fn bench() -> Bench {
    bench_of(TwinsSpec::with_serials("1001", "1002", "1003"))
}

fn bench_of(spec: TwinsSpec) -> Bench {
    let clock = Clock::system();
    let twins = Twins::new(spec);
    let axes = vec![axis("tilt", 1, "1001"), axis("spin", 2, "1002"), axis("changer", 3, "1003")];
    let port = |name: &str| twins.connector(name, clock).unwrap();
    let wheel = WheelConfig {
        name: "filter_wheel".into(),
        places: 12,
        dark: Some(Slot(12)),
        settle: Duration::from_millis(100),
    };
    let shutter = ShutterConfig { name: "shutter".into(), settle: Duration::from_millis(50) };
    let monochromator = MonochromatorConfig {
        name: "monochromator".into(),
        serial: "11042".into(),
        min: Nanometres(300.0),
        max: Nanometres(1100.0),
        tolerance: Nanometres(0.2),
        settle: Duration::from_millis(100),
    };
    let light_monitor = LightMonitorConfig {
        name: "light_monitor".into(),
        serial: String::new(),
        wavelength: Nanometres(550.0),
        average: 4,
    };
    Bench {
        monochromator: table::monochromator("spectral-cm110", port("sim:monochromator"), monochromator, clock).unwrap(),
        light_monitor: table::light_monitor("newport-1830c", port("sim:light-monitor"), light_monitor, clock).unwrap(),
        axes: table::holder("zaber-ascii", port("sim:holder"), axes, clock).unwrap(),
        wheel: table::filter_wheel("thorlabs-fw212c", port("sim:filter-wheel"), wheel, clock).unwrap(),
        shutter: table::shutter("thorlabs-sc10", port("sim:shutter"), shutter, clock).unwrap(),
        twins,
    }
}
