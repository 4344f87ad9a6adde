//! Doses, lists of doses, probing runs.

use super::super::server::Request;
use super::{Lab, Look};
use crate::app::{
    CardOfPowder, CharacterisationRequest, DoseList, DoseListRequest, Page, PageQuery, Result,
    VialReadyRequest, Weighing, WeighingDetail, WeighingRequest, WeighingsAsked,
};
use flip_core::domain::bench::BenchKind;

impl Lab {
    /// Commits the intent to weigh a dose, or finds the one of this key.
    pub(in super::super) async fn start_weighing(
        &self,
        request: WeighingRequest,
        key: &str,
    ) -> Result<Weighing> {
        match self {
            Self::Here(app) => Ok(app.start_weighing(request, key).await?.0),
            Self::There(server) => {
                server.dose(Request::post(&["weighings"], &request)?.key(key)).await
            }
        }
    }

    /// As [`Lab::start_weighing`], of a probing run.
    pub(in super::super) async fn characterise(
        &self,
        request: CharacterisationRequest,
        key: &str,
    ) -> Result<Weighing> {
        match self {
            Self::Here(app) => Ok(app.characterise(request, key).await?.0),
            Self::There(server) => {
                server.dose(Request::post(&["characterisations"], &request)?.key(key)).await
            }
        }
    }

    /// As [`Lab::start_weighing`], of a list of doses. `true`: it was begun before.
    pub(in super::super) async fn start_dose_list(
        &self,
        request: DoseListRequest,
        key: &str,
    ) -> Result<(DoseList, bool)> {
        match self {
            Self::Here(app) => app.start_dose_list(request, key).await,
            Self::There(server) => {
                let request = Request::post(&["weighings", "list"], &request)?.key(key);
                let begun = server.doses(request, |answer| {
                    let list: DoseList = answer.json()?;
                    let ids = list.doses.iter().filter_map(|it| it.weighing.clone()).collect();
                    Ok(((list, answer.is_replayed), ids))
                });
                begun.await
            }
        }
    }

    /// A weighing as it is now.
    pub(in super::super) async fn weighing(&self, id: &str) -> Result<WeighingDetail> {
        match self {
            Self::Here(app) => app.weighing(id).await,
            Self::There(server) => server.get(&["weighings", id]).await,
        }
    }

    /// A weighing after a while, or once it has ended.
    pub(in super::super) async fn weighing_later(
        &self,
        id: &str,
        look: Look,
    ) -> Result<WeighingDetail> {
        match self {
            Self::Here(app) => {
                tokio::time::sleep(look.here).await;
                app.weighing(id).await
            }
            Self::There(server) => {
                server.ask(Request::get(&["weighings", id]).wait(look.there_s)).await
            }
        }
    }

    /// Takes note that a weighing that was waited for has ended.
    pub(in super::super) fn has_ended(&self, id: &str) {
        if let Self::There(server) = self {
            server.ended(id);
        }
    }

    pub(in super::super) async fn vial_ready(
        &self,
        id: &str,
        request: VialReadyRequest,
    ) -> Result<Weighing> {
        match self {
            Self::Here(app) => app.vial_ready(id, request).await,
            Self::There(server) => {
                let found = server.post(&["weighings", id, "vial-ready"], &request).await?;
                server.awaits(id);
                Ok(found)
            }
        }
    }

    /// The newest weighing, if there is one.
    pub(in super::super) async fn newest_weighing(&self) -> Result<Option<Weighing>> {
        let first = PageQuery::first(1);
        let page: Page<Weighing> = match self {
            Self::Here(app) => app.weighings(WeighingsAsked::default(), first).await?.page,
            Self::There(server) => server.ask(Request::get(&["weighings"]).page(&first)).await?,
        };
        Ok(page.items.into_iter().next())
    }

    pub(in super::super) async fn powder_card(
        &self,
        powder: &str,
        lot: Option<&str>,
        bench: Option<BenchKind>,
    ) -> Result<CardOfPowder> {
        match self {
            Self::Here(app) => app.powder_card(powder, lot, bench).await,
            Self::There(server) => {
                let card = Request::get(&["powders", powder, "card"]).with("lot", lot);
                server.ask(card.with_word("bench", bench)).await
            }
        }
    }

    /// The certificate of a weighing; the laboratory is the server's own there.
    pub(in super::super) async fn certificate(
        &self,
        id: &str,
        laboratory: Option<&str>,
    ) -> Result<String> {
        match self {
            Self::Here(app) => app.certificate(id, laboratory).await,
            Self::There(server) => {
                let page = Request::get(&["weighings", id, "certificate.html"]);
                server.answer(page.long()).await?.text()
            }
        }
    }
}
