//! Who is this balance? Every question of that kind is optional: what a balance does not know it refuses, or says nothing.

use super::reply::{Reply, Said};
use super::{Balance, Command, DEVICE, Dialect, seconds};
use crate::hardware::DeviceError;
use serde::{Deserialize, Serialize};

/// Who a balance says it is, as far as its dialect tells.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Identity {
    /// From the dialect.
    pub maker: String,
    /// Model.
    pub model: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// Version of its software.
    pub software: Option<String>,
}

impl Identity {
    /// The balance said nothing of itself.
    pub fn is_unknown(&self) -> bool {
        self.model.is_none() && self.serial.is_none() && self.software.is_none()
    }
}

/// What a question for words brought.
enum Told {
    Words(String),
    /// Another answer: the balance does not know the question.
    Refused,
    Nothing,
}

impl Balance {
    /// Who the balance says it is; unknown where it refuses every question of that kind.
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
        let serial = self.commands.serial.map_or(Ok(Told::Nothing), |command| self.words(command)).map(&mut told)?;
        let software =
            self.commands.software.map_or(Ok(Told::Nothing), |command| self.words(command)).map(&mut told)?;
        if !answers {
            return Err(DeviceError::Silent { device: DEVICE });
        }
        Ok(Identity { maker: maker(self.settings.dialect).to_owned(), model, serial, software })
    }

    /// Its serial number, where it tells one.
    pub(super) fn serial_number(&mut self) -> Result<Option<String>, DeviceError> {
        let told = self.commands.serial.map_or(Ok(Told::Nothing), |command| self.words(command))?;
        Ok(if let Told::Words(words) = told { Some(words) } else { None })
    }

    /// The words that answer a question. A balance that answers no such question is asked each of them once: silence costs seconds.
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
            Ok((Reply { said: Said::Text(text), .. }, _)) if !text.is_empty() => Ok(Told::Words(text)),
            Ok(_) => Ok(Told::Refused),
            // Another kind of line came, as often as it was asked: no answer that could be read.
            Err(DeviceError::Garbled { .. }) => Ok(Told::Refused),
            Err(DeviceError::Silent { .. }) => {
                self.silent_to.push(command.bytes);
                Ok(Told::Nothing)
            }
            Err(error) => Err(error),
        }
    }
}

/// By its dialect.
pub(super) fn maker(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::MtSics => "Mettler-Toledo or compatible",
        Dialect::Ohaus => "Ohaus",
        Dialect::Sbi => "Sartorius or compatible",
        Dialect::Aandd => "A&D",
    }
}
