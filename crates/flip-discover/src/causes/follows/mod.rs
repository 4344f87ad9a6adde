//! Detects columns derived from the measurement: height, base diameter and flanks of the same heap,
//! another estimate of its angle. They are not conditions, and would explain the angle better than
//! any.
//!
//! ```text
//! x~, y~   column and angle of a row, less the mean of their powder on that day; without days, of their powder
//! r        correlation of x~ and y~                  t = r sqrt(freedom / (1 - r^2))
//! b_w      slope of x~ on y~                         b_b   the same of the powders' means
//! left     SD of the angle that the column leaves = SD(y~) sqrt(1 - r^2)
//! ```
//!
//! Runs of one powder on one day differ by the natural scatter of heaps. A condition explains only
//! the part of it that the condition changed; a column derived from the angle contains the rest
//! too. Of the columns that correlate with the angle, these are derived:
//!
//! | by | what is asked |
//! |---|---|
//! | powders | powders' means lie on the line on which runs of one powder lie: a condition knows nothing of how steep a powder is |
//! | values | it reads nearly what the angle is, degree for degree |
//! | repeats | it leaves less scatter than heaps of any powder repeat to |
//! | name | it is called after the heap, or after nothing but a length |
//! | together | columns with such names explain together what none does alone: height and base of heaps of different volume |
//! | classes | names of the column are ranges of the angle, whatever the powder |
//! | order | it has runs in the order of their angles less the mean of their powder, as no condition has: deviation, z score, flag of what is above the mean (`order`) |
//!
//! Except for `order` and `repeats` (and that to a quarter of the scatter), a column is kept if its
//! average is the same for powders of different angles: a column that does not depend on the powder
//! was there before the heap, or is the angle less its powder's mean.
//!
//! Columns that causes of the catalogue act through are never tested: the file format defines those
//! as conditions.

mod order;
mod words;

use crate::causes::hypothesis::has_mechanism;
use crate::data::campaign::{Campaign, Covariate, Quantity, Values};
use crate::report::ColumnLeftOut;
use crate::thresholds::column::{
    FLOW_REPEATS_TO, FREEDOM_MIN, KNOWS_POWDERS, MISPLACED, NAMED_T, NEAR_ALL, NEARLY_DEG,
    ON_A_LINE, POWDERS_APART, REPEATS_TO, ROUNDING, ROWS_MIN, SAME_SLOPE, SET_VALUES_MAX, SLOPE_Z,
    STRONG_SHARE, STRONG_T, TOGETHER,
};
use flip_core::stats::summary::mean;
use nalgebra::{DMatrix, DVector};
use std::collections::{BTreeMap, BTreeSet};

/// Columns set before a heap is poured, in addition to those that causes act through.
const SET: [&str; 2] = ["poured_mass_g", "ioniser_on"];
/// Robust SD beyond which a departure is clamped: a typing error in one cell.
const OUTLIER_SD: f64 = 4.0;

/// One row of the file.
#[derive(Clone, Copy)]
struct Row {
    powder: usize,
    session: usize,
    /// The mean, for the runs behind a summary.
    angle: f64,
    /// First of its runs.
    run: usize,
}

/// A column against the angle, row by row.
struct Course {
    rows: Vec<Row>,
    values: Vec<f64>,
    /// Departures from the mean of the powder on the day, or of the powder.
    departures: Vec<[f64; 2]>,
    freedom: f64,
}

