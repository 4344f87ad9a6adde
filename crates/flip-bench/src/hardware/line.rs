//! A line-oriented wire: a serial port or a TCP connection.

use super::DeviceError;
use super::wire::{Tap, shown};
use flip_core::domain::FieldError;
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

/// Maximum length of a line, bytes: more without a line end is noise.
const LINE_BYTES_MAX: usize = 512;
/// How long one read waits.
const LOOK: Duration = Duration::from_millis(5);
/// Connect timeout.
const CONNECT: Duration = Duration::from_secs(3);

/// Parity bit of a serial port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Parity {
    /// None.
    #[default]
    None,
    /// Odd.
    Odd,
    /// Even.
    Even,
}

impl Parity {
    /// Its letter, as in `8N1`.
    pub fn letter(self) -> char {
        match self {
            Self::None => 'N',
            Self::Odd => 'O',
            Self::Even => 'E',
        }
    }
}

/// Settings of a serial port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Serial {
    /// Bits per second. Default 9600.
    pub baud: u32,
    /// Data bits, 7 or 8. Default 8.
    pub data_bits: u8,
    /// Default none.
    pub parity: Parity,
}

impl Default for Serial {
    fn default() -> Self {
        Self { baud: 9600, data_bits: 8, parity: Parity::None }
    }
}

/// A stream of bytes whose reads end after [`LOOK`].
trait Stream: Read + Write + Send {}
impl<T: Read + Write + Send> Stream for T {}

/// An open wire to one device.
pub struct Line {
    device: &'static str,
    stream: Box<dyn Stream>,
    /// Bytes received that do not form a complete line yet.
    partial: Vec<u8>,
    tap: Tap,
}

impl Line {
    /// Open `port`: a path such as `/dev/ttyUSB0`, or `tcp://host:port`.
    ///
    /// # Errors
    /// [`DeviceError::Lost`] with the reason.
    pub fn open(
        device: &'static str,
        port: &str,
        serial: &Serial,
        tap: Tap,
    ) -> Result<Self, DeviceError> {
        let lost = |cause: String| DeviceError::Lost { device, cause: format!("{port}: {cause}") };
        let stream: Box<dyn Stream> = match port.strip_prefix("tcp://") {
            Some(address) => Box::new(connect(address).map_err(|error| lost(error.to_string()))?),
            None => Box::new(open_serial(port, serial).map_err(|error| lost(error.to_string()))?),
        };
        Ok(Self { device, stream, partial: Vec::new(), tap })
    }

    /// Name of the device used in messages.
    pub fn device(&self) -> &'static str {
        self.device
    }

    /// Send these bytes as they are.
    ///
    /// # Errors
    /// [`DeviceError::Lost`]
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.tap.sent(self.device, shown(bytes));
        let sent = self.stream.write_all(bytes).and_then(|()| self.stream.flush());
        sent.map_err(|error| DeviceError::Lost { device: self.device, cause: error.to_string() })
    }

    /// Receive the next line, without the CR or LF that ends it; empty lines are skipped.
    ///
    /// # Errors
    /// [`DeviceError::Silent`] after `limit`, [`DeviceError::Garbled`] when the input has no line
    /// end, [`DeviceError::Lost`]
    pub fn receive(&mut self, limit: Duration) -> Result<Vec<u8>, DeviceError> {
        let until = Instant::now() + limit;
        loop {
            if let Some(line) = self.take_line() {
                self.tap.received(self.device, shown(&line));
                return Ok(line);
            }
            if self.partial.len() > LINE_BYTES_MAX {
                let got = shown(&self.forget()[..64]);
                return Err(DeviceError::Garbled { device: self.device, got });
            }
            if Instant::now() >= until {
                return Err(DeviceError::Silent { device: self.device });
            }
            self.look()?;
        }
    }

    /// Discard unsolicited input; returns it.
    ///
    /// # Errors
    /// [`DeviceError::Lost`]
    pub fn discard_input(&mut self) -> Result<Vec<u8>, DeviceError> {
        let mut seen = self.look();
        while matches!(seen, Ok(1..)) && self.partial.len() <= 64 * LINE_BYTES_MAX {
            seen = self.look();
        }
        // Input from before the connection broke is recorded too.
        let forgotten = self.forget();
        seen.map(|_| forgotten)
    }

    /// Drop an incomplete line; it is recorded.
    fn forget(&mut self) -> Vec<u8> {
        let forgotten = std::mem::take(&mut self.partial);
        if !forgotten.is_empty() {
            self.tap.received(self.device, shown(&forgotten));
        }
        forgotten
    }

    fn take_line(&mut self) -> Option<Vec<u8>> {
        loop {
            let end = self.partial.iter().position(|byte| matches!(byte, b'\r' | b'\n'))?;
            let mut line: Vec<u8> = self.partial.drain(..=end).collect();
            line.pop();
            if !line.is_empty() {
                return Some(line);
            }
        }
    }

    /// Wait briefly for bytes; returns how many arrived.
    fn look(&mut self) -> Result<usize, DeviceError> {
        let mut buffer = [0; 256];
        match self.stream.read(&mut buffer) {
            Ok(0) => Err(DeviceError::Lost {
                device: self.device,
                cause: "the connection was closed".to_owned(),
            }),
            Ok(count) => {
                self.partial.extend_from_slice(&buffer[..count]);
                Ok(count)
            }
            Err(error) if is_silence(&error) => Ok(0),
            Err(error) => Err(DeviceError::Lost { device: self.device, cause: error.to_string() }),
        }
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        self.forget();
    }
}

/// Whether a read ended only because nothing came in time.
pub(crate) fn is_silence(error: &std::io::Error) -> bool {
    use ErrorKind::{Interrupted, TimedOut, WouldBlock};
    matches!(error.kind(), TimedOut | WouldBlock | Interrupted)
}

fn connect(address: &str) -> std::io::Result<TcpStream> {
    let unknown = || std::io::Error::new(ErrorKind::NotFound, "no such host");
    let address = address.to_socket_addrs()?.next().ok_or_else(unknown)?;
    let stream = TcpStream::connect_timeout(&address, CONNECT)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(CONNECT))?;
    Ok(stream)
}

fn open_serial(path: &str, serial: &Serial) -> serialport::Result<serialport::TTYPort> {
    let parity = match serial.parity {
        Parity::None => serialport::Parity::None,
        Parity::Odd => serialport::Parity::Odd,
        Parity::Even => serialport::Parity::Even,
    };
    let data_bits = if serial.data_bits == 7 {
        serialport::DataBits::Seven
    } else {
        serialport::DataBits::Eight
    };
    serialport::new(path, serial.baud)
        .data_bits(data_bits)
        .parity(parity)
        .timeout(LOOK)
        .open_native()
}

impl Serial {
    /// Returns the settings if they are valid for a port.
    ///
    /// # Errors
    /// The first field that is out of bounds.
    pub fn checked(self) -> Result<Self, FieldError> {
        if !(300..=4_000_000).contains(&self.baud) {
            return Err(FieldError::new(
                "baud",
                format!("must be from 300 to 4000000, got {}", self.baud),
            ));
        }
        if ![7, 8].contains(&self.data_bits) {
            return Err(FieldError::new(
                "data_bits",
                format!("must be 7 or 8, got {}", self.data_bits),
            ));
        }
        Ok(self)
    }
}
