//! Detects columns that are functions of the angle's residual from its powder's mean: deviation
//! from nominal, z score within the powder, rank, a flag for values above the mean, the session's
//! mean of these.
//!
//! A column computed this way fixes the order of the angles. A condition does not: heaps scatter in
//! addition to its effect, and runs at nearly the same setting stand in any order. The test is how
//! likely a condition would leave so few exceptions:
//!
//! ```text
//! groups     runs of a powder by their angles | all runs by their angle less the mean of powder and day | days by their mean of angles less powders'
//! class      runs of a group with the same of the column; m its median angle, c the middle between it and the next class's
//! s          scatter in the classes of all groups, 1.4826 median |y - m|, and not less than heaps repeat to
//! P          product over runs of Phi((c_above - m) / s) - Phi((c_below - m) / s): that each stays in its class, were its class all that it is due to
//! ```
//!
//! This assumes as strong a condition as possible: its effect is taken to be the whole difference
//! between classes. Runs left out as exceptions, such as typing errors, are one in fifty at most,
//! and could have been any: each costs a factor of n, and the order of k names one of k!. Below
//! [`ORDER_CHANCE`] the column counts as derived. A condition is left out by mistake if it has this order
//! by chance, and so about as rarely.

use super::Row;
use crate::data::campaign::{Quantity, Values};
use crate::thresholds::column::{
    FLOW_REPEATS_TO, FREEDOM_MIN, MISPLACED, ORDER_CHANCE, REPEATS_TO, ROWS_MIN,
};
use flip_core::stats::normal;
use flip_core::stats::summary::mean;
use std::collections::BTreeMap;

/// Most names that are put in order.
const NAMES_MAX: usize = 5;

/// A run, or a day, compared with others of its group.
#[derive(Debug, Clone, Copy)]
struct Point {
    group: usize,
    x: f64,
    y: f64,
}

/// One way to group the column's rows, and the part of the angle's scatter that is free in it.
struct Look {
    points: Vec<Point>,
    freedom: usize,
    /// Least scatter of one of its points.
    repeats_to: f64,
    of_what: &'static str,
}

/// Looks at rows and a column in one way, where repeats scatter to so many degrees.
type Looking = fn(&[Row], &[Option<f64>], f64) -> Option<Look>;

/// Why a column is a function of the angle's residual from its powder's mean, if it is. `runs` is
/// the number of runs behind the rows.
pub(crate) fn follows(
    quantity: Quantity,
    rows: &[Row],
    runs: usize,
    values: &Values,
) -> Option<String> {
    let (column, ln_orders) = ordered(rows, values)?;
    if column.iter().flatten().count() < ROWS_MIN {
        return None;
    }
    let of_run = if quantity == Quantity::Repose { REPEATS_TO } else { FLOW_REPEATS_TO };
    let repeats_to = of_run * (rows.len() as f64 / runs.max(rows.len()) as f64).sqrt();
    let looks: [Looking; 3] = [of_powders, of_days, of_means];
    looks.into_iter().find_map(|look| {
        let look = look(rows, &column, repeats_to)?;
        let exceptions = look.exceptions(ln_orders)?;
        Some(format!(
            "follows from the angle less its powder's mean: {} stand in the order of this column, with {exceptions} exceptions; heaps scatter too much for a condition to do that",
            look.of_what
        ))
    })
}

/// The column as numbers, row by row, and the logarithm of the number of possible orders.
fn ordered(rows: &[Row], values: &Values) -> Option<(Vec<Option<f64>>, f64)> {
    match values {
        Values::Numbers(values) => {
            Some((rows.iter().map(|row| values[row.run]).collect(), std::f64::consts::LN_2))
        }
        Values::Levels { names, of } if names.len() <= NAMES_MAX => {
            let left = less_mean(rows, |row| (row.powder, 0));
            let own = |level: usize| {
                rows.iter().zip(&left).filter(move |(row, _)| of[row.run] == Some(level))
            };
            let middle =
                |level| mean(&own(level).map(|(_, left)| *left).collect::<Vec<_>>()).unwrap_or(0.0);
            let middles: Vec<f64> = (0..names.len()).map(middle).collect();
            let ln_orders = (1..=names.len()).map(|k| libm::log(k as f64)).sum();
            Some((
                rows.iter().map(|row| of[row.run].map(|level| middles[level])).collect(),
                ln_orders,
            ))
        }
        Values::Levels { .. } => None,
    }
}

/// Angles less the mean of their group.
fn less_mean(rows: &[Row], group: impl Fn(&Row) -> (usize, usize)) -> Vec<f64> {
    let mut of: BTreeMap<(usize, usize), (f64, f64)> = BTreeMap::new();
    for row in rows {
        let (n, sum) = of.entry(group(row)).or_default();
        (*n, *sum) = (*n + 1.0, *sum + row.angle);
    }
    let middle = |row: &Row| of[&group(row)].1 / of[&group(row)].0;
    rows.iter().map(|row| row.angle - middle(row)).collect()
}

/// Runs of each powder by their angles.
fn of_powders(rows: &[Row], column: &[Option<f64>], repeats_to: f64) -> Option<Look> {
    let point =
        |(row, x): (&Row, &Option<f64>)| Some(Point { group: row.powder, x: (*x)?, y: row.angle });
    let points: Vec<Point> = rows.iter().zip(column).filter_map(point).collect();
    let freedom = points.len();
    Some(Look { points, freedom, repeats_to, of_what: "the angles of every powder" })
}

