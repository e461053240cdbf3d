//! The sections of the page, each a function from data to HTML.

use super::html::{base64, pairs, section, table};
use super::verdict::{Verdict, column_coverage};
use super::{Figure, ProductFile};
use crate::engine::bsdf::set::{BsdfSet, Column, Quantity};
use crate::engine::optics::side::Side;
use crate::products::context::{ProductContext, side_words};
use crate::products::markup::escape;
use crate::products::plots::hemisphere::quantity_words;

/// Most rows of the headline table; the rest is in the files.
const HEADLINE_ROWS: usize = 40;

/// Title, sample, run.
pub fn heading(context: &ProductContext) -> String {
    let end = context.finished.map_or_else(|| "not finished".to_owned(), |t| t.to_string());
    format!(
        "<header>\n<p class=\"over\">BSDF report</p>\n<h1>{}</h1>\n<p class=\"sub\">{} · {} · {} to {}</p>\n</header>\n",
        escape(&context.sample.name),
        escape(&context.scan_name),
        escape(&context.instrument),
        context.started,
        end
    )
}

/// The answer and its reasons.
pub fn verdict(verdict: &Verdict) -> String {
    let mut html = format!(
        "<section id=\"verdict\" class=\"verdict {}\">\n<h2>Can it be trusted? <strong>{}</strong></h2>\n<ul>\n",
        verdict.light.class(),
        verdict.light.answer()
    );
    for finding in &verdict.findings {
        html.push_str(&format!(
            "<li class=\"{}\"><b>{}</b> {}</li>\n",
            finding.light.class(),
            finding.what,
            escape(&finding.text)
        ));
    }
    html.push_str("</ul>\n</section>\n");
    html
}

/// T and R of the totals for each side and incident direction, k = 2.
pub fn headline(set: &BsdfSet) -> String {
    let totals: Vec<usize> =
        (0..set.quantities.len()).filter(|&q| !matches!(set.quantities.get(q), Some(Quantity::Band { .. }))).collect();
    let quantities = if totals.is_empty() { (0..set.quantities.len()).collect() } else { totals };
    let mut head = vec!["Hemispheres".to_owned(), "Source θ, φ".to_owned()];
    head.extend(quantities.iter().filter_map(|&q| set.quantities.get(q)).map(quantity_words));
    let mut rows = Vec::new();
    for side in Side::ALL {
        let mut directions: Vec<&Column> = Vec::new();
        for column in set.columns.iter().filter(|c| c.side == side) {
            if !directions.iter().any(|d| d.incident == column.incident) {
                directions.push(column);
            }
        }
        directions.sort_by(|a, b| {
            a.incident.theta.total_cmp(&b.incident.theta).then(a.incident.phi.total_cmp(&b.incident.phi))
        });
        for first in directions {
            let (theta, phi) = first.incident.degrees();
            let mut row = vec![side_words(side).to_owned(), format!("{theta:.1}°, {phi:.1}°")];
            row.extend(quantities.iter().map(|&q| {
                let found =
                    set.columns.iter().find(|c| c.side == side && c.quantity == q && c.incident == first.incident);
                found.map_or_else(
                    || "–".to_owned(),
                    |c| format!("{:.4} ± {:.4}", c.hemispherical, 2.0 * c.hemispherical_u),
                )
            }));
            rows.push(row);
        }
    }
    let all = rows.len();
    let rows = thinned(rows);
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let mut body = table(&head, &rows, 2);
    if rows.len() < all {
        body.push_str(&format!(
            "<p class=\"note\">{} of {all} rows, evenly spread; all are in bsdf.h5.</p>",
            rows.len()
        ));
    }
    body.push_str(
        "<p class=\"note\">Direct-hemispherical values with expanded uncertainty, k = 2. Front = exterior.</p>",
    );
    section("results", "Transmittance and reflectance", &body)
}

fn thinned(rows: Vec<Vec<String>>) -> Vec<Vec<String>> {
    let n = rows.len();
    if n <= HEADLINE_ROWS {
        return rows;
    }
    (0..HEADLINE_ROWS).filter_map(|k| rows.get(k * (n - 1) / (HEADLINE_ROWS - 1)).cloned()).collect()
}

/// The pictures, embedded.
pub fn figures(figures: &[Figure]) -> String {
    if figures.is_empty() {
        return String::new();
    }
    let mut body = String::from("<div class=\"figures\">\n");
    for figure in figures {
        body.push_str(&format!(
            "<figure{}><img alt=\"{}\" src=\"data:image/png;base64,{}\"/><figcaption>{}</figcaption></figure>\n",
            if figure.wide { " class=\"wide\"" } else { "" },
            escape(&figure.caption),
            base64(&figure.png),
            escape(&figure.caption)
        ));
    }
    body.push_str("</div>");
    section("pictures", "Where the light goes", &body)
}

