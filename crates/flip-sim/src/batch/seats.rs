//! Procedures that act on one spoon each, such as weighings, side by side on one batch.
//!
//! ```text
//!   a thread for each place --asks--> the batch's thread: one step for all that ask --answers--> threads
//! ```
//!
//! A step begins as soon as every spoon in use is asked for a motion. A procedure without a spoon, such
//! as one whose bed settles, holds up nobody.

use super::super::dispense::Dispenser;
use super::{Batch, Failed, Filled, Motion, Stand};
use flip_core::domain::bench::PitchLimits;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};

/// What a thread says to the batch's, with the number of its place.
enum Said {
    /// Put a copy of this bed into the place.
    Fill(Arc<Dispenser>),
    Move(Motion),
    /// Its spoon is not used any more.
    Leave,
}

type Answer = Result<Stand, Failed>;

/// A place of a batch for one procedure after the other.
pub struct Place {
    number: usize,
    says: Sender<(usize, Said)>,
    answers: Receiver<Answer>,
}

impl Place {
    /// A spoon with a copy of this bed; dropping it gives the place back.
    ///
    /// # Errors
    /// The batch cannot compute it, or has failed.
    pub fn fill(&mut self, bed: &Arc<Dispenser>) -> Result<Seat<'_>, Failed> {
        let stand = self.ask(Said::Fill(bed.clone()))?;
        Ok(Seat { pitch: bed.pitch(), stand, place: self })
    }

    /// The same with a loose heap, which comes to rest in its place.
    ///
    /// # Errors
    /// The batch cannot compute it, or has failed.
    pub fn settle(&mut self, heap: Dispenser) -> Result<Seat<'_>, Failed> {
        let mut seat = self.fill(&Arc::new(heap))?;
        seat.stand = seat.place.ask(Said::Move(Motion::Settle))?;
        Ok(seat)
    }

    fn ask(&self, said: Said) -> Answer {
        let ended = || Failed("the batch has ended".to_owned());
        self.says.send((self.number, said)).map_err(|_| ended())?;
        self.answers.recv().unwrap_or_else(|_| Err(ended()))
    }
}

/// A filled spoon in a place of a batch.
pub struct Seat<'a> {
    place: &'a Place,
    pitch: PitchLimits,
    stand: Stand,
}

impl Seat<'_> {
    /// How it stands.
    pub fn stand(&self) -> &Stand {
        &self.stand
    }
}

impl Filled for Seat<'_> {
    /// A batch that fails is a fault of the spoon, which nothing moves then.
    fn carry_out(&mut self, motion: Motion) -> f64 {
        match self.place.ask(Said::Move(motion)) {
            Ok(stand) => self.stand = stand,
            Err(Failed(why)) => {
                self.stand.fault = Some(why);
                self.stand.duration_s = 0.0;
            }
        }
        self.stand.duration_s
    }
    fn pitch(&self) -> PitchLimits {
        self.pitch
    }
    fn pitch_deg(&self) -> f64 {
        self.stand.pitch_deg
    }
    fn vial_mg(&self) -> f64 {
        self.stand.vial_mg
    }
    fn spilled_mg(&self) -> f64 {
        self.stand.spilled_mg
    }
    fn fault(&self) -> Option<&str> {
        self.stand.fault.as_deref()
    }
}

impl Drop for Seat<'_> {
    fn drop(&mut self) {
        // Nobody listens once the batch has ended.
        let _ = self.place.says.send((self.place.number, Said::Leave));
    }
}

