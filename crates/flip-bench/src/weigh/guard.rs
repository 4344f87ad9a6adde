//! The guard: the policy proposes, the guard disposes.
//!
//! Only actions returned by [`guard`] reach a device. It is a pure function of the readings and
//! actions so far, so every rule can be tested as a table.

use super::forecast::{Fall, Forecast, Shaking};
use super::silence::Silence;
use flip_core::domain::bench::{
    Action, INCLINE_CHANGE_DEG_MAX, PitchLimits, Reading, SHAKE_MM_MAX, SHAKE_MM_MIN, STROKES_MAX,
};
use flip_core::domain::vial::VialFlaw;
use serde::Serialize;

/// The pitch counts as at its end within this distance of its upper limit, degrees.
pub(super) const AT_THE_END_DEG: f64 = 0.5;
/// A shake of at least this fraction of the largest amplitude is a full one.
pub(super) const FULL: f64 = 0.95;
/// Factor from one tried amplitude to the next: the square root of a half.
const GENTLER: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Step from one tried lower pitch to the next, degrees.
const LOWER_DEG: f64 = 1.0;

/// Limits of a weighing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Range of the spoon's pitch.
    pub pitch: PitchLimits,
    /// Largest amplitude of a shake, mm. Default 16.
    pub shake_mm_max: f64,
    /// Steps before the weighing ends.
    pub steps_max: u32,
    /// Bench time before the weighing ends, s.
    pub seconds_max: f64,
    /// A reading may fall by this much between two steps before the vial counts as moved, mg.
    /// Default 3: three steps of a 1 mg balance.
    pub fall_mg_max: f64,
    /// A reading may rise by this much in a step without a shake, mg. Default 3, as above; on
    /// simulated spoons, inclining alone never released more than 0.5 mg.
    pub rise_mg_max: f64,
    /// This many full strokes in a row at the end of the pitch that release nothing mean a blocked
    /// spoon. Default 15: one, two, four and eight (`ladder.rs`).
    pub blocked_strokes: u32,
    /// Where there is no forecast, of a powder that does not hang: so many shakes like the last one
    /// that released something which release nothing mean a blocked spoon or a stuck balance.
    /// Default 8: the gentlest shakes at the end of a dose may take five for one step of the display.
    pub deaf_shakes: u32,
    /// Probability that a spoonful of the powder stops flowing while powder is left in it. Default
    /// 0: shakes that should release something do.
    pub hangs: f64,
    /// Share of silent shakes in earlier spoonfuls of the powder while they flowed
    /// ([`silent_share`](super::earlier::silent_share)), if known.
    pub silent_share: Option<f64>,
    /// Prior probability that a display is stuck. Default 0.003: far above that of real balances,
    /// because poured powder cannot be taken back (cost and benefit in `docs/reliability.md`). 0:
    /// the display is trusted.
    pub stands_still: f64,
    /// Step of the balance's display, mg.
    pub readability_mg: f64,
    /// A smaller rise of the display is its noise and no powder, mg: a step of the display, or three
    /// standard deviations of the difference of two readings at rest.
    pub piece_mg: f64,
    /// Forecast of the next shake; `None`: not used.
    pub forecast: Option<Forecast>,
}

impl Limits {
    /// Default of `fall_mg_max`.
    pub(super) const FALL_MG_MAX: f64 = 3.0;

    /// The same for an episode, which runs to its end whatever the spoon does.
    pub fn lenient(self) -> Self {
        Self { rise_mg_max: f64::INFINITY, blocked_strokes: u32::MAX, stands_still: 0.0, ..self }
    }

    /// Limits of a weighing within this frame.
    pub fn new(pitch: PitchLimits, steps_max: u32) -> Self {
        Self {
            pitch,
            shake_mm_max: SHAKE_MM_MAX,
            steps_max,
            seconds_max: f64::INFINITY,
            fall_mg_max: Self::FALL_MG_MAX,
            rise_mg_max: 3.0,
            blocked_strokes: 2 * STROKES_MAX - 1,
            deaf_shakes: 8,
            hangs: 0.0,
            silent_share: None,
            stands_still: 0.003,
            readability_mg: 1.0,
            piece_mg: 1.0,
            forecast: None,
        }
    }
}

