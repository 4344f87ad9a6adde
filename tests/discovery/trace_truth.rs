//! Benches with a hidden truth: balance readings of weighings in which a known cause, or none, is
//! at work.
//!
//! As [`truth`](crate::truth) for angles: nothing from the crate is used here, a [`TraceCase`] is
//! the file that a laboratory would upload, and the same family and seed produce the same bytes.
//! Each family draws one of several forms, none of which is in the detector's catalogue.
//!
//! ```text
//! mass of a shake   rate (A / 8 mm)^b exp(c pitch + day + weighing + shake)        scatter: 0.08, 0.12 and 0.15 to 0.3 of the log, chosen
//! reading           mass on the pan + 0.04 to 0.12 mg of noise, a third of it slower than 0.15 s, shown in steps of 0.01 or 0.1 mg
//! ```
//!
//! Forty weighings on eight to ten days, targets of 5 to 20 mg with long shakes first and short
//! ones last, a spoon of 25 to 70 mg that empties, six to fourteen readings after each shake, and
//! on most days a log of the empty pan and one of a standard mass.

mod family;

pub use family::TraceFamily;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use std::f64::consts::TAU;
use std::fmt::Write;

/// Readings and their truth.
#[derive(Debug, Clone)]
pub struct TraceCase {
    /// The file a laboratory uploads.
    pub csv: String,
    /// The form drawn by the family, for people.
    pub form: u32,
}

/// Readings of this family.
pub fn trace_case(family: TraceFamily, seed: u64) -> TraceCase {
    let mut bench = Bench::drawn(family, seed);
    TraceCase { form: bench.form, csv: bench.csv() }
}

/// The properties of a powder.
struct Powder {
    name: &'static str,
    /// mg of a shake of 8 mm at 10 deg, exponent of the amplitude, log mass per degree of pitch.
    rate: f64,
    exponent: f64,
    pitch: f64,
    /// Factor on the hidden effect.
    susceptibility: f64,
}

/// The surroundings of one weighing or log.
struct Around {
    day: usize,
    humidity: f64,
    vibration: f64,
    /// Rate of the day's drift, mg/s.
    drift: f64,
    waves: [[f64; 3]; 3],
    /// Times and sizes of jumps, for a wander by steps.
    jumps: [[f64; 2]; 6],
}

/// Mass that fell at a time, with its charge and susceptibility.
struct Fallen {
    at_s: f64,
    mg: f64,
    charge: f64,
    susceptibility: f64,
}

struct Bench {
    rng: Pcg64,
    family: TraceFamily,
    form: u32,
    /// Factor on the effect, 0.75 to 1.5.
    size: f64,
    powders: Vec<Powder>,
    step_mg: f64,
    noise_mg: f64,
    shake_scatter: f64,
    every_s: f64,
    readings: u32,
    weighings: usize,
    days: usize,
    /// Columns that are left out.
    missing: Vec<&'static str>,
    text: String,
}

const NAMES: [&str; 5] = ["sand", "sugar", "salt", "semolina", "sodium_bicarbonate"];
const OPTIONAL: [&str; 7] = [
    "powder",
    "session",
    "shake_mm",
    "spoon_pitch_deg",
    "spoon_fill_mg",
    "relative_humidity_pct",
    "vibration_rms_m_s2",
];

