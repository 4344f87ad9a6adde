//! What sections are made of: headings, tables, rows.

use maud::{Markup, Render, html};

/// A section: heading, a line that explains how to read it, content.
pub fn section(title: &str, intro: &str, content: &Markup) -> Markup {
    html! {
        @if !content.0.is_empty() {
            section { h2 { (title) } p.intro { (intro) } (content) }
        }
    }
}

/// Heading of a column of text.
pub fn left(label: impl Render) -> Markup {
    html! { th.left scope="col" { (label) } }
}

/// Heading of a column of numbers.
pub fn right(label: impl Render) -> Markup {
    html! { th scope="col" { (label) } }
}

/// A table that scrolls sideways; the style hides a caption that repeats the section's heading.
pub fn table(caption: &str, class: &str, headings: &[Markup], rows: &[Markup]) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label=(caption) {
            table class=(class) {
                caption { (caption) }
                thead { tr { @for heading in headings { (heading) } } }
                tbody { @for row in rows { (row) } }
            }
        }
    }
}

pub fn row(head: impl Render, cells: &[Markup]) -> Markup {
    html! { tr { th scope="row" { (head) } @for cell in cells { td { (cell) } } } }
}

/// Text of a cell that may wrap.
pub fn wrapped(words: &str) -> Markup {
    html! { span.left.wrap { (words) } }
}
