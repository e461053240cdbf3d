//! From measured blocks to the four directions that every reader needs, and sentences that say what is what.
//!
//! The LBNL engine refuses files with a missing direction and EnergyPlus divides by an interior reflectance of zero, so
//! what was not measured becomes a block by reciprocity (transmission) or a Lambertian placeholder.

use super::ExportError;
use super::matrix::{FilledBlock, Origin, PATCHES, opposite};
use crate::engine::optics::basis::AngleBasis;
use crate::engine::optics::side::Side;
use crate::products::context::side_words;
use std::f64::consts::PI;

/// Hemispherical value of a placeholder: small, and not zero.
pub const PLACEHOLDER_HEMISPHERICAL: f64 = 0.001;

/// One block as it is written: finite, not negative, no gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct WrittenBlock {
    /// Hemisphere pair.
    pub side: Side,
    /// BSDF in 1/sr, `values[outgoing * 145 + incident]`.
    pub values: Vec<f64>,
    /// One sentence: what was measured, filled, invented, clamped.
    pub note: String,
}

/// All four blocks in the order of the file.
///
/// # Errors
/// [`ExportError::Unfit`] for a side given twice, a wrong size, or a value that is not finite in a column that is not absent.
pub fn complete(blocks: &[FilledBlock]) -> Result<Vec<WrittenBlock>, ExportError> {
    for block in blocks {
        check(block)?;
        if blocks.iter().filter(|b| b.side == block.side).count() > 1 {
            return Err(unfit(block.side, "is given twice"));
        }
    }
    let given: Vec<WrittenBlock> = blocks.iter().map(written).collect();
    Ok(Side::ALL.iter().map(|&side| find_or_make(side, &given)).collect())
}

fn find_or_make(side: Side, given: &[WrittenBlock]) -> WrittenBlock {
    if let Some(block) = given.iter().find(|b| b.side == side) {
        return block.clone();
    }
    let other = match side {
        Side::TransmissionFront => Some(Side::TransmissionBack),
        Side::TransmissionBack => Some(Side::TransmissionFront),
        _ => None,
    };
    if let Some(source) = given.iter().find(|b| Some(b.side) == other) {
        return reversed(side, source);
    }
    WrittenBlock {
        side,
        values: vec![PLACEHOLDER_HEMISPHERICAL / PI; PATCHES * PATCHES],
        note: format!(
            "{}: NOT MEASURED, Lambertian placeholder of hemispherical {PLACEHOLDER_HEMISPHERICAL}.",
            side_words(side)
        ),
    }
}

/// TB\[R(i)\]\[R(o)\] = TF\[o\]\[i\], R = same theta, phi + 180 degrees.
fn reversed(side: Side, source: &WrittenBlock) -> WrittenBlock {
    let turned: Vec<usize> = (0..PATCHES).map(opposite).collect();
    let value = |row: usize, column: usize| {
        // row = R(i), column = R(o), and R is its own inverse.
        let (i, o) = (turned.get(row).copied().unwrap_or(row), turned.get(column).copied().unwrap_or(column));
        source.values.get(o * PATCHES + i).copied().unwrap_or(0.0)
    };
    let values = (0..PATCHES * PATCHES).map(|n| value(n / PATCHES, n % PATCHES)).collect();
    let note = format!("{}: not measured, by reciprocity from {}.", side_words(side), side_words(source.side));
    WrittenBlock { side, values, note }
}

fn written(block: &FilledBlock) -> WrittenBlock {
    let solid = AngleBasis::klems_full().projected_solid_angles();
    let mut clamped = vec![0.0; PATCHES];
    let mut values = Vec::with_capacity(block.values.len());
    for (row, l) in block.values.chunks_exact(PATCHES).zip(solid) {
        for ((value, origin), sum) in row.iter().zip(&block.origin).zip(&mut clamped) {
            values.push(match origin {
                Origin::Absent => PLACEHOLDER_HEMISPHERICAL / PI,
                _ if *value < 0.0 => {
                    *sum -= l * value;
                    0.0
                }
                _ => *value,
            });
        }
    }
    WrittenBlock { side: block.side, values, note: describe(block, &clamped) }
}

fn describe(block: &FilledBlock, clamped: &[f64]) -> String {
    let mut parts = Vec::new();
    for origin in Origin::ALL {
        let list: Vec<usize> = (0..PATCHES).filter(|&i| block.origin.get(i) == Some(&origin)).collect();
        match (list.len(), origin) {
            (0, _) => {}
            (PATCHES, Origin::Absent) => parts.push("NOT MEASURED, Lambertian placeholder in all columns".to_owned()),
            (PATCHES, _) => parts.push(format!("all {PATCHES} incident columns {}", origin.words())),
            (n, Origin::Absent) => parts.push(format!(
                "{n} columns NOT MEASURED, Lambertian placeholder of hemispherical {PLACEHOLDER_HEMISPHERICAL} (#{})",
                ranges(&list)
            )),
            (n, _) => parts.push(format!("{n} columns {} (#{})", origin.words(), ranges(&list))),
        }
    }
    let worst = clamped.iter().copied().fold(0.0, f64::max);
    if worst > 0.0 {
        let mean = clamped.iter().sum::<f64>() / PATCHES as f64;
        parts.push(format!(
            "negative noise written as 0, which adds {worst:.2e} to the worst column's hemispherical value and {mean:.2e} on average"
        ));
    }
    format!("{}: {}.", side_words(block.side), parts.join("; "))
}

