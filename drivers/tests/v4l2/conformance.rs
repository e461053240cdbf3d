//! The safe part of the conformance suite, as every camera meets it.

use crate::bench::{Bench, config};
use crate::shim::twin::Plan;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::{Finding, SAFE, Subject, check};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_camera_passes_the_safe_checks() {
    let bench = Bench::closed(Plan::default(), config("conformance"));
    let mut subject = Subject::Camera(Box::new(bench.camera));
    let findings = check(&mut subject, Clock::system(), &mut |_| ()).await;
    let failed: Vec<&Finding> = findings.iter().filter(|finding| finding.verdict.failed()).collect();
    assert!(failed.is_empty(), "{failed:#?}");
    assert_eq!(findings.len(), SAFE.len());
}
