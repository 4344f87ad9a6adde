//! Finds what the simulator gets wrong, from angles of repose and balance readings measured under
//! recorded conditions.
//!
//! Each folder is a room. A room may name those above it in this list and none below:
//!
//! ```text
//! thresholds.rs   every number at which a decision turns, with its reason
//! data/           campaign: what was measured, run by run, under which conditions     reading: how files were read
//!                 flow: the times of flow as a campaign                               scenario: runs that nobody made
//! report/         the document and its parts, the plain names and sizes in it, and what prints as zero
//! causes/         follows: columns that follow from what was measured                 catalogue: the causes and their forms
//!                 signature: what the angles would show of each, up to its size       response: what the simulator says of each
//!                 hypothesis: causes, covariates without one, what nobody recorded    hook: where a cause enters the simulator
//! judge/          noise: what angles do when nothing is wrong                         prepared: evidence of each hypothesis
//!                 screen: is anything wrong                                           posterior: one cause or two
//!                 verdict: what is proposed                                           claim: what of it may be claimed
//! worth/          effects: how large, on which powders                                law: of what no cause explains
//!                 held_out: its worth on other days                                   detectable: what this design would have found
//!                 experiment: what to measure next
//! extend/         extension: an extended simulator as data                            claimed: from what was found to one
//!                 fit: its amplitude by simulated heaps
//! traces/         the same for balance readings of weighings
//! spoon/          the same for what spoons let fall, against replays by the simulator
//! investigate/    all of it, channel by channel, into one document, and its sentences
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

mod causes;
mod data;
mod extend;
mod investigate;
mod judge;
pub mod report;
pub mod spoon;
mod thresholds;
pub mod traces;
mod worth;

pub use causes::catalogue::{Family, Mechanism};
pub use causes::hypothesis::{Cause, Untestable};
pub use causes::response::{Responses, responses};
pub use data::campaign::{self, Campaign, Covariate, Quantity, Run, Values, repeats_of};
pub use data::reading;
pub use extend::claimed::extend;
pub use extend::extension::{self, Extended, FitSet};
pub use extend::fit::{FitHeap, fit};
pub use investigate::angles::predict;
pub use investigate::{Measured, investigate, numerics};
pub use judge::posterior::Predicted;
pub use judge::screen::{Judged, Screening, Settings, screen};
pub use report::printed::is_told;
pub use report::{Report, names};
pub use thresholds::LEVELS_MAX;
