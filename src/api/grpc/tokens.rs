//! `flip.v1.Tokens`.

use super::convert::{all, at, page};
use super::proto::*;
use super::{Service, govern, read};
use crate::api::auth::{Caller, Identity as Who};
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

    async fn get_identity(
        &self,
        request: Request<GetIdentityRequest>,
    ) -> Result<Response<Identity>, Status> {
        let caller = Caller::of(request.extensions());
        read(request)?;
        let Who { token, name, role, may_clear, expires_at, issuer } = caller.identity();
        Ok(Response::new(Identity {
            token,
            name,
            expires_at: expires_at.and_then(at),
            role: Role::from(role).into(),
            may_clear,
            issuer,
        }))
    }

    async fn get_log_in(
        &self,
        _: Request<GetLogInRequest>,
    ) -> Result<Response<LogInOffer>, Status> {
        let provider = self.app.log_in_host().map(str::to_owned);
        Ok(Response::new(LogInOffer { provider }))
    }

    async fn begin_log_in(
        &self,
        _: Request<BeginLogInRequest>,
    ) -> Result<Response<BegunLogIn>, Status> {
        let app::BegunLogIn { url, state, secret } = self.app.begin_log_in().await?;
        Ok(Response::new(BegunLogIn { url, state, secret }))
    }

    async fn finish_log_in(
        &self,
        request: Request<FinishLogInRequest>,
    ) -> Result<Response<CreateTokenResponse>, Status> {
        let FinishLogInRequest { state, code, secret } = request.into_inner();
        let answer = app::LogInAnswer { state, code, secret };
        let (entry, secret) = self.app.finish_log_in(&answer).await?;
        Ok(Response::new(CreateTokenResponse { token: Some(entry.into()), secret }))
    }
}

impl From<app::Role> for Role {
    fn from(role: app::Role) -> Self {
        match role {
            app::Role::Viewer => Self::Viewer,
            app::Role::Operator => Self::Operator,
            app::Role::Admin => Self::Admin,
        }
    }
}

impl From<TokenEntry> for Token {
    fn from(entry: TokenEntry) -> Self {
        Self {
            id: entry.id,
            name: entry.name,
            role: Role::from(entry.role).into(),
            may_clear: entry.may_clear,
            created_at: at(entry.created_at),
            expires_at: entry.expires_at.and_then(at),
            revoked_at: entry.revoked_at.and_then(at),
            last_used_at: entry.last_used_at.and_then(at),
            issuer: entry.issuer,
            subject: entry.subject,
        }
    }
}