/// The situation before a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Situation<'a> {
    /// Target, mg.
    pub target_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Steps carried out.
    pub steps: u32,
    /// Bench time since the tare, s.
    pub seconds: f64,
    /// When the last motion ended, s on the same clock.
    pub moved_s: f64,
    /// When the reading was complete, s on the same clock.
    pub read_s: f64,
    /// Current pitch, degrees.
    pub pitch_deg: f64,
    /// Reading before the last step.
    pub before: Reading,
    /// Reading now.
    pub now: Reading,
    /// Whether the last step was a shake. False before the first step.
    pub shaken: bool,
    /// Every shake of this dose and its yield.
    pub falls: &'a [Fall],
    /// Number of the latest shakes made since the display last changed; `None`: displays of this
    /// balance stand still when all is well, and waiting for a change is pointless.
    pub unproven: Option<usize>,
    /// The display has changed since the load cell has responded to the full yield of the last
    /// shake.
    pub is_felt: bool,
}

/// The allowed action, and how it differs from the proposal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Allowed {
    /// The action.
    pub action: Action,
    /// Why it differs from the proposal, if it does.
    pub cut: Option<Cut>,
}

/// Why an action differs from the proposal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Cut {
    /// It was outside the bounds of action or spoon.
    #[error("cut to the bounds of the spoon")]
    Bounds,
    /// Too much might have fallen.
    #[error(
        "made gentler: as proposed {upper_mg:.1} mg might fall, and there is room for {room_mg:.1} mg"
    )]
    Gentler {
        /// Forecast for the proposal, mg.
        upper_mg: f64,
        /// Room up to the target plus its tolerance, mg.
        room_mg: f64,
    },
}

/// Why no further action may reach a device.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Halt {
    /// The object on the pan is not the vial that was declared.
    #[error("{0}")]
    Vial(VialFlaw),
    /// The balance shows the target or more: nothing may be added.
    #[error("the balance shows the target")]
    TargetReached,
    /// The ranges of arm and policy have no overlap in which powder could be dosed.
    #[error(
        "the arm tilts its spoon from {arm_lower_deg} to {arm_upper_deg} deg and shakes it by up to {shake_mm_max} mm, the policy doses from {lower_deg} to \
         {upper_deg} deg: no dose is possible with both, take another policy or widen the limits that the arm's driver describes"
    )]
    OutOfReach {
        /// Lower pitch limit of the arm, degrees.
        arm_lower_deg: f64,
        /// Upper pitch limit of the arm, degrees.
        arm_upper_deg: f64,
        /// Largest amplitude of the arm, mm.
        shake_mm_max: f64,
        /// Lower pitch limit of the policy, degrees.
        lower_deg: f64,
        /// Upper pitch limit of the policy, degrees.
        upper_deg: f64,
    },
    /// Every step is used up.
    #[error("every step is spent")]
    StepsSpent,
    /// The time is up.
    #[error("the time is spent")]
    TimeSpent,
    /// Even the gentlest shake might release too much.
    #[error(
        "even the gentlest shake might let {upper_mg:.1} mg fall, and there is room for {room_mg:.1} mg"
    )]
    NoRoom {
        /// Forecast for the gentlest shake, mg.
        upper_mg: f64,
        /// Room up to the target plus its tolerance, mg.
        room_mg: f64,
    },
    /// Full strokes at the end of the pitch release nothing.
    #[error(
        "the last {strokes} full strokes at the end of the pitch, {pitch_deg:.0} deg, gave nothing: the spoon is empty or blocked"
    )]
    Blocked {
        /// Number of strokes.
        strokes: u32,
        /// The end of the pitch, degrees.
        pitch_deg: f64,
    },
    /// A spoon that released powder before no longer does and the display is all but surely stuck, or
    /// it may be and the mass that it may hide leaves no room.
    #[error(
        "{shakes} shakes that should have given something gave nothing: the spoon is empty or blocked, or the balance stands still"
    )]
    Deaf {
        /// Number of shakes.
        shakes: usize,
    },
    /// The display has been constant through a shake and since: no shake may follow until it
    /// changes, as it may be stuck.
    #[error(
        "the balance has shown the same number through the last shake and since, so nothing says that it still weighs: look at it, and at what is in the vial; \
         where the display of a sound balance stands for minutes, write life_s = 0 under [readings] in the bench file"
    )]
    Unproven,
    /// The reading is not stable.
    #[error("the balance gives no stable reading: keep draughts and vibration away and tare again")]
    NotStable,
    /// The reading or the pitch is not a number.
    #[error("the balance or the spoon reports what is not a number: look at the bench")]
    NotANumber,
    /// The reading was taken before the last motion ended.
    #[error("the reading is older than the last motion")]
    Stale,
    /// The reading fell.
    #[error("the reading fell by {fell_mg} mg: the vial was moved or lifted")]
    VialMoved {
        /// Size of the fall, mg.
        fell_mg: f64,
    },
    /// The display shows the vial's mass again.
    #[error(
        "the balance shows {rose_mg} mg more, as if the vial had not been tared: it restarted or lost its tare; weigh the vial"
    )]
    TareLost {
        /// Size of the rise, mg.
        rose_mg: f64,
    },
    /// The display went back to zero.
    #[error(
        "the reading fell by {fell_mg} mg to nothing: the balance restarted, or somebody pressed its tare key; weigh the vial"
    )]
    Zeroed {
        /// Size of the fall, mg.
        fell_mg: f64,
    },
    /// The reading rose without a shake.
    #[error(
        "the reading rose by {rose_mg} mg without a shake: a draught, a leaking spoon or a hand on the balance"
    )]
    Rose {
        /// Size of the rise, mg.
        rose_mg: f64,
    },
    /// The proposal is not a number.
    #[error("the policy proposed an action that is not a number")]
    NotAnAction,
}

