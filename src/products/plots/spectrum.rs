//! The spectrum of one incident direction: hemispherical values band by band with interval and k = 2 uncertainty, and
//! the totals beside them.

use super::PlotError;
use super::canvas::{Canvas, Ink, Picture, picture};
use super::colour::{FAINT, GREY, INK, side_colour};
use crate::engine::bsdf::set::{BsdfSet, Column, Quantity};
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use crate::products::context::side_words;

/// The plot field of the bands, and the field of the totals, in pixels.
const FIELD: [f64; 4] = [76.0, 128.0, 706.0, 486.0];
const TOTALS: [f64; 4] = [738.0, 128.0, 976.0, 486.0];

/// Axes of the picture.
struct Frame {
    nm: [f64; 2],
    top: f64,
    step: f64,
}

/// Picture of the columns of one incident direction, all sides, 1000 x 560 pixels.
///
/// # Errors
/// [`PlotError::Empty`] where no column has that incident direction; [`PlotError::Drawing`].
pub fn spectrum(set: &BsdfSet, incident: Direction) -> Result<Picture, PlotError> {
    let columns: Vec<&Column> = set
        .columns
        .iter()
        .filter(|c| (c.incident.theta - incident.theta).abs() < 1e-9 && (c.incident.phi - incident.phi).abs() < 1e-9)
        .filter(|c| c.hemispherical.is_finite() && c.hemispherical_u.is_finite())
        .collect();
    let (theta, phi) = incident.degrees();
    if columns.is_empty() {
        return Err(PlotError::Empty(format!("no column with the source at ({theta:.1}, {phi:.1}) degrees")));
    }
    let frame = Frame::of(set, &columns);
    picture((1000, 560), |canvas| {
        canvas.text("Hemispherical transmittance and reflectance", (40.0, 34.0), Ink::new(25.0).bold())?;
        let note = format!("source at θ = {theta:.0}°, φ = {phi:.0}°      bars: band interval, whiskers: k = 2");
        canvas.text(&note, (40.0, 64.0), Ink::new(14.5).colour(GREY))?;
        legend(canvas, &columns)?;
        axes(canvas, &frame)?;
        band_names(canvas, set, &frame)?;
        columns.iter().try_for_each(|c| value(canvas, set, c, &frame))?;
        totals(canvas, set, &columns, &frame)
    })
}

fn legend(canvas: &Canvas, columns: &[&Column]) -> Result<(), PlotError> {
    let mut x = FIELD[0];
    for side in Side::ALL.into_iter().filter(|&s| columns.iter().any(|c| c.side == s)) {
        canvas.rectangle((x, 93.0), (x + 18.0, 99.0), side_colour(side))?;
        canvas.text(side_words(side), (x + 26.0, 96.0), Ink::new(14.0))?;
        x += 186.0;
    }
    Ok(())
}

fn axes(canvas: &Canvas, frame: &Frame) -> Result<(), PlotError> {
    let mut tick = 0.0;
    while tick <= frame.top + 1e-9 {
        let y = frame.y(tick);
        canvas.line(&[(FIELD[0], y), (FIELD[2], y)], FAINT, 1.0)?;
        canvas.line(&[(TOTALS[0], y), (TOTALS[2], y)], FAINT, 1.0)?;
        let places = if frame.step < 0.0099 { 3 } else { if frame.step < 0.099 { 2 } else { 1 } };
        canvas.text(&format!("{tick:.places$}"), (FIELD[0] - 9.0, y), Ink::new(13.5).right())?;
        tick += frame.step;
    }
    let span = frame.nm[1] - frame.nm[0];
    let every = if span > 700.0 { 200.0 } else { if span > 350.0 { 100.0 } else { 50.0 } };
    let mut nm = (frame.nm[0] / every).ceil() * every;
    while nm <= frame.nm[1] {
        let x = frame.x(nm);
        canvas.line(&[(x, FIELD[3]), (x, FIELD[3] + 6.0)], INK, 1.0)?;
        canvas.text(&format!("{nm:.0}"), (x, FIELD[3] + 19.0), Ink::new(13.5).centred())?;
        nm += every;
    }
    canvas.line(&[(FIELD[0], FIELD[3]), (FIELD[2], FIELD[3])], INK, 1.2)?;
    canvas.line(&[(TOTALS[0], TOTALS[3]), (TOTALS[2], TOTALS[3])], INK, 1.2)?;
    let middle = 0.5 * (FIELD[0] + FIELD[2]);
    canvas.text("wavelength (nm)", (middle, FIELD[3] + 46.0), Ink::new(15.0).centred())?;
    canvas.text("totals", (0.5 * (TOTALS[0] + TOTALS[2]), FIELD[3] + 46.0), Ink::new(15.0).centred())?;
    let upright = Ink { upright: true, ..Ink::new(15.0).centred() };
    canvas.text("T or R", (22.0, 0.5 * (FIELD[1] + FIELD[3])), upright)
}

