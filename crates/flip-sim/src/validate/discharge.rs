//! Silos: discharge rate through an orifice, and load on the floor.

use super::super::law::Law;
use super::super::scene::{
    advance, cut, down, fall_time, line, packing_fraction, power_law, rain, settle, top,
};
use super::super::shapes::Silo;
use super::super::walls::{Shape, Wall};
use super::{Check, Experiment, SMOOTH, Suite};
use crate::grains::Grains;
use crate::lanes::{Lanes, Portable, WIDTH};

pub(super) const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "beverloo",
        checks: &["beverloo_exponent", "beverloo_constant", "beverloo_offset", "beverloo_head"],
        run: beverloo,
    },
    Experiment {
        name: "janssen",
        checks: &["janssen_saturation", "janssen_stress_ratio"],
        run: janssen,
    },
];

/// Orifice diameters, grain diameters: from six, below which arches form, to 2/5 of the silo's.
const ORIFICES: [f64; 4] = [6.0, 8.0, 10.0, 12.0];
/// Radius of the discharged silo and filling height (two and a half times the widest orifice),
/// grain diameters.
const RADIUS: f64 = 15.0;
const HEIGHT: f64 = 30.0;
/// Number of beds over which each rate is averaged: with a single bed, 600 grains leave through the
/// narrowest orifice, and the offset is uncertain by 0.1.
const BEDS: u64 = 4;
/// Offset of spheres in the fit of the exponent (Beverloo et al. 1961).
const OFFSET: f64 = 1.4;

/// Beverloo et al. 1961: W = C rho_bulk sqrt(g) (D - k d)^(5/2).
///
/// `C` and `k` come from a line through W^(2/5) over D; the exponent from a power law of D - 1.4 d,
/// because with `k` free it would be the one assumed by the line.
fn beverloo(suite: &Suite) -> Vec<Check> {
    let law = suite.law_of_deep_bed(SMOOTH);
    let full = |grains: &Grains| f64::from(top(grains)) > HEIGHT + 1.0;
    let beds: Vec<Grains> =
        (1..=BEDS).map(|seed| rain(&law, &Silo::closed(RADIUS as f32), 1.0, seed, full)).collect();
    let rate = |orifice: f64, height: f64| {
        let of = |bed: &Grains| {
            let bulk = packing_fraction(bed, RADIUS - 3.0, [3.0, HEIGHT - 4.0]);
            discharge(&law, &cut(&law, bed, height), orifice) / bulk
        };
        beds.iter().map(of).sum::<f64>() / beds.len() as f64
    };
    let rates: Vec<[f64; 2]> =
        ORIFICES.iter().map(|&orifice| [orifice, rate(orifice, HEIGHT)]).collect();
    let [exponent, _] = power_law(&rates.iter().map(|[d, w]| [d - OFFSET, *w]).collect::<Vec<_>>());
    let [slope, at_zero] = line(&rates.iter().map(|[d, w]| [*d, w.powf(0.4)]).collect::<Vec<_>>());
    let head = rate(ORIFICES[1], 0.5 * HEIGHT) / rates[1][1] - 1.0;
    let source = "Beverloo et al. 1961: W = C rho sqrt(g) (D - k d)^(5/2)";
    vec![
        Check::within("beverloo_exponent", exponent, [2.2, 2.8], "", source),
        Check::within("beverloo_constant", slope.powf(2.5), [0.55, 0.65], "", source),
        Check::within("beverloo_offset", -at_zero / slope, [1.2, 1.6], "d", source),
        Check::near(
            "beverloo_head",
            head * 100.0,
            [0.0, 10.0],
            "%",
            "Beverloo et al. 1961: half the filling, same rate",
        ),
    ]
}

/// Volume of grains, d^3, that leaves through an orifice in the time sqrt(d / g), once the flow is
/// steady.
fn discharge(law: &Law, bed: &Grains, orifice: f64) -> f64 {
    const LOOK: u32 = 8;
    let silo = Silo { orifice: 0.5 * orifice as f32, ..Silo::closed(RADIUS as f32) };
    let mut grains = bed.clone();
    let mut left_after = |time: f64| {
        let steps = (time * fall_time(law)) as u32 / LOOK * LOOK;
        let before = grains.centres().len();
        for _ in 0..steps / LOOK {
            advance(&mut grains, law, down(law), &Shape::Silo(silo), LOOK);
            grains.take_departed(&Shape::Silo(silo));
        }
        (before - grains.centres().len()) as f64 / f64::from(steps)
    };
    left_after(10.0);
    left_after(20.0) * fall_time(law) * std::f64::consts::PI / 6.0
}

/// Radius of Janssen's column, grain diameters.
const COLUMN: f64 = 6.0;
/// Filling heights of Janssen's column, grain diameters.
const FILLINGS: [f64; 7] = [3.0, 6.0, 9.0, 14.0, 20.0, 30.0, 45.0];

