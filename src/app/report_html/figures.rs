//! Figures of a report as SVG. Lengths are in pixels of a figure [`WIDTH`] wide.

use super::Named;
use super::words::{column_with_unit, num, percent, shortened};
use flip_discover::report::spoon::{CourseReport, StepReport};
use flip_discover::report::{Curve, NullCheck, Report, Row};
use maud::{Markup, html};

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

/// A length or place, to a tenth of a pixel.
fn px(value: f64) -> String {
    format!("{value:.1}")
}

/// The mark of a powder: colour and shape, so that no information relies on colour alone.
fn mark(powder: usize, x: f64, y: f64) -> Markup {
    let colour = format!("p{}", powder % COLOURS);
    let outline = match powder % SHAPES {
        0 => return html! { circle.(colour) cx=(px(x)) cy=(px(y)) r="3.2" {} },
        1 => format!("M{:.1} {:.1}h6v6h-6z", x - 3.0, y - 3.0),
        2 => format!("M{x:.1} {:.1}l3.7 6.6h-7.4z", y - 3.9),
        3 => format!("M{x:.1} {:.1}l4.1 4.1-4.1 4.1-4.1-4.1z", y - 4.1),
        _ => format!("M{x:.1} {:.1}l3.7-6.6h-7.4z", y + 3.9),
    };
    html! { path.(colour) d=(outline) {} }
}

/// What a legend explains beside the marks of powders.
pub enum Sample {
    /// No difference.
    Zero,
    /// What was found, with its band.
    Course,
    /// A run without the covariate.
    Missing,
}

/// The legend of the marks.
pub fn legend(powders: &[&str], named: Named, samples: &[(Sample, &str)]) -> Markup {
    let swatch = |drawing: Markup, name: &str| {
        html! {
            li {
                svg width="22" height="12" viewBox="0 0 22 12" aria-hidden="true" { (drawing) }
                (name)
            }
        }
    };
    html! {
        ul.legend {
            @for (k, name) in powders.iter().enumerate() {
                (swatch(mark(k, 11.0, 6.0), &named(name)))
            }
            @for (sample, name) in samples { (swatch(sample.drawing(), name)) }
        }
    }
}

impl Sample {
    fn drawing(&self) -> Markup {
        match self {
            Self::Zero => html! { path.zero d="M1 6h20" {} },
            Self::Course => html! {
                rect.band x="1" width="20" height="12" {}
                path.course d="M1 6h20" {}
            },
            Self::Missing => html! { path.rug.p6 d="M4 6h14" {} },
        }
    }
}

/// A figure with its caption.
fn figure(caption: &str, summary: &str, height: f64, drawing: &Markup) -> Markup {
    html! {
        figure {
            figcaption { (caption) }
            svg viewBox={ "0 0 " (WIDTH) " " (height) } role="img" aria-label=(summary) {
                (drawing)
            }
        }
    }
}

/// Frame, grid and numbers of the vertical axis.
fn upright(scale: &Scale, right: f64, label: &str) -> Markup {
    let middle = f64::midpoint(scale.from, scale.to);
    html! {
        @for (value, written) in scale.ticks(5.0) {
            @let y = scale.at(value);
            path.grid d=(format!("M{LEFT} {y:.1}H{right:.1}")) {}
            text.end x=(px(LEFT - 6.0)) y=(px(y + 4.0)) { (written) }
        }
        text.mid x="12" y=(px(middle)) transform=(format!("rotate(-90 12 {middle:.1})")) { (label) }
    }
}

