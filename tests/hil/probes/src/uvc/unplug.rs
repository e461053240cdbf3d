//! The camera's plug is pulled in mid-stream: noticed as lost, opened again by the same link, bracket retaken.

use super::{BUSID, Bench, CARD, grey};
use crate::ensure;
use crate::report::{Outcome, Report};
use crate::v4l2::{self, acquire, settings};
use goniod_drivers::contract::{Camera, Device};
use goniod_drivers::error::ErrorKind;
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(120);
const TIMES: [u64; 4] = [10, 40, 160, 640];
/// Steps of the bracket at which the plug is pulled.
const PULLS: [usize; 3] = [0, 1, 3];

/// Runs the subject.
pub async fn run(report: &mut Report) {
    report.check("in-mid-stream", LIMIT, pulled()).await;
    report.check("frozen-and-pulled", LIMIT, frozen()).await;
}

/// Pulled at several steps of a bracket; each bracket is retaken whole.
async fn pulled() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let (mut kept, mut wrong, mut messages) = (0, Vec::new(), Vec::new());
    for pull_at in PULLS {
        for step in 0..TIMES.len() {
            let want = settings(TIMES[step], 5.0);
            if step == pull_at {
                bench.camera.apply(want).await?;
                bench.camera.arm().await?;
                bench.pull();
                messages.push(lost(&mut bench).await?);
                v4l2::gone(CARD).await?;
                ensure!(bench.camera.open().await.is_err_and(|e| e.kind == ErrorKind::Lost), "opened without a camera");
                bench.plug().await?;
                bench.camera.open().await?;
                let early = bench.camera.arm().await;
                ensure!(early.is_err_and(|e| e.kind == ErrorKind::Refused), "armed with settings of power-up");
                break;
            }
            let acquired = acquire(&mut bench.camera, want, 1).await?;
            wrong.extend(bench.wrong(&acquired, want));
        }
        for time in TIMES {
            let want = settings(time, 5.0);
            let acquired = acquire(&mut bench.camera, want, 1).await?;
            kept += acquired.kept.len();
            wrong.extend(bench.wrong(&acquired, want));
        }
    }
    ensure!(bench.server.is_imported(BUSID), "the camera is still plugged in");
    bench.close().await?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    messages.dedup();
    Ok(format!("{} pulls, {kept} frames retaken, 0 wrong labels; {messages:?}", PULLS.len()))
}

/// Frames that came before the pull may still be handed out; then the loss is said.
async fn lost(bench: &mut Bench) -> Result<String, Box<dyn std::error::Error + Send + Sync>> {
    for _ in 0..20 {
        match bench.camera.next_frame().await {
            Ok(_) => {}
            Err(error) if error.kind == ErrorKind::Lost => return Ok(error.message),
            Err(error) => return Err(format!("a pulled plug is {:?}: {error}", error.kind).into()),
        }
    }
    Err("frames come from a camera that is not there".into())
}

/// The camera's firmware hangs, then it is pulled and plugged: the driver's calls end and it opens again.
async fn frozen() -> Outcome {
    let mut bench = Bench::open(grey()).await?;
    let want = settings(20, 5.0);
    acquire(&mut bench.camera, want, 1).await?;
    bench.twin().faults().frozen = true;
    let hung = acquire(&mut bench.camera, settings(40, 5.0), 1).await.err();
    bench.pull();
    v4l2::gone(CARD).await?;
    bench.twin().faults().frozen = false;
    bench.plug().await?;
    bench.camera.open().await?;
    let acquired = acquire(&mut bench.camera, want, 1).await?;
    let wrong = bench.wrong(&acquired, want);
    bench.close().await?;
    ensure!(wrong.is_empty(), "{wrong:?}");
    let hung = hung.ok_or("a frozen camera took settings")?;
    Ok(format!("frozen: {:?} {}", hung.kind, hung.message))
}
