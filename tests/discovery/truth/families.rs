//! The hidden effect of each family: laboratories drawn until the effect can be distinguished from
//! everything else recorded.

use super::Family;
use super::effect::{Curve, Factor, Shape, Term};
use super::laboratory::{
    COLUMNS, Climate, Habits, Kind, Laboratory, Noise, PUBLISHED, Powder, Run, Tie, Truth, Value,
    column, mean, percentile, stream,
};
use rand::RngExt;
use rand_pcg::Pcg64;
use std::collections::BTreeMap;

const HUMIDITY: &str = "relative_humidity_pct";
const TEMPERATURE: &str = "temperature_c";
const REST: &str = "rest_min";
const AGE: &str = "container_age_d";
const ORDER: &str = "order_in_session";

/// Laboratories drawn before giving up on a family.
const DRAWS: usize = 400;
/// Largest effect on a run over the size: an effect that rests on only a run or two cannot be
/// found.
const PEAK_MAX: f64 = 3.5;
const PEAK_MAX_WILD: f64 = 6.0;
/// Least SD of a factor in the campaign, which goes from 0 to 1 over the range of a curve, and from
/// -1 to 1 over names: a factor that hardly moved would be blown up without bound on other days.
const MOVED_MIN: f64 = 0.1;
const MOVED_MIN_NAMES: f64 = 0.3;
/// Largest share of an effect's variance within a powder that another recorded column may explain;
/// above it, that column would be an equally right answer.
const SHARED_MAX: f64 = 0.5;
const SHARED_MAX_WILD: f64 = 0.9;
/// Correlations of covariates that went together.
const TIED: [f64; 2] = [0.955, 0.998];

/// A laboratory of this family.
///
/// # Panics
/// None of [`DRAWS`] will do.
pub fn draw(family: Family, size_deg: f64, seed: u64) -> Laboratory {
    let proposals = (0..DRAWS).map(|attempt| {
        let mut rng = stream(seed, family.name(), attempt);
        let mut laboratory = proposed(family, size_deg, &mut rng);
        let will_do = settled(&mut laboratory, family == Family::Wild);
        (laboratory, will_do)
    });
    let found = proposals.filter(|(_, will_do)| *will_do).map(|(laboratory, _)| laboratory).next();
    found.unwrap_or_else(|| panic!("{} shows in no laboratory", family.name()))
}

fn proposed(family: Family, size_deg: f64, rng: &mut Pcg64) -> Laboratory {
    if family == Family::Wild {
        return wild(rng);
    }
    let mut new = laboratory(rng);
    new.truth.family = family.name();
    match family {
        Family::NullPlain => {}
        Family::NullOutliers => new.noise.outliers = rng.random_range(0.03..0.06),
        Family::NullMissing => new.missing = rng.random_range(0.2..0.4),
        Family::NullDays => new.noise.day_deg = 1.2,
        Family::NullRestless => {
            new.noise.day_deg = 2.5;
            (new.days, new.repeats) = (4, 3);
            (new.habits.operator_daily, new.habits.plate_daily) = (true, true);
            let columns =
                [HUMIDITY, TEMPERATURE, AGE, "pressure_hpa", "supply_v", "operator", "plate"];
            columns.into_iter().for_each(|name| record(&mut new, name));
        }
        Family::NullConfounded => tie(&mut new, &[HUMIDITY, TEMPERATURE, AGE], rng),
        Family::NullScatter => {
            let columns = [HUMIDITY, REST, "vibration_rms_m_s2", ORDER, "operator"];
            let name = one(columns.to_vec(), rng);
            record(&mut new, name);
            let factor = match name {
                "operator" => Factor::Is { column: "operator", name: "Ada" },
                name => Factor::number(name, Shape::Power { p: 0.7 }),
            };
            new.noise.scatter = Some((factor, sign(rng) * rng.random_range(1.0..2.0)));
        }
        Family::TwoCauses => {
            let pair = two_that_differ(rng);
            pair.iter().for_each(|single| add(&mut new, *single, rng));
            new.truth.mechanisms = pair.iter().map(|single| single.name()).collect();
            new.truth.covariate = Some(new.terms[0].factors[0].column());
        }
        Family::Confounded => {
            let others = vec![
                (Family::ContainerAge, AGE),
                (Family::Temperature, TEMPERATURE),
                (Family::RestTime, REST),
            ];
            let (other, name) = one(others, rng);
            tie(&mut new, &[HUMIDITY, name], rng);
            if name != AGE {
                new.recorded.retain(|recorded| *recorded != AGE);
            }
            let both =
                if rng.random() { [Family::Humidity, other] } else { [other, Family::Humidity] };
            single(&mut new, both[0], rng);
            new.truth.rivals = vec![both[1].name()];
        }
        Family::Recorded => outside(&mut new, rng),
        Family::Unrecorded => {
            let days = new.days as f64;
            // The axis spans three campaigns, because the wander does not end with the first.
            let curve: Curve = match rng.random_range(0..4u32) {
                0 => Shape::knots(3 * new.days / rng.random_range(4..8u64) as usize, rng).into(),
                1 => Shape::Wave {
                    cycles: 3.0 * days / rng.random_range(9.0..22.0),
                    phase: rng.random(),
                }
                .into(),
                2 => Shape::Step { at: rng.random_range(0.1..0.24) }.into(),
                _ => {
                    let change = Shape::Broken {
                        knee: rng.random_range(0.08..0.2),
                        before: 0.0,
                        after: 1.0,
                    };
                    Curve::of(vec![
                        change,
                        Shape::Stretched { time: rng.random_range(0.02..0.1), p: 1.5 },
                    ])
                }
            };
            let susceptibility =
                some(&new, &[Pattern::Alike, Pattern::Graded, Pattern::Mixed], 1.0, rng);
            new.terms = vec![Term::new(susceptibility, vec![Factor::number("day", curve)])];
            if let Factor::Number { to, .. } = &mut new.terms[0].factors[0] {
                *to = 3.0 * days;
            }
            new.truth.also_right = vec!["unrecorded"];
        }
        cause => single(&mut new, cause, rng),
    }
    new.truth.size_deg = if new.terms.is_empty() { 0.0 } else { size_deg };
    new
}

