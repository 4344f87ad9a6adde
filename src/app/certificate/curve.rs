//! The balance readings of a dose over time, as a drawing.

use super::super::report_html::figures::Scale;
use super::words::digits;
use flip_core::domain::bench::Tick;
use flip_store::weighings::Weighing;
use maud::{Markup, html};
use std::fmt::Write;

/// Size of the drawing, and the margins of its axes, px.
const WIDTH: f64 = 680.0;
const HEIGHT: f64 = 240.0;
const LEFT: f64 = 52.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 12.0;
const BELOW: f64 = 42.0;

/// The curve, with the tolerance as a band; `None` where fewer than two readings are known.
pub(super) fn curve(weighing: &Weighing, ticks: &[Tick]) -> Option<Markup> {
    let (first, last) = (ticks.first()?, ticks.last()?);
    if ticks.len() < 2 {
        return None;
    }
    let bounds = [
        weighing.target_mg - weighing.tolerance_lower_mg,
        weighing.target_mg + weighing.tolerance_upper_mg,
    ];
    let (right, floor) = (WIDTH - RIGHT, HEIGHT - BELOW);
    let time = Scale::over([first.t_s, last.t_s], LEFT, right);
    let masses = ticks.iter().map(|tick| tick.reading.mass_mg).chain(bounds).chain([0.0]);
    let mass = Scale::over(masses, floor, TOP);
    let summary = format!(
        "Balance readings from {} mg to {} mg in {:.0} s; the target is {} mg.",
        digits(first.reading.mass_mg),
        digits(last.reading.mass_mg),
        last.t_s - first.t_s,
        digits(weighing.target_mg)
    );
    let target = mass.at(weighing.target_mg);
    Some(html! {
        figure {
            svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img" aria-label=(summary) {
                rect.band x=(LEFT) y=(px(mass.at(bounds[1]))) width=(right - LEFT)
                    height=(px(mass.at(bounds[0]) - mass.at(bounds[1]))) {}
                path.target d={ "M" (LEFT) " " (px(target)) "H" (right) } {}
                path.axis d={ "M" (LEFT) " " (TOP) "V" (floor) "H" (right) } {}
                @for (at, text) in mass.ticks(5.0) {
                    text x=(LEFT - 6.0) y=(px(mass.at(at) + 4.0)) text-anchor="end" { (text) }
                }
                @for (at, text) in time.ticks(7.0) {
                    text x=(px(time.at(at))) y=(floor + 16.0) text-anchor="middle" { (text) }
                }
                path.mass d=(steps(ticks, &time, &mass)) {}
                text x=(LEFT + 4.0) y=(TOP + 2.0) { "mg" }
                text x=(right) y=(HEIGHT - 6.0) text-anchor="end" { "bench time, s" }
            }
            figcaption {
                "Balance reading after each of " (ticks.len()) " steps. Dashed: the target; band: its tolerance."
            }
        }
    })
}

/// A reading stands until the next one.
fn steps(ticks: &[Tick], time: &Scale, mass: &Scale) -> String {
    let mut path = String::new();
    for (k, tick) in ticks.iter().enumerate() {
        let (x, y) = (time.at(tick.t_s), mass.at(tick.reading.mass_mg));
        let _infallible = match k {
            0 => write!(path, "M{x:.1} {y:.1}"),
            _ => write!(path, "H{x:.1}V{y:.1}"),
        };
    }
    path
}

/// A length or place, to a tenth of a pixel.
fn px(value: f64) -> String {
    format!("{value:.1}")
}