impl Halt {
    /// Whether the weighing has run its course: nothing is wrong, and the reading decides the
    /// outcome.
    pub fn is_expected(&self) -> bool {
        matches!(
            self,
            Self::TargetReached | Self::StepsSpent | Self::TimeSpent | Self::NoRoom { .. }
        )
    }

    /// Whether the halt is about the spoon's behaviour, which does not matter for a dose that is
    /// complete.
    pub(super) fn is_of_the_spoon(&self) -> bool {
        matches!(
            self,
            Self::NoRoom { .. } | Self::Blocked { .. } | Self::Deaf { .. } | Self::Unproven
        )
    }
}

/// Decide which action may be carried out: the proposal, clamped to its bounds and the spoon's, and
/// gentle enough that the dose exceeds its tolerance only with a small probability.
///
/// A proposal that might release too much is first made shorter and gentler, then, if even the smallest shake
/// is too much at that pitch, moved to a lower pitch. The pitch change per step is bounded and each
/// step waits for a fresh reading, which bounds its rate.
///
/// # Errors
/// [`Halt`] when nothing may be carried out. The first rule that applies, in this order: unusable
/// reading, moved vial, mass without a shake, target reached, steps or time used up, blocked,
/// unusable proposal, no room, and [`Halt::Unproven`] if the display must first prove that it is
/// alive. Where waiting for that is pointless and the display is more likely stuck than not,
/// [`Halt::Deaf`] replaces used-up steps; it also replaces no room where there would be room but
/// for the mass that the display may hide.
pub fn guard(limits: &Limits, seen: &Situation<'_>, proposed: Action) -> Result<Allowed, Halt> {
    is_usable(limits, seen)?;
    if seen.now.mass_mg >= seen.target_mg {
        return Err(Halt::TargetReached);
    }
    let silence = limits.forecast.filter(|_| seen.unproven.is_none()).and_then(|forecast| {
        let (falls, readability_mg) = (seen.falls, limits.readability_mg);
        let silence = Silence::after(falls, readability_mg, limits.stands_still)?;
        let forecast = forecast.silent_chance(falls, silence.shakes, readability_mg);
        Some(silence.unless(limits.hangs).as_before(limits.silent_share).unless(forecast))
    });
    if seen.steps >= limits.steps_max {
        let still = silence.filter(Silence::is_still);
        return Err(still.map_or(Halt::StepsSpent, |it| Halt::Deaf { shakes: it.shakes }));
    }
    if seen.seconds >= limits.seconds_max {
        return Err(Halt::TimeSpent);
    }
    if let Some(strokes) = silent_at_the_end(limits, seen.falls)
        && strokes >= limits.blocked_strokes
        && seen.pitch_deg > limits.pitch.upper_deg - AT_THE_END_DEG
    {
        return Err(Halt::Blocked { strokes, pitch_deg: limits.pitch.upper_deg });
    }
    let stuck = silence.as_ref().filter(|it| it.is_surely_still()).map(|it| it.shakes);
    if let Some(shakes) = stuck.or_else(|| deaf(limits, seen)) {
        return Err(Halt::Deaf { shakes });
    }
    if !proposed.incline_change_deg.is_finite() || !proposed.shake_mm.is_finite() {
        return Err(Halt::NotAnAction);
    }
    let action = bounded(limits, seen.pitch_deg, proposed);
    let allowed = match &limits.forecast {
        Some(forecast) => gentle(limits, forecast, silence.as_ref(), seen, action, proposed)?,
        None => Allowed { action, cut: (action != proposed).then_some(Cut::Bounds) },
    };
    if is_in_doubt(limits, seen, allowed.action) { Err(Halt::Unproven) } else { Ok(allowed) }
}

