//! Devices one by one, for an operator's hand: made through the same table and instrument file as for a run.

use super::{BenchError, hardware, is_simulated, light};
use crate::config::instrument::Instrument;
use goniod_drivers::clock::Clock;
use goniod_drivers::conformance::Subject;
use goniod_drivers::transport::Connector;
use std::path::Path;

/// A device as the instrument file names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its name: `tilt`, `filter_wheel`, `ccd`, ….
    pub name: String,
    /// Its driver.
    pub driver: String,
    /// Its port.
    pub port: String,
}

/// The devices of an instrument.
pub struct ByHand<'a> {
    instrument: &'a Instrument,
    clock: Clock,
    #[cfg(feature = "sim")]
    simulated: Option<(goniod_sim::twins::Twins, goniod_sim::bench::Bench)>,
}

/// All devices of an instrument file, in the order a run opens them.
pub fn entries(instrument: &Instrument) -> Vec<Entry> {
    let axes = ["changer", "tilt", "spin"]
        .into_iter()
        .filter(|name| *name != "changer" || instrument.holder.changer.is_some());
    let mut all = Vec::new();
    for link in instrument.links() {
        let names = match link.key.as_str() {
            "holder" => axes.clone().collect(),
            key => vec![link.camera().unwrap_or(key)],
        };
        all.extend(names.into_iter().map(|name| Entry {
            name: name.to_owned(),
            driver: link.driver.to_owned(),
            port: link.port.to_owned(),
        }));
    }
    all
}

// === impl ByHand ===

impl<'a> ByHand<'a> {
    /// The devices of `instrument`, whose file lies in `folder`; `sample` lies in a simulated bench.
    ///
    /// # Errors
    /// [`BenchError`]: ports that are mixed, files of a simulated bench that are wrong.
    pub fn new(
        instrument: &'a Instrument,
        folder: &Path,
        sample: Option<&Path>,
        clock: Clock,
    ) -> Result<ByHand<'a>, BenchError> {
        if !is_simulated(instrument)? {
            return Ok(ByHand {
                instrument,
                clock,
                #[cfg(feature = "sim")]
                simulated: None,
            });
        }
        #[cfg(feature = "sim")]
        {
            let simulation = instrument.simulation.as_ref().ok_or(BenchError::NoSimulation)?;
            let description = folder.join(&simulation.bench);
            let usual = description.with_file_name("samples").join("clear_glazing.toml");
            let sample = sample.unwrap_or(&usual);
            let parts = super::simulated::parts(instrument, &description, sample, simulation.seed, clock)?;
            Ok(ByHand { instrument, clock, simulated: Some(parts) })
        }
        #[cfg(not(feature = "sim"))]
        {
            let _ = (folder, sample);
            Err(BenchError::Lacks { what: "simulated bench", feature: "sim" })
        }
    }

    /// Makes the device `name`; `None` when the instrument has none of that name.
    ///
    /// # Errors
    /// [`BenchError`]: a driver that is not in this build or refuses its configuration, a port that does not exist.
    pub fn make(&self, name: &str) -> Result<Option<Subject>, BenchError> {
        let (i, clock) = (self.instrument, self.clock);
        let mut connect = |driver: &str, port: &str| self.connect(driver, port);
        let axis = |n: usize, connect: super::Connect<'_>| {
            Ok(super::holder(i, clock, connect)?.into_iter().nth(n).map(Subject::Axis))
        };
        match name {
            "tilt" => axis(0, &mut connect),
            "spin" => axis(1, &mut connect),
            "changer" => match super::operator(i) {
                Some((operator, _)) => Ok(Some(Subject::Axis(Box::new(operator)))),
                None => axis(2, &mut connect),
            },
            "filter_wheel" => Ok(Some(Subject::Wheel(super::filter_wheel(i, clock, &mut connect)?))),
            "shutter" => Ok(Some(Subject::Shutter(super::shutter(i, clock, &mut connect)?))),
            "light_monitor" => Ok(light::monitor(i, clock, &mut connect)?.map(Subject::LightMonitor)),
            "monochromator" => Ok(light::monochromator(i, clock, &mut connect)?.map(Subject::Monochromator)),
            "spectrometer" => Ok(light::spectrometer(i, clock)?.map(Subject::Spectrometer)),
            camera => self.camera(camera),
        }
    }

    fn camera(&self, name: &str) -> Result<Option<Subject>, BenchError> {
        let Some(camera) = self.instrument.camera.get(name) else { return Ok(None) };
        if !camera.driver.starts_with("sim-") {
            return Ok(Some(Subject::Camera(hardware::camera(name, camera, self.clock)?)));
        }
        #[cfg(feature = "sim")]
        if let Some((_, bench)) = &self.simulated {
            return Ok(Some(Subject::Camera(Box::new(bench.camera(name)?))));
        }
        Err(BenchError::CameraDriver { camera: name.to_owned(), driver: camera.driver.clone() })
    }

    fn connect(&self, driver: &str, port: &str) -> Result<Box<dyn Connector>, BenchError> {
        #[cfg(feature = "sim")]
        if let Some((twins, _)) = &self.simulated {
            return super::simulated::connect(twins, port, self.clock);
        }
        hardware::connect(self.instrument, driver, port, self.clock)
    }
}
