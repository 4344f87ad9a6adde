//! P-values of several channels, each corrected for the others.
//!
//! ```text
//! p_1 <= .. <= p_k     of the channels
//! p_i becomes          the largest over j <= i of min(1, (k - j + 1) p_j)
//! ```
//!
//! Source: Holm, Scand. J. Statist. 6 (1979) 65.

/// The p-value of one channel, corrected for the others.
pub(crate) fn holm(p: f64, others: &[f64]) -> f64 {
    let channels = others.len() + 1;
    let mut ascending: Vec<f64> =
        others.iter().copied().filter(|&other| other < p).chain([p]).collect();
    ascending.sort_by(f64::total_cmp);
    let grown = ascending.iter().enumerate().map(|(k, p)| (channels - k) as f64 * p);
    grown.fold(0.0, f64::max).min(1.0)
}

/// All p-values except one of these.
pub(crate) fn without(all: &[f64], p: f64) -> Vec<f64> {
    let own = all.iter().position(|&it| it == p);
    all.iter().enumerate().filter(|(k, _)| Some(*k) != own).map(|(_, &it)| it).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_cost_each_other_no_more_than_holm_says() {
        // Holm's example of two hypotheses: 0.01 and 0.04 become 0.02 and 0.04; 0.03 and 0.04 both
        // become 0.06.
        let both = |a: f64, b: f64| [holm(a, &[b]), holm(b, &[a])];
        assert_eq!((both(0.01, 0.04), both(0.03, 0.04)), ([0.02, 0.04], [0.06, 0.06]));
        assert_eq!(
            (both(0.7, 0.9), both(0.03, 0.03), holm(0.03, &[])),
            ([1.0, 1.0], [0.06, 0.06], 0.03)
        );
        // Of three: 0.01, 0.02 and 0.03 become 0.03, 0.04 and 0.04, in any order.
        let three = [0.02, 0.03, 0.01];
        let of_three: Vec<f64> = three.iter().map(|&p| holm(p, &without(&three, p))).collect();
        assert_eq!(of_three, [0.04, 0.04, 0.03]);
        // Nothing wrong, each p uniform: one is found in slightly less than 5 % of investigations,
        // 1 - (1 - 0.025)^2.
        let grid = || (0..400).map(|k| (f64::from(k) + 0.5) / 400.0);
        let alarms = grid()
            .flat_map(|a| grid().map(move |b| (a, b)))
            .filter(|&(a, b)| both(a, b).iter().any(|p| *p <= 0.05));
        let share = alarms.count() as f64 / 160_000.0;
        assert!((share - 0.049_375).abs() < 1e-4, "{share}");
    }
}
