//! The report: one HTML page without scripts or outside files, the verdict first.
//!
//! Can it be trusted ([`verdict`]), what came out (table, pictures, spectrum), how sure (coverage, budget), what happened in the night, how it was
//! measured, where it comes from. The page holds no clock: equal input gives equal bytes.

pub mod html;
pub mod sections;
pub mod verdict;

use super::markup::escape;
use crate::engine::bsdf::set::BsdfSet;
use crate::products::context::ProductContext;
use verdict::verdict;

/// A picture on the page.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// What it shows, in one sentence.
    pub caption: String,
    /// The PNG file's bytes.
    pub png: Vec<u8>,
    /// True for a picture that takes the whole width of the page.
    pub wide: bool,
}

/// A file that lies beside the report.
#[derive(Debug, Clone, PartialEq)]
pub struct ProductFile {
    /// Name relative to the report.
    pub name: String,
    /// What it is.
    pub what: String,
    /// Digest of its bytes.
    pub sha256: String,
}

/// The whole page as text (UTF-8).
pub fn report(context: &ProductContext, set: &BsdfSet, figures: &[Figure], files: &[ProductFile]) -> String {
    let verdict = verdict(context, set);
    let mut page = String::from("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    page.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
    page.push_str(&format!("<title>BSDF report: {}</title>\n", escape(&context.sample.name)));
    page.push_str("<style>\n");
    page.push_str(include_str!("style.css"));
    page.push_str("</style>\n</head>\n<body>\n<main>\n");
    for section in [
        sections::heading(context),
        sections::verdict(&verdict),
        sections::headline(set),
        sections::figures(figures),
        sections::coverage(set),
        sections::uncertainty(context),
        sections::night(context),
        sections::method(context),
        sections::provenance(context),
        sections::files(files),
    ] {
        page.push_str(&section);
    }
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::engine::optics::side::Side;
    use crate::products::context::synthetic;
    use crate::products::plots::{hemisphere::hemisphere, overview::overview, spectrum::spectrum};

    fn figures(set: &BsdfSet, folder: &std::path::Path) -> Vec<Figure> {
        let shown = set.columns.iter().filter(|c| c.quantity == 5 && c.incident.theta > 0.5).take(2);
        let mut pictures = vec![
            ("All hemispheres, visible.".to_owned(), overview(set, 5).unwrap(), true),
            ("Spectrum at normal incidence.".to_owned(), spectrum(set, set.columns[0].incident).unwrap(), true),
        ];
        pictures.extend(shown.map(|c| ("One direction, visible.".to_owned(), hemisphere(set, c).unwrap(), false)));
        let png = |picture: &crate::products::plots::canvas::Picture| {
            let path = folder.join("p.png");
            picture.write(&path).unwrap();
            std::fs::read(path).unwrap()
        };
        pictures
            .iter()
            .map(|(caption, p, wide)| Figure { caption: caption.clone(), png: png(p), wide: *wide })
            .collect()
    }

    #[test]
    fn the_page_is_whole_self_contained_and_repeats() {
        let set = synthetic::directions(&[Side::TransmissionFront, Side::ReflectionFront], &[0, 51, 100]);
        let folder = tempfile::tempdir().unwrap();
        let files = [ProductFile { name: "bsdf.h5".to_owned(), what: "all".to_owned(), sha256: "ab12".to_owned() }];
        let figures = figures(&set, folder.path());
        let page = report(&synthetic::context(), &set, &figures, &files);
        assert_eq!(page, report(&synthetic::context(), &set, &figures, &files));
        assert!(!page.contains("<script") && !page.contains("http://") && !page.contains("https://"));
        assert!(page.contains("blind &lt;30&gt; &amp; &quot;test&quot;"));
        assert!(page.find("Can it be trusted").unwrap() < page.find("<table").unwrap(), "the verdict comes first");
        assert!(page.contains("0.7000 ± 0.0210"), "T with k = 2");
        assert!(page.matches("data:image/png;base64,iVBOR").count() == figures.len());
        let tree = page.replace("<!DOCTYPE html>", "");
        let tree = tree.replace("<meta charset=\"utf-8\">", "").replace("initial-scale=1\">", "initial-scale=1\"/>");
        roxmltree::Document::parse(&tree).unwrap();
        if let Some(folder) = std::env::var_os("GONIOD_PLOTS") {
            std::fs::write(std::path::Path::new(&folder).join("report.html"), page).unwrap();
        }
    }
}
