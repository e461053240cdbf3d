//! `bsdf.h5`: everything that is known, uncertainty included, in a NeXus layout that h5py, silx and NeXpy open.
//!
//! ```text
//! /entry            NXentry, default = data
//!   data            NXdata, signal = bsdf, axes = side, incident, quantity, patch
//!     bsdf, u (k = 1), u_random, max (1/sr), coverage (0 to 1); NaN where nothing was measured; bsdf_errors is u
//!     side, incident, quantity, patch: the axes, plain numbers into the tables below
//!   hemispherical   NXdata, signal = value; value_errors (k = 1)
//!   tables          side_name; incident_theta_deg, incident_phi_deg (vector to the source); quantity_name, _kind,
//!                   _lower_nm, _upper_nm; patch_theta_deg, _phi_deg, _lower_deg, _upper_deg, _projected_solid_angle
//!   sample, instrument, provenance (context_json holds all of the context), spectra/NAME
//! ```
//! The bytes depend on the content alone: no object times. See NeXus manual, NXdata and NXroot.

use super::ExportError;
use crate::archive::disk::{commit_file, temporary_name};
use crate::engine::bsdf::set::{BsdfSet, PatchValue, Quantity};
use crate::engine::optics::direction::Direction;
use crate::engine::optics::side::Side;
use crate::products::context::{ProductContext, side_words};
use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, File, Group, H5Type, Location};
use std::path::Path;

/// A spectrum that goes along: a band's kernel, the lamp, a weighting function.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Name of the group, e.g. `kernel_f3`; letters, digits and underscores.
    pub name: String,
    /// Wavelengths in nm.
    pub wavelength_nm: Vec<f64>,
    /// Values at them.
    pub value: Vec<f64>,
    /// What the values are, with unit.
    pub meaning: String,
}

/// How a number is taken from a patch.
type Field = fn(&PatchValue) -> f64;

/// The axes of the big arrays.
struct Axes {
    sides: Vec<Side>,
    incidents: Vec<Direction>,
    quantities: usize,
    patches: usize,
}

/// Writes the file: temporary name, fsync, rename.
///
/// # Errors
/// [`ExportError::Hdf5`] with the library's words, [`ExportError::Unfit`] for a set without columns or with columns of
/// another length than its basis, [`ExportError::Io`] from the rename.
pub fn write_hdf5(
    path: &Path,
    set: &BsdfSet,
    context: &ProductContext,
    spectra: &[Spectrum],
) -> Result<(), ExportError> {
    let axes = Axes::of(set)?;
    let temporary = temporary_name(path);
    fill(&temporary, set, context, spectra, &axes)
        .map_err(|source| ExportError::Hdf5 { path: path.to_owned(), source })?;
    Ok(commit_file(&temporary, path)?)
}

fn fill(path: &Path, set: &BsdfSet, context: &ProductContext, spectra: &[Spectrum], axes: &Axes) -> hdf5::Result<()> {
    let file = File::with_options().with_fcpl(|p| p.obj_track_times(false)).create(path)?;
    attribute(&file, "NX_class", "NXroot")?;
    attribute(&file, "default", "entry")?;
    attribute(&file, "creator", "goniod")?;
    let entry = group(&file, "entry", "NXentry")?;
    attribute(&entry, "default", "data")?;
    text(&entry, "title", &format!("BSDF of {}, {}", context.sample.name, context.scan_name))?;
    text(&entry, "experiment_identifier", &context.run_id)?;
    text(&entry, "program_name", "goniod")?;
    text(&entry, "start_time", &context.started.to_string())?;
    if let Some(end) = context.finished {
        text(&entry, "end_time", &end.to_string())?;
    }
    data(&entry, set, axes)?;
    hemispherical(&entry, set, axes)?;
    tables(&entry, set, axes)?;
    provenance(&entry, context)?;
    if !spectra.is_empty() {
        let all = group(&entry, "spectra", "NXcollection")?;
        spectra.iter().try_for_each(|s| spectrum(&all, s))?;
    }
    file.close()
}

