//! One hemisphere: the patches of one column coloured by log BSDF, radius = theta, azimuth as in the files.

use super::PlotError;
use super::canvas::{Canvas, Ink, Picture, picture};
use super::colour::{ABSENT, GREY, HATCH, INK, LogScale, label, viridis};
use crate::engine::bsdf::set::{BsdfSet, Column, Quantity};
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use crate::products::context::side_words;
use plotters::style::RGBColor;

const WHITE: RGBColor = RGBColor(255, 255, 255);

/// Picture of one column, 900 x 780 pixels: patches, colour bar in 1/sr, straight-through or mirror direction, azimuth
/// of the source; patches that were not measured are hatched grey.
///
/// # Errors
/// [`PlotError::Empty`] where the column has no positive value; [`PlotError::Drawing`].
pub fn hemisphere(set: &BsdfSet, column: &Column) -> Result<Picture, PlotError> {
    let scale = LogScale::of(measured(column))
        .ok_or_else(|| PlotError::Empty(format!("no positive value in {}", title(set, column))))?;
    picture((900, 780), |canvas| {
        canvas.text(&title(set, column), (40.0, 36.0), Ink::new(27.0).bold())?;
        canvas.text(&subtitle(column), (40.0, 70.0), Ink::new(18.0).colour(GREY))?;
        let (centre, radius) = ((375.0, 412.0), 282.0);
        patches(canvas, centre, radius, &set.basis, column, scale)?;
        rings(canvas, centre, radius, column)?;
        azimuths(canvas, centre, radius)?;
        marks(canvas, centre, radius, column)?;
        colour_bar(canvas, (752.0, 150.0), (28.0, 524.0), scale)?;
        legend(canvas, column.side)
    })
}

/// Values of the patches that were measured.
pub(super) fn measured(column: &Column) -> impl Iterator<Item = f64> {
    column.patches.iter().filter(|p| p.coverage > 0.0 && p.bsdf.is_finite()).map(|p| p.bsdf)
}

/// Quantity and side in words.
pub(super) fn title(set: &BsdfSet, column: &Column) -> String {
    let quantity = set.quantities.get(column.quantity).map_or_else(|| "?".to_owned(), quantity_words);
    format!("{} · {quantity}", side_words(column.side))
}

/// A quantity with its interval.
pub fn quantity_words(quantity: &Quantity) -> String {
    match quantity {
        Quantity::Band { name, interval_nm: [a, b] } => format!("{name}, {a:.0}–{b:.0} nm"),
        Quantity::RadiometricTotal { interval_nm: [a, b] } => format!("radiometric total, {a:.0}–{b:.0} nm"),
        Quantity::Visible => "visible".to_owned(),
        Quantity::Solar { .. } => "solar".to_owned(),
    }
}

fn subtitle(column: &Column) -> String {
    let (theta, phi) = column.incident.degrees();
    let letter = if column.side.is_transmission() { "T" } else { "R" };
    format!(
        "source at θ = {theta:.0}°, φ = {phi:.0}°      {letter} = {:.4} ± {:.4} (k = 2)",
        column.hemispherical,
        2.0 * column.hemispherical_u
    )
}

/// The coloured disc; `radius` is theta = 90 degrees.
pub(super) fn patches(
    canvas: &Canvas,
    centre: (f64, f64),
    radius: f64,
    basis: &AngleBasis,
    column: &Column,
    scale: LogScale,
) -> Result<(), PlotError> {
    let patch_at = |dx: f64, dy: f64| {
        let theta = (90.0 * dx.hypot(dy) / radius).min(90.0);
        basis.patch_of(Direction { theta: theta.to_radians(), phi: dy.atan2(dx).rem_euclid(std::f64::consts::TAU) })
    };
    let line = if radius > 150.0 { 0.45 } else { 0.2 };
    canvas.disc(centre, radius, |dx, dy| {
        let here = patch_at(dx, dy);
        let patch = here.and_then(|p| column.patches.get(p)).filter(|p| p.coverage > 0.0 && p.bsdf.is_finite());
        let colour = match patch {
            Some(p) => scale.colour(p.bsdf),
            None if (dx + dy).rem_euclid(7.0) < 1.5 => HATCH,
            None => ABSENT,
        };
        // Half a finished pixel of a lighter line between patches.
        let edge = patch_at(dx + 0.5, dy) != here || patch_at(dx, dy + 0.5) != here;
        if edge { mix(colour, WHITE, line) } else { colour }
    })?;
    canvas.ring(centre, radius, INK, 1.2)
}

