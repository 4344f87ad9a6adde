//! Values before the end: a client may close the stream of an execution's values as soon as the
//! stream of its states says finished (`unitelabs-sila` does), and the two are calls of their own.
//! So a finished state waits until the values that somebody reads have ended.

use super::execution::Values;
use super::standard::ExecutionInfo;
use super::standard::execution_info::CommandStatus;
use futures::{StreamExt, stream};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::{sleep, timeout};
use tonic::Response;

/// The longest that a finished state waits for a reader who does not read.
const PATIENCE: Duration = Duration::from_millis(if cfg!(test) { 300 } else { 5_000 });
/// What a client gets to read the last value once it has been sent.
const HEAD_START: Duration = Duration::from_millis(50);

/// How many read the values of each execution.
#[derive(Default)]
pub struct Audience(watch::Sender<BTreeMap<String, usize>>);

impl Audience {
    /// `values` of an execution, which has a reader until they end or are dropped.
    pub fn values<T: Send + 'static>(
        self: &Arc<Self>,
        execution: &str,
        values: Response<Values<T>>,
    ) -> Response<Values<T>> {
        let reader = Reader::new(self.clone(), execution);
        let end = stream::once(async move { drop(reader) }).filter_map(async |()| None);
        values.map(|values| values.chain(end).boxed())
    }

    /// `states` of an execution, of which a finished one waits for the readers of its values.
    pub fn states(
        self: &Arc<Self>,
        execution: &str,
        states: Response<Values<ExecutionInfo>>,
    ) -> Response<Values<ExecutionInfo>> {
        let (audience, execution) = (self.clone(), execution.to_owned());
        let in_turn = move |state| {
            let (audience, execution) = (audience.clone(), execution.clone());
            async move {
                if is_finished(&state) {
                    audience.has_left(&execution).await;
                }
                state
            }
        };
        states.map(|states| states.then(in_turn).boxed())
    }

    async fn has_left(&self, execution: &str) {
        let mut readers = self.0.subscribe();
        if !readers.borrow().contains_key(execution) {
            return;
        }
        let left = readers.wait_for(|all| !all.contains_key(execution));
        let is_in_time = timeout(PATIENCE, left).await.is_ok();
        if is_in_time {
            sleep(HEAD_START).await;
        }
    }
}

fn is_finished(state: &Result<ExecutionInfo, tonic::Status>) -> bool {
    state.as_ref().is_ok_and(|it| {
        matches!(
            it.command_status(),
            CommandStatus::FinishedSuccessfully | CommandStatus::FinishedWithError
        )
    })
}

struct Reader {
    audience: Arc<Audience>,
    execution: String,
}

impl Reader {
    fn new(audience: Arc<Audience>, execution: &str) -> Self {
        let execution = execution.to_owned();
        audience.0.send_modify(|all| *all.entry(execution.clone()).or_default() += 1);
        Self { audience, execution }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.audience.0.send_modify(|all| {
            let count = all.get_mut(&self.execution).expect("counted since it was made");
            *count -= 1;
            if *count == 0 {
                all.remove(&self.execution);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;
    use std::time::Instant;

    fn state(status: CommandStatus) -> ExecutionInfo {
        ExecutionInfo { command_status: status as i32, ..ExecutionInfo::default() }
    }

    fn states(audience: &Arc<Audience>) -> Values<ExecutionInfo> {
        let all = [CommandStatus::Running, CommandStatus::FinishedSuccessfully];
        let all = stream::iter(all.map(|it| Ok(state(it)))).boxed();
        audience.states("a", Response::new(all)).into_inner()
    }

    fn values(audience: &Arc<Audience>, of: &str) -> Values<u32> {
        audience.values(of, Response::new(stream::iter([Ok(1), Ok(2)]).boxed())).into_inner()
    }

    #[tokio::test]
    async fn a_finished_state_waits_for_the_last_value_and_only_for_its_own() {
        let audience = Arc::<Audience>::default();
        let (mut read, _other) = (values(&audience, "a"), values(&audience, "b"));
        let mut states = states(&audience);
        assert!(states.next().now_or_never().is_some(), "a running state waits for nobody");
        let mut last = tokio::spawn(async move { states.next().await });
        for _ in 0..2 {
            assert!(read.next().await.is_some());
            assert!(timeout(Duration::from_millis(100), &mut last).await.is_err(), "too early");
        }
        assert!(read.next().await.is_none());
        let last = timeout(PATIENCE, last).await.expect("after the last value").unwrap();
        assert!(is_finished(&last.unwrap()));
    }

    #[tokio::test]
    async fn who_stops_reading_holds_nobody_up() {
        let audience = Arc::<Audience>::default();
        drop(values(&audience, "a"));
        let at_once = states(&audience).collect::<Vec<_>>().now_or_never();
        assert_eq!(at_once.map(|all| all.len()), Some(2));
        let (_never_read, begun) = (values(&audience, "a"), Instant::now());
        assert_eq!(states(&audience).count().await, 2);
        assert!(begun.elapsed() >= PATIENCE);
    }
}
