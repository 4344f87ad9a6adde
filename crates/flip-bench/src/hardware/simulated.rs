//! The digital bench: the simulator's spoon over the simulated balance.

use super::{Bench, DeviceError};
use flip_core::domain::bench::{Action, Moment, Reach, Reading, Standing, Tare};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::rest::Rest;
use flip_core::domain::seed::derive;
use flip_sim::balance;
use flip_sim::batch::{Filled, Motion};
use flip_sim::dispense::{self, Dispenser};

/// A bench whose powder is simulated, on a core or in a place of a batch.
#[derive(Debug, Clone)]
pub struct SimulatedBench<S = Dispenser> {
    spoon: S,
    balance: balance::Settings,
    noise: u64,
    readings: u64,
    /// True mass at the last reading, mg.
    read_at_mg: f64,
    tare_mg: f64,
    elapsed_s: f64,
}

impl SimulatedBench {
    /// A bench with a freshly filled level spoon (takes about half a second of CPU time).
    pub fn new(
        set: &ParameterSet,
        spoon: &dispense::Settings,
        balance: &balance::Settings,
        seed: u64,
    ) -> Self {
        Self::with_spoon(Dispenser::new(set, spoon, bed_seed(seed)), balance, seed)
    }
}

/// The seed of the spoonful on a bench of this seed.
pub fn bed_seed(seed: u64) -> u64 {
    derive(seed, &[0])
}

impl<S: Filled> SimulatedBench<S> {
    /// A bench with this spoon.
    pub fn with_spoon(spoon: S, balance: &balance::Settings, seed: u64) -> Self {
        let read_at_mg = spoon.vial_mg();
        let noise = derive(seed, &[1]);
        Self {
            spoon,
            balance: *balance,
            noise,
            readings: 0,
            read_at_mg,
            tare_mg: 0.0,
            elapsed_s: 0.0,
        }
    }

    /// True mass in the vial, mg, which no balance shows.
    pub fn vial_mg(&self) -> f64 {
        self.spoon.vial_mg()
    }

    /// Powder that missed the vial, mg.
    pub fn spilled_mg(&self) -> f64 {
        self.spoon.spilled_mg()
    }

    fn carry_out(&mut self, motion: Motion) -> Result<(), DeviceError> {
        self.elapsed_s += self.spoon.carry_out(motion);
        match self.spoon.fault() {
            Some(cause) => {
                Err(DeviceError::Faulted { device: "the simulated spoon", cause: cause.to_owned() })
            }
            None => Ok(()),
        }
    }
}

impl<S: Filled> Bench for SimulatedBench<S> {
    /// The spoon was filled when the bench was made, and stands over the vial.
    fn approach(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn tare(&mut self) -> Result<Tare, DeviceError> {
        self.tare_mg = self.spoon.vial_mg();
        Ok(Tare { tare_mg: None })
    }

    fn read(&mut self) -> Result<Reading, DeviceError> {
        let net_mg = self.spoon.vial_mg() - self.tare_mg;
        let reading = self.balance.read(self.read_at_mg, net_mg, self.noise, self.readings);
        self.readings += 1;
        self.read_at_mg = net_mg;
        self.elapsed_s += self.balance.wait_s;
        Ok(reading)
    }

    /// One reading: a simulated balance neither drifts nor is ever restless.
    fn stand(&mut self, seconds: f64) -> Result<Standing, DeviceError> {
        let reading = self.read()?;
        let still = reading.stable;
        let seen = [Moment { t_s: self.elapsed_s, mass_mg: reading.mass_mg }];
        let rest =
            Rest::of(&seen).ok_or(DeviceError::Silent { device: "the simulated balance" })?;
        Ok(Standing {
            reading,
            still,
            drift_mg_min: 0.0,
            scatter_mg: self.balance.noise_mg,
            seconds,
            rest,
        })
    }

    fn readings(&mut self, seconds: f64) -> Result<Vec<Moment>, DeviceError> {
        let until_s = self.elapsed_s + seconds;
        let mut seen = Vec::new();
        while seen.is_empty() || self.elapsed_s < until_s {
            let mass_mg = self.read()?.mass_mg;
            seen.push(Moment { t_s: self.elapsed_s, mass_mg });
        }
        Ok(seen)
    }

    fn is_the_same(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn lived_s(&self) -> f64 {
        f64::INFINITY
    }

    fn watch_for_life(&mut self, _seconds: f64) -> Result<bool, DeviceError> {
        Ok(true)
    }

    fn act(&mut self, action: Action) -> Result<(), DeviceError> {
        self.carry_out(Motion::Act(action))
    }

    fn level(&mut self) -> Result<(), DeviceError> {
        self.carry_out(Motion::Level)
    }

    fn retract(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn discard(&mut self) -> Result<(), DeviceError> {
        Ok(())
    }

    fn reach(&self) -> Reach {
        Reach { pitch: self.spoon.pitch(), ..Reach::FULL }
    }

    fn pitch_deg(&self) -> f64 {
        self.spoon.pitch_deg()
    }

    fn elapsed_s(&self) -> f64 {
        self.elapsed_s
    }
}
