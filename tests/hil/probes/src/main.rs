//! Probes of the virtual bench: the production drivers against the kernel's own interfaces, behind which stand the twins.
//!
//! `goniod-hil probe SUBJECT` runs in the guest; `goniod-hil bench DIR` runs on the host and holds what stands behind
//! the guest's serial ports. A new subject is a file here, a line in [`run`] and a line in `../../subjects`.

mod bench;
mod loopback;
mod report;
mod serial;
#[cfg(feature = "usb")]
mod usb;
mod uvc;
mod v4l2;
mod vivid;

use goniod_sim::front::usbip::vhci;
use report::Report;

async fn run(subject: &str, report: &mut Report) -> bool {
    match subject {
        "uvc-labels" => uvc::labels::run(report).await,
        "uvc-losses" => uvc::losses::run(report).await,
        "uvc-unplug" => uvc::unplug::run(report).await,
        "loopback" => loopback::run(report).await,
        "vivid" => vivid::run(report).await,
        "serial" => serial::run(report).await,
        #[cfg(feature = "usb")]
        "usb" => usb::run(report).await,
        _ => return false,
    }
    true
}

#[tokio::main(flavor = "multi_thread", worker_threads = 2)]
async fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["bench", dir] => bench::run(dir.as_ref()).await,
        ["probe", subject] => {
            let mut report = Report::new(subject);
            if !run(subject, &mut report).await {
                report.fail("subject", "no subject has this name");
            }
            report.end()
        }
        _ => std::process::ExitCode::from(2),
    }
}