impl Bench {
    fn drawn(family: TraceFamily, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(
            seed.wrapping_mul(0x9e37_79b9).wrapping_add(family as u64) ^ 0x0074_7261_6365,
        );
        let mut between = |low: f64, high: f64| rng.random_range(low..high);
        let powders = NAMES.map(|name| Powder {
            name,
            rate: between(0.7, 2.4),
            exponent: between(0.7, 1.3),
            pitch: between(0.02, 0.06),
            susceptibility: between(0.6, 1.4),
        });
        let (size, noise_mg, shake_scatter) =
            (between(0.75, 1.5), between(0.04, 0.12), between(0.15, 0.3));
        let every_s = between(0.1, 0.25);
        let few = family == TraceFamily::NullFew;
        let kept = rng.random_range(2..=5);
        let mut missing: Vec<&'static str> = Vec::new();
        if family == TraceFamily::NullMissing {
            missing = OPTIONAL.into_iter().filter(|_| rng.random::<f64>() < 0.4).collect();
        }
        if family == TraceFamily::HiddenFill {
            missing.push("spoon_fill_mg");
        }
        Self {
            form: rng.random_range(0..3),
            family,
            size,
            powders: powders.into_iter().take(kept).collect(),
            step_mg: if rng.random::<f64>() < 0.5 { 0.1 } else { 0.01 },
            noise_mg,
            shake_scatter,
            every_s: if few { 1.0 } else { every_s },
            readings: if few { 2 } else { rng.random_range(6..=14) },
            weighings: if few { 15 } else { 40 },
            days: rng.random_range(8..=10),
            missing,
            text: String::new(),
            rng,
        }
    }

    fn normal(&mut self) -> f64 {
        let (u, v): (f64, f64) = (self.rng.random_range(1e-12..1.0), self.rng.random());
        (-2.0 * u.ln()).sqrt() * (TAU * v).cos()
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.rng.random_range(low..high)
    }

    /// The size of an effect if it is the hidden one, else 0.
    fn size_of(&self, family: TraceFamily) -> f64 {
        if self.family == family { self.size } else { 0.0 }
    }

    fn around(&mut self, day: usize, humidity: f64, drift: f64) -> Around {
        let wave = |bench: &mut Self| {
            [0.3 * bench.normal(), bench.between(2.5, 15.0), bench.between(0.0, TAU)]
        };
        let waves = [wave(self), wave(self), wave(self)];
        let jumps = std::array::from_fn(|_| [self.between(0.0, 60.0), 0.5 * self.normal()]);
        Around {
            day,
            humidity: (humidity + 3.0 * self.normal()).clamp(12.0, 92.0),
            vibration: 0.008 * (0.8 * self.normal()).exp(),
            drift,
            waves,
            jumps,
        }
    }

    /// Remaining share of a load step after x seconds.
    fn behind(&self, x: f64) -> f64 {
        let tau = 0.5 * self.size;
        match self.form {
            // Three equal filters in series.
            0 => (1.0 + 3.0 * x / tau + 4.5 * (x / tau).powi(2)) * (-3.0 * x / tau).exp(),
            // A fast and a slow part.
            1 => 0.6 * (-x / (0.4 * tau)).exp() + 0.4 * (-x / (2.5 * tau)).exp(),
            _ => 1.0 / (1.0 + (x / tau).powi(3)),
        }
    }

    /// Relative gain, or loss, of mass that fell x seconds ago.
    fn gained(&self, x: f64, humidity: f64) -> f64 {
        let h = humidity / 100.0;
        let damp = 1.0 / (1.0 + (-(h - 0.5) / 0.09).exp());
        let uptake = match self.form {
            0 => (x + 1.0).powf(0.75) - 1.0,
            1 => 30.0 * (x / 30.0).tanh(),
            _ => x / (1.0 + x / 45.0),
        };
        let loss = match self.form {
            0 => 25.0 * (x / 25.0).atan(),
            1 => (x + 0.5).powf(0.85) - 0.5_f64.powf(0.85),
            _ => x / (1.0 + (x / 50.0).powi(2)).sqrt(),
        };
        let dry = (1.0 - h).powf(0.7);
        self.size_of(TraceFamily::MassUptake) * 0.009 * damp * uptake
            - self.size_of(TraceFamily::Evaporation) * 0.005 * dry * loss
    }

