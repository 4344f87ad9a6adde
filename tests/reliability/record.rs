//! The events of a weighing and its wire traffic, in one order, and whether anything is missing.

use flip_bench::hardware::wire::{Direction, Exchange};
use flip_bench::weigh::{Event, Phase};
use flip_core::domain::bench::Action;

/// One line of the record.
#[derive(Debug, Clone, PartialEq)]
pub enum Entry {
    Phase(Phase),
    /// A decision, the reading it was made on, and the mass in the vial then.
    Decision {
        allowed: Option<Action>,
        reading_mg: f64,
        vial_mg: f64,
    },
    Tick {
        step: u32,
    },
    Passed(Exchange),
    /// The fault began, with this mass in the vial.
    Injected {
        vial_mg: f64,
    },
}

/// The record of one weighing.
#[derive(Debug, Clone, Default)]
pub struct Record {
    pub entries: Vec<Entry>,
    reading_mg: f64,
}

impl Record {
    pub fn hear(&mut self, event: &Event<'_>, vial_mg: f64) {
        self.entries.push(match event {
            Event::Phase(phase) => Entry::Phase(*phase),
            // None of these doses is compared with an earlier one.
            Event::Pan(_) => return,
            Event::Decision(decision) => {
                Entry::Decision { allowed: decision.allowed, reading_mg: self.reading_mg, vial_mg }
            }
            Event::Tick(tick) => {
                self.reading_mg = tick.reading.mass_mg;
                Entry::Tick { step: tick.step }
            }
        });
    }

    pub fn phase(&self) -> Option<Phase> {
        self.entries.iter().rev().find_map(|entry| match entry {
            Entry::Phase(phase) => Some(*phase),
            _ => None,
        })
    }

    pub fn injected_at(&self) -> Option<usize> {
        self.entries.iter().position(|entry| matches!(entry, Entry::Injected { .. }))
    }

    pub fn ticks(&self) -> Vec<u32> {
        self.entries
            .iter()
            .filter_map(|entry| if let Entry::Tick { step } = entry { Some(*step) } else { None })
            .collect()
    }

    /// The first violation in the record.
    pub fn check(&self) -> Result<(), String> {
        self.phases_in_order()?;
        self.motions_decided()?;
        self.nothing_after_an_error()?;
        self.answers_complete()
    }

    fn phases_in_order(&self) -> Result<(), String> {
        let phases: Vec<Phase> = self
            .entries
            .iter()
            .filter_map(|it| if let Entry::Phase(phase) = it { Some(*phase) } else { None })
            .collect();
        let whole = [Phase::Armed, Phase::Dosing, Phase::Settling];
        let cut = [Phase::Armed, Phase::Settling];
        if !phases.is_empty() && phases != whole && phases != cut {
            return Err(format!("phases are {phases:?}"));
        }
        let ticks = self.ticks();
        let is_counted = ticks.iter().zip(0..).all(|(tick, n)| *tick == n);
        if is_counted { Ok(()) } else { Err(format!("ticks are {ticks:?}")) }
    }

    /// Powder moves only as decided, and after a halt only the way back is made.
    fn motions_decided(&self) -> Result<(), String> {
        let mut allowed: Option<Action> = None;
        let mut settling = false;
        let mut last = "";
        for entry in &self.entries {
            match entry {
                Entry::Decision { allowed: decided, .. } => allowed = *decided,
                Entry::Tick { .. } => allowed = None,
                Entry::Phase(phase) => (settling, allowed) = (*phase == Phase::Settling, None),
                Entry::Passed(it) if it.direction == Direction::Sent && it.device == "the arm" => {
                    let repeat = std::mem::replace(&mut last, &it.text) == it.text;
                    let pours = is_pouring(&it.text);
                    if pours && settling {
                        return Err(format!("{} after the end of dosing", it.text));
                    }
                    if pours && !repeat && allowed.is_none() {
                        return Err(format!("{} without a decision", it.text));
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Once the arm has answered with an error nothing pours any more, except one repeat under the
    /// same number.
    fn nothing_after_an_error(&self) -> Result<(), String> {
        let mut failed: Option<&str> = None;
        let mut last = "";
        for entry in &self.entries {
            let Entry::Passed(it) = entry else { continue };
            if it.device != "the arm" {
                continue;
            }
            match it.direction {
                Direction::Received if is_error(&it.text) => failed = Some(last),
                Direction::Received => {
                    // A repeat was answered, so the motion is known.
                    failed = failed.filter(|text| *text != last);
                }
                Direction::Sent => {
                    if failed.is_some_and(|text| text != it.text) && is_pouring(&it.text) {
                        return Err(format!("{} after an error of the arm", it.text));
                    }
                    last = &it.text;
                }
            }
        }
        Ok(())
    }

    /// Each call of the arm has its answer or its error before the next call; for the other
    /// devices, each answer follows a query.
    fn answers_complete(&self) -> Result<(), String> {
        let mut open: Option<&str> = None;
        let mut asked = Vec::new();
        for entry in &self.entries {
            let Entry::Passed(it) = entry else { continue };
            match (it.device.as_str(), it.direction) {
                ("the arm", Direction::Sent) => {
                    if let Some(text) = open.replace(&it.text) {
                        return Err(format!("{text} was never answered"));
                    }
                }
                ("the arm", Direction::Received) => {
                    open.take().ok_or_else(|| format!("{} answers nothing", it.text))?;
                }
                (device, Direction::Sent) => asked.push(device),
                (device, Direction::Received) if !asked.contains(&device) => {
                    return Err(format!("{device} said {} before it was asked", it.text));
                }
                _ => {}
            }
        }
        open.map_or(Ok(()), |text| Err(format!("{text} was never answered")))
    }
}

/// A command to the arm that may let powder fall.
pub fn is_pouring(text: &str) -> bool {
    text.contains("Shake by") || (text.contains("Pitch to") && !text.ends_with("Pitch to 0 deg"))
}

fn is_error(text: &str) -> bool {
    text.starts_with("the arm ") || text.starts_with("the connection to the arm ")
}
