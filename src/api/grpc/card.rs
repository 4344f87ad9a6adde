//! Probing runs and powder cards in the protocol.

use super::convert::{all, at, conditions, labels};
use super::proto::*;
use crate::app;
use flip_core::domain::powder_card as card;

/// The run that a message asks for, and its key.
pub(super) fn asked(asked: CharacteriseRequest) -> (app::CharacterisationRequest, String) {
    let vial_check = Option::<app::VialCheck>::from(asked.vial_check()).unwrap_or_default();
    let request = app::CharacterisationRequest {
        powder: asked.powder,
        spoonfuls: asked.spoonfuls,
        limit_mg: asked.limit_mg,
        policy: asked.policy,
        seed: asked.seed,
        simulator: asked.simulator,
        conditions: conditions(asked.conditions),
        lot: asked.lot,
        vial: asked.vial,
        operator: asked.operator,
        vial_check,
        reservation: asked.reservation,
        labels: labels(asked.labels),
    };
    (request, asked.idempotency_key)
}

impl From<app::CardOfPowder> for PowderCard {
    fn from(of: app::CardOfPowder) -> Self {
        let card = of.card;
        Self {
            powder: of.powder,
            lot: of.lot,
            bench: of.bench.map(super::convert::bench_kind),
            lots: all(of.lots),
            last_at: of.last_at.and_then(at),
            spoonfuls: card.spoonfuls as u64,
            shakes: card.shakes as u64,
            missing: card.missing,
            onset_deg: card.onset_deg.map(Into::into),
            never_flowed: card.never_flowed as u64,
            slope_per_deg: card.slope_per_deg.map(Into::into),
            scatter: card.scatter,
            shaken_out: card.left.map_or(0, |left| left.spoonfuls as u64),
            left_mg: card.left.map(|left| left.mass_mg.into()),
            left_share: card.left.map(|left| left.share.into()),
            curves: all(card.curves),
            judged: of.judged.map(Into::into),
        }
    }
}

impl From<app::JudgedSpoon> for JudgedSpoon {
    fn from(it: app::JudgedSpoon) -> Self {
        let app::JudgedSpoon { investigation, verdict, sentence, simulator } = it;
        Self { investigation, verdict: Verdict::from(verdict).into(), sentence, simulator }
    }
}

impl From<app::LotOnCard> for LotOnCard {
    fn from(it: app::LotOnCard) -> Self {
        Self { lot: it.lot, spoonfuls: it.spoonfuls as u64 }
    }
}

impl From<card::Estimate> for Estimate {
    fn from(card::Estimate { mean, low, high }: card::Estimate) -> Self {
        Self { mean, low, high }
    }
}

impl From<card::CardCurve> for CardCurve {
    fn from(it: card::CardCurve) -> Self {
        let stroke = match it.stroke {
            card::StrokeClass::Full => "full",
            card::StrokeClass::Half => "half",
            card::StrokeClass::Quarter => "quarter",
        };
        Self { stroke: stroke.to_owned(), shake_mm: it.shake_mm, cells: all(it.cells) }
    }
}

impl From<card::CardCell> for CardCell {
    fn from(it: card::CardCell) -> Self {
        Self {
            pitch_deg: it.pitch_deg,
            n: it.n as u64,
            mean_mg: it.mean_mg,
            sd_mg: it.sd_mg,
            low_mg: it.band_mg.map(|band| band[0]),
            high_mg: it.band_mg.map(|band| band[1]),
        }
    }
}