/// Numbers or names, and the label, of the horizontal axis.
fn level(scale: &Scale, ticks: &[(f64, String)], bottom: f64, label: &str) -> Markup {
    let middle = f64::midpoint(scale.from, scale.to);
    html! {
        path.axis d=(format!("M{LEFT} {bottom:.1}H{:.1}", scale.to)) {}
        @for (value, written) in ticks {
            @let x = scale.at(*value);
            path.axis d=(format!("M{x:.1} {bottom:.1}v4")) {}
            text.mid x=(px(x)) y=(px(bottom + 17.0)) { (written) }
        }
        text.mid x=(px(middle)) y=(px(bottom + 36.0)) { (label) }
    }
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

/// What had fallen after each step of a spoonful, by the balance and in replays.
pub fn course(of: &CourseReport, caption: &str) -> Markup {
    const HEIGHT: f64 = 200.0;
    let bottom = HEIGHT - BELOW;
    let steps = &of.steps;
    let masses = steps.iter().flat_map(|it| [it.weighed_mg, it.band90_mg[0], it.band90_mg[1]]);
    let y = Scale::over(masses.chain([0.0]), bottom, EDGE);
    let x = Scale::over([1.0, steps.len() as f64], LEFT, WIDTH - EDGE);
    let place = |k: usize, mg: f64| format!("{:.1} {:.1}", x.at((k + 1) as f64), y.at(mg));
    let path = |mg: &dyn Fn(&StepReport) -> f64| {
        let all = steps.iter().enumerate().map(|(k, it)| place(k, mg(it)));
        format!("M{}", all.collect::<Vec<_>>().join("L"))
    };
    let back = steps.iter().enumerate().rev().map(|(k, it)| place(k, it.band90_mg[0]));
    let band = format!("{}L{}Z", path(&|it| it.band90_mg[1]), back.collect::<Vec<_>>().join("L"));
    let last = steps.last().map_or([0.0; 2], |it| [it.weighed_mg, it.simulated_mg]);
    let summary = format!(
        "{caption}: {} mg weighed in the end, {} mg simulated",
        num(last[0], 1),
        num(last[1], 1)
    );
    let drawing = html! {
        (upright(&y, WIDTH - EDGE, "Fallen, mg"))
        @if !steps.is_empty() {
            path.band d=(band) {}
            path.course d=(path(&|it| it.simulated_mg)) {}
        }
        @for (k, it) in steps.iter().enumerate() {
            (mark(0, x.at((k + 1) as f64), y.at(it.weighed_mg)))
        }
        (level(&x, &x.ticks(8.0), bottom, "Step"))
    };
    figure(caption, &summary, HEIGHT, &drawing)
}

/// Residuals of the original simulator over one covariate, with the curve of the extended one and
/// its 90 % band; `None` where no run has the covariate.
pub fn residuals(report: &Report, curve: &Curve) -> Option<Markup> {
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
        return None;
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
    // Runs of one name are placed side by side.
    let aside = |k: usize| if is_named { 0.25 * (((k * 7) % 11) as f64 / 5.0 - 1.0) } else { 0.0 };
    let label = column_with_unit(&curve.covariate);
    let drawing = html! {
        (upright(&y, right, "Measured − simulated (°)"))
        (level(&x, &ticks, bottom, &label))
        @if is_named { (steps(&x, &y, &course)) } @else { (ribbon(&x, &y, &course)) }
        path.zero d=(format!("M{LEFT} {:.1}H{right:.1}", y.at(0.0))) {}
        @for (k, (at, residual, powder)) in points.iter().enumerate() {
            @let y = y.at(*residual);
            @match at {
                Some(place) => (mark(*powder, x.at(place + aside(k)), y)),
                None => path.rug.{ "p" (powder % COLOURS) }
                    d=(format!("M{:.1} {y:.1}h14", right + 14.0)) {},
            }
        }
        @if missing > 0 {
            text.mid x=(px(right + 21.0)) y=(px(bottom + 17.0)) { (missing) " not" }
            text.mid x=(px(right + 21.0)) y=(px(bottom + 31.0)) { "recorded" }
        }
    };
    let summary = format!(
        "Measured minus simulated angle of repose over {label}: {} runs, {missing} without a \
         recorded value.",
        points.len()
    );
    Some(figure(&label, &summary, HEIGHT, &drawing))
}

/// Curve and band over numbers.
fn ribbon(x: &Scale, y: &Scale, course: &[[f64; 3]]) -> Markup {
    let point = |place: f64, value: f64| format!("{:.1},{:.1}", x.at(place), y.at(value));
    let above = course.iter().map(|[place, mean, half]| point(*place, mean + half));
    let below = course.iter().rev().map(|[place, mean, half]| point(*place, mean - half));
    let outline: Vec<String> = above.chain(below).collect();
    let middle: Vec<String> = course.iter().map(|[place, mean, _]| point(*place, *mean)).collect();
    html! {
        @if !course.is_empty() {
            polygon.band points=(outline.join(" ")) {}
            polyline.course points=(middle.join(" ")) {}
        }
    }
}

/// Curve and band over names.
fn steps(x: &Scale, y: &Scale, course: &[[f64; 3]]) -> Markup {
    html! {
        @for [place, mean, half] in course {
            @let (from, to) = (x.at(place - 0.38), x.at(place + 0.38));
            @let (top, low) = (y.at(mean + half), y.at(mean - half));
            rect.band x=(px(from)) y=(px(top.min(low)))
                width=(px(to - from)) height=(px((low - top).abs())) {}
            path.course d=(format!("M{from:.1} {:.1}H{to:.1}", y.at(*mean))) {}
        }
    }
}

/// One side of a before/after comparison: the prediction for a row, and its SD.
pub type Side = fn(&Row) -> (Option<f64>, f64);

/// Predicted against measured angles; both sides share the scale of all rows.
pub fn predicted(report: &Report, caption: &str, side: Side) -> Markup {
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
    let (mut within, mut square) = (0usize, 0.0);
    let (mut sds, mut marks) = (Vec::new(), Vec::new());
    for (row, measured) in all {
        let (Some(prediction), sd) = side(row) else { continue };
        if !(prediction - measured).is_finite() {
            continue;
        }
        let powder = order.iter().position(|name| *name == row.powder).unwrap_or_default();
        marks.push(mark(powder, x.at(prediction), y.at(measured)));
        within += usize::from((measured - prediction).abs() <= Z90 * sd);
        square += (measured - prediction).powi(2);
        sds.push(sd);
    }
    sds.retain(|sd| sd.is_finite());
    sds.sort_by(f64::total_cmp);
    let half = sds.get(sds.len() / 2).map_or(0.0, |sd| Z90 * sd);
    let diagonal = |shift: f64| {
        let (from, to) = (x.low.max(y.low - shift), x.high.min(y.high - shift));
        let ends = [x.at(from), y.at(from + shift), x.at(to), y.at(to + shift)];
        format!("M{:.1} {:.1}L{:.1} {:.1}", ends[0], ends[1], ends[2], ends[3])
    };
    let drawing = html! {
        (upright(&y, WIDTH - EDGE, "Measured (°)"))
        (level(&x, &x.ticks(5.0), bottom, "Predicted (°)"))
        @for shift in [0.0, half, -half] {
            path.(if shift == 0.0 { "zero" } else { "limit" }) d=(diagonal(shift)) {}
        }
        @for mark in &marks { (mark) }
    };
    let count = marks.len();
    let rms = if count == 0 { f64::NAN } else { (square / count as f64).sqrt() };
    let share = percent(within as f64 / count.max(1) as f64)
        .replace('>', "more than")
        .replace('<', "less than");
    let summary = format!(
        "RMS difference {}° over {count} runs; {share} % lie within their 90 % interval.",
        num(rms, 2)
    );
    html! { div { (figure(caption, &summary, HEIGHT, &drawing)) p.note { (summary) } } }
}

/// The statistic of this campaign against the value exceeded by one in twenty campaigns without an
/// effect; empty where one of them is not known.
pub fn null_scale(check: &NullCheck) -> Markup {
    const HEIGHT: f64 = 74.0;
    let both = check.statistic.zip(check.threshold95);
    let Some((statistic, threshold95)) = both.filter(|(here, limit)| (here - limit).is_finite())
    else {
        return html! {};
    };
    let x = Scale::over([0.0, statistic, threshold95], 12.0, WIDTH - 12.0);
    let (here, limit) = (x.at(statistic), x.at(threshold95));
    let side = |at: f64| if at > 0.7 * WIDTH { ("end", at - 6.0) } else { ("start", at + 6.0) };
    let ((limit_side, limit_text), (here_side, here_text)) = (side(limit), side(here));
    let drawing = html! {
        rect.band x="12" y="24" width=(px((limit - 12.0).max(0.0))) height="24" {}
        path.axis d=(format!("M12 48H{:.1}", WIDTH - 12.0)) {}
        @for (value, written) in x.ticks(6.0) {
            @let at = x.at(value);
            path.axis d=(format!("M{at:.1} 48v4")) {}
            text.mid x=(px(at)) y="66" { (written) }
        }
        path.zero d=(format!("M{limit:.1} 6V48")) {}
        text.(limit_side) x=(px(limit_text)) y="14" { "1 in 20 above" }
        path.here d=(format!("M{here:.1} 24V48")) {}
        text.(here_side).strong x=(px(here_text)) y="40" { "here" }
    };
    let summary = format!(
        "The statistic here is {}; one in twenty campaigns without an effect exceeds {}.",
        num(statistic, 1),
        num(threshold95, 1)
    );
    figure("The statistic here, and where nothing is wrong", &summary, HEIGHT, &drawing)
}

/// A bar from zero to `value` on a scale shared by all bars of a table.
pub fn bar(value: f64, low: f64, high: f64, class: &str) -> Markup {
    let x = |value: f64| 160.0 * (value.clamp(low, high) - low) / (high - low);
    let (zero, end) = (x(0.0), if value.is_finite() { x(value) } else { x(0.0) });
    html! {
        svg.bar viewBox="0 0 160 12" preserveAspectRatio="none" aria-hidden="true" {
            rect.(class) x=(px(zero.min(end))) y="1" width=(px((end - zero).abs())) height="10" {}
            path.axis d=(format!("M{zero:.1} 0V12")) {}
        }
    }
}
