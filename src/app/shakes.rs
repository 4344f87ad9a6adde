//! Shakes as measurements: those of the weighings, read from their traces, and those of other
//! benches, imported from files.

use super::check::Check;
use super::file_powders::FilePowders;
use super::shake_csv;
use super::{App, Error, Result};
use flip_core::domain::apparatus::Apparatus;
use flip_core::domain::bench::{BenchKind, Tick};
use flip_core::domain::shake::{ShakesOf, Spoonful, display_step_mg};
use flip_core::domain::timestamp::Timestamp;
use flip_discover::reading::NamedPowder;
use flip_store::artifacts::sha256_hex;
use flip_store::now;
use flip_store::page::{LIST_LIMIT_MAX, Page, PageQuery, Window};
use flip_store::said::{Row, RowOf};
use flip_store::spoonfuls::{Forgotten, ImportedSpoonful, ShakesWanted};
use flip_store::weighings::{Weighing, WeighingRow};
use futures::stream::{self, BoxStream};
use futures::{StreamExt, TryStreamExt};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::HashMap;

/// Positions from here on are those of imported spoonfuls, which follow the weighings.
const IMPORTED: i64 = 1 << 62;
/// Display step assumed where neither the weighing nor its readings tell, mg: what the traces of
/// older versions were read with.
const STEP_MG: f64 = 1.0;
/// How many traces are read at a time: a bucket answers many at once.
const TRACES_AT_ONCE: usize = 8;
/// Maximum length of the name of a lot.
const LOT_CHARS_MAX: usize = 200;

/// A spoonful and where it comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptSpoonful {
    /// The spoonful.
    pub spoonful: Spoonful,
    /// The bench that shook it; absent if it was imported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// Where imported numbers come from.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub source: String,
    /// When the weighing began, or when it was imported.
    pub at: Timestamp,
}

/// Result of importing a file of shakes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ImportedShakes {
    /// Ids of the powders registered because the file names them.
    pub powders: Vec<String>,
    /// Powders given by name in the file, with the ids made or found for them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub named: Vec<NamedPowder>,
    /// Spoonfuls added.
    pub spoonfuls: usize,
    /// Their shakes.
    pub shakes: usize,
    /// Spoonfuls of the file that were stored already with the same shakes, and were skipped.
    #[serde(default)]
    pub already_stored: usize,
}

/// What was forgotten.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ForgottenShakes {
    /// Up to when.
    pub forgotten: Forgotten,
    /// Spoonfuls that were listed until then.
    pub spoonfuls: usize,
}

/// A position in the list, and what stands there: a weighing holds any number of spoonfuls.
type Placed = (i64, Vec<KeptSpoonful>);

impl App {
    /// Spoonfuls that count, those of weighings first, each oldest first. A page holds up to its
    /// limit of weighings and imported spoonfuls.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot, a wrong page.
    pub async fn list_shakes(
        &self,
        wanted: &ShakesWanted,
        page: PageQuery,
    ) -> Result<Page<KeptSpoonful>> {
        self.check_wanted(wanted).await?;
        let window = page.window(LIST_LIMIT_MAX)?;
        let Page { items, next } = window.page(self.shakes_from(wanted, window.clone()).await?);
        Ok(Page { items: items.into_iter().flatten().collect(), next })
    }

    /// All spoonfuls that count, in the same order.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot.
    pub async fn kept_spoonfuls(&self, wanted: &ShakesWanted) -> Result<Vec<KeptSpoonful>> {
        self.check_wanted(wanted).await?;
        let mut all = Vec::new();
        let mut window = Window { limit: LIST_LIMIT_MAX, ..Window::default() };
        loop {
            let found = self.shakes_from(wanted, window.clone()).await?;
            let Some((last, _)) = found.last() else { return Ok(all) };
            window.after = Some(*last);
            all.extend(found.into_iter().flat_map(|(_, spoonfuls)| spoonfuls));
        }
    }

    /// All spoonfuls of a powder, or of one of its lots, that count: on this kind of bench and
    /// imported, or on any.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot.
    pub async fn spoonfuls(
        &self,
        powder: &str,
        lot: Option<&str>,
        bench: Option<BenchKind>,
    ) -> Result<Vec<Spoonful>> {
        let (powder, lot) = (Some(powder.to_owned()), lot.map(str::to_owned));
        let kept = self.kept_spoonfuls(&ShakesWanted { powder, lot, bench }).await?;
        Ok(kept.into_iter().map(|it| it.spoonful).collect())
    }

