//! Conversions between the application's types and the contract's messages: the same names.

pub use super::labels::page;
use super::proto;
use crate::api::problem::Problem;
use crate::app;
use flip_core::domain::FieldError;
use flip_core::domain::apparatus::{Apparatus, Stroke, StrokeResponse};
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::conditions::{Condition, Conditions, Under};
use flip_core::domain::device::Device;
use flip_core::domain::job::{JobKind, JobState};
use flip_core::domain::labels::Labels;
use flip_core::domain::observable::Observation;
use flip_core::domain::parameters::{Parameter, ParameterSet};
use flip_core::domain::pile::Angle;
use flip_core::domain::powder::{Flowability, Method};
use flip_core::domain::weighing::{Outcome, WeighingState};
use prost_types::Timestamp;

/// Converts enums whose variants have the same names on both sides.
macro_rules! same_names {
    ($($ours:ty = $wire:ident { $($variant:ident)* })*) => {$(
        impl From<$ours> for proto::$wire {
            fn from(ours: $ours) -> Self {
                match ours { $(<$ours>::$variant => Self::$variant,)* }
            }
        }

        impl From<proto::$wire> for Option<$ours> {
            fn from(wire: proto::$wire) -> Self {
                match wire {
                    proto::$wire::Unspecified => None,
                    $(proto::$wire::$variant => Some(<$ours>::$variant),)*
                }
            }
        }
    )*};
}

same_names! {
    Device = Device { Cpu Cuda }
    Method = Method { Automated Manual }
    JobKind = JobKind { Calibration Training Evaluation Investigation Repose Film }
    JobState = JobState { Queued Running Succeeded Failed Cancelled }
    Outcome = Outcome { Within Under Over NotStable Blocked Stopped Aborted Unknown Probed }
    WeighingState = WeighingState { Planned AwaitingVial Armed Dosing Settling Done Aborted Unknown }
    app::WeighingSort = WeighingSort { Newest Oldest Error Target Seconds }
    app::VialCheck = VialCheck { Confirm Skip }
    app::CalibrationMethod = CalibrationMethod { Emulator Paper Sequential }
    app::DateOrder = DateOrder { DayFirst MonthFirst YearFirst }
    app::TrialPhase = TrialPhase { Search Verification }
    app::Order = Order { Curriculum Random Reverse DomainRandomisation }
    app::Preset = Preset { Flip Paper }
    app::Gradients = Gradients { Libtorch Fused }
    app::LabelKind = LabelKind { Powder Calibration Training Policy Evaluation Investigation Simulator Weighing DoseList Repose Film }
    app::ArchivedItems = Archived { Exclude Only Include }
    app::Verdict = Verdict { NoDiscrepancy Cause Ambiguous Unexplained Hint }
}

/// Builds messages from our structs: first the fields moved as they are, then those that need
/// converting.
macro_rules! same_fields {
    ($($this:ident: $ours:ty => $wire:ident { $($plain:ident)* } { $($field:ident: $value:expr,)* })*) => {$(
        impl From<$ours> for proto::$wire {
            fn from($this: $ours) -> Self {
                Self { $($field: $value,)* $($plain: $this.$plain,)* }
            }
        }
    )*};
}

