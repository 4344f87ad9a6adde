//! Turns readings into the judged quantities: plateaus between shakes, rows of averaged readings,
//! masses of shakes, scatter.
//!
//! The design is fixed, readings are not: each function that takes `shown` computes the same
//! statistic for measured and simulated readings.

use super::readings::{Kind, Reading, Traces, Weighing};
use flip_core::stats::summary::mean;
use std::ops::Range;

/// Most rows a plateau is averaged to, in doses and in controls; early readings are averaged least.
const ROWS_MAX: [usize; 2] = [6, 24];
/// Most readings of a plateau that are used, in doses and in controls; beyond that, every second,
/// third and so on.
const READINGS_MAX: [usize; 2] = [40, 600];
/// Step of a standard's log that counts as a mass put on the pan, over the usual change between
/// readings and over a third of the display's step.
const STEP_MIN: f64 = 8.0;
/// Number of readings that settled ones are compared with.
const SETTLED_READINGS: usize = 5;
/// Share of doses that begin at zero, from which on their first readings are those before the first
/// shake.
const TARED_SHARE: f64 = 0.8;

/// One weighing as it is judged.
#[derive(Debug, Clone)]
pub(super) struct Log {
    pub kind: Kind,
    /// Indices of its powder and of its session.
    pub powder: usize,
    pub session: usize,
    /// Range in [`Design::plateaus`].
    pub plateaus: Range<usize>,
}

/// Readings between two shakes.
#[derive(Debug, Clone)]
pub(super) struct Plateau {
    pub log: usize,
    /// Range in [`Design::times_s`].
    pub readings: Range<usize>,
    /// When the mass fell: between the last reading before and the first after, as near to the
    /// latter as the spacing of readings.
    pub step_s: f64,
    pub shake: Option<u32>,
    pub shake_mm: Option<f64>,
    pub pitch_deg: Option<f64>,
    pub fill_mg: Option<f64>,
    pub humidity_pct: Option<f64>,
    pub vibration: Option<f64>,
}

/// Averaged readings of one plateau.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub plateau: usize,
    pub readings: Range<usize>,
    pub t_s: f64,
}

/// The mass of one shake.
#[derive(Debug, Clone)]
pub(super) struct Shake {
    pub log: usize,
    /// `None` if the pan was tared before.
    pub before: Option<usize>,
    pub after: usize,
    /// Number of shakes up to and including it.
    pub number: f64,
}

/// The design of all readings.
#[derive(Debug, Clone)]
pub(super) struct Design {
    pub logs: Vec<Log>,
    pub plateaus: Vec<Plateau>,
    pub rows: Vec<Row>,
    pub shakes: Vec<Shake>,
    /// Time of each reading since the first of its log, s.
    pub times_s: Vec<f64>,
    /// As measured, mg.
    pub shown_mg: Vec<f64>,
    /// Step of the display, mg; 0 if it has none.
    pub readability_mg: f64,
    /// Doses that were left out because their shakes were not counted.
    pub uncounted: usize,
}

impl Design {
    /// The design of checked traces.
    pub fn new(traces: &Traces) -> Self {
        let names = |of: &dyn Fn(&Weighing) -> String| {
            let mut all: Vec<String> = traces.weighings.iter().map(of).collect();
            all.sort();
            all.dedup();
            move |name: &String| all.binary_search(name).unwrap_or(0)
        };
        // A dose of unknown powder gets a powder of its own.
        let own = |weighing: &Weighing| {
            if weighing.kind == Kind::Dose { format!("?{}", weighing.id) } else { String::new() }
        };
        let powder_of =
            |weighing: &Weighing| weighing.powder.clone().unwrap_or_else(|| own(weighing));
        let session_of = |weighing: &Weighing| weighing.session.clone().unwrap_or_default();
        let (powder, session) = (names(&powder_of), names(&session_of));
        let mut new = Self {
            logs: Vec::new(),
            plateaus: Vec::new(),
            rows: Vec::new(),
            shakes: Vec::new(),
            times_s: Vec::new(),
            shown_mg: Vec::new(),
            readability_mg: readability(traces),
            uncounted: 0,
        };
        for weighing in &traces.weighings {
            let Some(parts) = parts(weighing, new.readability_mg) else {
                new.uncounted += 1;
                continue;
            };
            let first = new.plateaus.len();
            parts.into_iter().for_each(|part| new.push(weighing, part, first));
            let plateaus = first..new.plateaus.len();
            if !plateaus.is_empty() {
                let (powder, session) =
                    (powder(&powder_of(weighing)), session(&session_of(weighing)));
                new.logs.push(Log { kind: weighing.kind, powder, session, plateaus });
            }
        }
        new.shakes = new.find_shakes();
        new
    }

