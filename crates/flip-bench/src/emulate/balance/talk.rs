//! The emulated balance's side of the conversation.

use super::Shared;
use super::cell::Display;
use super::fault::Fault;
use super::request::{Outcome, Request, announcement, say, understand};
use crate::emulate::port::Talker;
use flip_core::domain::seed::derive;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Bench time of a reply that needs no measurement, s.
const ANSWER_S: f64 = 0.02;
/// Maximum length of an incomplete command that is kept, bytes.
const COMMAND_BYTES_MAX: usize = 128;

pub(super) struct Conversation {
    shared: Arc<Shared>,
    heard: Vec<u8>,
    /// The last line that showed the display.
    printed: Option<String>,
    answers: u64,
}

impl Talker for Conversation {
    fn connected(&mut self) {
        self.heard.clear();
    }

    fn idle(&mut self, tell: &mut dyn FnMut(&[u8])) {
        self.come_up(tell);
    }

    fn hear(&mut self, bytes: &[u8], tell: &mut dyn FnMut(&[u8])) {
        if self.shared.is_down() {
            self.heard.clear();
            return;
        }
        self.come_up(tell);
        self.heard.extend_from_slice(bytes);
        while let Some(command) = take_command(&mut self.heard) {
            self.answer(&command, tell);
        }
        if self.heard.len() > COMMAND_BYTES_MAX {
            self.heard.clear();
        }
    }
}

impl Conversation {
    pub(super) fn new(shared: Arc<Shared>) -> Self {
        Self { shared, heard: Vec::new(), printed: None, answers: 0 }
    }

    /// Send the unsolicited power-up line.
    fn come_up(&mut self, tell: &mut dyn FnMut(&[u8])) {
        if self.shared.is_down() || self.shared.rises().take().is_none() {
            return;
        }
        self.heard.clear();
        if let Some(words) = announcement(self.shared.settings.dialect) {
            tell(format!("{words}\r\n").as_bytes());
        }
    }

    fn answer(&mut self, command: &str, tell: &mut dyn FnMut(&[u8])) {
        let shared = self.shared.clone();
        let request = understand(shared.settings.dialect, command);
        if request == Request::Nothing || shared.has(Fault::Silence) {
            shared.faults().count_answer();
            return;
        }
        let outcome = self.carry_out(request);
        if let Some(line) = self.line(request, &outcome) {
            let unasked = shared.has(Fault::AutoPrint);
            if let Some(old) = self.printed.as_ref().filter(|_| unasked) {
                tell(format!("{old}\r\n").as_bytes());
            }
            self.tell_with_faults(&line, tell);
            if matches!(outcome, Outcome::Shows(Display::Mass { .. })) {
                self.printed = Some(line);
            }
            if unasked && let Some(new) = self.line(Request::Now, &self.show()) {
                tell(format!("{new}\r\n").as_bytes());
            }
        }
        shared.faults().count_answer();
    }

    fn line(&self, request: Request, outcome: &Outcome) -> Option<String> {
        say(self.shared.settings.dialect, request, outcome, self.shared.cell().is_tared())
    }

    fn carry_out(&self, request: Request) -> Outcome {
        match request {
            Request::Now => {
                self.wait_for_frame();
                self.show()
            }
            Request::WhenStable => self.when_stable(),
            Request::Tare { at_once } => self.change(at_once, |cell, _| {
                let (number, unit) = cell.tare();
                Outcome::Tared(number, unit)
            }),
            Request::Zero { at_once } => self.change(at_once, |cell, stable| {
                if cell.zero() { Outcome::Done { stable } } else { Outcome::OutOfRange }
            }),
            Request::TareValue => {
                let (number, unit) = self.shared.cell().tare_text();
                Outcome::Tared(number, unit)
            }
            Request::ClearTare => {
                self.shared.cell().clear_tare();
                Outcome::Done { stable: true }
            }
            Request::Words(_) | Request::Unknown | Request::Nothing => {
                self.shared.pan.clock().wait_s(ANSWER_S);
                Outcome::AsAsked
            }
        }
    }

    fn show(&self) -> Outcome {
        Outcome::Shows(self.shared.cell().show(&self.shared.faults()))
    }

    fn wait_for_frame(&self) {
        let wait_s = self.shared.cell().until_frame_s();
        self.shared.pan.clock().wait_s(wait_s);
    }

    /// Display frame after frame until one is stable or has no mass, or the balance's own timeout
    /// ends.
    fn when_stable(&self) -> Outcome {
        let clock = self.shared.pan.clock();
        let until_s = clock.now_s() + self.shared.settings.stable_timeout_s;
        while clock.now_s() < until_s && !self.shared.closing.load(Ordering::SeqCst) {
            self.wait_for_frame();
            match self.show() {
                Outcome::Shows(Display::Mass { stable: false, .. }) => {}
                shown => return shown,
            }
        }
        Outcome::NotStable
    }

    fn change(
        &self,
        at_once: bool,
        change: impl FnOnce(&mut super::cell::Cell, bool) -> Outcome,
    ) -> Outcome {
        let shown = if at_once { self.show() } else { self.when_stable() };
        match shown {
            Outcome::Shows(Display::Mass { stable, .. }) => change(&mut self.shared.cell(), stable),
            refused => refused,
        }
    }

    /// Send the line, with the active faults applied.
    fn tell_with_faults(&mut self, line: &str, tell: &mut dyn FnMut(&[u8])) {
        self.answers += 1;
        let mut bytes = format!("{line}\r\n").into_bytes();
        if self.shared.has(Fault::WrongDigit) {
            self.change_digit(&mut bytes);
        }
        if self.shared.has(Fault::GarbledLine) {
            let place = derive(self.shared.settings.seed, &[2, self.answers]) as usize % line.len();
            if self.answers.is_multiple_of(2) {
                bytes.remove(place);
            } else {
                bytes[place] = b"\xff#~\x07"[place % 4];
            }
        }
        if self.shared.has(Fault::PartialLine) {
            bytes.truncate(line.len() / 2);
        }
        if self.shared.has(Fault::SlowReply) {
            self.dawdle();
        }
        tell(&bytes);
    }

    /// Replace one digit with another, if there is one.
    fn change_digit(&self, bytes: &mut [u8]) {
        let chance = derive(self.shared.settings.seed, &[3, self.answers]);
        let mut digits: Vec<&mut u8> =
            bytes.iter_mut().filter(|byte| byte.is_ascii_digit()).collect();
        if let Some(place) = (chance as usize / 9).checked_rem(digits.len()) {
            let digit = *digits[place] - b'0';
            *digits[place] = b'0' + (digit + 1 + (chance % 9) as u8) % 10;
        }
    }

    fn dawdle(&self) {
        let until = Instant::now() + Duration::from_millis(self.shared.settings.slow_reply_ms);
        while Instant::now() < until && !self.shared.closing.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// The first complete command: up to CR or LF, or an escape sequence, which needs no terminator.
fn take_command(heard: &mut Vec<u8>) -> Option<String> {
    let end = match heard.as_slice() {
        [0x1b, letter, ..] if letter.is_ascii_uppercase() => 2,
        [0x1b, ..] => heard.iter().position(|byte| matches!(byte, b'_' | b'\r' | b'\n'))? + 1,
        _ => heard.iter().position(|byte| matches!(byte, b'\r' | b'\n'))? + 1,
    };
    let command: Vec<u8> = heard.drain(..end).collect();
    Some(String::from_utf8_lossy(&command).trim_end_matches(['\r', '\n', ' ']).to_owned())
}
