//! Forms of effects: functions of the conditions of a run that move the angle.

use super::laboratory::{Run, Value, column, stream};
use rand::RngExt;
use rand_pcg::Pcg64;
use std::f64::consts::TAU;
use std::fmt;

/// Largest argument of a shape: experiments and later days may go this far beyond the range of a
/// column.
const ARGUMENT_MAX: f64 = 1.3;
/// Highest activity in [`Shape::Bet`], at the top of the range: the isotherm has its pole at 1.
const BET_ACTIVITY_MAX: f64 = 0.72;
/// Grid points for finding the range of a shape.
const PLACES: usize = 401;
/// Range of a shape below which it is flat; heights are about 1.
const FLAT: f64 = 1e-9;

/// A function of u, which is 0 to 1 over the range of a column.
#[derive(Debug, Clone)]
pub enum Shape {
    /// u^n / (half^n + u^n); Langmuir's isotherm for n = 1.
    Hill { half: f64, n: f64 },
    /// √(u - knee), 0 before the knee.
    ShiftedRoot { knee: f64 },
    /// atan((u - centre) / width).
    Arctan { centre: f64, width: f64 },
    /// 3 t² - 2 t³ with t = (u - from) / (to - from) in 0 to 1.
    Smoothstep { from: f64, to: f64 },
    /// tanh((u / half)^p).
    TanhPower { half: f64, p: f64 },
    /// Straight, with another slope after the knee.
    Broken { knee: f64, before: f64, after: f64 },
    /// 1 - exp(-(u / time)^p).
    Stretched { time: f64, p: f64 },
    /// The Brunauer-Emmett-Teller isotherm: c a / ((1 - a) (1 + (c - 1) a)), a = 0.72 u.
    Bet { c: f64 },
    /// Catmull-Rom spline through these heights at equal distances.
    Spline(Vec<f64>),
    /// sin(2π (cycles u + phase)).
    Wave { cycles: f64, phase: f64 },
    /// exp(-((u - centre) / width)²).
    Bump { centre: f64, width: f64 },
    /// 0, and 1 from here on.
    Step { at: f64 },
    /// u^p.
    Power { p: f64 },
    /// exp(k u), which saturates for k < 0.
    Exp { k: f64 },
    /// ln(1 + k u).
    Log { k: f64 },
    /// |u - at|.
    Fold { at: f64 },
    /// 1 / (u + offset).
    Reciprocal { offset: f64 },
    /// This many steps of equal height.
    Stairs { steps: f64 },
}

impl Shape {
    fn at(&self, u: f64) -> f64 {
        let u = u.clamp(0.0, ARGUMENT_MAX);
        match self {
            Self::Hill { half, n } => u.powf(*n) / (half.powf(*n) + u.powf(*n)),
            Self::ShiftedRoot { knee } => (u - knee).max(0.0).sqrt(),
            Self::Arctan { centre, width } => ((u - centre) / width).atan(),
            Self::Smoothstep { from, to } => {
                let t = ((u - from) / (to - from)).clamp(0.0, 1.0);
                t * t * (3.0 - 2.0 * t)
            }
            Self::TanhPower { half, p } => (u / half).powf(*p).tanh(),
            Self::Broken { knee, before, after } => {
                before * u.min(*knee) + after * (u - knee).max(0.0)
            }
            Self::Stretched { time, p } => -(-(u / time).powf(*p)).exp_m1(),
            Self::Bet { c } => {
                let a = BET_ACTIVITY_MAX * u;
                c * a / ((1.0 - a) * (1.0 + (c - 1.0) * a))
            }
            Self::Spline(heights) => spline(heights, u),
            Self::Wave { cycles, phase } => (TAU * (cycles * u + phase)).sin(),
            Self::Bump { centre, width } => (-((u - centre) / width).powi(2)).exp(),
            Self::Step { at } => f64::from(u >= *at),
            Self::Power { p } => u.powf(*p),
            Self::Exp { k } => (k * u).exp(),
            Self::Log { k } => (k * u).ln_1p(),
            Self::Fold { at } => (u - at).abs(),
            Self::Reciprocal { offset } => (u + offset).recip(),
            Self::Stairs { steps } => (steps * u).floor().min(*steps - 1.0),
        }
    }

