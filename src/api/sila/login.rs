//! AuthenticationService and AuthorizationService: access tokens for FLIP's tokens.

use super::error::Call;
use super::feature::{AUTHENTICATION, all};
use super::identity::{LIFE, authenticated};
use super::proto::sila2::org::silastandard::core::authenticationservice::v1::*;
use super::proto::sila2::org::silastandard::core::authorizationservice::v1::authorization_service_server::AuthorizationService;
use super::proto::sila2::org::silastandard::core::authorizationservice::v1::{
    GetFcpAffectedByMetadataAccessTokenParameters, GetFcpAffectedByMetadataAccessTokenResponses,
};
use super::value::{integer, text};
use super::{Sila, standard};
use authentication_service_server::AuthenticationService;
use tonic::{Request, Response, Status};

const LOGIN: Call =
    Call { feature: AUTHENTICATION, command: "Login", parameters: &[], errors: &[] };
const LOGOUT: Call =
    Call { feature: AUTHENTICATION, command: "Logout", parameters: &[], errors: &[] };

#[tonic::async_trait]
impl AuthenticationService for Sila {
    async fn login(
        &self,
        request: Request<LoginParameters>,
    ) -> Result<Response<LoginResponses>, Status> {
        let asked = request.into_inner();
        let user = LOGIN.text("UserIdentification", asked.user_identification)?;
        let secret = LOGIN.text("Password", asked.password)?;
        let server = LOGIN.text("RequestedServer", asked.requested_server)?;
        let failed = |why: &str| LOGIN.defined("AuthenticationFailed", why);
        if !server.eq_ignore_ascii_case(&self.plate.uuid().to_string()) {
            return Err(failed("RequestedServer is the UUID of another server"));
        }
        let known = |it: &standard::String| {
            all(self.lock.is_some()).any(|known| known.identifier.eq_ignore_ascii_case(&it.value))
        };
        if !asked.requested_features.iter().all(known) {
            return Err(failed("one of RequestedFeatures is not implemented here"));
        }
        let advice = "the password is a FLIP token (flip token create), the user its name";
        let holder = authenticated(&self.app, &secret).await.ok_or_else(|| failed(advice))?;
        if !user.is_empty() && user != holder.name {
            return Err(failed("the token has another name: give that as the user, or none"));
        }
        let token = self.sessions.begin(&secret)?;
        let lifetime = integer(LIFE.as_secs() as i64);
        Ok(Response::new(LoginResponses { access_token: text(token), token_lifetime: lifetime }))
    }

    async fn logout(
        &self,
        request: Request<LogoutParameters>,
    ) -> Result<Response<LogoutResponses>, Status> {
        let token = LOGOUT.text("AccessToken", request.into_inner().access_token)?;
        match self.sessions.end(&token) {
            true => Ok(Response::new(LogoutResponses {})),
            false => {
                Err(LOGOUT.defined("InvalidAccessToken", "there is no such access token any more"))
            }
        }
    }
}

#[tonic::async_trait]
impl AuthorizationService for Sila {
    async fn get_fcp_affected_by_metadata_access_token(
        &self,
        _: Request<GetFcpAffectedByMetadataAccessTokenParameters>,
    ) -> Result<Response<GetFcpAffectedByMetadataAccessTokenResponses>, Status> {
        let affected_calls = self.guarded.iter().filter_map(text).collect();
        Ok(Response::new(GetFcpAffectedByMetadataAccessTokenResponses { affected_calls }))
    }
}
