//! `--oidc-…`: log-ins with the lab's own accounts.

use super::failure::Failure;
use crate::app::{Oidc, OidcSettings, Role};
use flip_core::domain::FieldError;
use std::path::PathBuf;

/// The provider of log-ins; without an issuer there is none.
#[derive(Debug, Clone, clap::Args)]
pub(super) struct OidcArguments {
    /// Let people log in with the lab's own accounts: issuer of the OpenID Connect provider, exactly
    /// as in its discovery document.
    #[arg(long, value_name = "URL")]
    oidc_issuer: Option<String>,
    /// Id under which FLIP is registered at the provider.
    #[arg(long, value_name = "ID")]
    oidc_client_id: Option<String>,
    /// File with the secret that goes with the client id.
    #[arg(long, value_name = "FILE")]
    oidc_client_secret_file: Option<PathBuf>,
    /// Address of FLIP's page as browsers see it, with a last slash, registered at the provider as
    /// redirect URI.
    #[arg(long, value_name = "URL")]
    oidc_redirect_url: Option<String>,
    /// Scopes to ask the provider for, separated by spaces.
    #[arg(long, value_name = "SCOPES", default_value = "openid profile email")]
    oidc_scopes: String,
    /// Claim of the ID token that lists a person's groups.
    #[arg(long, value_name = "CLAIM", default_value = "groups")]
    oidc_role_claim: String,
    /// Role of a group: viewer=GROUP, operator=GROUP or admin=GROUP; may be repeated. Of several, a
    /// person has the highest; without one, nobody gets in.
    #[arg(long, value_name = "ROLE=GROUP", value_parser = role_of_group)]
    oidc_role: Vec<(Role, String)>,
}

impl OidcArguments {
    /// The provider, if one is named.
    pub(super) fn provider(&self) -> Result<Option<Oidc>, Failure> {
        let given = [
            ("oidc_client_id", self.oidc_client_id.is_some()),
            ("oidc_client_secret_file", self.oidc_client_secret_file.is_some()),
            ("oidc_redirect_url", self.oidc_redirect_url.is_some()),
            ("oidc_role", !self.oidc_role.is_empty()),
        ];
        let (Some(issuer), Some(client_id), Some(secret), Some(redirect_url)) = (
            &self.oidc_issuer,
            &self.oidc_client_id,
            &self.oidc_client_secret_file,
            &self.oidc_redirect_url,
        ) else {
            let named = self.oidc_issuer.is_some();
            let wrong =
                given.iter().filter(|(_, is_given)| *is_given != named).map(|(field, _)| {
                    let why = if named { "is needed beside" } else { "means nothing without" };
                    FieldError::new(*field, format!("{why} --oidc-issuer"))
                });
            let wrong: Vec<_> = wrong.collect();
            return if wrong.is_empty() { Ok(None) } else { Err(Failure::BadInput(wrong)) };
        };
        let client_secret = std::fs::read_to_string(secret).map_err(|error| {
            let message = format!("must be a file that can be read; {}: {error}", secret.display());
            FieldError::new("oidc_client_secret_file", message)
        })?;
        Ok(Some(Oidc::new(OidcSettings {
            issuer: issuer.clone(),
            client_id: client_id.clone(),
            client_secret: client_secret.trim_end().to_owned(),
            redirect_url: redirect_url.clone(),
            scopes: self.oidc_scopes.clone(),
            role_claim: self.oidc_role_claim.clone(),
            roles: self.oidc_role.clone(),
        })?))
    }
}

fn role_of_group(text: &str) -> Result<(Role, String), String> {
    let (role, group) = text.split_once('=').unwrap_or((text, ""));
    let role = match role {
        "viewer" => Some(Role::Viewer),
        "operator" => Some(Role::Operator),
        "admin" => Some(Role::Admin),
        _ => None,
    };
    role.filter(|_| !group.is_empty())
        .map(|role| (role, group.to_owned()))
        .ok_or_else(|| "must be viewer=GROUP, operator=GROUP or admin=GROUP".to_owned())
}
