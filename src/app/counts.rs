//! Counts of jobs and weighings.

use super::{App, Result};
use flip_store::counts::Counts;

impl App {
    /// Number of jobs by kind and state, and of weighings by state and outcome.
    ///
    /// # Errors
    /// `Internal`
    pub async fn counts(&self) -> Result<Counts> {
        Ok(self.store().counts().await?)
    }
}
