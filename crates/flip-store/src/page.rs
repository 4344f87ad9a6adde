//! Keyset paging: a list continues after the last row of the previous page.

use super::labels::Shown;
use super::row::Columns;
use super::{Result, Store};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};
use sqlx::any::AnyRow;

/// Maximum number of items on a page of a list.
pub const LIST_LIMIT_MAX: u32 = 200;
/// Maximum number of items on a page of a series (trials, episodes), which are drawn as curves.
pub const SERIES_LIMIT_MAX: u32 = 5000;
/// Number of items on a page when the caller sets no limit.
pub const LIMIT_DEFAULT: u32 = 50;

/// Rows read at once for an answer that grows with the whole history.
pub(super) const LONG_BATCH: i64 = 2000;

/// Requested page.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct PageQuery {
    /// Maximum number of items to return; 1 to [`LIST_LIMIT_MAX`] for lists, to
    /// [`SERIES_LIMIT_MAX`] for series.
    pub limit: Option<u32>,
    /// `next` of the previous page.
    pub after: Option<String>,
    /// Which items, by their labels; lists of what has none ignore it.
    #[serde(default)]
    pub shown: Shown,
}

/// A page of a list, and the cursor of the next one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Page<T> {
    /// The items, in the list's order.
    pub items: Vec<T>,
    /// Pass it as `after` to read on; absent on the last page.
    pub next: Option<String>,
}

/// A checked [`PageQuery`], in rows.
#[derive(Debug, Clone, Default)]
pub struct Window {
    /// Sequence number of the last row of the previous page.
    pub after: Option<i64>,
    /// Rows to return.
    pub limit: u32,
    /// Which rows, by their labels.
    pub shown: Shown,
}

impl PageQuery {
    /// A window of the first `limit` items.
    pub fn first(limit: u32) -> Self {
        Self { limit: Some(limit), ..Self::default() }
    }

    /// The same list with archived items.
    pub fn with_archived(mut self) -> Self {
        self.shown = Shown::all();
        self
    }

    /// The query in rows.
    ///
    /// # Errors
    /// `limit` outside 1..=`limit_max`, or an `after` that no page has returned.
    pub fn window(&self, limit_max: u32) -> std::result::Result<Window, FieldError> {
        let limit = self.limit.unwrap_or(LIMIT_DEFAULT.min(limit_max));
        if !(1..=limit_max).contains(&limit) {
            return Err(FieldError::new(
                "limit",
                format!("must be from 1 to {limit_max}, got {limit}"),
            ));
        }
        let after = self.after.as_deref().map(decode).transpose()?;
        Ok(Window { after, limit, shown: self.shown.clone() })
    }
}

impl Window {
    /// For a list whose newest row comes first: rows with a smaller number than this are next.
    pub fn before(&self) -> i64 {
        self.after.unwrap_or(i64::MAX)
    }

    /// For a list whose oldest row comes first: rows with a greater number than this are next.
    pub fn after(&self) -> i64 {
        self.after.unwrap_or(i64::MIN)
    }

    /// Number of rows to query: one more than the page holds, to see whether there is a next page.
    pub fn rows(&self) -> i64 {
        i64::from(self.limit) + 1
    }

    /// The page made of up to [`Window::rows`] rows with a `seq` column.
    pub(super) fn page_of<T>(
        &self,
        rows: &[AnyRow],
        item: impl Fn(&AnyRow) -> Result<T>,
    ) -> Result<Page<T>> {
        let numbered: Result<Vec<_>> =
            rows.iter().map(|row| Ok((row.plain("seq")?, item(row)?))).collect();
        Ok(self.page(numbered?))
    }

    /// The page made of up to [`Window::rows`] numbered items.
    pub fn page<T>(&self, mut rows: Vec<(i64, T)>) -> Page<T> {
        let more = rows.len() > self.limit as usize;
        rows.truncate(self.limit as usize);
        let next = rows.last().filter(|_| more).map(|(seq, _)| encode(*seq));
        Page { items: rows.into_iter().map(|(_, item)| item).collect(), next }
    }
}

fn encode(seq: i64) -> String {
    URL_SAFE_NO_PAD.encode(seq.to_be_bytes())
}

fn decode(cursor: &str) -> std::result::Result<i64, FieldError> {
    let bytes = URL_SAFE_NO_PAD.decode(cursor).ok().and_then(|b| <[u8; 8]>::try_from(b).ok());
    bytes.map(i64::from_be_bytes).ok_or_else(|| {
        FieldError::new(
            "after",
            "is not a cursor of this list: pass `next` of the page before as it is, or leave it out",
        )
    })
}

impl Store {
    /// Rows after a position, oldest first, at most [`LONG_BATCH`], and the position of the last
    /// one. The statement's arguments: a powder or null for any, the position, the limit.
    pub(super) async fn batch<T>(
        &self,
        sql: &'static str,
        powder: Option<&str>,
        after: i64,
        read: impl Fn(&AnyRow) -> Result<T>,
    ) -> Result<(Vec<T>, i64)> {
        let rows = sqlx::query(sql)
            .bind(powder)
            .bind(after)
            .bind(LONG_BATCH)
            .fetch_all(&self.long)
            .await?;
        let last = rows.last().map_or(Ok(after), |row| row.plain("seq"))?;
        Ok((rows.iter().map(read).collect::<Result<_>>()?, last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_names_the_next_one_only_when_there_is_one() {
        let window = PageQuery::first(2).window(LIST_LIMIT_MAX).unwrap();
        let full = window.page(vec![(9, 'a'), (7, 'b'), (5, 'c')]);
        assert_eq!(full.items, ['a', 'b']);
        let next = PageQuery { limit: Some(2), after: full.next, ..PageQuery::default() }
            .window(LIST_LIMIT_MAX)
            .unwrap();
        assert_eq!(next.before(), 7);
        assert_eq!(window.page(vec![(9, 'a'), (7, 'b')]).next, None);
    }

    #[test]
    fn limits_and_cursors_from_outside_are_refused_by_name() {
        let refused = |limit, after: Option<&str>| {
            PageQuery { limit, after: after.map(str::to_owned), ..PageQuery::default() }
                .window(LIST_LIMIT_MAX)
                .unwrap_err()
                .field
        };
        assert_eq!(refused(Some(0), None), "limit");
        assert_eq!(refused(Some(201), None), "limit");
        assert_eq!(refused(None, Some("nonsense!")), "after");
        assert_eq!(refused(None, Some("AAAA")), "after");
    }
}
