//! Klems Full matrix XML ("WINDOW BSDF XML"): Visible and Solar, all four directions, as WINDOW, pywincalc, EnergyPlus
//! and Radiance read it.
//!
//! What the readers demand: all eight blocks and no other wavelength (pywincalc 3.3.1), no empty required tag (an empty
//! `Manufacturer` crashes it), thickness in metre or millimetre, the type BTDF also for reflection, 145 x 145 numbers,
//! none of them NaN. Bands therefore go into files of their own.

use super::ExportError;
use super::klems_blocks::{WrittenBlock, complete};
use super::matrix::{FilledBlock, PATCHES};
use crate::engine::bsdf::set::Quantity;
use crate::engine::optics::basis::AngleBasis;
use crate::products::context::{ProductContext, side_words};
use crate::products::markup::escape;
use std::fmt::Write;

/// Device types that the schema knows.
const DEVICE_TYPES: [&str; 10] = [
    "Venetian blind horizontal",
    "Venetian blind vertical",
    "Woven shade",
    "Diffusing glass",
    "Specular glass",
    "Fritted Glass",
    "Cellular Shade",
    "Pleated Shade",
    "Solid Layer",
    "Other",
];

/// The two wavelength entries of a file: text, source and detector spectrum.
const VISIBLE: [&str; 3] = ["Visible", "CIE Illuminant D65 1nm.ssp", "ASTM E308 1931 Y.dsp"];
const SOLAR: [&str; 3] = ["Solar", "ASTM G173 AM1_5 37 Tilt Direct Full Spectrum.ssp", "None"];

/// The Klems file of a run.
///
/// `visible` and `solar` hold the blocks that are known, each side at most once; `uncertainty` is the one-line k = 2
/// summary ([`ProductContext::uncertainty_summary`]).
///
/// # Errors
/// [`ExportError::Unfit`] for values that are not finite, wrong sizes, or nothing measured at all.
pub fn klems_xml(
    context: &ProductContext,
    visible: &[FilledBlock],
    solar: &[FilledBlock],
    uncertainty: &str,
) -> Result<String, ExportError> {
    let (v, s) = (complete_some("Visible", visible)?, complete_some("Solar", solar)?);
    let mut remarks = run_remarks(context);
    remarks.push(uncertainty.to_owned());
    remarks.extend(block_remarks("Visible", &v));
    remarks.extend(block_remarks("Solar", &s));
    remarks.push(
        "Visible = D65 x V(lambda), Solar = ASTM G173 direct; outside the measured interval Solar is extrapolated."
            .to_owned(),
    );
    Ok(document(context, &context.sample.name, &[(VISIBLE, &v), (SOLAR, &s)], &remarks))
}

/// The Klems file of one band: its lamp-weighted mean stands under Visible and, because the LBNL engine demands the
/// entry, under Solar; `Comments` say so.
///
/// # Errors
/// As [`klems_xml`].
pub fn klems_xml_band(
    context: &ProductContext,
    quantity: &Quantity,
    blocks: &[FilledBlock],
    uncertainty: &str,
) -> Result<String, ExportError> {
    let name = quantity.name();
    let written = complete_some(&name, blocks)?;
    let interval = match quantity {
        Quantity::Band { interval_nm: [a, b], .. } | Quantity::RadiometricTotal { interval_nm: [a, b] } => {
            format!("{a:.0}-{b:.0} nm")
        }
        _ => "its own spectral weighting".to_owned(),
    };
    let mut remarks = vec![format!(
        "ONE BAND ONLY: the entries called Visible and Solar both hold the lamp-weighted mean of {name}, {interval}; \
         neither is a photometric or solar average."
    )];
    remarks.extend(run_remarks(context));
    remarks.push(uncertainty.to_owned());
    remarks.extend(block_remarks(&name, &written));
    let title = format!("{}, {name} {interval}", context.sample.name);
    Ok(document(context, &title, &[(VISIBLE, &written), (SOLAR, &written)], &remarks))
}

fn complete_some(what: &str, blocks: &[FilledBlock]) -> Result<Vec<WrittenBlock>, ExportError> {
    if blocks.is_empty() {
        return Err(ExportError::Unfit {
            format: "Klems XML",
            what: format!("{what} has no block at all"),
            advice: "measure at least one side with the bands that this quantity needs",
        });
    }
    complete(blocks)
}

