//! Client for the arm that holds the spoon, which runs behind a driver process
//! (`proto/flip/bench/v1/arm.proto`).
//!
//! Calls are synchronous and return when the motion is complete. A separate thread with its own
//! connection renews the lease, so that the driver levels and retracts the spoon by itself if this
//! process dies. It stops renewing when the owner has not called for [`Deadlines::idle`], so that a
//! hung thread counts as dead too. Code that may have to stop the arm takes a [`Stopper`]
//! beforehand.
//!
//! After an error it is unknown whether the spoon moved. A motion that is not answered is stopped.
//! Then, as after any error, call [`Arm::retract`] or drop the arm.

mod background;
#[cfg(test)]
mod deadline_tests;
mod limits;
mod remote;
mod stopper;

pub use limits::Limits;
pub use proto::{Description, Executed, Mode, State, Station};
pub use stopper::Stopper;

/// Messages, servers and clients, generated from the contract.
#[expect(missing_docs, reason = "generated; the contract has the comments")]
pub mod proto {
    tonic::include_proto!("flip.bench.v1");
}

use super::DeviceError;
use super::wire::Tap;
use background::{Attended, Renewals, States, UNATTENDED};
use proto::arm_client::ArmClient;
use remote::{DEVICE, Remote, forbidden, latched, shortened};
use std::time::{Duration, Instant};
use tonic::transport::Channel;

/// Poll interval while the arm brings its spoon back.
const RETURNING_LOOK: Duration = Duration::from_millis(20);

/// Version of the contract implemented by this client.
pub const PROTOCOL_VERSION: u32 = 1;

/// Timeouts, in wall-clock time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deadlines {
    /// For calls that move nothing. Default 1 s.
    pub call: Duration,
    /// For motions. Default 30 s.
    pub motion: Duration,
    /// Interval between renewals. Default 50 ms; the contract requires at most 100.
    pub renewal: Duration,
    /// Renewals stop when the owner has not called for this long. Default 30 s.
    pub idle: Duration,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self {
            call: Duration::from_secs(1),
            motion: Duration::from_secs(30),
            renewal: Duration::from_millis(50),
            idle: Duration::from_secs(30),
        }
    }
}

/// An arm. Dropping it releases control, which levels and retracts the spoon.
pub struct Arm {
    remote: Remote,
    /// Used only for renewals.
    urgent: Remote,
    url: String,
    deadlines: Deadlines,
    description: Description,
    limits: Limits,
    states: States,
    attended: Attended,
    control: Option<Control>,
}

/// State kept while this client has control.
struct Control {
    lease_id: String,
    sequence: u64,
    renewals: Renewals,
    /// Set when a motion found the arm latched.
    latched: Option<DeviceError>,
}

impl Control {
    /// Why the lease is gone, if it is.
    fn ended(&self) -> Option<DeviceError> {
        self.latched.clone().or_else(|| self.renewals.ended())
    }
}

impl Arm {
    /// Connect to the driver at `url` (`http://host:port`) and request its description. Nothing
    /// moves, and nobody loses control.
    ///
    /// # Errors
    /// [`DeviceError::Lost`], [`DeviceError::Silent`]; [`DeviceError::Garbled`] for meaningless
    /// limits, [`DeviceError::Forbidden`] for another version of the contract.
    pub fn connect(url: &str, tap: Tap, deadlines: Deadlines) -> Result<Self, DeviceError> {
        let remote = Remote::connect(url, tap, deadlines.call)?;
        let (description, limits) = described(&remote, deadlines)?;
        let urgent = Remote::connect_first(url, deadlines.call)?;
        let states = States::watch(&remote);
        let attended = Attended::new(deadlines.idle);
        Ok(Self {
            remote,
            urgent,
            url: url.to_owned(),
            deadlines,
            description,
            limits,
            states,
            attended,
            control: None,
        })
    }

