//! Brackets of swept integration times through `uvcvideo`: no frame under a wrong label.

use super::{Bench, grey, mosaic};
use crate::ensure;
use crate::report::{Outcome, Report};
use crate::v4l2::{acquire, settings};
use goniod_drivers::contract::Camera;
use goniod_sim::uvc::{Faults, FrameFault};
use std::collections::BTreeMap;
use std::time::Duration;

/// Ten integration times in 100 us, 0.1 to 51.2 ms.
const TIMES: [u64; 10] = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512];
const LIMIT: Duration = Duration::from_secs(150);

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("the-large-mosaic-brackets", LIMIT, sweep(mosaic(), 1, Faults::default())).await;
    let lies = Faults {
        half_changed: true,
        stale_per_1000: 20,
        repeated_per_1000: 20,
        short_per_1000: 20,
        error_per_1000: 20,
        dropped_per_1000: 20,
        ..Faults::default()
    };
    report.check("brackets-among-lying-frames", LIMIT, sweep(grey(), 4, lies)).await;
    report.check("a-moved-bench-is-not-seen-before-it-stands", LIMIT, moved()).await;
    report.check("a-control-changed-by-another-program-is-noticed", LIMIT, meddled()).await;
}

/// Brackets up and down in turn, with another latency of the controls each, and another gain each step.
async fn sweep(mode: goniod_sim::uvc::Mode, brackets: u32, faults: Faults) -> Outcome {
    let mut bench = Bench::open(mode).await?;
    let (mut kept, mut refused, mut wrong) = (0, 0, Vec::new());
    for bracket in 0..brackets {
        *bench.twin().faults() = Faults { latency_frames: (bracket * 2 + 1) % 6, ..faults.clone() };
        for step in 0..TIMES.len() {
            let at = if bracket % 2 == 0 { step } else { TIMES.len() - 1 - step };
            let want = settings(TIMES[at], (step * 20) as f64);
            let acquired = acquire(&mut bench.camera, want, 1).await?;
            kept += acquired.kept.len();
            refused += acquired.refused;
            wrong.extend(bench.wrong(&acquired, want));
        }
    }
    let counters = bench.camera.counters().await?;
    let mut happened: BTreeMap<FrameFault, u32> = BTreeMap::new();
    bench.twin().truth().iter().filter_map(|t| t.fault).for_each(|f| *happened.entry(f).or_default() += 1);
    bench.close().await?;
    ensure!(wrong.is_empty(), "{} wrong labels: {wrong:?}", wrong.len());
    ensure!(kept == TIMES.len() * brackets as usize, "{kept} frames kept");
    if faults.half_changed {
        ensure!(happened.len() >= 5, "too few kinds of faults happened: {happened:?}");
    }
    Ok(format!("{kept} frames kept, 0 wrong labels, {refused} refused; twin {happened:?}; driver {counters:?}"))
}

/// Arms again and again without any change of settings, at long exposures: what began before must not count.
async fn moved() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let want = settings(1500, 0.0);
    let mut checked = 0;
    let mut wrong = Vec::new();
    let mut acquired = acquire(&mut bench.camera, want, 1).await?;
    for pause_ms in [0, 60, 100, 140] {
        goniod_drivers::clock::Clock::system().sleep(Duration::from_millis(pause_ms)).await;
        acquired.armed = bench.camera.arm().await?;
        acquired.kept = vec![bench.camera.next_frame().await?];
        wrong.extend(bench.wrong(&acquired, want));
        checked += 1;
    }
    bench.close().await?;
    ensure!(wrong.is_empty(), "{} frames of a bench that still moved: {wrong:?}", wrong.len());
    Ok(format!("{checked} frames of 150 ms, all begun after the arming"))
}

/// Automatic exposure comes on behind the driver's back.
async fn meddled() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let want = settings(100, 10.0);
    acquire(&mut bench.camera, want, 1).await?;
    let other = v4l::Device::with_path(crate::v4l2::link(super::CARD).await?)?;
    let aperture_priority = v4l::Control { id: 0x009A_0901, value: v4l::control::Value::Integer(3) };
    other.set_control(aperture_priority)?;
    let before = bench.twin().settings();
    ensure!(before.exposure == 333, "the other program took no effect: {before:?}");
    let armed = bench.camera.arm().await;
    let after = bench.twin().settings();
    let noticed = match &armed {
        Ok(_) => after.exposure == 100,
        Err(error) => error.message.contains("changed by themselves"),
    };
    ensure!(noticed, "armed {armed:?} while the camera has {after:?}");
    let again = acquire(&mut bench.camera, want, 1).await?;
    let wrong = bench.wrong(&again, want);
    bench.close().await?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    Ok(format!(
        "automatic exposure switched off again; arming said {}",
        armed.map_or_else(|e| e.message, |_| "yes".into())
    ))
}
