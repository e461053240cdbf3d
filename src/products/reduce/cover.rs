//! Do the spectra of the instrument cover what the bands see? Asked before the night: a table that ends too early gives
//! wrong numbers, and nobody sees it in the morning.

use super::readings::{Reading, Setup, readings, slot_of};
use crate::engine::bsdf::set::Quantity;
use crate::engine::spectra::curve::{Curve, Grid};
use crate::products::error::{ProductError, Result};

/// Share of what a reading sees that may lie outside a table that goes on with its last value.
const OUTSIDE: f64 = 0.01;

/// Share of what the best channel of a band sees that must lie within the band's stated interval. Glasses leak: of the
/// paper's own stack for 1150 to 1670 nm it is an eighth.
const INSIDE: f64 = 0.05;

/// A responsivity that ends within a band must have come down to this share of its highest value.
const ENDED: f64 = 0.02;

/// Rounding of table ends, nm.
const SLACK_NM: f64 = 2.5;

/// The quantities that a scan will give if every view is measured; `diffusers`: does it need the reflecting and the
/// transmitting one.
///
/// # Errors
/// Spectra that cannot be combined, that end within a band, or that leave a diffuser without value: one sentence.
pub fn quantities(setup: Setup<'_>, diffusers: [bool; 2]) -> Result<Vec<Quantity>> {
    let made = readings(setup)?;
    let grid = Grid::engine();
    for band in setup.bands {
        let of_band: Vec<&Reading> = made.readings.iter().filter(|r| &r.band == band).collect();
        tables_reach(setup, band, &of_band)?;
        interval_is_seen(setup, &grid, band, &of_band)?;
        diffusers_are_known(setup, &grid, &of_band, diffusers)?;
    }
    Ok(made.quantities.into_iter().map(|(quantity, _)| quantity).collect())
}

/// Lamp and glasses cover the stated interval; a responsivity that ends within it ends at nothing.
fn tables_reach(setup: Setup<'_>, band: &str, readings: &[&Reading]) -> Result<()> {
    let slot = slot_of(setup, band)?;
    let Some([lo, hi]) = slot.interval_nm else { return Ok(()) };
    let ends = |what: String, [first, last]: [f64; 2]| {
        ProductError::Nothing(format!(
            "{what} covers {first} to {last} nm, but band `{band}` is {lo} to {hi} nm; give a table that covers it, or leave \
             the band out"
        ))
    };
    let is_short = |[first, last]: [f64; 2]| first > lo + SLACK_NM || last < hi - SLACK_NM;
    let spectra = setup.spectra;
    let glasses =
        slot.glasses.iter().filter_map(|g| Some((format!("the glass `{}`", g.glass), spectra.glasses.get(&g.glass)?)));
    let lamp = [("lamp.spectrum".to_owned(), &spectra.lamp)];
    for (what, curve) in lamp.into_iter().chain(glasses) {
        if is_short(curve.range_nm()) {
            return Err(ends(what, curve.range_nm()));
        }
    }
    for reading in readings {
        let Some(curve) = spectra.responsivity.get(&reading.camera).and_then(|c| c.get(reading.channel)) else {
            continue;
        };
        let (range, top) = (curve.range_nm(), curve.values().iter().copied().fold(0.0, f64::max));
        let is_cut = |nm: f64| nm > lo + SLACK_NM && nm < hi - SLACK_NM && curve.at(nm) > ENDED * top;
        if range.into_iter().any(is_cut) {
            return Err(ends(
                format!("the responsivity of camera `{}`, channel {},", reading.camera, reading.channel),
                range,
            ));
        }
    }
    Ok(())
}

/// The band's interval is where its camera sees through its filter.
fn interval_is_seen(setup: Setup<'_>, grid: &Grid, band: &str, readings: &[&Reading]) -> Result<()> {
    let Some(interval @ [lo, hi]) = slot_of(setup, band)?.interval_nm else { return Ok(()) };
    let cells = grid.interval(interval).into_iter().map(|nm| nm / grid.step_nm).collect::<Vec<f64>>();
    let best = readings.iter().map(|r| r.kernel.mean(&cells)).fold(0.0, f64::max);
    if best >= INSIDE {
        return Ok(());
    }
    Err(ProductError::Nothing(format!(
        "band `{band}`: only {:.0} % of what its camera sees through its filter lies within its interval_nm, {lo} to {hi} nm; \
         correct the interval, the glasses or the camera",
        100.0 * best
    )))
}

/// Each diffuser that the scan needs scatters in this band, and its table covers what the band sees, as the mirror's does.
fn diffusers_are_known(setup: Setup<'_>, grid: &Grid, readings: &[&Reading], diffusers: [bool; 2]) -> Result<()> {
    let spectra = setup.spectra;
    let references = [
        ("reference.reflection.spectrum", diffusers[0].then_some(spectra.reflection_reference.as_ref()).flatten()),
        ("reference.transmission.spectrum", diffusers[1].then_some(spectra.transmission_reference.as_ref()).flatten()),
    ];
    for reading in readings {
        let tables = references.into_iter().chain([("optics.mirror_reflectance", Some(&spectra.mirror))]);
        for (role, curve) in tables.filter_map(|(role, curve)| Some((role, curve?))) {
            let seen = |of: &dyn Fn(&Curve, f64) -> f64| {
                reading.kernel.mean(&grid.wavelengths().map(|nm| of(curve, nm)).collect::<Vec<f64>>())
            };
            let [first, last] = curve.range_nm();
            let outside = seen(&|_, nm| f64::from(u8::from(nm < first - SLACK_NM || nm > last + SLACK_NM)));
            let (band, channel) = (&reading.band, reading.channel);
            if outside > OUTSIDE {
                return Err(ProductError::Nothing(format!(
                    "{role} covers {first} to {last} nm, but {:.0} % of what band `{band}`, channel {channel}, sees lies \
                     outside; give a table that covers it, or leave the band out",
                    100.0 * outside
                )));
            }
            if seen(&Curve::at_clamped) <= 0.0 {
                return Err(ProductError::Nothing(format!(
                    "{role} is not above 0 where band `{band}`, channel {channel}, sees; correct the table or leave the band out"
                )));
            }
        }
    }
    Ok(())
}
