//! `flip characterise`: a few spoonfuls of a powder are shaken on the bench to see how it flows, and
//! the powder's card is printed.

use super::Common;
use super::benches::BenchArguments;
use super::failure::Failure;
use super::lab::{Lab, Look};
use super::labels::LabelArguments;
use super::session::{with_bench, with_reader};
use super::simulator::SimulatorArguments;
use super::table::table;
use super::watch::Watch;
use super::weigh::{calibrate_first, look};
use crate::app::{
    CardOfPowder, CharacterisationRequest, Error, VialCheck, VialReadyRequest, Weighing,
};
use flip_core::domain::powder_card::{CardCurve, Estimate, PowderCard, StrokeClass};
use flip_core::domain::weighing::{Outcome, WeighingState};
use serde::Serialize;
use std::time::Duration;

/// How often the run is looked at.
const LOOK: Look = Look { here: Duration::from_millis(100), there_s: 1 };

/// Arguments of `flip characterise`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Powder id.
    #[arg(long, value_name = "ID")]
    powder: String,
    /// Lot of the powder; the card is then of this lot alone.
    #[arg(long, value_name = "TEXT")]
    lot: Option<String>,
    /// Print the card of what is known, and move nothing.
    #[arg(long)]
    show: bool,
    /// Fillings of the spoon, 1 to 9: full, half and quarter strokes in turn [default: 3]. A bench
    /// where a person fills the spoon makes one.
    #[arg(long, value_name = "N")]
    spoonfuls: Option<u32>,
    /// Most that may fall into the vial altogether, mg, 1 to 1000 [default: one spoonful more than
    /// are made].
    #[arg(long, value_name = "MG", allow_negative_numbers = true)]
    limit_mg: Option<f64>,
    /// Policy id; it sets the range of the pitch [default: as for `flip weigh`].
    #[arg(long, value_name = "ID")]
    policy: Option<String>,
    /// Name of the operator.
    #[arg(long, value_name = "NAME")]
    operator: Option<String>,
    /// Label of the vial on the pan, which is discarded afterwards. It must be empty, and the
    /// balance is checked for that; if omitted, FLIP pours into whatever is on the pan.
    #[arg(long, value_name = "TEXT")]
    vial: Option<String>,
    #[command(flatten)]
    labels: LabelArguments,
    #[command(flatten)]
    extended: SimulatorArguments,
    #[command(flatten)]
    bench: BenchArguments,
}

/// The document of a run.
#[derive(Debug, Serialize)]
struct Document {
    /// Id of the weighing that it is recorded as.
    weighing: String,
    outcome: Option<Outcome>,
    /// Most that was to fall, mg.
    limit_mg: f64,
    /// What fell, by the balance, mg.
    reading_mg: Option<f64>,
    shakes: Option<u32>,
    /// Bench time.
    seconds: Option<f64>,
    /// What is to be known of the run beside that.
    #[serde(skip_serializing_if = "Option::is_none")]
    note: Option<String>,
    seed: u64,
    #[serde(flatten)]
    card: CardOfPowder,
}

/// Probes the powder, then prints its card; or only prints it.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    let (powder, lot) = (&arguments.powder, arguments.lot.as_deref());
    if arguments.show {
        // A server knows its own.
        let kind = common.server.is_none().then(|| arguments.bench.kind());
        let card = with_reader(common, async |lab| Ok(lab.powder_card(powder, lot, kind).await?))?;
        return common.print(&card, || text_of(&card));
    }
    let request = request(common, arguments)?;
    // A new key: running the command again means another run.
    let key = uuid::Uuid::now_v7().to_string();
    let (weighing, card) = with_bench(common, &arguments.bench, async |lab| {
        look(lab, request.vial_check).await?;
        let weighing = probe(lab, &Watch::new(), request, &key).await?;
        Ok((weighing, lab.powder_card(powder, lot, None).await?))
    })?;
    report(common, weighing, card)
}

fn request(common: &Common, arguments: &Arguments) -> Result<CharacterisationRequest, Failure> {
    let vial = arguments.vial.clone();
    Ok(CharacterisationRequest {
        powder: arguments.powder.clone(),
        spoonfuls: arguments.spoonfuls,
        limit_mg: arguments.limit_mg,
        policy: arguments.policy.clone(),
        seed: Some(common.seed),
        simulator: arguments.extended.simulator.clone(),
        conditions: arguments.extended.conditions()?,
        lot: arguments.lot.clone(),
        vial_check: if vial.is_some() { VialCheck::Confirm } else { VialCheck::Skip },
        vial,
        operator: arguments.operator.clone(),
        reservation: None,
        labels: arguments.labels.all()?,
    })
}

/// Commits the run, first calibrating the powder if necessary, and waits until the bench has
/// carried it out.
async fn probe(
    lab: &Lab,
    watch: &Watch,
    request: CharacterisationRequest,
    key: &str,
) -> Result<Weighing, Failure> {
    let weighing = match lab.characterise(request.clone(), key).await {
        Err(Error::Conflict { code: "calibration_missing", message }) => {
            let seed = request.seed.unwrap_or(1);
            let (policy, simulator) = (request.policy.as_deref(), request.simulator.as_deref());
            calibrate_first(lab, watch, &message, &request.powder, policy, simulator, seed).await?;
            lab.characterise(request, key).await?
        }
        started => started?,
    };
    ended(lab, watch, &weighing.id).await
}

