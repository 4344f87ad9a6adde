//! How often as much is found when nothing is wrong.

use serde::{Deserialize, Serialize};

/// Campaigns of the same design with nothing wrong.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NullCheck {
    /// Number of campaigns this one was compared with; 0 where there was nothing to judge.
    pub campaigns: u32,
    /// The statistic of this campaign; absent where there was nothing to judge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub statistic: Option<f64>,
    /// Exceeded by one in twenty of them; absent where there was nothing to judge.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub threshold95: Option<f64>,
}

impl NullCheck {
    /// Summarises these simulated campaigns' statistics, ascending, and this one's. The largest
    /// statistic of no evidence is not a number.
    pub(crate) fn of(null: &[f64], statistic: f64) -> Self {
        let threshold95 = null.get((0.95 * null.len() as f64) as usize).copied();
        match threshold95.filter(|threshold| (statistic - threshold).is_finite()) {
            Some(_) => {
                Self { campaigns: null.len() as u32, statistic: Some(statistic), threshold95 }
            }
            None => Self { campaigns: 0, statistic: None, threshold95: None },
        }
    }

    /// Whether there was anything to judge.
    pub fn is_judged(&self) -> bool {
        self.statistic.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_statistic_of_nothing_is_absent_and_reads_back() {
        let none = NullCheck::of(&[f64::NEG_INFINITY; 99], f64::NEG_INFINITY);
        assert_eq!(none, NullCheck { campaigns: 0, statistic: None, threshold95: None });
        let document = serde_json::to_string(&none).unwrap();
        assert_eq!(document, "{\"campaigns\":0}");
        assert_eq!(serde_json::from_str::<NullCheck>(&document).unwrap(), none);
        // The form in earlier, unreadable documents.
        let old = "{\"campaigns\":99,\"statistic\":null,\"threshold95\":null}";
        assert_eq!(serde_json::from_str::<NullCheck>(old).unwrap().statistic, None);
        let null: Vec<f64> = (0..100).map(f64::from).collect();
        let some = NullCheck::of(&null, 3.5);
        assert_eq!(
            some,
            NullCheck { campaigns: 100, statistic: Some(3.5), threshold95: Some(95.0) }
        );
        assert!(some.is_judged() && !none.is_judged());
    }
}
