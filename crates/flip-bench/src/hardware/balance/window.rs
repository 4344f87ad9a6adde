//! Is the display stable by FLIP's own criterion? For balances that never flag a reading stable.

use crate::hardware::settle::{Settling, Shown, settled};

/// Readings further apart than this do not belong together, s: something may have moved between
/// them.
const GAP_S_MAX: f64 = 2.0;
/// Number of readings kept: more than a window holds.
const READINGS_MAX: usize = 256;

/// Recent readings.
#[derive(Debug, Default)]
pub(super) struct Window {
    shown: Vec<Shown>,
    /// Any reading so far was flagged stable.
    flagged: bool,
    /// The display was stable at any time so far.
    stood: bool,
}

impl Window {
    /// Add one reading; returns whether the display is stable, in steps of `step_mg` or the
    /// balance's noise where that is larger.
    pub(super) fn hear(&mut self, one: Shown, step_mg: f64) -> bool {
        if self.shown.len() >= READINGS_MAX
            || self.shown.last().is_some_and(|last| one.t_s - last.t_s > GAP_S_MAX)
        {
            self.forget();
        }
        self.shown.push(one);
        let stands =
            settled(&Settling { lag_s: f64::NEG_INFINITY, ..Settling::new(step_mg) }, &self.shown)
                .is_some();
        self.flagged |= one.flag;
        self.stood |= stands;
        stands
    }

    /// Discard the readings: those that follow are unrelated to them.
    pub(super) fn forget(&mut self) {
        self.shown.clear();
    }

    /// Whether the display was stable although no reading was ever flagged stable.
    pub(super) fn stands_unflagged(&self) -> bool {
        self.stood && !self.flagged
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(t_s: f64, mass_mg: f64) -> Shown {
        Shown { t_s, mass_mg, flag: false }
    }

    #[test]
    fn a_display_that_stands_is_known_without_a_flag_and_one_that_moves_is_not() {
        let mut window = Window::default();
        let stood: Vec<bool> = (0..6)
            .map(|k| window.hear(shown(0.1 * f64::from(k), 5.0 + 0.1 * f64::from(k % 2)), 0.1))
            .collect();
        assert_eq!(stood, [false, false, false, false, true, true]);
        assert!(window.stands_unflagged());
        assert!(!window.hear(shown(0.6, 9.0), 0.1), "something fell");
        window.hear(Shown { flag: true, ..shown(0.7, 9.0) }, 0.1);
        assert!(!window.stands_unflagged());
    }

    #[test]
    fn readings_from_before_a_pause_do_not_count() {
        let mut window = Window::default();
        assert!((0..6).any(|k| window.hear(shown(0.1 * f64::from(k), 5.0), 0.1)));
        assert!(!window.hear(shown(10.0, 5.0), 0.1));
    }
}