fn mix(a: RGBColor, b: RGBColor, t: f64) -> RGBColor {
    let c = |x: u8, y: u8| (f64::from(x) + (f64::from(y) - f64::from(x)) * t).round() as u8;
    RGBColor(c(a.0, b.0), c(a.1, b.1), c(a.2, b.2))
}

fn on_disc(centre: (f64, f64), radius: f64, theta_deg: f64, phi: f64) -> (f64, f64) {
    let r = radius * theta_deg / 90.0;
    (centre.0 + r * phi.cos(), centre.1 - r * phi.sin())
}

/// Circles of equal theta, with their labels beside the plane of incidence, where no peak lies.
fn rings(canvas: &Canvas, centre: (f64, f64), radius: f64, column: &Column) -> Result<(), PlotError> {
    let beside = Side::file_incident(column.incident).phi - std::f64::consts::FRAC_PI_2;
    for theta in [30.0, 60.0] {
        canvas.ring(centre, radius * theta / 90.0, WHITE, 1.0)?;
        let (x, y) = on_disc(centre, radius, theta, beside);
        canvas.rectangle((x - 20.0, y - 10.0), (x + 20.0, y + 10.0), WHITE)?;
        canvas.text(&format!("{theta:.0}°"), (x, y), Ink::new(15.0).centred())?;
    }
    Ok(())
}

fn azimuths(canvas: &Canvas, centre: (f64, f64), radius: f64) -> Result<(), PlotError> {
    for k in 0..12 {
        let phi = f64::from(k * 30).to_radians();
        let (a, b) = (on_disc(centre, radius, 90.0, phi), on_disc(centre, radius + 6.0, 90.0, phi));
        canvas.line(&[a, b], INK, 1.0)?;
        let (x, y) = on_disc(centre, radius + 30.0, 90.0, phi);
        let words = match k {
            0 => "φ = 0°".to_owned(),
            3 => "90° up".to_owned(),
            _ => format!("{}°", k * 30),
        };
        let nudge = if k == 0 { 10.0 } else { 0.0 };
        canvas.text(&words, (x + nudge, y), Ink::new(16.5).colour(GREY).centred())?;
    }
    Ok(())
}

/// A ring at the straight-through or mirror direction; a wedge outside the rim at the azimuth of the source.
pub(super) fn marks(canvas: &Canvas, centre: (f64, f64), radius: f64, column: &Column) -> Result<(), PlotError> {
    let straight = Side::file_incident(column.incident);
    let at = on_disc(centre, radius, straight.theta.to_degrees(), straight.phi);
    // On small discs the ring goes around the patch and must not hide it.
    let (size, width) = if radius > 150.0 { (radius / 31.0, 3.0) } else { (8.0, 2.0) };
    canvas.ring(at, size, INK, width)?;
    canvas.ring(at, size, WHITE, 0.5 * width)?;
    if column.incident.theta > 1e-6 {
        wedge(
            canvas,
            on_disc(centre, radius + 1.0, 90.0, column.incident.phi),
            column.incident.phi,
            (radius / 22.0).max(9.0),
        )?;
    }
    Ok(())
}

/// A triangle with its tip at `tip`, pointing to the centre of the disc that lies in direction `phi` + 180 degrees.
fn wedge(canvas: &Canvas, tip: (f64, f64), phi: f64, size: f64) -> Result<(), PlotError> {
    let (s, c) = phi.sin_cos();
    let base = (tip.0 + size * c, tip.1 - size * s);
    let half = 0.55 * size;
    let points = [tip, (base.0 - half * s, base.1 - half * c), (base.0 + half * s, base.1 + half * c)];
    canvas.polygon(&points, RGBColor(213, 94, 0))
}

