//! Sessions that look like numbers but are names: 1.1, 1.2 and so on to 1.10, which as a number
//! equals 1.1.
//!
//! Parts between dots are compared separately. If that gives a different order than the numbers, or
//! distinguishes equal numbers, only the laboratory knows their meaning, and they are treated as
//! names.

use std::cmp::Ordering;

/// Whether these sessions, all of them numeric, are names.
pub(super) fn are_labels(texts: &[&str]) -> bool {
    let parts: Option<Vec<[u64; 2]>> = texts.iter().map(|text| parts(text)).collect();
    let numbers: Vec<f64> =
        texts.iter().filter_map(|text| text.replace(',', ".").parse().ok()).collect();
    let Some(parts) = parts.filter(|parts| parts.len() == numbers.len()) else { return false };
    let mut order: Vec<usize> = (0..texts.len()).collect();
    order.sort_by(|&a, &b| parts[a].cmp(&parts[b]));
    // Sorted by their parts, the numbers rise where the parts do.
    order.windows(2).any(|pair| {
        let by_number = numbers[pair[0]].total_cmp(&numbers[pair[1]]);
        by_number != parts[pair[0]].cmp(&parts[pair[1]])
            && (by_number != Ordering::Equal || texts[pair[0]] != texts[pair[1]])
    })
}

/// The parts before and after the dot; `None` for other numbers.
fn parts(text: &str) -> Option<[u64; 2]> {
    let (before, behind) = text.split_once(['.', ',']).unwrap_or((text, "0"));
    Some([before.parse().ok()?, behind.parse().ok()?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn session_1_10_is_not_session_1_1() {
        for labels in [
            &["1.1", "1.2", "1.10"] as &[&str],
            &["1.1", "1.10"],
            &["1.9", "1.10", "1.11"],
            &["1.8", "1.11"],
            &["1,1", "1,10"],
            &["1.1", "1.01"],
        ] {
            assert!(are_labels(labels), "{labels:?}");
        }
        for numbers in [
            &["1", "2", "10"] as &[&str],
            &["1.1", "1.2", "2.1"],
            &["1.10", "1.20", "2.00"],
            &["5.0", "5", "12"],
            &["1.01", "1.02", "1.10"],
            &["10", "1e1", "9"],
            &["-1.1", "-1.10"],
            &["1.1", "1.1", "1.1"],
            &[],
        ] {
            assert!(!are_labels(numbers), "{numbers:?}");
        }
    }
}
