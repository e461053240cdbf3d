//! Promise: silence is noticed soon: a serial line within two time-outs of its driver, a camera within exposure, read-out
//! and two seconds, whatever the kind. Real drivers, firmware twins that stop answering, simulated time.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;
#[path = "common/tiny.rs"]
mod tiny;

use goniod::control::devices::bench::{Bench, DeviceId};
use goniod::front::bench::{Faults, Rehearsal, open_simulated};
use goniod_drivers::clock::{Clock, UtcMicros};
use goniod_drivers::contract::CameraSettings;
use goniod_drivers::error::ErrorKind;
use goniod_drivers::units::ExposureTime;
use goniod_sim::camera::CameraFault;
use goniod_sim::firmware::fw212c::WheelFault;
use goniod_sim::firmware::outbox::WireFault::NoReply;
use goniod_sim::firmware::sc10::ShutterFault;
use goniod_sim::firmware::zaber::ZaberFault;
use goniod_sim::twins::Fault;
use std::future::Future;
use std::time::Duration;
use tiny::{Tiny, scan_text};

/// Answers that do not come: more than any driver asks for again.
const SILENT: usize = 64;

/// The line is drained before it is used again.
const QUIET: Duration = Duration::from_millis(250);

fn on_an_open_bench<F: Future<Output = ()>>(work: impl FnOnce(Bench, Faults, Clock) -> F) {
    let tiny = Tiny::new(&scan_text(1));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build().unwrap();
    runtime.block_on(async {
        let clock = Clock::starting_at(UtcMicros(0));
        let opened = open_simulated(&tiny.checked, &Rehearsal::default(), clock).unwrap();
        let (mut bench, faults) = (opened.bench, opened.faults.unwrap());
        bench.open_all(clock).await.unwrap();
        work(bench, faults, clock).await;
    });
}

#[test]
fn a_silent_serial_line_is_noticed_within_two_time_outs() {
    let silences = [
        (DeviceId::Shutter, Fault::Shutter(ShutterFault::Wire(NoReply)), Duration::from_secs(1)),
        (DeviceId::FilterWheel, Fault::Wheel(WheelFault::Wire(NoReply)), Duration::from_secs(1)),
        (DeviceId::Tilt, Fault::Holder(ZaberFault::Wire(NoReply)), Duration::from_millis(500)),
    ];
    for (id, fault, time_out) in silences {
        on_an_open_bench(async |mut bench, faults, clock| {
            (0..SILENT).for_each(|_| faults.twins.inject(fault.clone()));
            let asked = clock.now();
            let found = bench.resynchronise(&id, clock).await.unwrap_err();
            let noticed = clock.now() - asked;
            eprintln!("{id}: {noticed:?}");
            assert!(matches!(found.error.kind, ErrorKind::Timeout | ErrorKind::Lost), "{found}");
            assert!(noticed <= 2 * time_out + QUIET, "{id}: {noticed:?}");
        });
    }
}

#[test]
fn a_camera_that_gives_no_frame_is_noticed_within_exposure_readout_and_two_seconds() {
    for (name, exposure_s, readout_s) in [("ccd", 2.5, 0.06), ("ingaas", 0.02, 0.01)] {
        on_an_open_bench(async |mut bench, faults, clock| {
            let camera = bench.devices.cameras.get_mut(name).unwrap();
            let exposure = ExposureTime::from_seconds(exposure_s);
            camera.apply(CameraSettings { exposure, gain: 0.0 }).await.unwrap();
            let armed = camera.arm().await.unwrap();
            faults.cameras[name].push(CameraFault::NoFrame);
            let due = clock.now();
            // As the sequencer waits: no longer than the camera's own promise.
            let waited = clock.timeout(armed.due_within, camera.next_frame()).await;
            let noticed = (clock.now() - due).as_secs_f64();
            eprintln!("{name}: {noticed} s");
            assert!(waited.is_err() || waited.unwrap().is_err(), "{name}");
            // Restarting the stream with new settings is part of the exposure's way to the host.
            assert!(noticed <= exposure_s + readout_s + 0.1 + 2.0, "{name}: {noticed} s");
        });
    }
}
