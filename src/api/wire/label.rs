//! Names, notes and tags.

use super::{Answer, Timestamp};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What can have a label.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LabelKind {
    /// A powder; its name is that of its own row.
    Powder,
    /// A calibration.
    Calibration,
    /// A training.
    Training,
    /// A policy.
    Policy,
    /// An evaluation.
    Evaluation,
    /// An investigation.
    Investigation,
    /// A version of the simulator.
    Simulator,
    /// A weighing or a probing run.
    Weighing,
    /// A list of doses; its id is the name under which it was requested.
    DoseList,
    /// A measurement of the angle of repose by camera.
    Repose,
    /// A film of a weighing.
    Film,
}

answer! { app::LabelKind => enum LabelKind {
    Powder, Calibration, Training, Policy, Evaluation, Investigation, Simulator, Weighing, DoseList, Repose,
    Film,
} }
request! { enum LabelKind => app::LabelKind {
    Powder, Calibration, Training, Policy, Evaluation, Investigation, Simulator, Weighing, DoseList, Repose,
    Film,
} }

/// A name, a note, tags, and whether lists hide it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Label {
    /// What it is on.
    pub kind: LabelKind,
    /// Id of that.
    pub id: String,
    /// Name for people; empty: none.
    pub name: String,
    /// Note; empty: none.
    pub note: String,
    /// Tags, in the order given.
    pub tags: Vec<String>,
    /// Since when lists hide it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub archived_at: Option<Timestamp>,
    /// When it was last changed; absent if nobody ever did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub changed_at: Option<Timestamp>,
    /// By whom, if known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub changed_by: Option<String>,
}

answer! { app::Label => Label {
    kind, id, name, note, tags, archived_at, changed_at, changed_by,
} }

/// What to change about a label; what is absent stays as it is.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
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

request! { LabelChange => app::LabelChange { name, note, tags, archived } }

/// Whether archived things are on a list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ArchivedItems {
    /// Left out.
    #[default]
    Exclude,
    /// Nothing else.
    Only,
    /// Among the others.
    Include,
}

request! { enum ArchivedItems => app::ArchivedItems { Exclude, Only, Include } }

/// Something with its label.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Labelled<T> {
    /// What it is.
    #[serde(flatten)]
    pub item: T,
    /// Its name, note and tags; absent if nobody has given it any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub label: Option<Label>,
}

impl<T: Answer> Answer for app::Labelled<T> {
    type Wire = Labelled<T::Wire>;
    fn wire(self) -> Self::Wire {
        Labelled { item: self.item.wire(), label: self.label.wire() }
    }
}
