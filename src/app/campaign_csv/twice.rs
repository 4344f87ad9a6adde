//! Duplicate rows, equal in every cell: a run that was pasted twice is one run.
//!
//! Two runs may have the same angle, more often the coarser it is rounded, so equal rows are
//! duplicates only
//!
//! * where session and order in the session are equal too: one place in a day is one run;
//! * where the whole file is repeated: every row twice, or every row three times, counting rows
//!   that are equal in their own right;
//! * where there are more of them than chance explains:
//!
//! ```text
//! pairs of rows alike in all but the angle: M; alike in the angle too: O
//! q = share of the pairs of one powder, otherwise not alike, with equal angles,
//!     at least r / (2 sqrt(pi) s)       r: last digit of an angle, s: SD of a powder's angles; of a normal distribution
//! copies if P(O or more) <= 1 %         of a Poisson distribution with mean 3 M q
//! ```
//!
//! The factor of 3: angles of one day lie closer together than all angles. Duplicates count once,
//! even those that chance may have produced.

use super::Line;
use flip_discover::reading::LeftOut;
use std::collections::HashMap;
use std::hash::Hash;

/// Probability of chance below which equal rows are duplicates.
const CHANCE_MAX: f64 = 0.01;
/// Minimum number of distinct rows in a file that contains itself twice.
const WHOLE_MIN: usize = 8;
/// How much more often angles of one day may be equal than angles in general.
const CLOSER: f64 = 3.0;

/// What was left out, and what was noticed but kept.
#[derive(Debug, Default)]
pub(super) struct Twice {
    /// Duplicate rows.
    pub rows: Vec<u32>,
    /// Note on equal rows that chance can explain.
    pub note: Option<String>,
}

impl Twice {
    /// In the form of the report.
    pub fn told(&self) -> Vec<LeftOut> {
        let reason =
            "every cell is that of an earlier row: what stands in the file twice is counted once";
        let left_out = || LeftOut { rows: self.rows.clone(), reason: reason.to_owned() };
        if self.rows.is_empty() { Vec::new() } else { vec![left_out()] }
    }
}

/// Removes duplicates from the lines.
pub(super) fn leave_out(lines: &mut Vec<Line<'_>>) -> Twice {
    let groups = alike(lines, |line| (line.beside.clone(), line.angle_text));
    let doubled: Vec<&Vec<usize>> = groups.iter().filter(|group| group.len() > 1).collect();
    let times = times(&groups);
    let all = times == 1 && is_beyond_chance(lines, &doubled);
    let counted = |group: &[usize]| {
        if all || is_one_place(&lines[group[0]]) { 1 } else { group.len() / times }
    };
    let mut copies: Vec<usize> =
        doubled.iter().flat_map(|group| group[counted(group)..].to_vec()).collect();
    let others: usize = doubled.iter().map(|group| counted(group) - 1).sum();
    copies.sort_unstable();
    let twice = Twice {
        rows: copies.iter().map(|&k| lines[k].row as u32).collect(),
        note: (others > 0).then(|| {
            format!("{others} rows are like an earlier row in every cell, no more than chance brings at angles as coarse as these: each counts")
        }),
    };
    let mut k = 0..;
    lines.retain(|_| k.next().is_none_or(|k| copies.binary_search(&k).is_err()));
    twice
}

/// How often the whole file is repeated in itself.
fn times(groups: &[Vec<usize>]) -> usize {
    let common = groups.iter().fold(0, |common, group| divisor(common, group.len()));
    if groups.len() >= WHOLE_MIN { common.max(1) } else { 1 }
}

/// Greatest common divisor.
fn divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { divisor(b, a % b) }
}

