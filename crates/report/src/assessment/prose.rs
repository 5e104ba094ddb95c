//! Running text for HTML: text between backticks is code, as in Markdown.

use maud::{Markup, html};

use crumple_core::markdown::split_prose;

pub(super) fn prose_to_html(text: &str) -> Markup {
    html! {
        @for (is_code, piece) in split_prose(text) {
            @if is_code { code { (piece) } } @else { (piece) }
        }
    }
}
