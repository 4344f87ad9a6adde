//! `flip.v1.Weighings`.

use super::convert::{all, conditions, labels, missing, named, page};
use super::proto::*;
use super::shakes::bench_kind;
use super::{EventStream, Service, after, read, watch, write};
use crate::api::problem::Problem;
use crate::app;
use crate::app::Topic;
use crate::app::{DoseListRequest, LabelWanted, WeighingRequest, WeighingsAsked, WeighingsWanted};
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl weighings_server::Weighings for Service {
    async fn start_weighing(
        &self,
        request: Request<StartWeighingRequest>,
    ) -> Result<Response<StartWeighingResponse>, Status> {
        let (request, key) = dose(write(request)?)?;
        let (weighing, replayed) = self.app.start_weighing(request, &key).await?;
        Ok(Response::new(StartWeighingResponse { weighing: Some(weighing.into()), replayed }))
    }

    async fn start_dose_list(
        &self,
        request: Request<StartDoseListRequest>,
    ) -> Result<Response<StartDoseListResponse>, Status> {
        let asked = write(request)?;
        let vial_check = Option::<app::VialCheck>::from(asked.vial_check()).unwrap_or_default();
        let doses: Result<Vec<_>, Problem> =
            asked.doses.into_iter().map(|one| Ok(dose(one)?.0)).collect();
        let request = DoseListRequest {
            name: asked.name,
            doses: doses?,
            table: asked.table,
            tolerance: asked.tolerance.map(|given| tolerance(Some(given))).transpose()?,
            operator: asked.operator,
            checked: asked.checked,
            policy: asked.policy,
            vial_check,
            reservation: asked.reservation,
            labels: labels(asked.labels),
            check: asked.check,
        };
        let (list, replayed) = match request.check {
            true => (self.app.check_dose_list(request).await?, false),
            false => self.app.start_dose_list(request, &asked.idempotency_key).await?,
        };
        let app::DoseList { name, doses } = list;
        Ok(Response::new(StartDoseListResponse { name, doses: all(doses), replayed }))
    }

    async fn characterise(
        &self,
        request: Request<CharacteriseRequest>,
    ) -> Result<Response<StartWeighingResponse>, Status> {
        let (request, key) = super::card::asked(write(request)?);
        let (weighing, replayed) = self.app.characterise(request, &key).await?;
        Ok(Response::new(StartWeighingResponse { weighing: Some(weighing.into()), replayed }))
    }

    async fn list_weighings(
        &self,
        request: Request<ListWeighingsRequest>,
    ) -> Result<Response<ListWeighingsResponse>, Status> {
        let asked = read(request)?;
        let bench = asked.bench.as_deref().map(|name| bench_kind("bench", name));
        let wanted = WeighingsWanted {
            powder: asked.powder,
            lot: asked.lot,
            vial: asked.vial,
            operator: asked.operator,
            list: asked.list,
            policy: asked.policy,
            bench: bench.transpose()?,
            label: LabelWanted::among(asked.label.as_deref()).map_err(Problem::from)?,
            state: named::<WeighingState, _>("state", asked.state)?,
            outcome: named::<Outcome, _>("outcome", asked.outcome)?,
            outside: asked.outside,
            text: asked.q,
            sort: named::<WeighingSort, _>("sort", asked.sort)?.unwrap_or_default(),
            ..WeighingsWanted::default()
        };
        let wanted = WeighingsAsked { wanted, since: asked.since, until: asked.until };
        let window = page(asked.page);
        let app::WeighingsFound { page, total } = self.app.weighings(wanted, window).await?;
        let page = self.app.all_labelled(page).await?;
        Ok(Response::new(ListWeighingsResponse { items: all(page.items), next: page.next, total }))
    }

    async fn get_weighing(
        &self,
        request: Request<GetWeighingRequest>,
    ) -> Result<Response<WeighingDetail>, Status> {
        let found = self.app.weighing(&read(request)?.id).await?;
        Ok(Response::new(self.app.labelled(found).await?.into()))
    }

    async fn get_certificate(
        &self,
        request: Request<GetCertificateRequest>,
    ) -> Result<Response<Certificate>, Status> {
        let GetCertificateRequest { id, list } = read(request)?;
        let html = match (id, list) {
            (Some(id), None) => self.app.certificate(&id, None).await?,
            (None, Some(list)) => self.app.list_certificate(&list).await?,
            _ => return Err(missing("id").into()),
        };
        Ok(Response::new(Certificate { html }))
    }

    async fn get_asm(&self, request: Request<GetAsmRequest>) -> Result<Response<Asm>, Status> {
        let json = self.app.asm(&read(request)?.id).await?.to_string();
        Ok(Response::new(Asm { json }))
    }

    async fn stop_weighing(
        &self,
        request: Request<StopWeighingRequest>,
    ) -> Result<Response<Weighing>, Status> {
        Ok(Response::new(self.app.stop_weighing(&write(request)?.id).await?.0.into()))
    }

    async fn vial_ready(
        &self,
        request: Request<VialReadyRequest>,
    ) -> Result<Response<Weighing>, Status> {
        let VialReadyRequest { id, by, vial } = write(request)?;
        Ok(Response::new(
            self.app.vial_ready(&id, app::VialReadyRequest { by, vial }).await?.into(),
        ))
    }

    type WatchWeighingStream = EventStream;

    async fn watch_weighing(
        &self,
        request: Request<WatchRequest>,
    ) -> Result<Response<EventStream>, Status> {
        let WatchRequest { id, after_seq } = read(request)?;
        let events = self.app.events(Topic::Weighing(id), after(after_seq)?).await?;
        Ok(Response::new(watch(events)))
    }
}

