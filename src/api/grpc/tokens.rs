//! `flip.v1.Tokens`.

use super::convert::{all, at, page};
use super::proto::*;
use super::{Service, govern};
use crate::api::problem::Problem;
use crate::app;
use crate::app::TokenEntry;
use flip_core::domain::FieldError;
use tonic::{Request, Response, Status};

#[tonic::async_trait]
impl tokens_server::Tokens for Service {
    async fn create_token(
        &self,
        request: Request<CreateTokenRequest>,
    ) -> Result<Response<CreateTokenResponse>, Status> {
        let CreateTokenRequest { name, role, may_clear, expires_in_s } = govern(request)?;
        let role = match Role::try_from(role) {
            Ok(Role::Viewer) => app::Role::Viewer,
            Ok(Role::Operator) => app::Role::Operator,
            Ok(Role::Admin) => app::Role::Admin,
            _ => {
                return Err(Problem::from(FieldError::new(
                    "role",
                    "must be viewer, operator or admin",
                ))
                .into());
            }
        };
        let new = app::NewToken { name, role, may_clear, expires_in_s };
        let (entry, secret) = self.app.make_token(&new).await?;
        Ok(Response::new(CreateTokenResponse { token: Some(entry.into()), secret }))
    }

    async fn list_tokens(
        &self,
        request: Request<ListTokensRequest>,
    ) -> Result<Response<ListTokensResponse>, Status> {
        let found = self.app.tokens(page(govern(request)?.page)).await?;
        Ok(Response::new(ListTokensResponse { items: all(found.items), next: found.next }))
    }

    async fn revoke_token(
        &self,
        request: Request<RevokeTokenRequest>,
    ) -> Result<Response<Token>, Status> {
        Ok(Response::new(self.app.revoke_token(&govern(request)?.id).await?.into()))
    }
}

impl From<TokenEntry> for Token {
    fn from(entry: TokenEntry) -> Self {
        let role = match entry.role {
            app::Role::Viewer => Role::Viewer,
            app::Role::Operator => Role::Operator,
            app::Role::Admin => Role::Admin,
        };
        Self {
            id: entry.id,
            name: entry.name,
            role: role.into(),
            may_clear: entry.may_clear,
            created_at: at(entry.created_at),
            expires_at: entry.expires_at.and_then(at),
            revoked_at: entry.revoked_at.and_then(at),
            last_used_at: entry.last_used_at.and_then(at),
        }
    }
}
