//! A laboratory: its powders, weather, habits and noise, and its runs day after day.
//!
//! A day is the same whether it belongs to the campaign, to the days after it or to an experiment:
//! each draws from its own streams.

use super::effect::{Factor, Term};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use statrs::function::erf::erf;
use std::collections::BTreeMap;
use std::f64::consts::{SQRT_2, TAU};

/// Powder, mean and SD of five repeats in degrees, whether it takes up water from the air, flow
/// time in s (the last two chosen here).
pub const PUBLISHED: [(&str, f64, f64, bool, f64); 5] = [
    ("sand", 28.55, 1.94, false, 4.2),
    ("sugar", 31.41, 1.42, true, 5.1),
    ("salt", 36.03, 2.29, true, 5.6),
    ("semolina", 42.76, 1.97, false, 8.3),
    ("sodium_bicarbonate", 42.38, 2.48, true, 9.0),
];
/// Relative change of the flow time per degree of effect, and its SD between repeats.
const FLOW_PER_DEG: f64 = 0.015;
const FLOW_SD: f64 = 0.04;
/// Latest age at which a container is changed, so that later days have no ages outside the
/// campaign's.
const CONTAINER_D: f64 = 28.0;
/// Working days of a week.
const WEEK_D: usize = 5;

/// A quantity that can be recorded with a run.
#[derive(Debug)]
pub struct Column {
    /// Name in the file.
    pub name: &'static str,
    /// Usual range of its numbers; names have none.
    pub range: [f64; 2],
    /// Decimals written down.
    decimals: usize,
    /// Chance that a campaign records it without its truth needing it.
    pub chance: f64,
    /// Causes of the catalogue that act through it.
    pub causes: &'static [&'static str],
}

const fn of(
    name: &'static str,
    range: [f64; 2],
    decimals: usize,
    chance: f64,
    causes: &'static [&'static str],
) -> Column {
    Column { name, range, decimals, chance, causes }
}

/// Names instead of numbers.
const NAMES: [f64; 2] = [f64::NAN; 2];

/// In file order. `day` counts days from the first of the campaign; nobody records it.
pub const COLUMNS: [Column; 23] = [
    of("day", [0.0, 60.0], 0, 0.0, &[]),
    of("order_in_session", [1.0, 10.0], 0, 0.8, &["order"]),
    of("method", NAMES, 0, 0.5, &["method_bias"]),
    of("operator", NAMES, 0, 0.7, &["operator"]),
    of("batch", NAMES, 0, 0.45, &["batch"]),
    of("plate", NAMES, 0, 0.4, &["base_friction"]),
    of(
        "relative_humidity_pct",
        [20.0, 90.0],
        1,
        0.9,
        &["humidity", "deliquescence", "charge", "humid_ageing"],
    ),
    of("temperature_c", [15.0, 30.0], 1, 0.85, &["temperature"]),
    of("rest_min", [0.0, 300.0], 0, 0.6, &["rest_time", "humid_ageing"]),
    of("container_age_d", [0.0, 45.0], 0, 0.6, &["container_age"]),
    of("funnel_height_mm", [30.0, 100.0], 0, 0.4, &["funnel_height"]),
    of("base_diameter_mm", [60.0, 100.0], 0, 0.2, &["base_friction"]),
    of("poured_mass_g", [38.0, 62.0], 1, 0.25, &[]),
    of("flow_time_s", [2.0, 15.0], 2, 0.1, &[]),
    of("vibration_rms_m_s2", [0.002, 0.2], 4, 0.4, &["vibration"]),
    of("ioniser_on", [0.0, 1.0], 0, 0.2, &["charge"]),
    of("pressure_hpa", [985.0, 1031.0], 1, 0.35, &[]),
    of("hour_of_day", [8.0, 18.0], 1, 0.25, &[]),
    of("lamp_nm", [400.0, 740.0], 0, 0.15, &[]),
    of("noise_db", [32.0, 68.0], 0, 0.15, &[]),
    of("supply_v", [220.0, 240.0], 1, 0.15, &[]),
    of("bench", NAMES, 0, 0.15, &[]),
    of("balance_room_lux", [150.0, 900.0], 0, 0.1, &[]),
];

/// The column of this name.
///
/// # Panics
/// No such column.
pub fn column(name: &str) -> &'static Column {
    COLUMNS
        .iter()
        .find(|column| column.name == name)
        .unwrap_or_else(|| panic!("nothing is called {name}"))
}

