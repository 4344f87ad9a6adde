//! Judges angles of repose, flow times, balance readings and spoons together: each channel by itself,
//! with p-values corrected for multiple channels ([`holm`]).
//!
//! With nothing wrong in any channel, one is found in at most 5 % of investigations; a finding in
//! one does not cost the others their level again. Scatter of repeats is reported alongside and
//! decides nothing: the simulator makes no prediction of it, and under the null it may take any
//! form.

pub(crate) mod angles;
mod channel;
mod holm;
mod merge;
pub mod numerics;
mod scatter;
mod side;
mod steps;
mod words;

use crate::causes::follows;
use crate::causes::response::{Responses, responses};
use crate::data::campaign::Campaign;
use crate::data::flow::flow_times;
use crate::judge::prepared::Prepared;
use crate::judge::screen::Settings;
use crate::report::spoon::SpoonReport;
use crate::report::{ColumnLeftOut, NullCheck, Report};
use crate::traces::report::report;
use crate::traces::{self, TraceScreening, Traces, screen_traces};
use angles::angles;
use channel::Channel;
use flip_core::domain::FieldError;
use flip_core::domain::job::Progress;
use holm::{holm, without};
use merge::{add, add_spoon, add_traces};
use side::heard;
use std::ops::ControlFlow;
use steps::{Halt, Steps};

/// Share of the work spent on balance readings, and share of the rest spent on flow times.
const TRACES_SHARE: f64 = 0.3;
const FLOW_SHARE: f64 = 0.2;

/// What was measured. Nothing by default.
#[derive(Debug, Clone, Default)]
pub struct Measured<'a> {
    /// Angles of repose, and what was recorded with them.
    pub campaign: Option<&'a Campaign>,
    /// Balance readings of weighings.
    pub traces: Option<&'a Traces>,
    /// What [`judge_spoon`](crate::spoon::judge_spoon) says of weighings, corrected for
    /// [`Measured::channels`].
    pub spoon: Option<SpoonReport>,
}

impl<'a> Measured<'a> {
    /// Angles alone.
    pub fn angles(campaign: &'a Campaign) -> Self {
        Self { campaign: Some(campaign), ..Self::default() }
    }

    /// Most channels that are judged with these data, a spoon's not included: angles, flow times,
    /// balance readings.
    pub fn channels(&self) -> u32 {
        let has_flow = |campaign: &Campaign| flow_times(campaign).is_some();
        let of_campaign = self.campaign.map_or(0, |it| 1 + u32::from(has_flow(it)));
        of_campaign + u32::from(self.traces.is_some())
    }
}

/// Investigates whatever was measured.
///
/// | argument | meaning |
/// |----------|---------|
/// | `base` | version of the simulator that is judged |
/// | `on_progress` | receives progress; `Break` stops, and there is no report |
///
/// # Errors
/// A setting out of bounds; a campaign whose runs, or traces whose readings, cannot be judged;
/// nothing given.
pub fn investigate(
    measured: Measured<'_>,
    base: &str,
    settings: &Settings,
    mut on_progress: impl FnMut(&Progress) -> ControlFlow<()>,
) -> Result<Option<Report>, FieldError> {
    let settings = settings.checked()?;
    let mut steps = Steps::new(&mut on_progress);
    let Measured { campaign, traces, spoon } = measured;
    let of_spoon = spoon.as_ref().map(|it| it.p_value);
    let document = match (campaign, traces, of_spoon) {
        (Some(campaign), traces, _) => {
            of_campaign(campaign, traces, of_spoon, base, &settings, &mut steps)
        }
        (None, Some(traces), _) => of_traces(traces, of_spoon, base, &settings, &mut steps),
        (None, None, Some(p)) => Ok(Report::blank(base, p, NullCheck::of(&[], f64::NEG_INFINITY))),
        (None, None, None) => {
            let advice = "or traces or shakes are needed: there is nothing to judge";
            Err(FieldError::new("measurements", advice).into())
        }
    };
    match document {
        Ok(mut document) => {
            if let Some(spoon) = spoon {
                document.p_value = document.p_value.min(spoon.p_value);
                add_spoon(&mut document, spoon);
            }
            Ok(Some(document))
        }
        Err(Halt::Stopped) => Ok(None),
        Err(Halt::Refused(error)) => Err(error),
    }
}

