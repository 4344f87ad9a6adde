//! What lists and searches answer, on the database that the tests run on: the other tests of this
//! crate do not ask for all of them.

use crate::audit_search::AuditWanted;
use crate::jobs::{JobsWanted, Waiting};
use crate::labels::{ArchivedItems, Label, LabelKind, Shown};
use crate::node_actions::Fate;
use crate::page::{Page, Window};
use crate::parameter_sets::NewSet;
use crate::powders::Origin;
use crate::spoonfuls::ShakesWanted;
use crate::webhooks::Webhook;
use crate::weighing_search::{WeighingSort, WeighingsWanted};
use crate::weighings::Ending;
use crate::{Store, now, testing};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::job::{JobKind, JobState, Subject};
use flip_core::domain::labels::{LabelWanted, Labels};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::powder::{Flowability, Method};
use flip_core::domain::weighing::{Outcome, WeighingState};
use tempfile::TempDir;

/// A store with a dose that ended, one that waits, a calibration and a film of the first.
async fn filled() -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = testing::open(folder.path()).await.unwrap();
    let writer = store.writer().unwrap();
    let mut tx = store.write().await.unwrap();
    tx.insert_policy("p-1", "fixed", None, "{}", b"weights").await.unwrap();
    let calibration = r#"{"calibration":{"powder":"salt","target":{"repose_deg":31.5},"settings":{"method":"search"},"under":{}}}"#;
    let film = r#"{"film":{"weighing":"w-1"}}"#;
    let repose = r#"{"repose":{"powder":"salt","run":12}}"#;
    let labels: Labels = serde_json::from_str(r#"{"batch.1":"b","who":"Ada"}"#).unwrap();
    let jobs = [
        (JobKind::Calibration, calibration, labels),
        (JobKind::Film, film, Labels::default()),
        (JobKind::Repose, repose, Labels::default()),
    ];
    for (k, (kind, spec, labels)) in jobs.iter().enumerate() {
        let id = format!("j-{}", k + 1);
        let sha256 = [k as u8; 32];
        let (_, made) = tx
            .insert_job(&id, *kind, (spec, &sha256), &Subject::default(), (None, labels), now())
            .await
            .unwrap();
        assert!(made);
    }
    tx.commit().await.unwrap();
    let insert = "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, \
         tolerance_upper_mg, policy, parameter_set, seed, state, bench, asked, labels, created_at) \
         VALUES ($1, $1, $2, 'salt', $3, 1, 1, 'p-1', 'ps-1', -1, $4, 'simulated', $5, $6, $7)";
    for (id, target_mg, state, position, at) in
        [("w-1", 10.0, "dosing", 1, 1000), ("w-2", 20.0, "planned", 2, 2000)]
    {
        let asked = format!(
            r#"{{"lot":"L_1","vial":"V{position}","operator":"Ada","list":"Monday","position":"{position}"}}"#
        );
        let query = sqlx::query(insert).bind(id).bind(vec![position as u8; 32]).bind(target_mg);
        let query = query.bind(state).bind(asked).bind(r#"{"plate":"7"}"#).bind(at);
        query.execute(writer).await.unwrap();
    }
    (folder, store)
}

fn window(limit: u32) -> Window {
    Window { limit, ..Window::default() }
}

async fn ids(store: &Store, wanted: WeighingsWanted) -> Vec<String> {
    let found = store.weighings_wanted(&wanted, window(10)).await.unwrap();
    assert_eq!(found.total, found.page.items.len() as u64);
    found.page.items.into_iter().map(|it| it.id).collect()
}

#[tokio::test]
async fn weighings_are_found_by_all_that_is_said_of_them() {
    let (_folder, store) = filled().await;
    let some = |text: &str| Some(text.to_owned());
    let none = WeighingsWanted::default;
    let label = |key: &str, value: &str| Some(LabelWanted { key: key.into(), value: value.into() });
    let all = [
        (none(), vec!["w-2", "w-1"]),
        (WeighingsWanted { lot: some("L_1"), vial: some("V1"), ..none() }, vec!["w-1"]),
        (WeighingsWanted { operator: some("ada"), ..none() }, vec![]),
        (
            WeighingsWanted { list: some("Monday"), sort: WeighingSort::Oldest, ..none() },
            vec!["w-1", "w-2"],
        ),
        (
            WeighingsWanted {
                bench: Some(BenchKind::Simulated),
                sort: WeighingSort::Target,
                ..none()
            },
            vec!["w-2", "w-1"],
        ),
        (
            WeighingsWanted {
                label: label("plate", "7"),
                state: Some(WeighingState::Planned),
                ..none()
            },
            vec!["w-2"],
        ),
        (WeighingsWanted { label: label("plate", "8"), ..none() }, vec![]),
        (
            WeighingsWanted { text: some("ADA v2"), sort: WeighingSort::Seconds, ..none() },
            vec!["w-2"],
        ),
        (
            WeighingsWanted { text: some("l_1 salt"), sort: WeighingSort::Error, ..none() },
            vec!["w-2", "w-1"],
        ),
        (WeighingsWanted { text: some("L1"), ..none() }, vec![]),
        (WeighingsWanted { outside: true, ..none() }, vec![]),
    ];
    for (wanted, expected) in all {
        assert_eq!(ids(&store, wanted.clone()).await, expected, "{wanted:?}");
    }
    for sort in [WeighingSort::Newest, WeighingSort::Error, WeighingSort::Target] {
        let wanted = WeighingsWanted { sort, ..none() };
        let first = store.weighings_wanted(&wanted, window(1)).await.unwrap().page;
        let next =
            crate::page::PageQuery { limit: Some(1), after: first.next, ..Default::default() };
        let next = store.weighings_wanted(&wanted, next.window(1).unwrap()).await.unwrap().page;
        assert_eq!((next.items[0].id.as_str(), next.next), ("w-1", None), "{sort:?}");
    }
    let mut tx = store.write().await.unwrap();
    let mut label = Label::none(LabelKind::DoseList, "Monday");
    label.tags = vec!["Plate A".to_owned()];
    label.changed_at = Some(now());
    tx.set_label(&label).await.unwrap();
    assert!(tx.is_list("Monday").await.unwrap() && !tx.is_list("Tuesday").await.unwrap());
    tx.commit().await.unwrap();
    let mut tagged = window(10);
    tagged.shown.tag = Some("plate a".to_owned());
    assert_eq!(store.weighings_wanted(&none(), tagged).await.unwrap().total, 2);
    assert!(store.is_dose_list("Monday").await.unwrap());
    assert!(store.is_list_unfinished("Monday").await.unwrap());
}

#[tokio::test]
async fn a_dose_goes_its_way_whatever_of_its_measurements_is_missing() {
    let (_folder, store) = filled().await;
    assert_eq!(store.next_weighing().await.unwrap().unwrap().id, "w-2");
    assert_eq!(store.waiting_weighings().await.unwrap().len(), 1);
    assert_eq!(store.interrupted_weighings().await.unwrap().len(), 1);
    let mut tx = store.write().await.unwrap();
    assert_eq!(tx.planned_weighings().await.unwrap(), 1);
    // Without numbers first: what is bound as absent must not spoil the statement for a number.
    let mut bare = Ending::bare(WeighingState::Aborted, Outcome::Aborted, "stopped");
    bare.seconds = Some(f64::NAN);
    assert!(tx.end_planned_weighing("w-1", &bare, now()).await.unwrap().is_none());
    let ended = tx.end_planned_weighing("w-2", &bare, now()).await.unwrap().unwrap();
    assert_eq!((ended.seconds, ended.reading_mg), (None, None));
    let whole = Ending {
        state: WeighingState::Done,
        outcome: Outcome::Within,
        dispensed_mg: Some(10.25),
        reading_mg: Some(10.0),
        error_mg: Some(-0.25),
        shakes: Some(7),
        seconds: Some(12.5),
        error: None,
        ..bare
    };
    let ended = tx.end_weighing("w-1", &whole, now()).await.unwrap().unwrap();
    assert_eq!((ended.dispensed_mg, ended.error_mg), (Some(10.25), Some(-0.25)));
    assert_eq!((ended.shakes, ended.seconds, ended.seed), (Some(7), Some(12.5), u64::MAX));
    tx.commit().await.unwrap();
    let wanted = WeighingsWanted { sort: WeighingSort::Error, ..WeighingsWanted::default() };
    assert_eq!(ids(&store, wanted).await, ["w-1", "w-2"]);
    let counts = store.counts().await.unwrap();
    assert_eq!(counts.weighings.iter().map(|(_, n)| n).sum::<u32>(), 2);
    let shaken = store.shaken(&ShakesWanted::default(), window(10)).await.unwrap();
    assert!(shaken.is_empty(), "neither has a trace");
    let traces = store.traces_of("salt", Some("L_1"), BenchKind::Simulated, 3).await.unwrap();
    assert!(traces.is_empty());
    let found = store.audit_records(&AuditWanted::of("w-1"), window(10)).await.unwrap();
    assert_eq!(found.total, 1);
    assert!(store.stop_of("w-1").await.unwrap().is_none());
}

#[tokio::test]
async fn jobs_are_found_by_what_their_specifications_say() {
    let (_folder, store) = filled().await;
    let wanted = |kind, state, label| JobsWanted { kind, state, label };
    let label = |key: &str| Some(LabelWanted { key: key.into(), value: "b".into() });
    let jobs = async |wanted: JobsWanted| -> Vec<String> {
        let page: Page<_> = store.jobs(&wanted, window(10)).await.unwrap();
        page.items.into_iter().map(|it| it.id).collect()
    };
    assert_eq!(jobs(wanted(None, None, None)).await, ["j-3", "j-2", "j-1"]);
    assert_eq!(jobs(wanted(None, Some(JobState::Queued), label("batch.1"))).await, ["j-1"]);
    assert!(jobs(wanted(Some(JobKind::Film), None, label("batch.1"))).await.is_empty());
    let films = async |of| store.films(of, None, None, window(10)).await.unwrap().items.len();
    assert_eq!((films(None).await, films(Some("w-1")).await, films(Some("w-2")).await), (1, 1, 0));
    assert_eq!(store.whole_jobs(JobKind::Film, window(10)).await.unwrap().items.len(), 1);
    let waiting = store.waiting_jobs(["j-2", "j-1"]).await.unwrap();
    assert_eq!(waiting.jobs[0].1.method.as_deref(), Some("search"));
    let ids = |of: &Waiting| of.jobs.iter().map(|(id, _)| id.clone()).collect::<Vec<_>>();
    assert_eq!((waiting.before.len(), ids(&waiting)), (0, vec!["j-1".into(), "j-2".into()]));
    let last = store.waiting_jobs(["j-3", "j-3"]).await.unwrap();
    assert_eq!(ids(&last), ["j-3"]);
    let sum = |of: &Waiting| of.before.iter().map(|(_, many)| many).sum::<u64>();
    assert_eq!(sum(&last), 2);
    // A job that is computed does not wait; one whose worker is gone does again.
    for (lease_ms, waits) in [(-60_000, 2), (60_000, 1)] {
        let mut tx = store.write().await.unwrap();
        let until =
            flip_core::domain::timestamp::Timestamp::from_unix_ms(now().unix_ms() + lease_ms);
        tx.claim("j-1", "worker", now(), until).await.unwrap();
        tx.commit().await.unwrap();
        assert_eq!(sum(&store.waiting_jobs(["j-3", "j-3"]).await.unwrap()), waits);
    }
    assert_eq!(store.repose_runs("salt").await.unwrap(), 12);
    assert_eq!(store.repose_runs("sand").await.unwrap(), 0);
    let under_way = store.calibration_under_way("salt", None).await.unwrap();
    assert_eq!(under_way.as_deref(), Some("j-1"));
    assert!(store.calibration_under_way("salt", Some("sv-1")).await.unwrap().is_none());
    let mut tx = store.write().await.unwrap();
    let same: Labels = serde_json::from_str(r#"{"who":"Bob"}"#).unwrap();
    let spec = ("{}", &[0; 32][..]);
    let subject = Subject::default();
    let asked = tx.insert_job("j-4", JobKind::Calibration, spec, &subject, (None, &same), now());
    let (job, made) = asked.await.unwrap();
    assert!(!made && job.labels.0.len() == 2, "{job:?}");
    let cancelled = tx.request_cancel("j-2", now()).await.unwrap().unwrap();
    assert_eq!(cancelled.state, JobState::Cancelled);
    tx.commit().await.unwrap();
    let sql = "UPDATE job SET state = 'succeeded', lease_until = NULL, result = '{}', attempts = 1, started_at = 1000, finished_at = 3500 WHERE id = 'j-1'";
    sqlx::query(sql).execute(store.writer().unwrap()).await.unwrap();
    assert_eq!(store.times_taken().await.unwrap()[0].1, 2.5);
    let newest = async |powder, deg| store.newest_calibration(powder, deg, None).await.unwrap();
    assert_eq!(newest(Some("salt"), 0.0).await.as_deref(), Some("j-1"));
    assert_eq!(newest(None, 31.5).await, None);
}

#[tokio::test]
async fn labels_hide_and_mark_what_lists_show() {
    let (_folder, store) = filled().await;
    let mut tx = store.write().await.unwrap();
    for (kind, id) in [(LabelKind::Powder, "salt"), (LabelKind::Policy, "p-1")] {
        let mut label = Label::none(kind, id);
        (label.archived_at, label.changed_at) = (Some(now()), Some(now()));
        label.tags = vec!["Old".to_owned(), "b".to_owned()];
        tx.set_label(&label).await.unwrap();
    }
    tx.commit().await.unwrap();
    let shown = |archived, tag: Option<&str>| Window {
        shown: Shown { archived, tag: tag.map(str::to_owned) },
        ..window(20)
    };
    let policies = async |window| store.policies(window).await.unwrap().items.len();
    assert_eq!(policies(shown(ArchivedItems::Exclude, None)).await, 0);
    assert_eq!(policies(shown(ArchivedItems::Only, Some("old"))).await, 1);
    let powders = async |window| store.powders(window).await.unwrap().items.len();
    assert_eq!(powders(shown(ArchivedItems::Exclude, None)).await, 4);
    assert_eq!(powders(shown(ArchivedItems::Include, Some("OLD"))).await, 1);
    assert_eq!(store.simulators(window(5)).await.unwrap().items.len(), 0);
    assert_eq!(store.labels(None, shown(ArchivedItems::Only, None)).await.unwrap().items.len(), 2);
    let of = store.labels_of(LabelKind::Powder, &["salt", "sand"]).await.unwrap();
    assert_eq!(of["salt"].tags, ["Old", "b"]);
    assert!(store.kept_episodes(&["j-1"]).await.unwrap().is_empty());
    assert!(store.best_policy("salt", None, "p-1").await.unwrap().is_none());
    assert_eq!(store.policy_bytes("p-1").await.unwrap().unwrap(), b"weights");
}

#[tokio::test]
async fn a_measurement_is_withdrawn_and_the_one_before_it_counts_again() {
    let (_folder, store) = filled().await;
    let before = store.powder("salt").await.unwrap().unwrap();
    let mut tx = store.write().await.unwrap();
    let flowability = Flowability { repose_deg: 33.0, sd_deg: 0.5, n: 3 };
    let origin = Origin { source: "ours".to_owned(), measured_on: Some("2026-02-03".to_owned()) };
    let made =
        tx.insert_measurement("salt", Method::Automated, flowability, &origin).await.unwrap();
    tx.withdraw(&made.id, "a wrong plate", None).await.unwrap();
    assert!(tx.measurement("salt", &made.id).await.unwrap().unwrap().withdrawn.is_some());
    assert!(tx.insert_powder("chalk", "Chalk", Some(false)).await.unwrap().is_some());
    assert!(tx.insert_powder("chalk", "Chalk", None).await.unwrap().is_none());
    tx.commit().await.unwrap();
    assert_eq!(store.powder("salt").await.unwrap().unwrap(), before);
    assert_eq!(store.said_of_solubility().await.unwrap(), [("chalk".to_owned(), false)]);
    assert_eq!(store.ever_measured().await.unwrap().len(), 11);
    let installation = store.installation().await.unwrap();
    assert_eq!(store.installation().await.unwrap(), installation);
    assert!(store.health().await.database.ok);
}

#[tokio::test]
async fn what_jobs_save_comes_back_and_an_end_takes_its_files_along() {
    let (_folder, store) = filled().await;
    let (none, named) = ("0".repeat(64), store.artifacts().put(b"frame").await.unwrap());
    let mut tx = store.write().await.unwrap();
    let set = NewSet {
        parameters: ParameterSet::from_unit([0.5; 9]),
        repose_deg: 31.5,
        repose_sd_deg: None,
        runs: 3,
        error_deg: 0.25,
        simulator: None,
    };
    tx.insert_parameter_set("j-1", Some("salt"), 0, &set).await.unwrap();
    let with_sd = NewSet { repose_sd_deg: Some(0.5), ..set };
    tx.insert_parameter_set("j-1", Some("salt"), 1, &with_sd).await.unwrap();
    let json = |text: &str| serde_json::from_str::<serde_json::Value>(text).unwrap();
    let frames = serde_json::json!([{ "depth": named, "colour": none, "description": none }]);
    let pile = serde_json::json!({ "number": 1, "at": now(), "measured": null, "refusal": "dark", "frames": frames });
    tx.insert_pile("j-3", &serde_json::from_value(pile).unwrap()).await.unwrap();
    let episode = r#"{"index":0,"level":0,"powder":"salt","parameter_set":"ps-1","target_mg":1,"dispensed_mg":1,
                      "final_error_mg":0,"reward":1,"steps":1,"alpha":null,"critic_loss":null,"actor_loss":null}"#;
    let episode = serde_json::from_str(episode).unwrap();
    assert!(tx.insert_episode("j-1", &episode).await.unwrap());
    assert!(!tx.insert_episode("j-1", &episode).await.unwrap(), "it is there already");
    assert!(tx.insert_kept("j-1", 1, "p-2", b"weights").await.unwrap());
    tx.insert_dose("j-1", "a", &7).await.unwrap();
    for (position, n, mae_mg) in [(0, 3, 1.0), (1, 1, 2.0)] {
        let row = format!(
            r#"{{"controller":"c","powder":"salt","target_mg":1,"n":{n},"mae_mg":{mae_mg},"sd_mg":0,"bias_mg":0,"over_share":0,"zero_share":0,"shakes_mean":1}}"#
        );
        let row = serde_json::from_str(&row).unwrap();
        tx.insert_evaluation_row("j-1", position, Some("p-1"), None, &row).await.unwrap();
    }
    tx.choose_simulator(None, Some("it is the base")).await.unwrap();
    tx.create_node_action(&"A".repeat(26), "weigh", &json("{}")).await.unwrap();
    tx.node_action_became(&"A".repeat(26), &Fate::Made("w-1".to_owned())).await.unwrap();
    let hook = Webhook {
        id: "wh-1".into(),
        url: "http://a.example".into(),
        created_at: now(),
        failing_since: None,
        error: None,
    };
    tx.insert_webhook(&hook, &[1; 32]).await.unwrap();
    tx.webhook_failed("wh-1", "gone").await.unwrap();
    tx.commit().await.unwrap();

    let sets = store.sets_under("salt", None, window(5)).await.unwrap().items;
    let deviations: Vec<_> = sets.iter().map(|set| set.repose_sd_deg).collect();
    assert_eq!(deviations, [Some(0.5), None]);
    assert_eq!(store.piles("j-3").await.unwrap().len(), 1);
    assert_eq!(store.episodes("j-1", window(5)).await.unwrap().items.len(), 1);
    let kept = store.kept_episodes(&["j-1", "j-2"]).await.unwrap();
    assert_eq!(kept, [("j-1".to_owned(), 1, "p-2".to_owned())]);
    assert_eq!(store.doses::<u32>("j-1").await.unwrap()["a"], 7);
    assert_eq!(store.best_policy("salt", None, "p-1").await.unwrap().as_deref(), Some("p-1"));
    let evaluated = store.policy("p-1").await.unwrap().unwrap().evaluated;
    assert_eq!((evaluated[0].mae_mg, evaluated[0].n), (1.25, 4));
    assert_eq!(store.running_node_actions().await.unwrap(), ["A".repeat(26)]);
    assert!(store.webhooks().await.unwrap()[0].webhook.failing_since.is_some());
    store.forget_artifact(&named).await.unwrap();
    assert!(store.artifacts().get(&named).await.is_ok(), "a pile names it");
    let other = store.artifacts().put(b"nobody's").await.unwrap();
    store.forget_artifact(&other).await.unwrap();
    assert!(store.artifacts().get(&other).await.is_err());
    store.sweep_artifacts().await.unwrap();
}

#[tokio::test]
async fn records_of_a_dose_long_past_are_archived_and_read_as_before() {
    let (_folder, store) = filled().await;
    for (state, at) in [(WeighingState::Settling, 3000), (WeighingState::Dosing, 4000)] {
        let mut tx = store.write().await.unwrap();
        let at = flip_core::domain::timestamp::Timestamp::from_unix_ms(at);
        tx.advance_weighing("w-1", state, at).await.unwrap();
        tx.commit().await.unwrap();
    }
    let mut tx = store.write().await.unwrap();
    let end = Ending::bare(WeighingState::Aborted, Outcome::Aborted, "stopped");
    let at = flip_core::domain::timestamp::Timestamp::from_unix_ms(5000);
    tx.end_weighing("w-1", &end, at).await.unwrap().unwrap();
    tx.commit().await.unwrap();
    let before = store.audit_records(&AuditWanted::of("w-1"), window(10)).await.unwrap().page.items;
    let done = store.archive_audit(now()).await.unwrap();
    assert_eq!((done.weighings, done.records), (1, 2));
    let left: i64 = sqlx::query_scalar("SELECT count(*) FROM audit WHERE kind = 'state'")
        .fetch_one(&store.reader)
        .await
        .unwrap();
    assert_eq!(left, 0, "they are in a file");
    let after = store.audit_records(&AuditWanted::of("w-1"), window(10)).await.unwrap();
    assert_eq!((after.total, after.page.items), (3, before));
    let found = AuditWanted { text: Some("SETTLING".to_owned()), ..AuditWanted::default() };
    assert_eq!(store.audit_after(&found, 0).await.unwrap().len(), 1);
    let changed = store.verify_audit(None).await.unwrap();
    assert!(changed.archives.is_empty() && changed.broken.is_some_and(|it| it.why.contains("w-")));
}