/// The display may be stuck, and nothing it shows would support this shake.
///
/// Either the display did not change at the last shake, or it moved as a load cell does while
/// settling, and stopped before it had settled: as much again may then have fallen as it shows.
fn is_in_doubt(limits: &Limits, seen: &Situation<'_>, action: Action) -> bool {
    let shake = Shaking::of(seen.pitch_deg, &action);
    let Some(unproven) = seen.unproven.filter(|_| shake.shake_mm > 0.0) else { return false };
    let fell_mg = seen.falls.last().map_or(0.0, |fall| fall.mass_mg.max(0.0));
    let room_mg = seen.target_mg + seen.tolerance_upper_mg - seen.now.mass_mg - fell_mg;
    let chance = |forecast: &Forecast| {
        forecast.chance_above(seen.falls, limits.readability_mg, shake, room_mg)
    };
    unproven > 0
        || (!seen.is_felt
            && limits.forecast.is_some_and(|forecast| chance(&forecast) > forecast.risk))
}

/// Check that the reading can be relied on.
fn is_usable(limits: &Limits, seen: &Situation<'_>) -> Result<(), Halt> {
    let numbers =
        [seen.now.mass_mg, seen.pitch_deg, seen.target_mg, seen.seconds, seen.moved_s, seen.read_s];
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err(Halt::NotANumber);
    }
    if !seen.now.stable {
        return Err(Halt::NotStable);
    }
    if seen.read_s < seen.moved_s {
        return Err(Halt::Stale);
    }
    let rose_mg = seen.now.mass_mg - seen.before.mass_mg;
    if -rose_mg > limits.fall_mg_max {
        return Err(Halt::VialMoved { fell_mg: -rose_mg });
    }
    if !seen.shaken && rose_mg > limits.rise_mg_max {
        return Err(Halt::Rose { rose_mg });
    }
    Ok(())
}

/// Strokes of the latest full shakes at the end of the pitch, if together they released nothing
/// that the balance tells from its noise; `None` if there are none or something fell.
pub(super) fn silent_at_the_end(limits: &Limits, falls: &[Fall]) -> Option<u32> {
    let is_full = |fall: &&Fall| {
        fall.pitch_deg > limits.pitch.upper_deg - AT_THE_END_DEG
            && fall.shake_mm >= FULL * limits.shake_mm_max
    };
    let (mut strokes, mut fell_mg) = (0, 0.0);
    for fall in falls.iter().rev().take_while(is_full) {
        fell_mg += fall.mass_mg;
        if fell_mg >= limits.piece_mg - 1e-9 {
            break;
        }
        strokes += fall.strokes;
    }
    (strokes > 0).then_some(strokes)
}

/// Without a forecast: how many shakes released nothing since the last fall, if there were too many
/// of them at no lower pitch and no smaller amplitude.
fn deaf(limits: &Limits, seen: &Situation<'_>) -> Option<usize> {
    let hangs = limits.hangs > limits.stands_still;
    if limits.forecast.is_some() || seen.unproven.is_some() || hangs {
        return None;
    }
    let gave = |fall: &Fall| fall.mass_mg >= limits.piece_mg - 1e-9;
    let last = seen.falls.iter().rposition(gave)?;
    let (since, last) = (&seen.falls[last + 1..], seen.falls[last]);
    let should_give = |fall: &&Fall| {
        fall.pitch_deg > last.pitch_deg - AT_THE_END_DEG && fall.shake_mm >= FULL * last.shake_mm
    };
    let strokes: u32 = since.iter().filter(should_give).map(|fall| fall.strokes).sum();
    (strokes >= limits.deaf_shakes).then_some(since.len())
}

