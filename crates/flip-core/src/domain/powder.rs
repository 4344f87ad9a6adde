//! Real powders and their measured flowability.

use super::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// How an angle of repose was measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// By camera: funnel tip and pile apex located in depth images.
    Automated,
    /// By hand, per ISO 8398.
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Flowability {
    /// Mean angle of repose, degrees.
    pub repose_deg: f64,
    /// Standard deviation over the repeats, degrees.
    pub sd_deg: f64,
    /// Number of repeats.
    pub n: u32,
}

impl Flowability {
    /// Creates a validated measurement.
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

    /// Summarises repeats: their mean, sample standard deviation (0 for a single one, which has no
    /// spread of its own) and count.
    ///
    /// # Errors
    /// No repeats or more than 10000; an angle outside 5-85 deg, as `field[position]`.
    pub fn of_repeats(field: &str, angles_deg: &[f64]) -> Result<Self, FieldError> {
        repeats(field, angles_deg)?;
        for (k, &angle) in angles_deg.iter().enumerate() {
            bounded(&format!("{field}[{k}]"), angle, 5.0, 85.0, "deg")?;
        }
        let (mean, sd) = mean_and_sd(angles_deg);
        // Rounding may carry the mean of equal repeats past a bound that each of them satisfies.
        Self::new(mean.clamp(5.0, 85.0), sd, angles_deg.len() as u32).map_err(|_| {
            FieldError::new(
                field,
                format!(
                    "spread by {sd} deg: repeats of one powder must have an SD from 0 to 45 deg"
                ),
            )
        })
    }

    /// Summarises heaps, one repeat each.
    ///
    /// # Errors
    /// As [`HeapReadings::angles_deg`] and [`Flowability::of_repeats`].
    pub fn of_heaps(heaps: &HeapReadings) -> Result<Self, FieldError> {
        Self::of_repeats("heights_mm", &heaps.angles_deg()?)
    }
}

/// Heaps that each cover a round base to its rim, as measured with a ruler or a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeapReadings<'a> {
    /// Height of each heap above its base, mm.
    pub heights_mm: &'a [f64],
    /// Diameter of the base, 5 to 500 mm: one for each heap, or one for all.
    pub base_diameters_mm: &'a [f64],
    /// Height of the funnel's tip above the base, 0.1 to 3000 mm, if known; no heap is higher.
    pub funnel_height_mm: Option<f64>,
}

impl HeapReadings<'_> {
    /// The angle of each heap, degrees.
    ///
    /// # Formula
    /// ```text
    /// AoR = atan(2 h / d)
    /// ```
    /// for a heap of height h on a fixed base of diameter d, as ISO 8398 measures it by hand and
    /// arXiv:2506.03896 by camera. The latter prints 2 h / d; its numbers are in degrees, so the
    /// arctangent is taken, as in the simulated experiment.
    ///
    /// # Errors
    /// No heaps or more than 10000; a number of diameters that does not match the heaps; a diameter
    /// or funnel outside its bounds; a height that is not positive, above the funnel, or with an
    /// angle outside 5-85 deg.
    pub fn angles_deg(&self) -> Result<Vec<f64>, FieldError> {
        let Self { heights_mm, base_diameters_mm, funnel_height_mm } = *self;
        repeats("heights_mm", heights_mm)?;
        let (heaps, bases) = (heights_mm.len(), base_diameters_mm.len());
        if bases != 1 && bases != heaps {
            let advice = format!(
                "must hold one diameter for each of the {heaps} heights, or one for all, got {bases}"
            );
            return Err(FieldError::new("base_diameters_mm", advice));
        }
        for (k, &diameter) in base_diameters_mm.iter().enumerate() {
            bounded(&format!("base_diameters_mm[{k}]"), diameter, 5.0, 500.0, "mm")?;
        }
        if let Some(funnel) = funnel_height_mm {
            bounded("funnel_height_mm", funnel, 0.1, 3000.0, "mm")?;
        }
        let bases = base_diameters_mm.iter().cycle();
        heights_mm
            .iter()
            .zip(bases)
            .enumerate()
            .map(|(k, (&h, &d))| heap_deg(k, h, d, funnel_height_mm))
            .collect()
    }
}