    /// The arm's description, as last received.
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// What the arm may be commanded to do: the narrower of its own limits and FLIP's.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Request the description again: the reason for which it is latched may have changed.
    ///
    /// # Errors
    /// As [`Arm::connect`].
    pub fn describe(&mut self) -> Result<&Description, DeviceError> {
        self.attended.now();
        (self.description, self.limits) = described(&self.remote, self.deadlines)?;
        Ok(&self.description)
    }

    /// The latest state sent by the arm. At rest it may be a tenth of a second old.
    ///
    /// # Errors
    /// [`DeviceError::Lost`] when none has arrived for a second.
    pub fn state(&self) -> Result<State, DeviceError> {
        self.attended.now();
        self.states.newest()
    }

    /// Signal that the owner is alive and waiting for something else; counts as a call.
    pub fn attend(&self) {
        self.attended.now();
    }

    /// A handle that stops the arm from any thread, on its own connection.
    ///
    /// # Errors
    /// [`DeviceError::Lost`]
    pub fn stopper(&self) -> Result<Stopper, DeviceError> {
        Stopper::connect(&self.remote, &self.url, self.deadlines.call)
    }

    /// Take control, and keep it until [`Arm::release`], drop, or a fault.
    ///
    /// # Errors
    /// [`DeviceError::Forbidden`] while another client has control, [`DeviceError::Latched`] while
    /// the arm is latched.
    pub fn acquire(&mut self) -> Result<(), DeviceError> {
        self.attended.now();
        if self.control.as_ref().is_some_and(|control| control.ended().is_none()) {
            return Ok(());
        }
        self.control = None;
        let request =
            proto::AcquireRequest { client: format!("flip, process {}", std::process::id()) };
        let call = |mut client: ArmClient<Channel>| async move { client.acquire(request).await };
        let lease = self.remote.ask("Acquire".to_owned(), self.deadlines.call, call);
        let lease = lease.map_err(|error| self.explained(error))?;
        let renewals =
            Renewals::start(&self.urgent, &lease.lease_id, self.deadlines.renewal, &self.attended);
        self.control =
            Some(Control { lease_id: lease.lease_id, sequence: 0, renewals, latched: None });
        Ok(())
    }

    /// Release control: the driver levels and retracts the spoon first. Does nothing without
    /// control.
    ///
    /// # Errors
    /// A device failed: the arm is latched, or its dead-man acts.
    pub fn release(&mut self) -> Result<(), DeviceError> {
        // Renewals go on until this returns; if the call never arrives, the dead-man acts once they
        // end.
        let Some(control) = self.control.take() else { return Ok(()) };
        self.attended.for_next(self.deadlines.motion);
        let request = proto::ReleaseRequest { lease_id: control.lease_id.clone() };
        let call = |mut client: ArmClient<Channel>| async move { client.release(request).await };
        let released = self.remote.ask("Release".to_owned(), self.deadlines.motion, call).map(drop);
        released.map_err(|error| self.explained(error))
    }

    /// Bring the level spoon over the vial.
    ///
    /// # Errors
    /// A device failed or must not do this; the spoon may be anywhere.
    pub fn approach(&mut self) -> Result<Executed, DeviceError> {
        self.fresh()?.motion("Approach", |mut client, ticket| async move {
            client.approach(proto::ApproachRequest { ticket: Some(ticket) }).await
        })
    }

    /// Level the spoon and move it away from the vial, from any position. The only motion that is
    /// also attempted when states no longer arrive.
    ///
    /// # Errors
    /// As [`Arm::approach`].
    pub fn retract(&mut self) -> Result<Executed, DeviceError> {
        self.motion("Retract", |mut client, ticket| async move {
            client.retract(proto::RetractRequest { ticket: Some(ticket) }).await
        })
    }