fn run_remarks(context: &ProductContext) -> Vec<String> {
    let bands: Vec<String> = context
        .bands
        .iter()
        .map(|b| format!("{} {:.0}-{:.0} nm ({}, {})", b.name, b.interval_nm[0], b.interval_nm[1], b.glasses, b.camera))
        .collect();
    let end = context.finished.map_or_else(|| "not finished".to_owned(), |t| t.to_string());
    vec![
        format!(
            "Measured with the video-goniophotometer {} from {} to {end}, run {}, plan {}.",
            context.instrument, context.started, context.run_id, context.plan_hash
        ),
        format!("Lamp: {}. Normalisation: {}. Bands: {}.", context.lamp, context.normalisation, bands.join("; ")),
        format!(
            "{} of {} exposures stored, {} missing.",
            context.counts.stored, context.counts.planned, context.counts.missing
        ),
        "Thermal values (conductivity, emissivity, TIR) are placeholders, not measured.".to_owned(),
        "Front = exterior; x right as seen from the interior, y up; an incident patch is named by the azimuth in which \
         the light travels."
            .to_owned(),
    ]
}

fn block_remarks(what: &str, blocks: &[WrittenBlock]) -> Vec<String> {
    blocks.iter().map(|b| format!("{what} {}", b.note)).collect()
}

type Entry<'a> = ([&'a str; 3], &'a [WrittenBlock]);

fn document(context: &ProductContext, name: &str, entries: &[Entry], remarks: &[String]) -> String {
    let mut xml = String::with_capacity(4_000_000);
    xml.push_str(concat!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n",
        "<WindowElement xmlns=\"http://windows.lbl.gov\" xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" ",
        "xsi:schemaLocation=\"http://windows.lbl.gov/BSDF-v1.4.xsd\">\n",
        "<WindowElementType>System</WindowElementType>\n<FileType>BSDF</FileType>\n<Optical>\n<Layer>\n",
    ));
    material(&mut xml, context, name, remarks);
    definition(&mut xml);
    for (words, blocks) in entries {
        for block in *blocks {
            wavelength_data(&mut xml, words, block);
        }
    }
    xml.push_str("</Layer>\n</Optical>\n</WindowElement>\n");
    xml
}

fn material(xml: &mut String, context: &ProductContext, name: &str, remarks: &[String]) {
    let filled = |text: &str| if text.trim().is_empty() { "unknown".to_owned() } else { escape(text.trim()) };
    let device = context.sample.device_type.as_deref().filter(|d| DEVICE_TYPES.contains(d)).unwrap_or("Other");
    // A thickness of zero is not accepted by the readers.
    let thickness = if context.sample.thickness_mm > 0.0 { context.sample.thickness_mm } else { 1.0 };
    let _ = write!(
        xml,
        "<Material>\n\t<Name>{}</Name>\n\t<Manufacturer>{}</Manufacturer>\n\
         \t<Thickness unit=\"millimeter\">{thickness}</Thickness>\n\t<DeviceType>{device}</DeviceType>\n\
         \t<ThermalConductivity>0.2</ThermalConductivity>\n\t<EmissivityFront>0.9</EmissivityFront>\n\
         \t<EmissivityBack>0.9</EmissivityBack>\n\t<TIR>0</TIR>\n\t<Comments>{}</Comments>\n</Material>\n",
        filled(name),
        filled(&context.sample.manufacturer),
        escape(&remarks.join(" ")),
    );
}

fn definition(xml: &mut String) {
    let basis = AngleBasis::klems_full();
    let _ = write!(
        xml,
        "<DataDefinition>\n\t<IncidentDataStructure>Columns</IncidentDataStructure>\n\t<AngleBasis>\n\
         \t\t<AngleBasisName>{}</AngleBasisName>\n",
        basis.name
    );
    for ring in &basis.rings {
        let _ = write!(
            xml,
            "\t\t<AngleBasisBlock>\n\t\t\t<Theta>{}</Theta>\n\t\t\t<nPhis>{}</nPhis>\n\t\t\t<ThetaBounds>\n\
             \t\t\t\t<LowerTheta>{}</LowerTheta>\n\t\t\t\t<UpperTheta>{}</UpperTheta>\n\
             \t\t\t</ThetaBounds>\n\t\t</AngleBasisBlock>\n",
            ring.nominal_deg(),
            ring.patches,
            ring.lower_deg,
            ring.upper_deg
        );
    }
    xml.push_str("\t</AngleBasis>\n</DataDefinition>\n");
}

