//! Writes the products of a run: exports, plots, report; each by a temporary name and a rename, so none is ever half there.

use super::context::ProductContext;
use super::error::{ProductError, Result};
use super::export::ExportError;
use super::export::hdf5_nexus::{Spectrum, write_hdf5};
use super::export::klems_xml::{klems_xml, klems_xml_band};
use super::facts::{blocks, context, headline};
use super::plots::PlotError;
use super::plots::canvas::Picture;
use super::plots::{hemisphere, overview, spectrum};
use super::reduce::{Reduction, Run, reduce};
use super::report::{Figure, ProductFile, report};
use crate::archive::seal::{ProductSeal, frames_digest};
use crate::archive::write_atomic;
use crate::config::scan::Format;
use crate::digest::sha256_hex;
use crate::engine::bsdf::set::{BsdfSet, Column, Quantity};
use serde::Serialize;
use std::path::{Path, PathBuf};

pub use crate::archive::seal::PRODUCTS;

const KLEMS: &str = "Klems matrix, Visible and Solar: Radiance, WINDOW, EnergyPlus";
const HDF5: &str = "everything with its uncertainty, NeXus layout: h5py, silx";

/// A product.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Product {
    /// `NAME.xml`: Klems matrix, Visible and Solar.
    KlemsXml,
    /// `bands/NAME.xml`: one Klems matrix a band.
    KlemsXmlBands,
    /// `bsdf.h5`.
    Hdf5,
    /// `plots/*.png`.
    Plots,
    /// `report.html`.
    Report,
}

/// What was made.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Made {
    /// Files, the report last.
    pub files: Vec<PathBuf>,
    /// T and R in a few lines.
    pub headline: Vec<String>,
    /// Products that the scan asks for and that the run's frames cannot give, each with the reason.
    pub not_made: Vec<String>,
}

/// A file that was written, with what it is.
struct Written {
    path: PathBuf,
    what: String,
}

struct Maker<'a> {
    run: &'a Run,
    folder: PathBuf,
    reduction: Reduction,
    context: ProductContext,
    written: Vec<Written>,
    /// Exports of an earlier call.
    earlier: Vec<Written>,
    not_made: Vec<String>,
    /// Lifted with the first product.
    seal: Option<ProductSeal>,
}

/// Everything the scan asks for, plots and report. An export that the run's frames cannot give is named in the report
/// with the reason; the others are made all the same.
///
/// # Errors
/// [`ProductError`].
pub fn make_all(run: &Run) -> Result<Made> {
    let formats = &run.document.scan.products.formats;
    let mut products: Vec<Product> = formats
        .iter()
        .map(|f| match f {
            Format::KlemsXml => Product::KlemsXml,
            Format::Hdf5 => Product::Hdf5,
        })
        .collect();
    products.extend([Product::Plots, Product::Report]);
    let mut maker = Maker::new(run)?;
    for product in products {
        match maker.make(product) {
            Err(ProductError::Nothing(why)) => maker.not_made(product, &why),
            made => made?,
        }
    }
    maker.finish()
}

/// The products that are asked for, in this order.
///
/// # Errors
/// [`ProductError`].
pub fn make(run: &Run, products: &[Product]) -> Result<Made> {
    let mut maker = Maker::new(run)?;
    for product in products {
        maker.make(*product)?;
    }
    maker.finish()
}

// === impl Product ===

impl Product {
    fn words(self) -> &'static str {
        match self {
            Product::KlemsXml => "Klems XML",
            Product::KlemsXmlBands => "Klems XML of single bands",
            Product::Hdf5 => "HDF5",
            Product::Plots => "plots",
            Product::Report => "report",
        }
    }
}

// === impl Maker ===