/// The value of a cell.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Rounded as written down.
    Number(f64),
    /// A name.
    Name(String),
}

impl Value {
    /// Parses the text for this column.
    ///
    /// # Panics
    /// Not a number where one is required.
    pub fn parse(name: &str, text: &str) -> Self {
        if column(name).range[0].is_nan() {
            return Self::Name(text.to_owned());
        }
        Self::Number(
            text.trim().parse().unwrap_or_else(|_| panic!("{name} is a number, not {text:?}")),
        )
    }
}

/// One angle of repose and its conditions.
#[derive(Debug, Clone)]
pub struct Run {
    /// Days since the first of the campaign.
    pub day: usize,
    /// Index into [`Laboratory::powders`].
    pub powder: usize,
    /// The true conditions, recorded or not.
    pub values: BTreeMap<&'static str, Value>,
    /// Columns that were not filled in.
    forgotten: Vec<&'static str>,
    /// Measured angle, degrees.
    repose_deg: f64,
}

/// A powder.
#[derive(Debug, Clone)]
pub struct Powder {
    /// Id.
    pub name: String,
    /// Angle of repose, degrees.
    pub mean_deg: f64,
    /// SD of repeats, degrees.
    pub repeat_sd_deg: f64,
    /// Takes up water from the air.
    pub hygroscopic: bool,
    /// Mean flow time, s.
    pub flow_s: f64,
}

/// Weather in the room.
#[derive(Debug, Clone)]
pub struct Climate {
    /// Range over which the days' humidities are spread, %.
    pub humidity_pct: [f64; 2],
    /// Correlation of a day's weather with that of the day before.
    pub persistence: f64,
    /// Share of the season in the variance of the weather; its period in days and its phase in
    /// turns.
    pub season: f64,
    pub period_d: f64,
    pub phase: f64,
    /// SD of the drift of humidity in the course of a day, %.
    pub wander_pct: f64,
    /// Correlation of temperature with humidity; SD of temperature.
    pub warm_when_humid: f64,
    pub temperature_sd_c: f64,
}

/// How people work.
#[derive(Debug, Clone)]
pub struct Habits {
    /// Times at rest, min; between the first and the last if `rest_is_free`.
    pub rest_min: Vec<f64>,
    pub rest_is_free: bool,
    /// Heights of the funnel.
    pub heights_mm: Vec<f64>,
    /// Whether all powders have their containers changed together.
    pub shared_containers: bool,
    /// Chance that a container is changed on a day.
    pub renewal: f64,
    /// Two batches of each powder, A and B, are in use at the same time; otherwise one follows the
    /// other.
    pub parallel_batches: bool,
    /// Number of operators; whether one works for a whole day.
    pub operators: usize,
    pub operator_daily: bool,
    /// Number of base plates; whether one is used for a whole day.
    pub plates: usize,
    pub plate_daily: bool,
    /// Shares of runs with the camera, and with the ioniser.
    pub camera: f64,
    pub ioniser: f64,
    /// Day of the first session since 1970, if sessions are dates; else they are numbers.
    pub first_day: Option<i64>,
}

/// Columns that move together from day to day.
#[derive(Debug, Clone)]
pub struct Tie {
    /// Two or three of humidity, temperature, rest and age of container.
    pub columns: Vec<&'static str>,
    /// Days after which all containers are changed, if their age is among them.
    pub period_d: usize,
    /// SD of each around their driver, as a share of its range.
    pub jitter: f64,
}

/// Distribution of repeats about their mean, with a variance of 1 before scaling.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    Normal,
    /// Student's t with 4 degrees of freedom.
    HeavyTails,
    /// A gamma distribution of shape 4, skewed to the side of this sign.
    Skewed(f64),
}

/// The sources of scatter between repeats.
#[derive(Debug, Clone)]
pub struct Noise {
    /// SDs of days, and of days by powder, degrees.
    pub day_deg: f64,
    pub day_powder_deg: f64,
    pub kind: Kind,
    /// Share of runs that go wrong by 6 to 12 degrees.
    pub outliers: f64,
    /// Repeats scatter exp(strength (factor - 1/2)) times as much.
    pub scatter: Option<(Factor, f64)>,
}