    /// Turn the spoon to this pitch, degrees, positive is tip down.
    ///
    /// # Errors
    /// As [`Arm::approach`]; [`DeviceError::Forbidden`], before anything is sent, for a pitch
    /// outside [`Limits`].
    pub fn pitch(&mut self, pitch_deg: f64) -> Result<Executed, DeviceError> {
        let pitch_deg = self.limits.pitch_deg(pitch_deg)?;
        self.fresh()?.motion(
            &format!("Pitch to {pitch_deg} deg"),
            move |mut client, ticket| async move {
                client.pitch(proto::PitchRequest { ticket: Some(ticket), pitch_deg }).await
            },
        )
    }

    /// Shake the spoon once, out by this amplitude and back, mm.
    ///
    /// # Errors
    /// As [`Arm::pitch`].
    pub fn shake(&mut self, amplitude_mm: f64) -> Result<Executed, DeviceError> {
        let amplitude_mm = self.limits.shake_mm(amplitude_mm)?;
        self.fresh()?.motion(
            &format!("Shake by {amplitude_mm} mm"),
            move |mut client, ticket| async move {
                client.shake(proto::ShakeRequest { ticket: Some(ticket), amplitude_mm }).await
            },
        )
    }

    /// Fill the retracted spoon from the powder's container and shake off the surplus there.
    ///
    /// # Errors
    /// As [`Arm::approach`].
    pub fn scoop(&mut self) -> Result<Executed, DeviceError> {
        self.fresh()?.motion("Scoop", |mut client, ticket| async move {
            client.scoop(proto::ScoopRequest { ticket: Some(ticket) }).await
        })
    }

    /// Return what is left in the retracted spoon to the container.
    ///
    /// # Errors
    /// As [`Arm::approach`].
    pub fn discard(&mut self) -> Result<Executed, DeviceError> {
        self.fresh()?.motion("Discard", |mut client, ticket| async move {
            client.discard(proto::DiscardRequest { ticket: Some(ticket) }).await
        })
    }

    /// Turn the filled platform over the funnel, for an angle of repose.
    ///
    /// # Errors
    /// As [`Arm::approach`].
    pub fn invert(&mut self) -> Result<Executed, DeviceError> {
        self.fresh()?.motion("Invert", |mut client, ticket| async move {
            client.invert(proto::InvertRequest { ticket: Some(ticket) }).await
        })
    }

    /// Clear the latch, on the word of `person`, who has checked the arm and confirms that it may
    /// move. It levels and retracts the spoon and can then be acquired again.
    ///
    /// # Errors
    /// The cause persists, or the motion failed: the arm stays latched.
    pub fn recover(&mut self, person: &str) -> Result<(), DeviceError> {
        self.attended.for_next(self.deadlines.motion);
        let request = proto::RecoverRequest { person: person.chars().take(100).collect() };
        let call = |mut client: ArmClient<Channel>| async move { client.recover(request).await };
        self.remote.ask(format!("Recover, says {person}"), self.deadlines.motion, call).map(drop)
    }

    /// For motions that require a current state of the arm.
    fn fresh(&mut self) -> Result<&mut Self, DeviceError> {
        self.states.newest()?;
        Ok(self)
    }

    /// Request a motion under the next sequence number. If the connection breaks, send the request
    /// once more under the same number: the driver repeats its answer and moves nothing twice.
    fn motion<F>(
        &mut self,
        what: &str,
        call: impl Fn(ArmClient<Channel>, proto::Ticket) -> F,
    ) -> Result<Executed, DeviceError>
    where
        F: Future<Output = Result<tonic::Response<Executed>, tonic::Status>> + Send + 'static,
    {
        let limit = self.deadlines.motion;
        self.attended.for_next(limit);
        let control = self
            .control
            .as_mut()
            .ok_or_else(|| forbidden("nobody has taken control: acquire the arm first"))?;
        if let Some(ended) = control.ended() {
            return Err(self.explained(ended));
        }
        control.sequence += 1;
        let deadline_ms = u32::try_from(limit.as_millis()).unwrap_or(u32::MAX);
        let ticket = proto::Ticket {
            lease_id: control.lease_id.clone(),
            sequence: control.sequence,
            deadline_ms,
        };
        let ask = || {
            let ticket = ticket.clone();
            self.remote
                .ask(format!("{} {what}", ticket.sequence), limit, |client| call(client, ticket))
        };
        let answer = match ask() {
            Err(DeviceError::Lost { .. }) => ask(),
            answer => answer,
        };
        let answer = answer.and_then(|executed| checked(executed, ticket.sequence));
        if let Err(
            DeviceError::Silent { .. } | DeviceError::Lost { .. } | DeviceError::Garbled { .. },
        ) = &answer
        {
            self.stop_unanswered();
        }
        self.attended.now();
        let answer = answer.map_err(|error| self.explained(error));
        if let (Some(control), Err(error @ DeviceError::Latched { .. })) =
            (&mut self.control, &answer)
        {
            control.latched = Some(error.clone());
        }
        answer
    }