    /// Pull of a charge of 1 after x seconds, mg.
    fn pull(&self, x: f64, humidity: f64) -> f64 {
        let dry = 1.0 / (1.0 + ((humidity - 40.0) / 6.0).exp());
        let decay = match self.form {
            0 => (1.0 + x / 1.2).powf(-1.6),
            1 => 0.5 * (-x / 0.6).exp() + 0.5 * (-x / 4.0).exp(),
            _ => (-(x / 1.5).powf(0.7)).exp(),
        };
        self.size_of(TraceFamily::BalanceStatic) * 0.8 * dry * decay
    }

    fn drifted(&self, rate: f64, t: f64) -> f64 {
        let course = match self.form {
            0 => t * (1.0 + t / 150.0),
            1 => 90.0 * (t / 90.0).atan(),
            _ => t.powf(0.85) * 1.6,
        };
        self.size_of(TraceFamily::BalanceDrift) * rate * course
    }

    fn wandered(&self, around: &Around, t: f64, walk: f64) -> f64 {
        let course = match self.form {
            0 => around
                .waves
                .iter()
                .map(|[a, period, phase]| a * (TAU * t / period + phase).sin())
                .sum(),
            1 => 0.45 * walk,
            _ => around
                .jumps
                .iter()
                .map(|[at, by]| by / (1.0 + (-(t - at) / 0.8).exp()))
                .sum::<f64>(),
        };
        self.size_of(TraceFamily::Wander) * course
    }

    /// SD of a reading relative to that on a still bench.
    fn shaken(&self, vibration: f64) -> f64 {
        let v = vibration / 0.01;
        let more = match self.form {
            0 => v,
            1 => 2.0 * (v / 1.5).powi(2) / (1.0 + (v / 1.5).powi(2)),
            _ => (v - 0.5).max(0.0).powf(0.7),
        };
        1.0 + self.size_of(TraceFamily::VibrationNoise) * 0.8 * more
    }

    /// Factor on the n-th shake's mass, of `mm`, from a spoon that holds `fill` after `energy` of
    /// earlier shakes, mm^2.
    fn let_fall(&self, n: u32, mm: f64, fill: f64, energy: f64, powder: &Powder) -> f64 {
        let n = f64::from(n);
        let s = powder.susceptibility;
        let packed = self.size_of(TraceFamily::Densification) * s;
        let packed = match self.form {
            0 => (1.0 + n / 6.0).powf(-0.8 * packed),
            1 => 1.0 - (0.05 * packed).min(0.08) * n.min(10.0),
            _ => (-packed * energy / (energy + 500.0)).exp(),
        };
        let full = self.size_of(TraceFamily::FillLevel) + self.size_of(TraceFamily::HiddenFill);
        let full = if full > 0.0 {
            match self.form {
                0 => 1.9 * (1.0 - (-fill / (28.0 * full)).exp()),
                1 => 1.7 / (1.0 + (-(fill - 32.0 * full) / 11.0).exp()),
                _ => (0.022 * full * (fill - 40.0)).exp(),
            }
        } else {
            1.0
        };
        let actuator = self.size_of(TraceFamily::Actuator);
        let done = if actuator > 0.0 {
            match self.form {
                // A dead band that long shakes forget; a stop; a servo that falls behind.
                0 => mm - 2.2 * actuator * (-mm / 9.0).exp(),
                1 => mm.min(10.0 - 2.0 * actuator) + 0.15 * (mm - 10.0 + 2.0 * actuator).max(0.0),
                _ => 9.0 / actuator * (mm * actuator / 9.0).tanh(),
            }
        } else {
            mm
        };
        packed * full * (done.max(0.2) / mm).powf(powder.exponent)
    }