    /// The same as a file that [`App::import_shakes`] reads, one batch after another.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot.
    pub async fn shakes_csv(
        &self,
        wanted: ShakesWanted,
    ) -> Result<BoxStream<'static, Result<String>>> {
        self.check_wanted(&wanted).await?;
        let header = stream::once(async { Ok(shake_csv::write(std::iter::empty(), true)) });
        let app = self.clone();
        let rows = stream::try_unfold(None, move |after| {
            let (app, wanted) = (app.clone(), wanted.clone());
            async move {
                let window = Window { after, limit: LIST_LIMIT_MAX, ..Window::default() };
                let found = app.shakes_from(&wanted, window).await?;
                let last = found.last().map(|(last, _)| *last);
                let all = found.iter().flat_map(|(_, kept)| kept).map(|kept| &kept.spoonful);
                Ok::<_, Error>(last.map(|last| (shake_csv::write(all, false), Some(last))))
            }
        });
        Ok(header.chain(rows).boxed())
    }

    /// Stores the spoonfuls of a CSV file, or none. A powder is given by its id or its name; an
    /// unregistered one is refused, or, with `create`, registered. Spoonfuls that are listed
    /// already, with the same shakes, are skipped.
    ///
    /// # Errors
    /// `Invalid` with every invalid cell as `row[2].fell_mg`, the header being row 1, and spoonfuls
    /// whose name is taken by others.
    pub async fn import_shakes(
        &self,
        csv: &str,
        source: &str,
        create: bool,
    ) -> Result<ImportedShakes> {
        let mut check = Check::default();
        check.source("source", source);
        check.done()?;
        let (mut entries, names) = shake_csv::read(csv)?;
        let known = self.store().powder_names().await?;
        let of_rows = entries.iter().map(|it| (it.spoonful.powder.as_str(), it.row));
        let powders = FilePowders::find(of_rows, &names, &known, create)?;
        entries.iter_mut().for_each(|it| powders.rename(&mut it.spoonful.powder));
        let mut tx = self.store().write().await?;
        let mut rows = powders.register(&mut tx).await?;
        // Other imports wait for this transaction, so what is stored now is complete.
        let stored = self.stored_as(&entries, &powders.new_ids()).await?;
        let already_stored = leave_out(&mut entries, &stored)?;
        for entry in &entries {
            let kept = tx.insert_spoonful(&entry.spoonful, source, now()).await?;
            rows.push(Row::of(RowOf::Spoonful, &kept.id, &kept));
        }
        let imported = ImportedShakes {
            powders: powders.new_ids(),
            named: powders.named.clone(),
            spoonfuls: entries.len(),
            shakes: entries.iter().map(|it| it.spoonful.shakes.len()).sum(),
            already_stored,
        };
        let mut said = json!(imported);
        said["source"] = source.into();
        said["sha256"] = sha256_hex(csv.as_bytes()).into();
        tx.audit_deed(None, "import shakes", said, now()).await?;
        tx.audit_rows(rows).await?;
        tx.commit().await?;
        Ok(imported)
    }

    /// From now on neither uses nor lists the shakes of a powder until now, or of one of its lots.
    /// Weighings, traces and imported rows stay as evidence.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot.
    pub async fn forget_shakes(&self, powder: &str, lot: Option<&str>) -> Result<ForgottenShakes> {
        let (powder, lot) = (Some(powder.to_owned()), lot.map(str::to_owned));
        let wanted = ShakesWanted { powder, lot, bench: None };
        let spoonfuls = self.kept_spoonfuls(&wanted).await?.len();
        let powder = wanted.powder.unwrap_or_default();
        let mut tx = self.store().write().await?;
        let forgotten = tx.forget_shakes(&powder, wanted.lot.as_deref(), now()).await?;
        tx.commit().await?;
        Ok(ForgottenShakes { forgotten, spoonfuls })
    }

    async fn check_wanted(&self, wanted: &ShakesWanted) -> Result<()> {
        let mut check = Check::default();
        if let Some(lot) = &wanted.lot {
            check.text("lot", lot, LOT_CHARS_MAX);
        }
        check.done()?;
        if let Some(powder) = &wanted.powder {
            self.existing_powder(powder).await?;
        }
        Ok(())
    }

    /// One batch of the list: weighings, then imported spoonfuls.
    async fn shakes_from(&self, wanted: &ShakesWanted, window: Window) -> Result<Vec<Placed>> {
        let mut found: Vec<Placed> = Vec::new();
        if window.after() < IMPORTED {
            let shaken = self.store().shaken(wanted, window.clone()).await?;
            let read = stream::iter(shaken)
                .map(async |(seq, row)| Ok::<_, Error>((seq, self.of_weighing(&row).await?)));
            found.extend(read.buffered(TRACES_AT_ONCE).try_collect::<Vec<_>>().await?);
        }
        let Some(limit) = window.limit.checked_sub(found.len() as u32) else { return Ok(found) };
        let after = Some(window.after().saturating_sub(IMPORTED).max(0));
        let rest = self
            .store()
            .imported_spoonfuls(wanted, Window { after, limit, ..Window::default() })
            .await?;
        found.extend(rest.into_iter().map(|(seq, it)| (IMPORTED + seq, vec![of_import(it)])));
        Ok(found)
    }

    /// The spoonfuls of a weighing; none if its trace is lost, which concerns no other.
    async fn of_weighing(&self, row: &WeighingRow) -> Result<Vec<KeptSpoonful>> {
        let WeighingRow { weighing, trace: Some(trace), .. } = row else { return Ok(Vec::new()) };
        match self.stored_ticks(trace).await {
            Ok(ticks) => Ok(spoonfuls_of(weighing, &ticks)),
            Err(error @ Error::Unavailable(_)) => Err(error),
            Err(error) => {
                tracing::warn!(weighing = weighing.id, %error, "the shakes of a weighing cannot be read");
                Ok(Vec::new())
            }
        }
    }

    /// What is listed of the powders in a file, by [`key`].
    async fn stored_as(
        &self,
        entries: &[shake_csv::Entry],
        new: &[String],
    ) -> Result<HashMap<String, Spoonful>> {
        let mut powders: Vec<&String> = entries.iter().map(|it| &it.spoonful.powder).collect();
        powders.sort();
        powders.dedup();
        let mut stored = HashMap::new();
        for powder in powders.into_iter().filter(|powder| !new.contains(powder)) {
            let spoonfuls = self.spoonfuls(powder, None, None).await?;
            stored.extend(spoonfuls.into_iter().map(|it| (key(&it), it)));
        }
        Ok(stored)
    }
}

