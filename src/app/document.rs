//! HTML documents that stand alone, such as a report or a certificate.
//!
//! Their markup is written with [`html!`], which escapes every value spliced into it.
//! [`PreEscaped`] is the only way around that: here it takes style sheets of this program.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Content security policy: the page's own style, and nothing else. A server must send it: under
/// a stricter policy the page has no style.
pub const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// A page without script, font or other file. `schemes` are the colour schemes of its style.
pub fn page(title: &str, style: &str, schemes: Option<&str>, body: &Markup) -> String {
    inert(html! {
        (DOCTYPE) "\n"
        html lang="en" { "\n"
            head { "\n"
                meta charset="utf-8"; "\n"
                meta http-equiv="Content-Security-Policy" content=(POLICY); "\n"
                meta name="viewport" content="width=device-width, initial-scale=1"; "\n"
                @if let Some(schemes) = schemes { meta name="color-scheme" content=(schemes); "\n" }
                title { (title) } "\n"
                style { (PreEscaped(style)) } "\n"
            } "\n"
            body { "\n" (body) } "\n"
        } "\n"
    })
}

/// Markup as text in which no character acts on its neighbours: control characters, and those that
/// change the direction of writing, which could make a name read as another.
pub fn inert(markup: Markup) -> String {
    let acts = |c: char| {
        (c.is_control() && !matches!(c, '\n' | '\t'))
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}')
            || matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
    };
    markup.into_string().replace(acts, "\u{fffd}")
}

/// Names as nobody should choose them, for the tests of every document.
#[cfg(test)]
pub mod hostile {
    pub const NAMES: [&str; 9] = [
        "<script>alert(1)</script>",
        "\"><img src=x onerror=alert(1)>",
        "\" onload=\"x",
        "</style><b>",
        "</title><b>",
        "a & b < c",
        "\0<!--",
        "salt\u{202e}ragus",
        "\u{2067}12\u{2069}\u{200f}\u{61c}",
    ];

    /// The tags of a page and the names of their attributes, in order.
    fn skeleton(page: &str) -> Vec<String> {
        let (head, rest) = page.split_once("<style>").expect("a page has a style");
        let (_, body) = rest.split_once("</style>").expect("a style sheet ends");
        let tags = [head, body].into_iter().flat_map(|part| part.split('<').skip(1));
        let outside = |tag: &str| tag.split('"').step_by(2).collect::<String>();
        tags.map(|tag| outside(tag).split('>').next().unwrap_or_default().to_owned()).collect()
    }

    /// Whether `page`, made with each name in every place, has the markup that it has with a
    /// harmless one.
    pub fn assert_inert(page: impl Fn(&str) -> String) {
        let harmless = skeleton(&page("zeta"));
        for name in NAMES {
            let page = page(name);
            assert_eq!(skeleton(&page), harmless, "{name:?}");
            assert!(!page.contains(name), "{name:?}");
            assert!(
                !page.contains(['\0', '\u{202e}', '\u{2067}', '\u{200f}', '\u{61c}']),
                "{name:?}"
            );
        }
    }
}
