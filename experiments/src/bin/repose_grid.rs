//! A friction-cohesion grid of simulated angles of repose, as CSV and, if a third argument names a
//! file, as a picture: `cargo experiment repose_grid -- 9 4 docs/repose_grid.svg >
//! docs/repose_grid.csv`.

use flip_core::domain::parameters::ParameterSet;
use flip_sim::repose::{Settings, repose};
use rayon::prelude::*;

/// The heaps of one parameter set.
struct Cell {
    friction: f64,
    cohesion: f64,
    tip_deg: f64,
    tip_sd_deg: f64,
    cone_deg: f64,
    refused: usize,
}

fn cell(friction: f64, cohesion: f64, seeds: u64) -> Cell {
    let mut fractions = ParameterSet::default().to_unit();
    (fractions[4], fractions[7]) = (friction, cohesion);
    let set = ParameterSet::from_unit(fractions);
    let heaps: Vec<_> =
        (1..=seeds).filter_map(|seed| repose(&set, &Settings::default(), seed).ok()).collect();
    let n = heaps.len() as f64;
    let tip_deg = heaps.iter().map(|h| h.tip_deg).sum::<f64>() / n;
    Cell {
        friction: set.friction(),
        cohesion: set.cohesion(),
        tip_deg,
        tip_sd_deg: (heaps.iter().map(|h| (h.tip_deg - tip_deg).powi(2)).sum::<f64>() / (n - 1.0))
            .sqrt(),
        cone_deg: heaps.iter().map(|h| h.cone_deg).sum::<f64>() / n,
        refused: seeds as usize - heaps.len(),
    }
}

/// A table of angles, the steeper the darker; friction to the right, cohesion upwards.
fn picture(cells: &[Cell], side: usize) -> String {
    const WIDE: usize = 62;
    const HIGH: usize = 34;
    const LEFT: usize = 70;
    let (right, bottom) = (LEFT + WIDE * side, HIGH * side + 10);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {} {}\" font-family=\"sans-serif\" font-size=\"13\" \
         text-anchor=\"middle\">\n<title>Simulated angle of repose, degrees, over friction and cohesion</title>\n",
        right + 10,
        bottom + 50
    );
    for (k, cell) in cells.iter().enumerate() {
        let (x, y) = (LEFT + WIDE * (k / side), bottom - HIGH * (k % side + 1));
        let shade = ((cell.tip_deg - 20.0) / 35.0).clamp(0.0, 1.0);
        let ink = if shade > 0.5 { "#fff" } else { "#123" };
        let [r, g, b] = [(240.0, 10.0), (246.0, 78.0), (240.0, 72.0)]
            .map(|(light, dark)| light + shade * (dark - light));
        svg += &format!(
            "<rect x=\"{x}\" y=\"{y}\" width=\"{WIDE}\" height=\"{HIGH}\" fill=\"rgb({r:.0},{g:.0},{b:.0})\"/>"
        );
        let (x, y) = (x + WIDE / 2, y + HIGH / 2 + 5);
        svg += &format!("<text x=\"{x}\" y=\"{y}\" fill=\"{ink}\">{:.1}</text>\n", cell.tip_deg);
        if k % side == 0 {
            svg += &format!("<text x=\"{x}\" y=\"{}\">{:.2}</text>\n", bottom + 18, cell.friction);
        }
        if k / side == 0 {
            svg += &format!(
                "<text x=\"{}\" y=\"{y}\" text-anchor=\"end\">{:.2}</text>\n",
                LEFT - 8,
                cell.cohesion
            );
        }
    }
    svg += &format!("<text x=\"{}\" y=\"{}\">friction</text>\n", (LEFT + right) / 2, bottom + 40);
    svg += &format!(
        "<text transform=\"translate(16 {}) rotate(-90)\">cohesion</text>\n</svg>\n",
        bottom / 2
    );
    svg
}

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number =
        |k: usize, default: u64| arguments.get(k).and_then(|a| a.parse().ok()).unwrap_or(default);
    let (side, seeds) = (number(0, 5), number(1, 8));
    let share = |k: u64| k as f64 / (side - 1) as f64;
    let places: Vec<(u64, u64)> = (0..side).flat_map(|f| (0..side).map(move |c| (f, c))).collect();
    let cells: Vec<Cell> =
        places.par_iter().map(|&(f, c)| cell(share(f), share(c), seeds)).collect();
    println!("friction,cohesion,seeds,tip_deg,tip_sd_deg,cone_deg,refused");
    for c in &cells {
        println!(
            "{:.3},{:.3},{seeds},{:.2},{:.2},{:.2},{}",
            c.friction, c.cohesion, c.tip_deg, c.tip_sd_deg, c.cone_deg, c.refused
        );
    }
    if let Some(path) = arguments.get(2) {
        std::fs::write(path, picture(&cells, side as usize))?;
    }
    Ok(())
}