/// Carries out procedures 0 to `count`, each on a thread with a place of its own, as many at once as the
/// batch has places. `each` receives what each gives as soon as it has ended: in any order, but one at a
/// time. After `Break` no further procedure begins.
///
/// # Errors
/// The batch failed; procedures under way were told by the fault of their spoons, and `each` has received
/// what they gave.
///
/// # Panics
/// A procedure does.
pub fn side_by_side<T>(
    batch: &mut dyn Batch,
    count: usize,
    procedure: impl Fn(usize, &mut Place) -> T + Sync,
    each: &mut (dyn FnMut(usize, T) -> ControlFlow<()> + Send),
) -> Result<(), Failed> {
    let (next, over, each) = (AtomicUsize::new(0), AtomicBool::new(false), Mutex::new(each));
    let (says, heard) = channel();
    let work = |mut place: Place| {
        let _ends = EndsOnPanic(&over);
        while !over.load(Ordering::SeqCst) {
            let number = next.fetch_add(1, Ordering::SeqCst);
            if number >= count {
                break;
            }
            let given = procedure(number, &mut place);
            let mut each = each.lock().unwrap_or_else(PoisonError::into_inner);
            if (*each)(number, given).is_break() {
                over.store(true, Ordering::SeqCst);
            }
        }
    };
    std::thread::scope(|scope| {
        let mut answers = Vec::new();
        let mut threads = Vec::new();
        for number in 0..batch.places().min(count) {
            let (answer, answered) = channel();
            answers.push(answer);
            let place = Place { number, says: says.clone(), answers: answered };
            let work = &work;
            threads.push(scope.spawn(move || work(place)));
        }
        drop(says);
        let ended =
            Desk { batch, answers, over: &over, in_use: 0, asked: Vec::new(), failed: None }
                .serve(&heard);
        for thread in threads {
            thread.join().unwrap_or_else(|panic| resume_unwind(panic));
        }
        ended
    })
}

/// No further procedure begins once one has panicked.
struct EndsOnPanic<'a>(&'a AtomicBool);

impl Drop for EndsOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::SeqCst);
        }
    }
}

/// What stands between the threads and the batch.
struct Desk<'a> {
    batch: &'a mut dyn Batch,
    answers: Vec<Sender<Answer>>,
    over: &'a AtomicBool,
    /// Spoons that are used and not asked for a motion.
    in_use: usize,
    asked: Vec<(usize, Motion)>,
    failed: Option<Failed>,
}

impl Desk<'_> {
    /// Serves until every thread has gone.
    fn serve(mut self, heard: &Receiver<(usize, Said)>) -> Result<(), Failed> {
        while let Ok((place, said)) = heard.recv() {
            self.hear(place, said);
            // Whoever has a spoon by now takes part in the step.
            while let Ok((place, said)) = heard.try_recv() {
                self.hear(place, said);
            }
            if self.in_use == 0 && !self.asked.is_empty() {
                self.step();
            }
        }
        self.failed.map_or(Ok(()), Err)
    }

    fn hear(&mut self, place: usize, said: Said) {
        match said {
            Said::Fill(bed) => {
                let filled = match &self.failed {
                    Some(failed) => Err(failed.clone()),
                    None => self.batch.fill(&[(place, &bed)]),
                };
                match filled {
                    Ok(()) => {
                        self.in_use += 1;
                        self.answer(place, Ok(Stand::of(&bed, 0.0)));
                    }
                    Err(failed) => self.fail(place, failed),
                }
            }
            Said::Move(motion) => {
                self.in_use -= 1;
                self.asked.push((place, motion));
            }
            Said::Leave => self.in_use -= 1,
        }
    }

    fn step(&mut self) {
        let mut asked = std::mem::take(&mut self.asked);
        self.in_use += asked.len();
        if let Some(failed) = self.failed.clone() {
            return asked.iter().for_each(|(place, _)| self.answer(*place, Err(failed.clone())));
        }
        // In one order, whoever asked first.
        asked.sort_unstable_by_key(|(place, _)| *place);
        let stepped =
            self.batch.step(&asked).and_then(|stands| match stands.len() == asked.len() {
                true => Ok(stands),
                false => Err(Failed("the batch did not answer every spoon".to_owned())),
            });
        match stepped {
            Ok(stands) => {
                for ((place, _), stand) in asked.iter().zip(stands) {
                    self.answer(*place, Ok(stand));
                }
            }
            Err(failed) => {
                asked.iter().for_each(|(place, _)| self.fail(*place, failed.clone()));
            }
        }
    }

    fn fail(&mut self, place: usize, failed: Failed) {
        self.over.store(true, Ordering::SeqCst);
        self.failed.get_or_insert_with(|| failed.clone());
        self.answer(place, Err(failed));
    }

    fn answer(&self, place: usize, answer: Answer) {
        // A thread that asked waits for its answer.
        let _ = self.answers[place].send(answer);
    }
}