fn wavelength_data(xml: &mut String, [wavelength, source, detector]: &[&str; 3], block: &WrittenBlock) {
    let _ = write!(
        xml,
        "<WavelengthData>\n\t<LayerNumber>System</LayerNumber>\n\
         \t<Wavelength unit=\"Integral\">{wavelength}</Wavelength>\n\t<SourceSpectrum>{source}</SourceSpectrum>\n\
         \t<DetectorSpectrum>{detector}</DetectorSpectrum>\n\t<WavelengthDataBlock>\n\
         \t\t<WavelengthDataDirection>{}</WavelengthDataDirection>\n\
         \t\t<ColumnAngleBasis>LBNL/Klems Full</ColumnAngleBasis>\n\
         \t\t<RowAngleBasis>LBNL/Klems Full</RowAngleBasis>\n\
         \t\t<ScatteringDataType>BTDF</ScatteringDataType>\n\t\t<ScatteringData>\n",
        side_words(block.side)
    );
    for row in block.values.chunks_exact(PATCHES) {
        for (i, value) in row.iter().enumerate() {
            xml.push_str(if i == 0 { "" } else { ", " });
            number(xml, *value);
        }
        xml.push_str(",\n");
    }
    xml.push_str("\t\t</ScatteringData>\n\t</WavelengthDataBlock>\n</WavelengthData>\n");
}

/// Eight significant digits: the largest error of a hemispherical value is far below 1e-6.
fn number(xml: &mut String, value: f64) {
    let _ = if value == 0.0 { write!(xml, "0") } else { write!(xml, "{value:.7e}") };
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::engine::optics::side::Side;
    use crate::products::context::synthetic;
    use crate::products::export::klems_read::read_klems;
    use crate::products::export::matrix::Origin;

    fn blocks(sides: &[Side]) -> Vec<FilledBlock> {
        let set = synthetic::full(sides);
        sides.iter().map(|&s| FilledBlock::from_measured(&set, 5, s).unwrap().unwrap()).collect()
    }

    #[test]
    fn the_reader_gives_back_what_was_written() {
        let given = blocks(&Side::ALL);
        let xml = klems_xml(&synthetic::context(), &given, &given, "k=2 line").unwrap();
        let file = read_klems(&xml).unwrap();
        assert_eq!(file.name, "blind <30> & \"test\"");
        assert_eq!(file.manufacturer, "unknown");
        assert_eq!(file.basis.rings, AngleBasis::klems_full().rings);
        assert_eq!(file.blocks.len(), 8);
        for band in ["Visible", "Solar"] {
            for block in &given {
                let read = file.block(band, block.side).unwrap();
                for (a, b) in read.values.iter().zip(&block.values) {
                    assert!((a - b).abs() <= 1e-6 * b.abs());
                }
            }
        }
        let t = file.hemispherical("Visible", Side::TransmissionFront).unwrap();
        assert!(t.iter().all(|t| (t - 0.7).abs() < 1e-6));
    }

    #[test]
    fn the_comments_tell_measured_from_invented() {
        let mut given = blocks(&[Side::TransmissionFront]);
        given[0].origin[1] = Origin::Symmetry;
        let xml = klems_xml(&synthetic::context(), &given, &given, "k=2 uncertainty: T 0.7000 +- 0.0210").unwrap();
        let comments = read_klems(&xml).unwrap().comments.unwrap();
        for part in [
            "Visible Transmission Front: 144 columns measured (#0, 2-144); 1 columns by symmetry (#1).",
            "Solar Transmission Back: not measured, by reciprocity from Transmission Front.",
            "Visible Reflection Back: NOT MEASURED, Lambertian placeholder of hemispherical 0.001.",
            "k=2 uncertainty: T 0.7000 +- 0.0210",
            "HMI 2.5 kW",
            "f3 500-560 nm",
            "2026-03-04T18:00:00Z",
        ] {
            assert!(comments.contains(part), "missing '{part}' in: {comments}");
        }
    }

    #[test]
    fn a_band_file_does_not_pass_for_a_visible_one() {
        let given = blocks(&[Side::TransmissionFront]);
        let quantity = Quantity::Band { name: "f3".to_owned(), interval_nm: [500.0, 560.0] };
        let xml = klems_xml_band(&synthetic::context(), &quantity, &given, "u").unwrap();
        let file = read_klems(&xml).unwrap();
        assert!(file.comments.unwrap().starts_with("ONE BAND ONLY"));
        assert!(file.name.ends_with("f3 500-560 nm"));
    }

    #[test]
    fn nothing_measured_is_refused() {
        let error = klems_xml(&synthetic::context(), &[], &[], "").unwrap_err().to_string();
        assert!(error.contains("Visible has no block"), "{error}");
    }

    #[test]
    fn required_tags_are_never_empty() {
        let mut context = synthetic::context();
        context.sample.name = "  ".to_owned();
        context.sample.thickness_mm = 0.0;
        context.sample.device_type = Some("toaster".to_owned());
        let given = blocks(&[Side::TransmissionFront]);
        let xml = klems_xml(&context, &given, &given, "").unwrap();
        assert!(xml.contains("<Name>unknown</Name>") && xml.contains("<Manufacturer>unknown</Manufacturer>"));
        assert!(xml.contains("<Thickness unit=\"millimeter\">1</Thickness>"));
        assert!(xml.contains("<DeviceType>Other</DeviceType>"));
    }
}