/// Returns the campaign without the columns derived from its measurement, and those columns with
/// the reasons.
pub(crate) fn without(campaign: &Campaign) -> (Campaign, Vec<ColumnLeftOut>) {
    let rows = rows(campaign);
    let asked: Vec<&Covariate> =
        campaign.covariates.iter().filter(|covariate| is_asked(&covariate.name)).collect();
    let mut left_out: Vec<ColumnLeftOut> =
        asked.iter().filter_map(|covariate| follows(campaign, &rows, covariate)).collect();
    let is_out =
        |left_out: &[ColumnLeftOut], name: &str| left_out.iter().any(|out| out.column == name);
    let is_named = |covariate: &&&Covariate| {
        words::is_of_heap(&covariate.name, campaign.quantity) && !is_out(&left_out, &covariate.name)
    };
    let named = asked
        .iter()
        .filter(is_named)
        .filter_map(|covariate| Some((covariate.name.as_str(), numbers(covariate)?)));
    let may_be = |values: &[Option<f64>]| {
        Course::of(&rows, values).is_none_or(|course| !course.is_blind_to_powders())
    };
    let others: Vec<(&str, Vec<Option<f64>>)> =
        named.filter(|column| may_be(&column.1) && !is_setting(column.0, &column.1)).collect();
    // A column named like a derived one, and not set by hand, is another measurement of the same
    // heap.
    if !left_out.is_empty() || together(&rows, &others) {
        left_out.extend(others.iter().map(|(name, _)| ColumnLeftOut {
            column: (*name).to_owned(),
            reason: "follows from the angle: its name, and columns like it, say that it is of the heap that was measured"
                .to_owned(),
        }));
    }
    left_out.sort_by_key(|out| {
        campaign.covariates.iter().position(|covariate| covariate.name == out.column)
    });
    let kept = campaign
        .covariates
        .iter()
        .filter(|covariate| !is_out(&left_out, &covariate.name))
        .cloned()
        .collect();
    (Campaign { covariates: kept, ..campaign.clone() }, left_out)
}

fn is_asked(name: &str) -> bool {
    !has_mechanism(name) && !SET.contains(&name)
}

/// The rows that have an angle. Values that one row gives for all its runs count once.
fn rows(campaign: &Campaign) -> Vec<Row> {
    let mut of_row: Vec<(Row, Vec<f64>)> = Vec::new();
    for run in campaign.measured() {
        let of_run = campaign.runs[run];
        let angle = of_run.value.unwrap_or(f64::NAN);
        match of_row.last_mut().filter(|(last, _)| campaign.runs[last.run].row == of_run.row) {
            Some((_, angles)) => angles.push(angle),
            None => of_row.push((
                Row { powder: of_run.powder, session: of_run.session, angle, run },
                vec![angle],
            )),
        }
    }
    of_row
        .into_iter()
        .map(|(row, angles)| Row { angle: mean(&angles).unwrap_or(row.angle), ..row })
        .collect()
}

fn numbers(covariate: &Covariate) -> Option<Vec<Option<f64>>> {
    match &covariate.values {
        Values::Numbers(values) => Some(values.clone()),
        Values::Levels { .. } => None,
    }
}

/// Why a column is derived from the angle, if it is.
fn follows(campaign: &Campaign, rows: &[Row], covariate: &Covariate) -> Option<ColumnLeftOut> {
    let reason = match &covariate.values {
        Values::Numbers(values) => of_numbers(campaign.quantity, rows, &covariate.name, values),
        Values::Levels { of, .. } => are_classes(rows, of).then(|| {
            "follows from the angle: its names are ranges of it, whatever the powder".to_owned()
        }),
    };
    let reason = reason.or_else(|| {
        order::follows(campaign.quantity, rows, campaign.measured().len(), &covariate.values)
    });
    Some(ColumnLeftOut { column: covariate.name.clone(), reason: reason? })
}

