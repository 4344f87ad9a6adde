//! Settings: which balance is connected, and where.

use super::value::{STEPS, is_same};
use super::{Commands, aandd, mt_sics, ohaus, reply::Reply, reply::Unreadable, sbi};
use crate::hardware::line::{Parity, Serial};
use flip_core::domain::{FieldError, bounded};
use serde::{Deserialize, Serialize};

/// The command language of a balance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dialect {
    /// Mettler-Toledo.
    MtSics,
    /// Ohaus.
    Ohaus,
    /// Sartorius.
    Sbi,
    /// A&D.
    Aandd,
}

impl Dialect {
    /// Every dialect.
    pub const ALL: [Self; 4] = [Self::MtSics, Self::Ohaus, Self::Sbi, Self::Aandd];

    /// Name used in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::MtSics => "mt_sics",
            Self::Ohaus => "ohaus",
            Self::Sbi => "sbi",
            Self::Aandd => "aandd",
        }
    }

    /// How far FLIP's implementation of the dialect has been verified.
    pub fn verified(self) -> &'static str {
        match self {
            Self::MtSics | Self::Sbi => {
                "tested against an independent simulator, not verified on a device"
            }
            Self::Ohaus => "from manuals, not verified on a device",
            Self::Aandd => {
                "from memory, not verified on a device: compare the transcript with the manual"
            }
        }
    }

    /// Factory settings of the port.
    pub fn factory_serial(self) -> Serial {
        match self {
            Self::MtSics | Self::Ohaus => Serial::default(),
            Self::Sbi => Serial { parity: Parity::Odd, ..Serial::default() },
            Self::Aandd => Serial { baud: 2400, data_bits: 7, parity: Parity::Even },
        }
    }

    /// Parse one line of this dialect, without its terminator.
    ///
    /// # Errors
    /// [`Unreadable`]
    pub fn parse(self, line: &[u8]) -> Result<Reply, Unreadable> {
        match self {
            Self::MtSics => mt_sics::parse(line),
            Self::Ohaus => ohaus::parse(line),
            Self::Sbi => sbi::parse(line),
            Self::Aandd => aandd::parse(line),
        }
    }

    pub(super) fn commands(self) -> &'static Commands {
        match self {
            Self::MtSics => &mt_sics::COMMANDS,
            Self::Ohaus => &ohaus::COMMANDS,
            Self::Sbi => &sbi::COMMANDS,
            Self::Aandd => &aandd::COMMANDS,
        }
    }
}

impl std::str::FromStr for Dialect {
    type Err = FieldError;

    fn from_str(name: &str) -> Result<Self, FieldError> {
        Self::ALL.into_iter().find(|dialect| dialect.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(Self::name).join(", ");
            FieldError::new(
                "dialect",
                format!("must be one of {names}, got {name}; `flip bench probe` finds it"),
            )
        })
    }
}

/// How to wait for a stable reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StableBy {
    /// Poll readings until one is flagged stable: can be given up at any moment.
    #[default]
    Polling,
    /// The balance's own command, which answers when stable: one exchange, but if the wait is given
    /// up the reply still arrives later and has to be waited for. A dialect without such a command
    /// polls.
    Command,
    /// FLIP's own window over the readings decides, whatever the balance flags: for balances that
    /// never flag one stable. Taring is then requested immediately, where the dialect can.
    Window,
}

/// A balance on a port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Its dialect.
    pub dialect: Dialect,
    /// A path such as `/dev/ttyUSB0`, or `tcp://host:port`.
    pub port: String,
    /// Serial port settings. Default: the factory settings of the dialect's balances.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<Serial>,
    /// Step of the display, mg: 1, 2 or 5 in its last place. If set, frames with another step are
    /// treated as damaged. Default: as shown by the balance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readability_mg: Option<f64>,
    /// Reply timeout, s. Default 2.
    #[serde(default = "two")]
    pub timeout_s: f64,
    /// How long taring and zeroing may wait for a stable reading, s. Default 20.
    #[serde(default = "twenty")]
    pub stable_timeout_s: f64,
    /// How to wait for a stable reading. Default: by polling.
    #[serde(default)]
    pub stable_by: StableBy,
}

fn two() -> f64 {
    2.0
}

fn twenty() -> f64 {
    20.0
}

impl Settings {
    /// Settings with everything else at its default.
    pub fn new(dialect: Dialect, port: impl Into<String>) -> Self {
        let (timeout_s, stable_timeout_s) = (two(), twenty());
        let stable_by = StableBy::default();
        Self {
            dialect,
            port: port.into(),
            serial: None,
            readability_mg: None,
            timeout_s,
            stable_timeout_s,
            stable_by,
        }
    }

    /// Returns the settings if they are valid.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        if self.port.trim().is_empty() {
            return Err(FieldError::new(
                "port",
                "must be a path, as /dev/ttyUSB0, or tcp://host:port",
            ));
        }
        if let Some(serial) = self.serial {
            serial.checked()?;
        }
        if let Some(readability) = self.readability_mg {
            bounded("readability_mg", readability, 0.0001, 10_000.0, "mg")?;
            if !is_step(readability) {
                let message = format!(
                    "must be 1, 2 or 5 in some decimal place, as 0.1, 0.5 or 2, got {readability}"
                );
                return Err(FieldError::new("readability_mg", message));
            }
        }
        bounded("timeout_s", self.timeout_s, 0.05, 60.0, "s")?;
        bounded("stable_timeout_s", self.stable_timeout_s, 0.5, 600.0, "s")?;
        Ok(self)
    }
}

/// 1, 2 or 5 times a power of ten.
fn is_step(readability_mg: f64) -> bool {
    let place_mg = 10_f64.powf(readability_mg.log10().floor());
    STEPS.into_iter().chain([10]).any(|step| is_same(step as f64 * place_mg, readability_mg))
}
