//! Pure numerics used by calibration, evaluation and discovery: no I/O, no clock, randomness only
//! from a generator or a seed that the caller passes.
//!
//! | file | answers |
//! |------|---------|
//! | [`normal`] | density, distribution and quantile of the standard normal |
//! | [`summary`] | mean, spread, standard error, bootstrap interval, spread within cells |
//! | [`latin_hypercube`] | where to look first in a box |
//! | [`gaussian_process`] | what a noisy function probably is between the points where it was evaluated |
//! | [`mixed_model`] | how well signatures explain observations whose noise has days and repeats |
//! | [`minimise`] | where a smooth function of few variables is least |

pub mod gaussian_process;
pub mod latin_hypercube;
pub mod minimise;
pub mod mixed_model;
pub mod normal;
pub mod summary;