/// The hidden truth: see the fields of [`super::Case`] of the same names.
#[derive(Debug, Clone, Default)]
pub struct Truth {
    pub family: &'static str,
    pub mechanism: Option<&'static str>,
    pub also_right: Vec<&'static str>,
    pub mechanisms: Vec<&'static str>,
    pub rivals: Vec<&'static str>,
    pub covariate: Option<&'static str>,
    pub form_class: Option<&'static str>,
    pub size_deg: f64,
}

/// A laboratory with an effect, for any number of days.
#[derive(Debug, Clone)]
pub struct Laboratory {
    pub seed: u64,
    pub powders: Vec<Powder>,
    /// Days of the campaign, and runs of each powder on each.
    pub days: usize,
    pub repeats: usize,
    pub climate: Climate,
    pub habits: Habits,
    pub tie: Option<Tie>,
    pub noise: Noise,
    /// Columns of the file in addition to powder, angle and session.
    pub recorded: Vec<&'static str>,
    /// Share of cells that were not filled in.
    pub missing: f64,
    pub terms: Vec<Term>,
    pub truth: Truth,
}

/// Conditions that are the same all day.
struct Day {
    index: usize,
    /// Driver of humidity, and of everything tied to it: 0 to 1.
    driver: f64,
    drift_pct: f64,
    temperature_c: f64,
    ties: [f64; 3],
    pressure_hpa: f64,
    vibration: f64,
    supply_v: f64,
    hour: f64,
    operator: usize,
    plate: usize,
    /// For each powder.
    age_d: Vec<f64>,
    lot: Vec<usize>,
}

impl Laboratory {
    /// The runs of the campaign.
    pub fn campaign(&self) -> Vec<Run> {
        self.ordinary_days(0, self.days)
    }

    /// This many days with all powders in random order.
    pub fn ordinary_days(&self, start: usize, days: usize) -> Vec<Run> {
        let mut runs = Vec::new();
        for day in &self.calendar(start + days)[start..] {
            let mut rng = stream(self.seed, "runs", day.index);
            let mut powders: Vec<usize> =
                (0..self.powders.len() * self.repeats).map(|k| k / self.repeats).collect();
            for k in (1..powders.len()).rev() {
                powders.swap(k, rng.random_range(0..=k as u64) as usize);
            }
            let count = powders.len();
            let places = powders.into_iter().enumerate();
            let mut session: Vec<Run> = places
                .map(|(place, powder)| self.run(day, powder, place, count, &mut rng))
                .collect();
            let mut forgetting = stream(self.seed, "forgotten", day.index);
            for run in &mut session {
                run.forgotten = self
                    .recorded
                    .iter()
                    .copied()
                    .filter(|_| forgetting.random_bool(self.missing))
                    .collect();
            }
            self.measure(day.index, &mut session);
            runs.append(&mut session);
        }
        runs
    }

    /// The requested runs, on days from this one on.
    pub fn experiment(&mut self, start: usize, settings: &[BTreeMap<String, String>]) -> Vec<Run> {
        let mut sessions: Vec<Option<&String>> = Vec::new();
        for setting in settings {
            let session = setting.get("session");
            if !sessions.contains(&session) {
                sessions.push(session);
            }
            for name in
                setting.keys().filter(|name| !["powder", "session"].contains(&name.as_str()))
            {
                let name = column(name).name;
                assert!(!["day", "flow_time_s"].contains(&name), "{name} cannot be set");
                if !self.recorded.contains(&name) {
                    self.recorded.push(name);
                }
            }
        }
        let calendar = self.calendar(start + sessions.len());
        let days = sessions.into_iter().zip(&calendar[start..]);
        days.flat_map(|(session, day)| {
            let mine = settings.iter().filter(|setting| setting.get("session") == session);
            self.experiment_day(day, &mine.collect::<Vec<_>>())
        })
        .collect()
    }

    fn experiment_day(&self, day: &Day, settings: &[&BTreeMap<String, String>]) -> Vec<Run> {
        let mut rows = Vec::new();
        for setting in settings {
            let named = setting.get("powder").map(|name| {
                let powder = self.powders.iter().position(|powder| powder.name == *name);
                powder.unwrap_or_else(|| panic!("the laboratory has no {name}"))
            });
            rows.extend(
                (0..self.powders.len())
                    .filter(|&p| named.is_none_or(|it| it == p))
                    .map(|p| (p, *setting)),
            );
        }
        let mut rng = stream(self.seed, "runs", day.index);
        let mut session = Vec::new();
        for (place, (powder, setting)) in rows.iter().enumerate() {
            let mut run = self.run(day, *powder, place, rows.len(), &mut rng);
            for (name, text) in
                setting.iter().filter(|(name, _)| !["powder", "session"].contains(&name.as_str()))
            {
                run.values.insert(column(name).name, Value::parse(name, text));
            }
            session.push(run);
        }
        self.measure(day.index, &mut session);
        session
    }

