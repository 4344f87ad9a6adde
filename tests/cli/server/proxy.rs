//! A way to a server on which answers get lost.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::{Arc, Mutex, mpsc};
use std::thread::spawn;

/// Passes requests on; the first answer to a request that begins like one of the given ones is lost
/// with its connection.
pub struct Proxy {
    pub url: String,
    /// Hears of each lost answer.
    pub lost: mpsc::Receiver<String>,
}

/// Beginnings of requests whose answers are still to be lost.
type Doomed = Arc<Mutex<Vec<String>>>;

impl Proxy {
    pub fn to(address: &str, lose: &[&str]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}", listener.local_addr().unwrap());
        let (told, lost) = mpsc::channel();
        let doomed: Doomed = Arc::new(Mutex::new(lose.iter().map(|it| (*it).to_owned()).collect()));
        let address = address.to_owned();
        spawn(move || {
            for client in listener.incoming() {
                let server = TcpStream::connect(&address).unwrap();
                carry(client.unwrap(), server, &doomed, &told);
            }
        });
        Self { url, lost }
    }
}

fn carry(client: TcpStream, server: TcpStream, doomed: &Doomed, told: &mpsc::Sender<String>) {
    let asked = Arc::new(Mutex::new(String::new()));
    let (from, to, noted) =
        (client.try_clone().unwrap(), server.try_clone().unwrap(), asked.clone());
    spawn(move || {
        pass(from, to, |bytes| {
            let text = String::from_utf8_lossy(bytes);
            // A body may come by itself.
            if text.lines().next().is_some_and(|line| line.ends_with("HTTP/1.1")) {
                *noted.lock().unwrap() = text.into_owned();
            }
            true
        });
    });
    let (doomed, told) = (doomed.clone(), told.clone());
    spawn(move || {
        pass(server, client, |_| {
            let mut doomed = doomed.lock().unwrap();
            let asked = asked.lock().unwrap();
            let Some(at) = doomed.iter().position(|it| asked.starts_with(it.as_str())) else {
                return true;
            };
            // Nobody may be listening any more.
            let _ = told.send(doomed.remove(at));
            false
        });
    });
}

/// Passes bytes on until either side ends, or `may_pass` says no.
fn pass(mut from: TcpStream, mut to: TcpStream, mut may_pass: impl FnMut(&[u8]) -> bool) {
    let mut bytes = [0; 65536];
    while let Ok(n @ 1..) = from.read(&mut bytes) {
        if !may_pass(&bytes[..n]) || to.write_all(&bytes[..n]).is_err() {
            break;
        }
    }
    // Ended already, perhaps.
    let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
}
