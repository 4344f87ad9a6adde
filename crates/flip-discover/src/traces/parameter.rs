//! What is estimated of a cause in balance readings.

use super::catalogue::TraceMechanism;
use super::level::Estimate;

/// A parameter of a cause, with its 95 % interval.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name.
    pub name: &'static str,
    /// Best guess.
    pub value: f64,
    /// Lower limit of 95 %.
    pub low95: f64,
    /// Upper limit of 95 %.
    pub high95: f64,
    /// Unit of all three.
    pub unit: &'static str,
}

pub(super) fn parameters(mechanism: TraceMechanism, estimate: &Estimate) -> Vec<Parameter> {
    let [size, shape] = mechanism.numbers();
    let of = |(name, unit): (&'static str, &'static str), [value, low95, high95]: [f64; 3]| {
        Parameter { name, value, low95, high95, unit }
    };
    let shape = estimate.shape().map(|numbers| of(shape, numbers));
    std::iter::once(of(size, estimate.size())).chain(shape).collect()
}