    /// If the arm is latched, the reason why it refused or failed: more informative than that its
    /// lease has ended.
    fn explained(&self, error: DeviceError) -> DeviceError {
        if !matches!(error, DeviceError::Forbidden { .. } | DeviceError::Faulted { .. }) {
            return error;
        }
        let until = Instant::now() + self.deadlines.call;
        loop {
            let call = |mut client: ArmClient<Channel>| async move {
                client.describe(proto::DescribeRequest {}).await
            };
            match self.remote.ask("Describe".to_owned(), self.deadlines.call, call) {
                Ok(description) if !description.latch_cause.is_empty() => {
                    let cause = shortened(&description.latch_cause);
                    return match &error {
                        // The driver cannot know why renewals ended.
                        DeviceError::Forbidden { cause: ours, .. } if ours == UNATTENDED => {
                            latched(format!("{cause}; {ours}"))
                        }
                        _ => latched(cause),
                    };
                }
                // It brings the spoon back first, and only then is it latched or not.
                Ok(_) if self.is_returning() && Instant::now() < until => {
                    std::thread::sleep(RETURNING_LOOK)
                }
                _ => return error,
            }
        }
    }

    fn is_returning(&self) -> bool {
        self.states
            .newest()
            .is_ok_and(|state| matches!(state.mode(), Mode::Returning | Mode::Latched))
    }

    /// It is unknown whether the spoon still moves. After Stop it does not, and this lease can only
    /// bring it back.
    fn stop_unanswered(&self) {
        let request = proto::StopRequest { reason: "a motion was not answered".to_owned() };
        let call = |mut client: ArmClient<Channel>| async move { client.stop(request).await };
        // The tap records a failure; if the driver cannot be reached, the dead-man acts.
        let _ = self.remote.ask("Stop".to_owned(), self.deadlines.call, call);
    }
}

impl Drop for Arm {
    fn drop(&mut self) {
        // There is nobody left to report a failure to: the dead-man acts on it.
        let _ = self.release();
    }
}

fn described(remote: &Remote, deadlines: Deadlines) -> Result<(Description, Limits), DeviceError> {
    let call = |mut client: ArmClient<Channel>| async move {
        client.describe(proto::DescribeRequest {}).await
    };
    let description = remote.ask("Describe".to_owned(), deadlines.call, call)?;
    if description.protocol_version != PROTOCOL_VERSION {
        let theirs = description.protocol_version;
        return Err(forbidden(format!(
            "its driver speaks version {theirs} of the contract, FLIP {PROTOCOL_VERSION}"
        )));
    }
    let limits = Limits::narrowed(description.limits.as_ref())?;
    Ok((description, limits))
}

/// The answer, if its numbers are plausible for this motion.
pub fn checked(executed: Executed, sequence: u64) -> Result<Executed, DeviceError> {
    let lengths = [executed.amplitude_mm, executed.peak_speed_m_s, executed.duration_s];
    let sound = lengths.iter().all(|number| number.is_finite() && *number >= 0.0)
        && executed.pitch_deg.is_finite();
    if sound && executed.sequence == sequence {
        return Ok(executed);
    }
    Err(DeviceError::Garbled { device: DEVICE, got: format!("{executed:?}") })
}
