//! Identification of the balance. Every such query is optional: a balance refuses those it does not
//! know, or does not answer.

use super::reply::{Reply, Said};
use super::{Balance, Command, DEVICE, Dialect, seconds};
use crate::hardware::DeviceError;
use serde::{Deserialize, Serialize};

/// Identity of a balance, as far as its dialect reports it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Identity {
    /// Maker, from the dialect.
    pub maker: String,
    /// Model.
    pub model: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// Software version.
    pub software: Option<String>,
}

impl Identity {
    /// Whether the balance reported nothing about itself.
    pub fn is_unknown(&self) -> bool {
        self.model.is_none() && self.serial.is_none() && self.software.is_none()
    }
}

/// Outcome of a text query.
enum Told {
    Words(String),
    /// Another reply: the balance does not know the query.
    Refused,
    Nothing,
}

impl Balance {
    /// Query the identity; unknown where the balance refuses every such query.
    ///
    /// # Errors
    /// [`DeviceError::Silent`] if it answers none of them, else as [`Self::immediate`].
    pub fn identify(&mut self) -> Result<Identity, DeviceError> {
        let mut answers = false;
        let mut told = |it: Told| {
            answers |= !matches!(it, Told::Nothing);
            if let Told::Words(words) = it { Some(words) } else { None }
        };
        let mut model = None;
        for command in self.commands.model {
            if model.is_none() {
                model = told(self.words(*command)?);
            }
        }
        let serial = self
            .commands
            .serial
            .map_or(Ok(Told::Nothing), |command| self.words(command))
            .map(&mut told)?;
        let software = self
            .commands
            .software
            .map_or(Ok(Told::Nothing), |command| self.words(command))
            .map(&mut told)?;
        if !answers {
            return Err(DeviceError::Silent { device: DEVICE });
        }
        Ok(Identity { maker: maker(self.settings.dialect).to_owned(), model, serial, software })
    }

    /// Serial number, where the balance reports one.
    pub(super) fn serial_number(&mut self) -> Result<Option<String>, DeviceError> {
        let told = self.commands.serial.map_or(Ok(Told::Nothing), |command| self.words(command))?;
        Ok(if let Told::Words(words) = told { Some(words) } else { None })
    }

    /// Send a text query and return the reply. A balance that does not answer such a query is asked
    /// only once: silence costs seconds.
    fn words(&mut self, command: Command) -> Result<Told, DeviceError> {
        if self.silent_to.contains(&command.bytes) && !self.dialogue.keeps_step() {
            return Ok(Told::Nothing);
        }
        let limit = seconds(self.settings.timeout_s);
        let answer = match self.dialogue.ask(command, limit) {
            Err(DeviceError::Garbled { .. }) => self.dialogue.ask(command, limit),
            answer => answer,
        };
        match answer {
            Ok((Reply { said: Said::Text(text), .. }, _)) if !text.is_empty() => {
                Ok(Told::Words(text))
            }
            Ok(_) => Ok(Told::Refused),
            // Every attempt returned another kind of line: no reply could be parsed.
            Err(DeviceError::Garbled { .. }) => Ok(Told::Refused),
            Err(DeviceError::Silent { .. }) => {
                self.silent_to.push(command.bytes);
                Ok(Told::Nothing)
            }
            Err(error) => Err(error),
        }
    }
}

/// Maker implied by the dialect.
pub(super) fn maker(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::MtSics => "Mettler-Toledo or compatible",
        Dialect::Ohaus => "Ohaus",
        Dialect::Sbi => "Sartorius or compatible",
        Dialect::Aandd => "A&D",
    }
}
