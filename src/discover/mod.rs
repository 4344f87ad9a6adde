//! What the simulator gets wrong, by the angles of repose that a laboratory measured under recorded conditions.
//!
//! ```text
//! campaign.rs    what was measured, run by run, and under which conditions
//! catalogue.rs   the causes, and how strong each may have been in each run
//! signature.rs   from strengths to what the angles would show, up to its size
//! screen.rs      is anything wrong, and what explains it best
//! ```
//!
//! The calibrated simulator predicts one angle for a powder, whatever the day. Anything that a new calibration would absorb, a powder's own mean,
//! is therefore not looked at; what is left is judged by the evidence of each cause's signature in noise that has repeats, days, and days
//! that treat powders differently ([`mixed_model`](crate::stats::mixed_model)). The best of all causes is compared with the best that campaigns
//! of the same design have when nothing is wrong, so that many causes cost nothing in false alarms.
//!
//! Signatures are not simulated yet: a strength is taken to move every powder's angle in proportion, with deviations between powders.

pub mod campaign;
mod catalogue;
mod hypothesis;
mod investigate;
mod noise;
mod posterior;
pub mod report;
mod screen;
mod signature;

#[cfg(test)]
mod tests;

pub use campaign::repeats_of;
pub use campaign::{Campaign, Covariate, Run, Values};
pub use catalogue::{Family, Mechanism};
pub use hypothesis::{Cause, Responses, Untestable};
pub use investigate::investigate;
pub use posterior::Predicted;
pub use report::Report;
pub use screen::{Judged, Screening, Settings, screen};