same_fields! {
    f: Flowability => Flowability { repose_deg sd_deg n } {}
    p: app::Powder => Powder { id name soluble } {
        label: None,
        flowability: p.flowability.map(Into::into),
        created_at: at(p.created_at),
    }
    m: app::Measurement => Measurement { id powder repose_deg sd_deg sd_unknown n source measured_on } {
        method: proto::Method::from(m.method).into(),
        created_at: at(m.created_at),
        withdrawn: m.withdrawn.map(Into::into),
    }
    o: Observation => Observation { mean sd n } {
        observable: Some(o.observable.into()),
    }
    o: app::PowderObservation => PowderObservation { id powder mean sd n source measured_on } {
        observable: Some(o.observable.into()),
        created_at: at(o.created_at),
        withdrawn: o.withdrawn.map(Into::into),
    }
    d: app::PowderDetail => PowderDetail {} {
        powder: Some(d.powder.into()),
        measurements: all(d.measurements),
        observations: all(d.observations),
        sets: all(d.sets),
    }
    p: Parameter => Parameter { lower upper default } {
        key: p.key.to_owned(),
        unit: p.unit.to_owned(),
        meaning: p.meaning.to_owned(),
    }
    s: app::CalibratedSet => CalibratedSet { id powder calibration repose_deg repose_sd_deg runs error_deg simulator } {
        parameters: Some(s.parameters.into()),
        created_at: at(s.created_at),
    }
    c: app::Calibration => Calibration { powder } {
        label: None,
        job: Some(c.job.into()),
        target: Some(c.target.into()),
        settings_json: c.settings.to_string(),
        observations: all(c.observations),
        under: c.under.map(Into::into),
        steepness: c.steepness.map(Into::into),
        device: card_of(c.device),
        result: c.result.map(Into::into),
    }
    s: app::Steepness => Steepness { simulated_deg difference_deg uncertainty_deg agrees } {}
    u: Under => Under { simulator } {
        conditions: u.conditions.into_iter().map(|(name, condition)| (name, condition.to_string())).collect(),
    }
    r: app::CalibrationResult => CalibrationResult {
        evaluations verification_runs mean_error_deg sd_error_deg verified_error_deg reached size_shift_deg
    } {
        sets: all(r.sets),
        shortfall: r.shortfall.map(Into::into),
        emulator: r.emulator.map(Into::into),
        observed: all(r.observed),
    }
    o: app::Observed => Observed { sha256 built mean agrees } {
        observation: Some(o.observation.into()),
        sets: all(o.sets),
    }
    s: app::Simulated => Simulated { mean sd runs } {}
    s: app::Shortfall => Shortfall { nearest_repose_deg limiting_parameter } {}
    e: app::EmulatorUse => EmulatorUse { id sha256 runs built } {}
    s: app::CalibrationSet => CalibrationSet { id repose_deg repose_sd_deg runs error_deg verified_error_deg } {
        parameters: Some(s.parameters.into()),
    }
    p: app::Posterior => Posterior { repose_deg effective } {
        draws: p.draws.into_iter().map(|draw| proto::PosteriorDraw { values: draw.to_vec() }).collect(),
        parameters: all(p.parameters),
        together: all(p.together),
    }
    m: app::Marginal => Marginal { key mean learnt inert } {
        lower: m.interval[0],
        upper: m.interval[1],
    }
    p: app::Pair => CorrelatedPair { correlation } {
        keys: p.keys.to_vec(),
    }
    c: app::Comparison => Comparison { difference_deg standard_error_deg agree } {
        calibration: Some(c.calibration.into()),
        with: Some(c.with.into()),
    }
    c: app::ComparedCalibration => ComparedCalibration {
        id powder evaluations verification_runs sets verified_error_deg verified_sd_deg repose_deg standard_error_deg
    } {
        target: Some(c.target.into()),
        method: proto::CalibrationMethod::from(c.method).into(),
        emulator: c.emulator.map(Into::into),
        parameters: all(c.parameters),
    }
    s: app::ParameterSpread => ParameterSpread { key mean lower upper } {}
    t: app::Trial => Trial { index candidate seed readings tip_deg tip_sd_deg cone_deg creep_deg_per_s refusal error_deg seconds } {
        phase: proto::TrialPhase::from(t.phase).into(),
        parameters: Some(t.parameters.into()),
    }
    t: app::Training => Training { episodes kept_episodes } {
        label: None,
        job: Some(t.job.into()),
        order: proto::Order::from(t.order).into(),
        preset: proto::Preset::from(t.preset).into(),
        levels: all(t.levels),
        settings_json: t.settings.to_string(),
        result: t.result.map(Into::into),
        device: card_of(t.device),
    }
    l: app::TrainingLevel => TrainingLevel { powder repose_deg sets } {}
    r: app::TrainingResult => TrainingResult { policy episodes final_error_mg card } {
        levels_json: r.levels.iter().map(ToString::to_string).collect(),
    }
    e: app::Episode => Episode {
        index level powder parameter_set target_mg dispensed_mg final_error_mg reward steps alpha critic_loss actor_loss
    } {}
    p: app::Policy => Policy { id kind training sha256 size_bytes } {
        label: None,
        manifest_json: p.manifest.to_string(),
        evaluated: all(p.evaluated),
        created_at: at(p.created_at),
    }
    e: app::PolicyError => PolicyError { powder mae_mg n } {}
    e: app::Evaluation => Evaluation {
        policy controllers powders targets_mg repeats readability_mg max_shakes seed
    } {
        label: None,
        job: Some(e.job.into()),
        result: e.result.map(Into::into),
        particles: e.conditions.particles,
        extensions: e.conditions.amplitudes().into_iter().collect(),
        under: e.under.map(Into::into),
        substep_us: e.conditions.substep_us,
        device: card_of(e.device),
    }
    r: app::EvaluationResult => EvaluationResult { card } {
        rows: all(r.rows),
        summary: all(r.summary),
    }
    r: app::EvaluationRow => EvaluationRow {
        controller powder target_mg n mae_mg sd_mg bias_mg over_share zero_share shakes_mean seconds_mean
    } {}
    s: app::EvaluationSummary => EvaluationSummary {
        controller mae_mg sd_trials_mg sd_within_cells_mg bias_mg over_share zero_share shakes_mean seconds_mean
    } {
        ci95_lower_mg: s.ci95[0],
        ci95_upper_mg: s.ci95[1],
    }
    i: app::Investigation => Investigation {
        powders runs sessions weighings spoonfuls covariates simulations budget_runs seed simulator p_value sentence
    } {
        label: None,
        job: Some(i.job.into()),
        verdict: i.verdict.map(|verdict| proto::Verdict::from(verdict).into()),
        // Numbers, text and lists: serializing them as JSON cannot fail.
        report_json: i.report.and_then(|report| serde_json::to_string(&report).ok()),
    }
    v: app::SimulatorVersion => SimulatorVersion { id base investigation } {
        label: None,
        body_json: v.body.to_string(),
        created_at: at(v.created_at),
    }
    r: app::Row => PredictedRow { row powder before_deg before_sd_deg after_deg after_sd_deg } {}
    c: app::CurrentSimulator => CurrentSimulator { simulator base before reason } {
        chosen_at: c.chosen_at.and_then(at),
    }
    c: app::Checklist => Checklist { items } {
        changed_at: c.changed_at.and_then(at),
    }
    w: app::Weighing => Weighing {
        id powder target_mg tolerance_lower_mg tolerance_upper_mg policy parameter_set seed
        dispensed_mg reading_mg error_mg shakes seconds error bench_name
    } {
        label: None,
        bench: w.bench.map(bench_kind),
        under: w.under.map(Into::into),
        asked: (!w.asked.is_nothing()).then(|| w.asked.into()),
        labels: w.labels.0.into_iter().collect(),
        measured: w.measured.map(Into::into),
        apparatus: w.apparatus.map(Into::into),
        vial_check: proto::VialCheck::from(w.vial_check).into(),
        state: proto::WeighingState::from(w.state).into(),
        outcome: w.outcome.map(|outcome| proto::Outcome::from(outcome).into()),
        created_at: at(w.created_at),
        started_at: w.started_at.and_then(at),
        finished_at: w.finished_at.and_then(at),
    }
    a: Apparatus => Apparatus { readability_mg repeatability_mg capacity_mg } {
        stroke: a.stroke.map(Into::into),
    }
    s: Stroke => Stroke { shake_mm_max } {
        velocity_m_s: s.limits.velocity_m_s,
        acceleration_m_s2: s.limits.acceleration_m_s2,
        jerk_m_s3: s.limits.jerk_m_s3,
        response: s.response.map(Into::into),
    }
    r: StrokeResponse => StrokeResponse { gain offset_mm speed_gain } {}
    m: app::MeasuredMass => MeasuredMass {
        tare_mg gross_mg net_mg uncertainty_mg minimum_mg below_minimum_weight stable_by_balance stable_by_window
        drift_before_mg_min drift_after_mg_min in_flight_mg discarded_mg zero_mg proven
    } {
        devices: m.devices.into_iter().collect(),
    }
    l: app::Latch => Latch { reason weighing } {
        at: at(l.at),
        bench: l.bench.map(bench_kind),
    }
    h: app::Held => Held { reason by } {
        at: at(h.at),
    }
    w: app::Waiting => WaitingWeighing { id powder target_mg vial } {
        state: proto::WeighingState::from(w.state).into(),
    }
    v: app::Vial => Vial { name weighing holds_mg } {
        since: at(v.since),
    }
    r: app::Reservation => Reservation { id owner } {
        until: at(r.until),
    }
    u: app::Unwritten => UnwrittenEnd { weighing why } {
        since: at(u.since),
    }
    b: app::BenchStatus => BenchStatus { moving exchanges_vials } {
        held: b.held.map(Into::into),
        waiting: all(b.waiting),
        vial: b.vial.map(Into::into),
        reservation: b.reservation.map(Into::into),
        unwritten: b.unwritten.map(Into::into),
        piling: b.piling.map(Into::into),
        kind: b.kind.map(bench_kind),
        devices: b.devices.into_iter().collect(),
        latch: b.latch.map(Into::into),
        repeatability: b.repeatability.map(Into::into),
    }
    r: app::BalanceReading => BalanceReading { mass_mg stable readability_mg balance } {
        at: at(r.at),
    }
    r: app::Repeatability => Repeatability { sd_mg readability_mg } {
        minimum_mg: r.minimum_mg(0.001),
        readings_mg: r.readings_mg,
    }
    r: app::AuditRecord => AuditRecord { seq weighing kind hash } {
        at: at(r.at),
        body: r.body.to_string(),
    }
    v: app::AuditVerification => AuditVerification { records last_hash holds_hash } {
        broken_seq: v.broken.as_ref().map(|broken| broken.seq),
        broken_why: v.broken.map(|broken| broken.why),
        changed: all(v.changed),
        others: all(v.others),
        archives: all(v.archives),
        chains: all(v.chains),
    }
    c: app::ChangedRow => ChangedRow { weighing seq why } {}
    c: app::ChangedOther => ChangedOther { id seq why } { what: c.what.name().to_owned(), }
    l: app::LostArchive => LostArchive { file first last why } {}
    r: app::ReposeMeasurement => ReposeMeasurement { powder run } {
        label: None,
        job: Some(r.job.into()),
        bench: bench_kind(r.bench),
        procedure_json: json(&r.procedure),
        rig_json: json(&r.rig),
        limits_json: json(&r.limits),
        awaits: r.awaits.map(Into::into),
        piles: all(r.piles),
        result: r.result.map(Into::into),
    }
    a: app::Awaited => AwaitedFrames { pile have wanted } {}
    p: app::PileInMaking => PileInMaking { job pile } {}
    p: app::Pile => Pile { number refusal } {
        at: at(p.at),
        tip: p.measured.map(|it| it.tip.into()),
        cone: p.measured.map(|it| it.cone.into()),
        frames: p.frames.len() as u32,
        outline: p.outline.map(Into::into),
    }
    a: Angle => PileAngle { deg u_deg u_frames_deg } {}
    r: app::ReposeResult => ReposeResult { registered } {
        tip: Some(r.repeats.tip.into()),
        tip_u_deg: r.repeats.tip_u_deg,
        cone: Some(r.repeats.cone.into()),
        cone_u_deg: r.repeats.cone_u_deg,
    }
    c: app::Compared => ComparedMethods { powder difference_deg standard_error_deg } {
        automated: Some(c.automated.into()),
        manual: Some(c.manual.into()),
    }
    d: app::WeighingDetail => WeighingDetail {} {
        weighing: Some(d.weighing.into()),
        ticks: all(d.ticks),
        trace_lost: d.trace_lost,
        stopped: d.stopped.map(Into::into),
    }
    s: app::Stopped => Stopped { by } {
        at: at(s.at),
    }
    t: Tick => Tick { step t_s pitch_deg spoonful } {
        incline_change_deg: t.action.incline_change_deg,
        shake_mm: t.action.shake_mm,
        strokes: t.action.strokes,
        mass_mg: t.reading.mass_mg,
        stable: t.reading.stable,
    }
    e: app::Event => Event { seq topic kind } {
        data_json: e.data.to_string(),
        at: at(e.at),
    }
}

