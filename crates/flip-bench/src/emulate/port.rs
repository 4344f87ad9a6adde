//! Connection of an emulated device: a pseudo-terminal or a TCP port, served by its own thread.

use crate::hardware::line::is_silence;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::os::fd::OwnedFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often a device is given the chance to send something unsolicited.
const IDLE: Duration = Duration::from_millis(10);

/// A device that receives and sends bytes.
pub trait Talker: Send + 'static {
    /// The port was connected or opened.
    fn connected(&mut self) {}

    /// These bytes were received; `say` sends bytes back.
    fn hear(&mut self, bytes: &[u8], say: &mut dyn FnMut(&[u8]));

    /// Nothing was received for a few hundredths of a second.
    fn idle(&mut self, say: &mut dyn FnMut(&[u8])) {
        let _ = say;
    }
}

/// An emulated device's port. It is unplugged when this is dropped.
pub struct Port {
    address: String,
    unplugged: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Port {
    /// Serve `device` on a new pseudo-terminal.
    ///
    /// # Errors
    /// The system has no pseudo-terminal left.
    pub fn pty(device: impl Talker) -> std::io::Result<Self> {
        let controller = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&controller)?;
        unlockpt(&controller)?;
        let path =
            ptsname(&controller, Vec::new())?.into_string().map_err(std::io::Error::other)?;
        // Kept open, so that the device lives on while nobody has the port open.
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let terminal = rustix::fs::open(path.as_str(), flags, Mode::empty())?;
        let mut raw = tcgetattr(&terminal)?;
        raw.make_raw();
        tcsetattr(&terminal, OptionalActions::Now, &raw)?;
        Self::serve(path, move |unplugged| serve_pty(controller, terminal, device, unplugged))
    }

    /// Serve `device` on a TCP port of this machine, one connection at a time; port 0 picks a free
    /// one.
    ///
    /// # Errors
    /// The port is not available.
    pub fn tcp(address: SocketAddr, device: impl Talker) -> std::io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        let address = format!("tcp://{}", listener.local_addr()?);
        Self::serve(address, move |unplugged| serve_tcp(&listener, device, unplugged))
    }

    fn serve(
        address: String,
        work: impl FnOnce(&AtomicBool) + Send + 'static,
    ) -> std::io::Result<Self> {
        let unplugged = Arc::new(AtomicBool::new(false));
        let flag = unplugged.clone();
        let thread = std::thread::Builder::new()
            .name("emulated device".into())
            .spawn(move || work(&flag))?;
        Ok(Self { address, unplugged, thread: Some(thread) })
    }

    /// The address a driver opens: a path or `tcp://host:port`.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Pull the plug: clients that have the port open find it gone.
    pub fn unplug(&mut self) {
        self.unplugged.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.unplug();
    }
}

fn serve_pty(
    controller: OwnedFd,
    terminal: OwnedFd,
    mut device: impl Talker,
    unplugged: &AtomicBool,
) {
    let _kept_open = terminal;
    let mut stream = File::from(controller);
    device.connected();
    while !unplugged.load(Ordering::SeqCst) {
        let timeout = Timespec { tv_sec: 0, tv_nsec: IDLE.subsec_nanos().into() };
        let ready = poll(&mut [PollFd::new(&stream, PollFlags::IN)], Some(&timeout));
        let spoken = match ready {
            Ok(0) | Err(_) => converse(&mut device, &mut stream, None),
            Ok(_) => listen(&mut device, &mut stream),
        };
        if spoken.is_err() {
            return;
        }
    }
}

fn serve_tcp(listener: &TcpListener, mut device: impl Talker, unplugged: &AtomicBool) {
    while !unplugged.load(Ordering::SeqCst) {
        let Ok((mut stream, _)) = listener.accept() else {
            std::thread::sleep(IDLE);
            continue;
        };
        if stream.set_nonblocking(false).and_then(|()| stream.set_read_timeout(Some(IDLE))).is_err()
        {
            continue;
        }
        let _ = stream.set_nodelay(true);
        device.connected();
        while !unplugged.load(Ordering::SeqCst) && listen(&mut device, &mut stream).is_ok() {}
    }
}

/// Read once, and let the device reply.
fn listen(device: &mut impl Talker, stream: &mut (impl Read + Write)) -> std::io::Result<()> {
    let mut buffer = [0; 512];
    match stream.read(&mut buffer) {
        Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
        Ok(count) => converse(device, stream, Some(&buffer[..count])),
        Err(error) if is_silence(&error) => converse(device, stream, None),
        Err(error) => Err(error),
    }
}

fn converse(
    device: &mut impl Talker,
    stream: &mut impl Write,
    heard: Option<&[u8]>,
) -> std::io::Result<()> {
    let mut failed = Ok(());
    let mut say = |bytes: &[u8]| {
        if let Err(error) = stream.write_all(bytes).and_then(|()| stream.flush()) {
            failed = Err(error);
        }
    };
    match heard {
        Some(bytes) => device.hear(bytes, &mut say),
        None => device.idle(&mut say),
    }
    failed
}
