//! Frames that are lost or damaged on the way: every gap is noticed, every damage is marked.

use super::{Bench, grey};
use crate::ensure;
use crate::report::{Outcome, Report};
use crate::v4l2::{acquire, settings};
use goniod_drivers::contract::Camera;
use goniod_drivers::error::ErrorKind;
use goniod_sim::scene::Reading;
use goniod_sim::uvc::{Faults, FrameFault};
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(120);
/// Hands damaged frames on instead of leaving a gap.
const NODROP: &str = "/sys/module/uvcvideo/parameters/nodrop";
/// Frames taken among losses.
const FRAMES: u32 = 120;

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("every-gap-is-noticed", LIMIT, gaps()).await;
    report.check("damaged-frames-are-marked", LIMIT, damaged()).await;
    report.check("a-camera-that-sends-nothing-is-a-timeout", LIMIT, mute()).await;
}

/// The driver's frame numbers must grow by exactly what the twin's record says.
async fn gaps() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let first = acquire(&mut bench.camera, settings(50, 0.0), 1).await?.kept.remove(0);
    *bench.twin().faults() =
        Faults { dropped_per_1000: 60, short_per_1000: 60, error_per_1000: 60, ..Faults::default() };
    for _ in 0..FRAMES {
        bench.camera.next_frame().await?;
    }
    *bench.twin().faults() = Faults::default();
    // The number of a lost picture goes to the one after it; some whole ones later the count is straight.
    let mut last = bench.camera.next_frame().await?;
    let mut whole = 0;
    while whole < 8 || last.info.damaged {
        last = bench.camera.next_frame().await?;
        whole += 1;
    }
    let sequence = |frame| match bench.read(frame) {
        Reading::Whole(tag) => bench.truth(tag).map(|t| t.sequence).ok_or("no record of the frame"),
        _ => Err("a frame without faults is damaged"),
    };
    let (from, to) = (sequence(&first)?, sequence(&last)?);
    let noticed = last.info.device_frame_id - first.info.device_frame_id;
    let lost = {
        let twin = bench.twin();
        let between = twin.truth().iter().filter(|t| t.sequence > from && t.sequence <= to);
        between.filter(|t| t.fault.is_some()).count()
    };
    let counters = bench.camera.counters().await?;
    bench.close().await?;
    ensure!(lost > 0, "no frame was lost");
    ensure!(noticed == to - from, "the driver counts {noticed} frames, the twin sent {} ({counters:?})", to - from);
    ensure!(counters.lost as usize >= lost, "{lost} lost, {} noticed", counters.lost);
    Ok(format!("{noticed} frames by the driver's count and by the twin's, {lost} of them lost; {counters:?}"))
}

/// With `nodrop` the kernel hands damaged frames on: each one is marked, no whole one is.
async fn damaged() -> Outcome {
    std::fs::write(NODROP, "1")?;
    let outcome = damaged_frames().await;
    std::fs::write(NODROP, "0")?;
    outcome
}

async fn damaged_frames() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    acquire(&mut bench.camera, settings(50, 0.0), 1).await?;
    *bench.twin().faults() = Faults { short_per_1000: 100, error_per_1000: 100, ..Faults::default() };
    let (mut marked, mut passed, mut late, mut wrong) = (0, 0, 0, Vec::new());
    for _ in 0..FRAMES {
        let frame = bench.camera.next_frame().await?;
        let reading = bench.read(&frame);
        let fault = match reading {
            Reading::Whole(tag) => bench.truth(tag).and_then(|t| t.fault),
            _ => Some(FrameFault::Short),
        };
        match (frame.info.damaged, fault) {
            (true, Some(_)) => marked += 1,
            (false, None) => passed += 1,
            // The kernel copies pictures on several threads; one that overtakes another makes that one late.
            (true, None) => late += 1,
            (damaged, fault) => wrong.push(format!("damaged {damaged}, fault {fault:?}, {reading:?}")),
        }
    }
    let counters = bench.camera.counters().await?;
    bench.close().await?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    ensure!(late <= counters.stale, "{late} whole frames marked, {counters:?}");
    ensure!(marked > 0 && passed > 0, "{marked} marked, {passed} passed");
    Ok(format!("{marked} damaged frames marked, {passed} whole ones passed, {late} came late; {counters:?}"))
}

/// No picture comes, though the camera answers: the driver says so in time, and goes on when pictures come again.
async fn mute() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let want = settings(50, 0.0);
    acquire(&mut bench.camera, want, 1).await?;
    bench.twin().faults().mute = true;
    bench.camera.arm().await?;
    let error = loop {
        if let Err(error) = bench.camera.next_frame().await {
            break error;
        }
    };
    bench.twin().faults().mute = false;
    ensure!(error.kind == ErrorKind::Timeout, "{error}");
    let again = acquire(&mut bench.camera, want, 1).await?;
    let wrong = bench.wrong(&again, want);
    bench.close().await?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    Ok(error.message)
}
