//! Two calibrations side by side: their costs, their results, and whether their sets give the same
//! angle of repose.

use super::{App, Calibration, Error, Result};
use crate::jobs::calibrate::{CalibrationResult, CalibrationSet, EmulatorUse, Method};
use flip_core::domain::parameters::{COUNT, PARAMETERS};
use flip_core::domain::powder::{Flowability, mean_and_sd};
use serde::{Deserialize, Serialize};

/// Two calibrations compared.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// The requested calibration.
    pub calibration: ComparedCalibration,
    /// The calibration it is compared with.
    pub with: ComparedCalibration,
    /// Mean verified angle of the first minus that of the second, degrees; absent if one of them
    /// has no sets.
    pub difference_deg: Option<f64>,
    /// Standard error of that difference, degrees: the root of the sum of both squared standard
    /// errors; absent if one of them is.
    pub standard_error_deg: Option<f64>,
    /// Whether the mean verified angles agree: their difference is at most two of its standard
    /// errors. Absent if unknown.
    pub agree: Option<bool>,
}

/// Target, cost and result of one calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ComparedCalibration {
    /// Id of the calibration.
    pub id: String,
    /// Powder id; absent for a bare angle.
    pub powder: Option<String>,
    /// Target.
    pub target: Flowability,
    /// Search method.
    pub method: Method,
    /// Simulations of the search, without those of a shared emulator.
    pub evaluations: u32,
    /// Simulations with fresh seeds to check candidates.
    pub verification_runs: u32,
    /// The emulator it used; absent with a method that has none.
    pub emulator: Option<EmulatorUse>,
    /// Number of its sets.
    pub sets: u32,
    /// Mean over the sets of |mean over fresh seeds - target|, degrees; absent without sets.
    pub verified_error_deg: Option<f64>,
    /// Standard deviation of that over the sets, degrees; absent for fewer than two.
    pub verified_sd_deg: Option<f64>,
    /// Mean of the sets' simulated angles, degrees; absent without sets.
    pub repose_deg: Option<f64>,
    /// Standard error of that mean, degrees: the root of the sum of the sets' squared standard
    /// errors over their number, where a set's is `repose_sd_deg` / sqrt(`runs`). Absent without
    /// sets, or if one of them ran only once, as its spread is then unknown.
    pub standard_error_deg: Option<f64>,
    /// Each parameter over the sets; empty without sets.
    pub parameters: Vec<ParameterSpread>,
}

/// One parameter over the sets of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ParameterSpread {
    /// Its key.
    pub key: String,
    /// Mean over the sets.
    pub mean: f64,
    /// Smallest value of a set.
    pub lower: f64,
    /// Largest value of a set.
    pub upper: f64,
}

impl App {
    /// Compares two calibrations that have succeeded.
    ///
    /// # Errors
    /// `NotFound` if one of them does not exist; `Conflict` (`calibration_unfinished`) while one
    /// has no result.
    pub async fn compare_calibrations(&self, id: &str, with: &str) -> Result<Comparison> {
        Ok(Comparison::of(side(self.calibration(id).await?)?, side(self.calibration(with).await?)?))
    }
}

impl Comparison {
    fn of(calibration: ComparedCalibration, with: ComparedCalibration) -> Self {
        let both = |a: Option<f64>, b: Option<f64>| Some((a?, b?));
        let difference_deg = both(calibration.repose_deg, with.repose_deg).map(|(a, b)| a - b);
        let standard_error_deg =
            both(calibration.standard_error_deg, with.standard_error_deg).map(|(a, b)| a.hypot(b));
        let agree = both(difference_deg, standard_error_deg)
            .map(|(difference, error)| difference.abs() <= 2.0 * error);
        Self { calibration, with, difference_deg, standard_error_deg, agree }
    }
}

fn side(calibration: Calibration) -> Result<ComparedCalibration> {
    let Calibration { job, powder, target, settings, result, .. } = calibration;
    let result: CalibrationResult = result.ok_or_else(|| {
        let advice = format!(
            "calibration {} has no result: only those that have succeeded can be compared",
            job.id
        );
        Error::conflict("calibration_unfinished", advice)
    })?;
    let method = settings.get("method").cloned().unwrap_or_default();
    let sets = &result.sets;
    let errors: Vec<f64> = sets.iter().filter_map(|set| set.verified_error_deg).collect();
    let (repose_deg, standard_error_deg) = mean_angle(sets);
    Ok(ComparedCalibration {
        id: job.id,
        powder,
        target,
        method: serde_json::from_value(method).map_err(|error| Error::Internal(error.into()))?,
        evaluations: result.evaluations,
        verification_runs: result.verification_runs,
        sets: sets.len() as u32,
        verified_error_deg: result.verified_error_deg,
        verified_sd_deg: (errors.len() > 1).then(|| mean_and_sd(&errors).1),
        repose_deg,
        standard_error_deg,
        parameters: spreads(sets),
        emulator: result.emulator,
    })
}