    /// Days from the first one on; a longer calendar begins with the shorter one.
    fn calendar(&self, days: usize) -> Vec<Day> {
        let Self { climate, habits, .. } = self;
        let mut rng = stream(self.seed, "calendar", 0);
        let mut weather = [(); 3].map(|()| normal(&mut rng));
        let mut opened: Vec<f64> =
            self.powders.iter().map(|_| -rng.random_range(0.0..20.0f64).floor()).collect();
        let mut lot: Vec<usize> = vec![0; self.powders.len()];
        let innovation = (1.0 - climate.persistence.powi(2)).sqrt();
        let mut calendar = Vec::new();
        for index in 0..days {
            let date = index + 2 * (index / WEEK_D);
            weather = weather.map(|w| climate.persistence * w + innovation * normal(&mut rng));
            let season = (TAU * (date as f64 / climate.period_d + climate.phase)).sin() * SQRT_2;
            let humid = climate.season.sqrt() * season + (1.0 - climate.season).sqrt() * weather[0];
            let warm = climate.warm_when_humid * humid
                + (1.0 - climate.warm_when_humid.powi(2)).sqrt() * weather[1];
            // The same number of draws on every day; otherwise a different number of days would
            // change the days.
            let all = rng.random_bool(habits.renewal);
            for powder in 0..self.powders.len() {
                let one = rng.random_bool(habits.renewal);
                let stale = date as f64 - opened[powder] >= CONTAINER_D;
                if stale || if habits.shared_containers { all } else { one } {
                    opened[powder] = date as f64;
                }
                lot[powder] += usize::from(rng.random_bool(0.12));
            }
            let tied_age = self.tie.as_ref().filter(|tie| tie.columns.contains(&"container_age_d"));
            let (driver, age_d) = match tied_age {
                Some(tie) => {
                    let age = date % tie.period_d;
                    (age as f64 / tie.period_d as f64, vec![age as f64; self.powders.len()])
                }
                None => {
                    let opened = if habits.shared_containers {
                        vec![opened[0]; opened.len()]
                    } else {
                        opened.clone()
                    };
                    (
                        (1.0 + erf(humid / SQRT_2)) / 2.0,
                        opened.iter().map(|day| date as f64 - day).collect(),
                    )
                }
            };
            calendar.push(Day {
                index,
                driver,
                drift_pct: climate.wander_pct * normal(&mut rng),
                temperature_c: 21.5 + climate.temperature_sd_c * warm,
                ties: [(); 3].map(|()| normal(&mut rng)),
                pressure_hpa: 1008.0 + 9.0 * weather[2].clamp(-2.5, 2.5),
                vibration: normal(&mut rng),
                supply_v: 230.0 + 3.0 * normal(&mut rng),
                hour: rng.random_range(8.0..14.0),
                operator: rng.random_range(0..habits.operators as u64) as usize,
                plate: rng.random_range(0..habits.plates as u64) as usize,
                age_d,
                lot: lot.clone(),
            });
        }
        calendar
    }

