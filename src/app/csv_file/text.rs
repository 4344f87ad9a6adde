//! Decodes the bytes of a file as text, and strips the text's wrapping.

use flip_core::domain::FieldError;
use std::borrow::Cow;

/// Terminators written by Windows and old loggers: Ctrl-Z, or zeros that fill a block.
const ENDINGS: [char; 2] = ['\u{1a}', '\0'];

/// The text of a file: UTF-8, or UTF-16 with a byte-order mark, as spreadsheets save "Unicode
/// text".
///
/// # Errors
/// Any other encoding, by the row with the first invalid byte: an 8-bit file does not declare its
/// encoding.
pub fn table_text(bytes: &[u8]) -> Result<String, FieldError> {
    let units = |of: fn([u8; 2]) -> u16| {
        let whole = bytes[2..].chunks_exact(2).map(|pair| of([pair[0], pair[1]]));
        // Half a code unit is invalid.
        let odd = (bytes.len() % 2 == 1).then_some(0xd800);
        char::decode_utf16(whole.chain(odd).collect::<Vec<_>>())
            .collect::<Result<String, _>>()
            .map_err(|_| {
                FieldError::new("row[1]", "is not valid UTF-16 text: save the file as CSV UTF-8")
            })
    };
    match bytes {
        [0xff, 0xfe, ..] => units(u16::from_le_bytes),
        [0xfe, 0xff, ..] => units(u16::from_be_bytes),
        _ => std::str::from_utf8(bytes).map(str::to_owned).map_err(|error| {
            let row =
                1 + bytes[..error.valid_up_to()].iter().filter(|byte| **byte == b'\n').count();
            FieldError::new(format!("row[{row}]"), "is not UTF-8 text: save the file as CSV UTF-8")
        }),
    }
}

/// Removes invisible characters that web pages and chats insert: `salt` with a zero-width space is
/// salt.
pub(super) fn visible(text: &str) -> Cow<'_, str> {
    let is_hidden = |c: char| matches!(c, '\u{ad}' | '\u{200b}'..='\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2060}' | '\u{feff}');
    if text.contains(is_hidden) {
        Cow::Owned(text.replace(is_hidden, ""))
    } else {
        Cow::Borrowed(text)
    }
}

/// A text without its wrapping, and the separator that it declares.
#[derive(Debug, PartialEq)]
pub(super) struct Bare<'a> {
    pub text: &'a str,
    pub separator: Option<u8>,
}

/// Strips byte-order mark, Ctrl-Z and the line `sep=;` that spreadsheets write and consume: the
/// header is still row 1.
///
/// # Errors
/// A `sep=` that does not name a cell separator.
pub(super) fn bare(text: &str) -> Result<Bare<'_>, FieldError> {
    let text = text.trim_start_matches('\u{feff}');
    let text = text.trim_end_matches(|c: char| ENDINGS.contains(&c) || c == '\r' || c == '\n');
    let (first, rest) = text.split_once(['\n', '\r']).unwrap_or((text, ""));
    let named = first.trim_end_matches(['\r', '"']).trim_start_matches('"');
    let Some(named) =
        named.get(..4).filter(|it| it.eq_ignore_ascii_case("sep=")).and_then(|_| named.get(4..))
    else {
        return Ok(Bare { text, separator: None });
    };
    // Padding appended by programs that pad their rows: `sep=;;;;`.
    let mut marks = named.bytes();
    match marks.next() {
        Some(mark @ (b',' | b';' | b'\t' | b'|')) if marks.all(|other| other == mark) => {
            Ok(Bare { text: rest.strip_prefix('\n').unwrap_or(rest), separator: Some(mark) })
        }
        _ => Err(FieldError::new(
            "header",
            format!("is `{first}`: cells are separated by `,`, `;`, a tab or `|`"),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unicode_text_of_a_spreadsheet_reads_as_utf8_does() {
        let text = "powder\trepose_deg\nsalt\t36,2\n";
        let little: Vec<u8> = [0xff, 0xfe]
            .into_iter()
            .chain(text.encode_utf16().flat_map(u16::to_le_bytes))
            .collect();
        let big: Vec<u8> = [0xfe, 0xff]
            .into_iter()
            .chain(text.encode_utf16().flat_map(u16::to_be_bytes))
            .collect();
        for bytes in [text.as_bytes(), &little, &big] {
            assert_eq!(table_text(bytes).unwrap(), text);
        }
        assert_eq!(
            table_text(&little[..little.len() - 1]).unwrap_err().field,
            "row[1]",
            "half a character"
        );
        assert_eq!(table_text(b"a\nb\nPr\xfcfstand\n").unwrap_err().field, "row[3]");
    }

    #[test]
    fn what_spreadsheets_wrap_a_file_in_is_no_part_of_it() {
        let of = |text| bare(text).map(|it| (it.text, it.separator));
        assert_eq!(of("\u{feff}a,b\r\n1,2\r\n\u{1a}"), Ok(("a,b\r\n1,2", None)));
        assert_eq!(of("sep=;\r\na;b\r\n1;2"), Ok(("a;b\r\n1;2", Some(b';'))));
        assert_eq!(of("SEP=,\na,b"), Ok(("a,b", Some(b','))));
        assert_eq!(of("\"sep=\t\"\na\tb"), Ok(("a\tb", Some(b'\t'))));
        assert_eq!(of("sep=,,,\na,b,"), Ok(("a,b,", Some(b','))));
        assert_eq!(
            of("sep=x\na"),
            Err(FieldError::new(
                "header",
                "is `sep=x`: cells are separated by `,`, `;`, a tab or `|`"
            ))
        );
        assert_eq!(of("separator\n1"), Ok(("separator\n1", None)));
        assert_eq!(of("é=\n"), Ok(("é=", None)));
    }
}
