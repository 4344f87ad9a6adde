//! What is kept: powders and their measurements, shakes, policies, versions of the simulator, the
//! audit trail, tokens.

use super::super::FIRST_PAGE;
use super::super::server::Request;
use super::Lab;
use crate::app::{
    AuditAsked, AuditRecord, AuditVerification, ChosenSimulator, Compared, CurrentSimulator,
    ForgottenShakes, Imported, ImportedShakes, KeptSpoonful, Measured, Measurement, NewToken, Page,
    PageQuery, Policy, Powder, PowderObservation, Result, ShakesWanted, SimulatorVersion,
    TokenEntry,
};
use futures::TryStreamExt;
use serde::Deserialize;

/// The content type of a table.
const CSV: &str = "text/csv; charset=utf-8";

/// A new token as a server answers it.
#[derive(Deserialize)]
struct MadeToken {
    #[serde(flatten)]
    entry: TokenEntry,
    secret: String,
}

/// Which shakes, as a server is asked.
fn shakes(request: Request, wanted: &ShakesWanted) -> Request {
    let ShakesWanted { powder, lot, bench } = wanted;
    request.with("powder", powder.as_ref()).with("lot", lot.as_ref()).with_word("bench", *bench)
}

impl Lab {
    pub(in super::super) async fn powders(&self) -> Result<Vec<Powder>> {
        let page = match self {
            Self::Here(app) => app.powders(FIRST_PAGE).await?,
            Self::There(server) => server.ask(Request::get(&["powders"]).page(&FIRST_PAGE)).await?,
        };
        Ok(page.items)
    }

    pub(in super::super) async fn import_measurements(
        &self,
        csv: &str,
        create: bool,
    ) -> Result<Imported> {
        match self {
            Self::Here(app) => app.import_measurements(csv, create).await,
            Self::There(server) => {
                let path = ["measurements", "import"];
                let file = Request::upload(&path, CSV, csv.as_bytes());
                server.ask(file.with("create", Some(create))).await
            }
        }
    }

    /// Measurements and observations that count, of a powder or of all.
    pub(in super::super) async fn measured(&self, powder: Option<&str>) -> Result<Measured> {
        let server = match self {
            Self::Here(app) => return app.measured(powder).await,
            Self::There(server) => server,
        };
        let powders = match powder {
            Some(powder) => vec![powder.to_owned()],
            None => {
                let list = Request::get(&["powders"]).with("archived", Some("include"));
                server.all::<Powder>(list).await?.into_iter().map(|powder| powder.id).collect()
            }
        };
        let (mut measurements, mut observations) = (Vec::new(), Vec::new());
        for powder in &powders {
            let list = |what: &str| Request::get(&["powders", powder, what]);
            measurements.extend(server.all::<Measurement>(list("measurements")).await?);
            observations.extend(server.all::<PowderObservation>(list("observations")).await?);
        }
        measurements.retain(|it| it.withdrawn.is_none());
        observations.retain(|it| it.withdrawn.is_none());
        measurements.sort_by_key(|it| it.created_at);
        observations.sort_by_key(|it| it.created_at);
        Ok(Measured { measurements, observations })
    }

    /// The same as a file that can be imported.
    pub(in super::super) async fn measured_csv(&self, powder: Option<&str>) -> Result<String> {
        match self {
            Self::Here(app) => Ok(app.measured(powder).await?.csv()),
            Self::There(server) => {
                let file = match powder {
                    Some(powder) => Request::get(&["powders", powder, "measurements.csv"]),
                    None => Request::get(&["measurements.csv"]),
                };
                server.answer(file).await?.text()
            }
        }
    }

    pub(in super::super) async fn compare_methods(&self) -> Result<Vec<Compared>> {
        match self {
            Self::Here(app) => app.compare_methods().await,
            Self::There(server) => server.get(&["measurements", "comparison"]).await,
        }
    }

    pub(in super::super) async fn kept_spoonfuls(
        &self,
        wanted: &ShakesWanted,
    ) -> Result<Vec<KeptSpoonful>> {
        match self {
            Self::Here(app) => app.kept_spoonfuls(wanted).await,
            Self::There(server) => server.all(shakes(Request::get(&["shakes"]), wanted)).await,
        }
    }

    pub(in super::super) async fn shakes_csv(&self, wanted: ShakesWanted) -> Result<String> {
        match self {
            Self::Here(app) => app.shakes_csv(wanted).await?.try_collect().await,
            Self::There(server) => {
                server.answer(shakes(Request::get(&["shakes.csv"]), &wanted)).await?.text()
            }
        }
    }

    pub(in super::super) async fn import_shakes(
        &self,
        csv: &str,
        source: &str,
        create: bool,
    ) -> Result<ImportedShakes> {
        match self {
            Self::Here(app) => app.import_shakes(csv, source, create).await,
            Self::There(server) => {
                let file = Request::upload(&["shakes", "import"], CSV, csv.as_bytes());
                server.ask(file.with("source", Some(source)).with("create", Some(create))).await
            }
        }
    }

