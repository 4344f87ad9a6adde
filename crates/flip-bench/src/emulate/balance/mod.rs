//! An emulated balance: the four dialects over a pseudo-terminal or TCP, on top of a [`Pan`].
//!
//! It measures a frame every `frame_s`: the load cell follows the pan exponentially, noise and
//! wander are added, and the sum is rounded to the display step. The wander models what air,
//! temperature and the table do to a balance within seconds, as a stationary Ornstein-Uhlenbeck
//! process:
//!
//! ```text
//! x(t + dt) = a x(t) + wander sqrt(1 - a^2) N(0, 1)          a = exp(-dt / wander_s)
//! ```
//!
//! Noise and wander together are fitted to an enclosed balance's readings with nothing moving (A&D
//! HR-100A in the data pack, 578 s): root mean square of the difference of two readings 0.20, 0.33,
//! 0.46 and 0.6 to 0.7 mg over 0.3, 1, 2 and 4 s, here 0.21, 0.31, 0.40 and 0.51. Over a minute
//! that balance crept by another 1.7 to 4.6 mg, which is not modelled here, except as
//! [`Fault::Drift`]. `cargo experiment display_life` prints both. The stable flag is set when the load
//! was at rest for 1.5 to 2.3 s, as on the balance whose step responses are in the data pack.
//! Commands wait for a stable reading, and fail in the dialect's way when none comes. Under a
//! virtual clock, equal requests get equal replies.

mod aandd;
mod cell;
mod fault;
mod mt_sics;
mod ohaus;
mod request;
mod sbi;
mod talk;
#[cfg(test)]
mod tests;

pub use fault::Fault;

use super::pan::Pan;
use super::port::Port;
use crate::hardware::balance::value::Unit;
use crate::hardware::balance::{self as driver, Dialect};
use cell::Cell;
use fault::Faults;
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use talk::Conversation;

/// From power-on to the first reply, s of bench time: less than most motions, so that no request
/// need be lost.
const RESTART_S: f64 = 0.1;

/// Settings of an emulated balance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Its dialect. Default MT-SICS.
    pub dialect: Dialect,
    /// Step of the display, mg. Default 1.
    pub readability_mg: f64,
    /// Unit of the display. Default g.
    pub unit: Unit,
    /// Capacity, mg. Default 220 000.
    pub capacity_mg: f64,
    /// SD of one frame's noise, mg. Default 0.1 (measured, enclosed: 0.08-0.15).
    pub noise_mg: f64,
    /// SD of the wander, mg. Default 0.5.
    pub wander_mg: f64,
    /// Correlation time of the wander, s. Default 6.
    pub wander_s: f64,
    /// Time constant of the load cell, s. Default 0.16 (measured, 28 steps).
    pub settling_tau_s: f64,
    /// Frame interval, s. Default 0.19 (measured).
    pub frame_s: f64,
    /// The stable flag is set when the load was at rest for a time between these, s. Default 1.5
    /// and 2.3 (measured).
    pub flag_after_s: [f64; 2],
    /// How long commands wait for a stable reading, s of bench time. Default 40.
    pub stable_timeout_s: f64,
    /// Delay of a reply under [`Fault::SlowReply`], wall-clock ms. Default 3000.
    pub slow_reply_ms: u64,
    /// Seed of the noise and of the flag's timing. Default 0.
    pub seed: u64,
}

impl Settings {
    /// FLIP's settings for this balance at an address.
    pub fn found_at(&self, address: &str) -> driver::Settings {
        let readability_mg = Some(self.readability_mg);
        driver::Settings { readability_mg, ..driver::Settings::new(self.dialect, address) }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            dialect: Dialect::MtSics,
            readability_mg: 1.0,
            unit: Unit::Gram,
            capacity_mg: 220_000.0,
            noise_mg: 0.1,
            wander_mg: 0.5,
            wander_s: 6.0,
            settling_tau_s: 0.16,
            frame_s: 0.19,
            flag_after_s: [1.5, 2.3],
            stable_timeout_s: 40.0,
            slow_reply_ms: 3000,
            seed: 0,
        }
    }
}

impl Settings {
    /// Returns the settings if they are valid for a balance.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        bounded("readability_mg", self.readability_mg, 0.001, 10_000.0, "mg")?;
        bounded("capacity_mg", self.capacity_mg, 1000.0, 1e8, "mg")?;
        bounded("noise_mg", self.noise_mg, 0.0, 1000.0, "mg")?;
        bounded("wander_mg", self.wander_mg, 0.0, 1000.0, "mg")?;
        bounded("wander_s", self.wander_s, 0.1, 3600.0, "s")?;
        bounded("settling_tau_s", self.settling_tau_s, 0.001, 10.0, "s")?;
        bounded("frame_s", self.frame_s, 0.01, 10.0, "s")?;
        bounded("flag_after_s", self.flag_after_s[0], 0.0, self.flag_after_s[1], "s")?;
        bounded("flag_after_s", self.flag_after_s[1], self.flag_after_s[0], 60.0, "s")?;
        bounded("stable_timeout_s", self.stable_timeout_s, 0.1, 600.0, "s")?;
        Ok(self)
    }
}