fn bounded(limits: &Limits, pitch_deg: f64, proposed: Action) -> Action {
    let change = proposed.incline_change_deg.clamp(-INCLINE_CHANGE_DEG_MAX, INCLINE_CHANGE_DEG_MAX);
    let pitch = (pitch_deg + change).clamp(limits.pitch.lower_deg, limits.pitch.upper_deg);
    Action {
        strokes: proposed.strokes.clamp(1, STROKES_MAX),
        ..Action::once(pitch - pitch_deg, proposed.shake_mm.clamp(0.0, limits.shake_mm_max))
    }
}

/// The first candidate whose forecast leaves room: the action itself, fewer strokes, gentler ones at
/// its pitch, the gentlest ones at lower pitches.
fn gentle(
    limits: &Limits,
    forecast: &Forecast,
    silence: Option<&Silence>,
    seen: &Situation<'_>,
    action: Action,
    proposed: Action,
) -> Result<Allowed, Halt> {
    let room_mg = seen.target_mg + seen.tolerance_upper_mg - seen.now.mass_mg;
    let shake_of = |action: &Action| Shaking::of(seen.pitch_deg, action);
    let has_room = |action: &Action| {
        let shake = shake_of(action);
        let chance = forecast.chance_above(seen.falls, limits.readability_mg, shake, room_mg);
        (chance <= forecast.risk).then_some(chance)
    };
    let is_safe = |action: &Action| {
        let shake = shake_of(action);
        has_room(action).is_some_and(|chance| {
            let hidden = |it: &Silence| it.chance_above(chance, shake, room_mg);
            shake.shake_mm <= 0.0 || silence.map_or(chance, hidden) <= forecast.risk
        })
    };
    let upper_mg =
        |action: &Action| forecast.upper_mg(seen.falls, limits.readability_mg, shake_of(action));
    if is_safe(&action) {
        return Ok(Allowed { action, cut: (action != proposed).then_some(Cut::Bounds) });
    }
    let cut = Some(Cut::Gentler { upper_mg: upper_mg(&action), room_mg });
    let fewer = std::iter::successors(Some(action.strokes / 2), |strokes| Some(strokes / 2))
        .take_while(|strokes| *strokes > 0)
        .map(|strokes| Action { strokes, ..action });
    let single = Action { strokes: 1, ..action };
    let gentlest = Action { shake_mm: SHAKE_MM_MIN, ..single };
    let gentler =
        std::iter::successors(Some(GENTLER * action.shake_mm), |shake_mm| Some(GENTLER * shake_mm))
            .take_while(|shake_mm| *shake_mm > SHAKE_MM_MIN)
            .map(|shake_mm| Action { shake_mm, ..single })
            .chain([gentlest]);
    let lowest_deg = (seen.pitch_deg - INCLINE_CHANGE_DEG_MAX).max(limits.pitch.lower_deg);
    let lower = (1..)
        .map(|k| shake_of(&action).pitch_deg - f64::from(k) * LOWER_DEG)
        .take_while(|pitch_deg| *pitch_deg > lowest_deg)
        .chain([lowest_deg])
        .map(|pitch_deg| Action { incline_change_deg: pitch_deg - seen.pitch_deg, ..gentlest });
    if let Some(action) = fewer.chain(gentler).chain(lower).find(is_safe) {
        return Ok(Allowed { action, cut });
    }
    let last = Action { incline_change_deg: lowest_deg - seen.pitch_deg, ..gentlest };
    Err(match silence {
        Some(silence) if has_room(&last).is_some() => Halt::Deaf { shakes: silence.shakes },
        _ => Halt::NoRoom { upper_mg: upper_mg(&last), room_mg },
    })
}

#[cfg(test)]
#[path = "guard_tests.rs"]
mod tests;
