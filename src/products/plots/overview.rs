//! The overview sheet: small hemispheres, one row a side, a few incident directions each, one colour scale for all.

use super::PlotError;
use super::canvas::{Ink, Picture, picture};
use super::colour::{GREY, LogScale};
use super::hemisphere::{colour_bar, marks, measured, patches, quantity_words};
use crate::engine::bsdf::set::{BsdfSet, Column};
use crate::engine::optics::side::Side;
use crate::products::context::side_words;

/// Most hemispheres in a row.
const ACROSS: usize = 5;
const CELL: (f64, f64) = (210.0, 236.0);
const LEFT: f64 = 40.0;
const TOP: f64 = 96.0;

/// Sheet of one quantity: a row for each side, up to five incident directions spread over what was measured.
///
/// # Errors
/// [`PlotError::Empty`] where the quantity has no column with a positive value; [`PlotError::Drawing`].
pub fn overview(set: &BsdfSet, quantity: usize) -> Result<Picture, PlotError> {
    let rows: Vec<(Side, Vec<&Column>)> = Side::ALL
        .into_iter()
        .map(|side| (side, spread(set.columns.iter().filter(|c| c.side == side && c.quantity == quantity).collect())))
        .filter(|(_, columns)| !columns.is_empty())
        .collect();
    let scale = LogScale::of(rows.iter().flat_map(|(_, cs)| cs).flat_map(|c| measured(c)));
    let Some(scale) = scale else {
        return Err(PlotError::Empty(format!("quantity {quantity} has no column with a positive value")));
    };
    let across = rows.iter().map(|(_, c)| c.len()).max().unwrap_or(1);
    // Wide enough for the heading.
    let width = (LEFT + CELL.0 * across as f64 + 130.0).max(640.0);
    let height = TOP + (CELL.1 + 30.0) * rows.len() as f64 + 16.0;
    picture((width as u32, height as u32), |canvas| {
        let words = set.quantities.get(quantity).map_or_else(|| "?".to_owned(), quantity_words);
        canvas.text(&format!("Overview · {words}"), (LEFT, 34.0), Ink::new(25.0).bold())?;
        let note = "circle: straight-through or mirror direction; wedge: source; y up, seen from the interior";
        canvas.text(note, (LEFT, 64.0), Ink::new(12.5).colour(GREY))?;
        for (r, (side, columns)) in rows.iter().enumerate() {
            let y = TOP + (CELL.1 + 30.0) * r as f64;
            canvas.text(side_words(*side), (LEFT, y + 10.0), Ink::new(16.0).bold())?;
            for (i, column) in columns.iter().enumerate() {
                let centre = (LEFT + CELL.0 * (i as f64 + 0.5) - 10.0, y + 30.0 + 96.0);
                patches(canvas, centre, 84.0, &set.basis, column, scale)?;
                marks(canvas, centre, 84.0, column)?;
                caption(canvas, (centre.0, y + CELL.1 - 6.0), column)?;
            }
        }
        let bar = (CELL.1 + 30.0) * rows.len() as f64 - 80.0;
        colour_bar(canvas, (width - 106.0, TOP + 40.0), (22.0, bar), scale)
    })
}

fn caption(canvas: &super::canvas::Canvas, at: (f64, f64), column: &Column) -> Result<(), PlotError> {
    let (theta, phi) = column.incident.degrees();
    let letter = if column.side.is_transmission() { "T" } else { "R" };
    let source = format!("θ {theta:.0}° φ {phi:.0}°  {letter} {:.3}", column.hemispherical);
    canvas.text(&source, at, Ink::new(13.0).centred())
}

/// Up to [`ACROSS`] columns, evenly spread over the list in order of theta, first and last included.
fn spread(mut columns: Vec<&Column>) -> Vec<&Column> {
    columns
        .sort_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta).then(a.incident.phi.total_cmp(&b.incident.phi)));
    let n = columns.len();
    if n <= ACROSS {
        return columns;
    }
    (0..ACROSS).filter_map(|k| columns.get(k * (n - 1) / (ACROSS - 1)).copied()).collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::products::context::synthetic;

    #[test]
    fn a_full_scan_is_shown_by_five_directions_a_side() {
        let set = synthetic::full(&[Side::TransmissionFront, Side::ReflectionFront]);
        let shown = spread(set.columns.iter().filter(|c| c.quantity == 5).collect());
        assert_eq!(shown.len(), ACROSS);
        assert!(shown[0].incident.theta == 0.0 && shown[4].incident.theta > 1.4);
        let p = overview(&set, 5).unwrap();
        assert_eq!(p.size.0, (LEFT + 5.0 * CELL.0 + 130.0) as u32);
        if let Some(folder) = std::env::var_os("GONIOD_PLOTS") {
            p.write(&std::path::Path::new(&folder).join("overview.png")).unwrap();
        }
        assert!(matches!(overview(&set, 99), Err(PlotError::Empty(_))));
    }
}