/// Plain data as JSON text: numbers, text and lists, whose serialization cannot fail.
fn json(plain: &impl serde::Serialize) -> String {
    serde_json::to_string(plain).unwrap_or_default()
}

pub(super) fn bench_kind(kind: BenchKind) -> String {
    let name = match kind {
        BenchKind::Simulated => "simulated",
        BenchKind::Emulated => "emulated",
        BenchKind::Devices => "devices",
    };
    name.to_owned()
}

impl From<ParameterSet> for proto::ParameterSet {
    fn from(set: ParameterSet) -> Self {
        Self {
            particle_diameter_mm: set.particle_diameter_mm(),
            adhesion: set.adhesion(),
            particle_adhesion_scale: set.particle_adhesion_scale(),
            adhesion_offset_scale: set.adhesion_offset_scale(),
            friction: set.friction(),
            gravity_scale: set.gravity_scale(),
            damping: set.damping(),
            cohesion: set.cohesion(),
            particle_mass_ug: set.particle_mass_ug(),
        }
    }
}

impl From<(app::Job, bool)> for proto::StartJobResponse {
    fn from((job, created): (app::Job, bool)) -> Self {
        Self { job: Some(job.into()), created }
    }
}

/// The value of the enum in `field`; `None` if the caller left it unspecified.
///
/// # Errors
/// A number without a name in the contract.
pub fn named<W: TryFrom<i32>, T>(field: &str, number: i32) -> Result<Option<T>, Problem>
where
    Option<T>: From<W>,
{
    let wire = W::try_from(number)
        .map_err(|_| FieldError::new(field, "is not one of the values of its enum"))?;
    Ok(wire.into())
}

