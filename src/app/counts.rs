//! How much there is of what.

use super::{App, Result};
use flip_store::counts::Counts;

impl App {
    /// Jobs by kind and state, weighings by state and outcome.
    ///
    /// # Errors
    /// `Internal`
    pub async fn counts(&self) -> Result<Counts> {
        Ok(self.store().counts().await?)
    }
}
