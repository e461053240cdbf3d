//! What a scan's bands will give, told before the night.

use crate::config::check::Checked;
use crate::config::scan::{Format, ReferenceMode};
use crate::engine::bsdf::set::Quantity;
use crate::products::error::ProductError;
use crate::products::reduce::{InstrumentSpectra, Setup, Standards, quantities};

/// A warning when the scan asks for a Klems file that its bands will not give.
///
/// # Errors
/// Spectra of the instrument that do not cover what the bands see: the night would give no numbers, or wrong ones.
pub fn what_bands_give(checked: &Checked) -> Result<Option<String>, ProductError> {
    let of_role = |role: &str| checked.files.iter().find(|f| f.role == role);
    let text = |role: &str| Ok(of_role(role).map(|f| String::from_utf8_lossy(&f.bytes).into_owned()));
    let spectra = InstrumentSpectra::of(&checked.instrument_dir, checked.calibrations.keys(), &text)?;
    let (standards, scan) = (Standards::load()?, &checked.scan);
    let setup =
        Setup { instrument: &checked.instrument, bands: &scan.bands.names, spectra: &spectra, standards: &standards };
    let measures = |transmission: bool| {
        scan.reference.mode == ReferenceMode::Diffuser
            && scan.incidence.sides.iter().any(|side| side.is_transmission() == transmission)
    };
    let given = quantities(setup, [measures(false), measures(true)])?;
    if !scan.products.formats.contains(&Format::KlemsXml) {
        return Ok(None);
    }
    let lacks = |there: bool, name: &'static str| (!there).then_some(name);
    let visible = lacks(given.contains(&Quantity::Visible), "Visible");
    let solar = lacks(given.iter().any(|q| matches!(q, Quantity::Solar { .. })), "Solar");
    let lacking: Vec<&str> = visible.into_iter().chain(solar).collect();
    Ok((!lacking.is_empty()).then(|| {
        format!(
            "`products.formats` asks for klems-xml, but the bands do not reach far enough for {}; that file will not be \
             made unless `bands.use` names more bands",
            lacking.join(" and ")
        )
    }))
}
