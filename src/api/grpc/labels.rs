//! `flip.v1.Labels`, and labels on other messages.

use super::convert::{all, at, missing, named};
use super::proto::*;
use super::{Service, read, write};
use crate::app;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl labels_server::Labels for Service {
    async fn list_labels(
        &self,
        request: Request<ListLabelsRequest>,
    ) -> Result<Response<ListLabelsResponse>, Status> {
        let ListLabelsRequest { page: wanted, kind } = read(request)?;
        let kind = named::<LabelKind, _>("kind", kind.unwrap_or_default())?;
        let found = self.app.labels(kind, page(wanted)).await?;
        Ok(Response::new(ListLabelsResponse { items: all(found.items), next: found.next }))
    }

    async fn get_label(
        &self,
        request: Request<GetLabelRequest>,
    ) -> Result<Response<Label>, Status> {
        let GetLabelRequest { kind, id } = read(request)?;
        let kind = named::<LabelKind, _>("kind", kind)?.ok_or_else(|| missing("kind"))?;
        Ok(Response::new(self.app.label(kind, &id).await?.into()))
    }

    async fn set_label(
        &self,
        request: Request<SetLabelRequest>,
    ) -> Result<Response<Label>, Status> {
        let SetLabelRequest { kind, id, name, note, tags, archived } = write(request)?;
        let kind = named::<LabelKind, _>("kind", kind)?.ok_or_else(|| missing("kind"))?;
        let tags = tags.map(|tags| tags.tags);
        let change = app::LabelChange { name, note, tags, archived };
        Ok(Response::new(self.app.set_label(kind, &id, change).await?.into()))
    }
}

/// The requested page; by default the first, without archived items.
pub fn page(request: Option<PageRequest>) -> app::PageQuery {
    let Some(page) = request else { return app::PageQuery::default() };
    let archived: Option<app::ArchivedItems> = page.archived().into();
    let tag = page.tag.filter(|tag| !tag.trim().is_empty());
    let shown = app::Shown { archived: archived.unwrap_or_default(), tag };
    app::PageQuery { limit: page.limit, after: page.after, shown }
}

impl From<app::Label> for Label {
    fn from(label: app::Label) -> Self {
        Self {
            kind: LabelKind::from(label.kind).into(),
            id: label.id,
            name: label.name,
            note: label.note,
            tags: label.tags,
            archived_at: label.archived_at.and_then(at),
            changed_at: label.changed_at.and_then(at),
            changed_by: label.changed_by,
        }
    }
}

impl From<app::Withdrawn> for Withdrawn {
    fn from(it: app::Withdrawn) -> Self {
        Self { at: at(it.at), by: it.by, reason: it.reason, replaced_by: it.replaced_by }
    }
}

/// Messages that carry the label of what they describe.
macro_rules! labelled {
    ($($Ours:ident => $Wire:ident;)*) => {
        $(impl From<app::Labelled<app::$Ours>> for $Wire {
            fn from(it: app::Labelled<app::$Ours>) -> Self {
                Self { label: it.label.map(Into::into), ..it.item.into() }
            }
        })*
    };
}

labelled! {
    Powder => Powder;
    Job => Job;
    Calibration => Calibration;
    Training => Training;
    Policy => Policy;
    Evaluation => Evaluation;
    Investigation => Investigation;
    SimulatorVersion => SimulatorVersion;
    Weighing => Weighing;
    ReposeMeasurement => ReposeMeasurement;
}

impl From<app::Labelled<app::PowderDetail>> for PowderDetail {
    fn from(it: app::Labelled<app::PowderDetail>) -> Self {
        let mut detail = Self::from(it.item);
        if let Some(powder) = &mut detail.powder {
            powder.label = it.label.map(Into::into);
        }
        detail
    }
}

impl From<app::Labelled<app::WeighingDetail>> for WeighingDetail {
    fn from(it: app::Labelled<app::WeighingDetail>) -> Self {
        let mut detail = Self::from(it.item);
        if let Some(weighing) = &mut detail.weighing {
            weighing.label = it.label.map(Into::into);
        }
        detail
    }
}