impl<'a> Maker<'a> {
    fn new(run: &'a Run) -> Result<Maker<'a>> {
        let reduction = reduce(run)?;
        let context = context(run, &reduction.set, &reduction.facts)?;
        let folder = run.dir.path().join(PRODUCTS);
        let (written, earlier, not_made) = (Vec::new(), Vec::new(), Vec::new());
        Ok(Maker { run, folder, reduction, context, written, earlier, not_made, seal: None })
    }

    fn make(&mut self, product: Product) -> Result<()> {
        match product {
            Product::KlemsXml => self.klems(),
            Product::KlemsXmlBands => self.klems_bands(),
            Product::Hdf5 => self.hdf5(),
            Product::Plots => self.plots(),
            Product::Report => self.report(),
        }
    }

    fn not_made(&mut self, product: Product, why: &str) {
        let line = format!("NOT MADE: {}: {why}", product.words());
        self.context.notes.push(line.clone());
        self.not_made.push(line);
    }

    fn finish(self) -> Result<Made> {
        let files: Vec<PathBuf> = self.written.into_iter().map(|w| w.path).collect();
        if let Some(seal) = self.seal {
            seal.set(&files)?;
        }
        Ok(Made { files, headline: headline(&self.reduction.set), not_made: self.not_made })
    }
}

// === what a maker makes ===

impl Maker<'_> {
    /// The place of a product, ready to be written to.
    fn place(&mut self, name: &str) -> Result<PathBuf> {
        if self.seal.is_none() {
            let from = frames_digest(self.run.frames.values());
            self.seal = Some(ProductSeal::lift(self.run.dir.path(), from)?);
        }
        let path = self.folder.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent)?;
        }
        Ok(path)
    }

    fn write(&mut self, name: &str, bytes: &[u8], what: &str) -> Result<()> {
        let path = self.place(name)?;
        write_atomic(&path, bytes)?;
        self.written.push(Written { path, what: what.to_owned() });
        Ok(())
    }

    fn index(&self, wanted: impl Fn(&Quantity) -> bool) -> Option<usize> {
        self.reduction.set.quantities.iter().position(wanted)
    }

    fn klems(&mut self) -> Result<()> {
        let set = &self.reduction.set;
        let visible = self.index(|q| *q == Quantity::Visible);
        let solar = self.index(|q| matches!(q, Quantity::Solar { .. }));
        let (Some(visible), Some(solar)) = (visible, solar) else {
            return Err(ProductError::Nothing(
                "the Klems file needs Visible and Solar, and the measured bands do not reach far enough for both; \
                 measure more bands, or ask for klems-xml-bands"
                    .into(),
            ));
        };
        let uncertainty = self.context.uncertainty_summary(set);
        let xml =
            klems_xml(&self.context, &blocks(self.run, set, visible), &blocks(self.run, set, solar), &uncertainty)?;
        self.write("bsdf.xml", xml.as_bytes(), KLEMS)
    }

    fn klems_bands(&mut self) -> Result<()> {
        for index in 0..self.reduction.set.quantities.len() {
            let set = &self.reduction.set;
            let Some(quantity @ Quantity::Band { .. }) = set.quantities.get(index) else { continue };
            let uncertainty = self.context.uncertainty_summary(set);
            let xml = klems_xml_band(&self.context, quantity, &blocks(self.run, set, index), &uncertainty)?;
            let name = quantity.name();
            self.write(&format!("bands/{name}.xml"), xml.as_bytes(), &format!("Klems matrix of band {name}"))?;
        }
        Ok(())
    }

    fn hdf5(&mut self) -> Result<()> {
        let path = self.place("bsdf.h5")?;
        write_hdf5(&path, &self.reduction.set, &self.context, &spectra(self.run))?;
        let what = HDF5.to_owned();
        self.written.push(Written { path, what });
        Ok(())
    }

    fn plots(&mut self) -> Result<()> {
        let mut pictures: Vec<(String, Picture, String)> = Vec::new();
        let set = &self.reduction.set;
        for (name, what, picture) in [
            (
                "overview",
                "the headline quantity, up to five directions of each side",
                overview::overview(set, Quantity::headline(&set.quantities)),
            ),
            ("spectrum", "bands and totals of the column nearest to the normal", spectrum_of(set)),
        ] {
            if let Some(picture) = drawn(picture)? {
                pictures.push((format!("plots/{name}.png"), picture, what.to_owned()));
            }
        }
        for column in featured(set) {
            let Some(picture) = drawn(hemisphere::hemisphere(set, column))? else { continue };
            let quantity = set.quantities.get(column.quantity).map(Quantity::name).unwrap_or_default();
            let (side, place) = (side_slug(column), place_slug(column));
            let what = format!("{} of {quantity}, source at {place}", super::context::side_words(column.side));
            pictures.push((format!("plots/{side}-{place}-{quantity}.png"), picture, what));
        }
        for (name, picture, what) in pictures {
            let path = self.place(&name)?;
            picture.write(&path)?;
            self.written.push(Written { path, what });
        }
        Ok(())
    }

    fn report(&mut self) -> Result<()> {
        let mut figures = Vec::new();
        let mut files = Vec::new();
        self.find_earlier();
        for w in self.earlier.iter().chain(&self.written) {
            let bytes = std::fs::read(&w.path)?;
            let name = w.path.strip_prefix(&self.folder).unwrap_or(&w.path).display().to_string();
            files.push(ProductFile { name: name.clone(), what: w.what.clone(), sha256: sha256_hex(&bytes) });
            if shown_in_report(Path::new(&name), &self.reduction.set) {
                let wide = name.ends_with("overview.png") || name.ends_with("spectrum.png");
                figures.push(Figure { caption: w.what.clone(), png: bytes, wide });
            }
        }
        let page = report(&self.context, &self.reduction.set, &figures, &files);
        self.write("report.html", page.as_bytes(), "the report")
    }
}