fn heap_deg(
    k: usize,
    height_mm: f64,
    diameter_mm: f64,
    funnel_mm: Option<f64>,
) -> Result<f64, FieldError> {
    let field = || format!("heights_mm[{k}]");
    if let Some(funnel) = funnel_mm.filter(|&funnel| height_mm > funnel) {
        let advice = format!(
            "must not be above the funnel's {funnel} mm, got {height_mm}: no heap rises past the tip"
        );
        return Err(FieldError::new(field(), advice));
    }
    let angle = (2.0 * height_mm / diameter_mm).atan().to_degrees();
    if !height_mm.is_finite() || !(5.0..=85.0).contains(&angle) {
        let [lower, upper] = [5.0_f64, 85.0].map(|deg| deg.to_radians().tan() * diameter_mm / 2.0);
        let advice = format!(
            "must be from {lower:.3} to {upper:.1} mm on a base of {diameter_mm} mm (an angle of 5 to 85 deg), got {height_mm}"
        );
        return Err(FieldError::new(field(), advice));
    }
    Ok(angle)
}

fn repeats(field: &str, values: &[f64]) -> Result<(), FieldError> {
    match values.len() {
        1..=10_000 => Ok(()),
        n => Err(FieldError::new(field, format!("must hold 1 to 10000 repeats, got {n}"))),
    }
}

/// Mean and sample standard deviation (divisor n - 1) of at least one value; the SD of a single
/// value is 0.
pub fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (mean, if n > 1.0 { (squares / (n - 1.0)).sqrt() } else { 0.0 })
}

/// Parses a powder id: a lower-case letter, then up to 63 letters, digits or underscores.
///
/// # Errors
/// Any other text; `field` is the name of the field it came from.
pub fn powder_id(field: &str, text: &str) -> Result<String, FieldError> {
    let ok = text.len() <= 64
        && text.starts_with(|c: char| c.is_ascii_lowercase())
        && text.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    match ok {
        true => Ok(text.to_owned()),
        false => Err(FieldError::new(
            field,
            "must be a lower-case letter followed by at most 63 of a-z, 0-9 and _",
        )),
    }
}

/// One row of the published table.
#[derive(Debug, Clone, Copy)]
pub struct Published {
    /// Powder id.
    pub id: &'static str,
    /// Display name.
    pub name: &'static str,
    /// By camera.
    pub automated: Flowability,
    /// By hand, per ISO 8398.
    pub manual: Flowability,
    /// Whether it dissolves in water that it takes up at a laboratory's humidity: salt from 75 %,
    /// sugar from 85 %. Quartz and starch do not, nor does hydrogen carbonate, which takes up water
    /// only above 85 %.
    pub soluble: bool,
}

/// Whether a powder dissolves in water that it takes up from the air: what was said of it, else
/// what is known of a published one.
pub fn is_soluble(powder: &str, said: Option<bool>) -> Option<bool> {
    said.or_else(|| PUBLISHED.iter().find(|row| row.id == powder).map(|row| row.soluble))
}

const fn angle(repose_deg: f64, sd_deg: f64) -> Flowability {
    Flowability { repose_deg, sd_deg, n: 5 }
}

/// Source of [`PUBLISHED`].
pub const PUBLISHED_SOURCE: &str = "arXiv:2506.03896, table of automated and manual (ISO 8398) angles of repose, five repeats each";

/// The published measurements, from the most to the least flowable, in the paper's order. Facts
/// from [`PUBLISHED_SOURCE`].
pub const PUBLISHED: [Published; 5] = [
    Published {
        id: "sand",
        name: "Sand",
        automated: angle(28.55, 1.94),
        manual: angle(27.69, 2.54),
        soluble: false,
    },
    Published {
        id: "sugar",
        name: "Sugar",
        automated: angle(31.41, 1.42),
        manual: angle(30.93, 0.87),
        soluble: true,
    },
    Published {
        id: "salt",
        name: "Salt",
        automated: angle(36.03, 2.29),
        manual: angle(35.80, 1.71),
        soluble: true,
    },
    Published {
        id: "semolina",
        name: "Semolina",
        automated: angle(42.762, 1.97),
        manual: angle(40.91, 1.85),
        soluble: false,
    },
    Published {
        id: "sodium_bicarbonate",
        name: "Sodium bicarbonate",
        automated: angle(42.38, 2.48),
        manual: angle(43.14, 1.00),
        soluble: false,
    },
];

/// Mean absolute error of the published robot by powder, mg, at 15 mg and at 20 mg. Its policy was
/// trained by curriculum; the powders were real. arXiv:2506.03896.
pub const PUBLISHED_DOSES: [(&str, [f64; 2]); 5] = [
    ("salt", [2.4, 2.4]),
    ("sugar", [1.6, 1.2]),
    ("sand", [1.6, 2.2]),
    ("sodium_bicarbonate", [3.6, 1.6]),
    ("semolina", [1.8, 2.8]),
];
/// The same over all powders and targets, as published: the mean and the number after the
/// plus-minus sign, mg.
pub const PUBLISHED_DOSES_OVERALL_MG: [f64; 2] = [2.12, 1.53];

