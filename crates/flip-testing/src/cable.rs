//! The network between FLIP and its PostgreSQL, which a test can cut.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often a carrier looks whether the cable is whole.
const LOOK: Duration = Duration::from_millis(5);

/// Connections to a port of localhost are carried to a server's socket. While it is cut, nothing
/// arrives and nobody hears that: as between machines, connections stay open and silent. What was
/// sent meanwhile arrives once it is whole. It ends with the process.
#[derive(Debug)]
pub struct Cable {
    port: u16,
    is_cut: Arc<AtomicBool>,
}

impl Cable {
    /// A whole cable to this socket.
    ///
    /// # Panics
    /// When no port is free.
    pub fn to(socket: PathBuf) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let is_cut = Arc::<AtomicBool>::default();
        let cut = is_cut.clone();
        std::thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let (socket, cut) = (socket.clone(), cut.clone());
                std::thread::spawn(move || join(client, &socket, &cut));
            }
        });
        Self { port, is_cut }
    }

    /// The address of this database through the cable.
    ///
    /// # Panics
    /// When it is not the address of a database.
    pub fn address(&self, direct: &str) -> String {
        let name = direct.split('?').next().and_then(|front| front.rsplit('/').next()).unwrap();
        format!("postgres://flip@127.0.0.1:{}/{name}?sslmode=disable", self.port)
    }

    /// Cut it.
    pub fn cut(&self) {
        self.is_cut.store(true, Ordering::SeqCst);
    }

    /// Make it whole again.
    pub fn mend(&self) {
        self.is_cut.store(false, Ordering::SeqCst);
    }
}

/// Join a client with the server until one of them ends the connection.
fn join(client: TcpStream, socket: &Path, cut: &Arc<AtomicBool>) {
    wait(cut);
    // A server that is down refuses: the client sees its connection end.
    let Ok(server) = UnixStream::connect(socket) else { return };
    // Every statement waits for an answer: nothing is gained by collecting bytes.
    let _ = client.set_nodelay(true);
    let (Ok(client_too), Ok(server_too)) = (client.try_clone(), server.try_clone()) else { return };
    let there = cut.clone();
    std::thread::spawn(move || {
        carry(&client_too, &server_too, &there);
        let _ = server_too.shutdown(Shutdown::Both);
    });
    carry(&server, &client, cut);
    let _ = client.shutdown(Shutdown::Both);
}

/// Carry bytes until their source ends.
fn carry(mut from: impl Read, mut to: impl Write, cut: &AtomicBool) {
    let mut bytes = vec![0; 1 << 16];
    loop {
        let read = match from.read(&mut bytes) {
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Ok(0) | Err(_) => break,
            Ok(read) => read,
        };
        wait(cut);
        if to.write_all(&bytes[..read]).is_err() {
            break;
        }
    }
    // The end of a connection does not cross a cut either.
    wait(cut);
}

fn wait(cut: &AtomicBool) {
    while cut.load(Ordering::SeqCst) {
        std::thread::sleep(LOOK);
    }
}
