//! Flow times: how long each run's powder took to run out of the funnel.

use super::campaign::{Campaign, Quantity, Run, percent};
use flip_core::domain::FieldError;

/// The campaign of the flow times, if any were measured; runs without one are kept without a value.
///
/// # Errors
/// Too few of them, or all the same: [`Campaign::checked`], reported for `flow_time_s`.
pub(crate) fn flow_times(campaign: &Campaign) -> Option<Result<Campaign, FieldError>> {
    campaign.flow_time_s.iter().any(Option::is_some).then(|| {
        let runs = campaign.runs.iter().zip(&campaign.flow_time_s);
        let runs = runs.map(|(run, time)| Run { value: time.map(percent), ..*run }).collect();
        let flow = Campaign {
            runs,
            flow_time_s: Vec::new(),
            quantity: Quantity::FlowTime,
            ..campaign.clone()
        };
        flow.checked().map_err(|error| FieldError::new("flow_time_s", error.message))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::campaign::{Covariate, Values};
    use crate::report::{Channel, Verdict};
    use crate::{Measured, Responses, Settings, investigate, screen};
    use flip_core::stats::normal;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use std::ops::ControlFlow;

    const SETTINGS: Settings = Settings { seed: 1, simulations: 99 };

    /// Twenty days, two runs of three powders each, whose angles do not depend on the day's
    /// humidity; flow is slowed by `slower` of it.
    fn campaign(seed: u64, slower: impl Fn(f64) -> f64) -> Campaign {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut normal = move || normal::quantile(rng.random::<f64>().clamp(1e-12, 1.0 - 1e-12));
        let humidity: Vec<f64> = (0..20).map(|k| 25.0 + 2.3 * f64::from(k * 7 % 20)).collect();
        let days: Vec<[f64; 2]> = (0..20).map(|_| [0.5 * normal(), 0.02 * normal()]).collect();
        let (mut runs, mut flow_time_s) = (Vec::new(), Vec::new());
        for k in 0..120 {
            let (session, powder) = (k / 6, k % 3);
            let value = Some(30.0 + 4.0 * powder as f64 + days[session][0] + 1.5 * normal());
            runs.push(Run { row: k as u32 + 2, powder, session, value });
            let log = slower(humidity[session]) + days[session][1] + 0.05 * normal();
            flow_time_s.push((k % 11 != 0).then(|| (5.0 + powder as f64) * libm::exp(log)));
        }
        let values = Values::Numbers(runs.iter().map(|run| Some(humidity[run.session])).collect());
        let covariates = vec![Covariate { name: "relative_humidity_pct".to_owned(), values }];
        let powders = ["sand", "sugar", "salt"].map(str::to_owned).to_vec();
        Campaign { powders, runs, covariates, flow_time_s, ..Campaign::default() }
            .checked()
            .unwrap()
    }

    #[test]
    fn humid_air_that_slows_the_flow_is_found_where_angles_say_nothing() {
        let slower = |humidity: f64| 0.2 * (humidity - 25.0) / 45.0;
        let document =
            investigate(Measured::angles(&campaign(1, slower)), "base", &SETTINGS, |_| {
                ControlFlow::Continue(())
            });
        let document = document.unwrap().unwrap();
        let [finding] = &document.findings[..] else { panic!("{document:?}") };
        assert_eq!(
            (finding.channel, finding.unit.as_str()),
            (Channel::FlowTime, "%"),
            "{}",
            document.sentence
        );
        // From the 5th to the 95th percentile, 27 to 67 %, flow takes exp(0.2 * 40 / 45) = 1.19
        // times as long.
        assert!(
            finding.ci95[0] < 19.0 && 19.0 < finding.ci95[1] && finding.ci95[0] > 5.0,
            "{finding:?}"
        );
        let flow = document.beside.iter().find(|it| it.channel == Channel::FlowTime).unwrap();
        assert_eq!(flow.n, 109, "the runs that have a time");
        assert!(flow.verdict != Verdict::NoDiscrepancy && document.verdict == flow.verdict);
        assert!(document.sentence.contains("flow"), "{}", document.sentence);
        assert!(
            document.p_value <= 0.05
                && document.gain.is_none()
                && document.simulator_version.extended.is_none()
        );
    }

    #[test]
    fn flow_that_does_not_depend_on_anything_is_left_alone() {
        let null = |seed| {
            let flow = flow_times(&campaign(seed, |_| 0.0)).unwrap().unwrap();
            screen(&flow, &Responses::new(), &SETTINGS).unwrap().p_value
        };
        let alarms = (0..40).filter(|&seed| null(seed) <= 0.05).count();
        // Two are expected; seven or more have a chance of 1 in 300 (binomial, 40 at 5 %).
        assert!(alarms <= 6, "{alarms} false alarms of 40");
    }

    #[test]
    fn a_few_times_are_no_reason_to_refuse_the_angles() {
        let mut few = campaign(1, |_| 0.0);
        few.flow_time_s.iter_mut().skip(5).for_each(|time| *time = None);
        let error = flow_times(&few).unwrap().unwrap_err();
        assert_eq!(error.field, "flow_time_s");
        few.flow_time_s = Vec::new();
        assert!(flow_times(&few).is_none());
        few.flow_time_s = vec![Some(1.0)];
        assert_eq!(few.checked().unwrap_err().field, "flow_time_s");
    }
}