/// Waits until the run has ended, and says which spoonful it is at.
async fn ended(lab: &Lab, watch: &Watch, id: &str) -> Result<Weighing, Failure> {
    let (mut confirmed, mut said) = (false, 0);
    let mut detail = lab.weighing(id).await?;
    loop {
        if let Some(last) = detail.ticks.last().filter(|last| last.spoonful > said) {
            said = last.spoonful;
            watch.say(&format!(
                "spoonful {said}: {:.1} mg have fallen in {:.0} s",
                last.reading.mass_mg, last.t_s
            ));
        }
        match detail.weighing.state {
            WeighingState::Done | WeighingState::Aborted | WeighingState::Unknown => {
                lab.has_ended(id);
                return Ok(detail.weighing);
            }
            WeighingState::AwaitingVial if !confirmed => {
                lab.vial_ready(id, VialReadyRequest::default()).await?;
                confirmed = true;
            }
            _ => {}
        }
        detail = lab.weighing_later(id, LOOK).await?;
    }
}

fn report(common: &Common, weighing: Weighing, card: CardOfPowder) -> Result<(), Failure> {
    if matches!(weighing.state, WeighingState::Aborted | WeighingState::Unknown) {
        let error = weighing.error.unwrap_or_else(|| "it was stopped".to_owned());
        return Err(Failure::Failed(anyhow::anyhow!("weighing {}: {error}", weighing.id)));
    }
    let document = Document {
        weighing: weighing.id,
        outcome: weighing.outcome,
        limit_mg: weighing.target_mg,
        reading_mg: weighing.reading_mg,
        shakes: weighing.shakes,
        seconds: weighing.seconds,
        note: weighing.error,
        seed: weighing.seed,
        card,
    };
    common.print(&document, || text(&document))
}

fn text(document: &Document) -> String {
    let outcome = serde_json::to_value(document.outcome).ok();
    let mut text = format!(
        "outcome    {}\nfell       {} of at most {} mg\nshakes     {}\nseconds    {:.1}\n",
        outcome.as_ref().and_then(|value| value.as_str()).unwrap_or("unknown"),
        document.reading_mg.map_or_else(|| "unknown".to_owned(), |mg| format!("{mg:.2} mg")),
        document.limit_mg,
        document.shakes.unwrap_or_default(),
        document.seconds.unwrap_or_default(),
    );
    if let Some(note) = &document.note {
        text += &format!("note       {note}\n");
    }
    text + &text_of(&document.card)
}

fn text_of(of: &CardOfPowder) -> String {
    let PowderCard { spoonfuls, shakes, missing, never_flowed, .. } = &of.card;
    let card = &of.card;
    let name = |lot: &Option<String>| lot.clone().unwrap_or_else(|| "unknown".to_owned());
    let lots: Vec<String> =
        of.lots.iter().map(|it| format!("{} ({})", name(&it.lot), it.spoonfuls)).collect();
    let last = of.last_at.map_or_else(String::new, |at| format!(", the last of {at}"));
    let mut text = format!(
        "powder     {}\nof         {spoonfuls} spoonfuls, {shakes} shakes{last}\nlots       {}",
        of.powder,
        lots.join(", ")
    );
    if let Some(missing) = missing {
        return format!("{text}\nno card    {missing}");
    }
    let with = |name: &str, it: Option<Estimate>, digits: usize, unit: &str| {
        it.map_or_else(
            || format!("\n{name:<11}unknown"),
            |it| {
                let Estimate { mean, low, high } = it;
                format!("\n{name:<11}{mean:.digits$} {unit} ({low:.digits$} to {high:.digits$})")
            },
        )
    };
    text += &with("onset", card.onset_deg, 1, "deg");
    if *never_flowed > 0 {
        text += &format!(", {never_flowed} spoonfuls never flowed");
    }
    text += &with("slope", card.slope_per_deg, 3, "per deg, of ln mg");
    text +=
        &card.scatter.map_or_else(String::new, |sd| format!("\nscatter    {sd:.2}, SD of ln mg"));
    text += &with("left", card.left.map(|left| left.mass_mg), 1, "mg");
    if let Some(left) = card.left {
        text += &format!(
            ", {:.0} % of a filling, after {} spoonfuls",
            100.0 * left.share.mean,
            left.spoonfuls
        );
    }
    format!("{text}\n\n{}", curves(&card.curves))
}

fn curves(curves: &[CardCurve]) -> String {
    let rows = curves.iter().flat_map(|curve| {
        let stroke = match curve.stroke {
            StrokeClass::Full => "full",
            StrokeClass::Half => "half",
            StrokeClass::Quarter => "quarter",
        };
        let stroke = format!("{stroke}, {:.1} mm", curve.shake_mm);
        curve.cells.iter().map(move |cell| {
            let band = cell.band_mg.map(|[low, high]| format!("{low:.2} to {high:.2}"));
            vec![
                stroke.clone(),
                format!("{:.1}", cell.pitch_deg),
                cell.n.to_string(),
                format!("{:.2}", cell.mean_mg),
                cell.sd_mg.map_or_else(|| "-".to_owned(), |mg| format!("{mg:.2}")),
                band.unwrap_or_else(|| "-".to_owned()),
            ]
        })
    });
    table(
        &["stroke", "pitch deg", "n", "mean mg", "sd mg", "90 % of the mean"],
        &rows.collect::<Vec<_>>(),
    )
}