    /// Any of them, monotone or not.
    pub fn any(rng: &mut Pcg64) -> Self {
        let [a, b] = [rng.random_range(0.1..0.9), rng.random_range(0.05..0.5)];
        match rng.random_range(0..19u32) {
            0 => Self::Hill { half: a, n: rng.random_range(0.6..4.0) },
            1 => Self::ShiftedRoot { knee: 0.8 * a },
            2 => Self::Arctan { centre: a, width: b },
            3 => Self::Smoothstep { from: a - b, to: a + b },
            4 => Self::TanhPower { half: a, p: rng.random_range(0.5..3.0) },
            5 => Self::Broken {
                knee: a,
                before: rng.random_range(-1.0..1.0),
                after: rng.random_range(-1.0..1.0),
            },
            6 => Self::Stretched { time: b, p: rng.random_range(0.3..0.8) },
            7 => Self::Bet { c: rng.random_range(2.0..60.0) },
            8 | 9 => Self::knots(4 + rng.random_range(0..4u32) as usize, rng),
            10 => Self::Wave { cycles: rng.random_range(0.4..2.0), phase: rng.random() },
            11 => Self::Bump { centre: a, width: b },
            12 => Self::Step { at: a },
            13 => Self::Power { p: rng.random_range(0.3..3.0) },
            14 => Self::Exp { k: rng.random_range(-4.0..4.0) },
            15 => Self::Log { k: rng.random_range(1.0..50.0) },
            16 => Self::Fold { at: a },
            17 => Self::Reciprocal { offset: b },
            _ => Self::Stairs { steps: rng.random_range(2..6u32).into() },
        }
    }

    /// A spline through this many random heights.
    pub fn knots(count: usize, rng: &mut Pcg64) -> Self {
        Self::Spline((0..count).map(|_| rng.random_range(-1.0..1.0)).collect())
    }
}

/// Catmull-Rom spline through heights at equal distances over 0 to 1, level at the ends and beyond.
fn spline(heights: &[f64], u: f64) -> f64 {
    let last = heights.len() - 1;
    let place = u.min(1.0) * last as f64;
    let left = (place as usize).min(last - 1);
    let t = place - left as f64;
    let slope =
        |k: usize| if k == 0 || k == last { 0.0 } else { (heights[k + 1] - heights[k - 1]) / 2.0 };
    let (t2, t3) = (t * t, t * t * t);
    (2.0 * t3 - 3.0 * t2 + 1.0) * heights[left]
        + (t3 - 2.0 * t2 + t) * slope(left)
        + (3.0 * t2 - 2.0 * t3) * heights[left + 1]
        + (t3 - t2) * slope(left + 1)
}

/// A chain of shapes, each scaled to 0 to 1 over the range of its argument.
#[derive(Debug, Clone)]
pub struct Curve(Vec<(Shape, [f64; 2])>);

impl Curve {
    /// Composes the shapes, the first being applied first.
    pub fn of(shapes: Vec<Shape>) -> Self {
        let layer = |shape: Shape| {
            let values = || (0..PLACES).map(|k| shape.at(k as f64 / (PLACES - 1) as f64));
            let range = [
                values().fold(f64::INFINITY, f64::min),
                values().fold(f64::NEG_INFINITY, f64::max),
            ];
            (shape, range)
        };
        Self(shapes.into_iter().map(layer).collect())
    }

    fn at(&self, u: f64) -> f64 {
        let layer = |u: f64, (shape, [low, high]): &(Shape, [f64; 2])| {
            if high - low < FLAT { 0.0 } else { (shape.at(u) - low) / (high - low) }
        };
        self.0.iter().fold(u, layer)
    }
}

impl From<Shape> for Curve {
    fn from(shape: Shape) -> Self {
        Self::of(vec![shape])
    }
}