fn of_numbers(
    quantity: Quantity,
    rows: &[Row],
    name: &str,
    values: &[Option<f64>],
) -> Option<String> {
    let course = Course::of(rows, values)?;
    let (share, t) = (course.share(), course.t());
    let (left, least) =
        (course.left(), if quantity == Quantity::Repose { REPEATS_TO } else { FLOW_REPEATS_TO });
    let is_rounded = share >= NEAR_ALL && left < ROUNDING * least;
    if t < NAMED_T || (course.is_blind_to_powders() && !is_rounded) {
        return None;
    }
    let is_strong = t >= STRONG_T && share >= STRONG_SHARE;
    let of_what = if quantity == Quantity::Repose { "angle" } else { "flow time" };
    let explains = format!(
        "follows from the {of_what}: explains {:.0} % of how far runs of one powder on one day are apart",
        100.0 * share
    );
    if is_strong && course.is_of_powders() {
        Some(format!("{explains}, and is as much more or less for powders that are steeper"))
    } else if is_strong && quantity == Quantity::Repose && course.reads_the_angle() {
        Some(format!("{explains}, and reads nearly what the angle is"))
    } else if share >= NEAR_ALL && left < least {
        Some(format!(
            "{explains}, and leaves {left:.2} {}: no condition makes repeats so alike",
            quantity.unit()
        ))
    } else if words::is_of_heap(name, quantity) && !is_setting(name, values) {
        Some(format!("{explains}, and is called after the heap that was measured"))
    } else {
        None
    }
}

impl Course {
    /// Returns `None` where too few rows have both.
    fn of(rows: &[Row], values: &[Option<f64>]) -> Option<Self> {
        let known: Vec<(Row, f64)> =
            rows.iter().filter_map(|&row| Some((row, values[row.run]?))).collect();
        let (rows, values): (Vec<Row>, Vec<f64>) = known.into_iter().unzip();
        if rows.len() < ROWS_MIN {
            return None;
        }
        let on_days = departures(&rows, &values, |row| (row.powder, row.session));
        let (departures, freedom) = match on_days.1 >= FREEDOM_MIN {
            true => on_days,
            false => departures(&rows, &values, |row| (row.powder, 0)),
        };
        (freedom > 1).then_some(Self { rows, values, departures, freedom: freedom as f64 - 1.0 })
    }

    fn sum(&self, of: impl Fn(f64, f64) -> f64) -> f64 {
        self.departures.iter().map(|&[x, y]| of(x, y)).sum()
    }

    /// Share of the scatter that goes with the column, r^2.
    fn share(&self) -> f64 {
        let scale = self.sum(|x, _| x * x) * self.sum(|_, y| y * y);
        if scale > 0.0 { (self.sum(|x, y| x * y).powi(2) / scale).min(1.0) } else { 0.0 }
    }

    fn t(&self) -> f64 {
        (self.share() * self.freedom / (1.0 - self.share()).max(1e-12)).sqrt()
    }

    fn slope(&self) -> f64 {
        self.sum(|x, y| x * y) / self.sum(|_, y| y * y)
    }

    /// SD of the angle within days that the column leaves.
    fn sd(&self) -> f64 {
        (self.sum(|_, y| y * y) / self.freedom).sqrt()
    }

    fn left(&self) -> f64 {
        self.sd() * (1.0 - self.share()).sqrt()
    }

    /// Rows, mean value and mean angle of each powder.
    fn powders(&self) -> Vec<[f64; 3]> {
        let mut of: BTreeMap<usize, [f64; 3]> = BTreeMap::new();
        for (row, value) in self.rows.iter().zip(&self.values) {
            let [n, x, y] = of.entry(row.powder).or_default();
            (*n, *x, *y) = (*n + 1.0, *x + value, *y + row.angle);
        }
        of.into_values().map(|[n, x, y]| [n, x / n, y / n]).collect()
    }

    /// Sums over powders of squares and products of their means, by rows: of values, of both, of
    /// angles. `None` where their angles are too much alike.
    fn between(&self) -> Option<[f64; 3]> {
        let powders = self.powders();
        let rows: f64 = powders.iter().map(|powder| powder[0]).sum();
        let middle =
            |k: usize| powders.iter().map(|powder| powder[0] * powder[k]).sum::<f64>() / rows;
        let (x, y) = (middle(1), middle(2));
        let sum = |of: fn(f64, f64) -> f64| {
            powders.iter().map(|powder| powder[0] * of(powder[1] - x, powder[2] - y)).sum::<f64>()
        };
        let sums = [sum(|x, _| x * x), sum(|x, y| x * y), sum(|_, y| y * y)];
        (powders.len() > 1 && (sums[2] / rows).sqrt() >= POWDERS_APART * self.sd()).then_some(sums)
    }

