//! Keys of the instrument file for what a night does about failing devices and tripped interlocks.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// What to do when a device stayed lost beyond its longest outage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AfterOutage {
    /// Stay suspended in the safe state until somebody resumes, stops or aborts.
    Suspend,
    /// End the run in the safe state.
    End,
    /// List the views that need the device as missing and go on with the others.
    GiveUp,
}

/// What is done about failing devices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recovery {
    /// Attempts after the first failure of a device in an exposure.
    pub attempts: u32,
    /// Waits before the first, second, … attempt; the last holds for all further ones.
    pub backoff_s: Vec<f64>,
    /// How long a lost device is waited for.
    pub longest_outage_s: f64,
    /// What follows then; absent: cameras are given up, anything else ends the run.
    pub after_outage: Option<AfterOutage>,
    /// Other numbers for single devices, by name.
    pub device: BTreeMap<String, DeviceRecovery>,
}

/// Other numbers for one device.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DeviceRecovery {
    /// As in [`Recovery`].
    pub attempts: Option<u32>,
    /// As in [`Recovery`].
    pub backoff_s: Option<Vec<f64>>,
    /// As in [`Recovery`].
    pub longest_outage_s: Option<f64>,
    /// As in [`Recovery`].
    pub after_outage: Option<AfterOutage>,
}

/// Conditions under which exposures wait or the run ends; each is watched where its key is there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Interlocks {
    /// How often gauges are read.
    pub period_s: f64,
    /// Least time from the start of the run to the first exposure.
    pub warm_up_s: f64,
    /// Relative change of the light monitor since the start that suspends.
    pub lamp_drift_warning: Option<f64>,
    /// Relative change of the light monitor since the start that ends the run.
    pub lamp_drift_alarm: Option<f64>,
    /// Relative change of the light monitor within one bracket after which the bracket is taken again.
    pub drift_per_view: Option<f64>,
    /// Temperature of a camera that suspends.
    pub temperature_warning_c: Option<f64>,
    /// Temperature of a camera that ends the run.
    pub temperature_alarm_c: Option<f64>,
    /// Heed the shutter's interlock contact; open, it ends the run.
    pub door: bool,
    /// Free room of the run's disk that suspends.
    pub free_disk_warning_mb: Option<f64>,
    /// Free room of the run's disk that ends the run.
    pub free_disk_alarm_mb: Option<f64>,
    /// How long a run may stay suspended before it ends.
    pub longest_suspension_s: f64,
}

// === impl Recovery ===

impl Default for Recovery {
    fn default() -> Recovery {
        Recovery {
            attempts: 3,
            backoff_s: vec![1.0, 5.0, 20.0],
            longest_outage_s: 1800.0,
            after_outage: None,
            device: BTreeMap::new(),
        }
    }
}

// === impl Interlocks ===

impl Default for Interlocks {
    fn default() -> Interlocks {
        Interlocks {
            period_s: 10.0,
            warm_up_s: 0.0,
            lamp_drift_warning: None,
            lamp_drift_alarm: None,
            drift_per_view: None,
            temperature_warning_c: None,
            temperature_alarm_c: None,
            door: false,
            free_disk_warning_mb: None,
            free_disk_alarm_mb: None,
            longest_suspension_s: 3600.0,
        }
    }
}

impl Interlocks {
    /// How often gauges are read.
    pub fn period(&self) -> Duration {
        seconds(self.period_s)
    }

    /// How long a run may stay suspended.
    pub fn longest_suspension(&self) -> Duration {
        seconds(self.longest_suspension_s)
    }
}

/// A checked number of seconds; what is none is zero.
pub fn seconds(s: f64) -> Duration {
    Duration::try_from_secs_f64(s).unwrap_or_default()
}