/// The colour bar with its ticks and unit.
pub(super) fn colour_bar(
    canvas: &Canvas,
    (x, y): (f64, f64),
    (width, height): (f64, f64),
    scale: LogScale,
) -> Result<(), PlotError> {
    canvas.text("BSDF (1/sr)", (x - 6.0, y - 24.0), Ink::new(15.0))?;
    let steps = height as usize;
    for i in 0..steps {
        let top = y + i as f64;
        let t = 1.0 - (i as f64 + 0.5) / height;
        canvas.rectangle((x, top), (x + width, top + 1.5), viridis(t))?;
    }
    let corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height), (x, y)];
    canvas.line(&corners, INK, 1.0)?;
    for value in scale.ticks() {
        let at = y + height * (1.0 - scale.place(value));
        canvas.line(&[(x + width, at), (x + width + 6.0, at)], INK, 1.0)?;
        canvas.text(&label(value), (x + width + 11.0, at), Ink::new(16.0))?;
    }
    Ok(())
}

fn legend(canvas: &Canvas, side: Side) -> Result<(), PlotError> {
    let y = 750.0;
    let ink = Ink::new(15.0).colour(GREY);
    canvas.ring((48.0, y), 7.0, INK, 3.0)?;
    canvas.ring((48.0, y), 7.0, WHITE, 1.4)?;
    let straight = if side.is_transmission() { "straight-through direction" } else { "mirror direction" };
    canvas.text(straight, (64.0, y), ink)?;
    wedge(canvas, (288.0, y), 0.0, 13.0)?;
    canvas.text("azimuth of the source", (310.0, y), ink)?;
    canvas.rectangle((504.0, y - 7.0), (522.0, y + 7.0), ABSENT)?;
    for k in 0..3 {
        let x = 504.0 + 6.0 * f64::from(k);
        canvas.line(&[(x, y + 7.0), (x + 6.0, y - 7.0)], HATCH, 1.2)?;
    }
    canvas.text("not measured", (531.0, y), ink)?;
    canvas.text("seen from the interior", (692.0, y), ink)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::products::context::synthetic;

    fn oblique() -> BsdfSet {
        let mut set = synthetic::full(&[]);
        let source = Direction::from_degrees(40.0, 105.0);
        set.columns.push(synthetic::column(Side::TransmissionFront, source, 5, 0.2, 0.5));
        for patch in set.columns[0].patches.iter_mut().skip(133) {
            (patch.coverage, patch.bsdf) = (0.0, f64::NAN);
        }
        set
    }

    #[test]
    fn the_direct_patch_is_bright_where_the_light_travels_to_and_gaps_are_grey() {
        let set = oblique();
        let p = hemisphere(&set, &set.columns[0]).unwrap();
        // Patch (40, 285): below the centre, a little to the right; beside the white ring mark.
        let phi: f64 = 291f64.to_radians();
        let r = 282.0 * 43.0 / 90.0;
        let at = |r: f64, phi: f64| p.pixel((375.0 + r * phi.cos()) as u32, (412.0 - r * phi.sin()) as u32);
        assert_eq!(at(r, phi), [253, 231, 37], "the brightest colour");
        let other = at(r, 105f64.to_radians());
        assert!(other[0] < 100 && other[2] > 60, "diffuse patches are dark: {other:?}");
        let grey = at(282.0 * 85.0 / 90.0, 1.1);
        assert!(grey[0] == grey[1] && grey[1] == grey[2] && grey[0] > 150, "{grey:?}");
    }

    #[test]
    fn a_column_without_light_is_an_error_with_its_name() {
        let mut set = oblique();
        set.columns[0].patches.iter_mut().for_each(|p| p.bsdf = 0.0);
        let text = hemisphere(&set, &set.columns[0]).unwrap_err().to_string();
        assert!(text.contains("Transmission Front · visible"), "{text}");
    }

    /// Writes the pictures for looking at: `GONIOD_PLOTS=folder cargo test -p goniod --lib show_plots`.
    #[test]
    fn show_plots() {
        let set = oblique();
        let p = hemisphere(&set, &set.columns[0]).unwrap();
        assert_eq!(p.size, (900, 780));
        if let Some(folder) = std::env::var_os("GONIOD_PLOTS") {
            p.write(&std::path::Path::new(&folder).join("hemisphere.png")).unwrap();
        }
    }
}
