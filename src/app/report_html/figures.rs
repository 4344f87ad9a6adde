//! Figures of a report as SVG. Lengths are in pixels of a figure [`WIDTH`] wide.

use super::words::{column_with_unit, num, percent, shortened, text};
use flip_discover::report::{Curve, NullCheck, Report, Row};

/// Width of every figure.
const WIDTH: f64 = 420.0;
/// Margins for the labels to the left of a figure and below it, and at the other two edges.
const LEFT: f64 = 48.0;
const BELOW: f64 = 44.0;
const EDGE: f64 = 10.0;
/// Width of the strip for runs without the covariate.
const STRIP: f64 = 44.0;
/// Number of colours for powders; shapes repeat with another period.
const COLOURS: usize = 7;
const SHAPES: usize = 5;
/// z of a two-sided 90 % interval.
const Z90: f64 = 1.645;

/// Maps values to pixels.
#[derive(Debug, Clone, Copy)]
pub struct Scale {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    /// A scale over all finite `values`, with a little room, from pixel `from` to pixel `to`.
    pub fn over(values: impl IntoIterator<Item = f64>, from: f64, to: f64) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values.into_iter().filter(|value| value.is_finite()) {
            (low, high) = (low.min(value), high.max(value));
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        let room =
            if high - low > 1e-9 * low.abs().max(high.abs()) { 0.04 * (high - low) } else { 0.5 };
        Self { low: low - room, high: high + room, from, to }
    }

    /// Pixel of a value.
    pub fn at(&self, value: f64) -> f64 {
        self.from + (self.to - self.from) * (value - self.low) / (self.high - self.low)
    }

    /// About `count` round values on the scale, as written.
    pub fn ticks(&self, count: f64) -> Vec<(f64, String)> {
        let rough = (self.high - self.low) / count;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|m| m * power)
            .into_iter()
            .find(|step| *step >= 0.7 * rough)
            .unwrap_or(rough);
        let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).map(|value| (value, num(value, decimals))).collect()
    }
}

/// Powders in the order of the file, each with its mark.
pub fn powders(rows: &[Row]) -> Vec<&str> {
    let mut found: Vec<&str> = Vec::new();
    for row in rows {
        if !found.contains(&row.powder.as_str()) {
            found.push(&row.powder);
        }
    }
    found
}

/// The mark of a powder: colour and shape, so that no information relies on colour alone.
pub fn mark(powder: usize, x: f64, y: f64) -> String {
    let class = format!("class=\"p{}\"", powder % COLOURS);
    let (l, t) = (x - 3.0, y - 3.0);
    match powder % SHAPES {
        0 => format!("<circle {class} cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\"/>"),
        1 => format!("<path {class} d=\"M{l:.1} {t:.1}h6v6h-6z\"/>"),
        2 => format!("<path {class} d=\"M{x:.1} {:.1}l3.7 6.6h-7.4z\"/>", y - 3.9),
        3 => format!("<path {class} d=\"M{x:.1} {:.1}l4.1 4.1-4.1 4.1-4.1-4.1z\"/>", y - 4.1),
        _ => format!("<path {class} d=\"M{x:.1} {:.1}l3.7-6.6h-7.4z\"/>", y + 3.9),
    }
}

/// The legend of the marks.
pub fn legend(powders: &[&str], more: &[(&str, &str)]) -> String {
    let swatch = |drawing: &str, name: &str| {
        format!(
            "<li><svg width=\"22\" height=\"12\" viewBox=\"0 0 22 12\" aria-hidden=\"true\">{drawing}</svg>{name}</li>"
        )
    };
    let of_powder =
        |(k, name): (usize, &&str)| swatch(&mark(k, 11.0, 6.0), &text(&super::words::words(name)));
    let marks: String = powders.iter().enumerate().map(of_powder).collect();
    let others: String = more.iter().map(|(drawing, name)| swatch(drawing, name)).collect();
    format!("<ul class=\"legend\">{marks}{others}</ul>")
}

/// A figure with its caption.
fn figure(caption: &str, summary: &str, height: f64, drawing: &str) -> String {
    format!(
        "<figure><figcaption>{}</figcaption><svg viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{}\">{drawing}\
         </svg></figure>",
        text(caption),
        text(summary)
    )
}

