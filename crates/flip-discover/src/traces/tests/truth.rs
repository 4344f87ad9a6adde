//! A laboratory whose bench may hide an effect, in forms that the catalogue does not have. Shares
//! nothing with the code under test.

use super::super::readings::{Kind, Reading, Traces, Weighing};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The hidden effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hidden {
    Nothing,
    /// The balance's own filter, which the simulated bench has.
    OwnFilter,
    Drift,
    Lag,
    Uptake,
    Evaporation,
    Static,
    Vibration,
    Holdup,
    Fill,
    Densification,
    Actuator,
    /// Waves of the reading, different in each weighing: no cause of the catalogue.
    Wander,
    /// Draughts that wander at random, in each weighing.
    Draught,
}

/// How the bench is used.
#[derive(Debug, Clone, Copy)]
pub struct Bench {
    pub hidden: Hidden,
    /// Factor on the effect.
    pub size: f64,
    pub readability_mg: f64,
    /// Time between readings, s.
    pub every_s: f64,
    /// Readings after each shake.
    pub readings: u32,
}

impl Bench {
    pub fn new(hidden: Hidden, readability_mg: f64) -> Self {
        Self { hidden, size: 1.0, readability_mg, every_s: 0.2, readings: 10 }
    }
}

/// mg per shake of 8 mm, and its exponent of the amplitude.
const POWDERS: [(&str, f64, f64); 5] = [
    ("sand", 2.2, 0.9),
    ("sugar", 1.6, 0.7),
    ("salt", 1.9, 1.0),
    ("semolina", 1.1, 1.2),
    ("bicarbonate", 0.9, 0.8),
];

struct Lab {
    rng: Pcg64,
    bench: Bench,
}

/// Surroundings of one weighing.
struct Day {
    session: usize,
    humidity: f64,
    vibration: f64,
    /// Drift, mg/s.
    drift: f64,
    /// Amplitude, period and phase of waves.
    waves: [(f64, f64, f64); 3],
}

