//! What each band and channel measures: spectral kernels, and the quantities that are combined from them.

use super::inputs::{InstrumentSpectra, Standards};
use crate::config::instrument::{FilterSlot, Instrument};
use crate::engine::bsdf::set::Quantity;
use crate::engine::spectra::combine::{Combiner, Prior};
use crate::engine::spectra::curve::Grid;
use crate::engine::spectra::filters::{GlassPlate, stack_transmittance};
use crate::engine::spectra::kernels::{Kernel, irradiance, one_over_h};
use crate::engine::spectra::targets;
use crate::products::error::{ProductError, Result, engine};

/// Share of a target's weight that must lie where kernels reach, for the quantity to be offered.
const REACH: f64 = 0.8;
/// A kernel reaches where it is above this share of its largest value.
const REACH_LEVEL: f64 = 0.02;

/// What the bands measure with, whether they have measured already or not.
#[derive(Clone, Copy)]
pub struct Setup<'a> {
    /// The instrument.
    pub instrument: &'a Instrument,
    /// Bands of the scan.
    pub bands: &'a [String],
    /// Spectra of the instrument.
    pub spectra: &'a InstrumentSpectra,
    /// Standard spectra.
    pub standards: &'a Standards,
}

/// One reading: a channel of a band.
pub struct Reading {
    /// Band name.
    pub band: String,
    /// Camera.
    pub camera: String,
    /// Channel of the camera.
    pub channel: usize,
    /// Its kernel.
    pub kernel: Kernel,
    /// 1/h of eq. (11)/(13).
    pub one_over_h: f64,
    /// Irradiance through the filter at normal incidence, uW/cm2; NaN where the instrument does not tell it.
    pub irradiance: f64,
    /// Value of the reflecting and the transmitting diffuser for this reading.
    pub references: [Option<f64>; 2],
}

/// All readings of a run and what is combined from them.
pub struct Readings {
    /// The readings, band by band, channel by channel.
    pub readings: Vec<Reading>,
    /// The quantities with their weights.
    pub quantities: Vec<(Quantity, Combiner)>,
}

/// Kernels of the scan's bands and the quantities they allow.
pub fn readings(setup: Setup<'_>) -> Result<Readings> {
    let grid = Grid::engine();
    let lamp = grid.sample(&setup.spectra.lamp);
    let rho = grid.sample_clamped(&setup.spectra.mirror);
    let scale = lamp_scale(setup);
    let mut readings = Vec::new();
    let mut bands = Vec::new();
    for name in setup.bands {
        let slot = slot_of(setup, name)?;
        let filter = stack_transmittance(&grid, &plates(setup, slot)?);
        let camera = slot.camera.clone().unwrap_or_default();
        let channels = setup.spectra.responsivity.get(&camera).ok_or_else(|| {
            ProductError::Nothing(format!("band `{name}`: its camera `{camera}` has no responsivity in the run"))
        })?;
        for (channel, curve) in channels.iter().enumerate() {
            let factors = [&grid.sample(curve)[..], &lamp[..], &filter[..], &rho[..]];
            let what = || format!("band `{name}`, channel {channel}");
            let kernel = Kernel::of(&grid, name, channel, factors).map_err(engine(what()))?;
            let mean = |c: &Option<_>| c.as_ref().map(|c| kernel.mean(&grid.sample_clamped(c)));
            readings.push(Reading {
                band: name.clone(),
                camera: camera.clone(),
                channel,
                one_over_h: one_over_h(&grid, factors).map_err(engine(what()))?,
                irradiance: scale * irradiance(&grid, &lamp, &filter).map_err(engine(what()))?,
                references: [mean(&setup.spectra.reflection_reference), mean(&setup.spectra.transmission_reference)],
                kernel,
            });
        }
        // Inside its stated interval only: what a stack leaks elsewhere is not the band, and no camera may see it.
        let interval_nm = slot.interval_nm.unwrap_or_default();
        let band = targets::band(&targets::radiometric(&grid, &lamp, interval_nm), &filter);
        bands.push((name.clone(), interval_nm, band));
    }
    let quantities = quantities(setup.standards, &grid, &lamp, &readings, bands)?;
    Ok(Readings { readings, quantities })
}

