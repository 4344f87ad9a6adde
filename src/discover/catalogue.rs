//! The causes that FLIP knows, and how strong each is in each run of a campaign.
//!
//! | mechanism | covariate | strength, up to its size |
//! |---|---|---|
//! | `humidity` | relative humidity h | h^m, m = 1, 2, 4, 8; logistic around 50 and 60 % |
//! | `deliquescence` | h | a step at 65, 75 or 85 %; sodium chloride takes up water from 75 %, sucrose from 85 % |
//! | `charge` | h | (45 % - h)^m below 45 %, m = 1, 2 |
//! | `rest_time` | time at rest t | 1 - exp(-t / T), T = 5, 20, 60, 200 min; log(1 + t / T), T = 1, 10 min |
//! | `humid_ageing` | h, t | h^m, m = 1, 2, 4, times a function of t as above |
//! | `container_age` | days since opening a | a, sqrt a, 1 - exp(-a / 10 d) |
//! | `temperature` | T | T, exp(T / 10 K) |
//! | `vibration` | rms acceleration v | v, v^2, sqrt v |
//! | `funnel_height` | height H | log H |
//! | `order` | place in the session k | k, 1 - exp(-k / 2), 1 - exp(-k / 5) |
//! | `batch`, `method_bias`, `operator`, `base_friction` | batch, method, operator, plate | one number for each level |
//!
//! The forms are ours, a few of each kind that such a cause may have; no number in them was measured.

use super::campaign::Campaign;
use super::signature::Course;

/// Causes that look alike are claimed together first.
pub type Family = &'static str;

/// A cause that the simulator can be extended by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(missing_docs)] // The module's table says what each is.
pub enum Mechanism {
    Humidity,
    Deliquescence,
    Charge,
    RestTime,
    HumidAgeing,
    ContainerAge,
    Temperature,
    Vibration,
    FunnelHeight,
    Order,
    Batch,
    MethodBias,
    Operator,
    BaseFriction,
}

impl Mechanism {
    /// All of them.
    pub const ALL: [Self; 14] = [
        Self::Humidity,
        Self::Deliquescence,
        Self::Charge,
        Self::RestTime,
        Self::HumidAgeing,
        Self::ContainerAge,
        Self::Temperature,
        Self::Vibration,
        Self::FunnelHeight,
        Self::Order,
        Self::Batch,
        Self::MethodBias,
        Self::Operator,
        Self::BaseFriction,
    ];

    /// Name, as reports have it, and family.
    pub fn name(self) -> (&'static str, Family) {
        match self {
            Self::Humidity => ("humidity", "moisture"),
            Self::Deliquescence => ("deliquescence", "moisture"),
            Self::Charge => ("charge", "electrostatic"),
            Self::RestTime => ("rest_time", "consolidation"),
            Self::HumidAgeing => ("humid_ageing", "moisture_x_rest"),
            Self::ContainerAge => ("container_age", "ageing"),
            Self::Temperature => ("temperature", "temperature"),
            Self::Vibration => ("vibration", "vibration"),
            Self::FunnelHeight => ("funnel_height", "protocol"),
            Self::Order => ("order", "protocol"),
            Self::Batch => ("batch", "size"),
            Self::MethodBias => ("method_bias", "protocol"),
            Self::Operator => ("operator", "protocol"),
            Self::BaseFriction => ("base_friction", "protocol"),
        }
    }