/// Janssen 1895: the share of a filling m borne by the floor saturates, m_app = c m_sat (1 - exp(-m
/// / m_sat)) with m_sat = rho pi R^3 / (2 mu K).
///
/// Each filling is rained in. The floor then sinks by a fifth of a diameter, which mobilises the
/// wall's friction upwards, and the load is averaged over the second half of that motion (Vanel and
/// Clement 1999, Eur. Phys. J. B 11, 525). The load is the push of the floor and the groove; `c`,
/// below one, accounts for the friction of the groove, which is not measured.
fn janssen(suite: &Suite) -> Vec<Check> {
    let law = suite.law_of_deep_bed(SMOOTH);
    let loads: Vec<[f64; 2]> = FILLINGS.iter().map(|&height| floor_load(&law, height)).collect();
    let shape = |m: f64, saturated: f64| 1.0 - (-m / saturated).exp();
    let error = |saturated: f64| -> f64 {
        let [up, down] = loads.iter().fold([0.0; 2], |[up, down], &[m, load]| {
            [up + load * shape(m, saturated), down + shape(m, saturated).powi(2)]
        });
        loads.iter().map(|&[m, load]| (load - up / down * shape(m, saturated)).powi(2)).sum()
    };
    let saturated = least(&error, [10.0, 10_000.0]);
    let mean = loads.iter().map(|load| load[1]).sum::<f64>() / loads.len() as f64;
    let spread: f64 = loads.iter().map(|load| (load[1] - mean).powi(2)).sum();
    // m_sat in grains, with a packing fraction of 0.6 in the bulk: K to a few percent.
    let stress_ratio = 0.6 * 6.0 * COLUMN.powi(3) / (2.0 * SMOOTH * saturated);
    vec![
        Check::near(
            "janssen_saturation",
            1.0 - error(saturated) / spread,
            [1.0, 0.02],
            "R2",
            "Janssen 1895",
        ),
        Check::within(
            "janssen_stress_ratio",
            stress_ratio,
            [0.4, 0.9],
            "",
            "Janssen 1895: K of granular matter",
        ),
    ]
}

/// Number of grains filled in, and the load on the floor in grain weights.
pub(super) fn floor_load(law: &Law, height: f64) -> [f64; 2] {
    const SINK: f32 = 0.2;
    const STEPS: u16 = 4000;
    let mut silo = Silo::closed(COLUMN as f32);
    let mut grains = rain(law, &silo, 0.4, height as u64, |grains| f64::from(top(grains)) > height);
    settle(&mut grains, law, down(law), &Shape::Silo(silo), 2000);
    let mut load = 0.0;
    for step in 1..=STEPS {
        silo.floor = -SINK * f32::from(step) / f32::from(STEPS);
        grains.substep(law, down(law), &Shape::Silo(silo));
        if step > STEPS / 2 && step % 20 == 0 {
            load += lift(law, &grains, &silo) / f64::from(law.gravity) / f64::from(STEPS / 2 / 20);
        }
    }
    [grains.centres().len() as f64, load]
}

/// Upward push of the floor and the groove on the grains, diameters per substep squared, as the
/// next substep will compute it. The side is vertical; its friction, which carries the rest of the
/// weight, is not included.
fn lift(law: &Law, grains: &Grains, silo: &Silo) -> f64 {
    let mut sum = 0.0;
    for (x, v) in grains.centres().iter().zip(grains.velocities()) {
        if x[2] > silo.floor + 1.0 {
            continue;
        }
        let u = [v[0], v[1], v[2] - law.gravity];
        let touch = silo.touch([x[0] + u[0], x[1] + u[1], x[2] + u[2]].map(Portable::splat));
        let (gap, normal) = (first(touch.gap) - law.wall.onset, touch.normal.map(first));
        if gap < 0.0 {
            let opening = u[0] * normal[0] + u[1] * normal[1] + u[2] * normal[2];
            let damping = law.wall.normal_damping / v[3].max(1.0).sqrt();
            sum += f64::from((-law.wall.normal * gap - damping * opening).max(0.0) * normal[2]);
        }
    }
    sum
}

fn first(lanes: Portable) -> f32 {
    let mut all = [0.0; WIDTH];
    lanes.store(&mut all);
    all[0]
}

/// Minimum of a function with a single minimum, by golden-section search.
fn least(of: &impl Fn(f64) -> f64, [mut low, mut high]: [f64; 2]) -> f64 {
    let golden = 0.5 * (5.0f64.sqrt() - 1.0);
    for _ in 0..80 {
        let (a, b) = (high - golden * (high - low), low + golden * (high - low));
        if of(a) < of(b) {
            high = b;
        } else {
            low = a;
        }
    }
    0.5 * (low + high)
}
