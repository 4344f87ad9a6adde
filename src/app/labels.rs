//! Names, notes and tags of everything a person makes, and what lists hide.

use super::check::Check;
use super::powders::same_name_refused;
use super::{
    App, Calibration, Error, Evaluation, Investigation, Job, JobKind, Page, PageQuery, Policy,
    Powder, PowderDetail, ReposeMeasurement, Result, SimulatorVersion, Training, Weighing,
    WeighingDetail,
};
use flip_core::domain::FieldError;
use flip_core::domain::powder_name::NAME_CHARS_MAX;
use flip_store::labels::{Label, LabelKind};
use flip_store::now;
use flip_store::page::LIST_LIMIT_MAX;
use flip_store::who::Who;
use serde::{Deserialize, Serialize};
use serde_json::json;

/// Maximum length of a note, characters.
const NOTE_CHARS_MAX: usize = 4000;
/// Most tags on one thing.
const TAGS_MAX: usize = 20;
/// Maximum length of a tag, characters.
const TAG_CHARS_MAX: usize = 40;

/// What to change about a label; what is absent stays as it is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct LabelChange {
    /// Name for people, up to 100 characters on one line; empty removes it. A powder keeps one.
    pub name: Option<String>,
    /// Note, up to 4000 characters; empty removes it.
    pub note: Option<String>,
    /// All its tags: up to 20, each up to 40 characters and without a comma. Tags that differ only
    /// in case are one.
    pub tags: Option<Vec<String>>,
    /// Whether lists hide it.
    pub archived: Option<bool>,
}

/// Something with its label, if anybody has changed that.
#[derive(Debug, Clone, PartialEq)]
pub struct Labelled<T> {
    /// What it is.
    pub item: T,
    /// Its label.
    pub label: Option<Label>,
}

/// Has a label.
pub trait Named {
    /// What it is, and its id.
    fn called(&self) -> (LabelKind, &str);
}

impl Named for Job {
    fn called(&self) -> (LabelKind, &str) {
        let kind = match self.kind {
            JobKind::Calibration => LabelKind::Calibration,
            JobKind::Training => LabelKind::Training,
            JobKind::Evaluation => LabelKind::Evaluation,
            JobKind::Investigation => LabelKind::Investigation,
            JobKind::Repose => LabelKind::Repose,
            JobKind::Film => LabelKind::Film,
        };
        (kind, &self.id)
    }
}

macro_rules! named {
    ($($Item:ty: $kind:ident $($field:ident).+;)*) => {
        $(impl Named for $Item {
            fn called(&self) -> (LabelKind, &str) {
                (LabelKind::$kind, &self.$($field).+)
            }
        })*
    };
}

named! {
    Powder: Powder id;
    PowderDetail: Powder powder.id;
    WeighingDetail: Weighing weighing.id;
    Calibration: Calibration job.id;
    Training: Training job.id;
    Evaluation: Evaluation job.id;
    Investigation: Investigation job.id;
    ReposeMeasurement: Repose job.id;
    Policy: Policy id;
    SimulatorVersion: Simulator id;
    Weighing: Weighing id;
}

