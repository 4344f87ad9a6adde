//! Real powders and their measured flowability.

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// How an angle of repose was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// By camera: funnel tip and pile apex located in depth images.
    Automated,
    /// By hand, after ISO 8398.
    Manual,
}

impl Method {
    /// The name used in JSON and the database.
    pub fn name(self) -> &'static str {
        match self {
            Self::Automated => "automated",
            Self::Manual => "manual",
        }
    }
}

/// A measured angle of repose: the mean of `n` repeats and their standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Flowability {
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// Number of repeats.
    pub n: u32,
}

impl Flowability {
    /// A checked measurement.
    ///
    /// # Errors
    /// An angle outside 5-85 deg, a negative or non-finite SD, or no repeats.
    pub fn new(repose_deg: f64, sd_deg: f64, n: u32) -> Result<Self, FieldError> {
        bounded("repose_deg", repose_deg, 5.0, 85.0, "deg")?;
        bounded("sd_deg", sd_deg, 0.0, 45.0, "deg")?;
        if !(1..=10_000).contains(&n) {
            return Err(FieldError::new("n", "must be from 1 to 10000 repeats"));
        }
        Ok(Self { repose_deg, sd_deg, n })
    }
}

/// A powder id: a lower-case letter, then up to 63 letters, digits or underscores.
///
/// # Errors
/// Any other text; `field` names where it stood.
pub fn powder_id(field: &str, text: &str) -> Result<String, FieldError> {
    let ok = text.len() <= 64
        && text.starts_with(|c: char| c.is_ascii_lowercase())
        && text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    match ok {
        true => Ok(text.to_owned()),
        false => Err(FieldError::new(field, "must be a lower-case letter followed by at most 63 of a-z, 0-9 and _")),
    }
}

/// One row of the published table.
#[derive(Debug, Clone, Copy)]
pub struct Published {
    /// Powder id.
    pub id: &'static str,
    /// Name for people.
    pub name: &'static str,
    /// By camera.
    pub automated: Flowability,
    /// By hand, ISO 8398.
    pub manual: Flowability,
}

const fn angle(repose_deg: f64, sd_deg: f64) -> Flowability {
    Flowability { repose_deg, sd_deg, n: 5 }
}

/// Where [`PUBLISHED`] comes from.
pub const PUBLISHED_SOURCE: &str =
    "arXiv:2506.03896, table of automated and manual (ISO 8398) angles of repose, five repeats each";

/// The published measurements, from the most to the least flowable as the paper lists them. Facts from [`PUBLISHED_SOURCE`].
pub const PUBLISHED: [Published; 5] = [
    Published { id: "sand", name: "Sand", automated: angle(28.55, 1.94), manual: angle(27.69, 2.54) },
    Published { id: "sugar", name: "Sugar", automated: angle(31.41, 1.42), manual: angle(30.93, 0.87) },
    Published { id: "salt", name: "Salt", automated: angle(36.03, 2.29), manual: angle(35.80, 1.71) },
    Published { id: "semolina", name: "Semolina", automated: angle(42.762, 1.97), manual: angle(40.91, 1.85) },
    Published {
        id: "sodium_bicarbonate",
        name: "Sodium bicarbonate",
        automated: angle(42.38, 2.48),
        manual: angle(43.14, 1.00),
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_measurements_are_refused_by_field() {
        let field = |r: Result<Flowability, FieldError>| r.unwrap_err().field;
        assert_eq!(field(Flowability::new(90.0, 1.0, 5)), "repose_deg");
        assert_eq!(field(Flowability::new(f64::NAN, 1.0, 5)), "repose_deg");
        assert_eq!(field(Flowability::new(30.0, -1.0, 5)), "sd_deg");
        assert_eq!(field(Flowability::new(30.0, 1.0, 0)), "n");
    }

    #[test]
    fn every_published_row_passes_its_own_checks() {
        for row in PUBLISHED {
            powder_id("id", row.id).unwrap();
            for m in [row.automated, row.manual] {
                assert_eq!(Flowability::new(m.repose_deg, m.sd_deg, m.n), Ok(m));
            }
        }
    }
}
