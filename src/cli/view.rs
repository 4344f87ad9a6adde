//! A picture of a heap from the side: its grains, the fitted cone and the apex triangle.

use flip_sim::repose::{Pile, Settings};
use std::fmt::Write;

/// Pixels per grain diameter.
const SCALE: f64 = 32.0;
/// Margin around the heap and for the legend, pixels.
const MARGIN: f64 = 48.0;
/// Maximum number of grains drawn: more would make a picture of many megabytes, so only the nearest
/// to the viewer are drawn.
const DRAWN_MAX: usize = 4000;

/// An SVG of the heap seen along y, nearer grains in front and lighter.
pub(super) fn svg(pile: &Pile, settings: &Settings, diameter_mm: f64) -> String {
    let base = settings.base_radius_diameters;
    let d = diameter_mm;
    let mut grains: Vec<[f64; 4]> = (0..pile.snapshot.ids.len())
        .map(|k| {
            let [x, y, z] = pile.snapshot.centre_mm(k).map(|c| f64::from(c) / d);
            [x, y, z, f64::from(pile.snapshot.radius_mm(k)) / d]
        })
        .collect();
    grains.sort_by(|a, b| b[1].total_cmp(&a[1]));
    let hidden = grains.len().saturating_sub(DRAWN_MAX);
    let top = grains.iter().fold(1.0f64, |top, g| top.max(g[2] + g[3]));
    let (width, height) = (2.0 * base * SCALE + 2.0 * MARGIN, top * SCALE + 3.0 * MARGIN);
    let at = |x: f64, z: f64| [MARGIN + (x + base) * SCALE, height - MARGIN - z * SCALE];
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" font-family=\"sans-serif\" \
         font-size=\"20\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n"
    );
    for [x, y, z, r] in &grains[hidden..] {
        let [cx, cy] = at(*x, *z);
        let near = ((base - y) / (2.0 * base)).clamp(0.0, 1.0);
        let light = 45.0 + 40.0 * near;
        let _ = writeln!(
            out,
            "<circle cx=\"{cx:.1}\" cy=\"{cy:.1}\" r=\"{:.1}\" fill=\"hsl(35 45% {light:.0}%)\" stroke=\"#6b5a3a\" \
             stroke-width=\"0.8\"/>",
            r * SCALE
        );
    }
    let mut line = |from: [f64; 2], to: [f64; 2], style: &str| {
        let _ = writeln!(
            out,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" {style}/>",
            from[0], from[1], to[0], to[1]
        );
    };
    let plate = "stroke=\"#333333\" stroke-width=\"6\"";
    line(at(-base, 0.0), at(base, 0.0), plate);
    let apex = base * pile.repose.tip_deg.to_radians().tan();
    let tip = "stroke=\"#b3261e\" stroke-width=\"4\"";
    // The cone is drawn through the middle of the flank, where it was fitted.
    let slope = pile.repose.cone_deg.to_radians().tan();
    let [half, centre] = [0.5 * apex, 0.5 * base];
    let cone = "stroke=\"#1a56b0\" stroke-width=\"4\" stroke-dasharray=\"14 8\"";
    for side in [-1.0, 1.0] {
        line(at(side * base, 0.0), at(0.0, apex), tip);
        let reach = |z: f64| side * (centre + (half - z) / slope.max(1e-9));
        line(at(reach(0.2 * apex), 0.2 * apex), at(reach(0.8 * apex), 0.8 * apex), cone);
    }
    let legend = [
        ("#b3261e", format!("apex: atan(2 h / d_base) = {:.1} deg", pile.repose.tip_deg)),
        (
            "#1a56b0",
            format!("cone fitted to 20-80 % of the height: {:.1} deg", pile.repose.cone_deg),
        ),
    ];
    for (k, (colour, text)) in legend.iter().enumerate() {
        let _ = writeln!(
            out,
            "<text x=\"{MARGIN}\" y=\"{:.0}\" fill=\"{colour}\">{text}</text>",
            30 + 28 * k
        );
    }
    out.push_str("</svg>\n");
    out
}