/// What is said of a device: nothing of the processor.
pub fn card_of(device: Device) -> Option<i32> {
    (!device.is_cpu()).then(|| proto::Device::from(device).into())
}

/// The refusal of a request without this field.
pub fn missing(field: &str) -> Problem {
    FieldError::new(field, "is missing").into()
}

/// Converts every item.
pub fn all<T: Into<W>, W>(items: Vec<T>) -> Vec<W> {
    items.into_iter().map(Into::into).collect()
}

/// `None` for an empty list: proto3 cannot distinguish the two, and none of our lists may be empty.
pub fn given<T>(items: Vec<T>) -> Option<Vec<T>> {
    if items.is_empty() { None } else { Some(items) }
}

/// Conditions as received, numbers as text.
pub fn conditions(typed: std::collections::HashMap<String, String>) -> Conditions {
    typed.into_iter().map(|(name, value)| (name, Condition::typed(&value))).collect()
}

/// Labels as received.
pub fn labels(written: std::collections::HashMap<String, String>) -> Labels {
    Labels(written.into_iter().collect())
}

pub(super) fn at(time: app::Timestamp) -> Option<Timestamp> {
    let ms = time.unix_ms();
    Some(Timestamp {
        seconds: ms.div_euclid(1000),
        nanos: (ms.rem_euclid(1000) * 1_000_000) as i32,
    })
}
