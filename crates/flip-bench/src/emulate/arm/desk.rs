//! A driver process around any robot: the contract's calls, modes, leases and dead-man, independent
//! of how it moves.

use super::body::{Answer, Asked, Body, Brake, End};
use super::dead_man::DeadMan;
use super::fault::Fault;
use super::service::{Service, watch_over};
use super::wires::Wires;
use crate::hardware::arm::proto::arm_server::ArmServer;
use crate::hardware::arm::proto::{self, Executed, Mode};
use std::net::{SocketAddr, TcpListener};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::{oneshot, watch};
use tonic::Status;

/// Reason for a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// A client requested it.
    Asked,
    /// Control was released.
    Released,
    /// Renewals stopped.
    DeadMan,
    /// A person cleared the latch.
    Recovered,
}

/// Carries out motions.
pub trait Robot: Send + 'static {
    /// Carry out one motion and return when it is at rest. The spoon's position is reported to
    /// `desk` on the way: [`Desk::show`], [`Desk::rest`] and [`Desk::arrive`]. When `brake` is set,
    /// stop at once and return its cause. The robot does not deal with the answer's sequence
    /// number.
    ///
    /// # Errors
    /// What ended it before it was complete.
    fn carry_out(
        &mut self,
        asked: Asked,
        why: Why,
        brake: &Brake,
        desk: &Desk,
    ) -> Result<Executed, End>;
}

/// Jobs of a robot's thread.
pub(super) enum Job {
    /// A client's motion.
    Motion {
        sequence: u64,
        asked: Asked,
        brake: Brake,
        answer: watch::Sender<Option<Result<Executed, Status>>>,
    },
    /// Level and retract.
    Return { why: Why, brake: Brake, answer: oneshot::Sender<Result<(), Status>> },
    /// The driver ends.
    Finish,
}

/// State shared by the threads of one driver.
pub struct Desk {
    began: Instant,
    description: proto::Description,
    dead_man: DeadMan,
    body: Mutex<Body>,
    jobs: Mutex<Sender<Job>>,
}

impl Desk {
    pub(super) fn locked(&self) -> MutexGuard<'_, Body> {
        self.body.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn dead_man(&self) -> DeadMan {
        self.dead_man
    }

    /// Report the spoon's pose while it moves. Never blocks, so that a control loop may call it:
    /// while the desk is busy the pose is dropped.
    pub fn show(&self, pitch_deg: f64, displacement_mm: f64) {
        if let Ok(mut body) = self.body.try_lock() {
            (body.pitch_deg, body.displacement_mm) = (pitch_deg, displacement_mm);
        }
    }

    /// Report the spoon's pose at rest.
    pub fn rest(&self, pitch_deg: f64, displacement_mm: f64) {
        let mut body = self.locked();
        (body.pitch_deg, body.displacement_mm) = (pitch_deg, displacement_mm);
    }

    /// Report that the spoon rests at this station, or has left it for [`proto::Station::Between`].
    pub fn arrive(&self, station: proto::Station) {
        self.locked().station = station;
    }

    /// Pitch in degrees and displacement along the spoon's axis in mm.
    pub fn pose(&self) -> (f64, f64) {
        let body = self.locked();
        (body.pitch_deg, body.displacement_mm)
    }

    /// Station of the spoon.
    pub fn station(&self) -> proto::Station {
        self.locked().station
    }

    pub(super) fn describe(&self) -> proto::Description {
        let latch_cause = self.locked().latch.unwrap_or_default().to_owned();
        proto::Description { latch_cause, ..self.description.clone() }
    }

    /// Accept a motion, or find the answer of the one it repeats.
    pub(super) fn accept(&self, ticket: &proto::Ticket, asked: Asked) -> Result<Answer, Status> {
        let mut body = self.locked();
        if let Some(first) =
            body.judge(&self.description, &ticket.lease_id, ticket.sequence, asked)?
        {
            return Ok(first);
        }
        let (say, answer) = watch::channel(None);
        let brake = body.begin(ticket.sequence, asked, answer.clone());
        // Sent under the lock, so that motions keep the order in which they were accepted.
        self.send(Job::Motion { sequence: ticket.sequence, asked, brake, answer: say });
        Ok(answer)
    }

    /// End the current motion, then level and retract on the driver's own initiative.
    pub(super) fn begin_return(
        &self,
        body: &mut Body,
        why: Why,
        end: End,
    ) -> oneshot::Receiver<Result<(), Status>> {
        let (answer, hear) = oneshot::channel();
        let brake = body.begin_return(end);
        self.send(Job::Return { why, brake, answer });
        hear
    }

    /// The next state to stream, and whether anything moves.
    pub(super) fn state(&self) -> (Result<proto::State, Status>, bool) {
        let body = self.locked();
        if body.has(Fault::StateStreamLost) {
            return (Err(Status::unavailable("the robot no longer says where it is")), false);
        }
        let state = proto::State {
            mode: body.mode.into(),
            station: body.station.into(),
            pitch_deg: body.pitch_deg,
            shake_displacement_mm: body.displacement_mm,
            last_shake: body.last_shake,
            measured_at_s: self.began.elapsed().as_secs_f64(),
        };
        (Ok(state), body.is_moving())
    }

