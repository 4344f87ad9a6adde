//! The causes FLIP knows, and how strong each is in each run of a campaign.
//!
//! | mechanism | covariate | strength, up to its size |
//! |---|---|---|
//! | `humidity` | relative humidity h | h^m, m = 1, 2, 4, 8; a rise around 40, 50 and 60 % |
//! | `deliquescence` | h | a step from 60 to 85 % in powders that may dissolve; sodium chloride takes up water from 75 %, sucrose from 85 % |
//! | `charge` | h, ioniser | (45 % - h)^m below 45 %, m = 1, 2, and with a limit; nothing where an ioniser is on |
//! | `rest_time` | time at rest t | 1 - exp(-t / T), T = 5, 20, 60, 200 min; log(1 + t / T), T = 1, 10 min; a rise around 20 and 80 min |
//! | `humid_ageing` | h, t | 1 / log(1 / h), h^m, m = 2, 4, or h beyond 30 %, times a function of t as above |
//! | `container_age` | days since opening a | a, sqrt a, 1 - exp(-a / T), T = 3, 10 d; a rise around 7 d |
//! | `temperature` | T | T, exp(T / 10 K); a rise around 20, 23 and 26 deg C |
//! | `vibration` | rms acceleration v | v, v^2, sqrt v, v / (v + V), V = 0.02, 0.1 m/s^2 |
//! | `funnel_height` | height H | log H, H, H^2, -1 / H; a rise around 60 mm |
//! | `order` | place in the session k | k, k^2, 1 - exp(-k / 2), 1 - exp(-k / 5) |
//! | `batch`, `method_bias`, `operator`, `base_friction` | batch, method, operator, plate | one number for each level |
//!
//! The forms are ours: for each kind, some grow ever faster, some approach a limit, and some rise
//! in the middle. None of their numbers was measured.

use super::signature::Course;
use crate::data::campaign::{Campaign, Quantity, Values};

/// Causes that look alike are claimed together first.
pub type Family = &'static str;

/// A cause the simulator can be extended by.
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
    /// Every mechanism.
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

    /// Name used in reports, and family.
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

    /// The covariates it needs to be judged at all.
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

    /// Whether it can affect this quantity at all. Powder running out of a funnel does not depend
    /// on how a heap is viewed, what it lies on or how far it fell; the simulator makes no
    /// prediction of scatter, so scatter has no causes.
    pub(crate) fn moves(self, quantity: Quantity) -> bool {
        match quantity {
            Quantity::Repose => true,
            Quantity::FlowTime => {
                !matches!(self, Self::MethodBias | Self::BaseFriction | Self::FunnelHeight)
            }
            Quantity::Scatter => false,
        }
    }

    /// Direction in which a cause moves the angle of repose, up (1) or down (-1), where physics
    /// fixes it.
    pub(crate) fn sign(self) -> Option<f64> {
        match self {
            Self::Humidity | Self::Deliquescence | Self::Charge => Some(1.0),
            Self::RestTime | Self::HumidAgeing | Self::ContainerAge => Some(1.0),
            Self::Vibration | Self::FunnelHeight => Some(-1.0),
            _ => None,
        }
    }

    /// The forms of its first covariate, if that is numeric.
    fn forms(self) -> &'static [Form] {
        match self {
            Self::Humidity => &HUMIDITY,
            Self::HumidAgeing => &HUMID,
            Self::Deliquescence => &DELIQUESCENCE,
            Self::Charge => &CHARGE,
            Self::RestTime => &REST,
            Self::ContainerAge => &AGE,
            Self::Temperature => &TEMPERATURE,
            Self::Vibration => &VIBRATION,
            Self::FunnelHeight => &HEIGHT,
            Self::Order => &ORDER,
            Self::Batch | Self::MethodBias | Self::Operator | Self::BaseFriction => &[],
        }
    }

    /// Its strength by the named form at these covariate values; `None` if it has no such form.
    pub(crate) fn strength(self, form: &str, values: &[f64]) -> Option<f64> {
        let at = |forms: &[Form], name: &str, value: f64| {
            Some(forms.iter().find(|form| form.0 == name)?.1(value))
        };
        match (self, form.split_once(TIMES), values) {
            (Self::HumidAgeing, Some((humid, aged)), [h, t]) => {
                Some(at(&HUMID, humid, *h)? * at(&REST, aged, *t)?)
            }
            (_, None, [value]) => at(self.forms(), form, *value),
            _ => None,
        }
    }

    /// The possible effect of this cause on the runs of a campaign, one course for each form.
    ///
    /// # Errors
    /// Why this campaign cannot tell.
    pub(crate) fn courses(self, campaign: &Campaign) -> Result<Vec<(String, Course)>, String> {
        let first = self.covariates()[0];
        if let Self::Batch | Self::MethodBias | Self::Operator | Self::BaseFriction = self {
            let (level, count) = campaign.levels(first)?;
            let course = Course::of_levels(&level, count, campaign);
            let named = course.map(|course| vec![(format!("one number for each {first}"), course)]);
            return named.ok_or_else(|| format!("each powder has but one {first}"));
        }
        let values = campaign.numbers(first)?;
        let strengths: Vec<(String, Vec<f64>)> = match self {
            Self::Deliquescence => but_not(of(&values, self.forms()), &insoluble(campaign)),
            Self::Charge => but_not(of(&values, self.forms()), &ionised(campaign)),
            Self::HumidAgeing => {
                let rest = campaign.numbers("rest_min")?;
                let rests = of(&rest, &REST);
                let product = |(humid, of_humidity): (String, Vec<f64>)| {
                    let times = move |(aged, of_rest): &(String, Vec<f64>)| {
                        (
                            format!("{humid}{TIMES}{aged}"),
                            of_humidity.iter().zip(of_rest).map(|(h, t)| h * t).collect(),
                        )
                    };
                    rests.iter().map(times).collect::<Vec<_>>()
                };
                of(&values, &HUMID).into_iter().flat_map(product).collect()
            }
            _ => of(&values, self.forms()),
        };
        let course = |(name, strength): (String, Vec<f64>)| {
            Some((name, Course::of_strength(&strength, campaign)?))
        };
        let courses: Vec<(String, Course)> = strengths.into_iter().filter_map(course).collect();
        match courses.is_empty() {
            true => Err(format!(
                "{} has no range in which it could act",
                self.covariates().join(" and ")
            )),
            false => Ok(courses),
        }
    }
}

