//! Promise: the seeds of the fuzz targets that speak through a driver are what its twin says. `GONIOD_BLESS=1` writes
//! them anew.
#![allow(clippy::unwrap_used, clippy::expect_used)]

#[path = "../../fuzz/targets/session.rs"]
mod session;

use async_trait::async_trait;
use goniod_drivers::clock::Clock;
use goniod_drivers::error::Result;
use goniod_drivers::transport::usb::{Transfer, UsbConnector, UsbError, UsbPipe, UsbRequest};
use goniod_drivers::transport::{Connector, UsbLink};
use goniod_sim::firmware::Firmware;
use goniod_sim::firmware::cm110::{Cm110Twin, MonochromatorSpec};
use goniod_sim::firmware::esp301::{Esp301Twin, EspStage};
use goniod_sim::firmware::fw212c::{Fw212cTwin, WheelSpec};
use goniod_sim::firmware::ifw::IfwTwin;
use goniod_sim::firmware::newport_1830c::Newport1830cTwin;
use goniod_sim::firmware::open_shutter::{Listener, OpenShutterTwin};
use goniod_sim::firmware::sc10::Sc10Twin;
use goniod_sim::firmware::smc100::{Smc100Twin, SmcStage};
use goniod_sim::firmware::usb::oceanoptics::{OceanModel, OceanSpec, OceanTwin};
use goniod_sim::firmware::usb::pm100::{Pm100Spec, Pm100Twin};
use goniod_sim::firmware::zaber::{ZaberChainTwin, ZaberStage};
use goniod_sim::front::{PipePort, UsbBus};
use goniod_sim::truth::lamp::SimLamp;
use session::{Wire, paused};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// What was said, one answer a request.
type Tape = Arc<Mutex<Vec<Vec<u8>>>>;

/// A twin on tape.
struct OnTape<T>(T, Tape);

/// A USB connector on tape.
struct BusOnTape(Box<dyn UsbConnector>, Tape);

/// An open one.
struct PipeOnTape(UsbLink, Tape);

impl<T: Firmware> Firmware for OnTape<T> {
    fn receive(&mut self, bytes: &[u8], now: Instant) {
        self.1.lock().unwrap().push(Vec::new());
        self.0.receive(bytes, now);
    }

    fn due(&self) -> Option<Instant> {
        self.0.due()
    }

    fn take(&mut self, now: Instant) -> Vec<u8> {
        let said = self.0.take(now);
        if let Some(answer) = self.1.lock().unwrap().last_mut() {
            answer.extend(&said);
        }
        said
    }

    fn connected(&mut self, now: Instant) {
        self.0.connected(now);
    }
}

#[async_trait]
impl UsbConnector for BusOnTape {
    fn port(&self) -> &str {
        self.0.port()
    }

    async fn connect(&mut self) -> Result<UsbLink> {
        let link = self.0.connect().await?;
        let info = link.info().clone();
        Ok(UsbLink::new(PipeOnTape(link, Arc::clone(&self.1)), info))
    }
}

#[async_trait]
impl UsbPipe for PipeOnTape {
    async fn transfer(&mut self, request: UsbRequest, limit: Duration) -> Transfer<Vec<u8>> {
        let answer = match request {
            UsbRequest::BulkOut(endpoint, bytes) => {
                return self.0.send(endpoint, &bytes, limit).await.map(|()| Vec::new());
            }
            UsbRequest::ControlOut(setup, bytes) => {
                return self.0.control_out(setup, &bytes, limit).await.map(|()| Vec::new());
            }
            UsbRequest::ClearHalt(endpoint) => return self.0.clear_halt(endpoint).await.map(|()| Vec::new()),
            UsbRequest::BulkIn(endpoint, room) => self.0.read(endpoint, room, limit).await,
            UsbRequest::ControlIn(setup, room) => self.0.control_in(setup, room, limit).await,
        };
        let line = match &answer {
            Ok(bytes) => [&[0], bytes.as_slice()].concat(),
            Err(UsbError::Stall) => vec![2],
            Err(UsbError::Gone) => vec![3],
            Err(_) => vec![1],
        };
        self.1.lock().unwrap().push(line);
        answer
    }
}

