//! Where a server is: what `--server` takes.

use std::net::IpAddr;
use std::str::FromStr;
use ureq::http::Uri;

/// The address of a running `flip serve`, with the path before `/v1` if a proxy adds one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in super::super) struct Address {
    /// Without a slash at its end.
    text: String,
    /// Whether others on the way can read what is sent.
    is_open: bool,
}

impl Address {
    /// Whether others on the way can read what is sent: plain HTTP to another machine.
    pub(super) fn is_open(&self) -> bool {
        self.is_open
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = |why: &str| format!("{why}, as in http://127.0.0.1:8080, got `{text}`");
        let uri: Uri = text.parse().map_err(|_| wrong("must be an address"))?;
        let scheme = uri.scheme_str().filter(|scheme| matches!(*scheme, "http" | "https"));
        let (Some(scheme), Some(host)) = (scheme, uri.host().filter(|host| !host.is_empty()))
        else {
            return Err(wrong("must begin with http:// or https:// and name a host"));
        };
        let is_bare = uri.query().is_none() && !text.contains(['#', '@']);
        if !is_bare {
            return Err(wrong("must be an address alone, without name, password, ? or #"));
        }
        let text = text.trim_end_matches('/');
        let text = text.strip_suffix("/v1").unwrap_or(text).trim_end_matches('/').to_owned();
        Ok(Self { text, is_open: scheme == "http" && !is_loopback(host) })
    }
}

fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || bare.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_may_have_a_path_and_a_last_slash() {
        let read = |text: &str| text.parse::<Address>().unwrap().to_string();
        assert_eq!(read("http://127.0.0.1:8080/"), "http://127.0.0.1:8080");
        assert_eq!(read("https://lab.example/flip/v1/"), "https://lab.example/flip");
        assert_eq!(read("http://[::1]:80"), "http://[::1]:80");
    }

    #[test]
    fn anything_else_is_refused_and_says_what_is_wanted() {
        for wrong in [
            "",
            "127.0.0.1:8080",
            "ftp://lab",
            "http://",
            "http://lab/?x=1",
            "http://lab/#a",
            "http://me:secret@lab",
        ] {
            let why = wrong.parse::<Address>().unwrap_err();
            assert!(why.contains("as in http://127.0.0.1:8080"), "{wrong}: {why}");
        }
    }

    #[test]
    fn plain_http_to_another_machine_is_open() {
        let is_open = |text: &str| text.parse::<Address>().unwrap().is_open();
        assert!(is_open("http://lab:8080") && is_open("http://192.168.0.7"));
        assert!(!is_open("https://lab") && !is_open("http://localhost:1"));
        assert!(!is_open("http://[::1]:1") && !is_open("http://127.0.0.2"));
    }
}