/// A factor of an effect.
#[derive(Debug, Clone)]
pub enum Factor {
    /// floor + (1 - floor) curve(u) with u = 0 at `from` and 1 at `to`; by the logarithm of the
    /// number if `log`.
    Number { column: &'static str, from: f64, to: f64, log: bool, floor: f64, curve: Curve },
    /// 1 for this name, else 0.
    Is { column: &'static str, name: &'static str },
    /// A fixed number from -1 to 1 for each name, the same for all powders or not.
    Level { column: &'static str, by_powder: bool, seed: u64 },
}

impl Factor {
    /// A curve over the usual range of a column.
    pub fn number(name: &'static str, curve: impl Into<Curve>) -> Self {
        let [from, to] = column(name).range;
        Self::Number { column: name, from, to, log: false, floor: 0.0, curve: curve.into() }
    }

    /// The same over the range of its logarithm, with a ratio of at most 300.
    pub fn logarithm(name: &'static str, curve: impl Into<Curve>) -> Self {
        let [from, to] = column(name).range;
        Self::Number {
            column: name,
            from: from.max(to / 300.0),
            to,
            log: true,
            floor: 0.0,
            curve: curve.into(),
        }
    }

    /// 1 without the ioniser, 0 with it.
    pub fn without_ioniser() -> Self {
        let curve = Shape::Power { p: 1.0 }.into();
        Self::Number { column: "ioniser_on", from: 1.0, to: 0.0, log: false, floor: 0.0, curve }
    }

    /// The column it depends on.
    pub fn column(&self) -> &'static str {
        match self {
            Self::Number { column, .. } | Self::Is { column, .. } | Self::Level { column, .. } => {
                column
            }
        }
    }

    /// Its value for a run.
    pub fn at(&self, run: &Run) -> f64 {
        match (self, &run.values[self.column()]) {
            (Self::Number { from, to, log, floor, curve, .. }, Value::Number(x)) => {
                let u = if *log {
                    (x.max(*from) / from).ln() / (to / from).ln()
                } else {
                    (x - from) / (to - from)
                };
                floor + (1.0 - floor) * curve.at(u)
            }
            (Self::Is { name, .. }, Value::Name(level)) => f64::from(level == name),
            (Self::Level { by_powder, seed, .. }, Value::Name(level)) => {
                let powder = if *by_powder { run.powder } else { 0 };
                stream(*seed, level, powder).random_range(-1.0..1.0)
            }
            (factor, value) => panic!("{factor:?} of {value:?}"),
        }
    }
}

impl fmt::Display for Factor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number { column, from, to, log, floor, curve } => {
                let shapes: Vec<String> =
                    curve.0.iter().map(|(shape, _)| format!("{shape:.3?}")).collect();
                let scale = if *log { "log " } else { "" };
                write!(
                    f,
                    "[{scale}{column} {from:.3}..{to:.3}, at least {floor:.2}: {}]",
                    shapes.join(" then ")
                )
            }
            Self::Is { column, name } => write!(f, "[{column} = {name}]"),
            Self::Level { column, by_powder, .. } => {
                write!(f, "[level of {column}{}]", if *by_powder { " and powder" } else { "" })
            }
        }
    }
}

/// A cause: scale (susceptibility · product of the factors - centre), degrees.
#[derive(Debug, Clone)]
pub struct Term {
    /// One for each powder.
    pub susceptibility: Vec<f64>,
    /// The first one's column is the covariate of the cause.
    pub factors: Vec<Factor>,
    /// Degrees.
    pub scale: f64,
    /// Mean of each powder in the campaign, before scaling.
    pub centre: Vec<f64>,
}

impl Term {
    /// Not yet scaled.
    pub fn new(susceptibility: Vec<f64>, factors: Vec<Factor>) -> Self {
        let centre = vec![0.0; susceptibility.len()];
        Self { susceptibility, factors, scale: 1.0, centre }
    }

    /// Contribution to the angle of a run, degrees.
    pub fn at(&self, run: &Run) -> f64 {
        let product: f64 = self.factors.iter().map(|factor| factor.at(run)).product();
        self.scale * (self.susceptibility[run.powder] * product - self.centre[run.powder])
    }
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let susceptibility: Vec<String> =
            self.susceptibility.iter().map(|x| format!("{x:.2}")).collect();
        write!(f, "{:.3} ({}) ", self.scale, susceptibility.join(", "))?;
        self.factors.iter().try_for_each(|factor| factor.fmt(f))
    }
}