impl App {
    /// The label of one thing; an empty one if nobody has named it.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn label(&self, kind: LabelKind, id: &str) -> Result<Label> {
        let own_name = self.exists(kind, id).await?;
        let mut label =
            self.store().label(kind, id).await?.unwrap_or_else(|| Label::none(kind, id));
        label.name = own_name.unwrap_or(label.name);
        Ok(label)
    }

    /// Labels, the one first made first; optionally of one kind.
    pub async fn labels(&self, kind: Option<LabelKind>, page: PageQuery) -> Result<Page<Label>> {
        let mut found = self.store().labels(kind, page.window(LIST_LIMIT_MAX)?).await?;
        let names = self.store().powder_names().await?;
        for label in found.items.iter_mut().filter(|it| it.kind == LabelKind::Powder) {
            if let Some((_, name)) = names.iter().find(|(id, _)| *id == label.id) {
                name.clone_into(&mut label.name);
            }
        }
        Ok(found)
    }

    /// Renames, notes, tags or archives one thing. Nothing but the label changes: what it is on is
    /// never deleted, and can be shown and used as before.
    ///
    /// # Errors
    /// `NotFound`; `Invalid`; `Conflict`: `powder_exists` if another powder has that name,
    /// `not_over` if what is to be archived has not ended.
    pub async fn set_label(&self, kind: LabelKind, id: &str, change: LabelChange) -> Result<Label> {
        let own_name = self.exists(kind, id).await?;
        let change = change.checked(kind)?;
        if change.archived == Some(true) {
            self.is_over(kind, id).await?;
        }
        let mut tx = self.store().write().await?;
        let before = tx.label(kind, id).await?.unwrap_or_else(|| Label::none(kind, id));
        let mut label = before.clone();
        label.note = change.note.unwrap_or(label.note);
        label.tags = change.tags.unwrap_or(label.tags);
        label.archived_at = match change.archived {
            Some(true) => label.archived_at.or_else(|| Some(now())),
            Some(false) => None,
            None => label.archived_at,
        };
        let mut powder = None;
        match (own_name, change.name) {
            (Some(own), Some(name)) if own != name => {
                same_name_refused(&tx.powder_names().await?, Some(id), &name)?;
                tx.rename_powder(id, &name).await?;
                powder = Some(name);
            }
            (Some(_), _) => {}
            (None, name) => label.name = name.unwrap_or(label.name),
        }
        if label == before && powder.is_none() {
            drop(tx);
            return self.label(kind, id).await;
        }
        let at = now();
        label.changed_at = Some(at);
        label.changed_by = Who::now().map(|who| who.name);
        tx.set_label(&label).await?;
        let mut said = json!({ "label": { "kind": kind, "id": id, "name": label.name, "note": label.note,
            "tags": label.tags, "archived_at": label.archived_at } });
        if let Some(name) = &powder {
            said["powder"] = json!({ "id": id, "name": name });
        }
        let weighing = (kind == LabelKind::Weighing).then_some(id);
        tx.audit_deed(weighing, "label", said, at).await?;
        tx.commit().await?;
        self.label(kind, id).await
    }

    /// One thing with its label.
    pub async fn labelled<T: Named>(&self, item: T) -> Result<Labelled<T>> {
        let (kind, id) = item.called();
        let label = self.store().label(kind, id).await?;
        Ok(Labelled { item, label })
    }

    /// A page of things with their labels.
    pub async fn all_labelled<T: Named>(&self, page: Page<T>) -> Result<Page<Labelled<T>>> {
        let mut labels = Vec::new();
        for kind in kinds(&page.items) {
            let of_kind = page.items.iter().map(Named::called).filter(|(it, _)| *it == kind);
            let ids: Vec<&str> = of_kind.map(|(_, id)| id).collect();
            labels.push((kind, self.store().labels_of(kind, &ids).await?));
        }
        let items = page.items.into_iter().map(|item| {
            let (kind, id) = item.called();
            let of_kind = labels.iter_mut().find(|(it, _)| *it == kind);
            let label = of_kind.and_then(|(_, labels)| labels.remove(id));
            Labelled { item, label }
        });
        Ok(Page { items: items.collect(), next: page.next })
    }

    /// The name in its own row, if its kind has one there.
    ///
    /// # Errors
    /// `NotFound`
    async fn exists(&self, kind: LabelKind, id: &str) -> Result<Option<String>> {
        let store = self.store();
        let (what, is_there) = match kind {
            LabelKind::Powder => return Ok(Some(self.existing_powder(id).await?.name)),
            LabelKind::Calibration => ("calibration", self.is_job(JobKind::Calibration, id).await?),
            LabelKind::Training => ("training", self.is_job(JobKind::Training, id).await?),
            LabelKind::Evaluation => ("evaluation", self.is_job(JobKind::Evaluation, id).await?),
            LabelKind::Investigation => {
                ("investigation", self.is_job(JobKind::Investigation, id).await?)
            }
            LabelKind::Repose => ("repose measurement", self.is_job(JobKind::Repose, id).await?),
            LabelKind::Film => ("film", self.is_job(JobKind::Film, id).await?),
            LabelKind::Policy => ("policy", store.policy(id).await?.is_some()),
            LabelKind::Simulator => ("simulator version", store.simulator(id).await?.is_some()),
            LabelKind::Weighing => ("weighing", store.weighing(id).await?.is_some()),
            LabelKind::DoseList => ("list of doses", store.is_dose_list(id).await?),
        };
        if is_there { Ok(None) } else { Err(Error::not_found(what, id)) }
    }

    async fn is_job(&self, kind: JobKind, id: &str) -> Result<bool> {
        Ok(self.store().job(id).await?.is_some_and(|row| row.job.kind == kind))
    }

    /// Refuses to hide what still computes or moves, or waits to.
    async fn is_over(&self, kind: LabelKind, id: &str) -> Result<()> {
        let is_over = match kind {
            LabelKind::Weighing => {
                self.store().weighing(id).await?.is_none_or(|it| it.weighing.outcome.is_some())
            }
            LabelKind::DoseList => !self.store().is_list_unfinished(id).await?,
            _ => self.store().job(id).await?.is_none_or(|row| row.job.state.is_terminal()),
        };
        let advice = "has not ended, and lists must show what computes or moves: wait for its end, or stop or cancel it, then archive it";
        if is_over { Ok(()) } else { Err(Error::conflict("not_over", format!("`{id}` {advice}"))) }
    }
}