    /// Whether powders' means lie on the line of the runs within them.
    fn is_of_powders(&self) -> bool {
        let Some([xx, xy, yy]) = self.between().filter(|sums| sums[0] > 0.0) else { return false };
        let (between, on_a_line) = (xy / yy, xy * xy / (xx * yy));
        let is_same = (SAME_SLOPE[0]..=SAME_SLOPE[1]).contains(&(between / self.slope()))
            && on_a_line >= ON_A_LINE;
        is_same && between.abs() >= SLOPE_Z * (self.variance_of_means() / yy).sqrt()
    }

    /// Whether powders of different angles have the same average of it, as far as can be seen.
    fn is_blind_to_powders(&self) -> bool {
        let spread = |[xx, ..]: [f64; 3]| xx / (self.powders().len() - 1) as f64;
        self.between().is_some_and(|sums| spread(sums) < KNOWS_POWDERS * self.variance_of_means())
    }

    /// Variance of a powder's mean times its rows, for a condition that does not depend on the
    /// powder; runs of a day share their common part.
    fn variance_of_means(&self) -> f64 {
        let variance = |of: fn(&Row) -> (usize, usize)| {
            let (departures, freedom) = departures(&self.rows, &self.values, of);
            departures.iter().map(|pair| pair[0] * pair[0]).sum::<f64>() / freedom.max(1) as f64
        };
        let (of_powder, of_day) =
            (variance(|row| (row.powder, 0)), variance(|row| (row.powder, row.session)));
        let days: BTreeSet<(usize, usize)> =
            self.rows.iter().map(|row| (row.powder, row.session)).collect();
        let on_a_day = self.rows.len() as f64 / days.len() as f64;
        let shared = if of_powder > 0.0 { (1.0 - of_day / of_powder).clamp(0.0, 1.0) } else { 0.0 };
        of_powder * (1.0 + (on_a_day - 1.0) * shared)
    }

    /// Whether its means are near the powders' angles, and it moves degree for degree with them.
    fn reads_the_angle(&self) -> bool {
        let is_near = self.powders().iter().all(|[_, x, y]| (x - y).abs() <= NEARLY_DEG);
        is_near && (0.5..=1.5).contains(&self.slope())
    }
}

/// Departures of values and angles from the means of their groups, outliers clamped; and the
/// remaining degrees of freedom.
fn departures(
    rows: &[Row],
    values: &[f64],
    of: impl Fn(&Row) -> (usize, usize),
) -> (Vec<[f64; 2]>, usize) {
    let mut sums: BTreeMap<(usize, usize), [f64; 3]> = BTreeMap::new();
    for (row, value) in rows.iter().zip(values) {
        let [n, x, y] = sums.entry(of(row)).or_default();
        (*n, *x, *y) = (*n + 1.0, *x + value, *y + row.angle);
    }
    let own = |(row, value): (&Row, &f64)| {
        let [n, x, y] = sums[&of(row)];
        (n > 1.0).then(|| [value - x / n, row.angle - y / n])
    };
    let mut departures: Vec<[f64; 2]> = rows.iter().zip(values).filter_map(own).collect();
    for k in 0..2 {
        let mut sizes: Vec<f64> = departures.iter().map(|pair| pair[k].abs()).collect();
        sizes.sort_by(f64::total_cmp);
        // 1.4826: SD of a normal distribution over its median absolute deviation.
        let reach = OUTLIER_SD * 1.4826 * sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
        if reach > 0.0 {
            departures.iter_mut().for_each(|pair| pair[k] = pair[k].clamp(-reach, reach));
        }
    }
    let groups = sums.values().filter(|sum| sum[0] > 1.0).count();
    let freedom = departures.len() - groups;
    (departures, freedom)
}

