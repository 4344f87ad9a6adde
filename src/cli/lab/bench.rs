//! The bench.

use super::super::server::Request;
use super::Lab;
use crate::app::{
    BalanceReading, BalanceRequest, BenchRow, BenchStatus, ClearRequest, LoadRequest,
    Repeatability, RepeatabilityRequest, Reservation, ReservationRequest, Result, ResumeRequest,
};

impl Lab {
    pub(in super::super) async fn bench(&self) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.bench().await,
            Self::There(server) => server.get(&["bench"]).await,
        }
    }

    pub(in super::super) async fn clear_bench(&self, request: ClearRequest) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.clear_bench(request).await,
            Self::There(server) => server.post(&["bench", "clear"], &request).await,
        }
    }

    pub(in super::super) async fn resume_bench(
        &self,
        request: ResumeRequest,
    ) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.resume_bench(request).await,
            Self::There(server) => server.post(&["bench", "resume"], &request).await,
        }
    }

    pub(in super::super) async fn benches(&self) -> Result<Vec<BenchRow>> {
        match self {
            Self::Here(app) => app.benches().await,
            Self::There(server) => server.get(&["benches"]).await,
        }
    }

    pub(in super::super) async fn bench_named(&self, name: &str) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.bench_named(name).await,
            Self::There(server) => server.get(&["benches", name]).await,
        }
    }

    pub(in super::super) async fn stop_bench_named(&self, name: &str) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.stop_bench_named(name).await,
            Self::There(server) => server.post(&["benches", name, "stop"], &()).await,
        }
    }

    pub(in super::super) async fn resume_bench_named(
        &self,
        name: &str,
        request: ResumeRequest,
    ) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.resume_bench_named(name, request).await,
            Self::There(server) => server.post(&["benches", name, "resume"], &request).await,
        }
    }

    pub(in super::super) async fn clear_bench_named(
        &self,
        name: &str,
        request: ClearRequest,
    ) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => app.clear_bench_named(name, request).await,
            Self::There(server) => server.post(&["benches", name, "clear"], &request).await,
        }
    }

    pub(in super::super) async fn load_bench(
        &self,
        name: &str,
        request: LoadRequest,
    ) -> Result<BenchRow> {
        match self {
            Self::Here(app) => app.load_bench(name, request).await,
            Self::There(server) => {
                server.ask(Request::put(&["benches", name, "load"], &request)?).await
            }
        }
    }

    pub(in super::super) async fn check_repeatability(
        &self,
        request: RepeatabilityRequest,
    ) -> Result<Repeatability> {
        match self {
            Self::Here(app) => app.check_repeatability(request).await,
            Self::There(server) => server.post(&["bench", "repeatability"], &request).await,
        }
    }

    pub(in super::super) async fn read_balance(&self) -> Result<BalanceReading> {
        match self {
            Self::Here(app) => app.read_balance().await,
            Self::There(server) => server.get(&["bench", "balance"]).await,
        }
    }

    pub(in super::super) async fn tare_balance(
        &self,
        request: BalanceRequest,
    ) -> Result<BalanceReading> {
        match self {
            Self::Here(app) => app.tare_balance(request).await,
            Self::There(server) => server.post(&["bench", "balance", "tare"], &request).await,
        }
    }

    pub(in super::super) async fn zero_balance(
        &self,
        request: BalanceRequest,
    ) -> Result<BalanceReading> {
        match self {
            Self::Here(app) => app.zero_balance(request).await,
            Self::There(server) => server.post(&["bench", "balance", "zero"], &request).await,
        }
    }

    pub(in super::super) async fn reserve_bench(
        &self,
        request: ReservationRequest,
    ) -> Result<Reservation> {
        match self {
            Self::Here(app) => app.reserve_bench(request).await,
            Self::There(server) => server.post(&["bench", "reservation"], &request).await,
        }
    }

    /// Releases the bench, and returns it.
    pub(in super::super) async fn release_bench(&self, id: &str) -> Result<BenchStatus> {
        match self {
            Self::Here(app) => {
                app.release_bench(id).await?;
                app.bench().await
            }
            Self::There(server) => server.ask(Request::delete(&["bench", "reservation", id])).await,
        }
    }
}