/// Frame, grid and numbers of the vertical axis.
fn upright(scale: &Scale, right: f64, label: &str) -> String {
    let lines: String = scale
        .ticks(5.0)
        .iter()
        .map(|(value, written)| {
            let y = scale.at(*value);
            format!(
                "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right:.1}\"/><text class=\"end\" x=\"{:.1}\" y=\"{:.1}\">{written}\
                 </text>",
                LEFT - 6.0,
                y + 4.0
            )
        })
        .collect();
    let middle = f64::midpoint(scale.from, scale.to);
    format!(
        "{lines}<text class=\"mid\" x=\"12\" y=\"{middle:.1}\" transform=\"rotate(-90 12 {middle:.1})\">{}</text>",
        text(label)
    )
}

/// Numbers or names, and the label, of the horizontal axis.
fn level(scale: &Scale, ticks: &[(f64, String)], bottom: f64, label: &str) -> String {
    let numbers: String = ticks
        .iter()
        .map(|(value, written)| {
            let x = scale.at(*value);
            format!(
                "<path class=\"axis\" d=\"M{x:.1} {bottom:.1}v4\"/><text class=\"mid\" x=\"{x:.1}\" y=\"{:.1}\">{}</text>",
                bottom + 17.0,
                text(written)
            )
        })
        .collect();
    format!(
        "<path class=\"axis\" d=\"M{LEFT} {bottom:.1}H{:.1}\"/>{numbers}<text class=\"mid\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
        scale.to,
        f64::midpoint(scale.from, scale.to),
        bottom + 36.0,
        text(label)
    )
}

/// Names along an axis: as many as fit.
fn names(levels: &[String], room: f64) -> Vec<(f64, String)> {
    let each = room / levels.len().max(1) as f64;
    let every = (38.0 / each).ceil().max(1.0) as usize;
    let letters = (each * every as f64 / 6.6) as usize;
    levels
        .iter()
        .enumerate()
        .step_by(every)
        .map(|(k, name)| (k as f64, shortened(name, letters)))
        .collect()
}

/// Residuals of the original simulator over one covariate, with the curve of the extended one and
/// its 90 % band.
pub fn residuals(report: &Report, curve: &Curve) -> String {
    const HEIGHT: f64 = 258.0;
    let order = powders(&report.rows);
    let points: Vec<(Option<f64>, f64, usize)> = report
        .rows
        .iter()
        .zip(&curve.at)
        .filter_map(|(row, at)| {
            let residual = row.measured_deg? - row.before_deg?;
            let powder = order.iter().position(|name| *name == row.powder)?;
            residual.is_finite().then_some((at.filter(|at| at.is_finite()), residual, powder))
        })
        .collect();
    if points.iter().all(|(at, ..)| at.is_none()) {
        return String::new();
    }
    let course: Vec<[f64; 3]> = curve
        .course
        .iter()
        .filter(|it| it.iter().all(|value| value.is_finite()))
        .copied()
        .collect();
    let missing = points.iter().filter(|(at, ..)| at.is_none()).count();
    let right = WIDTH - EDGE - if missing > 0 { STRIP } else { 0.0 };
    let bottom = HEIGHT - BELOW;
    let band = course.iter().flat_map(|[_, mean, half]| [mean - half, mean + half]);
    let y = Scale::over(
        points.iter().map(|(_, residual, _)| *residual).chain(band).chain([0.0]),
        bottom,
        EDGE,
    );
    let is_named = !curve.levels.is_empty();
    let ends = if is_named { vec![-0.4, curve.levels.len() as f64 - 0.6] } else { Vec::new() };
    let places =
        points.iter().filter_map(|(at, ..)| *at).chain(course.iter().map(|it| it[0])).chain(ends);
    let x = Scale::over(places, LEFT, right);
    let ticks = if is_named { names(&curve.levels, right - LEFT) } else { x.ticks(5.0) };

    let mut drawing = upright(&y, right, "Measured − simulated (°)");
    drawing += &level(&x, &ticks, bottom, &column_with_unit(&curve.covariate));
    drawing += &if is_named { steps(&x, &y, &course) } else { ribbon(&x, &y, &course) };
    drawing += &format!("<path class=\"zero\" d=\"M{LEFT} {:.1}H{right:.1}\"/>", y.at(0.0));
    for (k, (at, residual, powder)) in points.iter().enumerate() {
        match at {
            // Runs of one name are placed side by side.
            Some(place) if is_named => {
                drawing += &mark(
                    *powder,
                    x.at(place + 0.25 * (((k * 7) % 11) as f64 / 5.0 - 1.0)),
                    y.at(*residual),
                );
            }
            Some(place) => drawing += &mark(*powder, x.at(*place), y.at(*residual)),
            None => {
                drawing += &format!(
                    "<path class=\"rug p{}\" d=\"M{:.1} {:.1}h14\"/>",
                    powder % COLOURS,
                    right + 14.0,
                    y.at(*residual)
                );
            }
        }
    }
    if missing > 0 {
        let middle = right + 21.0;
        drawing += &format!(
            "<text class=\"mid\" x=\"{middle:.1}\" y=\"{:.1}\">{missing} not</text>",
            bottom + 17.0
        );
        drawing += &format!(
            "<text class=\"mid\" x=\"{middle:.1}\" y=\"{:.1}\">recorded</text>",
            bottom + 31.0
        );
    }
    let summary = format!(
        "Measured less simulated angle of repose over {}: {} runs, {missing} without it recorded.",
        super::words::lower(&column_with_unit(&curve.covariate)),
        points.len()
    );
    figure(&column_with_unit(&curve.covariate), &summary, HEIGHT, &drawing)
}