/// The entry of [`PUBLISHED_DOSES`] for this powder and target, if any.
pub fn published_mae_mg(powder: &str, target_mg: f64) -> Option<f64> {
    let (_, errors) = PUBLISHED_DOSES.iter().find(|(id, _)| *id == powder)?;
    [15.0, 20.0].iter().position(|published| *published == target_mg).map(|k| errors[k])
}

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
    fn what_was_said_of_a_powder_counts_before_what_is_known() {
        assert_eq!(is_soluble("sand", None), Some(false));
        assert_eq!(is_soluble("salt", None), Some(true));
        assert_eq!(is_soluble("quartz", None), None);
        assert_eq!(is_soluble("sand", Some(true)), Some(true));
        assert_eq!(is_soluble("quartz", Some(false)), Some(false));
    }

    #[test]
    fn the_published_doses_have_their_published_mean_and_name_published_powders() {
        let errors: Vec<f64> = PUBLISHED_DOSES.iter().flat_map(|(_, errors)| *errors).collect();
        assert!((errors.iter().sum::<f64>() / 10.0 - PUBLISHED_DOSES_OVERALL_MG[0]).abs() < 1e-9);
        assert!(
            PUBLISHED_DOSES.iter().all(|(id, _)| PUBLISHED.iter().any(|powder| powder.id == *id))
        );
        assert_eq!(published_mae_mg("semolina", 20.0), Some(2.8));
        assert_eq!(
            (published_mae_mg("semolina", 10.0), published_mae_mg("flour", 15.0)),
            (None, None)
        );
    }

    #[test]
    fn repeats_become_their_mean_and_sample_sd() {
        let measured = Flowability::of_repeats("repeats_deg", &[30.0, 32.0, 34.0]).unwrap();
        assert_eq!(measured, Flowability { repose_deg: 32.0, sd_deg: 2.0, n: 3 });
        let single = Flowability::of_repeats("repeats_deg", &[30.0]).unwrap();
        assert_eq!(single, Flowability { repose_deg: 30.0, sd_deg: 0.0, n: 1 });
        assert_eq!(Flowability::of_repeats("repeats_deg", &[85.0; 7]).unwrap().repose_deg, 85.0);
    }

    #[test]
    fn impossible_repeats_are_refused_by_position() {
        let field =
            |angles: &[f64]| Flowability::of_repeats("repeats_deg", angles).unwrap_err().field;
        assert_eq!(field(&[]), "repeats_deg");
        assert_eq!(field(&[30.0; 10_001]), "repeats_deg");
        assert_eq!(field(&[30.0, 4.9]), "repeats_deg[1]");
        assert_eq!(field(&[30.0, 31.0, f64::NAN]), "repeats_deg[2]");
        assert_eq!(field(&[5.0, 85.0]), "repeats_deg", "an SD of 57 deg");
    }

    #[test]
    fn a_heap_as_high_as_its_base_is_wide_by_half_stands_at_45_degrees() {
        let of = |heights_mm: &[f64], base_diameters_mm: &[f64], funnel_height_mm| {
            Flowability::of_heaps(&HeapReadings { heights_mm, base_diameters_mm, funnel_height_mm })
        };
        let one = of(&[20.0], &[40.0], None).unwrap();
        assert!((one.repose_deg - 45.0).abs() < 1e-12 && one.n == 1);
        // tan 30 deg = 0.57735: the same angle on two bases has no spread.
        let two = of(
            &[28.867_513_459_481_29, 57.735_026_918_962_57],
            &[100.0, 200.0],
            Some(57.735_026_918_962_57),
        )
        .unwrap();
        assert!((two.repose_deg - 30.0).abs() < 1e-9 && two.sd_deg < 1e-9 && two.n == 2);
        assert_eq!(of(&[20.0; 3], &[40.0], None).unwrap().n, 3);
        let field =
            |heights: &[f64], bases: &[f64], funnel| of(heights, bases, funnel).unwrap_err().field;
        assert_eq!(field(&[], &[40.0], None), "heights_mm");
        assert_eq!(field(&[20.0; 3], &[40.0; 2], None), "base_diameters_mm");
        assert_eq!(field(&[20.0], &[], None), "base_diameters_mm");
        assert_eq!(field(&[20.0; 2], &[40.0, 0.0], None), "base_diameters_mm[1]");
        assert_eq!(field(&[20.0], &[40.0], Some(19.0)), "heights_mm[0]");
        assert_eq!(field(&[20.0], &[40.0], Some(0.0)), "funnel_height_mm");
        assert_eq!(field(&[20.0, 1.0], &[40.0], None), "heights_mm[1]", "2.9 deg");
        for height in [0.0, -20.0, 300.0, f64::NAN, f64::INFINITY] {
            assert_eq!(field(&[height], &[40.0], None), "heights_mm[0]", "{height}");
        }
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
