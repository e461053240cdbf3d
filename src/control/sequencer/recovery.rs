//! From a device's error to what is done about it: one pure function.

use goniod_drivers::error::ErrorKind;
use std::time::Duration;

/// What is done about an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// Try again after this time; open the device anew before that when `reopen`.
    Retry {
        /// Wait.
        after: Duration,
        /// Open anew and prove the identity.
        reopen: bool,
    },
    /// List the exposure as missing and go on with the next.
    GiveUp,
    /// End the run safely.
    End,
}

/// Waits before the first, second and every further retry.
const WAITS: [Duration; 3] = [Duration::from_secs(1), Duration::from_secs(5), Duration::from_secs(20)];

/// Exposures given up in a row for the same device, after which it gets one try an exposure and no waits.
pub const GIVEN_UP_BEFORE_SHORT: u32 = 3;

/// What to do about an error of `kind` after `failed` failures in this exposure (at least 1), with `retries` allowed and
/// `given_up` exposures given up in a row for the same device.
pub fn decide(kind: ErrorKind, failed: u32, retries: u32, given_up: u32) -> Decision {
    let reopen = match kind {
        ErrorKind::Refused | ErrorKind::WrongDevice => return Decision::End,
        ErrorKind::Busy => false,
        ErrorKind::Timeout | ErrorKind::Garbled | ErrorKind::Lost | ErrorKind::Broken => true,
    };
    if failed > retries || given_up >= GIVEN_UP_BEFORE_SHORT {
        return Decision::GiveUp;
    }
    let [first, second, further] = WAITS;
    let after = match failed {
        0 | 1 => first,
        2 => second,
        _ => further,
    };
    Decision::Retry { after, reopen }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusals_end_the_run_and_everything_else_is_tried_a_bounded_number_of_times() {
        use ErrorKind::{Broken, Busy, Garbled, Lost, Refused, Timeout, WrongDevice};
        for kind in [Refused, WrongDevice] {
            assert_eq!(decide(kind, 1, 3, 0), Decision::End);
        }
        for kind in [Busy, Timeout, Garbled, Lost, Broken] {
            for failed in 1..=3 {
                let Decision::Retry { reopen, .. } = decide(kind, failed, 3, 0) else {
                    unreachable!("{kind:?} {failed}");
                };
                assert_eq!(reopen, kind != Busy);
            }
            assert_eq!(decide(kind, 4, 3, 0), Decision::GiveUp);
            assert_eq!(decide(kind, 1, 3, GIVEN_UP_BEFORE_SHORT), Decision::GiveUp);
        }
    }
}