/// The suite's default campaign.
fn laboratory(rng: &mut Pcg64) -> Laboratory {
    let powder = |&(name, mean_deg, repeat_sd_deg, hygroscopic, flow_s): &(&str, _, _, _, _)| {
        Powder { name: name.to_owned(), mean_deg, repeat_sd_deg, hygroscopic, flow_s }
    };
    let recorded: Vec<&str> = COLUMNS
        .iter()
        .filter(|column| rng.random_bool(column.chance))
        .map(|column| column.name)
        .collect();
    let times = vec![
        vec![1.0, 5.0, 15.0, 60.0, 240.0],
        vec![2.0, 10.0, 30.0, 120.0],
        vec![0.0, 20.0, 90.0, 180.0],
    ];
    let heights = [
        vec![45.0, 60.0, 75.0],
        vec![40.0, 50.0, 60.0, 80.0],
        (35..=95).step_by(5).map(f64::from).collect(),
    ];
    let rest_is_free = rng.random_bool(0.3);
    let climate = Climate {
        humidity_pct: [rng.random_range(25.0..35.0), rng.random_range(64.0..75.0)],
        persistence: one(vec![0.0, 0.4, 0.75], rng),
        season: one(vec![0.0, 0.0, 0.5], rng),
        period_d: rng.random_range(35.0..120.0),
        phase: rng.random(),
        wander_pct: rng.random_range(0.5..5.0),
        warm_when_humid: rng.random_range(-0.2..0.6),
        temperature_sd_c: rng.random_range(1.2..2.5),
    };
    let habits = Habits {
        rest_min: if rest_is_free { vec![1.0, 300.0] } else { one(times, rng) },
        rest_is_free,
        heights_mm: one(heights.to_vec(), rng),
        shared_containers: rng.random_bool(0.3),
        renewal: rng.random_range(0.05..0.12),
        parallel_batches: rng.random(),
        operators: rng.random_range(2..4u32) as usize,
        operator_daily: rng.random_bool(0.6),
        plates: rng.random_range(2..4u32) as usize,
        plate_daily: rng.random_bool(0.3),
        camera: rng.random_range(0.35..0.65),
        // Off if not recorded.
        ioniser: if recorded.contains(&"ioniser_on") { 0.3 } else { 0.0 },
        first_day: rng.random_bool(0.6).then(|| 19_723 + 7 * rng.random_range(0..120i64) - 3),
    };
    Laboratory {
        seed: rng.random(),
        powders: PUBLISHED.iter().map(powder).collect(),
        days: 20,
        repeats: 2,
        climate,
        habits,
        tie: None,
        noise: Noise {
            day_deg: 0.5,
            day_powder_deg: 0.4,
            kind: Kind::Normal,
            outliers: 0.0,
            scatter: None,
        },
        recorded,
        missing: if rng.random() { rng.random_range(0.0..0.04) } else { 0.0 },
        terms: Vec::new(),
        truth: Truth::default(),
    }
}

