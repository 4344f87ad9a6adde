//! The certificate of a server that was given none: signed by itself, with what the standard asks
//! for, and kept in the data folder, because clients remember it.

use super::nameplate::NamePlate;
use crate::api::listen::Tls;
use rcgen::{
    CertificateParams, CustomExtension, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa,
    KeyPair, KeyUsagePurpose, date_time_ymd,
};
use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::net::IpAddr;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Common name of certificates that no authority signed.
const COMMON_NAME: &str = "SiLA2";
/// Object identifier of the extension with the server's UUID.
const SERVER_UUID: [u64; 7] = [1, 3, 6, 1, 4, 1, 58583];
/// Certificates do not expire while a bench is in use: a client that remembers one has no other way
/// to know the server.
const LAST_YEAR: i32 = 2099;

/// The certificate of this server for these names and addresses; made anew if it lacks one of them.
///
/// # Errors
/// The files cannot be read or written.
pub fn own(plate: &NamePlate, names: &[String]) -> io::Result<Tls> {
    let tls = Tls {
        certificate: plate.folder.join("certificate.pem"),
        key: plate.folder.join("key.pem"),
    };
    let mut certified = plate.certified();
    let is_whole = names.iter().all(|name| certified.contains(name));
    if is_whole && tls.certificate.exists() && tls.key.exists() {
        return Ok(tls);
    }
    certified.extend(names.iter().filter(|name| !plate.certified().contains(name)).cloned());
    let key = key(&tls.key)?;
    let certificate = parameters(&plate.uuid().to_string(), &certified)
        .and_then(|it| it.self_signed(&key))
        .map_err(io::Error::other)?;
    fs::write(&tls.certificate, certificate.pem())?;
    plate.set_certified(certified)?;
    Ok(tls)
}

/// The key, made the first time and readable by nobody else.
fn key(file: &Path) -> io::Result<KeyPair> {
    if file.exists() {
        return KeyPair::from_pem(&fs::read_to_string(file)?).map_err(io::Error::other);
    }
    let key = KeyPair::generate().map_err(io::Error::other)?;
    let mut written = OpenOptions::new().write(true).create_new(true).mode(0o600).open(file)?;
    written.write_all(key.serialize_pem().as_bytes())?;
    Ok(key)
}

fn parameters(uuid: &str, names: &[String]) -> Result<CertificateParams, rcgen::Error> {
    let mut it = CertificateParams::new(names.to_vec())?;
    it.distinguished_name = DistinguishedName::new();
    it.distinguished_name.push(DnType::CommonName, COMMON_NAME);
    it.not_before = date_time_ymd(2026, 1, 1);
    it.not_after = date_time_ymd(LAST_YEAR, 12, 31);
    it.is_ca = IsCa::ExplicitNoCa;
    it.key_usages = vec![
        KeyUsagePurpose::DigitalSignature,
        KeyUsagePurpose::KeyEncipherment,
        KeyUsagePurpose::KeyCertSign,
    ];
    it.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth];
    let content = uuid.as_bytes().to_vec();
    it.custom_extensions = vec![CustomExtension::from_oid_content(&SERVER_UUID, content)];
    Ok(it)
}

/// Names and addresses by which a server that listens there is reached.
pub fn names(listen: IpAddr) -> Vec<String> {
    let mut names = vec!["localhost".to_owned(), "127.0.0.1".to_owned(), "::1".to_owned()];
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = host.trim();
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '.';
    if !host.is_empty() && host.chars().all(is_name) {
        names.extend([host.to_owned(), format!("{host}.local")]);
    }
    match listen.is_unspecified() {
        false => names.push(listen.to_string()),
        true => names.extend(addresses().iter().map(IpAddr::to_string)),
    }
    names.sort();
    names.dedup();
    names
}

/// Addresses of this machine's interfaces, but for those that only it can reach.
fn addresses() -> Vec<IpAddr> {
    let all = if_addrs::get_if_addrs().unwrap_or_default();
    all.into_iter()
        .filter(|it| !it.is_loopback() && !it.is_link_local())
        .map(|it| it.ip())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_certificate_stays_until_an_address_is_new() {
        let data = tempfile::tempdir().unwrap();
        let plate = NamePlate::of(data.path(), "0194f1c5-0000-4000-a000-000000000000").unwrap();
        let names = |list: &[&str]| list.iter().map(|it| (*it).to_owned()).collect::<Vec<_>>();
        let made = |list: &[&str]| {
            let tls = own(&plate, &names(list)).unwrap();
            (fs::read(tls.certificate).unwrap(), fs::read(tls.key).unwrap())
        };
        let first = made(&["localhost", "10.0.0.1"]);
        assert_eq!(made(&["10.0.0.1"]), first);
        let second = made(&["10.0.0.2"]);
        assert!(second.0 != first.0 && second.1 == first.1, "a new certificate of the same key");
        assert_eq!(made(&["localhost", "10.0.0.1", "10.0.0.2"]), second);
    }

    #[test]
    fn a_server_that_listens_everywhere_has_a_name_and_loopback_addresses() {
        let names = names("0.0.0.0".parse().unwrap());
        assert!(names.contains(&"localhost".to_owned()) && !names.contains(&"0.0.0.0".to_owned()));
    }
}