    /// The conditions of a run; nothing is measured yet.
    fn run(&self, day: &Day, powder: usize, place: usize, count: usize, rng: &mut Pcg64) -> Run {
        let Self { climate, habits, .. } = self;
        let one_of = |count: usize, rng: &mut Pcg64| rng.random_range(0..count as u64) as usize;
        let late = place as f64 / (count.max(2) - 1) as f64 - 0.5;
        let [dry, humid] = climate.humidity_pct;
        let mut humidity_pct =
            dry + (humid - dry) * day.driver + day.drift_pct * late + 0.5 * normal(rng);
        let mut temperature_c = day.temperature_c + 0.5 * late + 0.15 * normal(rng);
        let (listed, share) =
            (habits.rest_min[one_of(habits.rest_min.len(), rng)], rng.random::<f64>());
        let [shortest, longest] = [habits.rest_min[0], habits.rest_min[habits.rest_min.len() - 1]];
        let mut rest_min =
            if habits.rest_is_free { shortest * (longest / shortest).powf(share) } else { listed };
        if let Some(tie) = &self.tie {
            for (name, tied) in tie.columns.iter().zip(day.ties) {
                let level = day.driver + tie.jitter * tied;
                match *name {
                    "relative_humidity_pct" => {
                        humidity_pct = dry + (humid - dry) * level + 0.3 * normal(rng)
                    }
                    "temperature_c" => temperature_c = 18.5 + 6.5 * level + 0.1 * normal(rng),
                    // Less than a factor of three, so that its logarithm follows as well.
                    "rest_min" => rest_min = 60.0 + 110.0 * level,
                    _ => {}
                }
            }
        }
        let operator = if habits.operator_daily { 0 } else { one_of(habits.operators, rng) };
        let plate = if habits.plate_daily { 0 } else { one_of(habits.plates, rng) };
        let text =
            |names: &[&str], index: usize| Value::Name(names[index % names.len()].to_owned());
        let batch = match (habits.parallel_batches, rng.random::<bool>()) {
            (true, second) => ["A", "B"][usize::from(second)].to_owned(),
            (false, _) => {
                let letters = self.powders[powder].name.to_uppercase();
                format!("{}-{}", letters.get(..3).unwrap_or("LOT"), 101 + day.lot[powder])
            }
        };
        let values = [
            ("day", Value::Number(day.index as f64)),
            ("order_in_session", Value::Number(place as f64 + 1.0)),
            ("method", text(&["manual", "camera"], usize::from(rng.random_bool(habits.camera)))),
            (
                "operator",
                text(&["Ada", "Ben", "Chloe"][..habits.operators], day.operator + operator),
            ),
            ("batch", Value::Name(batch)),
            ("plate", text(&["glass", "steel", "acrylic"][..habits.plates], day.plate + plate)),
            ("relative_humidity_pct", Value::Number(humidity_pct.clamp(8.0, 95.0))),
            ("temperature_c", Value::Number(temperature_c)),
            ("rest_min", Value::Number(rest_min.max(0.0))),
            ("container_age_d", Value::Number(day.age_d[powder])),
            (
                "funnel_height_mm",
                Value::Number(habits.heights_mm[one_of(habits.heights_mm.len(), rng)]),
            ),
            ("base_diameter_mm", Value::Number([60.0, 80.0, 100.0][one_of(3, rng)])),
            ("poured_mass_g", Value::Number(50.0 + 4.0 * normal(rng))),
            (
                "vibration_rms_m_s2",
                Value::Number(
                    (0.02 * (0.8 * day.vibration + 0.5 * normal(rng)).exp()).clamp(0.002, 0.3),
                ),
            ),
            ("ioniser_on", Value::Number(f64::from(u8::from(rng.random_bool(habits.ioniser))))),
            ("pressure_hpa", Value::Number(day.pressure_hpa + 0.3 * normal(rng))),
            ("hour_of_day", Value::Number(day.hour + 4.0 * (late + 0.5) * count as f64 / 20.0)),
            (
                "lamp_nm",
                Value::Number([405.0, 450.0, 530.0, 590.0, 630.0, 660.0, 730.0][one_of(7, rng)]),
            ),
            ("noise_db", Value::Number(50.0 + 6.0 * normal(rng))),
            ("supply_v", Value::Number(day.supply_v + normal(rng))),
            ("bench", text(&["left", "right"], one_of(2, rng))),
            ("balance_room_lux", Value::Number(rng.random_range(150.0..900.0))),
        ];
        let values = values.into_iter().map(|(name, value)| (name, rounded(name, value))).collect();
        Run { day: day.index, powder, values, forgotten: Vec::new(), repose_deg: f64::NAN }
    }

