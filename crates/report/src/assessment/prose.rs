//! Running text for HTML: text between backticks is code, as in Markdown.

use maud::{Markup, html};

pub(super) fn prose_to_html(text: &str) -> Markup {
    html! {
        @for (index, piece) in text.split('`').enumerate() {
            @if index % 2 == 1 { code { (piece) } } @else { (piece) }
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn code_is_marked_and_the_rest_is_escaped() {
        let html = super::prose_to_html("a < `b`").into_string();
        assert_eq!(html, "a &lt; <code>b</code>");
    }
}
