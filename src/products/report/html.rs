//! Small pieces of HTML: tables, pictures as data addresses.

use crate::products::markup::escape;

/// A section with its heading; `body` is HTML already.
pub fn section(id: &str, title: &str, body: &str) -> String {
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}\n</section>\n", escape(title))
}

/// A table; cells are text and are escaped here. Columns from `numbers` on are set to the right.
pub fn table(head: &[&str], rows: &[Vec<String>], numbers: usize) -> String {
    let class = |i: usize| if i >= numbers { " class=\"n\"" } else { "" };
    let mut html = String::from("<table>\n<thead><tr>");
    for (i, cell) in head.iter().enumerate() {
        html.push_str(&format!("<th{}>{}</th>", class(i), escape(cell)));
    }
    html.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        html.push_str("<tr>");
        for (i, cell) in row.iter().enumerate() {
            html.push_str(&format!("<td{}>{}</td>", class(i), escape(cell)));
        }
        html.push_str("</tr>\n");
    }
    html.push_str("</tbody>\n</table>");
    html
}

/// Words and values, two columns; empty values are left out.
pub fn pairs(rows: &[(String, String)]) -> String {
    let mut html = String::from("<dl>\n");
    for (word, value) in rows.iter().filter(|(_, v)| !v.is_empty()) {
        html.push_str(&format!("<dt>{}</dt><dd>{}</dd>\n", escape(word), escape(value)));
    }
    html.push_str("</dl>");
    html
}

/// Base64 with padding (RFC 4648, section 4).
pub fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |i: usize| u32::from(group.get(i).copied().unwrap_or(0));
        let word = byte(0) << 16 | byte(1) << 8 | byte(2);
        for i in 0..4 {
            if i <= group.len() {
                out.push(char::from(ALPHABET[(word >> (18 - 6 * i)) as usize & 63]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The test vectors of RFC 4648, section 10.
    #[test]
    fn base64_gives_the_vectors_of_its_standard() {
        let vectors = ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"];
        for (n, expected) in vectors.into_iter().enumerate() {
            assert_eq!(base64(&b"foobar"[..n]), expected);
        }
        assert_eq!(base64(&[0xff, 0xff, 0xfe]), "///+");
    }

    #[test]
    fn cells_are_escaped() {
        let html = table(&["a"], &[vec!["<b> & \"c\"".to_owned()]], 1);
        assert!(html.contains("<td>&lt;b&gt; &amp; &quot;c&quot;</td>"));
    }
}