    fn send(&self, job: Job) {
        // The thread ends only with the driver.
        let _ = self.jobs.lock().unwrap_or_else(PoisonError::into_inner).send(job);
    }

    /// Carry out jobs until the driver ends.
    fn work(&self, jobs: &Receiver<Job>, robot: &mut impl Robot) {
        while let Ok(job) = jobs.recv() {
            match job {
                Job::Motion { sequence, asked, brake, answer } => {
                    let done = robot.carry_out(asked, Why::Asked, &brake, self);
                    // Nobody may be waiting any more.
                    let _ = answer.send(Some(self.after(sequence, asked, &brake, done)));
                }
                Job::Return { why, brake, answer } => {
                    let _ = answer.send(self.bring_back(why, &brake, robot));
                }
                Job::Finish => return,
            }
        }
    }

    /// The answer to a client's motion; also sets the mode afterwards.
    fn after(
        &self,
        sequence: u64,
        asked: Asked,
        brake: &Brake,
        done: Result<Executed, End>,
    ) -> Result<Executed, Status> {
        let mut body = self.locked();
        let done =
            done.map(|executed| Executed { sequence, pitch_deg: body.pitch_deg, ..executed });
        match done {
            Ok(executed) if matches!(asked, Asked::Shake(_)) => body.last_shake = Some(executed),
            Err(End::Reflex | End::UserStop | End::LevelFails) => {
                body.latch(done.err().and_then(End::latch_cause))
            }
            _ => {}
        }
        body.settle(brake);
        done.map_err(End::status)
    }

    fn bring_back(&self, why: Why, brake: &Brake, robot: &mut impl Robot) -> Result<(), Status> {
        if self.locked().mode != Mode::Returning {
            return Err(Status::internal(
                "the arm was latched before it could bring the spoon back",
            ));
        }
        let end = robot.carry_out(Asked::Retract, why, brake, self).err();
        let mut body = self.locked();
        match (end, why) {
            (Some(end), _) => {
                body.latch(end.latch_cause());
                return Err(Status::internal("the spoon could not be brought back"));
            }
            (None, Why::DeadMan) => body.latch(End::DeadMan.latch_cause()),
            (None, _) => (body.mode, body.latch) = (Mode::Idle, None),
        }
        Ok(())
    }
}

/// A running driver process. It ends when this is dropped.
pub struct Driver {
    desk: Arc<Desk>,
    wires: Wires,
    address: SocketAddr,
    runtime: Option<tokio::runtime::Runtime>,
    hand: Option<JoinHandle<()>>,
}

impl Driver {
    /// Serve this robot, whose spoon is level and retracted, on a TCP address; port 0 picks a free
    /// one. A lease expires when it is not renewed for `dead_man` of wall-clock time.
    ///
    /// # Errors
    /// The system has no port or thread left.
    pub fn serve(
        address: SocketAddr,
        description: proto::Description,
        dead_man: Duration,
        robot: impl Robot,
    ) -> std::io::Result<Self> {
        Self::start(address, description, DeadMan { limit: dead_man, forgives: false }, robot)
    }

    pub(super) fn start(
        address: SocketAddr,
        description: proto::Description,
        dead_man: DeadMan,
        mut robot: impl Robot,
    ) -> std::io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let (send, jobs) = channel();
        let body = Mutex::new(Body::new());
        let desk = Arc::new(Desk {
            began: Instant::now(),
            description,
            dead_man,
            body,
            jobs: Mutex::new(send),
        });
        let working = desk.clone();
        let thread = std::thread::Builder::new().name("robot".to_owned());
        let hand = Some(thread.spawn(move || working.work(&jobs, &mut robot))?);
        let wires = Wires::default();
        let runtime = Some(listen(listener, &desk, &wires)?);
        Ok(Self { desk, wires, address, runtime, hand })
    }

    /// The address clients connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) fn desk(&self) -> &Desk {
        &self.desk
    }

    pub(super) fn wires(&self) -> &Wires {
        &self.wires
    }

    /// Starve the driver of CPU time for this long.
    #[cfg(test)]
    pub(super) fn hold_up(&self, held: Duration) {
        let (say, hear) = channel();
        if let Some(runtime) = &self.runtime {
            runtime.spawn(async move {
                std::thread::sleep(held);
                let _ = say.send(());
            });
        }
        let _ = hear.recv();
    }
}

impl Drop for Driver {
    fn drop(&mut self) {
        let _ = self.desk.locked().brake.set(End::DeadMan);
        self.desk.send(Job::Finish);
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
        if let Some(hand) = self.hand.take() {
            let _ = hand.join();
        }
    }
}

fn listen(
    listener: TcpListener,
    desk: &Arc<Desk>,
    wires: &Wires,
) -> std::io::Result<tokio::runtime::Runtime> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    let runtime = builder.worker_threads(1).thread_name("arm driver").enable_all().build()?;
    let entered = runtime.enter();
    let incoming = wires.accept(listener)?;
    drop(entered);
    let service = ArmServer::new(Service(desk.clone()));
    runtime.spawn(
        tonic::transport::Server::builder().add_service(service).serve_with_incoming(incoming),
    );
    runtime.spawn(watch_over(desk.clone()));
    Ok(runtime)
}
