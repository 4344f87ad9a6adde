//! The card of a powder, computed from its shakes whenever it is asked for: what is forgotten is on
//! no card.

use super::investigations::Investigation;
use super::shakes::KeptSpoonful;
use super::{App, Result};
use flip_core::card::card_of;
use flip_core::domain::bench::BenchKind;
use flip_core::domain::powder_card::PowderCard;
use flip_core::domain::shake::Spoonful;
use flip_core::domain::timestamp::Timestamp;
use flip_discover::report::Verdict;
use flip_store::page::PageQuery;
use flip_store::spoonfuls::ShakesWanted;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Newest investigations among which one of the powder's shakes is looked for.
const LOOKED_AT: u32 = 50;

/// The card, and what it is of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CardOfPowder {
    /// Powder id.
    pub powder: String,
    /// Only of this lot; absent for all, and unknown ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Of weighings on this bench, and imported spoonfuls; absent for every bench.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bench: Option<BenchKind>,
    /// Where its spoonfuls come from.
    pub lots: Vec<LotOnCard>,
    /// When the last weighing with a shake began, or the last spoonful was imported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last_at: Option<Timestamp>,
    /// What the newest investigation of its shakes said; absent if there was none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub judged: Option<JudgedSpoon>,
    /// The numbers.
    pub card: PowderCard,
}

/// What an investigation said of a powder's shakes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JudgedSpoon {
    /// The investigation.
    pub investigation: String,
    /// Whether the simulated spoon is wrong, and whether the cause has a name.
    pub verdict: Verdict,
    /// In plain words.
    pub sentence: String,
    /// The version of the simulator made from it; absent if none was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub simulator: Option<String>,
}

/// Spoonfuls of a lot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LotOnCard {
    /// Its name; absent if unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lot: Option<String>,
    /// Spoonfuls.
    pub spoonfuls: usize,
}

impl App {
    /// How a powder, or one of its lots, leaves the spoon of a kind of bench: of doses, probing runs
    /// and imported spoonfuls that are not forgotten. By default on the bench of this application,
    /// or on every bench if it has none.
    ///
    /// # Errors
    /// `NotFound`: an unknown powder. `Invalid`: an impossible lot.
    pub async fn powder_card(
        &self,
        powder: &str,
        lot: Option<&str>,
        bench: Option<BenchKind>,
    ) -> Result<CardOfPowder> {
        let own = || self.jobs_or_refuse().ok().map(|jobs| jobs.bench().kind());
        let bench = bench.or_else(own);
        let (powder, lot) = (powder.to_owned(), lot.map(str::to_owned));
        let wanted = ShakesWanted { powder: Some(powder.clone()), lot: lot.clone(), bench };
        let kept = self.kept_spoonfuls(&wanted).await?;
        let spoonfuls: Vec<Spoonful> = kept.iter().map(|it| it.spoonful.clone()).collect();
        let judged = self.judged_spoon(&powder).await?;
        Ok(CardOfPowder {
            powder,
            lot,
            bench,
            lots: lots(&kept),
            last_at: kept.iter().map(|it| it.at).max(),
            judged,
            card: card_of(&spoonfuls),
        })
    }
}

impl App {
    /// What the newest investigation that judged this powder's shakes said, among the newest ones.
    async fn judged_spoon(&self, powder: &str) -> Result<Option<JudgedSpoon>> {
        let newest = self.investigations(PageQuery::first(LOOKED_AT)).await?.items;
        let has_spoons = |it: &&Investigation| it.spoonfuls > 0 && it.verdict.is_some();
        for found in newest.iter().filter(has_spoons) {
            let Ok(report) = self.report(&found.job.id).await else { continue };
            let Some(spoon) = report.spoon else { continue };
            let Some(of) = spoon.powders.into_iter().find(|it| it.powder == powder) else {
                continue;
            };
            let made = report.simulator_version.extended.filter(|_| of.extension.is_some());
            return Ok(Some(JudgedSpoon {
                investigation: found.job.id.clone(),
                verdict: of.verdict,
                sentence: of.sentence,
                simulator: made,
            }));
        }
        Ok(None)
    }
}

fn lots(kept: &[KeptSpoonful]) -> Vec<LotOnCard> {
    let mut counts: BTreeMap<Option<String>, usize> = BTreeMap::new();
    for it in kept {
        *counts.entry(it.spoonful.lot.clone()).or_default() += 1;
    }
    counts.into_iter().map(|(lot, spoonfuls)| LotOnCard { lot, spoonfuls }).collect()
}
