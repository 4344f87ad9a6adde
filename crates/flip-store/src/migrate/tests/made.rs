//! Stores to be copied: one made by the store's own operations, and rows of all sorts in every table.

use crate::checklist::StoredChecklist;
use crate::holds::Held;
use crate::labels::{Label, LabelKind};
use crate::node_actions::Fate;
use crate::page::Window;
use crate::pan::Reservation;
use crate::tokens::{HashedToken, Role, TokenEntry};
use crate::webhooks::Webhook;
use crate::weighings::{Ending, Intent};
use crate::workers::Worker;
use crate::{Store, now};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::bench_check::CheckKind;
use flip_core::domain::job::{JobKind, Subject};
use flip_core::domain::labels::Labels;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::weighing::{Outcome, WeighingState};
use serde_json::json;
use sqlx::{AnyPool, AssertSqlSafe};
use std::fmt::Debug;

fn at(ms: i64) -> Timestamp {
    Timestamp::from_unix_ms(ms)
}

/// A laboratory that has worked: doses, one of them archived, files, people, and a whole audit trail.
/// Returns the SHA-256 of the trace.
pub(super) async fn work(store: &Store) -> String {
    let trace = store.artifacts().put("ticks of a dose, µ".as_bytes()).await.unwrap();
    let mut tx = store.write().await.unwrap();
    tx.insert_powder("chalk", "Chalk, ‘fine’ 粉", Some(false)).await.unwrap();
    let said = json!({ "powder": { "id": "chalk", "name": "Chalk, ‘fine’ 粉" } });
    tx.audit_deed(None, "new powder", said, now()).await.unwrap();
    tx.insert_policy("p-1", "fixed", None, "{}", b"weights\0\xff").await.unwrap();
    let labels: Labels = serde_json::from_str(r#"{"batch":"ä"}"#).unwrap();
    let spec = (r#"{"film":{"weighing":"w-1"}}"#, &[3u8; 32][..]);
    let job = (None, &labels);
    tx.insert_job("j-1", JobKind::Film, spec, &Subject::default(), job, at(10)).await.unwrap();
    for (k, id) in ["w-1", "w-2"].into_iter().enumerate() {
        let request = json!({ "powder": "chalk", "target_mg": 10.1, "tolerance_lower_mg": 0.0,
            "tolerance_upper_mg": 5e-324, "policy": "p-1", "seed": u64::MAX,
            "asked": { "lot": "L", "vial": format!("V{k}"), "operator": "Ada" } });
        let intent = Intent {
            id: id.to_owned(),
            idempotency_key: format!("key {k}"),
            request_sha256: vec![k as u8; 32],
            request: serde_json::from_value(request).unwrap(),
            parameter_set: "ps-1".to_owned(),
        };
        tx.insert_weighing(&intent, at(100)).await.unwrap();
    }
    tx.arm_weighing("w-1", BenchKind::Simulated, at(200)).await.unwrap().unwrap();
    tx.advance_weighing("w-1", WeighingState::Dosing, at(300)).await.unwrap();
    let bare = Ending::bare(WeighingState::Done, Outcome::Within, "");
    let ending = Ending {
        dispensed_mg: Some(10.1),
        reading_mg: Some(10.0),
        error_mg: Some(-0.1),
        seconds: Some(1.0 / 3.0),
        shakes: Some(7),
        trace: Some(trace.clone()),
        error: None,
        ..bare
    };
    tx.end_weighing("w-1", &ending, at(400)).await.unwrap().unwrap();
    let mut label = Label::none(LabelKind::Powder, "chalk");
    (label.note, label.changed_at) = ("white".to_owned(), Some(at(500)));
    tx.set_label(&label).await.unwrap();
    let said = json!({ "label": { "kind": "powder", "id": "chalk", "name": "", "note": "white",
        "tags": [], "archived_at": null } });
    tx.audit_deed(None, "label", said, at(500)).await.unwrap();
    tx.insert_check(CheckKind::Shakes, &json!({ "worst_mm": 0.1 }), at(600)).await.unwrap();
    tx.hold_bench(&Held { at: at(700), reason: "stop".to_owned(), by: None }).await.unwrap();
    tx.resume_bench("Ada", "looked", at(800)).await.unwrap();
    tx.change_checklist(&["gloves".to_owned()]).await.unwrap();
    tx.insert_token(&token("00")).await.unwrap();
    let hook = Webhook {
        id: "wh-1".into(),
        url: "http://a.example".into(),
        created_at: at(900),
        failing_since: None,
        error: None,
    };
    tx.insert_webhook(&hook, &[1; 32]).await.unwrap();
    tx.insert_worker(&Worker {
        id: "flip-1".into(),
        name: "old workstation".into(),
        version: "0.1.0".into(),
        kinds: vec![JobKind::Calibration],
        threads: 4,
        serves: false,
        card: Some("a card".to_owned()),
        started_at: at(900),
        heard_at: at(901),
        ended_at: None,
        jobs: Vec::new(),
    })
    .await
    .unwrap();
    tx.create_node_action(&"A".repeat(26), "weigh", &json!({})).await.unwrap();
    tx.node_action_became(&"A".repeat(26), &Fate::Made("w-1".to_owned())).await.unwrap();
    let until = at(4_000_000_000_000);
    let reserved = Reservation { id: "rs-1".into(), owner: "Ada".into(), until };
    tx.reserve_bench(&reserved, at(950)).await.unwrap();
    tx.commit().await.unwrap();
    store.archive_audit(now()).await.unwrap();
    trace
}

pub(super) fn token(id: &str) -> HashedToken {
    let entry = TokenEntry {
        id: id.to_owned(),
        name: "Ada".to_owned(),
        role: Role::Admin,
        may_clear: true,
        created_at: at(1),
        expires_at: None,
        revoked_at: None,
        last_used_at: None,
        issuer: None,
        subject: None,
    };
    HashedToken { entry, sha256: vec![7; 32] }
}

/// What a store answers, about everything that [`work`] left in it.
pub(super) async fn answers(store: &Store) -> Vec<String> {
    fn said(answer: impl Debug) -> String {
        format!("{answer:?}")
    }
    let all = || Window { limit: 200, ..Window::default() };
    let wanted = Default::default();
    let StoredChecklist { items, .. } = store.checklist().await.unwrap().unwrap();
    vec![
        said(store.powders(all()).await.unwrap().items),
        said(store.all_measurements(None).await.unwrap()),
        said(store.policies(all()).await.unwrap().items),
        said(store.policy_bytes("p-1").await.unwrap()),
        said(store.jobs(&Default::default(), all()).await.unwrap().items),
        said(store.weighings_wanted(&wanted, all()).await.unwrap().page.items),
        said(store.weighing("w-1").await.unwrap()),
        said(store.next_weighing().await.unwrap()),
        said(store.labels(None, all()).await.unwrap().items),
        said(store.tokens(all()).await.unwrap().items),
        said(store.webhooks().await.unwrap()),
        said(store.workers().await.unwrap()),
        said(store.node_actions(10).await.unwrap()),
        said(store.reservation().await.unwrap()),
        said(store.pan().await.unwrap()),
        said(store.newest_check::<serde_json::Value>(CheckKind::Shakes).await.unwrap()),
        said(store.events_after(None, 0, 200).await.unwrap()),
        said(store.audit_after(&Default::default(), 0).await.unwrap()),
        said(store.installation().await.unwrap()),
        said(store.counts().await.unwrap().weighings),
        said(items),
    ]
}

/// Numbers that look random and are the same in each run.
pub(super) struct Dice(pub u64);

impl Dice {
    fn roll(&mut self) -> u64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[(self.roll() % of.len() as u64) as usize]
    }

    fn hex(&mut self, digits: usize) -> String {
        (0..digits).map(|_| char::from_digit((self.roll() % 16) as u32, 16).unwrap()).collect()
    }

    fn text(&mut self) -> String {
        const WORDS: [&str; 12] = [
            "",
            "ä",
            "粉",
            "🧪",
            "a'b\"c\\",
            "\u{ffff}",
            "\u{10ffff}",
            "\u{1}\u{7f}",
            "a b",
            "$1",
            "e\u{301}",
            "%_",
        ];
        (0..self.roll() % 4).map(|_| self.pick(&WORDS)).collect()
    }

    fn any_real(&mut self) -> f64 {
        let extremes = [-0.0, 0.0, 5e-324, -5e-324, f64::MAX, f64::MIN, f64::MIN_POSITIVE];
        let others = [f64::INFINITY, f64::NEG_INFINITY, 0.1, 1.0, -3.0, 1e15, 1.0 / 3.0];
        let random = f64::from_bits(self.roll());
        match self.roll() % 3 {
            0 => self.pick(&extremes),
            1 => self.pick(&others),
            _ if random.is_nan() => 1.5,
            _ => random,
        }
    }

    fn any_integer(&mut self) -> i64 {
        self.pick(&[i64::MIN, i64::MAX, -1, 0, 1, 1 << 53, (1 << 53) + 1])
    }

    fn count(&mut self) -> i64 {
        self.pick(&[1, 2, 1 << 53, i64::MAX])
    }
}

/// A value as it stands in a statement of SQLite.
fn literal(text: &str) -> String {
    format!("CAST(x'{}' AS TEXT)", hex::encode(text))
}

fn real(number: f64) -> String {
    match number {
        f64::INFINITY => "9e999".to_owned(),
        f64::NEG_INFINITY => "-9e999".to_owned(),
        // The text of zero has lost its sign in SQLite's parser.
        zero if zero == 0.0 && zero.is_sign_negative() => "(-1e-200 * 1e-200)".to_owned(),
        number => format!("{number:e}"),
    }
}

/// Columns of JSON.
const JSON: [&str; 17] = [
    "spec",
    "subject",
    "labels",
    "body",
    "parameters",
    "manifest",
    "under",
    "patch",
    "asked",
    "measured",
    "apparatus",
    "data",
    "tags",
    "items",
    "args",
    "refused",
    "answer",
];
/// Columns that refer to a row of another table, and to which.
const REFERENCES: [(&str, &str); 9] = [
    ("job", "job"),
    ("calibration", "job"),
    ("investigation", "job"),
    ("evaluation", "job"),
    ("training", "job"),
    ("powder", "powder"),
    ("policy", "policy"),
    ("simulator", "simulator_version"),
    ("version", "simulator_version"),
];

/// Rows of all sorts in each of these tables of SQLite, given in an order of their references.
pub(super) async fn fill(writer: &AnyPool, tables: &[String], rows: u64, dice: &mut Dice) {
    // The id of the installation is there already.
    for table in tables.iter().filter(|table| *table != "installation") {
        let sql = "SELECT name, type, \"notnull\", pk FROM pragma_table_info($1) ORDER BY name";
        let columns: Vec<(String, String, i64, i64)> =
            sqlx::query_as(sql).bind(table).fetch_all(writer).await.unwrap();
        let is_single = columns.iter().any(|it| it.0 == "one");
        for k in 0..if is_single { 1 } else { rows } {
            let (mut names, mut values) = (Vec::new(), Vec::new());
            for (name, of, not_null, key) in &columns {
                let may_be_null = *not_null == 0 && *key == 0;
                let value = special(table, name, k, dice);
                let value = value.or_else(|| {
                    (may_be_null && dice.roll().is_multiple_of(3)).then(|| "NULL".to_owned())
                });
                names.push(format!("\"{name}\""));
                values.push(value.unwrap_or_else(|| ordinary(table, name, of, k, dice)));
            }
            let (names, values) = (names.join(", "), values.join(", "));
            let sql = format!("INSERT OR IGNORE INTO {table} ({names}) VALUES ({values})");
            let made = sqlx::query(AssertSqlSafe(sql.clone())).execute(writer).await;
            made.unwrap_or_else(|error| panic!("{error}: {sql}"));
        }
    }
}

/// The ends of what a number can be.
pub(super) const EXTREMES: [f64; 8] = [
    -0.0,
    5e-324,
    -5e-324,
    f64::MIN_POSITIVE,
    f64::MAX,
    f64::MIN,
    f64::INFINITY,
    f64::NEG_INFINITY,
];

/// A dose with each of [`EXTREMES`], stored as numbers that are no text on the way.
pub(super) async fn add_extremes(writer: &AnyPool) {
    let sql = "INSERT INTO weighing (id, idempotency_key, request_sha256, powder, target_mg, tolerance_lower_mg, \
               tolerance_upper_mg, policy, parameter_set, seed, state, created_at, dispensed_mg) \
               VALUES ($1, $1, zeroblob(32), 'salt', 1, 0, 0, (SELECT min(id) FROM policy), 'ps-1', $2, 'planned', 0, $3)";
    for (k, number) in EXTREMES.into_iter().enumerate() {
        let seed = if k.is_multiple_of(2) { i64::MIN } else { i64::MAX };
        let row = sqlx::query(sql).bind(format!("x{k}")).bind(seed).bind(number);
        row.execute(writer).await.unwrap();
    }
}

/// What the rules of a table ask for.
fn special(table: &str, column: &str, k: u64, dice: &mut Dice) -> Option<String> {
    let first = k == 0;
    let text = |it: &str| Some(literal(it));
    match (table, column) {
        ("audit_away", "first") => Some(format!("{}", 10 * k + 1000)),
        ("audit_away", "last") => Some(format!("{}", 10 * k + 1000 + dice.roll() % 9)),
        ("audit_away", "archive") => Some((i64::MAX - k as i64).to_string()),
        ("event", "seq") | ("audit", "seq") => Some(format!("{}", 500 + 3 * k)),
        (_, "seq") if table != "webhook" => Some(format!("{}", 500 + 2 * k)),
        (_, "one") => Some("1".to_owned()),
        ("job", "state") => text("queued"),
        ("job", "owner" | "lease_until" | "result" | "finished_at") => Some("NULL".to_owned()),
        ("weighing", "state") => text(if k.is_multiple_of(2) { "done" } else { "planned" }),
        ("weighing", "outcome") => {
            Some(if k.is_multiple_of(2) { literal("within") } else { "NULL".into() })
        }
        ("weighing", "finished_at") => {
            Some(if k.is_multiple_of(2) { dice.any_integer().to_string() } else { "NULL".into() })
        }
        ("bench_hold", "resumed_at") | ("latch", "cleared_at") => {
            Some(if first { "NULL".into() } else { dice.any_integer().to_string() })
        }
        ("bench_hold", "resumed_by") | ("latch", "cleared_by") => {
            Some(if first { "NULL".into() } else { literal(&dice.text()) })
        }
        ("portion", "outcomes" | "done_at") if first => Some("NULL".to_owned()),
        ("portion", "outcomes") => Some("x'a0f97e00'".to_owned()),
        ("portion", "done_at") => Some(dice.count().to_string()),
        ("bench", "chain") => Some((100 + k).to_string()),
        ("bench", "powder" | "loaded_at") => Some("NULL".to_owned()),
        ("node_action", "refused") => Some("NULL".to_owned()),
        ("node_action", "id") => Some(literal(&format!("{k:026}"))),
        ("kept_policy", "id") => Some(literal(&format!("p-{k}"))),
        (_, "measured_on") => text("2026-02-03"),
        _ => None,
    }
}

fn ordinary(table: &str, column: &str, of: &str, k: u64, dice: &mut Dice) -> String {
    if let Some((_, other)) = REFERENCES.iter().find(|(name, _)| *name == column) {
        return format!("(SELECT id FROM {other} ORDER BY id LIMIT 1 OFFSET {})", k % 3);
    }
    if JSON.contains(&column) {
        let body = json!({ "text": dice.text(), "lot": dice.text(), "number": dice.any_integer() });
        return literal(&body.to_string());
    }
    match (column, of) {
        ("bytes", "BLOB") => format!("x'{}'", dice.hex(2 + 2 * (k as usize % 40))),
        (_, "BLOB") => format!("x'{}'", dice.hex(64)),
        ("sha256" | "hash" | "before" | "checkpoint" | "trace", "TEXT") => literal(&dice.hex(64)),
        (
            "id" | "key" | "emulator" | "parameter_set" | "idempotency_key" | "replaced_by"
            | "name" | "reason",
            _,
        ) => {
            let prefix = match (table, column) {
                (_, "parameter_set") | ("parameter_set", "id") => "ps-",
                ("policy", _) => "p-",
                ("simulator_version", _) => "sv-",
                ("bench_reservation", _) => "rs-",
                ("webhook", _) => "wh-",
                ("emulator_run", _) => "em-",
                _ => "",
            };
            literal(&format!("{prefix}{k}{}", dice.text()))
        }
        ("url", _) => literal("http://a.example/ä"),
        ("kind", _) if table == "audit" => literal("person"),
        ("weighing", _) if table == "audit" => literal(&format!("w{}", dice.text())),
        (_, "TEXT") => literal(&dice.text()),
        ("dispensed_mg" | "reading_mg" | "error_mg" | "seconds" | "claimed_fraction", _) => {
            real(dice.any_real())
        }
        ("fraction", _) => dice.pick(&["0", "1e-320", "0.1", "1"]).to_owned(),
        ("tolerance_lower_mg", _) => real(-0.0),
        ("repose_deg" | "sd_deg" | "error_deg" | "repose_sd_deg", _) => {
            format!("{:?}", 5.0 + (dice.roll() % 1000) as f64 / 37.0)
        }
        (_, "REAL") => dice.pick(&["5e-324", "1e6", "0.1"]).to_owned(),
        ("soluble" | "cancel_requested" | "may_clear" | "serves", _) => (k % 2).to_string(),
        ("position" | "number" | "episode", _) => (k + 1).to_string(),
        ("n", _) => (1 + k).to_string(),
        ("seed" | "shakes" | "failing_since" | "started_at" | "claimed_at", _) => {
            dice.any_integer().to_string()
        }
        _ => dice.count().to_string(),
    }
}
