//! The SC10 driver against the shutter's twin.

use super::{Bench, bench};
use goniod_drivers::clock::Clock;
use goniod_drivers::contract::ShutterState::{Closed, Open};
use goniod_drivers::error::ErrorKind;
use goniod_drivers::transport::Connector;
use goniod_sim::firmware::WireFault;
use goniod_sim::firmware::sc10::ShutterFault;
use goniod_sim::pose::PoseSource;
use goniod_sim::twins::Fault;
use std::time::Duration;
use tokio::time::Instant;

async fn open() -> Bench {
    let mut bench = bench();
    bench.shutter.open().await.unwrap();
    bench
}

fn inject(bench: &Bench, fault: ShutterFault) {
    bench.twins.inject(Fault::Shutter(fault));
}

fn light(bench: &Bench) -> bool {
    bench.twins.pose(Instant::now()).shutter_open
}

#[tokio::test(start_paused = true)]
async fn the_twin_speaks_the_worked_exchange() {
    let bench = bench();
    let clock = Clock::system();
    let mut link = bench.twins.shutter.connector(clock).connect().await.unwrap();
    for (request, reply) in [
        ("\r", "\rCommand error CMD_NOT_DEFINED\r"),
        ("id?\r", "id?\rTHORLABS SC10 VERSION 1.07\r"),
        ("mode=1\r", "mode=1\r"),
        ("ens?\r", "ens?\r0\r"),
        ("ens\r", "ens\r"),
        ("closed?\r", "closed?\r0\r"),
        ("ens\r", "ens\r"),
        ("closed?\r", "closed?\r1\r"),
        ("rep=200\r", "rep=200\rCommand error CMD_ARG_INVALID\r"),
    ] {
        link.send(request.as_bytes()).await.unwrap();
        let text = link.prompt(clock.now() + Duration::from_millis(100)).await.unwrap().unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), reply);
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
}

#[tokio::test(start_paused = true)]
async fn set_opens_and_closes_and_knows() {
    let mut bench = open().await;
    for state in [Open, Open, Closed, Open, Closed, Closed] {
        bench.shutter.set(state).await.unwrap();
        assert_eq!(light(&bench), state == Open);
        assert_eq!(bench.shutter.state().await.unwrap(), Some(state));
    }
}