    /// Readings from `from_s` on of a load, each the time and the displayed value.
    fn read(
        &mut self,
        around: &Around,
        fallen: &[Fallen],
        is_dose: bool,
        slow: &mut [f64; 2],
        from_s: f64,
        count: u32,
    ) -> Vec<(f64, f64)> {
        (0..count)
            .map(|k| {
                let jitter = self.between(0.0, 0.1);
                let t = from_s + self.every_s * (f64::from(k) + jitter);
                let mut shown = self.drifted(around.drift, t);
                for (j, step) in fallen.iter().enumerate() {
                    let x = (t - step.at_s).max(0.0);
                    let lag = if self.family == TraceFamily::BalanceLag && (j > 0) {
                        self.behind(x)
                    } else {
                        0.0
                    };
                    shown += step.mg * (1.0 - lag);
                    if is_dose {
                        shown += step.mg * step.susceptibility * self.gained(x, around.humidity);
                        shown += step.charge * step.susceptibility * self.pull(x, around.humidity);
                    }
                }
                // The balance's own filter, and wandering air.
                let own = self.normal();
                let kept = (-self.every_s / 0.15).exp();
                slow[0] = kept * slow[0] + (1.0 - kept * kept).sqrt() * own;
                let kept = (-self.every_s / 5.0).exp();
                slow[1] = kept * slow[1] + (1.0 - kept * kept).sqrt() * self.normal();
                shown += self.wandered(around, t, slow[1]);
                let noise = 0.8 * self.normal() + 0.6 * slow[0];
                shown += self.noise_mg * self.shaken(around.vibration) * noise;
                (t, (shown / self.step_mg).round() * self.step_mg)
            })
            .collect()
    }

    fn write(
        &mut self,
        id: &str,
        kind: &str,
        around: &Around,
        powder: Option<&str>,
        rows: &[(f64, f64)],
        shake: Option<[f64; 4]>,
    ) {
        let cell = |missing: &[&str], name: &str, text: String| {
            if missing.contains(&name) { String::new() } else { text }
        };
        for (k, &(t, mg)) in rows.iter().enumerate() {
            let missing = self.missing.clone();
            let of = |name: &str, text: String| cell(&missing, name, text);
            let [index, mm, pitch, fill] =
                shake.map_or([const { String::new() }; 4], |[index, mm, pitch, fill]| {
                    let mm = if mm > 0.0 { format!("{mm:.2}") } else { String::new() };
                    [
                        format!("{index:.0}"),
                        of("shake_mm", mm),
                        of("spoon_pitch_deg", format!("{pitch:.1}")),
                        of("spoon_fill_mg", format!("{fill:.1}")),
                    ]
                });
            let still = u8::from(k + 2 >= rows.len());
            let decimals = 2;
            writeln!(
                self.text,
                "{id},{t:.3},{mg:.decimals$},{still},{},{},{index},{mm},{pitch},{fill},{},{},{kind}",
                of("powder", powder.unwrap_or_default().to_owned()),
                of("session", format!("day {}", around.day + 1)),
                of("relative_humidity_pct", format!("{:.1}", around.humidity)),
                of("vibration_rms_m_s2", format!("{:.5}", around.vibration)),
            )
            .unwrap();
        }
    }

