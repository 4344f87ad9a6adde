//! API tokens.

use super::{App, Result};
use crate::store::tokens::Role;

impl App {
    /// Make a token and return its secret, which is shown once and not stored.
    pub async fn create_token(&self, _name: &str, _role: Role) -> Result<String> {
        self.stub()
    }

    /// The role of a token's holder; `None` when the secret belongs to no token.
    pub async fn authenticate(&self, _secret: &str) -> Result<Option<Role>> {
        self.stub()
    }

    /// Whether any token exists: the first start prints one.
    pub async fn has_tokens(&self) -> Result<bool> {
        self.stub()
    }
}