/// What makes a spoonful one: no id contains a line break.
fn key(it: &Spoonful) -> String {
    format!("{}\n{}\n{}", it.powder, it.spoonful, it.weighing)
}

/// Leaves out what is stored already, and returns how many.
///
/// # Errors
/// Every spoonful whose name is taken by one with other shakes.
fn leave_out(
    entries: &mut Vec<shake_csv::Entry>,
    stored: &HashMap<String, Spoonful>,
) -> Result<usize> {
    let mut check = Check::default();
    let before = entries.len();
    entries.retain(|entry| match stored.get(&key(&entry.spoonful)) {
        None => true,
        Some(known) if *known == entry.spoonful => false,
        Some(_) => {
            let advice = format!(
                "`{}` is stored already with other shakes: give it another name, or forget the powder's shakes first",
                entry.spoonful.weighing
            );
            check.refuse(&format!("row[{}].weighing", entry.row), advice);
            true
        }
    });
    check.done()?;
    Ok(before - entries.len())
}

/// The spoonfuls of a weighing with these ticks. Its session is the day on which it began (UTC).
pub(super) fn spoonfuls_of(weighing: &Weighing, ticks: &[Tick]) -> Vec<KeptSpoonful> {
    let at = weighing.started_at.unwrap_or(weighing.created_at);
    let of = ShakesOf {
        weighing: weighing.id.clone(),
        powder: weighing.powder.clone(),
        lot: weighing.asked.lot.clone(),
        session: at.to_string().split('T').next().map(str::to_owned),
    };
    let apparatus = weighing.apparatus.unwrap_or_else(|| unrecorded(ticks));
    let kept =
        |spoonful| KeptSpoonful { spoonful, bench: weighing.bench, source: String::new(), at };
    Spoonful::of(ticks, &apparatus, &of).into_iter().map(kept).collect()
}

/// Of a weighing from before it was recorded what it was made with: only its display shows.
fn unrecorded(ticks: &[Tick]) -> Apparatus {
    let shown = display_step_mg(ticks.iter().map(|tick| tick.reading.mass_mg));
    let readability_mg = shown.unwrap_or(STEP_MG);
    Apparatus { readability_mg, repeatability_mg: None, capacity_mg: None, stroke: None }
}

fn of_import(it: ImportedSpoonful) -> KeptSpoonful {
    let ImportedSpoonful { spoonful, source, created_at, .. } = it;
    KeptSpoonful { spoonful, bench: None, source, at: created_at }
}