/// The mean simulated angle over the sets, and its standard error.
pub(super) fn mean_angle(sets: &[CalibrationSet]) -> (Option<f64>, Option<f64>) {
    let angles: Vec<f64> = sets.iter().map(|set| set.repose_deg).collect();
    ((!angles.is_empty()).then(|| mean_and_sd(&angles).0), standard_error_deg(sets))
}

/// Standard error of the mean angle over the sets, each of which is the mean of its own runs.
fn standard_error_deg(sets: &[CalibrationSet]) -> Option<f64> {
    if sets.is_empty() {
        return None;
    }
    let variance = |set: &CalibrationSet| Some(set.repose_sd_deg?.powi(2) / f64::from(set.runs));
    let sum: f64 = sets.iter().map(variance).sum::<Option<f64>>()?;
    Some(sum.sqrt() / sets.len() as f64)
}

fn spreads(sets: &[CalibrationSet]) -> Vec<ParameterSpread> {
    if sets.is_empty() {
        return Vec::new();
    }
    let spread = |k: usize| {
        let values: Vec<f64> = sets.iter().map(|set| set.parameters.values()[k]).collect();
        ParameterSpread {
            key: PARAMETERS[k].key.to_owned(),
            mean: mean_and_sd(&values).0,
            lower: values.iter().copied().fold(f64::INFINITY, f64::min),
            upper: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    };
    (0..COUNT).map(spread).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use flip_core::domain::parameters::ParameterSet;

    fn set(
        repose_deg: f64,
        repose_sd_deg: Option<f64>,
        runs: u32,
        friction: f64,
    ) -> CalibrationSet {
        let mut values = ParameterSet::default().values();
        values[4] = friction;
        let parameters = ParameterSet::new(values).unwrap();
        let (id, error) = (parameters.id(), (repose_deg - 30.0).abs());
        CalibrationSet {
            id,
            parameters,
            repose_deg,
            repose_sd_deg,
            runs,
            error_deg: error,
            verified_error_deg: Some(error),
        }
    }

    fn compared(sets: &[CalibrationSet]) -> ComparedCalibration {
        ComparedCalibration {
            id: "c".into(),
            powder: None,
            target: Flowability { repose_deg: 30.0, sd_deg: 0.0, n: 1 },
            method: Method::Sequential,
            evaluations: 1,
            verification_runs: 1,
            emulator: None,
            sets: sets.len() as u32,
            verified_error_deg: None,
            verified_sd_deg: None,
            repose_deg: Some(
                sets.iter().map(|set| set.repose_deg).sum::<f64>() / sets.len() as f64,
            ),
            standard_error_deg: standard_error_deg(sets),
            parameters: spreads(sets),
        }
    }

    #[test]
    fn two_sets_of_equal_error_halve_its_square() {
        // 2 / sqrt(4) = 1 for each set, so 1 / sqrt(2) for the mean of two.
        let sets = [set(30.0, Some(2.0), 4, 0.2), set(31.0, Some(2.0), 4, 0.6)];
        assert!((standard_error_deg(&sets).unwrap() - 0.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(standard_error_deg(&[]), None);
        assert_eq!(
            standard_error_deg(&[set(30.0, Some(2.0), 4, 0.2), set(30.0, None, 1, 0.2)]),
            None
        );
        let friction = &spreads(&sets)[4];
        assert_eq!((friction.key.as_str(), friction.lower, friction.upper), ("friction", 0.2, 0.6));
        assert!((friction.mean - 0.4).abs() < 1e-12);
    }

    #[test]
    fn angles_agree_within_two_joint_standard_errors() {
        // Joint standard error: sqrt(0.3^2 + 0.4^2) = 0.5.
        let at = |angle: f64, error: Option<f64>| compared(&[set(angle, error, 1, 0.2)]);
        let agree = |angle| Comparison::of(at(30.0, Some(0.3)), at(angle, Some(0.4))).agree;
        assert_eq!(
            [agree(30.99), agree(31.01), agree(29.01), agree(28.99)],
            [true, false, true, false].map(Some)
        );
        let unknown = Comparison::of(at(30.0, None), at(30.0, Some(0.4)));
        assert_eq!(
            (unknown.difference_deg, unknown.standard_error_deg, unknown.agree),
            (Some(0.0), None, None)
        );
    }
}
