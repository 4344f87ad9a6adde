//! Units that a request may name; the document alone uses these types.

use utoipa::ToSchema;

/// Unit of a mass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "snake_case")]
pub enum MassUnit {
    /// Milligrams.
    Mg,
    /// Grams.
    G,
}

/// Unit of a tolerance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[schema(rename_all = "snake_case")]
pub enum ToleranceUnit {
    /// Milligrams.
    Mg,
    /// Grams.
    G,
    /// Per cent of the target.
    #[schema(rename = "%")]
    Percent,
}
