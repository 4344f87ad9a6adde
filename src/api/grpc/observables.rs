//! Observables, and observations in requests.

use super::convert::missing;
use super::proto;
use crate::api::problem::Problem;
use flip_core::domain::observable::{Observable, Observation};

impl From<Observable> for proto::Observable {
    fn from(ours: Observable) -> Self {
        use proto::observable::Kind;
        let kind = match ours {
            Observable::FlowTime { mass_g, orifice_mm } => {
                Kind::FlowTime(proto::FlowTime { mass_g, orifice_mm })
            }
            Observable::ShakeMass { pitch_deg, shake_mm } => {
                Kind::ShakeMass(proto::ShakeMass { pitch_deg, shake_mm })
            }
            Observable::DrainedAngle {} => Kind::DrainedAngle(proto::DrainedAngle {}),
            Observable::PileHeight { base_diameter_mm, fall_mm } => {
                Kind::PileHeight(proto::PileHeight { base_diameter_mm, fall_mm })
            }
        };
        Self { kind: Some(kind) }
    }
}

/// An observation in a request; `field` is its location in the request.
pub fn observation(field: &str, wire: proto::Observation) -> Result<Observation, Problem> {
    let proto::Observation { observable, mean, sd, n } = wire;
    let observable = observable.and_then(Into::into);
    let observable = observable.ok_or_else(|| missing(&format!("{field}.observable")))?;
    Ok(Observation { observable, mean, sd, n })
}

/// `None` if the caller named no observable, or one that this version does not know.
impl From<proto::Observable> for Option<Observable> {
    fn from(wire: proto::Observable) -> Self {
        use proto::observable::Kind;
        Some(match wire.kind? {
            Kind::FlowTime(proto::FlowTime { mass_g, orifice_mm }) => {
                Observable::FlowTime { mass_g, orifice_mm }
            }
            Kind::ShakeMass(proto::ShakeMass { pitch_deg, shake_mm }) => {
                Observable::ShakeMass { pitch_deg, shake_mm }
            }
            Kind::DrainedAngle(proto::DrainedAngle {}) => Observable::DrainedAngle {},
            Kind::PileHeight(proto::PileHeight { base_diameter_mm, fall_mm }) => {
                Observable::PileHeight { base_diameter_mm, fall_mm }
            }
        })
    }
}