impl Lab {
    fn normal(&mut self) -> f64 {
        let (u, v): (f64, f64) = (self.rng.random_range(1e-12..1.0), self.rng.random());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    fn is(&self, hidden: Hidden) -> f64 {
        if self.bench.hidden == hidden { self.bench.size } else { 0.0 }
    }

    fn day(&mut self, session: usize, humidity: f64, session_drift: f64) -> Day {
        let mut wave = || {
            let amplitude = 0.35 * self.normal();
            (amplitude, self.rng.random_range(3.0..14.0), self.rng.random_range(0.0..6.3))
        };
        let waves = [wave(), wave(), wave()];
        Day {
            session,
            humidity: (humidity + 3.0 * self.normal()).clamp(15.0, 90.0),
            vibration: 0.01 * (0.8 * self.normal()).exp(),
            drift: session_drift,
            waves,
        }
    }

    /// `count` readings starting at `from`, of a load that arrived in `steps` of (time, mg,
    /// amplitude of charge).
    fn read(
        &mut self,
        day: &Day,
        kind: Kind,
        steps: &[(f64, f64, f64)],
        draught: &mut f64,
        from: f64,
        count: u32,
    ) -> Vec<(f64, f64)> {
        let every = self.bench.every_s;
        (0..count)
            .map(|k| {
                let t = from + every * f64::from(k);
                let humid = day.humidity / 100.0;
                let mut shown = 0.0;
                for (j, &(at, mg, charge)) in steps.iter().enumerate() {
                    let x = t - at;
                    let moved = j > 0 || kind == Kind::Dose;
                    let behind = match self.bench.hidden {
                        // Two equal filters in series.
                        Hidden::Lag if moved => {
                            (1.0 + x / (0.35 * self.bench.size))
                                * (-x / (0.35 * self.bench.size)).exp()
                        }
                        Hidden::OwnFilter if moved => (-x / 0.16).exp(),
                        _ => 0.0,
                    };
                    shown += mg * (1.0 - behind);
                    if kind == Kind::Dose {
                        shown +=
                            self.is(Hidden::Uptake) * 0.02 * mg * humid.powf(1.7) * x.powf(0.9);
                        shown -= self.is(Hidden::Evaporation)
                            * 0.008
                            * mg
                            * (1.0 - humid).powf(1.5)
                            * 40.0
                            * (x / 40.0).ln_1p();
                        if j > 0 {
                            let dry = (-(day.humidity - 20.0).max(0.0) / 15.0).exp();
                            shown += self.is(Hidden::Static) * 0.8 * charge * dry
                                / (1.0 + (x / 1.5).powi(2));
                        }
                    }
                }
                shown += self.is(Hidden::Drift) * day.drift * (t + 0.002 * t * t);
                let wave = day.waves.iter().map(|(a, period, phase)| {
                    a * (std::f64::consts::TAU * t / period + phase).sin()
                });
                shown += self.is(Hidden::Wander) * wave.sum::<f64>();
                *draught = *draught * (-every / 4.0).exp()
                    + 0.3 * (1.0 - (-2.0 * every / 4.0).exp()).sqrt() * self.normal();
                shown += self.is(Hidden::Draught) * *draught;
                let shaking = 1.0 + self.is(Hidden::Vibration) * (day.vibration / 0.012).powf(1.5);
                shown += 0.1 * shaking * self.normal();
                let step = self.bench.readability_mg;
                (t, ((shown / step).round() * step * 1e6).round() / 1e6)
            })
            .collect()
    }

    fn reading(day: &Day, (t_s, balance_mg): (f64, f64)) -> Reading {
        Reading {
            t_s,
            balance_mg,
            stable: None,
            shake_index: None,
            shake_mm: None,
            spoon_pitch_deg: None,
            spoon_fill_mg: None,
            relative_humidity_pct: Some(day.humidity),
            vibration_rms_m_s2: Some(day.vibration),
        }
    }

    fn dose(&mut self, id: usize, day: &Day) -> Weighing {
        let (powder, rate, exponent) = POWDERS[self.rng.random_range(0..5u32) as usize];
        let target = self.rng.random_range(5.0..20.0);
        let own = rate * (0.15 * self.normal()).exp();
        let mut fill: f64 = self.rng.random_range(25.0..70.0);
        let (mut t, mut mass, mut film, mut draught) = (0.0, 0.0, 0.0, 0.3 * self.normal());
        let mut pitch: f64 = self.rng.random_range(5.0..15.0);
        let mut steps = vec![(0.0, 0.0, 0.0)];
        let mut readings = Vec::new();
        for shake in 0..=30u32 {
            let mm: f64 = match (target - mass) / own {
                left if left > 4.0 => self.rng.random_range(6.0..14.0),
                left if left > 1.5 => self.rng.random_range(4.0..10.0),
                _ => self.rng.random_range(2.0..6.0),
            };
            let before = fill;
            if shake > 0 {
                pitch += self.rng.random_range(-1.0..2.0);
                let executed = if self.is(Hidden::Actuator) > 0.0 {
                    mm.powi(3) / (mm * mm + 20.0 * self.bench.size)
                } else {
                    mm
                };
                let mut mg = own
                    * (executed / 8.0).powf(exponent)
                    * (0.04 * (pitch - 10.0)).exp()
                    * (0.25 * self.normal()).exp();
                let n = f64::from(shake);
                mg *= if self.is(Hidden::Fill) > 0.0 {
                    1.8 * fill / (fill + 40.0 * self.bench.size)
                } else {
                    1.0
                };
                mg *= (-self.is(Hidden::Densification) * (n / 12.0).powf(0.7)).exp();
                // A film takes up to 3 mg, more slowly the fuller it is.
                let kept = self.is(Hidden::Holdup) * (3.0 - film) * (1.0 - (-mg / 3.0f64).exp());
                film += kept.min(mg);
                mg -= kept.min(mg);
                mass += mg;
                fill -= mg;
                t += 0.6;
                steps.push((t, mg, (0.3 * self.normal()).exp()));
            }
            let shown = self.read(
                day,
                Kind::Dose,
                &steps,
                &mut draught,
                t + self.bench.every_s,
                self.bench.readings,
            );
            t = shown[shown.len() - 1].0;
            readings.extend(shown.into_iter().map(|shown| Reading {
                shake_index: Some(shake),
                shake_mm: (shake > 0).then_some(mm),
                spoon_pitch_deg: Some(pitch),
                spoon_fill_mg: Some(before),
                ..Self::reading(day, shown)
            }));
            if mass > target - 0.3 {
                break;
            }
        }
        let (powder, session) = (Some(powder.to_owned()), Some(format!("day {}", day.session)));
        Weighing {
            id: format!("w{id}"),
            powder,
            session,
            kind: Kind::Dose,
            target_mg: Some(target),
            readings,
        }
    }

    fn control(&mut self, id: usize, day: &Day, kind: Kind) -> Weighing {
        let mut draught = 0.3 * self.normal();
        let mut steps = vec![(0.0, 0.0, 0.0)];
        let count = (10.0 / self.bench.every_s) as u32;
        let mut shown = self.read(day, kind, &steps, &mut draught, 0.0, count);
        let t = shown[shown.len() - 1].0;
        steps.push((t + 0.1, if kind == Kind::Standard { 10.0 } else { 0.0 }, 0.0));
        shown.extend(self.read(day, kind, &steps, &mut draught, t + self.bench.every_s, 4 * count));
        let readings = shown.into_iter().map(|shown| Self::reading(day, shown)).collect();
        let session = Some(format!("day {}", day.session));
        Weighing { id: format!("c{id}"), powder: None, session, kind, target_mg: None, readings }
    }
}

/// Forty weighings on eight days, and a log of the empty pan or of a standard on each.
pub fn traces(bench: Bench, seed: u64) -> Traces {
    let mut lab = Lab { rng: Pcg64::seed_from_u64(seed ^ 0x7ace), bench };
    let mut weighings = Vec::new();
    for session in 0..8 {
        let (humidity, way) = (lab.rng.random_range(25.0..70.0), lab.normal());
        let drift = 0.015 + 0.008 * way;
        for k in 0..5 {
            let day = lab.day(session, humidity, drift);
            weighings.push(lab.dose(5 * session + k, &day));
        }
        let day = lab.day(session, humidity, drift);
        let kind = if session % 2 == 0 { Kind::Zero } else { Kind::Standard };
        weighings.push(lab.control(session, &day, kind));
    }
    Traces { weighings }
}
