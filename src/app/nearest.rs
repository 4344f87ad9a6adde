//! Suggestions for unknown names.

/// The known name nearest to `written`: at most a third of its letters differ, three at most, and
/// no other is as near.
pub(super) fn nearest<'a>(
    written: &str,
    known: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    let written = written.to_lowercase();
    let allowed = (written.chars().count() / 3).min(3);
    let distance = |name: &str| strsim::osa_distance(&written, &name.to_lowercase());
    let mut near: Vec<_> = known
        .into_iter()
        .map(|name| (distance(name), name))
        .filter(|(d, _)| *d <= allowed)
        .collect();
    near.sort_unstable();
    match near[..] {
        [(nearest, name)] if nearest > 0 => Some(name),
        [(nearest, name), (next, _), ..] if nearest > 0 && next > nearest => Some(name),
        _ => None,
    }
}

/// " (did you mean `…`?)", or an empty string.
pub(super) fn did_you_mean<'a>(written: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(written, known).map_or_else(String::new, |name| format!(" (did you mean `{name}`?)"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_of_the_pen_finds_its_name_and_another_word_finds_none() {
        let known = ["repose_deg", "repose_sd_deg", "flow_time_s", "flow_time_sd_s", "powder", "n"];
        for (written, meant) in [
            ("repose_dge", Some("repose_deg")),
            ("Repose_Degs", Some("repose_deg")),
            ("flow_tme_s", Some("flow_time_s")),
            ("powdr", Some("powder")),
            ("humidity", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest(written, known), meant, "{written}");
        }
        assert_eq!(nearest("san", ["sand", "salt", "sans"]), None, "two are as near");
    }
}
