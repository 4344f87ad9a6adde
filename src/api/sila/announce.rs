//! Discovery: the server tells its network that it is there, by multicast DNS.

use super::nameplate::NamePlate;
use super::service;
use mdns_sd::{IfKind, ServiceDaemon, ServiceInfo};
use std::net::SocketAddr;

/// Type of service that clients look for.
const KIND: &str = "_sila._tcp.local.";
/// Most bytes of one property, its name included.
const PROPERTY_BYTES: usize = 255;

/// An announcement, taken back when dropped.
pub struct Announcement {
    daemon: ServiceDaemon,
    name: String,
}

/// Announces the server at this address with its certificate, PEM, if it speaks TLS.
///
/// # Errors
/// The system gives no multicast socket.
pub fn announce(
    plate: &NamePlate,
    address: SocketAddr,
    certificate: Option<&str>,
) -> Result<Announcement, mdns_sd::Error> {
    let uuid = plate.uuid().to_string();
    let host = format!("flip-{}.local.", &uuid[uuid.len() - 12..]);
    let properties = properties(&plate.name(), certificate);
    let (ip, port) = (address.ip(), address.port());
    let mut info = match ip.is_unspecified() {
        true => ServiceInfo::new(KIND, &uuid, &host, "", port, &properties[..])?.enable_addr_auto(),
        false => ServiceInfo::new(KIND, &uuid, &host, ip, port, &properties[..])?,
    };
    // The name is a UUID: nobody else has it, so nobody need be asked.
    info.set_requires_probe(false);
    let daemon = ServiceDaemon::new()?;
    daemon.disable_interface(vec![IfKind::LoopbackV4, IfKind::LoopbackV6])?;
    let name = info.get_fullname().to_owned();
    daemon.register(info)?;
    Ok(Announcement { daemon, name })
}

impl Drop for Announcement {
    fn drop(&mut self) {
        // Whoever listens forgets it at once; otherwise within two minutes.
        let _told = self.daemon.unregister(&self.name);
        let _ended = self.daemon.shutdown();
    }
}

/// What is said of the server; the certificate goes line by line, as a property has at most 255
/// bytes.
fn properties(name: &str, certificate: Option<&str>) -> Vec<(String, String)> {
    let said = [
        ("version", env!("CARGO_PKG_VERSION")),
        ("server_name", name),
        ("description", service::DESCRIPTION),
    ];
    let said = said.map(|(key, text)| (key.to_owned(), fitting(key, text)));
    let lines = certificate.unwrap_or_default().lines().enumerate();
    let certificate = lines.map(|(k, line)| (format!("ca{k}"), line.to_owned()));
    said.into_iter().chain(certificate).collect()
}

/// As much of a text as fits, in whole characters.
fn fitting(key: &str, text: &str) -> String {
    let room = PROPERTY_BYTES - key.len() - 1;
    let ends = text.char_indices().map(|(k, c)| k + c.len_utf8());
    text[..ends.take_while(|end| *end <= room).last().unwrap_or(0)].to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_certificate_goes_line_by_line_and_a_long_name_is_cut() {
        let pem = "-----BEGIN CERTIFICATE-----\nabc\n-----END CERTIFICATE-----\n";
        let all = properties(&"ü".repeat(200), Some(pem));
        let of = |key: &str| &all.iter().find(|it| it.0 == key).unwrap().1;
        assert_eq!((of("ca1").as_str(), of("ca2").starts_with("-----END")), ("abc", true));
        assert_eq!(of("server_name").len(), 242);
        assert!(all.iter().all(|(key, text)| key.len() + 1 + text.len() <= PROPERTY_BYTES));
    }
}
