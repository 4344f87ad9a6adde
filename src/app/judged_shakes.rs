//! The shakes that an investigation or a calibration uses: stored ones, or those of a file, with what calibration
//! says of their powders.

use super::check::Check;
use super::file_powders::FilePowders;
use super::shake_csv;
use super::shakes::KeptSpoonful;
use super::{App, Result};
use crate::jobs::SpoonSpec;
use flip_core::domain::FieldError;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::shake::Spoonful;
use flip_core::domain::spoon::Spoon;
use flip_discover::spoon::{Calibrated, Settings};
use flip_store::spoonfuls::ShakesWanted;
use serde::{Deserialize, Serialize};

/// Most replayed spoonfuls for each powder: half an hour of a processor where nothing is wrong.
const BUDGET_REPLAYS: u32 = 600;
/// Most of them.
const BUDGET_REPLAYS_MAX: u32 = 100_000;
/// Most sets of a powder that are replayed.
const SETS_MAX: usize = 10;

/// Which stored shakes to judge. Empty: all.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredShakes {
    /// Only of this powder.
    pub powder: Option<String>,
    /// Only of this lot.
    pub lot: Option<String>,
    /// Only of weighings on this kind of bench, and imported ones; needed where shakes of several
    /// kinds are stored.
    pub bench: Option<BenchKind>,
}

/// What an investigation is asked of spoons.
pub(super) struct AskedOfSpoons<'a> {
    pub csv: Option<&'a str>,
    pub stored: Option<&'a StoredShakes>,
    pub budget_replays: Option<u32>,
    /// Channels judged beside the spoon's.
    pub beside: u32,
    pub seed: u64,
}

impl App {
    /// The specification of what spoons are asked; `None` where shakes were not given.
    ///
    /// # Errors
    /// `Invalid`: errors in the file by row and column, a budget out of bounds, shakes of several
    /// kinds of bench, none, or none of a calibrated powder.
    pub(super) async fn spoon_spec(&self, asked: AskedOfSpoons<'_>) -> Result<Option<SpoonSpec>> {
        let usual = Settings { seed: asked.seed, ..Settings::among(asked.beside + 1) };
        let mut check = Check::default();
        let replays = asked.budget_replays.unwrap_or(BUDGET_REPLAYS);
        check.count("budget_replays", replays, usual.replays_min(), BUDGET_REPLAYS_MAX);
        check.done()?;
        let (field, spoonfuls) = match (asked.csv, asked.stored) {
            (None, None) => return Ok(None),
            (Some(_), Some(_)) => {
                let advice = "is one file or the stored shakes: leave `shakes` or `shakes_csv` out";
                return Err(FieldError::new("shakes", advice).into());
            }
            (Some(csv), None) => ("shakes_csv", self.of_file(csv).await?),
            (None, Some(stored)) => ("shakes", self.stored_spoonfuls(stored).await?),
        };
        let calibrated = self.calibrated(&spoonfuls).await?;
        let has_sets = |it: &&Spoonful| calibrated.iter().any(|of| of.powder == it.powder);
        if spoonfuls.iter().filter(has_sets).count() < 2 {
            let advice = format!(
                "hold {} spoonfuls, and fewer than two of a calibrated powder: weigh more, and `flip calibrate` the powder first",
                spoonfuls.len()
            );
            return Err(FieldError::new(field, advice).into());
        }
        let spoon = match self.jobs_or_refuse() {
            Ok(jobs) => jobs.bench().spoon(),
            Err(_) => Spoon::default(),
        };
        let settings = Settings { replays, ..usual };
        Ok(Some(SpoonSpec { spoonfuls, calibrated, settings, spoon }))
    }

    async fn of_file(&self, csv: &str) -> Result<Vec<Spoonful>> {
        let (mut entries, names) = shake_csv::read(csv)?;
        let known = self.store().powder_names().await?;
        let of_rows = entries.iter().map(|it| (it.spoonful.powder.as_str(), it.row));
        let powders = FilePowders::find(of_rows, &names, &known, false)?;
        entries.iter_mut().for_each(|it| powders.rename(&mut it.spoonful.powder));
        Ok(entries.into_iter().map(|it| it.spoonful).collect())
    }

    /// The stored spoonfuls asked for.
    ///
    /// # Errors
    /// `Invalid`: shakes of several kinds of bench; `NotFound`: an unknown powder.
    pub(super) async fn stored_spoonfuls(&self, stored: &StoredShakes) -> Result<Vec<Spoonful>> {
        let StoredShakes { powder, lot, bench } = stored.clone();
        let kept = self.kept_spoonfuls(&ShakesWanted { powder, lot, bench }).await?;
        of_one_kind(&kept)?;
        Ok(kept.into_iter().map(|it| it.spoonful).collect())
    }

    /// What calibration says of each of these powders that is calibrated.
    async fn calibrated(&self, spoonfuls: &[Spoonful]) -> Result<Vec<Calibrated>> {
        let mut all: Vec<Calibrated> = Vec::new();
        for Spoonful { powder, .. } in spoonfuls {
            if all.iter().any(|it| it.powder == *powder) {
                continue;
            }
            let sets = self.calibrated_sets(Some(powder), 0.0, None).await?.unwrap_or_default();
            let sets: Vec<_> = sets.into_iter().take(SETS_MAX).map(|it| it.parameters).collect();
            let angle = self.existing_powder(powder).await?.flowability;
            if !sets.is_empty() {
                all.push(Calibrated { powder: powder.clone(), sets, angle });
            }
        }
        Ok(all)
    }
}

/// Refuses shakes of weighings on several kinds of bench: a simulator that is wrong of one of them
/// may be right of another.
fn of_one_kind(kept: &[KeptSpoonful]) -> Result<()> {
    let mut kinds: Vec<BenchKind> = Vec::new();
    for kind in kept.iter().filter_map(|it| it.bench) {
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    if kinds.len() < 2 {
        return Ok(());
    }
    let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
    let advice = format!("must be one of {}: shakes of all of them are stored", names.join(", "));
    Err(FieldError::new("shakes.bench", advice).into())
}
