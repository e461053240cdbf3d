//! Serial lines: the holder behind a USB adapter that is pulled out in mid-command, the shutter behind a 16550.

use crate::bench::STAGE;
use crate::ensure;
use crate::report::{Outcome, Report};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::{RotaryAxis, Shutter, ShutterState};
use goniod_drivers::devices::{AxisConfig, ShutterConfig};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::table;
use goniod_drivers::transport::SerialConnector;
use goniod_drivers::units::{Degrees, DegreesPerSecond};
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// Node of the USB adapter (`ftdi_sio`).
const ADAPTER: &str = "/dev/ttyUSB0";
/// Node of the third 16550.
const LINE: &str = "/dev/ttyS2";
const LIMIT: Duration = Duration::from_secs(60);

type Error = Box<dyn std::error::Error + Send + Sync>;

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("a-shutter-on-a-16550", LIMIT, shutter()).await;
    report.check("a-holder-on-a-usb-adapter", LIMIT, holder()).await;
    report.check("the-adapter-is-pulled-in-mid-command", LIMIT, pulled()).await;
}

fn order(what: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "ORDER {what}");
    let _ = out.flush();
}

fn axis() -> Result<Box<dyn RotaryAxis>, Error> {
    let clock = Clock::system();
    let config = AxisConfig {
        name: "tilt".into(),
        device: 1,
        axis: 1,
        serial: STAGE.into(),
        min: Degrees(-5.0),
        max: Degrees(365.0),
        speed: DegreesPerSecond(20.0),
        acceleration_deg_per_s2: 80.0,
        tolerance: Degrees(0.01),
        settle: Duration::from_millis(50),
    };
    let connector = Box::new(SerialConnector::new(ADAPTER, table::lookup("zaber-ascii")?.baud, clock));
    table::holder("zaber-ascii", connector, vec![config], clock)?.pop().ok_or_else(|| "no axis".into())
}

async fn there(node: &str, wanted: bool) -> Result<(), Error> {
    let clock = Clock::system();
    while Path::new(node).exists() != wanted {
        if clock.elapsed() > Duration::from_secs(30) {
            return Err(format!("{node} did not {}", if wanted { "come" } else { "go" }).into());
        }
        clock.sleep(Duration::from_millis(20)).await;
    }
    Ok(())
}

async fn shutter() -> Outcome {
    let clock = Clock::system();
    let driver = "thorlabs-sc10";
    let connector = Box::new(SerialConnector::new(LINE, table::lookup(driver)?.baud, clock));
    let config = ShutterConfig { name: "shutter".into(), settle: Duration::from_millis(50) };
    let mut shutter: Box<dyn Shutter> = table::shutter(driver, connector, config, clock)?;
    let identity = shutter.open().await?;
    for state in [ShutterState::Open, ShutterState::Closed, ShutterState::Open] {
        shutter.set(state).await?;
        ensure!(shutter.state().await? == Some(state), "not {state:?}");
    }
    shutter.make_safe().await?;
    ensure!(shutter.state().await? == Some(ShutterState::Closed), "not safe");
    Ok(format!("{} {}", identity.model, identity.firmware))
}

async fn holder() -> Outcome {
    there(ADAPTER, true).await?;
    let mut axis = axis()?;
    let identity = axis.open().await?;
    axis.home().await?;
    let reached = axis.move_to(Degrees(12.5)).await?;
    order("angle 12.5");
    Ok(format!("{} {} at {:.4}", identity.model, identity.serial, reached.0))
}

/// The command under way fails as a loss, the node comes back under its name, the axis is opened again and knows where
/// it is, and the move is made again.
async fn pulled() -> Outcome {
    let mut axis = axis()?;
    axis.open().await?;
    let mut said = Vec::new();
    for target in [60.0, 20.0] {
        let clock = Clock::system();
        let moving = tokio::spawn(async move {
            let result = axis.move_to(Degrees(target)).await;
            (axis, result)
        });
        clock.sleep(Duration::from_millis(400)).await;
        order("unplug");
        let (back, result) = moving.await?;
        axis = back;
        let error = result.err().ok_or("a move ended well without its adapter")?;
        ensure!(error.kind == ErrorKind::Lost, "{:?}: {error}", error.kind);
        said.push(error.message);
        there(ADAPTER, false).await?;
        let missing = axis.open().await.err().ok_or("opened without an adapter")?;
        ensure!(missing.kind == ErrorKind::Lost, "{:?}: {missing}", missing.kind);
        order("plug");
        there(ADAPTER, true).await?;
        axis.open().await?;
        ensure!(axis.position().await?.is_some(), "the stage kept its power and its reference");
        axis.move_to(Degrees(target)).await?;
        order(&format!("angle {target:.1}"));
    }
    said.dedup();
    Ok(format!("pulled twice in mid-move: {said:?}"))
}
