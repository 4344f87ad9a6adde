//! `flip.v1.Webhooks`.

use super::convert::{all, at};
use super::proto::*;
use super::{Service, govern};
use crate::app;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl webhooks_server::Webhooks for Service {
    async fn add_webhook(
        &self,
        request: Request<AddWebhookRequest>,
    ) -> Result<Response<AddWebhookResponse>, Status> {
        let new = app::NewWebhook { url: govern(request)?.url };
        let (webhook, secret) = self.app.add_webhook(&new).await?;
        Ok(Response::new(AddWebhookResponse { webhook: Some(webhook.into()), secret }))
    }

    async fn list_webhooks(
        &self,
        request: Request<ListWebhooksRequest>,
    ) -> Result<Response<ListWebhooksResponse>, Status> {
        govern(request)?;
        Ok(Response::new(ListWebhooksResponse { items: all(self.app.webhooks().await?) }))
    }

    async fn remove_webhook(
        &self,
        request: Request<RemoveWebhookRequest>,
    ) -> Result<Response<RemoveWebhookResponse>, Status> {
        self.app.remove_webhook(&govern(request)?.id).await?;
        Ok(Response::new(RemoveWebhookResponse {}))
    }
}

impl From<app::Webhook> for Webhook {
    fn from(it: app::Webhook) -> Self {
        let app::Webhook { id, url, created_at, failing_since, error } = it;
        let (created_at, failing_since) = (at(created_at), failing_since.and_then(at));
        Self { id, url, created_at, failing_since, error }
    }
}
