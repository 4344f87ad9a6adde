//! How long jobs took on this machine, for those that wait or are about to be requested.

use super::{App, Result};
use flip_core::stats::summary::quartiles;
use flip_store::jobs::Sort;
use serde::{Deserialize, Serialize};

/// Jobs of one sort that are looked back at: what ran long ago ran with other settings.
const LAST: usize = 50;

/// How long jobs of one sort took, those that succeeded at the first attempt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JobTimes {
    /// Which jobs.
    #[serde(flatten)]
    pub sort: Sort,
    /// How many of them: the last fifty at most.
    pub n: u32,
    /// First quartile, s.
    pub lower_s: f64,
    /// Median, s.
    pub median_s: f64,
    /// Third quartile, s.
    pub upper_s: f64,
}

impl App {
    /// How long jobs of each sort took; none of a sort of which none has succeeded.
    ///
    /// # Errors
    /// `Internal`
    pub async fn job_times(&self) -> Result<Vec<JobTimes>> {
        let mut sorts: Vec<(Sort, Vec<f64>)> = Vec::new();
        for (sort, seconds) in self.store().times_taken().await? {
            match sorts.iter_mut().find(|(known, _)| *known == sort) {
                Some((_, times)) if times.len() < LAST => times.push(seconds),
                Some(_) => {}
                None => sorts.push((sort, vec![seconds])),
            }
        }
        let of = |(sort, times): (Sort, Vec<f64>)| {
            let n = times.len() as u32;
            let [lower_s, median_s, upper_s] = quartiles(times)?;
            Some(JobTimes { sort, n, lower_s, median_s, upper_s })
        };
        Ok(sorts.into_iter().filter_map(of).collect())
    }
}
