//! Vials and reservations of the bench.

use super::Timestamp;
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A person confirms that the vial of a weighing is in, and empty.
#[derive(Debug, Clone, PartialEq, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VialReadyRequest {
    /// Name of the person confirming.
    #[serde(default)]
    pub by: Option<String>,
    /// Label on the vial; if the weighing names a vial, it must match.
    #[serde(default)]
    pub vial: Option<String>,
}

request! { VialReadyRequest => app::VialReadyRequest { by, vial } }

/// A request to reserve the bench.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReservationRequest {
    /// Who reserves the bench.
    pub owner: String,
    /// Duration from now, s, 1 to 86400; the reservation then expires.
    pub seconds: u32,
    /// Your own reservation, to extend it.
    #[serde(default)]
    pub id: Option<String>,
}

request! { ReservationRequest => app::ReservationRequest { owner, seconds, id } }

/// A reservation: exclusive use of the bench.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Reservation {
    /// Id used in requests: `rs-…`.
    pub id: String,
    /// Who holds it.
    pub owner: String,
    /// When it expires.
    pub until: Timestamp,
}

answer! { flip_store::pan::Reservation => Reservation { id, owner, until } }

/// Whether a person must confirm that the vial is in place before a dose starts, on a bench that
/// cannot exchange vials.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum VialCheck {
    /// A person confirms, and the balance checks that the vial is a new one and empty.
    #[default]
    Confirm,
    /// No confirmation and no check: FLIP doses into whatever is on the pan.
    Skip,
}

answer! { flip_core::domain::vial::VialCheck => enum VialCheck { Confirm, Skip } }
request! { enum VialCheck => flip_core::domain::vial::VialCheck { Confirm, Skip } }

/// The vial on the pan, as far as is known.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Vial {
    /// Its name, if one was given.
    pub name: Option<String>,
    /// The weighing that last poured into the vial.
    pub weighing: String,
    /// Mass poured into it according to the display, mg; absent if unknown.
    pub holds_mg: Option<f64>,
    /// Start of the first dose into it.
    pub since: Timestamp,
}

answer! { flip_core::domain::vial::Vial => Vial { name, weighing, holds_mg, since } }