/// Whether a column with few distinct values could have been set by hand, its name not being
/// specific to heaps.
fn is_setting(name: &str, values: &[Option<f64>]) -> bool {
    let different: BTreeSet<u64> = values.iter().flatten().map(|value| value.to_bits()).collect();
    different.len() <= SET_VALUES_MAX && !words::is_of_heaps_alone(name)
}

/// Whether the logarithms of these columns together explain most of the scatter of repeats.
fn together(rows: &[Row], columns: &[(&str, Vec<Option<f64>>)]) -> bool {
    if columns.len() < 2 {
        return false;
    }
    let has_all =
        |row: &&Row| columns.iter().all(|(_, of)| of[row.run].is_some_and(|value| value > 0.0));
    let rows: Vec<Row> = rows.iter().filter(has_all).copied().collect();
    let of = |column: &[Option<f64>]| -> Vec<f64> {
        rows.iter().map(|row| column[row.run].map_or(0.0, libm::log)).collect()
    };
    let day = |row: &Row| (row.powder, row.session);
    let powder = |row: &Row| (row.powder, 0);
    let is_by_day = departures(&rows, &vec![0.0; rows.len()], day).1 >= FREEDOM_MIN;
    let centred = |values: &[f64]| match is_by_day {
        true => departures(&rows, values, day),
        false => departures(&rows, values, powder),
    };
    let all: Vec<(Vec<[f64; 2]>, usize)> =
        columns.iter().map(|(_, column)| centred(&of(column))).collect();
    let (first, freedom) = &all[0];
    if *freedom < FREEDOM_MIN + columns.len() {
        return false;
    }
    let x = DMatrix::from_fn(first.len(), all.len(), |i, k| all[k].0[i][0]);
    let y = DVector::from_fn(first.len(), |i, _| first[i][1]);
    let Ok(fit) = x.clone().svd(true, true).solve(&y, 1e-9) else { return false };
    let left = (&y - x * fit).norm_squared() / (freedom - columns.len()) as f64;
    1.0 - left / (y.norm_squared() / *freedom as f64) >= TOGETHER
}

/// Whether names are ranges of the angle: no two overlap, over all powders, some powder has two of
/// them, and some two powders share one.
fn are_classes(rows: &[Row], of: &[Option<usize>]) -> bool {
    let mut known: Vec<(f64, usize, usize)> =
        rows.iter().filter_map(|row| Some((row.angle, of[row.run]?, row.powder))).collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let count = |which: &dyn Fn(&(f64, usize, usize)) -> bool| {
        known.iter().filter(|row| which(row)).count()
    };
    let mut pairs: Vec<(usize, usize)> = known.iter().map(|row| (row.1, row.2)).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let is_often =
        |&(level, powder): &(usize, usize)| count(&|row| row.1 == level && row.2 == powder) >= 3;
    let often: Vec<(usize, usize)> = pairs.into_iter().filter(is_often).collect();
    let has_two = |k: fn(&(usize, usize)) -> usize| {
        often.iter().any(|one| often.iter().any(|other| one != other && k(one) == k(other)))
    };
    if known.len() < ROWS_MIN || !has_two(|row| row.1) || !has_two(|row| row.0) {
        return false;
    }
    // Levels in the order of their medians; a row is misplaced if its position belongs to another
    // level.
    let mut levels: Vec<(usize, usize)> = Vec::new();
    for level in known.iter().map(|row| row.1).collect::<BTreeSet<_>>() {
        let places: Vec<usize> = (0..known.len()).filter(|&k| known[k].1 == level).collect();
        levels.push((places[places.len() / 2], level));
    }
    levels.sort_unstable();
    let expected = levels
        .iter()
        .flat_map(|&(_, level)| std::iter::repeat_n(level, count(&|row| row.1 == level)));
    let misplaced = known.iter().zip(expected).filter(|(row, level)| row.1 != *level).count();
    misplaced as f64 <= MISPLACED * known.len() as f64
}

#[cfg(test)]
mod residual_tests;
#[cfg(test)]
mod tests;