/// Runs by their angle less the mean of their powder on that day.
fn of_days(rows: &[Row], column: &[Option<f64>], repeats_to: f64) -> Option<Look> {
    let day = |row: &Row| (row.powder, row.session);
    let mut on_day: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    rows.iter().for_each(|row| *on_day.entry(day(row)).or_default() += 1);
    let left = less_mean(rows, day);
    let known = (0..rows.len()).filter(|&k| on_day[&day(&rows[k])] > 1);
    let points: Vec<Point> =
        known.filter_map(|k| Some(Point { group: 0, x: column[k]?, y: left[k] })).collect();
    // Rows determined by the mean of a day are not free.
    let freedom = points.len().saturating_sub(on_day.values().filter(|runs| **runs > 1).count());
    let of_what = "the angles, less the mean of their powder on the day,";
    (freedom >= FREEDOM_MIN).then_some(Look { points, freedom, repeats_to, of_what })
}

/// Days by their mean of angles less their powders', if the column has one value a day.
fn of_means(rows: &[Row], column: &[Option<f64>], repeats_to: f64) -> Option<Look> {
    let left = less_mean(rows, |row| (row.powder, 0));
    let mut of: BTreeMap<usize, (Option<f64>, Vec<f64>)> = BTreeMap::new();
    for ((row, x), left) in rows.iter().zip(column).zip(left) {
        let day = of.entry(row.session).or_default();
        if x.is_some_and(|x| day.0.is_some_and(|before| before.to_bits() != x.to_bits())) {
            return None;
        }
        day.0 = day.0.or(*x);
        day.1.push(left);
    }
    let point =
        |(x, left): &(Option<f64>, Vec<f64>)| Some(Point { group: 0, x: (*x)?, y: mean(left)? });
    let points: Vec<Point> = of.values().filter_map(point).collect();
    let freedom = points.len();
    let repeats_to = repeats_to * (of.len() as f64 / rows.len() as f64).sqrt();
    (freedom >= ROWS_MIN && of.len() < rows.len()).then_some(Look {
        points,
        freedom,
        repeats_to,
        of_what: "the means of days",
    })
}

impl Look {
    /// Number of points out of order, rising or falling, if so few do not occur by chance.
    fn exceptions(&self, ln_orders: f64) -> Option<usize> {
        [1.0, -1.0].into_iter().find_map(|sign| {
            let mut groups: BTreeMap<usize, Vec<Point>> = BTreeMap::new();
            self.points.iter().for_each(|it| {
                groups.entry(it.group).or_default().push(Point { x: sign * it.x, ..*it })
            });
            let kept: Vec<Vec<Point>> = groups.into_values().map(in_order).collect();
            let n = self.points.len();
            let out = n - kept.iter().map(Vec::len).sum::<usize>();
            let scatter = scatter(&kept).max(self.repeats_to);
            let ln_chance = kept.iter().map(|group| ln_chance(group, scatter)).sum::<f64>();
            let ln_chance = ln_chance * self.freedom as f64 / n as f64
                + out as f64 * libm::log(n as f64)
                + ln_orders;
            (out as f64 <= MISPLACED * n as f64 && ln_chance < libm::log(ORDER_CHANCE))
                .then_some(out)
        })
    }
}

/// The largest ordered subset of a group: sorted by x, the longest subsequence that does not fall
/// in y.
fn in_order(mut points: Vec<Point>) -> Vec<Point> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    // The last point of the best sequence of each length, and the point before each point.
    let (mut ends, mut before): (Vec<usize>, Vec<Option<usize>>) = (Vec::new(), Vec::new());
    for (k, point) in points.iter().enumerate() {
        let place = ends.partition_point(|&end| points[end].y <= point.y);
        before.push(place.checked_sub(1).map(|place| ends[place]));
        match ends.get_mut(place) {
            Some(end) => *end = k,
            None => ends.push(k),
        }
    }
    let mut kept: Vec<Point> =
        std::iter::successors(ends.last().copied(), |&k| before[k]).map(|k| points[k]).collect();
    kept.reverse();
    kept
}

/// Points of an ordered group, split by their value of the column.
fn classes(points: &[Point]) -> Vec<&[Point]> {
    points.chunk_by(|a, b| a.x.to_bits() == b.x.to_bits()).collect()
}

/// Robust SD within the classes of all groups.
fn scatter(groups: &[Vec<Point>]) -> f64 {
    let departures = |class: &[Point]| -> Vec<f64> {
        let middle = median(class.iter().map(|it| it.y).collect());
        class.iter().map(|it| (it.y - middle).abs()).collect()
    };
    // 1.4826: SD of a normal distribution over its median absolute deviation.
    1.4826 * median(groups.iter().flat_map(|group| classes(group)).flat_map(departures).collect())
}

/// Logarithm of the chance that every point of an ordered group stays in its class.
fn ln_chance(points: &[Point], scatter: f64) -> f64 {
    let classes = classes(points);
    let middles: Vec<f64> =
        classes.iter().map(|class| median(class.iter().map(|it| it.y).collect())).collect();
    let cut = |k: usize| f64::midpoint(middles[k], middles[k + 1]);
    let of_class = |(k, class): (usize, &&[Point])| {
        let middle = middles[k];
        let below = if k == 0 { 0.0 } else { normal::cdf((cut(k - 1) - middle) / scatter) };
        let above =
            if k + 1 == classes.len() { 1.0 } else { normal::cdf((cut(k) - middle) / scatter) };
        class.len() as f64 * libm::log((above - below).max(f64::MIN_POSITIVE))
    };
    classes.iter().enumerate().map(of_class).sum()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    if values.is_empty() {
        return 0.0;
    }
    if values.len() % 2 == 1 { values[half] } else { f64::midpoint(values[half - 1], values[half]) }
}