fn data(entry: &Group, set: &BsdfSet, axes: &Axes) -> hdf5::Result<()> {
    let data = group(entry, "data", "NXdata")?;
    attribute(&data, "signal", "bsdf")?;
    attributes(&data, "axes", &["side", "incident", "quantity", "patch"])?;
    let fields: [(&str, &str, Field); 5] = [
        ("bsdf", "1/sr", |p| p.bsdf),
        ("u", "1/sr", |p| p.u),
        ("u_random", "1/sr", |p| p.u_random),
        ("coverage", "1", |p| p.coverage),
        ("max", "1/sr", |p| p.max),
    ];
    for (name, unit, field) in fields {
        let mut values = vec![f64::NAN; axes.len() * axes.patches];
        for column in &set.columns {
            let Some(at) = axes.place(column.side, column.incident, column.quantity) else { continue };
            for (slot, patch) in values.iter_mut().skip(at * axes.patches).zip(&column.patches) {
                *slot = field(patch);
            }
        }
        let shape = [axes.sides.len(), axes.incidents.len(), axes.quantities, axes.patches];
        let dataset = array(&data, name, &shape, &values)?;
        attribute(&dataset, "units", unit)?;
    }
    data.link_hard("/entry/data/u", "bsdf_errors")?;
    for (name, count, meaning) in [
        ("side", axes.sides.len(), "number in tables/side_name"),
        ("incident", axes.incidents.len(), "number in tables/incident_theta_deg and incident_phi_deg"),
        ("quantity", axes.quantities, "number in tables/quantity_name"),
        ("patch", axes.patches, "patch of the emergent basis, number in tables/patch_theta_deg"),
    ] {
        let axis = counting(&data, name, count)?;
        attribute(&axis, "long_name", meaning)?;
    }
    Ok(())
}

fn hemispherical(entry: &Group, set: &BsdfSet, axes: &Axes) -> hdf5::Result<()> {
    let data = group(entry, "hemispherical", "NXdata")?;
    attribute(&data, "signal", "value")?;
    attributes(&data, "axes", &["side", "incident", "quantity"])?;
    let (mut values, mut errors) = (vec![f64::NAN; axes.len()], vec![f64::NAN; axes.len()]);
    for column in &set.columns {
        let at = axes.place(column.side, column.incident, column.quantity);
        if let Some((value, error)) = at.and_then(|at| Some((values.get_mut(at)?, errors.get_mut(at)?))) {
            (*value, *error) = (column.hemispherical, column.hemispherical_u);
        }
    }
    let shape = [axes.sides.len(), axes.incidents.len(), axes.quantities];
    let value = array(&data, "value", &shape, &values)?;
    attribute(&value, "long_name", "direct-hemispherical transmittance or reflectance")?;
    attribute(&value, "units", "1")?;
    let errors = array(&data, "value_errors", &shape, &errors)?;
    attribute(&errors, "long_name", "standard uncertainty, k = 1")?;
    for (name, count) in [("side", axes.sides.len()), ("incident", axes.incidents.len()), ("quantity", axes.quantities)]
    {
        counting(&data, name, count)?;
    }
    Ok(())
}

