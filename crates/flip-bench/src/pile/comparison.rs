//! Automated versus manual: the paper's table, from stored measurements.

use flip_core::domain::powder::{Flowability, Method, PUBLISHED};
use serde::{Deserialize, Serialize};

/// A measurement as it is stored.
#[derive(Debug, Clone, PartialEq)]
pub struct Stored {
    /// Powder id.
    pub powder: String,
    /// By camera or by hand.
    pub method: Method,
    /// Mean, standard deviation, repeats.
    pub flowability: Flowability,
}

/// One powder measured both ways.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Powder id.
    pub powder: String,
    /// By camera.
    pub automated: Flowability,
    /// By hand.
    pub manual: Flowability,
    /// Automated minus manual, degrees.
    pub difference_deg: f64,
    /// Standard error of the difference, degrees; absent where a single repeat gives no spread.
    pub standard_error_deg: Option<f64>,
}

/// Compare every powder that was measured both ways, in the order of first measurement; the last
/// measurement by each method counts.
///
/// ```text
/// difference = mean_a - mean_m        SE^2 = sd_a^2 / n_a + sd_m^2 / n_m
/// ```
pub fn compare(stored: &[Stored]) -> Vec<Compared> {
    let mut powders: Vec<&str> = Vec::new();
    for one in stored {
        if !powders.contains(&one.powder.as_str()) {
            powders.push(&one.powder);
        }
    }
    let newest = |powder: &str, method: Method| {
        stored
            .iter()
            .rev()
            .find(|one| one.powder == powder && one.method == method)
            .map(|one| one.flowability)
    };
    let both = |powder: &str| {
        let (automated, manual) =
            (newest(powder, Method::Automated)?, newest(powder, Method::Manual)?);
        let variance = |f: Flowability| (f.n > 1).then(|| f.sd_deg * f.sd_deg / f64::from(f.n));
        let standard_error_deg =
            variance(automated).zip(variance(manual)).map(|(a, m)| (a + m).sqrt());
        let difference_deg = automated.repose_deg - manual.repose_deg;
        Some(Compared {
            powder: powder.to_owned(),
            automated,
            manual,
            difference_deg,
            standard_error_deg,
        })
    };
    powders.into_iter().filter_map(both).collect()
}

/// The published measurements as stored ones.
pub fn published() -> Vec<Stored> {
    let rows = PUBLISHED
        .iter()
        .flat_map(|p| [(p.id, Method::Automated, p.automated), (p.id, Method::Manual, p.manual)]);
    rows.map(|(powder, method, flowability)| Stored {
        powder: powder.to_owned(),
        method,
        flowability,
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Differences of the published means, and their standard errors computed by hand:
    /// sqrt((sd_a^2 + sd_m^2) / 5).
    #[test]
    fn the_published_table_comes_out() {
        let table = compare(&published());
        let expected = [
            ("sand", 0.86, 1.429),
            ("sugar", 0.48, 0.745),
            ("salt", 0.23, 1.278),
            ("semolina", 1.852, 1.209),
            ("sodium_bicarbonate", -0.76, 1.196),
        ];
        assert_eq!(table.len(), expected.len());
        for (row, (powder, difference, error)) in table.iter().zip(expected) {
            assert_eq!(row.powder, powder);
            assert!((row.difference_deg - difference).abs() < 1e-9, "{row:?}");
            assert!((row.standard_error_deg.unwrap() - error).abs() < 5e-4, "{row:?}");
        }
    }

    #[test]
    fn the_newest_counts_and_one_method_alone_makes_no_row() {
        let one = |powder: &str, method, deg, n| Stored {
            powder: powder.into(),
            method,
            flowability: Flowability::new(deg, 0.0, n).unwrap(),
        };
        let stored = [
            one("flour", Method::Manual, 50.0, 5),
            one("salt", Method::Automated, 35.0, 5),
            one("salt", Method::Manual, 36.0, 1),
            one("salt", Method::Automated, 37.0, 5),
        ];
        let table = compare(&stored);
        assert_eq!(table.len(), 1);
        assert_eq!((table[0].difference_deg, table[0].standard_error_deg), (1.0, None));
    }
}
