//! Weighings that match, in the order asked for, and how many there are.
//!
//! A list is read page by page by keyset: the cursor is the place of the last row, and the next page
//! holds what comes after that row in the order asked for, also while doses come in.

use super::jobs::path_of;
use super::labels::Shown;
use super::page::{Page, Window};
use super::row::{Columns, word};
use super::sql::Parts;
use super::weighing_rows::weighing;
use super::weighings::Weighing;
use super::{Result, Store};
use flip_core::domain::bench::BenchKind;
use flip_core::domain::labels::LabelWanted;
use flip_core::domain::timestamp::Timestamp;
use flip_core::domain::weighing::{Outcome, WeighingState};
use serde::{Deserialize, Serialize};

/// Which weighings. Empty: all.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct WeighingsWanted {
    /// Only of this powder, by id.
    pub powder: Option<String>,
    /// Only of this lot of a powder.
    pub lot: Option<String>,
    /// Only into this vial.
    pub vial: Option<String>,
    /// Only asked for by this operator.
    pub operator: Option<String>,
    /// Only of this list of doses.
    pub list: Option<String>,
    /// Only by this policy, by id.
    pub policy: Option<String>,
    /// Only on this kind of bench.
    pub bench: Option<BenchKind>,
    /// Only with this label of a caller.
    #[serde(default)]
    pub label: Option<LabelWanted>,
    /// Only with this state.
    pub state: Option<WeighingState>,
    /// Only with this outcome.
    pub outcome: Option<Outcome>,
    /// Only under or over their tolerance, by the reading.
    #[serde(default)]
    pub outside: bool,
    /// Only requested at this time or later.
    pub since: Option<Timestamp>,
    /// Only requested before this time.
    pub before: Option<Timestamp>,
    /// Only with these words, in any case, each in the id, powder, policy, lot, vial, operator,
    /// list, position or error, or in the name given to it.
    pub text: Option<String>,
    /// Their order.
    pub sort: WeighingSort,
}

/// Order of weighings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WeighingSort {
    /// The newest request first.
    #[default]
    Newest,
    /// The oldest request first.
    Oldest,
    /// The largest error first, of either sign; those without one last.
    Error,
    /// The largest target first.
    Target,
    /// The longest on the bench first; those that did not move last.
    Seconds,
}

/// A page of matching weighings, and how many match.
#[derive(Debug, Clone, PartialEq)]
pub struct WeighingsFound {
    /// The page.
    pub page: Page<Weighing>,
    /// How many match in all.
    pub total: u64,
}

impl WeighingSort {
    /// What is ordered by, descending; the number of the row decides among equals.
    fn key(self) -> &'static str {
        match self {
            Self::Newest => "seq",
            Self::Oldest => "-seq",
            Self::Error => "coalesce(abs(error_mg), -1)",
            Self::Target => "target_mg",
            Self::Seconds => "coalesce(seconds, -1)",
        }
    }
}

impl WeighingsWanted {
    /// Adds the conditions to a statement that has come to its `WHERE`.
    fn restrict(&self, shown: &Shown, sql: &mut Parts) {
        sql.push("TRUE");
        restrict_to(shown, self.list.is_some(), sql);
        let words = [
            ("powder", self.powder.clone()),
            ("policy", self.policy.clone()),
            ("asked ->> 'lot'", self.lot.clone()),
            ("asked ->> 'vial'", self.vial.clone()),
            ("asked ->> 'operator'", self.operator.clone()),
            ("asked ->> 'list'", self.list.clone()),
            ("bench", self.bench.as_ref().map(word)),
            ("state", self.state.as_ref().map(word)),
            ("outcome", self.outcome.as_ref().map(word)),
        ];
        for (column, is) in words {
            if let Some(is) = is {
                sql.push(format!(" AND {column} = ")).push_bind(is);
            }
        }
        if let Some(LabelWanted { key, value }) = &self.label {
            sql.push(" AND labels ->> ")
                .push_bind(path_of(key))
                .push(" = ")
                .push_bind(value.clone());
        }
        if self.outside {
            sql.push(" AND outcome IN ('under', 'over')");
        }
        if let Some(since) = self.since {
            sql.push(" AND created_at >= ").push_bind(since.unix_ms());
        }
        if let Some(before) = self.before {
            sql.push(" AND created_at < ").push_bind(before.unix_ms());
        }
        for part in self.text.iter().flat_map(|text| text.split_whitespace()) {
            // Reading JSON takes most of the time: first whether the word is anywhere in it.
            sql.push(" AND (TRUE");
            if !part.contains(['"', '\\']) {
                let row = "id || ' ' || powder || ' ' || policy || ' ' || coalesce(asked, '') || ' ' || coalesce(error, '')";
                sql.push(" AND ").contains(row, part);
            }
            let words = "concat_ws(' ', id, powder, policy, asked ->> 'lot', asked ->> 'vial', asked ->> 'operator', \
                         asked ->> 'list', asked ->> 'position', error)";
            sql.push(" AND ").contains(words, part);
            sql.push(" OR id IN (SELECT id FROM label WHERE kind = 'weighing' AND ");
            sql.contains("name", part).push("))");
        }
    }
}