fn tables(entry: &Group, set: &BsdfSet, axes: &Axes) -> hdf5::Result<()> {
    let tables = group(entry, "tables", "NXcollection")?;
    attribute(
        &tables,
        "frame",
        "z towards the interior, y up, x right as seen from the interior; Front = exterior; incident: vector to the \
         source, theta from the normal on the source's side; emergent patch: theta from the normal on the emergent side",
    )?;
    texts(&tables, "side_name", axes.sides.iter().map(|&s| side_words(s).to_owned()))?;
    let numbers = |name: &str, values: Vec<f64>| array(&tables, name, &[values.len()], &values);
    numbers("incident_theta_deg", axes.incidents.iter().map(|d| d.degrees().0).collect())?;
    numbers("incident_phi_deg", axes.incidents.iter().map(|d| d.degrees().1).collect())?;
    texts(&tables, "quantity_name", set.quantities.iter().map(Quantity::name))?;
    texts(&tables, "quantity_kind", set.quantities.iter().map(|q| kind(q).0.to_owned()))?;
    numbers("quantity_lower_nm", set.quantities.iter().map(|q| kind(q).1[0]).collect())?;
    numbers("quantity_upper_nm", set.quantities.iter().map(|q| kind(q).1[1]).collect())?;
    text(&tables, "basis_name", &set.basis.name)?;
    let centres: Vec<(f64, f64)> =
        (0..axes.patches).filter_map(|p| set.basis.centre(p)).map(Direction::degrees).collect();
    let rings = || set.basis.rings.iter().flat_map(|r| std::iter::repeat_n(r, r.patches));
    numbers("patch_theta_deg", centres.iter().map(|c| c.0).collect())?;
    numbers("patch_phi_deg", centres.iter().map(|c| c.1).collect())?;
    numbers("patch_lower_deg", rings().map(|r| r.lower_deg).collect())?;
    numbers("patch_upper_deg", rings().map(|r| r.upper_deg).collect())?;
    numbers("patch_phi_width_deg", rings().map(|r| 360.0 / r.patches as f64).collect())?;
    let solid = numbers("patch_projected_solid_angle", set.basis.projected_solid_angles())?;
    attribute(&solid, "units", "sr")
}

fn kind(quantity: &Quantity) -> (&'static str, [f64; 2]) {
    match quantity {
        Quantity::Band { interval_nm, .. } => ("band", *interval_nm),
        Quantity::RadiometricTotal { interval_nm } => ("radiometric total", *interval_nm),
        Quantity::Visible => ("visible, D65 x V(lambda)", [380.0, 780.0]),
        Quantity::Solar { measured_nm } => ("solar, ASTM G173 direct; interval = measured part", *measured_nm),
    }
}

fn provenance(entry: &Group, context: &ProductContext) -> hdf5::Result<()> {
    let sample = group(entry, "sample", "NXsample")?;
    text(&sample, "name", &context.sample.name)?;
    text(&sample, "manufacturer", &context.sample.manufacturer)?;
    let thickness = array(&sample, "thickness", &[1], &[context.sample.thickness_mm])?;
    attribute(&thickness, "units", "mm")?;
    let instrument = group(entry, "instrument", "NXinstrument")?;
    text(&instrument, "name", &context.instrument)?;
    text(&instrument, "lamp", &context.lamp)?;
    texts(&instrument, "serial", context.serials.iter().map(|(device, serial)| format!("{device} {serial}")))?;
    let bands = context.bands.iter();
    let row = |b: &crate::products::context::BandRow| {
        format!("{} {:.0}-{:.0} nm, {}, {}", b.name, b.interval_nm[0], b.interval_nm[1], b.glasses, b.camera)
    };
    texts(&instrument, "bands", bands.map(row))?;
    let provenance = group(entry, "provenance", "NXcollection")?;
    text(&provenance, "run_id", &context.run_id)?;
    text(&provenance, "plan_hash", &context.plan_hash)?;
    text(&provenance, "normalisation", &context.normalisation)?;
    texts(&provenance, "versions", context.versions.iter().map(|(what, version)| format!("{what} {version}")))?;
    texts(&provenance, "notes", context.notes.iter().cloned())?;
    let c = &context.counts;
    for (name, count) in
        [("planned", c.planned), ("stored", c.stored), ("missing", c.missing), ("rejected", c.rejected)]
    {
        array(&provenance, name, &[1], &[count])?;
    }
    let json = serde_json::to_string(context).map_err(|e| hdf5::Error::from(e.to_string()))?;
    text(&provenance, "context_json", &json)
}