/// The document of balance readings without angles.
fn of_traces(
    traces: &Traces,
    of_spoon: Option<f64>,
    base: &str,
    settings: &Settings,
    steps: &mut Steps<'_>,
) -> Result<Report, Halt> {
    let screening = screened(traces, settings, steps)?;
    let null_check = NullCheck::of(&screening.null, screening.statistic);
    let p = holm(screening.p_value, of_spoon.as_slice());
    let mut document = Report::blank(base, p, null_check);
    add_traces(&mut document, report(traces, &screening, p));
    Ok(document)
}

fn screened(
    traces: &Traces,
    &Settings { seed, simulations }: &Settings,
    steps: &mut Steps<'_>,
) -> Result<TraceScreening, Halt> {
    steps.begin(0.0, "judging balance readings, here and where nothing is wrong")?;
    Ok(screen_traces(traces, &traces::Settings { seed, simulations })?)
}

/// The document of a campaign, with balance readings if there are any: every channel is screened by
/// itself, and concluded by a p-value that is corrected for the others. `of_spoon` is the spoon's,
/// which is corrected already and corrected here once more: the document keeps the smaller.
fn of_campaign(
    campaign: &Campaign,
    traces: Option<&Traces>,
    of_spoon: Option<f64>,
    base: &str,
    settings: &Settings,
    steps: &mut Steps<'_>,
) -> Result<Report, Halt> {
    let mut done = 0.0;
    let mut readings = None;
    if let Some(traces) = traces {
        readings = Some((traces, screened(traces, settings, steps)?));
        done = TRACES_SHARE;
    }
    let (campaign, mut left_out) = follows::without(campaign);
    let none = Responses::new();
    let (flow, silent) = match prepared_flow(&campaign, &mut left_out) {
        Some(Ok(flow)) => (Some(flow), None),
        // Flow times that cannot be judged are no reason to refuse the angles.
        Some(Err(error)) => (None, Some(error)),
        None => (None, None),
    };
    let mut timed = None;
    if let Some((flow, prepared)) = &flow {
        steps.begin(done, "judging flow times, here and where nothing is wrong")?;
        let nobody_stops = |_| ControlFlow::Continue(());
        timed = Some(Channel::screened(flow, &none, prepared, settings, nobody_stops)?);
        done += (1.0 - done) * FLOW_SHARE;
    }
    // Readings of which nothing was judged cost the other channels nothing.
    let of_readings = readings.as_ref().map(|it| &it.1).filter(|it| !it.judged.is_empty());
    let of_flow = timed.as_ref().map(|channel| channel.screening.p_value);
    let others = of_readings.map(|it| it.p_value).into_iter().chain(of_flow).chain(of_spoon);
    let others: Vec<f64> = others.collect();
    let corrected = |p: f64| holm(p, &others);
    let responses = responses(&campaign);
    let mut rest = steps.after(done);
    let mut document = angles(&campaign, &responses, base, settings, corrected, &mut rest)?;
    document.left_out = left_out;
    // Nor do angles of which nothing was judged.
    let own = Some(document.p_value).filter(|_| document.null_check.is_judged());
    let all: Vec<f64> = own.into_iter().chain(others).collect();
    let corrected = |p: f64| holm(p, &without(&all, p));
    document.p_value = all.iter().map(|&p| corrected(p)).fold(1.0, f64::min);
    if let Some(channel) = timed {
        let (heard, side) = heard(&channel, corrected(channel.screening.p_value), settings)?;
        add(&mut document, heard);
        document.beside.push(side);
    }
    if let Some(error) = silent {
        document.blind_spots.push(format!("Flow times: {}.", error.message));
    }
    if let Some((traces, screening)) = readings {
        add_traces(&mut document, report(traces, &screening, corrected(screening.p_value)));
    }
    let left_out = words::left_out(&document.left_out);
    document.sentence = [document.sentence, left_out].join(" ").trim_end().to_owned();
    Ok(document)
}

/// Flow times without the columns that follow from them, ready to be judged; `None` if none were
/// measured.
fn prepared_flow(
    campaign: &Campaign,
    left_out: &mut Vec<ColumnLeftOut>,
) -> Option<Result<(Campaign, Prepared), FieldError>> {
    let prepared = |flow: Campaign| {
        let (flow, of_flow) = follows::without(&flow);
        left_out.extend(of_flow);
        let prepared = Prepared::new(&flow, &Responses::new())?;
        match prepared.hypotheses.is_empty() {
            true => Err(FieldError::new("flow_time_s", words::unjudged(flow.sessions()))),
            false => Ok((flow, prepared)),
        }
    };
    Some(flow_times(campaign)?.and_then(prepared))
}

#[cfg(test)]
mod tests;