fn line(twin: impl Firmware, tape: &Tape) -> Wire {
    let port = PipePort::new("sim:device", OnTape(twin, Arc::clone(tape)));
    let connector: Box<dyn Connector> = Box::new(port.connector(Clock::system()));
    Wire::Line(connector)
}

fn usb(connector: impl UsbConnector + 'static, tape: &Tape) -> Wire {
    Wire::Usb(Box::new(BusOnTape(Box::new(connector), Arc::clone(tape))))
}

/// The twin that a driver speaks to.
fn twin_of(driver: &str, tape: &Tape) -> Wire {
    let (now, clock) = (Instant::now(), Clock::system());
    match driver {
        "zaber-ascii" => line(ZaberChainTwin::new(vec![ZaberStage::new("1001")], now), tape),
        "newport-esp301" => line(Esp301Twin::new(vec![EspStage::new("1001")], 921_600, now), tape),
        "newport-esp300" => line(Esp301Twin::new(vec![EspStage::new("1001")], 19_200, now), tape),
        "newport-smc100" => line(Smc100Twin::new(vec![SmcStage::new(1, "1001")], now), tape),
        "thorlabs-fw212c" => line(Fw212cTwin::new(WheelSpec::default(), now), tape),
        "optec-ifw" => line(IfwTwin::new(9, now), tape),
        "thorlabs-sc10" => line(Sc10Twin::new(now), tape),
        "uniblitz-vcm-d1" => line(OpenShutterTwin::new(Listener::Uniblitz, now), tape),
        "lcus-relay" => line(OpenShutterTwin::new(Listener::Relay, now), tape),
        "spectral-cm110" => line(Cm110Twin::new(MonochromatorSpec::default(), now), tape),
        "newport-1830c" => line(Newport1830cTwin::new(SimLamp::steady(1e-3, now), now), tape),
        "thorlabs-pm100" => usb(
            UsbBus::new("usb:1313:8078:P0001234", Pm100Twin::new(Pm100Spec::new("P0001234"))).connector(clock),
            tape,
        ),
        "oceanoptics-usb" => {
            let twin = OceanTwin::new(OceanSpec::new(OceanModel::Usb2000, "USB2G1234"), now);
            usb(UsbBus::new("usb:2457:1002", twin).connector(clock), tape)
        }
        other => panic!("`{other}` has no twin here"),
    }
}

fn recorded(driver: &str) -> Vec<u8> {
    let tape = Tape::default();
    paused().block_on(session::session(driver, twin_of(driver, &tape))).unwrap_or_else(|e| panic!("{driver}: {e}"));
    let answers = tape.lock().unwrap();
    let counted = |answer: &Vec<u8>| [&u16::try_from(answer.len()).unwrap().to_le_bytes(), answer.as_slice()].concat();
    answers.iter().flat_map(counted).collect()
}

#[test]
fn the_seeds_of_the_drivers_are_what_their_twins_say() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus");
    let mut stale = Vec::new();
    for driver in goniod_drivers::table::DRIVERS {
        if matches!(driver.make, goniod_drivers::table::Make::Camera(_)) {
            continue;
        }
        let path = corpus.join(format!("wire-{}", driver.name)).join("twin");
        let said = recorded(driver.name);
        if std::env::var_os("GONIOD_BLESS").is_some() {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, &said).unwrap();
        }
        if std::fs::read(&path).ok() != Some(said) {
            stale.push(driver.name);
        }
    }
    assert!(stale.is_empty(), "driver or twin of {stale:?} say otherwise now; GONIOD_BLESS=1 writes the seeds anew");
}