/// Lines grouped by equal keys, by index; groups and lines in the order of the file.
fn alike<'a, K: Hash + Eq>(lines: &[Line<'a>], key: impl Fn(&Line<'a>) -> K) -> Vec<Vec<usize>> {
    let (mut places, mut groups): (HashMap<K, usize>, Vec<Vec<usize>>) =
        (HashMap::new(), Vec::new());
    for (k, line) in lines.iter().enumerate() {
        let place = *places.entry(key(line)).or_insert(groups.len());
        match groups.get_mut(place) {
            Some(group) => group.push(k),
            None => groups.push(vec![k]),
        }
    }
    groups
}

/// Whether a line gives its session and its place in it.
fn is_one_place(line: &Line<'_>) -> bool {
    line.session.is_filled() && line.has_order
}

/// Whether this many equal rows are more than chance explains.
fn is_beyond_chance(lines: &[Line<'_>], doubled: &[&Vec<usize>]) -> bool {
    let of_groups =
        |groups: &[Vec<usize>]| groups.iter().map(|group| pairs(group.len())).sum::<f64>();
    let alike_beside = of_groups(&alike(lines, |line| line.beside.clone()));
    let alike_in_all: f64 = doubled.iter().map(|group| pairs(group.len())).sum();
    let of_powders = of_groups(&alike(lines, |line| line.powder.clone())) - alike_beside;
    let equal =
        of_groups(&alike(lines, |line| (line.powder.clone(), line.angle_text))) - alike_in_all;
    let share = if of_powders > 0.0 { equal / of_powders } else { 0.0 };
    let chance = (CLOSER * share.max(of_equal_angles(lines))).min(1.0);
    alike_in_all > 0.0 && poisson_tail(alike_in_all, chance * alike_beside) <= CHANCE_MAX
}

fn pairs(n: usize) -> f64 {
    n as f64 * (n as f64 - 1.0) / 2.0
}

/// Probability that two angles of a powder are equal as written, for a normal distribution.
fn of_equal_angles(lines: &[Line<'_>]) -> f64 {
    let decimals = lines
        .iter()
        .map(|line| line.angle_text.split_once(['.', ',']).map_or(0, |(_, part)| part.len()))
        .max();
    let last_digit = 10f64.powi(-(decimals.unwrap_or(0).min(300) as i32));
    let (mut squares, mut free) = (0.0, 0.0);
    for group in alike(lines, |line| line.powder.clone()) {
        let angles: Vec<f64> =
            group.iter().filter_map(|&k| Some(lines[k].angle?.repose_deg)).collect();
        let mean = angles.iter().sum::<f64>() / angles.len().max(1) as f64;
        squares += angles.iter().map(|angle| (angle - mean).powi(2)).sum::<f64>();
        free += angles.len() as f64 - 1.0;
    }
    // Angles that never differ are equal more often than by chance, and carry no information on
    // duplicates.
    let sd = if squares > 0.0 && free > 0.0 { (squares / free).sqrt() } else { 0.0 };
    last_digit / (2.0 * std::f64::consts::PI.sqrt() * sd)
}

/// Probability of `least` or more under a Poisson distribution.
fn poisson_tail(least: f64, mean: f64) -> f64 {
    if least <= mean {
        // More than a third, which is all that matters.
        return 1.0;
    }
    let mut term = libm::exp(least * libm::log(mean) - mean - libm::lgamma(least + 1.0));
    let (mut sum, mut k) = (0.0, least);
    while term > 1e-12 * sum && term > 0.0 {
        sum += term;
        k += 1.0;
        term *= mean / k;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_of_a_poisson_distribution_is_its_sum() {
        // 1 - exp(-0.5) (1 + 0.5), and 1 - exp(-2) (1 + 2 + 2 + 4/3).
        assert!((poisson_tail(2.0, 0.5) - 0.090_204_010_431_050).abs() < 1e-12);
        assert!((poisson_tail(4.0, 2.0) - 0.142_876_539_501_453).abs() < 1e-12);
        assert_eq!((poisson_tail(1.0, 2.0), poisson_tail(1.0, 0.0)), (1.0, 0.0));
        assert!(poisson_tail(900.0, 700.0) < 1e-10, "where exp(-700) is almost nothing");
    }
}