    /// The covariates without which nothing can be said.
    pub fn covariates(self) -> &'static [&'static str] {
        match self {
            Self::Humidity | Self::Deliquescence | Self::Charge => &["relative_humidity_pct"],
            Self::RestTime => &["rest_min"],
            Self::HumidAgeing => &["relative_humidity_pct", "rest_min"],
            Self::ContainerAge => &["container_age_d"],
            Self::Temperature => &["temperature_c"],
            Self::Vibration => &["vibration_rms_m_s2"],
            Self::FunnelHeight => &["funnel_height_mm"],
            Self::Order => &["order_in_session"],
            Self::Batch => &["batch"],
            Self::MethodBias => &["method"],
            Self::Operator => &["operator"],
            Self::BaseFriction => &["plate"],
        }
    }

    /// Which way a cause moves the angle of repose, up (1) or down (-1), where physics says so.
    pub(super) fn sign(self) -> Option<f64> {
        match self {
            Self::Humidity | Self::Deliquescence | Self::Charge => Some(1.0),
            Self::RestTime | Self::HumidAgeing | Self::ContainerAge => Some(1.0),
            Self::Vibration | Self::FunnelHeight => Some(-1.0),
            _ => None,
        }
    }

    /// Odds before any data, over those of a plain cause: a step or a product fits what a plain cause does, and more.
    pub(super) fn prior(self) -> f64 {
        match self {
            Self::Deliquescence | Self::HumidAgeing => 0.5,
            _ => 1.0,
        }
    }

    /// What this cause may do to the runs of a campaign, one course for each form that it may have.
    ///
    /// # Errors
    /// Why this campaign cannot tell.
    pub(super) fn courses(self, campaign: &Campaign) -> Result<Vec<(String, Course)>, String> {
        let first = self.covariates()[0];
        if let Self::Batch | Self::MethodBias | Self::Operator | Self::BaseFriction = self {
            let (level, count) = campaign.levels(first)?;
            let course = Course::of_levels(&level, count, campaign);
            let named = course.map(|course| vec![(format!("one number for each {first}"), course)]);
            return named.ok_or_else(|| format!("each powder has but one {first}"));
        }
        let values = campaign.numbers(first)?;
        let strengths: Vec<(String, Vec<f64>)> = match self {
            Self::Humidity => of(&values, &HUMIDITY),
            Self::Deliquescence => of(&values, &DELIQUESCENCE),
            Self::Charge => of(&values, &CHARGE),
            Self::RestTime => of(&values, &REST),
            Self::HumidAgeing => {
                let rest = campaign.numbers("rest_min")?;
                let rests = of(&rest, &REST);
                let product = |(humid, of_humidity): (String, Vec<f64>)| {
                    let times = move |(aged, of_rest): &(String, Vec<f64>)| {
                        (format!("{humid} times {aged}"), of_humidity.iter().zip(of_rest).map(|(h, t)| h * t).collect())
                    };
                    rests.iter().map(times).collect::<Vec<_>>()
                };
                of(&values, &HUMIDITY[..3]).into_iter().flat_map(product).collect()
            }
            Self::ContainerAge => of(&values, &AGE),
            Self::Temperature => of(&values, &[("T", |t| t), ("exp(T / 10 K)", |t| (t / 10.0).exp())]),
            Self::Vibration => of(&values, &[("v", |v| v), ("v^2", |v| v * v), ("sqrt v", |v| v.max(0.0).sqrt())]),
            Self::FunnelHeight => of(&values, &[("log H", |height| height.max(1.0).ln())]),
            _ => of(&values, &ORDER),
        };
        let course = |(name, strength): (String, Vec<f64>)| Some((name, Course::of_strength(&strength, campaign)?));
        let courses: Vec<(String, Course)> = strengths.into_iter().filter_map(course).collect();
        match courses.is_empty() {
            true => Err(format!("{} has no range in which it could act", self.covariates().join(" and "))),
            false => Ok(courses),
        }
    }
}

/// A form's name, and the form.
type Form = (&'static str, fn(f64) -> f64);

/// Relative humidity in percent, h = 1 at 100 %.
const HUMIDITY: [Form; 6] = [
    ("h", |h| h / 100.0),
    ("h^2", |h| (h / 100.0).powi(2)),
    ("h^4", |h| (h / 100.0).powi(4)),
    ("h^8", |h| (h / 100.0).powi(8)),
    ("a rise around 50 %", |h| step(h, 50.0, 5.0)),
    ("a rise around 60 %", |h| step(h, 60.0, 5.0)),
];
const DELIQUESCENCE: [Form; 3] = [
    ("a step at 65 %", |h| step(h, 65.0, 1.0)),
    ("a step at 75 %", |h| step(h, 75.0, 1.0)),
    ("a step at 85 %", |h| step(h, 85.0, 1.0)),
];
const CHARGE: [Form; 2] = [
    ("45 % - h below 45 %", |h| (0.45 - h / 100.0).max(0.0)),
    ("(45 % - h)^2 below 45 %", |h| (0.45 - h / 100.0).max(0.0).powi(2)),
];
/// Minutes.
const REST: [Form; 6] = [
    ("1 - exp(-t / 5 min)", |t| 1.0 - (-t / 5.0).exp()),
    ("1 - exp(-t / 20 min)", |t| 1.0 - (-t / 20.0).exp()),
    ("1 - exp(-t / 60 min)", |t| 1.0 - (-t / 60.0).exp()),
    ("1 - exp(-t / 200 min)", |t| 1.0 - (-t / 200.0).exp()),
    ("log(1 + t / 1 min)", |t| t.max(0.0).ln_1p()),
    ("log(1 + t / 10 min)", |t| (t.max(0.0) / 10.0).ln_1p()),
];
/// Days.
const AGE: [Form; 3] =
    [("a", |a| a), ("sqrt a", |a| a.max(0.0).sqrt()), ("1 - exp(-a / 10 d)", |a| 1.0 - (-a / 10.0).exp())];
const ORDER: [Form; 3] =
    [("k", |k| k), ("1 - exp(-k / 2)", |k| 1.0 - (-k / 2.0).exp()), ("1 - exp(-k / 5)", |k| 1.0 - (-k / 5.0).exp())];

fn step(at: f64, middle: f64, width: f64) -> f64 {
    1.0 / (1.0 + ((middle - at) / width).exp())
}

fn of(values: &[f64], forms: &[Form]) -> Vec<(String, Vec<f64>)> {
    forms.iter().map(|(name, form)| ((*name).to_owned(), values.iter().map(|&value| form(value)).collect())).collect()
}