fn kinds<T: Named>(items: &[T]) -> Vec<LabelKind> {
    let mut kinds: Vec<LabelKind> = Vec::new();
    for (kind, _) in items.iter().map(Named::called) {
        if !kinds.contains(&kind) {
            kinds.push(kind);
        }
    }
    kinds
}

impl LabelChange {
    /// The change as it is stored: trimmed, each tag once.
    fn checked(mut self, kind: LabelKind) -> Result<Self> {
        let mut check = Check::default();
        if let Some(name) = &mut self.name {
            *name = name.trim().to_owned();
            if !name.is_empty() {
                check.text("name", name, NAME_CHARS_MAX);
            } else if kind == LabelKind::Powder {
                check.refuse("name", "must not be empty: a powder has a name");
            }
        }
        if let Some(note) = &mut self.note {
            *note = note.trim().replace("\r\n", "\n");
            let length = note.chars().count();
            let is_odd = |c: char| c.is_control() && c != '\n' && c != '\t';
            if length > NOTE_CHARS_MAX || note.chars().any(is_odd) {
                check.refuse(
                    "note",
                    format!("must be at most {NOTE_CHARS_MAX} characters, line breaks but no other control characters, got {length}"),
                );
            }
        }
        if let Some(tags) = self.tags.take() {
            self.tags = check.keep(checked_tags(tags));
        }
        check.done()?;
        Ok(self)
    }
}

fn checked_tags(tags: Vec<String>) -> std::result::Result<Vec<String>, FieldError> {
    let mut kept: Vec<String> = Vec::new();
    for (k, tag) in tags.iter().enumerate() {
        let tag = tag.split_whitespace().collect::<Vec<_>>().join(" ");
        let length = tag.chars().count();
        if !(1..=TAG_CHARS_MAX).contains(&length)
            || tag.contains(',')
            || tag.chars().any(char::is_control)
        {
            let advice =
                format!("must be 1 to {TAG_CHARS_MAX} characters without commas, got `{tag}`");
            return Err(FieldError::new(format!("tags[{k}]"), advice));
        }
        if !kept.iter().any(|known| known.to_lowercase() == tag.to_lowercase()) {
            kept.push(tag);
        }
    }
    match kept.len() > TAGS_MAX {
        true => {
            let advice = format!("must be at most {TAGS_MAX}, got {}", kept.len());
            Err(FieldError::new("tags", advice))
        }
        false => Ok(kept),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(change: LabelChange, kind: LabelKind) -> String {
        match change.checked(kind).unwrap_err() {
            Error::Invalid(errors) => errors[0].field.clone(),
            other => panic!("{other}"),
        }
    }

    #[test]
    fn what_a_person_types_is_tidied_and_what_cannot_be_kept_is_refused_by_name() {
        let tags = ["  Batch  7 ", "batch 7", "GMP"].map(str::to_owned).to_vec();
        let change = LabelChange {
            name: Some("  Morning run ".into()),
            note: Some("two\r\nlines\n".into()),
            tags: Some(tags),
            archived: None,
        };
        let kept = change.checked(LabelKind::Training).unwrap();
        assert_eq!(kept.name.as_deref(), Some("Morning run"));
        assert_eq!(kept.note.as_deref(), Some("two\nlines"));
        assert_eq!(kept.tags.unwrap(), ["Batch 7", "GMP"]);

        let name = |name: &str| LabelChange { name: Some(name.into()), ..LabelChange::default() };
        let tags = |tags: Vec<String>| LabelChange { tags: Some(tags), ..LabelChange::default() };
        assert_eq!(refused(name(&"x".repeat(101)), LabelKind::Policy), "name");
        assert_eq!(refused(name("a\nb"), LabelKind::Policy), "name");
        assert_eq!(refused(name(" "), LabelKind::Powder), "name");
        assert!(name("").checked(LabelKind::Policy).is_ok(), "it removes the name");
        assert_eq!(refused(tags(vec!["a".into(), "b,c".into()]), LabelKind::Policy), "tags[1]");
        assert_eq!(refused(tags(vec![String::new()]), LabelKind::Policy), "tags[0]");
        let many = (0..21).map(|k| format!("t{k}")).collect();
        assert_eq!(refused(tags(many), LabelKind::Policy), "tags");
        let note = LabelChange { note: Some("x".repeat(4001)), ..LabelChange::default() };
        assert_eq!(refused(note, LabelKind::Policy), "note");
    }
}
