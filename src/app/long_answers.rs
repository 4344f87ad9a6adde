//! Responses that grow with the whole history, produced batch by batch, so that none of them
//! occupies a reader or fills memory throughout.

use super::measurement_csv;
use super::{App, Result};
use futures::StreamExt;
use futures::stream::{self, BoxStream};

/// Start of the next batch: after this position in this part.
#[derive(Debug, Clone, Copy)]
enum Next {
    Measurements(i64),
    Observations(i64),
}

impl App {
    /// All measurements, as a file that [`App::import_measurements`] reads; optionally of one
    /// powder.
    ///
    /// # Errors
    /// `NotFound`
    pub async fn measured_csv(
        &self,
        powder: Option<String>,
    ) -> Result<BoxStream<'static, Result<String>>> {
        if let Some(powder) = &powder {
            self.existing_powder(powder).await?;
        }
        let app = self.clone();
        let rows = stream::try_unfold(Some(Next::Measurements(0)), move |next| {
            let (app, powder) = (app.clone(), powder.clone());
            async move {
                match next {
                    Some(next) => app.measured_after(powder.as_deref(), next).await.map(Some),
                    None => Ok(None),
                }
            }
        });
        Ok(rows.boxed())
    }

    /// One batch, and where the next one starts; the first includes the header.
    async fn measured_after(
        &self,
        powder: Option<&str>,
        next: Next,
    ) -> Result<(String, Option<Next>)> {
        let header = measurement_csv::write(&[], &[]).len();
        Ok(match next {
            Next::Measurements(after) => {
                let (found, last) = self.store().measurements_after(powder, after).await?;
                let next =
                    if found.is_empty() { Next::Observations(0) } else { Next::Measurements(last) };
                let text = measurement_csv::write(&found, &[]);
                (text[if after == 0 { 0 } else { header }..].to_owned(), Some(next))
            }
            Next::Observations(after) => {
                let (found, last) = self.store().observations_after(powder, after).await?;
                let next = (!found.is_empty()).then_some(Next::Observations(last));
                (measurement_csv::write(&[], &found)[header..].to_owned(), next)
            }
        })
    }
}