    fn push(&mut self, weighing: &Weighing, part: Range<usize>, first: usize) {
        let is_control = usize::from(weighing.kind != Kind::Dose);
        let stride = part.len().div_ceil(READINGS_MAX[is_control]);
        let readings: Vec<&Reading> = weighing.readings[part].iter().step_by(stride).collect();
        let from = self.times_s.len();
        let start_s = weighing.readings[0].t_s;
        self.times_s.extend(readings.iter().map(|reading| reading.t_s - start_s));
        self.shown_mg.extend(readings.iter().map(|reading| reading.balance_mg));
        let plateau = self.plateaus.len();
        let times = &self.times_s[from..];
        let apart = (times[times.len() - 1] - times[0]) / (times.len() - 1).max(1) as f64;
        let gap = if plateau > first { times[0] - self.times_s[from - 1] } else { 0.0 };
        let step_s = times[0] - if apart > 0.0 { gap.min(apart) } else { gap / 2.0 };
        let known = |of: &dyn Fn(&Reading) -> Option<f64>| {
            mean(&readings.iter().copied().filter_map(of).collect::<Vec<_>>())
        };
        self.plateaus.push(Plateau {
            log: self.logs.len(),
            readings: from..from + readings.len(),
            step_s,
            shake: readings[0].shake_index,
            shake_mm: known(&|reading| reading.shake_mm),
            pitch_deg: known(&|reading| reading.spoon_pitch_deg),
            fill_mg: known(&|reading| reading.spoon_fill_mg),
            humidity_pct: known(&|reading| reading.relative_humidity_pct),
            vibration: known(&|reading| reading.vibration_rms_m_s2),
        });
        let (n, rows_max) = (readings.len(), ROWS_MAX[is_control]);
        let mut low = 0;
        for k in 1..=rows_max.min(n) {
            let share = (k as f64 / rows_max as f64).powf(1.5);
            let high =
                if n <= rows_max { k } else { ((n as f64 * share).round() as usize).max(low + 1) };
            let t_s =
                self.times_s[from + low..from + high].iter().sum::<f64>() / (high - low) as f64;
            self.rows.push(Row { plateau, readings: from + low..from + high, t_s });
            low = high;
        }
    }

    /// Shakes between counted plateaus of doses. If nearly all doses begin at zero, that was before
    /// the first shake, whatever its number.
    fn find_shakes(&self) -> Vec<Shake> {
        let doses: Vec<&Log> = self.logs.iter().filter(|log| log.kind == Kind::Dose).collect();
        let levels = self.levels(&self.shown_mg);
        let (noise, typical) =
            (self.readability_mg.max(4.0 * self.reading_sd()), typical_step(&doses, &levels));
        let tared = |log: &&&Log| levels[log.plateaus.start].abs() <= noise.max(0.05 * typical);
        let starts = doses.iter().filter(tared).count() as f64 >= TARED_SHARE * doses.len() as f64;
        let mut shakes = Vec::new();
        for log in doses {
            let first = &self.plateaus[log.plateaus.start];
            let is_before = starts || first.shake == Some(0);
            // A pan whose first reading exceeded a few shakes was not tared.
            let is_tared = levels[log.plateaus.start].abs() <= 5.0 * typical + noise;
            if !is_before && first.shake == Some(1) && is_tared {
                shakes.push(Shake {
                    log: first.log,
                    before: None,
                    after: log.plateaus.start,
                    number: 1.0,
                });
            }
            let offset = if starts { first.shake.unwrap_or(0) } else { 0 };
            for after in log.plateaus.clone().skip(1) {
                let pair = (self.plateaus[after - 1].shake, self.plateaus[after].shake);
                if let (Some(before), Some(now)) = pair
                    && now == before + 1
                {
                    let number = f64::from(now - offset.min(now));
                    shakes.push(Shake { log: first.log, before: Some(after - 1), after, number });
                }
            }
        }
        shakes
    }

    /// Whether `of` returns a value for at least half of the plateaus that end a shake.
    pub fn knows(&self, of: impl Fn(&Plateau) -> Option<f64>) -> bool {
        let known =
            self.shakes.iter().filter(|shake| of(&self.plateaus[shake.after]).is_some()).count();
        known > 0 && 2 * known >= self.shakes.len()
    }

    /// Number of powders and of sessions.
    pub fn counts(&self) -> (usize, usize) {
        let most =
            |of: &dyn Fn(&Log) -> usize| self.logs.iter().map(of).max().map_or(0, |last| last + 1);
        (most(&|log| log.powder), most(&|log| log.session))
    }

    /// Mean of each row, mg.
    pub fn averaged(&self, shown: &[f64]) -> Vec<f64> {
        let of =
            |row: &Row| shown[row.readings.clone()].iter().sum::<f64>() / row.readings.len() as f64;
        self.rows.iter().map(of).collect()
    }

    /// Final level of each plateau: the mean of the later half of its readings, mg.
    pub fn levels(&self, shown: &[f64]) -> Vec<f64> {
        let of = |plateau: &Plateau| {
            let late =
                &shown[plateau.readings.start + plateau.readings.len() / 2..plateau.readings.end];
            late.iter().sum::<f64>() / late.len() as f64
        };
        self.plateaus.iter().map(of).collect()
    }

