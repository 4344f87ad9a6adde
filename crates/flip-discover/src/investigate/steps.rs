//! Progress of an investigation, and the two ways in which it ends without a report.

use crate::worth::held_out::Stopped;
use flip_core::domain::FieldError;
use flip_core::domain::job::Progress;
use std::ops::ControlFlow;

/// Why there is no report.
pub(crate) enum Halt {
    /// A stop was requested.
    Stopped,
    /// What was measured cannot be judged.
    Refused(FieldError),
}

impl From<FieldError> for Halt {
    fn from(error: FieldError) -> Self {
        Self::Refused(error)
    }
}

impl From<Stopped> for Halt {
    fn from(_: Stopped) -> Self {
        Self::Stopped
    }
}

/// Tells a caller how far an investigation is, and hears whether to stop.
pub(crate) struct Steps<'a> {
    on_progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>,
    /// Share of the work done before the first of these steps.
    before: f64,
}

impl<'a> Steps<'a> {
    pub(crate) fn new(on_progress: &'a mut dyn FnMut(&Progress) -> ControlFlow<()>) -> Self {
        Self { on_progress, before: 0.0 }
    }

    /// The steps that are left once this share of the work is done.
    pub(crate) fn after(&mut self, before: f64) -> Steps<'_> {
        Steps { on_progress: self.on_progress, before }
    }

    /// Goes on with a step, at this share of what these steps are of.
    pub(crate) fn go_on(&mut self, share: f64, message: &str) -> ControlFlow<()> {
        let fraction = self.before + (1.0 - self.before) * share;
        (self.on_progress)(&Progress { fraction, message: message.to_owned() })
    }

    /// The same.
    ///
    /// # Errors
    /// A stop was requested.
    pub(crate) fn begin(&mut self, share: f64, message: &str) -> Result<(), Halt> {
        match self.go_on(share, message) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(Halt::Stopped),
        }
    }
}
