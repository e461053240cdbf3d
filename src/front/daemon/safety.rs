//! The safe state without a run: asked for by an operator, or after a run that nobody goes on with.

use super::hub::Hub;
use crate::config::instrument::Instrument;
use crate::config::load::load;
use crate::control::devices::safe::SafeResult;
use crate::front::bench::open_direct;

/// Opens what the safe state lists and makes it safe; the caller holds [`Hub::bench`]. Gives each device's result.
///
/// # Errors
/// One sentence: an instrument file or a driver that cannot be used, or which devices did not prove that they are safe.
pub async fn make_safe(hub: &Hub) -> Result<String, String> {
    let instrument = load::<Instrument>(&hub.facts.instrument, "instrument").map_err(|e| e.to_string())?.value;
    let mut bench = open_direct(&instrument, hub.clock).map_err(|e| e.to_string())?;
    let reports = bench.make_safe(&instrument.safe_state, hub.clock).await;
    let words: Vec<String> = reports.iter().map(|r| format!("{} {}", r.device, r.outcome.word())).collect();
    let words = words.join(", ");
    if reports.iter().all(|r| r.outcome == SafeResult::Confirmed) {
        return Ok(words);
    }
    Err(format!("NOT PROVEN SAFE, look at the bench: {words}"))
}
