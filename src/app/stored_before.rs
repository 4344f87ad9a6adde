//! Which measurements of a file are stored already, with the same powder, values, source and day.

use super::measurement_csv::{Entry, Value};
use super::measurements::Measured;
use flip_core::domain::observable::Observation;
use flip_core::domain::powder::{Flowability, Method};
use std::collections::HashMap;

/// How often each one was stored.
pub(super) struct StoredBefore(HashMap<String, usize>);

impl StoredBefore {
    pub fn of(measured: &Measured) -> Self {
        let mut stored = HashMap::new();
        for it in &measured.measurements {
            let angle = Flowability { repose_deg: it.repose_deg, sd_deg: it.sd_deg, n: it.n };
            *stored
                .entry(key(&it.powder, &it.source, &it.measured_on, &angle_key(it.method, &angle)))
                .or_default() += 1;
        }
        for it in &measured.observations {
            let observed =
                Observation { observable: it.observable, mean: it.mean, sd: it.sd, n: it.n };
            *stored
                .entry(key(&it.powder, &it.source, &it.measured_on, &format!("{observed:?}")))
                .or_default() += 1;
        }
        Self(stored)
    }

    /// Whether it was stored. Each stored measurement matches one in the file: a duplicate in the
    /// file is stored twice.
    pub fn has(&mut self, entry: &Entry) -> bool {
        let value = match &entry.value {
            Value::Angle(method, angle) => angle_key(*method, angle),
            Value::Observed(observed) => format!("{observed:?}"),
        };
        let left = self
            .0
            .get_mut(&key(&entry.powder, &entry.origin.source, &entry.origin.measured_on, &value))
            .filter(|left| **left > 0);
        left.map(|left| *left -= 1).is_some()
    }
}

fn angle_key(method: Method, angle: &Flowability) -> String {
    format!("{method:?} {angle:?}")
}

/// Different numbers print differently, and no id or source contains a line break.
fn key(powder: &str, source: &str, day: &Option<String>, value: &str) -> String {
    format!("{powder}\n{source}\n{day:?}\n{value}")
}