/// Joins the names of forms that are multiplied.
const TIMES: &str = " times ";

/// A form's name, and the form.
type Form = (&'static str, fn(f64) -> f64);

/// Relative humidity in percent, h = 1 at 100 %.
const HUMIDITY: [Form; 7] = [
    ("h", |h| h / 100.0),
    ("h^2", |h| (h / 100.0).powi(2)),
    ("h^4", |h| (h / 100.0).powi(4)),
    ("h^8", |h| (h / 100.0).powi(8)),
    ("a rise around 40 %", |h| step(h, 40.0, 5.0)),
    ("a rise around 50 %", |h| step(h, 50.0, 5.0)),
    ("a rise around 60 %", |h| step(h, 60.0, 5.0)),
];
/// Factor on age: all are small in dry air, otherwise ageing would be rest.
const HUMID: [Form; 4] = [
    ("1 / log(1 / h)", |h| 1.0 / (100.0 / h.clamp(1.0, 99.0)).ln()),
    ("h^2", |h| (h / 100.0).powi(2)),
    ("h^4", |h| (h / 100.0).powi(4)),
    ("h - 30 % above 30 %", |h| (h / 100.0 - 0.3).max(0.0)),
];
const DELIQUESCENCE: [Form; 6] = [
    ("a step at 60 %", |h| step(h, 60.0, 1.0)),
    ("a step at 65 %", |h| step(h, 65.0, 1.0)),
    ("a step at 70 %", |h| step(h, 70.0, 1.0)),
    ("a step at 75 %", |h| step(h, 75.0, 1.0)),
    ("a step at 80 %", |h| step(h, 80.0, 1.0)),
    ("a step at 85 %", |h| step(h, 85.0, 1.0)),
];
const CHARGE: [Form; 3] = [
    ("45 % - h below 45 %", |h| (0.45 - h / 100.0).max(0.0)),
    ("(45 % - h)^2 below 45 %", |h| (0.45 - h / 100.0).max(0.0).powi(2)),
    ("1 - exp(-(45 % - h) / 5 %) below 45 %", |h| {
        1.0 - (-(0.45 - h / 100.0).max(0.0) / 0.05).exp()
    }),
];
/// Minutes.
const REST: [Form; 8] = [
    ("1 - exp(-t / 5 min)", |t| 1.0 - (-t / 5.0).exp()),
    ("1 - exp(-t / 20 min)", |t| 1.0 - (-t / 20.0).exp()),
    ("1 - exp(-t / 60 min)", |t| 1.0 - (-t / 60.0).exp()),
    ("1 - exp(-t / 200 min)", |t| 1.0 - (-t / 200.0).exp()),
    ("log(1 + t / 1 min)", |t| t.max(0.0).ln_1p()),
    ("log(1 + t / 10 min)", |t| (t.max(0.0) / 10.0).ln_1p()),
    ("a rise around 20 min", |t| t * t / (t * t + 400.0)),
    ("a rise around 80 min", |t| t * t / (t * t + 6400.0)),
];
/// Days.
const AGE: [Form; 5] = [
    ("a", |a| a),
    ("sqrt a", |a| a.max(0.0).sqrt()),
    ("1 - exp(-a / 3 d)", |a| 1.0 - (-a / 3.0).exp()),
    ("1 - exp(-a / 10 d)", |a| 1.0 - (-a / 10.0).exp()),
    ("a rise around 7 d", |a| a * a / (a * a + 49.0)),
];
/// Degrees Celsius.
const TEMPERATURE: [Form; 5] = [
    ("T", |t| t),
    ("exp(T / 10 K)", |t| (t / 10.0).exp()),
    ("a rise around 20 deg C", |t| step(t, 20.0, 1.0)),
    ("a rise around 23 deg C", |t| step(t, 23.0, 1.0)),
    ("a rise around 26 deg C", |t| step(t, 26.0, 1.0)),
];
/// m/s^2.
const VIBRATION: [Form; 5] = [
    ("v", |v| v),
    ("v^2", |v| v * v),
    ("sqrt v", |v| v.max(0.0).sqrt()),
    ("v / (v + 0.02 m/s^2)", |v| v.max(0.0) / (v.max(0.0) + 0.02)),
    ("v / (v + 0.1 m/s^2)", |v| v.max(0.0) / (v.max(0.0) + 0.1)),
];
/// Millimetres.
const HEIGHT: [Form; 5] = [
    ("log H", |height| height.max(1.0).ln()),
    ("H", |height| height),
    ("H^2", |height| height * height),
    ("-1 / H", |height| -1.0 / height.max(1.0)),
    ("a rise around 60 mm", |height| step(height, 60.0, 6.0)),
];
const ORDER: [Form; 4] = [
    ("k", |k| k),
    ("k^2", |k| k * k),
    ("1 - exp(-k / 2)", |k| 1.0 - (-k / 2.0).exp()),
    ("1 - exp(-k / 5)", |k| 1.0 - (-k / 5.0).exp()),
];

fn step(at: f64, middle: f64, width: f64) -> f64 {
    1.0 / (1.0 + ((middle - at) / width).exp())
}

fn of(values: &[f64], forms: &[Form]) -> Vec<(String, Vec<f64>)> {
    forms
        .iter()
        .map(|(name, form)| ((*name).to_owned(), values.iter().map(|&value| form(value)).collect()))
        .collect()
}

/// The same strengths, zero in these runs.
fn but_not(mut strengths: Vec<(String, Vec<f64>)>, runs: &[usize]) -> Vec<(String, Vec<f64>)> {
    strengths.iter_mut().for_each(|(_, strength)| runs.iter().for_each(|&i| strength[i] = 0.0));
    strengths
}

/// Runs of powders that do not dissolve at any laboratory humidity.
fn insoluble(campaign: &Campaign) -> Vec<usize> {
    (0..campaign.runs.len()).filter(|&i| !campaign.may_dissolve(campaign.runs[i].powder)).collect()
}

/// Runs with an ioniser, which removes charge; where none was recorded there was none.
fn ionised(campaign: &Campaign) -> Vec<usize> {
    match campaign.values("ioniser_on") {
        Some(Values::Levels { names, of }) => {
            let on = |level: Option<usize>| level.is_some_and(|level| names[level] == "yes");
            (0..of.len()).filter(|&i| on(of[i])).collect()
        }
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powders_that_do_not_dissolve_cannot_deliquesce() {
        let mut campaign = crate::data::sample::campaign(1, |_| 0.0);
        let insoluble = |campaign: &Campaign| -> Vec<usize> {
            let runs = insoluble(campaign);
            (0..2).filter(|&p| runs.iter().any(|&i| campaign.runs[i].powder == p)).collect()
        };
        // Sand is known not to, salt to; of quartz nothing is known until a laboratory says so.
        assert_eq!(insoluble(&campaign), [0]);
        campaign.powders[0] = "quartz".to_owned();
        assert!(insoluble(&campaign).is_empty());
        campaign.soluble = [("quartz".to_owned(), false), ("salt".to_owned(), false)].into();
        assert_eq!(insoluble(&campaign), [0, 1]);
        assert!(Mechanism::Deliquescence.courses(&campaign).is_err());
    }

    #[test]
    fn how_a_heap_is_poured_and_read_does_not_change_how_powder_runs_out() {
        use Mechanism::{BaseFriction, FunnelHeight, MethodBias};
        let moving = |quantity| Mechanism::ALL.into_iter().filter(move |it| it.moves(quantity));
        assert_eq!(moving(Quantity::Repose).count(), Mechanism::ALL.len());
        let of_heaps: Vec<Mechanism> =
            Mechanism::ALL.into_iter().filter(|it| !it.moves(Quantity::FlowTime)).collect();
        assert_eq!(of_heaps, [FunnelHeight, MethodBias, BaseFriction]);
        assert_eq!(moving(Quantity::Scatter).count(), 0);
    }
}