/// Band names in a line above the field, in a second line where two would touch.
fn band_names(canvas: &Canvas, set: &BsdfSet, frame: &Frame) -> Result<(), PlotError> {
    let mut ends = [f64::NEG_INFINITY; 2];
    let mut names: Vec<(f64, &str)> = set
        .quantities
        .iter()
        .filter_map(|q| match q {
            Quantity::Band { name, interval_nm: [a, b] } => Some((frame.x(0.5 * (a + b)), name.as_str())),
            _ => None,
        })
        .collect();
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (x, name) in names {
        let half = 4.2 * name.chars().count() as f64 + 3.0;
        let line = if x - half > ends[0] { 0 } else { 1 };
        ends[line] = x + half;
        let y = FIELD[1] - 8.0 + 13.0 * line as f64;
        canvas.text(name, (x, y), Ink::new(12.0).colour(GREY).centred())?;
    }
    Ok(())
}

fn value(canvas: &Canvas, set: &BsdfSet, column: &Column, frame: &Frame) -> Result<(), PlotError> {
    let Some(Quantity::Band { interval_nm: [a, b], .. }) = set.quantities.get(column.quantity) else { return Ok(()) };
    let y = frame.y(column.hemispherical);
    canvas.rectangle((frame.x(*a), y - 2.0), (frame.x(*b), y + 2.0), side_colour(column.side))?;
    whisker(canvas, frame.x(0.5 * (a + b)), column, frame)
}

fn whisker(canvas: &Canvas, x: f64, column: &Column, frame: &Frame) -> Result<(), PlotError> {
    let u = 2.0 * column.hemispherical_u;
    let (low, high) = (frame.y(column.hemispherical - u), frame.y(column.hemispherical + u));
    for y in [low, high] {
        canvas.line(&[(x - 4.0, y), (x + 4.0, y)], INK, 1.2)?;
    }
    canvas.line(&[(x, low), (x, high)], INK, 1.2)
}

fn totals(canvas: &Canvas, set: &BsdfSet, columns: &[&Column], frame: &Frame) -> Result<(), PlotError> {
    let kinds: Vec<usize> =
        (0..set.quantities.len()).filter(|&q| !matches!(set.quantities.get(q), Some(Quantity::Band { .. }))).collect();
    let width = (TOTALS[2] - TOTALS[0]) / kinds.len().max(1) as f64;
    for (k, &q) in kinds.iter().enumerate() {
        let middle = TOTALS[0] + width * (k as f64 + 0.5);
        let name = set.quantities.get(q).map(Quantity::name).unwrap_or_default();
        canvas.text(&name, (middle, TOTALS[3] + 19.0), Ink::new(13.5).centred())?;
        let here: Vec<&&Column> = columns.iter().filter(|c| c.quantity == q).collect();
        for (i, column) in here.iter().enumerate() {
            let x = middle + (i as f64 - 0.5 * (here.len() as f64 - 1.0)) * (0.8 * width / here.len() as f64).min(22.0);
            let y = frame.y(column.hemispherical);
            canvas.rectangle((x - 6.0, y), (x + 6.0, frame.y(0.0)), side_colour(column.side))?;
            whisker(canvas, x, column, frame)?;
        }
    }
    Ok(())
}

// === impl Frame ===

impl Frame {
    fn of(set: &BsdfSet, columns: &[&Column]) -> Frame {
        let mut nm = [380.0_f64, 780.0_f64];
        for quantity in &set.quantities {
            if let Quantity::Band { interval_nm: [a, b], .. } = quantity {
                nm = [nm[0].min(*a), nm[1].max(*b)];
            }
        }
        let margin = 0.02 * (nm[1] - nm[0]);
        let highest = columns.iter().map(|c| c.hemispherical + 2.0 * c.hemispherical_u).fold(0.0, f64::max);
        let rough = (highest.max(1e-3) * 1.08) / 5.0;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|s| s * power).find(|s| *s >= rough).unwrap_or(rough);
        Frame { nm: [nm[0] - margin, nm[1] + margin], top: step * (highest * 1.08 / step).ceil(), step }
    }

    fn x(&self, nm: f64) -> f64 {
        FIELD[0] + (FIELD[2] - FIELD[0]) * (nm - self.nm[0]) / (self.nm[1] - self.nm[0])
    }

    /// Height of a value; what lies below zero is drawn at zero.
    fn y(&self, value: f64) -> f64 {
        FIELD[3] - (FIELD[3] - FIELD[1]) * (value / self.top).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::products::context::synthetic;

    #[test]
    fn the_bar_of_a_band_stands_at_its_value() {
        let set = synthetic::directions(&[Side::TransmissionFront, Side::ReflectionFront], &[0]);
        let p = spectrum(&set, Direction::from_degrees(0.0, 0.0)).unwrap();
        let columns: Vec<&Column> = set.columns.iter().collect();
        let frame = Frame::of(&set, &columns);
        assert!(frame.top > 0.72 && frame.top < 1.01 && frame.step == 0.2);
        // Band f3, 500-560 nm: T = 0.7 (1 - 0.0001 x 120).
        let (x, y) = (frame.x(510.0) as u32, frame.y(0.7 * 0.988) as u32);
        assert_eq!(p.pixel(x, y), [0, 114, 178]);
        if let Some(folder) = std::env::var_os("GONIOD_PLOTS") {
            p.write(&std::path::Path::new(&folder).join("spectrum.png")).unwrap();
        }
    }

    #[test]
    fn a_direction_that_was_not_measured_is_told() {
        let set = synthetic::directions(&[Side::TransmissionFront], &[0]);
        let text = spectrum(&set, Direction::from_degrees(33.0, 4.0)).unwrap_err().to_string();
        assert!(text.contains("(33.0, 4.0)"), "{text}");
    }
}