/// Curve and band over numbers.
fn ribbon(x: &Scale, y: &Scale, course: &[[f64; 3]]) -> String {
    if course.is_empty() {
        return String::new();
    }
    let point = |place: f64, value: f64| format!("{:.1},{:.1} ", x.at(place), y.at(value));
    let above = course.iter().map(|[place, mean, half]| point(*place, mean + half));
    let below = course.iter().rev().map(|[place, mean, half]| point(*place, mean - half));
    let outline: String = above.chain(below).collect();
    let middle: String = course.iter().map(|[place, mean, _]| point(*place, *mean)).collect();
    format!(
        "<polygon class=\"band\" points=\"{}\"/><polyline class=\"course\" points=\"{}\"/>",
        outline.trim_end(),
        middle.trim_end()
    )
}

/// Curve and band over names.
fn steps(x: &Scale, y: &Scale, course: &[[f64; 3]]) -> String {
    let of = |[place, mean, half]: &[f64; 3]| {
        let (from, to) = (x.at(place - 0.38), x.at(place + 0.38));
        let (top, low) = (y.at(mean + half), y.at(mean - half));
        format!(
            "<rect class=\"band\" x=\"{from:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\"/><path class=\"course\" \
             d=\"M{from:.1} {:.1}H{to:.1}\"/>",
            top.min(low),
            to - from,
            (low - top).abs(),
            y.at(*mean)
        )
    };
    course.iter().map(of).collect()
}

/// One side of a before/after comparison: the prediction for a row, and its SD.
pub type Side = fn(&Row) -> (Option<f64>, f64);