    pub(in super::super) async fn forget_shakes(
        &self,
        powder: &str,
        lot: Option<&str>,
    ) -> Result<ForgottenShakes> {
        match self {
            Self::Here(app) => app.forget_shakes(powder, lot).await,
            Self::There(server) => {
                let forget = Request::delete(&["shakes"]).with("powder", Some(powder));
                server.ask(forget.with("lot", lot)).await
            }
        }
    }

    pub(in super::super) async fn policies(&self, page: PageQuery) -> Result<Page<Policy>> {
        match self {
            Self::Here(app) => app.policies(page).await,
            Self::There(server) => server.ask(Request::get(&["policies"]).page(&page)).await,
        }
    }

    pub(in super::super) async fn policy(&self, id: &str) -> Result<Policy> {
        match self {
            Self::Here(app) => app.policy(id).await,
            Self::There(server) => server.get(&["policies", id]).await,
        }
    }

    pub(in super::super) async fn policy_bytes(&self, id: &str) -> Result<Vec<u8>> {
        match self {
            Self::Here(app) => app.policy_bytes(id).await,
            Self::There(server) => {
                Ok(server.answer(Request::get(&["policies", id, "weights"])).await?.body)
            }
        }
    }

    /// Imports the file given in `field`; `true` if it was not known.
    pub(in super::super) async fn import_policy(
        &self,
        field: &'static str,
        file: &[u8],
    ) -> Result<(Policy, bool)> {
        match self {
            Self::Here(app) => app.import_policy(field, file).await,
            Self::There(server) => {
                // Its id is a hash of it.
                let file = Request::upload(&["policies"], "application/octet-stream", file);
                let answer = server.answer(file.repeatable()).await?;
                Ok((answer.json()?, answer.status == 201))
            }
        }
    }

    pub(in super::super) async fn simulators(&self) -> Result<Vec<SimulatorVersion>> {
        let page = match self {
            Self::Here(app) => app.simulators(FIRST_PAGE).await?,
            Self::There(server) => {
                server.ask(Request::get(&["simulators"]).page(&FIRST_PAGE)).await?
            }
        };
        Ok(page.items)
    }

    pub(in super::super) async fn current_simulator(&self) -> Result<CurrentSimulator> {
        match self {
            Self::Here(app) => app.current_simulator().await,
            Self::There(server) => server.get(&["simulators", "current"]).await,
        }
    }

    pub(in super::super) async fn choose_simulator(
        &self,
        chosen: &ChosenSimulator,
    ) -> Result<CurrentSimulator> {
        match self {
            Self::Here(app) => app.choose_simulator(chosen).await,
            Self::There(server) => {
                server.ask(Request::put(&["simulators", "current"], chosen)?).await
            }
        }
    }

    pub(in super::super) async fn verify_audit(
        &self,
        hash: Option<&str>,
    ) -> Result<AuditVerification> {
        match self {
            Self::Here(app) => app.verify_audit(hash).await,
            Self::There(server) => {
                let verify = Request::get(&["audit", "verification"]).with("hash", hash);
                server.ask(verify.long()).await
            }
        }
    }

    /// The records that match, oldest first.
    pub(in super::super) async fn audit_records(
        &self,
        asked: AuditAsked,
    ) -> Result<Vec<AuditRecord>> {
        match self {
            Self::Here(app) => {
                let mut all = Vec::new();
                app.export_audit(asked, |record| all.push(record.clone())).await?;
                Ok(all)
            }
            Self::There(server) => {
                let AuditAsked { wanted, since, until } = asked;
                let records = Request::get(&["audit.json"])
                    .with("weighing", wanted.weighing)
                    .with("kind", wanted.kind)
                    .with("person", wanted.person)
                    .with("q", wanted.text)
                    .with("since", since)
                    .with("until", until);
                server.ask(records.long()).await
            }
        }
    }

    /// Makes a token; returns its entry and its secret.
    pub(in super::super) async fn make_token(
        &self,
        new: &NewToken,
    ) -> Result<(TokenEntry, String)> {
        match self {
            Self::Here(app) => app.make_token(new).await,
            Self::There(server) => {
                let MadeToken { entry, secret } = server.post(&["tokens"], new).await?;
                Ok((entry, secret))
            }
        }
    }

    pub(in super::super) async fn tokens(&self, page: PageQuery) -> Result<Page<TokenEntry>> {
        match self {
            Self::Here(app) => app.tokens(page).await,
            Self::There(server) => server.ask(Request::get(&["tokens"]).page(&page)).await,
        }
    }

    pub(in super::super) async fn revoke_token(&self, id: &str) -> Result<TokenEntry> {
        match self {
            Self::Here(app) => app.revoke_token(id).await,
            Self::There(server) => {
                // A token that has ended stays as it is.
                server.ask(Request::delete(&["tokens", id]).repeatable()).await
            }
        }
    }
}
