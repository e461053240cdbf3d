//! One BSDF matrix of the Klems file: 145 x 145 values and, for each column, how it came about.

use super::ExportError;
use crate::engine::bsdf::set::BsdfSet;
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::side::Side;
use crate::products::context::side_words;

/// Patches of Klems Full.
pub const PATCHES: usize = 145;

/// How the column of one incident patch came about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// Measured at this incident direction.
    Measured,
    /// From a measured column by the sample's symmetry.
    Symmetry,
    /// Interpolated between measured columns.
    Interpolated,
    /// From other measured columns by reciprocity.
    Reciprocity,
    /// Nothing is known; the values are not looked at.
    Absent,
}

/// A full matrix of one hemisphere pair and one quantity.
///
/// Columns are in file order: an incident patch is named by the azimuth in which the light *travels* (source
/// azimuth + 180 degrees, [`Side::file_incident`]); rows are outgoing patches.
#[derive(Debug, Clone, PartialEq)]
pub struct FilledBlock {
    /// Hemisphere pair.
    pub side: Side,
    /// BSDF in 1/sr, row by row: `values[outgoing * 145 + incident]`.
    pub values: Vec<f64>,
    /// Origin of each of the 145 columns.
    pub origin: Vec<Origin>,
}

// === impl Origin ===

impl Origin {
    /// All, in the order of trust.
    pub const ALL: [Origin; 5] =
        [Origin::Measured, Origin::Symmetry, Origin::Interpolated, Origin::Reciprocity, Origin::Absent];

    /// In words, as `Comments` says it.
    pub fn words(self) -> &'static str {
        match self {
            Origin::Measured => "measured",
            Origin::Symmetry => "by symmetry",
            Origin::Interpolated => "interpolated",
            Origin::Reciprocity => "by reciprocity",
            Origin::Absent => "not measured",
        }
    }
}

// === impl FilledBlock ===

impl FilledBlock {
    /// The measured columns of one side and quantity put in their places, nothing filled; `None` where the set holds
    /// no column of that side and quantity.
    ///
    /// # Errors
    /// [`ExportError::Unfit`] where the emergent basis is not Klems Full, or a direction is no Klems patch centre's patch.
    pub fn from_measured(set: &BsdfSet, quantity: usize, side: Side) -> Result<Option<FilledBlock>, ExportError> {
        let full = AngleBasis::klems_full();
        if set.basis.rings != full.rings {
            return Err(ExportError::Unfit {
                format: "Klems matrix",
                what: format!("the emergent basis is {}", set.basis.name),
                advice: "reduce the run again with the emergent basis LBNL/Klems Full",
            });
        }
        let mut block =
            FilledBlock { side, values: vec![0.0; PATCHES * PATCHES], origin: vec![Origin::Absent; PATCHES] };
        for column in set.columns.iter().filter(|c| c.side == side && c.quantity == quantity) {
            let incident =
                full.patch_of(Side::file_incident(column.incident)).filter(|_| column.patches.len() == PATCHES);
            let Some(incident) = incident else {
                return Err(ExportError::Unfit {
                    format: "Klems matrix",
                    what: format!(
                        "{}: a column has {} patches or a direction below the horizon",
                        side_words(side),
                        column.patches.len()
                    ),
                    advice: "this is a fault of the reduction, keep the run and report it",
                });
            };
            for (row, patch) in block.values.chunks_exact_mut(PATCHES).zip(&column.patches) {
                if let Some(value) = row.get_mut(incident) {
                    *value = patch.bsdf;
                }
            }
            if let Some(origin) = block.origin.get_mut(incident) {
                *origin = Origin::Measured;
            }
        }
        Ok(block.origin.contains(&Origin::Measured).then_some(block))
    }

    /// Direct-hemispherical value of every incident patch: sum over o of L_o B\[o\]\[i\].
    pub fn hemispherical(&self) -> Vec<f64> {
        let mut sums = vec![0.0; PATCHES];
        let solid = AngleBasis::klems_full().projected_solid_angles();
        for (row, l) in self.values.chunks_exact(PATCHES).zip(solid) {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += l * value;
            }
        }
        sums
    }

    /// Number of columns of one origin.
    pub fn count(&self, origin: Origin) -> usize {
        self.origin.iter().filter(|&&o| o == origin).count()
    }
}

/// Index of the patch at the same theta, phi + 180 degrees (Klems Full); itself for the cap.
pub fn opposite(patch: usize) -> usize {
    let full = AngleBasis::klems_full();
    match full.place(patch).and_then(|(r, k)| Some((r, k, full.rings.get(r)?.patches))) {
        Some((ring, k, n)) => full.index(ring, (k + n / 2) % n),
        None => patch,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::engine::optics::direction::Direction;
    use crate::products::context::synthetic;

    #[test]
    fn a_direct_beam_lies_on_the_diagonal_and_sums_are_kept() {
        let set = synthetic::full(&[Side::TransmissionFront]);
        let block = FilledBlock::from_measured(&set, 5, Side::TransmissionFront).unwrap().unwrap();
        assert_eq!(block.count(Origin::Measured), PATCHES);
        for (i, t) in block.hemispherical().into_iter().enumerate() {
            assert!((t - 0.7).abs() < 1e-12);
            assert!(block.values[i * PATCHES + i] > 5.0);
        }
        assert!(FilledBlock::from_measured(&set, 5, Side::ReflectionBack).unwrap().is_none());
    }

    #[test]
    fn a_source_high_up_is_the_column_that_travels_downwards() {
        let high = Direction::from_degrees(40.0, 90.0);
        let mut set = synthetic::full(&[]);
        set.columns.push(synthetic::column(Side::TransmissionFront, high, 0, 0.0, 0.6));
        let block = FilledBlock::from_measured(&set, 0, Side::TransmissionFront).unwrap().unwrap();
        // Ring 5 (35-45 degrees) begins at 45; 24 patches; 270 degrees is patch 18 of it.
        assert_eq!(block.origin.iter().position(|&o| o == Origin::Measured), Some(45 + 18));
    }

    #[test]
    fn opposite_is_its_own_inverse_and_turns_by_180_degrees() {
        let full = AngleBasis::klems_full();
        for p in 0..PATCHES {
            assert_eq!(opposite(opposite(p)), p);
            let (a, b) = (full.centre(p).unwrap(), full.centre(opposite(p)).unwrap());
            assert!((a.theta - b.theta).abs() < 1e-12);
            assert!(a.theta == 0.0 || ((a.phi - b.phi).abs() - std::f64::consts::PI).abs() < 1e-9);
        }
    }

    #[test]
    fn another_basis_is_refused_with_advice() {
        let mut set = synthetic::full(&[]);
        set.basis = AngleBasis::klems_half();
        let text = FilledBlock::from_measured(&set, 0, Side::TransmissionFront).unwrap_err().to_string();
        assert!(text.contains("Klems Half") && text.contains("reduce the run again"), "{text}");
    }
}