fn spectrum(parent: &Group, spectrum: &Spectrum) -> hdf5::Result<()> {
    let data = group(parent, &spectrum.name, "NXdata")?;
    attribute(&data, "signal", "value")?;
    attributes(&data, "axes", &["wavelength"])?;
    let wavelength = array(&data, "wavelength", &[spectrum.wavelength_nm.len()], &spectrum.wavelength_nm)?;
    attribute(&wavelength, "units", "nm")?;
    let value = array(&data, "value", &[spectrum.value.len()], &spectrum.value)?;
    attribute(&value, "long_name", &spectrum.meaning)
}

fn group(parent: &Group, name: &str, class: &str) -> hdf5::Result<Group> {
    let group = parent.create_group(name)?;
    attribute(&group, "NX_class", class)?;
    Ok(group)
}

/// A dataset of numbers; big ones are packed with gzip and shuffle where the library has them.
fn array<T: H5Type>(parent: &Group, name: &str, shape: &[usize], values: &[T]) -> hdf5::Result<Dataset> {
    let mut builder = parent.new_dataset::<T>();
    if shape.len() == 4 && hdf5::filters::deflate_available() {
        let chunk: Vec<usize> = shape.iter().enumerate().map(|(d, &n)| if d < 2 { n.min(16) } else { n }).collect();
        builder = builder.chunk(chunk).shuffle().deflate(4);
    }
    let dataset = builder.obj_track_times(false).shape(shape).create(name)?;
    dataset.as_writer().write_raw(values)?;
    Ok(dataset)
}

fn counting(parent: &Group, name: &str, count: usize) -> hdf5::Result<Dataset> {
    let numbers: Vec<u32> = (0..).take(count).collect();
    array(parent, name, &[count], &numbers)
}

fn word(value: &str) -> hdf5::Result<VarLenUnicode> {
    // A NUL would end the string early in every reader.
    value.replace('\0', " ").parse().map_err(|_| hdf5::Error::from(format!("'{value}' is not a valid string")))
}

fn text(parent: &Group, name: &str, value: &str) -> hdf5::Result<()> {
    parent.new_dataset::<VarLenUnicode>().obj_track_times(false).create(name)?.write_scalar(&word(value)?)
}

fn texts(parent: &Group, name: &str, values: impl Iterator<Item = String>) -> hdf5::Result<()> {
    let words = values.map(|v| word(&v)).collect::<hdf5::Result<Vec<_>>>()?;
    array(parent, name, &[words.len()], &words).map(|_| ())
}

fn attribute(location: &Location, name: &str, value: &str) -> hdf5::Result<()> {
    location.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&word(value)?)
}

fn attributes(location: &Location, name: &str, values: &[&str]) -> hdf5::Result<()> {
    let words = values.iter().map(|v| word(v)).collect::<hdf5::Result<Vec<_>>>()?;
    location.new_attr::<VarLenUnicode>().shape(words.len()).create(name)?.write_raw(&words)
}

// === impl Axes ===

impl Axes {
    fn of(set: &BsdfSet) -> Result<Axes, ExportError> {
        let patches = set.basis.len();
        let unfit = |what: String| ExportError::Unfit {
            format: "HDF5",
            what,
            advice: "reduce the run again; if it stays, keep the run and report it",
        };
        if set.columns.is_empty() {
            return Err(unfit("the result holds no column".to_owned()));
        }
        if let Some(c) = set.columns.iter().find(|c| c.patches.len() != patches || c.quantity >= set.quantities.len()) {
            return Err(unfit(format!(
                "a column of {} has {} patches and quantity {}, the set has {patches} and {}",
                side_words(c.side),
                c.patches.len(),
                c.quantity,
                set.quantities.len()
            )));
        }
        let sides = Side::ALL.into_iter().filter(|&s| set.columns.iter().any(|c| c.side == s)).collect();
        let mut incidents: Vec<Direction> = Vec::new();
        for column in &set.columns {
            if !incidents.iter().any(|&d| same(d, column.incident)) {
                incidents.push(column.incident);
            }
        }
        incidents.sort_by(|a, b| a.theta.total_cmp(&b.theta).then(a.phi.total_cmp(&b.phi)));
        Ok(Axes { sides, incidents, quantities: set.quantities.len(), patches })
    }