    fn measure(&self, day: usize, runs: &mut [Run]) {
        let mut rng = stream(self.seed, "noise", day);
        let day_deg = self.noise.day_deg * normal(&mut rng);
        let of_powder: Vec<f64> =
            self.powders.iter().map(|_| self.noise.day_powder_deg * normal(&mut rng)).collect();
        for run in runs {
            let powder = &self.powders[run.powder];
            let repeat = match self.noise.kind {
                Kind::Normal => normal(&mut rng),
                Kind::HeavyTails => {
                    let chi2: f64 = (0..4).map(|_| normal(&mut rng).powi(2)).sum();
                    normal(&mut rng) / (chi2 / 4.0).sqrt() / SQRT_2
                }
                Kind::Skewed(side) => {
                    let gamma: f64 = (0..4).map(|_| -(1.0 - rng.random::<f64>()).ln()).sum();
                    side * (gamma - 4.0) / 2.0
                }
            };
            let wrong = if rng.random_bool(self.noise.outliers) {
                rng.random_range(6.0..12.0) * if rng.random() { 1.0 } else { -1.0 }
            } else {
                0.0
            };
            let scatter = self
                .noise
                .scatter
                .as_ref()
                .map_or(1.0, |(factor, strength)| (strength * (factor.at(run) - 0.5)).exp());
            let effect = self.effect_deg(run);
            let noise =
                day_deg + of_powder[run.powder] + scatter * powder.repeat_sd_deg * repeat + wrong;
            run.repose_deg = powder.mean_deg + effect + noise;
            // A powder that piles steeper flows slower; the method of measurement does not change
            // its flow.
            let material = !["method_bias", "operator", "base_friction", "funnel_height"]
                .iter()
                .any(|cause| self.truth.mechanisms.contains(cause));
            let slower = if material { FLOW_PER_DEG * effect } else { 0.0 };
            let flow_s = powder.flow_s * (slower + FLOW_SD * normal(&mut rng)).exp();
            run.values.insert("flow_time_s", rounded("flow_time_s", Value::Number(flow_s)));
        }
    }

    /// Contribution of the causes to the angle of a run, degrees.
    pub fn effect_deg(&self, run: &Run) -> f64 {
        self.terms.iter().map(|term| term.at(run)).sum()
    }

    /// Whether no batch is of one powder only.
    pub fn shares_batches(&self) -> bool {
        self.habits.parallel_batches
    }

    /// The runs as the chemist writes them down.
    pub fn csv(&self, runs: &[Run]) -> String {
        let recorded: Vec<&str> = COLUMNS
            .iter()
            .map(|column| column.name)
            .filter(|name| self.recorded.contains(name))
            .collect();
        let mut file = csv::Writer::from_writer(Vec::new());
        file.write_record(["powder", "repose_deg", "session"].iter().chain(&recorded)).unwrap();
        for run in runs {
            let mut row = vec![
                self.powders[run.powder].name.clone(),
                format!("{:.2}", run.repose_deg),
                self.session(run.day),
            ];
            row.extend(recorded.iter().map(|name| match &run.values[name] {
                _ if run.forgotten.contains(name) => String::new(),
                Value::Number(x) => x.to_string(),
                Value::Name(name) => name.clone(),
            }));
            file.write_record(&row).unwrap();
        }
        String::from_utf8(file.into_inner().unwrap()).unwrap()
    }

    fn session(&self, day: usize) -> String {
        match self.habits.first_day {
            Some(first) => date(first + (day + 2 * (day / WEEK_D)) as i64),
            None => (day + 1).to_string(),
        }
    }
}

fn rounded(name: &str, value: Value) -> Value {
    match value {
        Value::Number(x) => {
            let unit = 10f64.powi(column(name).decimals as i32);
            Value::Number((x * unit).round() / unit)
        }
        name => name,
    }
}

/// Year, month and day of a day since 1970, after Hinnant's `civil_from_days`: eras of 400 years
/// that begin in March.
fn date(day: i64) -> String {
    let z = day + 719_468;
    let (era, of_era) = (z.div_euclid(146_097), z.rem_euclid(146_097));
    let year_of_era = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let march = (5 * of_year + 2) / 153;
    let month = if march < 10 { march + 3 } else { march - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{:02}", of_year - (153 * march + 2) / 5 + 1)
}

/// A separate random stream for every purpose: an FNV-1a hash of the three is the seed.
pub fn stream(seed: u64, purpose: &str, number: usize) -> Pcg64 {
    let bytes =
        seed.to_le_bytes().into_iter().chain((number as u64).to_le_bytes()).chain(purpose.bytes());
    let step = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x100_0000_01b3);
    Pcg64::seed_from_u64(bytes.fold(0xcbf2_9ce4_8422_2325, step))
}

/// A standard normal draw (Box-Muller).
pub fn normal(rng: &mut Pcg64) -> f64 {
    let (radius, turn) = (1.0 - rng.random::<f64>(), rng.random::<f64>());
    (-2.0 * radius.ln()).sqrt() * (TAU * turn).cos()
}

/// Mean; NaN if empty.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Quantile with linear interpolation between the sorted values.
pub fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = share * (sorted.len() - 1) as f64;
    let (left, right) = (sorted[place as usize], sorted[place.ceil() as usize]);
    left + (right - left) * place.fract()
}
