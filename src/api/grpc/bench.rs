//! `flip.v1.Bench`.

use super::convert::{all, at, bench_kind, page};
use super::proto::*;
use super::{Service, clear, read, write};
use crate::app::{
    self, AuditAsked, AuditWanted, BalanceRequest, ClearRequest, LoadRequest, NewChecklist,
    RepeatabilityRequest, ResumeRequest,
};
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl bench_server::Bench for Service {
    async fn get_bench(
        &self,
        request: Request<GetBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        read(request)?;
        Ok(Response::new(self.app.bench().await?.into()))
    }

    async fn get_checklist(
        &self,
        request: Request<GetChecklistRequest>,
    ) -> Result<Response<Checklist>, Status> {
        read(request)?;
        Ok(Response::new(self.app.checklist().await?.into()))
    }

    async fn change_checklist(
        &self,
        request: Request<ChangeChecklistRequest>,
    ) -> Result<Response<Checklist>, Status> {
        let ChangeChecklistRequest { items } = write(request)?;
        Ok(Response::new(self.app.change_checklist(&NewChecklist { items }).await?.into()))
    }

    async fn stop_bench(
        &self,
        request: Request<StopBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        write(request)?;
        Ok(Response::new(self.app.stop_bench().await?.into()))
    }

    async fn clear_bench(
        &self,
        request: Request<ClearBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let ClearBenchRequest { by, note, looked, vial_ready, resume } = clear(request)?;
        let cleared =
            self.app.clear_bench(ClearRequest { by, note, looked, vial_ready, resume }).await?;
        Ok(Response::new(cleared.into()))
    }

    async fn list_benches(
        &self,
        request: Request<ListBenchesRequest>,
    ) -> Result<Response<ListBenchesResponse>, Status> {
        read(request)?;
        Ok(Response::new(ListBenchesResponse { items: all(self.app.benches().await?) }))
    }

    async fn get_named_bench(
        &self,
        request: Request<GetNamedBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let name = read(request)?.name;
        Ok(Response::new(self.app.bench_named(&name).await?.into()))
    }

    async fn stop_named_bench(
        &self,
        request: Request<StopNamedBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let name = write(request)?.name;
        Ok(Response::new(self.app.stop_bench_named(&name).await?.into()))
    }

    async fn resume_named_bench(
        &self,
        request: Request<ResumeNamedBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let ResumeNamedBenchRequest { name, request } = write(request)?;
        let ResumeBenchRequest { by, note } = request.unwrap_or_default();
        let resumed = self.app.resume_bench_named(&name, ResumeRequest { by, note }).await?;
        Ok(Response::new(resumed.into()))
    }

    async fn clear_named_bench(
        &self,
        request: Request<ClearNamedBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let ClearNamedBenchRequest { name, request } = clear(request)?;
        let ClearBenchRequest { by, note, looked, vial_ready, resume } =
            request.unwrap_or_default();
        let request = ClearRequest { by, note, looked, vial_ready, resume };
        Ok(Response::new(self.app.clear_bench_named(&name, request).await?.into()))
    }

    async fn load_bench(
        &self,
        request: Request<LoadBenchRequest>,
    ) -> Result<Response<ListedBench>, Status> {
        let LoadBenchRequest { name, powder, lot } = write(request)?;
        let loaded = self.app.load_bench(&name, LoadRequest { powder, lot }).await?;
        Ok(Response::new(loaded.into()))
    }

    async fn resume_bench(
        &self,
        request: Request<ResumeBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        let ResumeBenchRequest { by, note } = write(request)?;
        Ok(Response::new(self.app.resume_bench(ResumeRequest { by, note }).await?.into()))
    }

    async fn reserve_bench(
        &self,
        request: Request<ReserveBenchRequest>,
    ) -> Result<Response<Reservation>, Status> {
        let ReserveBenchRequest { owner, seconds, id } = write(request)?;
        Ok(Response::new(
            self.app.reserve_bench(app::ReservationRequest { owner, seconds, id }).await?.into(),
        ))
    }

    async fn release_bench(
        &self,
        request: Request<ReleaseBenchRequest>,
    ) -> Result<Response<BenchStatus>, Status> {
        self.app.release_bench(&write(request)?.id).await?;
        Ok(Response::new(self.app.bench().await?.into()))
    }

    async fn check_repeatability(
        &self,
        request: Request<CheckRepeatabilityRequest>,
    ) -> Result<Response<Repeatability>, Status> {
        let CheckRepeatabilityRequest { readings_mg, readability_mg } = write(request)?;
        let found = self
            .app
            .check_repeatability(RepeatabilityRequest { readings_mg, readability_mg })
            .await?;
        Ok(Response::new(found.into()))
    }

    async fn read_balance(
        &self,
        request: Request<ReadBalanceRequest>,
    ) -> Result<Response<BalanceReading>, Status> {
        read(request)?;
        Ok(Response::new(self.app.read_balance().await?.into()))
    }

    async fn tare_balance(
        &self,
        request: Request<TareBalanceRequest>,
    ) -> Result<Response<BalanceReading>, Status> {
        let TareBalanceRequest { reservation } = write(request)?;
        Ok(Response::new(self.app.tare_balance(BalanceRequest { reservation }).await?.into()))
    }

    async fn zero_balance(
        &self,
        request: Request<ZeroBalanceRequest>,
    ) -> Result<Response<BalanceReading>, Status> {
        let ZeroBalanceRequest { reservation } = write(request)?;
        Ok(Response::new(self.app.zero_balance(BalanceRequest { reservation }).await?.into()))
    }

    async fn list_audit(
        &self,
        request: Request<ListAuditRequest>,
    ) -> Result<Response<ListAuditResponse>, Status> {
        let ListAuditRequest { page: window, weighing, kind, person, since, until, q: text } =
            read(request)?;
        let wanted = AuditWanted { weighing, kind, person, text, ..AuditWanted::default() };
        let asked = AuditAsked { wanted, since, until };
        let app::AuditFound { page, total } = self.app.audit(asked, page(window)).await?;
        Ok(Response::new(ListAuditResponse { items: all(page.items), next: page.next, total }))
    }

    async fn verify_audit(
        &self,
        request: Request<VerifyAuditRequest>,
    ) -> Result<Response<AuditVerification>, Status> {
        let asked = read(request)?;
        Ok(Response::new(self.app.verify_audit(asked.hash.as_deref()).await?.into()))
    }
}

impl From<app::BenchRow> for ListedBench {
    fn from(bench: app::BenchRow) -> Self {
        let holds =
            bench.holds.map(|it| LoadedPowder { powder: it.powder, lot: it.lot, at: at(it.at) });
        Self {
            name: bench.name,
            kind: bench.kind.map(bench_kind),
            owner: bench.owner,
            machine: bench.machine,
            since: bench.since.and_then(at),
            heard_at: bench.heard_at.and_then(at),
            served: bench.served,
            latch: bench.latch,
            held: bench.held,
            moving: bench.moving,
            waiting: bench.waiting,
            holds,
        }
    }
}

impl From<app::AuditChain> for AuditChain {
    fn from(chain: app::AuditChain) -> Self {
        Self { last_seq: chain.last_seq, last_hash: chain.last_hash }
    }
}