#[tokio::test(start_paused = true)]
async fn a_toggle_whose_answer_is_lost_is_never_doubled() {
    let faults = [
        ShutterFault::PromptLostAfterToggle,
        ShutterFault::EchoLost,
        ShutterFault::FirstSwallowed,
        ShutterFault::Wire(WireFault::NoReply),
        ShutterFault::Wire(WireFault::Late(Duration::from_millis(900))),
        ShutterFault::Wire(WireFault::Cut(2)),
        ShutterFault::Wire(WireFault::Corrupt(1, 0x01)),
        ShutterFault::Wire(WireFault::Previous),
        ShutterFault::Wire(WireFault::Duplicate),
        ShutterFault::Wire(WireFault::Junk(b"> ".to_vec())),
    ];
    let mut bench = open().await;
    for fault in faults {
        for before in 0..12 {
            for state in [Open, Closed] {
                if let ShutterFault::Wire(_) = fault {
                    (0..before).for_each(|_| inject(&bench, ShutterFault::Wire(WireFault::Pass)));
                }
                inject(&bench, fault.clone());
                let set = bench.shutter.set(state).await;
                set.unwrap_or_else(|e| panic!("{fault:?} after {before}: {e}"));
                assert_eq!(light(&bench), state == Open, "{fault:?} after {before}");
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_stuck_blade_is_broken_either_way() {
    let mut bench = open().await;
    inject(&bench, ShutterFault::Stuck(true));
    let error = bench.shutter.set(Open).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Broken);
    assert!(error.message.contains("blade stuck"), "{error}");
    assert_eq!(bench.shutter.state().await.unwrap(), None, "command and sensor disagree");
    inject(&bench, ShutterFault::Stuck(false));
    bench.shutter.set(Open).await.unwrap();
    inject(&bench, ShutterFault::Stuck(true));
    assert_eq!(bench.shutter.set(Closed).await.unwrap_err().kind, ErrorKind::Broken);
    assert_eq!(
        bench.shutter.make_safe().await.unwrap_err().kind,
        ErrorKind::Broken,
        "a safe state is proven or failed"
    );
}

#[tokio::test(start_paused = true)]
async fn a_dead_sensor_is_no_proof_of_a_closed_shutter() {
    let mut bench = open().await;
    bench.shutter.set(Open).await.unwrap();
    inject(&bench, ShutterFault::SensorDead(true));
    assert_eq!(bench.shutter.set(Closed).await.unwrap_err().kind, ErrorKind::Broken);
    assert_eq!(bench.shutter.state().await.unwrap(), None);
}

#[tokio::test(start_paused = true)]
async fn a_tripped_interlock_keeps_it_closed_until_it_is_restored() {
    let mut bench = open().await;
    bench.shutter.set(Open).await.unwrap();
    inject(&bench, ShutterFault::Interlock(true));
    tokio::time::sleep(Duration::from_millis(20)).await;
    assert!(!light(&bench));
    assert_eq!(bench.shutter.state().await.unwrap(), Some(Closed));
    let error = bench.shutter.set(Open).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Refused);
    assert!(error.message.contains("interlock"), "{error}");
    bench.shutter.set(Closed).await.unwrap();
    bench.shutter.make_safe().await.unwrap();
    inject(&bench, ShutterFault::Interlock(false));
    bench.shutter.set(Open).await.unwrap();
    assert!(light(&bench));
}

#[tokio::test(start_paused = true)]
async fn the_front_key_is_seen_and_another_mode_is_mended_by_open() {
    let mut bench = open().await;
    inject(&bench, ShutterFault::FrontKey);
    tokio::time::sleep(Duration::from_millis(20)).await;
    assert_eq!(bench.shutter.state().await.unwrap(), Some(Open));
    bench.shutter.set(Closed).await.unwrap();
    inject(&bench, ShutterFault::Mode(4));
    let error = bench.shutter.set(Open).await.unwrap_err();
    assert!(error.message.contains("mode 4"), "{error}");
    assert_eq!(bench.shutter.health().await.unwrap().warnings, ["not in manual mode"]);
    bench.shutter.open().await.unwrap();
    bench.shutter.set(Open).await.unwrap();
    assert!(light(&bench));
}

#[tokio::test(start_paused = true)]
async fn the_first_request_may_be_swallowed_and_a_restart_is_survived() {
    let mut bench = bench();
    inject(&bench, ShutterFault::FirstSwallowed);
    bench.shutter.open().await.unwrap();
    bench.shutter.set(Open).await.unwrap();
    inject(&bench, ShutterFault::Restart);
    tokio::time::sleep(Duration::from_millis(20)).await;
    assert_eq!(bench.shutter.state().await.unwrap(), Some(Closed), "a restart closes it");
    inject(&bench, ShutterFault::RestartOnCommand);
    bench.shutter.set(Open).await.unwrap();
    assert!(light(&bench));
}

#[tokio::test(start_paused = true)]
async fn make_safe_closes_over_a_fresh_link() {
    let mut bench = open().await;
    bench.shutter.set(Open).await.unwrap();
    bench.twins.inject(Fault::Unplugged("sim:shutter".into(), Duration::from_secs(5)));
    assert_eq!(bench.shutter.make_safe().await.unwrap_err().kind, ErrorKind::Lost);
    assert!(light(&bench));
    tokio::time::sleep(Duration::from_secs(6)).await;
    bench.shutter.make_safe().await.unwrap();
    assert!(!light(&bench));
}
