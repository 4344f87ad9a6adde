//! When a training moves from one powder to the next.

use flip_policy::{Switch, SwitchReason};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// The published rule for advancing to the next level.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rule {
    /// Length of the error queue, K. Default 20.
    pub queue: u32,
    /// Advance when the mean of a full queue is below this, mg. Default 0.8.
    pub mean_mg: f64,
    /// Advance when the maximum of a full queue is below this, mg. Default 1.
    pub max_mg: f64,
    /// Otherwise advance after this many episodes on a level. Default 1330.
    pub episodes_max: u32,
}

impl Default for Rule {
    fn default() -> Self {
        Self { queue: 20, mean_mg: 0.8, max_mg: 1.0, episodes_max: 1330 }
    }
}

/// State of a training within its curriculum. Plain data: part of a checkpoint.
///
/// After each episode its error joins the queue (the oldest leaves when K are queued) and
///
/// ```text
/// K errors queued and (mean < 0.8 mg or max < 1 mg)   -> next level
/// otherwise, 1330 episodes on this level              -> next level
/// ```
///
/// On a move the queue and the counter are cleared; the last level never ends.
///
/// Source: the paper's prose. In its Algorithm 2 as printed the episode limit is tested only while
/// the queue is not full, so with K = 20 it could never trigger after 1330 episodes; here it is
/// tested after every episode.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Curriculum {
    rule: Rule,
    levels: u32,
    level: u32,
    queue: VecDeque<f64>,
    on_level: u32,
    episodes: u32,
    switches: Vec<Switch>,
}

impl Curriculum {
    /// Starts at the first of `levels` levels, with at most `level_episodes_max` episodes on each
    /// but the last.
    ///
    /// # Panics
    /// If there are no levels.
    pub fn new(levels: u32, rule: &Rule, level_episodes_max: u32) -> Self {
        assert!(levels > 0, "a curriculum needs a level");
        Self {
            rule: Rule { episodes_max: level_episodes_max, ..rule.clone() },
            levels,
            level: 0,
            queue: VecDeque::new(),
            on_level: 0,
            episodes: 0,
            switches: Vec::new(),
        }
    }

    /// Restarts at the first level, with at most `level_episodes_max` episodes on each but the
    /// last: the training has left the surrogate.
    pub fn begin_again(&mut self, level_episodes_max: u32) {
        if self.level > 0 {
            let reason = SwitchReason::Simulator;
            self.switches.push(Switch { episode: self.episodes, from: self.level, to: 0, reason });
        }
        self.rule.episodes_max = level_episodes_max;
        self.level = 0;
        self.queue.clear();
        self.on_level = 0;
    }

    /// The level of the next episode, from 0.
    pub fn level(&self) -> u32 {
        self.level
    }

    /// The moves so far.
    pub fn switches(&self) -> &[Switch] {
        &self.switches
    }

    /// Counts an episode that belongs to no level.
    pub fn pass(&mut self) {
        self.episodes += 1;
    }

    /// Counts an episode that ran on `level` with this absolute error, mg; returns the move it
    /// caused.
    ///
    /// Episodes are collected in rounds: one that began on an earlier level only counts as an
    /// episode. An error that is not a number is queued as the largest number.
    pub fn record(&mut self, level: u32, error_mg: f64) -> Option<&Switch> {
        self.episodes += 1;
        if level != self.level {
            return None;
        }
        self.on_level += 1;
        if self.queue.len() == self.rule.queue as usize {
            self.queue.pop_front();
        }
        self.queue.push_back(if error_mg.is_nan() { f64::MAX } else { error_mg });
        if self.level + 1 == self.levels {
            return None;
        }
        let reason = self.reason()?;
        self.switches.push(Switch {
            episode: self.episodes,
            from: self.level,
            to: self.level + 1,
            reason,
        });
        self.level += 1;
        self.queue.clear();
        self.on_level = 0;
        self.switches.last()
    }