fn record(laboratory: &mut Laboratory, name: &'static str) {
    if !laboratory.recorded.contains(&name) {
        laboratory.recorded.push(name);
    }
}

/// Makes columns move together from day to day.
fn tie(laboratory: &mut Laboratory, columns: &[&'static str], rng: &mut Pcg64) {
    columns.iter().for_each(|name| record(laboratory, name));
    laboratory.climate.wander_pct = 0.0;
    laboratory.tie = Some(Tie {
        columns: columns.to_vec(),
        period_d: rng.random_range(26..31u32) as usize,
        jitter: rng.random_range(0.02..0.05),
    });
}

/// How powders differ in susceptibility.
#[derive(Clone, Copy)]
enum Pattern {
    /// By a quarter.
    Alike,
    /// By a factor of up to five.
    Graded,
    /// About three of five feel it.
    Some,
    /// Those that take up water feel it most.
    Hygroscopic,
    /// Those that take up water feel it least.
    Dry,
    /// The more, the flatter the heap.
    Flat,
    /// Sugar and salt alone.
    Soluble,
    /// Some one way, some the other.
    Mixed,
}

/// One of these patterns, with this sign.
fn some(
    laboratory: &Laboratory,
    patterns: &[Pattern],
    sign_of_all: f64,
    rng: &mut Pcg64,
) -> Vec<f64> {
    let count = laboratory.powders.len();
    let pattern = one(patterns.to_vec(), rng);
    let mut places: Vec<usize> = (0..count).collect();
    (1..count).rev().for_each(|k| places.swap(k, rng.random_range(0..=k as u64) as usize));
    let felt_by = (3 * count).div_ceil(5).max(2);
    let mut of = |powder: &Powder, place: usize| match pattern {
        Pattern::Alike => rng.random_range(0.75..1.25),
        Pattern::Graded => rng.random_range(0.35..1.7),
        Pattern::Some => f64::from(place < felt_by) * rng.random_range(0.7..1.3),
        Pattern::Hygroscopic if powder.hygroscopic => rng.random_range(0.9..1.5),
        Pattern::Dry if !powder.hygroscopic => rng.random_range(0.9..1.5),
        Pattern::Hygroscopic | Pattern::Dry => rng.random_range(0.1..0.5),
        Pattern::Flat => (35.0 / powder.mean_deg).powi(2) * rng.random_range(0.9..1.1),
        Pattern::Soluble => {
            f64::from(["sugar", "salt"].contains(&powder.name.as_str()))
                * rng.random_range(0.8..1.2)
        }
        Pattern::Mixed => rng.random_range(0.5..1.4) * if place < felt_by { 1.0 } else { -1.0 },
    };
    laboratory
        .powders
        .iter()
        .zip(places)
        .map(|(powder, place)| sign_of_all * of(powder, place))
        .collect()
}

/// Adds a cause of the catalogue, and its name.
fn single(laboratory: &mut Laboratory, cause: Family, rng: &mut Pcg64) {
    add(laboratory, cause, rng);
    laboratory.truth.mechanism = Some(cause.name());
    laboratory.truth.mechanisms = vec![cause.name()];
    laboratory.truth.covariate = Some(laboratory.terms[0].factors[0].column());
}

/// Adds a cause of the catalogue in one of at least three forms, and records the columns needed to
/// see it.
fn add(laboratory: &mut Laboratory, cause: Family, rng: &mut Pcg64) {
    let (patterns, sign_of_all, factors): (&[Pattern], f64, Vec<Factor>) = match cause {
        Family::Humidity => {
            let shapes = vec![
                Shape::Bet { c: rng.random_range(3.0..40.0) },
                Shape::Smoothstep {
                    from: rng.random_range(0.1..0.3),
                    to: rng.random_range(0.6..0.85),
                },
                Shape::ShiftedRoot { knee: rng.random_range(0.1..0.4) },
                Shape::TanhPower {
                    half: rng.random_range(0.4..0.7),
                    p: rng.random_range(1.6..3.5),
                },
                Shape::Broken {
                    knee: rng.random_range(0.25..0.5),
                    before: rng.random_range(0.0..0.3),
                    after: 1.0,
                },
            ];
            let patterns = &[Pattern::Graded, Pattern::Hygroscopic, Pattern::Some];
            (patterns, 1.0, vec![Factor::number(HUMIDITY, one(shapes, rng))])
        }
        Family::Deliquescence => {
            laboratory.climate.humidity_pct =
                [rng.random_range(35.0..45.0), rng.random_range(80.0..90.0)];
            let (at, width) =
                ((rng.random_range(60.0..80.0) - 20.0) / 70.0, rng.random_range(0.015..0.05));
            let shapes = vec![
                Shape::Smoothstep { from: at - width, to: at + width },
                Shape::Arctan { centre: at, width: width / 3.0 },
                Shape::Hill { half: at, n: 1.2 / width },
                Shape::TanhPower { half: at, p: 0.8 / width },
            ];
            (&[Pattern::Soluble], 1.0, vec![Factor::number(HUMIDITY, one(shapes, rng))])
        }
        Family::RestTime => {
            let knee = rng.random_range(0.3..0.6);
            let factors = vec![
                Factor::number(REST, Shape::Hill { half: rng.random_range(0.03..0.3), n: 1.0 }),
                Factor::number(
                    REST,
                    Shape::Hill { half: rng.random_range(0.1..0.3), n: rng.random_range(1.5..2.5) },
                ),
                Factor::number(REST, stretched(0.05..0.3, rng)),
                Factor::number(
                    REST,
                    Shape::Arctan { centre: 0.0, width: rng.random_range(0.05..0.3) },
                ),
                Factor::logarithm(
                    REST,
                    Shape::Broken { knee, before: rng.random_range(0.0..0.3), after: 1.0 },
                ),
                Factor::logarithm(REST, Shape::Smoothstep { from: knee - 0.25, to: knee + 0.35 }),
            ];
            (&[Pattern::Alike, Pattern::Graded, Pattern::Some], 1.0, vec![one(factors, rng)])
        }
        Family::HumidAgeing => {
            let humid = vec![
                Shape::ShiftedRoot { knee: rng.random_range(0.1..0.3) },
                Shape::Smoothstep {
                    from: rng.random_range(0.05..0.2),
                    to: rng.random_range(0.7..0.9),
                },
                Shape::Bet { c: rng.random_range(2.0..20.0) },
            ];
            let rested = vec![
                Shape::Hill { half: rng.random_range(0.05..0.4), n: 1.0 },
                Shape::Arctan { centre: 0.0, width: rng.random_range(0.05..0.4) },
                stretched(0.1..0.4, rng),
            ];
            let factors = vec![
                Factor::number(HUMIDITY, one(humid, rng)),
                Factor::number(REST, one(rested, rng)),
            ];
            (&[Pattern::Graded, Pattern::Hygroscopic], 1.0, factors)
        }
        Family::ContainerAge => {
            let knee = rng.random_range(0.1..0.35);
            let shapes = vec![
                Shape::Hill { half: rng.random_range(0.1..0.5), n: rng.random_range(1.0..2.0) },
                Shape::Arctan { centre: knee, width: rng.random_range(0.05..0.3) },
                Shape::Smoothstep { from: 0.0, to: rng.random_range(0.4..0.9) },
                Shape::Broken { knee, before: 1.0, after: rng.random_range(0.0..0.3) },
                stretched(0.1..0.5, rng),
            ];
            let patterns = &[Pattern::Alike, Pattern::Graded, Pattern::Hygroscopic, Pattern::Mixed];
            (patterns, 1.0, vec![Factor::number(AGE, one(shapes, rng))])
        }
        Family::Charge => {
            laboratory.climate.humidity_pct =
                [rng.random_range(20.0..26.0), rng.random_range(58.0..68.0)];
            let shapes = vec![
                Shape::Smoothstep { from: 0.0, to: rng.random_range(0.6..1.0) },
                Shape::TanhPower {
                    half: rng.random_range(0.3..0.7),
                    p: rng.random_range(1.2..2.5),
                },
                Shape::Hill { half: rng.random_range(0.2..0.6), n: rng.random_range(1.2..3.0) },
                Shape::ShiftedRoot { knee: rng.random_range(0.0..0.2) },
            ];
            let curve = one(shapes, rng).into();
            let from = rng.random_range(40.0..47.0);
            let dryness =
                Factor::Number { column: HUMIDITY, from, to: 18.0, log: false, floor: 0.0, curve };
            (
                &[Pattern::Alike, Pattern::Graded, Pattern::Dry],
                1.0,
                vec![dryness, Factor::without_ioniser()],
            )
        }
        Family::Temperature => {
            laboratory.climate.temperature_sd_c = rng.random_range(1.8..2.6);
            let shapes = vec![
                Shape::Broken {
                    knee: rng.random_range(0.35..0.55),
                    before: rng.random_range(0.0..0.3),
                    after: 1.0,
                },
                Shape::Smoothstep {
                    from: rng.random_range(0.0..0.3),
                    to: rng.random_range(0.6..1.0),
                },
                Shape::Arctan {
                    centre: rng.random_range(0.35..0.55),
                    width: rng.random_range(0.05..0.2),
                },
                Shape::TanhPower {
                    half: rng.random_range(0.4..0.7),
                    p: rng.random_range(1.5..4.0),
                },
            ];
            let patterns = &[Pattern::Alike, Pattern::Graded, Pattern::Some, Pattern::Mixed];
            (patterns, 1.0, vec![Factor::number(TEMPERATURE, one(shapes, rng))])
        }
        Family::Vibration => {
            let name = "vibration_rms_m_s2";
            let factors = vec![
                Factor::number(name, Shape::Hill { half: rng.random_range(0.05..0.2), n: 1.0 }),
                Factor::number(
                    name,
                    Shape::Arctan { centre: 0.0, width: rng.random_range(0.05..0.3) },
                ),
                Factor::number(name, Shape::ShiftedRoot { knee: rng.random_range(0.01..0.1) }),
                Factor::number(name, Shape::TanhPower { half: 0.2, p: rng.random_range(0.6..1.6) }),
                Factor::logarithm(
                    name,
                    Shape::Broken { knee: rng.random_range(0.3..0.5), before: 0.1, after: 1.0 },
                ),
            ];
            (&[Pattern::Alike, Pattern::Graded, Pattern::Flat], -1.0, vec![one(factors, rng)])
        }
        Family::FunnelHeight => {
            let shapes = vec![
                Shape::Arctan {
                    centre: rng.random_range(0.1..0.5),
                    width: rng.random_range(0.1..0.4),
                },
                Shape::Hill { half: rng.random_range(0.3..0.6), n: rng.random_range(1.5..3.0) },
                Shape::Broken {
                    knee: rng.random_range(0.3..0.5),
                    before: 1.0,
                    after: rng.random_range(0.2..0.5),
                },
                Shape::Smoothstep {
                    from: rng.random_range(0.0..0.2),
                    to: rng.random_range(0.6..1.0),
                },
            ];
            let patterns = &[Pattern::Alike, Pattern::Graded, Pattern::Flat];
            (patterns, -1.0, vec![Factor::number("funnel_height_mm", one(shapes, rng))])
        }
        Family::Order => {
            let shapes = vec![
                Shape::Hill { half: rng.random_range(0.1..0.5), n: rng.random_range(1.0..2.5) },
                Shape::Arctan {
                    centre: rng.random_range(0.0..0.5),
                    width: rng.random_range(0.1..0.3),
                },
                Shape::Broken {
                    knee: rng.random_range(0.3..0.6),
                    before: 1.0,
                    after: rng.random_range(0.0..0.3),
                },
                stretched(0.1..0.5, rng),
            ];
            let factor = course(laboratory, one(shapes, rng), 0.0);
            (&[Pattern::Alike, Pattern::Graded, Pattern::Mixed], sign(rng), vec![factor])
        }
        Family::Batch => {
            let form = rng.random_range(0..3u32);
            laboratory.habits.parallel_batches = form > 0;
            // Each powder has its own lots; both jars of a powder differ in its own way; or fine
            // grains in one of them, which come out last.
            let level = Factor::Level { column: "batch", by_powder: form < 2, seed: rng.random() };
            let late = Shape::Smoothstep { from: 0.0, to: 1.0 };
            let factors =
                if form < 2 { vec![level] } else { vec![level, course(laboratory, late, 0.4)] };
            (&[Pattern::Alike, Pattern::Graded], 1.0, factors)
        }
        Family::MethodBias => {
            (&[Pattern::Alike], sign(rng), vec![Factor::Is { column: "method", name: "camera" }])
        }
        Family::Operator => {
            let level = Factor::Level { column: "operator", by_powder: false, seed: rng.random() };
            // Some operators grow careless in the course of a session.
            let tired = Shape::Hill { half: 0.5, n: 2.0 };
            let factors = if rng.random_bool(0.35) {
                vec![level, course(laboratory, tired, 0.4)]
            } else {
                vec![level]
            };
            (&[Pattern::Alike, Pattern::Graded, Pattern::Flat], 1.0, factors)
        }
        Family::BaseFriction => {
            let level = Factor::Level { column: "plate", by_powder: false, seed: rng.random() };
            (&[Pattern::Alike, Pattern::Flat, Pattern::Some], 1.0, vec![level])
        }
        other => unreachable!("{other:?} is no single cause"),
    };
    let mut susceptibility = some(laboratory, patterns, sign_of_all, rng);
    if cause == Family::MethodBias {
        // The camera is off by the same everywhere, by more on steep heaps in two ways, or too high
        // on flat ones and too low on steep ones.
        let form = rng.random_range(0..4u32);
        for (felt, powder) in susceptibility.iter_mut().zip(&laboratory.powders) {
            *felt *= match form {
                0 => 1.0,
                1 => ((powder.mean_deg - 18.0) / 20.0).powi(2),
                2 => (powder.mean_deg - 24.0).max(0.0).sqrt() / 4.0,
                _ => ((powder.mean_deg - 34.0) / 4.0).tanh(),
            };
        }
    }
    // An unrecorded ioniser is off.
    factors
        .iter()
        .map(Factor::column)
        .filter(|name| *name != "ioniser_on")
        .for_each(|name| record(laboratory, name));
    laboratory.terms.push(Term::new(susceptibility, factors));
}

fn stretched(time: std::ops::Range<f64>, rng: &mut Pcg64) -> Shape {
    Shape::Stretched { time: rng.random_range(time), p: rng.random_range(0.4..0.7) }
}

/// A curve over the session.
fn course(laboratory: &Laboratory, shape: Shape, floor: f64) -> Factor {
    let to = (laboratory.powders.len() * laboratory.repeats) as f64;
    Factor::Number { column: ORDER, from: 1.0, to, log: false, floor, curve: shape.into() }
}

/// Two single causes that share no covariate and were not mistaken for each other.
fn two_that_differ(rng: &mut Pcg64) -> [Family; 2] {
    let moisture = [Family::Humidity, Family::Deliquescence, Family::HumidAgeing, Family::Charge];
    let slow = [Family::Humidity, Family::Deliquescence, Family::ContainerAge, Family::Temperature];
    let session = [Family::Operator, Family::Order];
    let resting = [Family::RestTime, Family::HumidAgeing];
    let supply = [Family::Batch, Family::ContainerAge];
    loop {
        let pair = [one(Family::SINGLES.to_vec(), rng), one(Family::SINGLES.to_vec(), rng)];
        let alike = |group: &[Family]| pair.iter().all(|cause| group.contains(cause));
        if pair[0] != pair[1]
            && !alike(&moisture)
            && !alike(&slow)
            && !alike(&session)
            && !alike(&resting)
            && !alike(&supply)
        {
            return pair;
        }
    }
}

/// Adds an effect of a column without a mechanism.
fn outside(laboratory: &mut Laboratory, rng: &mut Pcg64) {
    let columns =
        vec!["pressure_hpa", "hour_of_day", "lamp_nm", "noise_db", "supply_v", "balance_room_lux"];
    let name = one(columns, rng);
    let forms = vec!["linear", "power", "threshold", "saturating", "periodic", "smooth"];
    let form = one(forms, rng);
    let at = rng.random_range(0.35..0.65);
    let shapes = match form {
        "linear" => vec![Shape::Power { p: 1.0 }],
        "power" => {
            vec![
                Shape::Power { p: rng.random_range(0.3..0.5) },
                Shape::Power { p: rng.random_range(2.0..3.5) },
            ]
        }
        "threshold" => {
            vec![Shape::Step { at }, Shape::Smoothstep { from: at - 0.04, to: at + 0.04 }]
        }
        "saturating" => {
            vec![
                Shape::Hill { half: rng.random_range(0.08..0.2), n: 1.0 },
                Shape::Exp { k: rng.random_range(-9.0..-4.0) },
            ]
        }
        "periodic" => vec![Shape::Wave { cycles: rng.random_range(1.0..2.0), phase: rng.random() }],
        _ => vec![
            Shape::knots(5, rng),
            Shape::Bump { centre: at, width: rng.random_range(0.15..0.3) },
        ],
    };
    let factor = Factor::number(name, one(shapes, rng));
    let susceptibility =
        some(laboratory, &[Pattern::Alike, Pattern::Graded, Pattern::Some], sign(rng), rng);
    record(laboratory, name);
    laboratory.terms = vec![Term::new(susceptibility, vec![factor])];
    laboratory.truth.covariate = Some(name);
    laboratory.truth.form_class = Some(form);
}

/// Any laboratory with any effect.
fn wild(rng: &mut Pcg64) -> Laboratory {
    let mut new = laboratory(rng);
    let strangers = [
        "lactose_m200",
        "mcc_ph102",
        "talc",
        "titania_p25",
        "maize_starch",
        "kaolin",
        "milk_powder",
        "glass_beads_100",
        "citric_acid",
        "cocoa",
    ];
    let mut powders: Vec<Powder> = new.powders.clone();
    powders.extend(strangers.map(|name| Powder {
        name: name.to_owned(),
        mean_deg: rng.random_range(25.0..50.0),
        repeat_sd_deg: rng.random_range(1.0..3.0),
        hygroscopic: rng.random(),
        flow_s: rng.random_range(3.0..12.0),
    }));
    let count = rng.random_range(3..9u32) as usize;
    new.powders = (0..count)
        .map(|_| powders.swap_remove(rng.random_range(0..powders.len() as u64) as usize))
        .collect();
    new.days = rng.random_range(12..41u32) as usize;
    new.repeats = rng.random_range(1..4u32) as usize;
    new.missing = rng.random_range(0.0..0.15);
    new.noise = Noise {
        day_deg: rng.random_range(0.2..1.0),
        day_powder_deg: rng.random_range(0.1..0.7),
        kind: one(vec![Kind::Normal, Kind::HeavyTails, Kind::Skewed(1.0), Kind::Skewed(-1.0)], rng),
        outliers: if rng.random_bool(0.2) { 0.02 } else { 0.0 },
        scatter: None,
    };
    new.truth.family = Family::Wild.name();
    let columns: Vec<&'static str> =
        new.recorded.iter().copied().filter(|name| *name != "flow_time_s").collect();
    let causes = [0, 1, 1, 1, 1, 1, 2, 2][rng.random_range(0..8u32) as usize];
    if columns.is_empty() || causes == 0 {
        return new;
    }
    let runs = new.campaign();
    for _ in 0..causes {
        let first = one(columns.clone(), rng);
        let mut factors = vec![any_factor(&runs, first, 0.0, rng)];
        let second = one(columns.clone(), rng);
        if second != first && rng.random_bool(0.2) {
            let floor = rng.random_range(0.0..0.6);
            factors.push(any_factor(&runs, second, floor, rng));
        }
        let patterns =
            [Pattern::Alike, Pattern::Graded, Pattern::Some, Pattern::Hygroscopic, Pattern::Mixed];
        let susceptibility = some(&new, &patterns, sign(rng), rng);
        new.terms.push(Term::new(susceptibility, factors));
    }
    let first = new.terms[0].factors[0].column();
    new.truth.covariate = Some(first);
    new.truth.also_right = column(first).causes.to_vec();
    // 0.35 to 1.6 deg, small ones as often as large ones.
    new.truth.size_deg = 0.35 * (1.6f64 / 0.35).powf(rng.random());
    new
}

/// Up to three chained shapes over the column's actual range; names have levels.
fn any_factor(runs: &[Run], name: &'static str, floor: f64, rng: &mut Pcg64) -> Factor {
    let Some(numbers) = numbers(runs, name) else {
        return Factor::Level { column: name, by_powder: rng.random_bool(0.3), seed: rng.random() };
    };
    let [from, to] = [0.01, 0.99].map(|share| percentile(&numbers, share));
    let curve = Curve::of((0..rng.random_range(1..4u32)).map(|_| Shape::any(rng)).collect());
    Factor::Number { column: name, from, to: to.max(from + 1e-3), log: false, floor, curve }
}

/// Scales each cause to its size in the campaign. False if the effect could not be distinguished
/// from something else recorded, or not be found.
fn settled(laboratory: &mut Laboratory, wild: bool) -> bool {
    let runs = laboratory.campaign();
    let (peak_max, shared_max) =
        if wild { (PEAK_MAX_WILD, SHARED_MAX_WILD) } else { (PEAK_MAX, SHARED_MAX) };
    let mut effects: Vec<Vec<f64>> = Vec::new();
    for k in 0..laboratory.terms.len() {
        let raw: Vec<f64> = runs.iter().map(|run| laboratory.terms[k].at(run)).collect();
        let within = within_powders(&runs, &raw);
        let sd = mean(&within.iter().map(|x| x * x).collect::<Vec<_>>()).sqrt();
        let felt =
            mean(&laboratory.terms[k].susceptibility.iter().map(|s| s * s).collect::<Vec<_>>())
                .sqrt();
        let names = matches!(laboratory.terms[k].factors[0], Factor::Level { .. });
        if sd.is_nan() || sd < felt * if names { MOVED_MIN_NAMES } else { MOVED_MIN } {
            return false;
        }
        let size_deg = laboratory.truth.size_deg;
        let of_powder = |powder: usize| {
            let mine = runs.iter().zip(&raw).filter(|(run, _)| run.powder == powder);
            mean(&mine.map(|(_, x)| *x).collect::<Vec<_>>())
        };
        laboratory.terms[k].centre = (0..laboratory.powders.len()).map(of_powder).collect();
        laboratory.terms[k].scale = size_deg / sd;
        if within.iter().any(|x| x.abs() > peak_max * sd) {
            return false;
        }
        let own: Vec<&str> = laboratory.terms[k].factors.iter().map(Factor::column).collect();
        let tied: &[&str] = laboratory.tie.as_ref().map_or(&[], |tie| &tie.columns);
        let mut others =
            laboratory.recorded.iter().filter(|name| !own.contains(name) && !tied.contains(name));
        if others.any(|name| explained(&runs, &within, name) > shared_max) {
            return false;
        }
        effects.push(within);
    }
    if let [first, second] = &effects[..]
        && correlation(first, second).abs() > 0.4
    {
        return false;
    }
    let Some(tie) = &laboratory.tie else { return true };
    let columns: Vec<Vec<f64>> =
        tie.columns.iter().filter_map(|name| numbers(&runs, name)).collect();
    columns.windows(2).all(|pair| {
        let r = correlation(&pair[0], &pair[1]).abs();
        TIED[0] < r && r < TIED[1]
    })
}

/// Numbers of a column, if they are numbers.
pub fn numbers(runs: &[Run], name: &str) -> Option<Vec<f64>> {
    let number = |run: &Run| match run.values.get(name)? {
        Value::Number(x) => Some(*x),
        Value::Name(_) => None,
    };
    runs.iter().map(number).collect()
}

/// Values less the mean of their powder.
pub fn within_powders(runs: &[Run], values: &[f64]) -> Vec<f64> {
    let mut of_powder: BTreeMap<usize, Vec<f64>> = BTreeMap::new();
    for (run, value) in runs.iter().zip(values) {
        of_powder.entry(run.powder).or_default().push(*value);
    }
    runs.iter().zip(values).map(|(run, value)| value - mean(&of_powder[&run.powder])).collect()
}

/// Pearson correlation; 0 if one of them is constant.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let (mean_a, mean_b) = (mean(a), mean(b));
    let sum = |f: &dyn Fn(f64, f64) -> f64| {
        a.iter().zip(b).map(|(a, b)| f(a - mean_a, b - mean_b)).sum::<f64>()
    };
    let spread = (sum(&|a, _| a * a) * sum(&|_, b| b * b)).sqrt();
    if spread > 0.0 { sum(&|a, b| a * b) / spread } else { 0.0 }
}

/// Share of the variance of an effect that a column explains: by a straight line, or by the mean of
/// each name.
fn explained(runs: &[Run], effect: &[f64], name: &str) -> f64 {
    if let Some(numbers) = numbers(runs, name) {
        return correlation(effect, &within_powders(runs, &numbers)).powi(2);
    }
    let mut of_name: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (run, x) in runs.iter().zip(effect) {
        if let Value::Name(name) = &run.values[name] {
            of_name.entry(name).or_default().push(*x);
        }
    }
    let between: f64 = of_name.values().map(|mine| mine.len() as f64 * mean(mine).powi(2)).sum();
    between / effect.iter().map(|x| x * x).sum::<f64>()
}

fn one<T>(mut of: Vec<T>, rng: &mut Pcg64) -> T {
    of.swap_remove(rng.random_range(0..of.len() as u64) as usize)
}

fn sign(rng: &mut Pcg64) -> f64 {
    if rng.random() { 1.0 } else { -1.0 }
}