/// Predicted against measured angles; both sides share the scale of all rows.
pub fn predicted(report: &Report, caption: &str, side: Side) -> String {
    const HEIGHT: f64 = 340.0;
    let order = powders(&report.rows);
    let rows = &report.rows;
    let all = rows.iter().filter_map(|row| row.measured_deg.map(|measured| (row, measured)));
    let ends: Vec<f64> = all
        .clone()
        .flat_map(|(row, measured)| [Some(measured), row.before_deg, row.after_deg])
        .flatten()
        .collect();
    let bottom = HEIGHT - BELOW;
    let x = Scale::over(ends.iter().copied(), LEFT, WIDTH - EDGE);
    let y = Scale::over(ends.iter().copied(), bottom, EDGE);
    let mut drawing = upright(&y, WIDTH - EDGE, "Measured (°)");
    drawing += &level(&x, &x.ticks(5.0), bottom, "Predicted (°)");
    let (mut within, mut count, mut square) = (0usize, 0usize, 0.0);
    let (mut sds, mut marks) = (Vec::new(), String::new());
    for (row, measured) in all {
        let (Some(prediction), sd) = side(row) else { continue };
        if !(prediction - measured).is_finite() {
            continue;
        }
        let powder = order.iter().position(|name| *name == row.powder).unwrap_or_default();
        marks += &mark(powder, x.at(prediction), y.at(measured));
        within += usize::from((measured - prediction).abs() <= Z90 * sd);
        count += 1;
        square += (measured - prediction).powi(2);
        sds.push(sd);
    }
    sds.retain(|sd| sd.is_finite());
    sds.sort_by(f64::total_cmp);
    let half = sds.get(sds.len() / 2).map_or(0.0, |sd| Z90 * sd);
    for shift in [0.0, half, -half] {
        let (from, to) = (x.low.max(y.low - shift), x.high.min(y.high - shift));
        drawing += &format!(
            "<path class=\"{}\" d=\"M{:.1} {:.1}L{:.1} {:.1}\"/>",
            if shift == 0.0 { "zero" } else { "limit" },
            x.at(from),
            y.at(from + shift),
            x.at(to),
            y.at(to + shift)
        );
    }
    drawing += &marks;
    let rms = if count == 0 { f64::NAN } else { (square / count as f64).sqrt() };
    let share = percent(within as f64 / count.max(1) as f64)
        .replace("&gt;", "more than")
        .replace("&lt;", "less than");
    let summary = format!(
        "RMS difference {}° over {count} runs; {share} lie within their 90 % interval.",
        num(rms, 2)
    );
    format!(
        "<div>{}<p class=\"note\">{summary}</p></div>",
        figure(caption, &summary, HEIGHT, &drawing)
    )
}

/// The statistic of this campaign against the value exceeded by one in twenty campaigns without an
/// effect.
pub fn null_scale(check: &NullCheck) -> String {
    const HEIGHT: f64 = 74.0;
    let both = check.statistic.zip(check.threshold95);
    let Some((statistic, threshold95)) = both.filter(|(here, limit)| (here - limit).is_finite())
    else {
        return String::new();
    };
    let x = Scale::over([0.0, statistic, threshold95], 12.0, WIDTH - 12.0);
    let (here, limit) = (x.at(statistic), x.at(threshold95));
    let tick = |(value, written): &(f64, String)| {
        format!(
            "<path class=\"axis\" d=\"M{0:.1} 48v4\"/><text class=\"mid\" x=\"{0:.1}\" y=\"66\">{written}</text>",
            x.at(*value)
        )
    };
    let ticks: String = x.ticks(6.0).iter().map(tick).collect();
    let side = |at: f64| if at > 0.7 * WIDTH { ("end", at - 6.0) } else { ("start", at + 6.0) };
    let ((limit_side, limit_text), (here_side, here_text)) = (side(limit), side(here));
    let drawing = format!(
        "<rect class=\"band\" x=\"12\" y=\"24\" width=\"{:.1}\" height=\"24\"/><path class=\"axis\" d=\"M12 48H{:.1}\"/>{ticks}\
         <path class=\"zero\" d=\"M{limit:.1} 6V48\"/><text class=\"{limit_side}\" x=\"{limit_text:.1}\" y=\"14\">1 in 20 above</text>\
         <path class=\"here\" d=\"M{here:.1} 24V48\"/><text class=\"{here_side} strong\" x=\"{here_text:.1}\" y=\"40\">here</text>",
        (limit - 12.0).max(0.0),
        WIDTH - 12.0
    );
    let summary = format!(
        "The statistic here is {}; one of twenty campaigns without an effect exceeds {}.",
        num(statistic, 1),
        num(threshold95, 1)
    );
    figure("The statistic here, and of campaigns with nothing wrong", &summary, HEIGHT, &drawing)
}

/// A bar from zero to `value` on a scale shared by all bars of a table.
pub fn bar(value: f64, low: f64, high: f64, class: &str) -> String {
    let x = |value: f64| 160.0 * (value.clamp(low, high) - low) / (high - low);
    let (zero, end) = (x(0.0), if value.is_finite() { x(value) } else { x(0.0) });
    format!(
        "<svg class=\"bar\" viewBox=\"0 0 160 12\" preserveAspectRatio=\"none\" aria-hidden=\"true\"><rect class=\"{class}\" \
         x=\"{:.1}\" y=\"1\" width=\"{:.1}\" height=\"10\"/><path class=\"axis\" d=\"M{zero:.1} 0V12\"/></svg>",
        zero.min(end),
        (end - zero).abs()
    )
}