    fn reason(&self) -> Option<SwitchReason> {
        if self.queue.len() == self.rule.queue as usize {
            if self.queue.iter().sum::<f64>() / (self.queue.len() as f64) < self.rule.mean_mg {
                return Some(SwitchReason::Mean);
            }
            if self.queue.iter().all(|&error| error < self.rule.max_mg) {
                return Some(SwitchReason::Maximum);
            }
        }
        (self.on_level >= self.rule.episodes_max).then_some(SwitchReason::TimeOut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curriculum_that_begins_again_has_its_levels_and_a_limit_of_its_own_before_it() {
        let mut curriculum = Curriculum::new(3, &Rule::default(), 4);
        let moves = |curriculum: &mut Curriculum, episodes| {
            (0..episodes).for_each(|_| _ = curriculum.record(curriculum.level(), 5.0));
            curriculum
                .switches()
                .iter()
                .map(|s| (s.episode, s.from, s.to, s.reason))
                .collect::<Vec<_>>()
        };
        moves(&mut curriculum, 10);
        curriculum.begin_again(2);
        let time_out = |episode, from| (episode, from, from + 1, SwitchReason::TimeOut);
        let back = (10, 2, 0, SwitchReason::Simulator);
        assert_eq!(
            moves(&mut curriculum, 9),
            [time_out(4, 0), time_out(8, 1), back, time_out(12, 0), time_out(14, 1)]
        );
    }

    /// The episodes at which a curriculum of three levels moves if the errors follow `error`.
    fn switches(episodes: u32, error: impl Fn(u32) -> f64) -> Vec<(u32, u32, SwitchReason)> {
        let mut curriculum = Curriculum::new(3, &Rule::default(), 1330);
        for k in 0..episodes {
            let level = curriculum.level();
            curriculum.record(level, error(k));
        }
        curriculum.switches().iter().map(|s| (s.episode, s.to, s.reason)).collect()
    }

    #[test]
    fn scripted_errors_move_the_level_when_the_paper_says() {
        use SwitchReason::{Maximum, Mean, TimeOut};
        // Good from the start: each level needs a full queue of its own, and the last never ends.
        assert_eq!(switches(100, |_| 0.5), [(20, 1, Mean), (40, 2, Mean)]);
        // Exactly 0.8 mg is not below the limit, but all 20 are below 1 mg.
        assert_eq!(switches(25, |_| 0.8), [(20, 1, Maximum)]);
        // A single 1 mg among 0.9 mg: neither rule applies until it has left the queue.
        assert_eq!(switches(25, |k| if k == 3 { 1.0 } else { 0.9 }), [(24, 1, Maximum)]);
        // One large error among small ones: the mean tolerates it.
        assert_eq!(switches(20, |k| if k == 3 { 9.0 } else { 0.3 }), [(20, 1, Mean)]);
        // Never good: the time-out, on the first two levels only.
        assert_eq!(switches(4000, |_| 5.0), [(1330, 1, TimeOut), (2660, 2, TimeOut)]);
        // Good only late: moves once two large errors are left among 20, before the time-out.
        assert_eq!(
            switches(1200, |k| if k < 1000 { 5.0 } else { 0.1 }),
            [(1018, 1, Mean), (1038, 2, Mean)]
        );
    }

    #[test]
    fn an_error_that_is_not_a_number_never_counts_as_good() {
        assert_eq!(
            switches(30, |k| if k == 0 { f64::NAN } else { 0.1 }),
            [(21, 1, SwitchReason::Mean)]
        );
        assert_eq!(switches(1329, |_| f64::NAN), []);
        assert_eq!(switches(1330, |_| f64::NAN), [(1330, 1, SwitchReason::TimeOut)]);
    }

    #[test]
    fn an_episode_that_began_on_an_earlier_level_is_not_queued() {
        let mut curriculum = Curriculum::new(2, &Rule { queue: 2, ..Rule::default() }, 100);
        curriculum.record(0, 0.1);
        assert!(curriculum.record(0, 0.1).is_some());
        curriculum.record(0, 0.1);
        assert_eq!(
            (curriculum.level(), curriculum.on_level, curriculum.queue.len(), curriculum.episodes),
            (1, 0, 0, 3)
        );
    }
}