/// `0-3, 7, 9-10`
fn ranges(sorted: &[usize]) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for &i in sorted {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == i => *last = i,
            _ => runs.push((i, i)),
        }
    }
    let word = |(a, b): (usize, usize)| if a == b { a.to_string() } else { format!("{a}-{b}") };
    runs.into_iter().map(word).collect::<Vec<_>>().join(", ")
}

fn check(block: &FilledBlock) -> Result<(), ExportError> {
    if block.values.len() != PATCHES * PATCHES || block.origin.len() != PATCHES {
        return Err(unfit(block.side, "does not have 145 x 145 values and 145 origins"));
    }
    for (n, value) in block.values.iter().enumerate() {
        let (outgoing, incident) = (n / PATCHES, n % PATCHES);
        if !value.is_finite() && block.origin.get(incident) != Some(&Origin::Absent) {
            return Err(unfit(block.side, &format!("incident #{incident}, outgoing #{outgoing} is {value}")));
        }
    }
    Ok(())
}

fn unfit(side: Side, what: &str) -> ExportError {
    ExportError::Unfit {
        format: "Klems XML",
        what: format!("{} {what}", side_words(side)),
        advice: "every value must be a finite number; fill the patches or mark the column absent before the export",
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::products::context::synthetic;

    fn single(side: Side, outgoing: usize, incident: usize, value: f64) -> FilledBlock {
        let mut values = vec![0.0; PATCHES * PATCHES];
        values[outgoing * PATCHES + incident] = value;
        FilledBlock { side, values, origin: vec![Origin::Measured; PATCHES] }
    }

    #[test]
    fn back_transmission_comes_by_reciprocity_and_says_so() {
        let all = complete(&[single(Side::TransmissionFront, 25, 51, 0.6)]).unwrap();
        assert_eq!(all.iter().map(|b| b.side).collect::<Vec<_>>(), Side::ALL);
        let back = &all[2];
        assert_eq!(back.values[opposite(51) * PATCHES + opposite(25)], 0.6);
        assert_eq!(back.values.iter().filter(|v| **v != 0.0).count(), 1);
        assert!(back.note.contains("by reciprocity from Transmission Front"), "{}", back.note);
        assert!(all[1].note.contains("NOT MEASURED") && all[3].values.iter().all(|v| *v > 0.0));
    }

    #[test]
    fn a_reversed_block_reversed_again_is_the_block() {
        let source = written(&single(Side::TransmissionBack, 13, 77, 2.0));
        let twice = reversed(Side::TransmissionBack, &reversed(Side::TransmissionFront, &source));
        assert_eq!(twice.values, source.values);
    }

    #[test]
    fn a_nan_is_refused_with_its_place_but_not_in_an_absent_column() {
        let mut block = single(Side::ReflectionFront, 3, 7, f64::NAN);
        let text = complete(std::slice::from_ref(&block)).unwrap_err().to_string();
        assert!(text.contains("Reflection Front") && text.contains("incident #7, outgoing #3"), "{text}");
        block.origin[7] = Origin::Absent;
        let all = complete(&[block]).unwrap();
        assert!(all.iter().all(|b| b.values.iter().all(|v| v.is_finite() && *v >= 0.0)));
        assert!(all[1].note.contains("144 columns measured (#0-6, 8-144)"), "{}", all[1].note);
        assert!(all[1].note.contains("1 columns NOT MEASURED"), "{}", all[1].note);
    }

    #[test]
    fn negative_noise_is_clamped_and_its_sum_told() {
        let mut block = single(Side::TransmissionFront, 0, 0, 1.0);
        block.values[5 * PATCHES] = -0.1;
        let all = complete(&[block]).unwrap();
        assert_eq!(all[0].values[5 * PATCHES], 0.0);
        // 0.1 x 0.023323 sr of a patch in the second ring.
        assert!(all[0].note.contains("2.33e-3 to the worst"), "{}", all[0].note);
    }

    #[test]
    fn a_side_given_twice_is_refused() {
        let set = synthetic::full(&[Side::ReflectionBack]);
        let b = FilledBlock::from_measured(&set, 0, Side::ReflectionBack).unwrap().unwrap();
        assert!(complete(&[b.clone(), b]).unwrap_err().to_string().contains("given twice"));
    }
}
