//! Lists of doses.

use super::{Asked, Labels, Tolerance, VialCheck, WeighingRequest, is_default};
use crate::app;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Doses that belong together: all of them are planned, or none.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DoseListRequest {
    /// Name of the list, a new one: 1 to 200 characters.
    pub name: String,
    /// The doses in order, 1 to 64; or `table`.
    #[serde(default)]
    pub doses: Vec<WeighingRequest>,
    /// The doses as a table with a header, copied from a spreadsheet or CSV. Columns: `powder` (id
    /// or name); `target_mg` or `target_g`; if wanted `tolerance_mg` or `tolerance_pct` for both
    /// sides, or `tolerance_lower_mg` and `tolerance_upper_mg`; `position`, `vial`, `lot`,
    /// `operator`; and `repeats`, for a row without a vial or a position.
    #[serde(default)]
    pub table: Option<String>,
    /// Of rows of the table that give none; default 1 mg on either side.
    #[serde(default)]
    pub tolerance: Option<Tolerance>,
    /// Of rows of the table that give none.
    #[serde(default)]
    pub operator: Option<String>,
    /// What a person confirmed before asking, for the rows of the table; at most 20.
    #[serde(default)]
    pub checked: Vec<String>,
    /// Policy of the rows of the table; default as for a weighing.
    #[serde(default)]
    pub policy: Option<String>,
    /// For the rows of the table.
    #[serde(default)]
    pub vial_check: VialCheck,
    /// The bench reservation under which the table is requested, if any.
    #[serde(default)]
    pub reservation: Option<String>,
    /// Only checks the list: nothing is stored, and nothing will move.
    #[serde(default)]
    pub check: bool,
    /// What the caller writes on every dose, to find them again.
    #[serde(default)]
    pub labels: Labels,
}

request! { DoseListRequest => app::DoseListRequest {
    name, doses, table, tolerance, operator, checked, policy, vial_check, reservation, check, labels,
} }

/// A list of doses as it was understood.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct DoseList {
    /// Its name.
    pub name: String,
    /// Its doses, in the order in which they are weighed.
    pub doses: Vec<ListedDose>,
}

answer! { app::DoseList => DoseList { name, doses } }

/// A dose of a list.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ListedDose {
    /// Its weighing; null if the list was only checked.
    pub weighing: Option<String>,
    /// Powder id.
    pub powder: String,
    /// Target mass, mg.
    pub target_mg: f64,
    /// Accepted shortfall, mg.
    pub tolerance_lower_mg: f64,
    /// Accepted excess, mg.
    pub tolerance_upper_mg: f64,
    /// Policy id.
    pub policy: String,
    /// Lot, vial, operator and position.
    #[serde(default, skip_serializing_if = "is_default")]
    pub asked: Asked,
}

answer! { app::ListedDose => ListedDose {
    weighing, powder, target_mg, tolerance_lower_mg, tolerance_upper_mg, policy, asked,
} }