    /// Mass of each shake, mg.
    pub fn masses(&self, shown: &[f64]) -> Vec<f64> {
        let levels = self.levels(shown);
        self.shakes
            .iter()
            .map(|shake| levels[shake.after] - shake.before.map_or(0.0, |k| levels[k]))
            .collect()
    }

    /// Variance of a reading within each plateau from differences of neighbours, which slow changes
    /// do not affect, mg^2; `None` with fewer than 3.
    pub fn scatter(&self, shown: &[f64]) -> Vec<Option<f64>> {
        let of = |plateau: &Plateau| {
            let readings = &shown[plateau.readings.clone()];
            let squares: f64 = readings.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
            (readings.len() >= 3).then(|| 0.5 * squares / (readings.len() - 1) as f64)
        };
        self.plateaus.iter().map(of).collect()
    }

    /// SD of a reading, display included, mg: from differences of neighbours in the later half of
    /// plateaus, where relaxation has ended.
    pub fn reading_sd(&self) -> f64 {
        let (mut squares, mut count) = (0.0, 0);
        for plateau in &self.plateaus {
            let late = &self.shown_mg
                [plateau.readings.start + plateau.readings.len() / 2..plateau.readings.end];
            squares += late.windows(2).map(|pair| 0.5 * (pair[1] - pair[0]).powi(2)).sum::<f64>();
            count += late.len() - 1;
        }
        (squares / f64::from(count.max(1) as u32)).sqrt()
    }
}

fn typical_step(doses: &[&Log], levels: &[f64]) -> f64 {
    let steps = doses
        .iter()
        .flat_map(|log| levels[log.plateaus.clone()].windows(2).map(|pair| pair[1] - pair[0]));
    let mut all: Vec<f64> = steps.map(f64::abs).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(0.0)
}

/// Where a weighing's plateaus are: by the count of shakes, in a control without one by its large
/// steps; `None` for a dose without.
fn parts(weighing: &Weighing, readability_mg: f64) -> Option<Vec<Range<usize>>> {
    let readings = &weighing.readings;
    let is_counted = readings.iter().all(|reading| reading.shake_index.is_some());
    let is_split: Vec<bool> = match (is_counted, weighing.kind) {
        (true, Kind::Dose) => {
            readings.windows(2).map(|pair| pair[0].shake_index != pair[1].shake_index).collect()
        }
        (false, Kind::Dose) => return None,
        (_, Kind::Zero) => vec![false; readings.len()],
        (_, Kind::Standard) => steps(readings, readability_mg),
    };
    let mut ends: Vec<usize> =
        is_split.iter().enumerate().filter(|(_, split)| **split).map(|(k, _)| k + 1).collect();
    ends.extend((!readings.is_empty()).then_some(readings.len()));
    let starts = std::iter::once(0).chain(ends.iter().copied());
    let parts = starts.zip(&ends).map(|(low, &high)| low..high).collect();
    Some(parts)
}

/// Whether the load of a standard's log changes after each reading: where two readings deviate from
/// the settled ones before them on the same side. The following readings have settled when a few in
/// turn move little.
fn steps(readings: &[Reading], readability_mg: f64) -> Vec<bool> {
    let shown: Vec<f64> = readings.iter().map(|reading| reading.balance_mg).collect();
    let moves: Vec<f64> = shown.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    let mut sorted = moves.clone();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted.get(sorted.len() * 3 / 4).copied().unwrap_or(0.0);
    let least = STEP_MIN * usual.max(readability_mg / 3.0);
    let mut is_split = vec![false; moves.len()];
    let mut settled_from = 0;
    for k in 0..shown.len().saturating_sub(2) {
        if k < settled_from {
            continue;
        }
        let mut before =
            shown[settled_from.max(k.saturating_sub(SETTLED_READINGS - 1))..=k].to_vec();
        before.sort_by(f64::total_cmp);
        let [now, next] = [shown[k + 1], shown[k + 2]].map(|mg| mg - before[before.len() / 2]);
        if now.abs() > least / 3.0 && next.abs() > least / 2.0 && now * next > 0.0 {
            is_split[k] = true;
            let is_still = |from: &usize| {
                moves[*from..(*from + SETTLED_READINGS).min(moves.len())]
                    .iter()
                    .all(|&by| by <= least / 3.0)
            };
            settled_from = (k + 1..moves.len()).find(is_still).unwrap_or(moves.len());
        }
    }
    is_split
}

/// The coarsest step of a display that all readings are multiples of, mg; 0 if none is.
fn readability(traces: &Traces) -> f64 {
    let keeps = |step: f64| {
        let mut shown = traces
            .weighings
            .iter()
            .flat_map(|weighing| &weighing.readings)
            .map(|reading| reading.balance_mg / step);
        // Files are written in decimal: the remainder is rounding.
        shown.all(|steps| (steps - steps.round()).abs() < 1e-6 * steps.abs().max(1.0))
    };
    let steps =
        (-4..=2).rev().flat_map(|decade| [5.0, 2.0, 1.0].map(|digit| digit * 10f64.powi(decade)));
    steps.into_iter().find(|&step| keeps(step)).unwrap_or(0.0)
}