/// Factor from the lamp's relative spectrum to uW/(cm2 nm); NaN in ratio mode without a stated irradiance.
fn lamp_scale(setup: Setup<'_>) -> f64 {
    let total = setup.spectra.lamp.integrate(300.0, 1700.0);
    setup.instrument.lamp.irradiance_uw_per_cm2.map_or(f64::NAN, |e| e / total)
}

/// The wheel's place of a band.
pub(super) fn slot_of<'a>(setup: Setup<'a>, band: &str) -> Result<&'a FilterSlot> {
    let slots = &setup.instrument.filter_wheel.slot;
    slots.values().find(|s| s.band == band).ok_or_else(|| {
        ProductError::Nothing(format!("the scan uses band `{band}`, which the run's instrument does not have"))
    })
}

fn plates(setup: Setup<'_>, slot: &FilterSlot) -> Result<Vec<GlassPlate>> {
    let plate = |g: &crate::config::instrument::Glass| {
        let tau_1mm = setup.spectra.glasses.get(&g.glass).cloned();
        let reflection_factor = setup.spectra.reflection_factors.get(&g.glass).copied();
        match (tau_1mm, reflection_factor) {
            (Some(tau_1mm), Some(reflection_factor)) => {
                Ok(GlassPlate { tau_1mm, reflection_factor, thickness_mm: g.thickness_mm })
            }
            _ => Err(ProductError::Nothing(format!("the run's glass tables lack `{}`", g.glass))),
        }
    };
    slot.glasses.iter().map(plate).collect()
}

/// Bands, lamp-weighted total, Visible and Solar, as far as the kernels reach.
fn quantities(
    standards: &Standards,
    grid: &Grid,
    lamp: &[f64],
    readings: &[Reading],
    bands: Vec<(String, [f64; 2], Vec<f64>)>,
) -> Result<Vec<(Quantity, Combiner)>> {
    let kernels: Vec<&Kernel> = readings.iter().map(|r| &r.kernel).collect();
    let reach = reach(grid, &kernels);
    let combiner = |name: &str, target: &[f64]| {
        Combiner::new(grid, &kernels, target, Prior::default()).map_err(engine(format!("the weights of `{name}`")))
    };
    let mut out = Vec::new();
    for (name, interval_nm, target) in bands {
        let weights = combiner(&name, &target)?;
        out.push((Quantity::Band { name, interval_nm }, weights));
    }
    let interval_nm = measured_interval(grid, &reach);
    let total = targets::radiometric(grid, lamp, interval_nm);
    out.push((Quantity::RadiometricTotal { interval_nm }, combiner("total", &total)?));
    let visible = targets::visible(grid, &standards.d65, &standards.v);
    if share(&visible, &reach) >= REACH {
        out.push((Quantity::Visible, combiner("visible", &visible)?));
    }
    let solar = targets::solar(grid, &standards.g173_direct, interval_nm);
    let everything = targets::solar(grid, &standards.g173_direct, [300.0, 2500.0]);
    if share(&everything, &reach) >= 0.5 {
        out.push((Quantity::Solar { measured_nm: interval_nm }, combiner("solar", &solar)?));
    }
    Ok(out)
}

/// Grid points that at least one kernel reaches.
fn reach(grid: &Grid, kernels: &[&Kernel]) -> Vec<bool> {
    let mut reach = vec![false; grid.len];
    for kernel in kernels {
        let top = kernel.weights.iter().copied().fold(0.0, f64::max);
        for (r, w) in reach.iter_mut().zip(&kernel.weights) {
            *r |= *w >= REACH_LEVEL * top;
        }
    }
    reach
}

fn share(target: &[f64], reach: &[bool]) -> f64 {
    let all: f64 = target.iter().sum();
    let inside: f64 = target.iter().zip(reach).filter(|(_, r)| **r).map(|(t, _)| t).sum();
    inside / all
}

/// First and last wavelength that a kernel reaches, nm.
fn measured_interval(grid: &Grid, reach: &[bool]) -> [f64; 2] {
    let reached: Vec<f64> = grid.wavelengths().zip(reach).filter(|(_, r)| **r).map(|(w, _)| w).collect();
    [reached.first().copied().unwrap_or(f64::NAN), reached.last().copied().unwrap_or(f64::NAN)]
}