/// How much of the hemispheres was seen, quantity by quantity.
pub fn coverage(set: &BsdfSet) -> String {
    let mut rows = Vec::new();
    for side in Side::ALL {
        for (q, quantity) in set.quantities.iter().enumerate() {
            let seen: Vec<f64> = set
                .columns
                .iter()
                .filter(|c| c.side == side && c.quantity == q)
                .map(|c| column_coverage(set, c))
                .collect();
            if seen.is_empty() {
                continue;
            }
            let least = seen.iter().copied().fold(f64::INFINITY, f64::min);
            let mean = seen.iter().sum::<f64>() / seen.len() as f64;
            rows.push(vec![
                side_words(side).to_owned(),
                quantity_words(quantity),
                seen.len().to_string(),
                format!("{:.1} %", 100.0 * mean),
                format!("{:.1} %", 100.0 * least),
            ]);
        }
    }
    let head = ["Hemispheres", "Quantity", "Incident directions", "Mean coverage", "Least"];
    section("coverage", "What was seen", &table(&head, &rows, 2))
}

/// The uncertainty budget.
pub fn uncertainty(context: &ProductContext) -> String {
    let mut rows: Vec<Vec<String>> = context
        .uncertainty
        .iter()
        .map(|c| {
            let kind = if c.correlated { "common to all patches" } else { "independent" };
            vec![c.name.clone(), kind.to_owned(), c.source.clone(), format!("{:.2} %", 100.0 * c.relative)]
        })
        .collect();
    let total = context.uncertainty.iter().map(|c| c.relative * c.relative).sum::<f64>().sqrt();
    rows.push(vec!["all, in quadrature".to_owned(), String::new(), String::new(), format!("{:.2} %", 100.0 * total)]);
    let head = ["Component", "Kind", "Source", "Relative, k = 1"];
    let note = "<p class=\"note\">Typical for a hemispherical value of this run; each value's own uncertainty is in the \
                table above and in bsdf.h5.</p>";
    section("uncertainty", "Uncertainty budget", &(table(&head, &rows, 3) + note))
}

/// What was measured and how.
pub fn method(context: &ProductContext) -> String {
    let bands: Vec<Vec<String>> = context
        .bands
        .iter()
        .map(|b| {
            let interval = format!("{:.0}–{:.0} nm", b.interval_nm[0], b.interval_nm[1]);
            vec![b.name.clone(), interval, b.glasses.clone(), b.camera.clone()]
        })
        .collect();
    let mut rows = vec![("Sample".to_owned(), sample_line(context)), ("Lamp".to_owned(), context.lamp.clone())];
    rows.extend(context.lamp_hours.clone().map(|hours| ("Hours of the lamp".to_owned(), hours)));
    rows.push(("Normalisation".to_owned(), context.normalisation.clone()));
    let mut body = pairs(&rows);
    body.push_str(&table(&["Band", "Interval", "Filter glasses", "Camera"], &bands, 9));
    if !context.notes.is_empty() {
        body.push_str("\n<h3>Notes</h3>\n<ul>\n");
        for note in &context.notes {
            body.push_str(&format!("<li>{}</li>\n", escape(note)));
        }
        body.push_str("</ul>");
    }
    section("method", "What was measured, and how", &body)
}

fn sample_line(context: &ProductContext) -> String {
    let s = &context.sample;
    let maker = if s.manufacturer.is_empty() { "maker unknown" } else { &s.manufacturer };
    format!("{}, {maker}, {} mm thick, {}", s.name, s.thickness_mm, s.device_type.as_deref().unwrap_or("Other"))
}

/// How the night went.
pub fn night(context: &ProductContext) -> String {
    section("night", "What happened in the night", &pairs(&context.night))
}

/// Run, plan, versions, serial numbers, counts.
pub fn provenance(context: &ProductContext) -> String {
    let c = &context.counts;
    let mut rows = vec![
        ("Run".to_owned(), context.run_id.clone()),
        ("Plan".to_owned(), context.plan_hash.clone()),
        (
            "Exposures".to_owned(),
            format!("{} planned, {} stored, {} missing, {} frames refused", c.planned, c.stored, c.missing, c.rejected),
        ),
    ];
    rows.extend(context.serials.iter().map(|(device, serial)| (format!("Serial of {device}"), serial.clone())));
    rows.extend(context.versions.iter().map(|(what, version)| (format!("Version of {what}"), version.clone())));
    section("provenance", "Where it comes from", &pairs(&rows))
}

/// The files beside the report.
pub fn files(files: &[ProductFile]) -> String {
    if files.is_empty() {
        return String::new();
    }
    let mut body =
        String::from("<table>\n<thead><tr><th>File</th><th>What it is</th><th>SHA-256</th></tr></thead>\n<tbody>\n");
    for file in files {
        body.push_str(&format!(
            "<tr><td><a href=\"{0}\">{0}</a></td><td>{1}</td><td class=\"hash\">{2}</td></tr>\n",
            escape(&file.name),
            escape(&file.what),
            escape(&file.sha256)
        ));
    }
    body.push_str("</tbody>\n</table>");
    section("files", "Files", &body)
}