/// A dose, and its key.
fn dose(asked: StartWeighingRequest) -> Result<(WeighingRequest, String), Problem> {
    let vial_check = Option::<app::VialCheck>::from(asked.vial_check()).unwrap_or_default();
    let request = WeighingRequest {
        powder: asked.powder,
        target: target(asked.target)?,
        tolerance: tolerance(asked.tolerance)?,
        policy: asked.policy,
        seed: asked.seed,
        simulator: asked.simulator,
        conditions: conditions(asked.conditions),
        vial_check,
        reservation: asked.reservation,
        bench_name: asked.bench_name,
        labels: labels(asked.labels),
        asked: asked.asked.map(purpose).unwrap_or_default(),
    };
    Ok((request, asked.idempotency_key))
}

impl From<app::ListedDose> for ListedDose {
    fn from(dose: app::ListedDose) -> Self {
        Self {
            weighing: dose.weighing,
            powder: dose.powder,
            target_mg: dose.target_mg,
            tolerance_lower_mg: dose.tolerance_lower_mg,
            tolerance_upper_mg: dose.tolerance_upper_mg,
            policy: dose.policy,
            asked: Some(dose.asked).filter(|asked| !asked.is_nothing()).map(Into::into),
        }
    }
}

fn purpose(asked: Asked) -> app::Asked {
    let Asked {
        lot,
        vial,
        operator,
        list,
        position,
        temperature_c,
        relative_humidity_pct,
        accuracy_pct,
        retries_max,
        probe_spoonfuls,
        checked,
    } = asked;
    let on_overdose = match retries_max {
        0 => app::OnOverdose::Stop,
        max => app::OnOverdose::DiscardAndRetry { max },
    };
    app::Asked {
        lot,
        vial,
        operator,
        list,
        position,
        temperature_c,
        relative_humidity_pct,
        accuracy_pct,
        checked,
        on_overdose,
        probe: probe_spoonfuls.map(|spoonfuls| app::Probe { spoonfuls }),
    }
}

impl From<app::Asked> for Asked {
    fn from(asked: app::Asked) -> Self {
        Self {
            lot: asked.lot,
            vial: asked.vial,
            operator: asked.operator,
            list: asked.list,
            position: asked.position,
            temperature_c: asked.temperature_c,
            relative_humidity_pct: asked.relative_humidity_pct,
            accuracy_pct: asked.accuracy_pct,
            retries_max: match asked.on_overdose {
                app::OnOverdose::Stop => 0,
                app::OnOverdose::DiscardAndRetry { max } => max,
            },
            probe_spoonfuls: asked.probe.map(|probe| probe.spoonfuls),
            checked: asked.checked,
        }
    }
}

fn target(target: Option<Target>) -> Result<app::Target, Problem> {
    let target = target.ok_or_else(|| missing("target"))?;
    let unit = match target.unit() {
        MassUnit::Unspecified => return Err(missing("target.unit")),
        MassUnit::Mg => "mg",
        MassUnit::G => "g",
    };
    Ok(app::Target { value: target.value, unit: unit.to_owned() })
}

fn tolerance(tolerance: Option<Tolerance>) -> Result<app::Tolerance, Problem> {
    let tolerance = tolerance.ok_or_else(|| missing("tolerance"))?;
    let unit = match tolerance.unit() {
        ToleranceUnit::Unspecified => return Err(missing("tolerance.unit")),
        ToleranceUnit::Mg => "mg",
        ToleranceUnit::G => "g",
        ToleranceUnit::Percent => "%",
    };
    Ok(app::Tolerance { lower: tolerance.lower, upper: tolerance.upper, unit: unit.to_owned() })
}