    /// Number of columns that the arrays have room for.
    fn len(&self) -> usize {
        self.sides.len() * self.incidents.len() * self.quantities
    }

    fn place(&self, side: Side, incident: Direction, quantity: usize) -> Option<usize> {
        let s = self.sides.iter().position(|&x| x == side)?;
        let i = self.incidents.iter().position(|&x| same(x, incident))?;
        Some((s * self.incidents.len() + i) * self.quantities + quantity)
    }
}

fn same(a: Direction, b: Direction) -> bool {
    (a.theta - b.theta).abs() < 1e-9 && (a.phi - b.phi).abs() < 1e-9
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::products::context::synthetic;

    fn set() -> BsdfSet {
        let mut set = synthetic::directions(&[Side::TransmissionFront, Side::ReflectionFront], &[0, 51, 12]);
        set.columns.retain(|c| c.side == Side::TransmissionFront || c.incident.theta > 0.0);
        set
    }

    #[test]
    fn values_stand_at_their_place_and_gaps_are_nan() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bsdf.h5");
        let set = set();
        write_hdf5(&path, &set, &synthetic::context(), &[]).unwrap();
        if let Some(folder) = std::env::var_os("GONIOD_PLOTS") {
            std::fs::copy(&path, Path::new(&folder).join("bsdf.h5")).unwrap();
        }
        let file = File::open(&path).unwrap();
        let bsdf = file.dataset("entry/data/bsdf").unwrap();
        assert_eq!(bsdf.shape(), [2, 3, 7, 145]);
        let values: Vec<f64> = bsdf.read_raw().unwrap();
        let theta: Vec<f64> = file.dataset("entry/tables/incident_theta_deg").unwrap().read_raw().unwrap();
        assert!((theta[1] - 20.0).abs() < 1e-9 && (theta[2] - 40.0).abs() < 1e-9);
        let column = set.columns.iter().find(|c| c.incident.theta > 0.6 && c.quantity == 5).unwrap();
        let at = (2 * 7 + 5) * 145;
        assert!(values[at..at + 145].iter().zip(&column.patches).all(|(v, p)| *v == p.bsdf));
        let gap = 3 * 7 * 145;
        assert!(values[gap..gap + 145].iter().all(|v| v.is_nan()), "reflection at normal incidence was not measured");
        let u: Vec<f64> = file.dataset("entry/data/bsdf_errors").unwrap().read_raw().unwrap();
        assert_eq!(u[at], column.patches[0].u);
        let t: Vec<f64> = file.dataset("entry/hemispherical/value").unwrap().read_raw().unwrap();
        assert!((t[2 * 7 + 5] - 0.7).abs() < 1e-12 && t[3 * 7].is_nan());
    }

    #[test]
    fn the_same_content_gives_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let spectra = [Spectrum {
            name: "kernel_f3".to_owned(),
            wavelength_nm: vec![500.0, 530.0, 560.0],
            value: vec![0.1, 1.0, 0.1],
            meaning: "kernel of f3, relative".to_owned(),
        }];
        let bytes = |name: &str| {
            let path = folder.path().join(name);
            write_hdf5(&path, &set(), &synthetic::context(), &spectra).unwrap();
            std::fs::read(path).unwrap()
        };
        let first = bytes("a.h5");
        // Object times have a resolution of one second.
        std::thread::sleep(std::time::Duration::from_millis(1100));
        assert!(first == bytes("b.h5"), "two files of the same content differ");
    }

    #[test]
    fn an_empty_result_is_refused() {
        let set = synthetic::full(&[]);
        let error = write_hdf5(Path::new("never.h5"), &set, &synthetic::context(), &[]).unwrap_err().to_string();
        assert!(error.contains("holds no column"), "{error}");
    }
}