    fn dose(&mut self, id: usize, around: &Around, day_log: f64) {
        let which = self.rng.random_range(0..self.powders.len() as u32) as usize;
        let (name, rate, exponent, per_deg) = (
            self.powders[which].name,
            self.powders[which].rate,
            self.powders[which].exponent,
            self.powders[which].pitch,
        );
        let susceptibility = self.powders[which].susceptibility;
        let target = self.between(5.0, 20.0);
        let own = rate * (day_log + 0.12 * self.normal()).exp();
        let mut fill = self.between(25.0, 70.0);
        let (mut mass, mut energy, mut film) = (0.0, 0.0, 0.0);
        let mut pitch = self.between(5.0, 14.0);
        let mut fallen = vec![Fallen { at_s: 0.0, mg: 0.0, charge: 0.0, susceptibility }];
        let mut slow = [self.normal(), self.normal()];
        let mut from_s = 0.0;
        for n in 0..=30u32 {
            let mm = match (target - mass) / own {
                left if left > 4.0 => self.between(6.0, 14.0),
                left if left > 1.5 => self.between(4.0, 10.0),
                _ => self.between(2.0, 6.0),
            };
            if n > 0 {
                pitch += self.between(-1.0, 1.8);
                let factor = self.let_fall(n, mm, fill, energy, &self.powders[which]);
                let scatter = self.shake_scatter * self.normal();
                let mut mg = own
                    * (mm / 8.0).powf(exponent)
                    * (per_deg * (pitch - 10.0) + scatter).exp()
                    * factor;
                let room = self.size_of(TraceFamily::SpoonHoldup) * 3.5 * susceptibility;
                let kept = match self.form {
                    // Half of each shake until there is no more room; the part missing from a film
                    // of half the room; less and less with each shake.
                    0 => (0.5 * mg).min(room - film),
                    1 => mg * (room - film).max(0.0) / (room - film + 0.5 * room + 1e-9),
                    _ => {
                        mg * self.size_of(TraceFamily::SpoonHoldup).min(1.0) * 0.8
                            / (1.0 + (f64::from(n) / 2.0).powi(2))
                    }
                };
                let kept = kept.clamp(0.0, mg);
                film += kept;
                mg = (mg - kept).min(fill);
                (mass, fill, energy) = (mass + mg, fill - mg, energy + mm * mm);
                from_s += self.between(0.4, 0.8);
                let charge = (0.35 * self.normal()).exp();
                fallen.push(Fallen { at_s: from_s, mg, charge, susceptibility });
                from_s += self.every_s;
            }
            let rows = self.read(around, &fallen, true, &mut slow, from_s, self.readings);
            from_s = rows[rows.len() - 1].0;
            let shake = [f64::from(n), if n > 0 { mm } else { 0.0 }, pitch, fill];
            self.write(&format!("w{id}"), "dose", around, Some(name), &rows, Some(shake));
            if mass > target - 0.4 || fill < 1.0 {
                break;
            }
        }
    }

    fn log(&mut self, id: &str, around: &Around, kind: &str) {
        let mut slow = [self.normal(), self.normal()];
        let mut fallen = vec![Fallen { at_s: 0.0, mg: 0.0, charge: 0.0, susceptibility: 1.0 }];
        let count = (12.0 / self.every_s) as u32;
        let mut rows = self.read(around, &fallen, false, &mut slow, 0.0, count);
        if kind == "standard" {
            let at_s = rows[rows.len() - 1].0 + 0.1;
            fallen.push(Fallen { at_s, mg: 20.0, charge: 0.0, susceptibility: 1.0 });
        }
        let from_s = rows[rows.len() - 1].0 + self.every_s;
        rows.extend(self.read(around, &fallen, false, &mut slow, from_s, 3 * count));
        self.write(id, kind, around, None, &rows, None);
    }

    fn csv(&mut self) -> String {
        self.text =
            "weighing_id,t_s,balance_mg,stable,powder,session,shake_index,shake_mm,spoon_pitch_deg,spoon_fill_mg,\
                     relative_humidity_pct,vibration_rms_m_s2,kind\n"
                .to_owned();
        for day in 0..self.days {
            let (humidity, day_log) = (self.between(22.0, 72.0), 0.08 * self.normal());
            let drift = 0.016 + 0.009 * self.normal();
            let (from, to) =
                (day * self.weighings / self.days, (day + 1) * self.weighings / self.days);
            for id in from..to {
                let around = self.around(day, humidity, drift);
                self.dose(id, &around, day_log);
            }
            for kind in ["zero", "standard"] {
                if self.rng.random::<f64>() < 0.7 {
                    let around = self.around(day, humidity, drift);
                    self.log(&format!("{kind}{day}"), &around, kind);
                }
            }
        }
        std::mem::take(&mut self.text)
    }
}
