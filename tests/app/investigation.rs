//! Investigations: what is available of one that has not ended, and one that is no longer wanted.

use crate::harness::storage;
use flip::app::{App, Error, InvestigationRequest, JobState, Options, PageQuery};

#[tokio::test(flavor = "multi_thread")]
async fn one_that_waits_has_no_predictions_and_can_be_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let app = App::open(storage(folder.path()).await, Options::without_workers()).await.unwrap();
    let (job, created) = app.start_investigation(InvestigationRequest::default()).await.unwrap();
    assert!(created);
    let waiting = app.investigation(&job.id).await.unwrap();
    assert_eq!((waiting.job.state, waiting.seed, waiting.simulations), (JobState::Queued, 1, 499));
    assert!(waiting.verdict.is_none() && waiting.report.is_none());
    let early = app.predictions(&job.id).await;
    assert!(
        matches!(early, Err(Error::Conflict { code: "investigation_unfinished", .. })),
        "{early:?}"
    );
    assert!(matches!(app.evaluation(&job.id).await, Err(Error::NotFound { .. })));

    assert_eq!(app.cancel_job(&job.id).await.unwrap().state, JobState::Cancelled);
    let (other, created) = app.start_investigation(InvestigationRequest::default()).await.unwrap();
    assert!(created && other.id != job.id, "a cancelled one is not asked for again");
    let ids: Vec<String> = app
        .investigations(PageQuery::first(10))
        .await
        .unwrap()
        .items
        .into_iter()
        .map(|item| item.job.id)
        .collect();
    assert_eq!(ids, [other.id, job.id]);
    app.shutdown().await.unwrap();
}