// === what lies there already ===

impl Maker<'_> {
    /// Exports that an earlier call made belong into the list of files too.
    fn find_earlier(&mut self) {
        for (name, what) in [("bsdf.xml", KLEMS), ("bsdf.h5", HDF5)] {
            let path = self.folder.join(name);
            if path.is_file() && !self.written.iter().any(|w| w.path == path) {
                self.earlier.push(Written { path, what: what.to_owned() });
            }
        }
    }
}

/// Plots of the totals go into the report; those of single bands lie beside it.
fn shown_in_report(name: &Path, set: &BsdfSet) -> bool {
    let Some(stem) = name.file_stem().and_then(|s| s.to_str()) else { return false };
    let bands = set.quantities.iter().filter(|q| matches!(q, Quantity::Band { .. }));
    name.extension().is_some_and(|e| e == "png") && !bands.map(Quantity::name).any(|b| stem.ends_with(&format!("-{b}")))
}

/// Of every side: the headline quantity in three directions from the normal outward, and every band at the first.
fn featured(set: &BsdfSet) -> Vec<&Column> {
    let headline = Quantity::headline(&set.quantities);
    let mut out = Vec::new();
    for side in crate::engine::optics::side::Side::ALL {
        let mut of: Vec<&Column> = set.columns.iter().filter(|c| c.side == side).collect();
        of.sort_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta));
        let first = of.first().map(|c| c.incident);
        let headliners: Vec<&Column> = of.iter().copied().filter(|c| c.quantity == headline).collect();
        let n = headliners.len();
        let mut picked: Vec<usize> = vec![0, n / 2, n.saturating_sub(1)];
        picked.dedup();
        out.extend(picked.into_iter().filter_map(|i| headliners.get(i).copied()));
        out.extend(of.into_iter().filter(|c| Some(c.incident) == first && c.quantity != headline));
    }
    out
}

fn spectrum_of(set: &BsdfSet) -> std::result::Result<Picture, PlotError> {
    let nearest = set.columns.iter().min_by(|a, b| a.incident.theta.total_cmp(&b.incident.theta));
    nearest.map_or(Err(PlotError::Empty("the run has no column".to_owned())), |c| spectrum::spectrum(set, c.incident))
}

/// A picture, or nothing where there is nothing to draw.
fn drawn(picture: std::result::Result<Picture, PlotError>) -> Result<Option<Picture>> {
    match picture {
        Ok(picture) => Ok(Some(picture)),
        Err(PlotError::Empty(_)) => Ok(None),
        Err(e) => Err(e.into()),
    }
}

fn side_slug(column: &Column) -> String {
    super::context::side_words(column.side).to_lowercase().replace(' ', "-")
}

fn place_slug(column: &Column) -> String {
    let (theta, phi) = column.incident.degrees();
    format!("{theta:.1}-{phi:.1}")
}

/// Spectra that go into the HDF5 file.
fn spectra(run: &Run) -> Vec<Spectrum> {
    let lamp = &run.spectra.lamp;
    vec![Spectrum {
        name: "lamp".to_owned(),
        wavelength_nm: lamp.wavelength_nm().to_vec(),
        value: lamp.values().to_vec(),
        meaning: "relative spectral power of the lamp".to_owned(),
    }]
}

impl From<ExportError> for ProductError {
    fn from(e: ExportError) -> ProductError {
        ProductError::Nothing(e.to_string())
    }
}

impl From<PlotError> for ProductError {
    fn from(e: PlotError) -> ProductError {
        ProductError::Nothing(e.to_string())
    }
}
