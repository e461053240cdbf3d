//! What the last daemon left: entries under way when it ended, runs that are gone, files that cannot be read.

use super::entry::{Ended, Entry, EntryState, Products, Work};
use super::hub::Hub;
use super::queue::BadEntry;
use super::worker::{change, fail};
use crate::front::runs::{RunStatus, status_of};

/// What the last daemon left.
#[derive(Default)]
pub struct Left {
    /// The bench may stand as a run left it.
    pub bench: bool,
    /// A run will be gone on with by itself, and makes the bench safe at its end.
    pub goes_on: bool,
    /// Why somebody must look before the next entry.
    pub hold: Option<String>,
}

/// Entries that a crash left as running although their run was over: writes their end. Gives the others a place at the
/// head of the queue, or, where the instrument does not want that, tells them as failed.
pub fn settle(hub: &Hub) -> Left {
    let bad = hub.queue(|q| q.bad().first().cloned());
    let unread = |b: BadEntry| {
        format!("{} cannot be read ({}); its run may have been cut short, look at it", b.path.display(), b.reason)
    };
    let mut left = Left { bench: bad.is_some(), hold: bad.map(unread), ..Left::default() };
    let running: Vec<Entry> =
        hub.queue(|q| q.entries().filter(|e| matches!(e.state, EntryState::Running { .. })).cloned().collect());
    for entry in running {
        let EntryState::Running { run } = &entry.state else { continue };
        let path = hub.facts.runs_dir.join(run);
        match status_of(&path) {
            None if !path.exists() && !entry.begun => {
                change(hub, entry.id, |e| e.state = EntryState::Waiting);
            }
            None if !path.exists() => {
                let why = format!("its run directory {} is gone: is its disk mounted?", path.display());
                let reason = format!("{why} When it is back, `goniod resume {run}` goes on with it");
                fail(hub, &entry, Some(run), reason);
                left = Left { bench: true, hold: Some(format!("{run} was cut short; {why}")), ..left };
            }
            Some(status) if status.is_finished() => is_done(hub, &entry, run, status),
            _ if hub.facts.auto_resume || matches!(entry.work, Work::Resume { .. }) => {
                left.bench = true;
                left.goes_on |= hub.queue(|queue| queue.held().is_none());
            }
            _ => {
                left.bench = true;
                let reason =
                    format!("the daemon ended in the middle of this run; `goniod resume {run}` goes on with it");
                fail(hub, &entry, Some(run), reason);
            }
        }
    }
    left
}

/// Writes the end that the run's own journal tells.
fn is_done(hub: &Hub, entry: &Entry, run: &str, status: RunStatus) {
    let products = if status.stored > 0 { Products::Pending } else { Products::None };
    let outcome = Ended {
        ending: status.state,
        stored: status.stored,
        missing: status.missing,
        planned: 0,
        safe: status.safe,
        message: None,
    };
    change(hub, entry.id, |e| {
        e.state = EntryState::Done { run: run.to_owned(), outcome };
        e.products = products;
    });
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used)]
    use super::*;
    use crate::front::daemon::hub::Facts;
    use crate::front::daemon::queue::Queue;
    use goniod_drivers::clock::{Clock, UtcMicros};
    use std::path::Path;

    /// A daemon's state with one entry under way when it was killed.
    fn killed(state: &Path, begun: bool) -> Queue {
        let mut queue = Queue::open(state).unwrap();
        let staged = queue.stage().unwrap();
        queue.add(staged, Work::Resume { run: "r".to_owned() }, "2026-01-01T18:00:00Z".to_owned()).unwrap();
        let under_way = |e: &mut Entry| (e.state, e.begun) = (EntryState::Running { run: "r".to_owned() }, begun);
        queue.set(1, under_way).unwrap();
        Queue::open(state).unwrap()
    }

    fn settled(state: &Path, queue: Queue) -> (Hub, Left) {
        let (instrument, runs_dir) = (state.join("instrument.toml"), state.join("runs"));
        let facts = Facts { name: "n".to_owned(), instrument, runs_dir, auto_resume: true };
        let hub = Hub::new(facts, queue, Clock::starting_at(UtcMicros(0)));
        let left = settle(&hub);
        (hub, left)
    }

    #[test]
    fn a_run_whose_folder_is_gone_is_not_begun_anew_and_somebody_must_look() {
        let state = tempfile::tempdir().unwrap();
        let (hub, left) = settled(state.path(), killed(state.path(), true));
        assert!(left.bench && left.hold.unwrap().contains("is its disk mounted?"));
        assert!(hub.queue(|q| matches!(&q.get(1).unwrap().state, EntryState::Failed { run: Some(_), .. })));
    }

    #[test]
    fn a_run_whose_folder_was_never_made_waits_again() {
        let state = tempfile::tempdir().unwrap();
        let (hub, left) = settled(state.path(), killed(state.path(), false));
        assert!(!left.bench && left.hold.is_none());
        assert!(hub.queue(|q| q.get(1).unwrap().state == EntryState::Waiting));
    }

    #[test]
    fn an_entry_that_cannot_be_read_may_have_left_the_bench_anyhow() {
        let state = tempfile::tempdir().unwrap();
        drop(killed(state.path(), true));
        std::fs::write(state.path().join("queue/000001/entry.json"), "{\"id\": 1, \"sta").unwrap();
        let (_, left) = settled(state.path(), Queue::open(state.path()).unwrap());
        assert!(left.bench && left.hold.unwrap().contains("000001"));
    }
}
