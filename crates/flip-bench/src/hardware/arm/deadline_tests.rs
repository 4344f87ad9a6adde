//! Is the driver told how long a motion may take?

use super::{Arm, proto};
use crate::emulate::arm as emulated;
use crate::emulate::pan::Pan;
use crate::hardware::bench_file::ArmAddress;
use crate::hardware::clock::Clock;
use crate::hardware::wire::Tap;
use prost::Message;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

/// Passes on what `from` says to `to`, and keeps it.
fn pass_on(mut from: TcpStream, mut to: TcpStream, kept: Arc<Mutex<Vec<u8>>>) {
    std::thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            kept.lock().unwrap().extend(&bytes[..count]);
            if to.write_all(&bytes[..count]).is_err() {
                return;
            }
        }
    });
}

/// A listener in front of a driver: its URL, and what clients have sent.
fn overheard(driver: &str) -> (String, Arc<Mutex<Vec<u8>>>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let driver = driver.trim_start_matches("http://").to_owned();
    let sent = Arc::<Mutex<Vec<u8>>>::default();
    let kept = sent.clone();
    std::thread::spawn(move || {
        for client in listener.incoming().flatten() {
            let server = TcpStream::connect(&driver).unwrap();
            pass_on(client.try_clone().unwrap(), server.try_clone().unwrap(), kept.clone());
            pass_on(server, client, Arc::default());
        }
    });
    (url, sent)
}

#[test]
fn a_deadline_of_the_bench_file_is_what_the_driver_reads() {
    let clock = Clock::standing();
    let spoon = emulated::FormulaSpoon::new(emulated::Flow::default(), 1);
    let settings = emulated::Settings { dead_man_ms: 20_000, ..emulated::Settings::DEFAULT };
    let pan = Pan::holding(11_000.0, clock);
    let driver = emulated::Arm::start(settings, pan, Box::new(spoon)).unwrap();
    let (url, sent) = overheard(driver.url());
    let address = ArmAddress { url, motion_s: Some(41.0) };
    let mut arm = Arm::connect(&address.url, Tap::none(), address.deadlines()).unwrap();
    arm.acquire().unwrap();
    arm.approach().unwrap();
    let deadline = proto::Ticket { deadline_ms: 41_000, ..proto::Ticket::default() };
    let field = deadline.encode_to_vec();
    assert!(sent.lock().unwrap().windows(field.len()).any(|bytes| bytes == field));
}
