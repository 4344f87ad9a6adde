//! Finds what the simulator gets wrong, from angles of repose and balance readings measured under
//! recorded conditions.
//!
//! ```text
//! campaign.rs     what was measured, run by run, and under which conditions
//! follows/        columns that follow from what was measured, and are left out
//! catalogue.rs    the causes, and how strong each may have been in each run
//! response.rs     what the simulator says of each cause
//! signature.rs    from strengths to what the angles would show, up to its size
//! hypothesis.rs   the causes, the covariates without a cause, and what nobody recorded
//! noise.rs        what angles do when nothing is wrong
//! screen.rs       is anything wrong, and what explains it best      null_check.rs  how often by chance
//! posterior.rs    one cause or two, and what that says of each run
//! effects.rs      how large, on which powders        law.rs         the law of what no cause explains
//! claim.rs        what of it may be claimed          sizes.rs       how far each powder is moved, in words
//! held_out.rs     what it is worth on other days     detectable.rs  what this design would have found
//! experiment.rs   what to measure next               scenario.rs    runs that nobody made
//! extension.rs    an extended simulator as data  extend.rs      from what was found to one
//! fit.rs          its amplitude by simulated heaps  numerics.rs    what is wrong without any data
//! investigate.rs  all of it, for angles              report.rs, words.rs   the document, and its sentences
//! flow.rs, scatter.rs   flow times, and how far repeats scatter    beside.rs   judged as angles are
//! traces/         the same for balance readings      channels.rs           all together
//! names.rs        plain names of causes and columns    reading.rs   how files were read
//! ```
//!
//! The calibrated simulator predicts one angle per powder, whatever the day. Anything a new
//! calibration would absorb (a powder's own mean) is therefore not judged. The rest is judged by
//! the evidence for each cause's signature in noise made of repeats, days, and days that treat
//! powders differently ([`mixed_model`](flip_core::stats::mixed_model)). The best of all causes is
//! compared with the best found in campaigns of the same design where nothing is wrong, so many
//! causes cost nothing in false alarms.
//!
//! Whether something is wrong depends on that comparison alone. The cause comes from the posterior
//! over models with one cause or two; a claimed cause holds 0.8 of it and has no look-alike. Its
//! worth is measured on days left out of the whole search.

/// Bumped when an investigation of the same campaign may produce a different report.
pub const VERSION: u32 = 5;

mod beside;
pub mod campaign;
mod catalogue;
mod channels;
mod claim;
mod detectable;
mod effects;
mod experiment;
mod extend;
pub mod extension;
mod fit;
mod flow;
mod follows;
mod held_out;
mod hypothesis;
mod investigate;
mod law;
pub mod names;
mod noise;
mod null_check;
pub mod numerics;
mod posterior;
pub mod reading;
pub mod report;
mod response;
mod scatter;
mod scenario;
mod screen;
mod signature;
mod sizes;
pub mod traces;
mod words;

#[cfg(test)]
mod tests;

pub use campaign::{Campaign, Covariate, Quantity, Run, Values};
pub use campaign::{LEVELS_MAX, repeats_of};
pub use catalogue::{Family, Mechanism};
pub use channels::investigate;
pub use claim::is_told;
pub use extend::extend;
pub use extension::{Extended, FitSet};
pub use fit::{FitHeap, fit};
pub use hypothesis::{Cause, Responses, Untestable};
pub use investigate::predict;
pub use posterior::Predicted;
pub use report::Report;
pub use response::responses;
pub use screen::{Judged, Screening, Settings, screen};
