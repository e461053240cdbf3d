//! The host's side of the guest's serial ports: twins behind two lines, results and orders on a third.
//!
//! An order of a probe (`ORDER unplug`, `ORDER plug`, `ORDER angle DEGREES`) pulls the USB serial adapter out of the
//! guest or puts it back through the emulator's monitor, or judges the holder's true angle.

use goniod_drivers::clock::Clock;
use goniod_sim::firmware::Firmware;
use goniod_sim::firmware::sc10::Sc10Twin;
use goniod_sim::firmware::zaber::{ZaberChainTwin, ZaberStage};
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::{UnixListener, UnixStream};
use tokio::time::Instant;

/// Serial number of the holder's stage.
pub const STAGE: &str = "1001";
/// What the emulator calls the USB serial adapter, and how it is made.
const ADAPTER: &str = "adapter0";
const ADAPTER_DEVICE: &str = "usb-serial,chardev=adapter,bus=xhci.0,id=adapter0";
/// Longest rest of a twin that has nothing to say.
const IDLE: Duration = Duration::from_secs(3600);

type Shared<T> = Arc<Mutex<T>>;

/// Serves the sockets in `dir` until the guest has ended, and writes its results to standard output.
pub async fn run(dir: &Path) -> ExitCode {
    match serve(dir).await {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let _ = writeln!(std::io::stderr(), "bench: {error}");
            ExitCode::FAILURE
        }
    }
}

async fn serve(dir: &Path) -> std::io::Result<()> {
    let now = Instant::now();
    let holder = Arc::new(Mutex::new(ZaberChainTwin::new(vec![ZaberStage::new(STAGE)], now)));
    let results = UnixListener::bind(dir.join("results.sock"))?;
    tokio::spawn(line(UnixListener::bind(dir.join("line.sock"))?, Arc::new(Mutex::new(Sc10Twin::new(now)))));
    tokio::spawn(line(UnixListener::bind(dir.join("adapter.sock"))?, Arc::clone(&holder)));
    let (stream, _) = results.accept().await?;
    let mut lines = BufReader::new(stream).lines();
    let mut out = std::io::stdout();
    while let Some(text) = lines.next_line().await? {
        let text = text.trim();
        match text.split_whitespace().collect::<Vec<_>>().as_slice() {
            ["ORDER", "unplug"] => monitor(dir, &format!("device_del {ADAPTER}")).await?,
            ["ORDER", "plug"] => monitor(dir, &format!("device_add {ADAPTER_DEVICE}")).await?,
            ["ORDER", "angle", degrees] => writeln!(out, "{}", judge(&holder, degrees))?,
            _ => writeln!(out, "{text}")?,
        }
        out.flush()?;
        if text == "END" {
            break;
        }
    }
    Ok(())
}

/// One order to the emulator, given again for a while where it is refused: a device that was pulled out lets go of its
/// line a moment later.
async fn monitor(dir: &Path, order: &str) -> std::io::Result<()> {
    let clock = Clock::system();
    loop {
        let heard = say(dir, order).await?;
        match heard.split("Error: ").nth(1) {
            Some(_) if clock.elapsed() < Duration::from_secs(20) => clock.sleep(Duration::from_millis(100)).await,
            Some(error) => return Err(std::io::Error::other(format!("{order}: {error}"))),
            None => return Ok(()),
        }
    }
}

/// What the emulator answers; its monitor echoes and prompts, and the order is taken when a prompt follows it.
async fn say(dir: &Path, order: &str) -> std::io::Result<String> {
    let mut stream = UnixStream::connect(dir.join("monitor.sock")).await?;
    stream.write_all(format!("{order}\n").as_bytes()).await?;
    let mut heard = String::new();
    let mut chunk = [0; 256];
    while heard.matches("(qemu)").count() < 2 {
        match stream.read(&mut chunk).await? {
            0 => break,
            n => heard.push_str(&String::from_utf8_lossy(&chunk[..n])),
        }
    }
    Ok(heard)
}

/// The stage's true angle, past its driver.
fn judge(holder: &Shared<ZaberChainTwin>, degrees: &str) -> String {
    let is = lock(holder).angle_deg(1, Instant::now());
    match (is, degrees.parse::<f64>()) {
        (Some(is), Ok(should)) if (is - should).abs() < 0.01 => {
            format!("PASS serial/the-stage-stands-at-{degrees}: {is:.4}")
        }
        _ => format!("FAIL serial/the-stage-stands-at-{degrees}: {is:?}"),
    }
}

fn lock<T>(twin: &Shared<T>) -> MutexGuard<'_, T> {
    twin.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A twin behind a serial line that the emulator opens again and again.
async fn line<T: Firmware>(listener: UnixListener, twin: Shared<T>) {
    while let Ok((stream, _)) = listener.accept().await {
        lock(&twin).connected(Instant::now());
        let _ = carry(stream, &twin).await;
    }
}

async fn carry<T: Firmware>(mut stream: UnixStream, twin: &Shared<T>) -> std::io::Result<()> {
    let clock = Clock::system();
    let mut chunk = [0; 256];
    loop {
        let bytes = lock(twin).take(clock.now());
        stream.write_all(&bytes).await?;
        let due = lock(twin).due().unwrap_or(clock.now() + IDLE);
        tokio::select! {
            read = stream.read(&mut chunk) => match read? {
                0 => return Ok(()),
                n => lock(twin).receive(&chunk[..n], clock.now()),
            },
            () = clock.sleep_until(due) => {}
        }
    }
}
