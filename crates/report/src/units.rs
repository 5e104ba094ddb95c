//! No-break spaces between numbers and units.

/// Units that reports write after a number or in parentheses.
const UNITS: [&str; 15] = [
    "m/s²", "m/s³", "m²/s³", "m/s", "km/h", "m", "km", "kg", "s", "ms", "h", "min", "%", "MB", "Hz",
];

/// Elements whose text stays unchanged: commands are copied, and figures do not wrap.
const VERBATIM_ELEMENTS: [&str; 4] = ["code", "script", "style", "svg"];

/// Replaces the space before each unit in the text of an HTML page by a no-break space. A unit follows a digit or is in
/// parentheses, as in the heading `peak brake (m/s²)`.
pub(crate) fn insert_nbsp_before_units(page: &str) -> String {
    let mut joined = String::with_capacity(page.len());
    let mut rest = page;
    while let Some((text, tag)) = rest.find('<').map(|start| rest.split_at(start)) {
        push_with_nbsp(text, &mut joined);
        let element = VERBATIM_ELEMENTS
            .iter()
            .find(|name| tag[1..].starts_with(**name));
        let end = element
            .and_then(|name| tag.find(&format!("</{name}>")))
            .unwrap_or(0);
        let end = tag[end..]
            .find('>')
            .map_or(tag.len(), |close| end + close + 1);
        joined.push_str(&tag[..end]);
        rest = &tag[end..];
    }
    push_with_nbsp(rest, &mut joined);
    joined
}

fn push_with_nbsp(text: &str, joined: &mut String) {
    let mut before = "";
    for (index, word) in text.split(' ').enumerate() {
        let unit = word
            .trim_end_matches([',', '.', ';', ':', ')'])
            .trim_start_matches('(');
        let is_attached = before.ends_with(|c: char| c.is_ascii_digit()) || word.starts_with('(');
        if index > 0 {
            joined.push(if is_attached && UNITS.contains(&unit) {
                '\u{a0}'
            } else {
                ' '
            });
        }
        joined.push_str(word);
        before = word;
    }
}

#[cfg(test)]
mod tests {
    use super::insert_nbsp_before_units;

    #[test]
    fn a_unit_stays_with_its_number() {
        let page = "<p title=\"3 m\">hit at 5.50 s, 10.1 m/s (of 3 m); 3 may</p><th>peak brake (m/s²)</th><code>--for \
            3 s</code> 4 s";
        let joined = page
            .replace("5.50 s", "5.50\u{a0}s")
            .replace("10.1 m", "10.1\u{a0}m")
            .replace("of 3 m", "of 3\u{a0}m")
            .replace("brake (", "brake\u{a0}(")
            .replace(" 4 s", " 4\u{a0}s");
        assert_eq!(insert_nbsp_before_units(page), joined);
    }

    #[test]
    fn damaged_markup_is_kept() {
        for page in ["", "<", "<p", "<code>3 m", "3 m<", "a <svg", "é<é é>3 é"] {
            assert_eq!(insert_nbsp_before_units(page).replace('\u{a0}', " "), page);
        }
    }
}