/// A weighing is archived with its list of doses, unless that list is asked for, and has the tags
/// of its list.
fn restrict_to(shown: &Shown, of_list: bool, sql: &mut Parts) {
    let archived =
        |kind| format!("(SELECT id FROM label WHERE kind = '{kind}' AND archived_at IS NOT NULL)");
    let (doses, lists) = (archived("weighing"), archived("dose_list"));
    match shown.archived() {
        Some(true) => {
            sql.push(format!(" AND (id IN {doses} OR asked ->> 'list' IN {lists})"));
        }
        Some(false) => {
            sql.push(format!(" AND id NOT IN {doses}"));
            // Reading JSON takes most of the time: first whether any list is archived.
            if !of_list {
                sql.push(format!(
                    " AND (NOT EXISTS {lists} OR coalesce(asked ->> 'list' NOT IN {lists}, TRUE))"
                ));
            }
        }
        None => {}
    }
    if let Some(tag) = &shown.tag {
        let tagged = |kind| {
            format!(
                "(SELECT l.id FROM label l, json_each(l.tags) t WHERE l.kind = '{kind}' AND lower(t.value) = lower("
            )
        };
        sql.push(format!(" AND (id IN {}", tagged("weighing"))).push_bind(tag.clone());
        sql.push(format!(")) OR asked ->> 'list' IN {}", tagged("dose_list")));
        sql.push_bind(tag.clone()).push(")))");
    }
}

impl Store {
    /// A page of the weighings that match, and how many match.
    pub async fn weighings_wanted(
        &self,
        wanted: &WeighingsWanted,
        window: Window,
    ) -> Result<WeighingsFound> {
        let key = wanted.sort.key();
        // To look for words, every row is read: once, for both the page and the number.
        let how = if wanted.text.is_some() { "MATERIALIZED" } else { "NOT MATERIALIZED" };
        let found = format!("WITH found AS {how} (SELECT seq, {key} AS place FROM weighing WHERE ");
        let mut sql = Parts::new(self.is_postgres(), &found);
        wanted.restrict(&window.shown, &mut sql);
        // The page is chosen by its numbers alone: to sort whole rows takes several times as long.
        sql.push(
            ") SELECT w.*, total FROM (SELECT count(*) AS total FROM found) AS counted \
             LEFT JOIN weighing w ON w.seq IN (SELECT seq FROM found",
        );
        if let Some(after) = window.after {
            let there = format!("SELECT {key}, seq FROM weighing WHERE seq = ");
            sql.push(format!(" WHERE (place, seq) < ({there}")).push_bind(after).push(")");
        }
        sql.push(" ORDER BY place DESC, seq DESC LIMIT ").push_bind(window.rows());
        sql.push(format!(") ORDER BY {key} DESC, seq DESC"));
        let mut rows = sql.query().fetch_all(&self.reader).await?;
        let total: i64 = rows[0].plain("total")?;
        // Of an empty page there is only the number.
        rows.retain(|row| row.maybe_plain::<i64>("seq").is_some());
        Ok(WeighingsFound { page: window.page_of(&rows, weighing)?, total: total.unsigned_abs() })
    }
}
