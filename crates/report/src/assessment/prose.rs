//! Running text for HTML: text between backticks is code, as in Markdown.

use maud::{Markup, html};

pub(super) fn prose_to_html(text: &str) -> Markup {
    html! {
        @for (index, piece) in text.split('`').enumerate() {
            @if index % 2 == 1 { code { (piece) } } @else { (piece) }
        }
    }
}