/// How an emulated balance is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Socket {
    /// A new pseudo-terminal.
    Pty,
    /// A TCP port; 0 picks a free one.
    Tcp(SocketAddr),
}

/// State shared by the conversation and the handle.
struct Shared {
    settings: Settings,
    pan: Pan,
    cell: Mutex<Cell>,
    faults: Mutex<Faults>,
    /// Bench time at which a balance that was powered on is ready.
    rises_s: Mutex<Option<f64>>,
    closing: AtomicBool,
}

impl Shared {
    fn cell(&self) -> MutexGuard<'_, Cell> {
        self.cell.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn faults(&self) -> MutexGuard<'_, Faults> {
        self.faults.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn rises(&self) -> MutexGuard<'_, Option<f64>> {
        self.rises_s.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether it is powering up: it neither receives nor sends anything.
    fn is_down(&self) -> bool {
        self.rises().is_some_and(|rises_s| self.pan.clock().now_s() < rises_s)
    }

    fn has(&self, fault: Fault) -> bool {
        self.faults().has(fault)
    }
}

/// A running emulated balance; it is unplugged when this is dropped.
pub struct Balance {
    shared: Arc<Shared>,
    port: Port,
    socket: Socket,
    /// Load on the pan before it was lifted, mg.
    lifted_mg: f64,
}

impl Balance {
    /// Connect it on top of this pan.
    ///
    /// # Errors
    /// The pseudo-terminal or the port is not available.
    pub fn start(settings: Settings, pan: Pan, socket: Socket) -> std::io::Result<Self> {
        let cell = Mutex::new(Cell::new(settings.clone(), pan.clone()));
        let shared = Arc::new(Shared {
            settings,
            pan,
            cell,
            faults: Mutex::default(),
            rises_s: Mutex::default(),
            closing: AtomicBool::new(false),
        });
        let port = serve(&shared, socket)?;
        Ok(Self { shared, port, socket, lifted_mg: 0.0 })
    }

    /// The address a driver opens.
    pub fn address(&self) -> &str {
        self.port.address()
    }

    /// The pan under it.
    pub fn pan(&self) -> &Pan {
        &self.shared.pan
    }

    /// Current tare, mg.
    pub fn tare_mg(&self) -> f64 {
        self.shared.cell().tare_mg()
    }

    /// Inject this fault.
    pub fn inject(&mut self, fault: Fault) {
        self.begin(fault, None);
    }

    /// Inject this fault for the next `answers` replies; one-off faults happen once.
    pub fn inject_for(&mut self, fault: Fault, answers: u32) {
        self.begin(fault, Some(answers));
    }

    /// Clear all faults; a lifted vial is put back. A pulled plug stays out.
    pub fn clear(&mut self) {
        self.shared.faults().clear();
        self.shared.cell().end_faults();
        self.shared.pan.add_mg(std::mem::take(&mut self.lifted_mg));
    }

    /// Reconnect after [`Fault::Unplug`]; a pseudo-terminal then has another address.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn plug_in(&mut self) -> std::io::Result<()> {
        self.unplug();
        self.shared.closing.store(false, Ordering::SeqCst);
        let address =
            self.address().strip_prefix("tcp://").and_then(|address| address.parse().ok());
        self.socket = address.map_or(self.socket, Socket::Tcp);
        self.port = serve(&self.shared, self.socket)?;
        Ok(())
    }

    fn begin(&mut self, fault: Fault, answers: Option<u32>) {
        match fault {
            Fault::Unplug => self.unplug(),
            Fault::KeypadTare => _ = self.shared.cell().tare(),
            Fault::Restart => {
                self.shared.cell().restart();
                *self.shared.rises() = Some(self.shared.pan.clock().now_s() + RESTART_S);
            }
            Fault::VialLifted => {
                let load_mg = self.shared.pan.load_mg();
                self.lifted_mg += load_mg;
                self.shared.pan.add_mg(-load_mg);
            }
            _ => {
                self.shared.cell().begin(fault);
                self.shared.faults().add(fault, answers);
            }
        }
    }

    fn unplug(&mut self) {
        self.shared.closing.store(true, Ordering::SeqCst);
        self.port.unplug();
    }
}

impl Drop for Balance {
    fn drop(&mut self) {
        self.unplug();
    }
}

fn serve(shared: &Arc<Shared>, socket: Socket) -> std::io::Result<Port> {
    let conversation = Conversation::new(shared.clone());
    match socket {
        Socket::Pty => Port::pty(conversation),
        Socket::Tcp(address) => Port::tcp(address, conversation),
    }
}
