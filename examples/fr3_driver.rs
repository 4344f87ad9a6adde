//! A driver process for a Franka Research 3, as required by `proto/flip/bench/v1/arm.proto`.
//!
//! It has been compiled and never run on a robot. Before it moves one:
//! * The machine wired to the robot needs a PREEMPT_RT kernel and the right to set real-time
//!   priorities: the control loop has 1 ms.
//! * The crate's notes keep a caveat about validating its impedance control on an FR3; this driver
//!   uses the robot's own Cartesian impedance controller.
//! * The end effector's frame is set in the robot's administration: origin in the middle of the
//!   spoon's bowl, x towards the tip, y across to the left, z up when the spoon is level.
//! * Collision thresholds below are guesses for a light gripper and spoon. Try every motion without
//!   powder, slowly, the user stop in hand.
//! * There is no scoop, discard or invert: these depend on the container. They return
//!   UNIMPLEMENTED.
//!
//! ```text
//! cargo run --release --features franka --example fr3_driver -- 172.16.0.2 0.0.0.0:50061 way.json
//! ```
//!
//! `way.json` is a list of points in the robot's base frame, m, from the retracted station to over
//! the vial: `[[0.4,0.2,0.3],[0.5,0.0,0.3]]`. The spoon goes straight from one to the next and
//! keeps its orientation. On start the robot must stand at the first, the spoon level.

use flip::telemetry;
use flip_bench::emulate::arm::{Asked, Brake, Desk, Driver, End, Robot, Why};
use flip_bench::hardware::arm::PROTOCOL_VERSION;
use flip_bench::hardware::arm::proto::{Description, Executed, Limits, Station};
use flip_bench::hardware::waypoints::Stroke;
use flip_core::domain::bench::PitchLimits;
use flip_core::domain::motion::{MotionLimits, Move, TurnLimits};
use franka::{
    CartesianPose, ControllerMode, MAX_CUTOFF_FREQUENCY, RealtimeConfig, RobotMode, motion_finished,
};
use std::error::Error;
use std::time::Duration;

/// From full speed to rest when a motion is ended, s.
const BRAKING_S: f64 = 0.04;
/// Tolerance on the retracted spoon's position on start, m, and on its level (sine of the angle).
const START: [f64; 2] = [0.002, 0.02];
/// Largest amplitude of a shake, mm.
const SHAKE_MM_MAX: f64 = 16.0;
/// Control cycles over which the measured speed is taken.
const SPEED_CYCLES: usize = 10;
/// Collision thresholds of joints, Nm, and of the end effector, N and Nm.
const JOINTS_NM: [f64; 7] = [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0];
const SPOON_N: [f64; 6] = [15.0, 15.0, 15.0, 15.0, 15.0, 15.0];

/// A point in the base frame, m.
type Point = [f64; 3];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [robot, listen, way] = arguments.as_slice() else {
        return Err("usage: fr3_driver <robot> <address to listen on> <way.json>".into());
    };
    let way: Vec<Point> = serde_json::from_str(&std::fs::read_to_string(way)?)?;
    if way.len() < 2 || way.iter().flatten().any(|number| !number.is_finite()) {
        return Err("the way must have two points or more, all of them numbers".into());
    }
    stands_at(robot, &way[0])?;
    // A motion must not wait for a reader of the log, nor end because there is none.
    telemetry::start(telemetry::Format::Text, telemetry::COMMAND);
    let fr3 = Fr3 { address: robot.clone(), way, reached: 0, robot: None };
    let driver = Driver::serve(listen.parse()?, description(), Duration::from_millis(300), fr3)?;
    telemetry::say(format_args!("serving {robot} on {}", driver.address()));
    loop {
        std::thread::park();
    }
}

/// The contract gives control only of a spoon known to be level and retracted.
fn stands_at(address: &str, retracted: &Point) -> Result<(), Box<dyn Error>> {
    let pose = franka::Robot::new(address, RealtimeConfig::Ignore)?.read_once()?.O_T_EE;
    let away = (0..3).map(|k| (pose[12 + k] - retracted[k]).powi(2)).sum::<f64>().sqrt();
    if away > START[0] || pose[2].abs() > START[1] {
        return Err(
            "the spoon is not level at the first point of the way: bring it there by hand".into()
        );
    }
    Ok(())
}

fn description() -> Description {
    Description {
        protocol_version: PROTOCOL_VERSION,
        name: "Franka Research 3".to_owned(),
        serial: "not known to the driver".to_owned(),
        driver_version: env!("CARGO_PKG_VERSION").to_owned(),
        limits: Some(Limits {
            pitch_deg_min: PitchLimits::PAPER.lower_deg,
            pitch_deg_max: PitchLimits::PAPER.upper_deg,
            pitch_deg_s_max: TurnLimits::DEFAULT.velocity_deg_s,
            shake_mm_max: SHAKE_MM_MAX,
            velocity_m_s_max: MotionLimits::PAPER.velocity_m_s,
            acceleration_m_s2_max: MotionLimits::PAPER.acceleration_m_s2,
            jerk_m_s3_max: MotionLimits::PAPER.jerk_m_s3,
        }),
        can_scoop: false,
        can_discard: false,
        can_invert: false,
        is_emulated: false,
        latch_cause: String::new(),
    }
}

/// The robot and its position on the way.
struct Fr3 {
    address: String,
    way: Vec<Point>,
    /// The last point of the way that was reached.
    reached: usize,
    /// Connected by the control thread, whose priority the connection raises.
    robot: Option<franka::Robot>,
}

/// Where the spoon is relative to the start of a path: turned about its width, shifted along its
/// axis, moved in the base frame.
#[derive(Clone, Copy, Default)]
struct Offset {
    turned_deg: f64,
    along_m: f64,
    moved_m: Point,
}

/// Measurements along a path.
#[derive(Default)]
struct Measured {
    furthest_m: f64,
    top_m_s: f64,
    duration_s: f64,
}

impl Robot for Fr3 {
    fn carry_out(
        &mut self,
        asked: Asked,
        why: Why,
        brake: &Brake,
        desk: &Desk,
    ) -> Result<Executed, End> {
        self.ready(why)?;
        let measured = match asked {
            Asked::Pitch(deg) => self.turn(deg, brake, desk)?,
            Asked::Shake(mm) => self.shake(mm, brake, desk)?,
            Asked::Approach => self.travel(self.way.len() - 1, Station::OverVial, brake, desk)?,
            Asked::Retract => {
                self.turn(0.0, brake, desk)?;
                self.travel(0, Station::Retracted, brake, desk)?
            }
            // The desk refuses anything the description does not offer.
            Asked::Scoop | Asked::Discard | Asked::Invert => return Err(End::Reflex),
        };
        let is_shake = matches!(asked, Asked::Shake(_));
        Ok(Executed {
            amplitude_mm: if is_shake { measured.furthest_m * 1e3 } else { 0.0 },
            peak_speed_m_s: if is_shake { measured.top_m_s } else { 0.0 },
            duration_s: measured.duration_s,
            ..Executed::default()
        })
    }
}

impl Fr3 {
    /// Connects, and recovers from errors once a person has checked.
    fn ready(&mut self, why: Why) -> Result<(), End> {
        if self.robot.is_none() {
            let robot =
                franka::Robot::new(&self.address, RealtimeConfig::Enforce).map_err(failed)?;
            let (joints, spoon) = (JOINTS_NM, SPOON_N);
            robot
                .set_collision_behavior(joints, joints, joints, joints, spoon, spoon, spoon, spoon)
                .map_err(failed)?;
            self.robot = Some(robot);
        }
        match (&self.robot, why) {
            (Some(robot), Why::Recovered) => robot.automatic_error_recovery().map_err(failed),
            _ => Ok(()),
        }
    }

    /// Turns to this pitch; an interrupted stroke is brought back on the way.
    fn turn(&mut self, to_deg: f64, brake: &Brake, desk: &Desk) -> Result<Measured, End> {
        let (from_deg, displacement_mm) = desk.pose();
        let back = Move::new(displacement_mm.abs() * 1e-3, MotionLimits::PAPER);
        let sign = -displacement_mm.signum();
        self.follow(back.duration_s(), brake, desk, |t| Offset {
            along_m: sign * back.position_m(t),
            ..Offset::default()
        })?;
        desk.rest(from_deg, 0.0);
        let turn = Move::new((to_deg - from_deg).abs(), TurnLimits::DEFAULT.into());
        let sign = (to_deg - from_deg).signum();
        let turned = |t| Offset { turned_deg: sign * turn.position_m(t), ..Offset::default() };
        let measured = self.follow(turn.duration_s(), brake, desk, turned)?;
        desk.rest(to_deg, 0.0);
        Ok(measured)
    }

    fn shake(&mut self, amplitude_mm: f64, brake: &Brake, desk: &Desk) -> Result<Measured, End> {
        let stroke = Stroke::new(amplitude_mm * 1e-3, MotionLimits::PAPER);
        let shaken = |t| Offset { along_m: stroke.at(t).position, ..Offset::default() };
        let measured = self.follow(stroke.duration_s(), brake, desk, shaken)?;
        desk.rest(desk.pose().0, 0.0);
        Ok(measured)
    }

    /// Moves along the way to one of its ends, point by point.
    fn travel(
        &mut self,
        to: usize,
        station: Station,
        brake: &Brake,
        desk: &Desk,
    ) -> Result<Measured, End> {
        let mut whole = Measured::default();
        if desk.station() == station {
            return Ok(whole);
        }
        desk.arrive(Station::Between);
        loop {
            // A travel interrupted between two points goes back over the last one reached.
            if to > self.reached {
                self.straight(self.reached + 1, brake, desk, &mut whole)?;
                self.reached += 1;
            } else {
                self.straight(self.reached, brake, desk, &mut whole)?;
                if self.reached == to {
                    break;
                }
                self.reached -= 1;
            }
        }
        desk.arrive(station);
        Ok(whole)
    }

    fn straight(
        &mut self,
        to: usize,
        brake: &Brake,
        desk: &Desk,
        whole: &mut Measured,
    ) -> Result<(), End> {
        let robot = self.robot.as_ref().ok_or(End::Reflex)?;
        let here = robot.read_once().map_err(failed)?.O_T_EE_c;
        let way: Point = std::array::from_fn(|k| self.way[to][k] - here[12 + k]);
        let length_m = way.iter().map(|d| d * d).sum::<f64>().sqrt();
        if length_m < 1e-6 {
            return Ok(());
        }
        let path = Move::new(length_m, MotionLimits::PAPER);
        let moved = |t: f64| way.map(|d| d * path.position_m(t) / length_m);
        let done = self.follow(path.duration_s(), brake, desk, |t| Offset {
            moved_m: moved(t),
            ..Offset::default()
        })?;
        whole.duration_s += done.duration_s;
        Ok(())
    }

    /// Follows a path at 1 kHz. When the brake is set, time on the path slows to a stop within
    /// [`BRAKING_S`].
    fn follow(
        &self,
        duration_s: f64,
        brake: &Brake,
        desk: &Desk,
        path: impl Fn(f64) -> Offset,
    ) -> Result<Measured, End> {
        let robot = self.robot.as_ref().ok_or(End::Reflex)?;
        if duration_s == 0.0 {
            return Ok(Measured::default());
        }
        let (mut on_path_s, mut rate) = (0.0f64, 1.0f64);
        let (mut measured, mut start, mut measured_start) = (Measured::default(), None, [0.0; 16]);
        let mut lately = [0.0; SPEED_CYCLES];
        let mut cycles = 0;
        let (pitch_deg, displacement_mm) = desk.pose();
        let outcome = robot.control_cartesian_pose(
            |state, period| {
                let dt = period.as_secs_f64();
                let base = *start.get_or_insert_with(|| {
                    measured_start = state.O_T_EE;
                    state.O_T_EE_c
                });
                if brake.get().is_some() {
                    rate = (rate - dt / BRAKING_S).max(0.0);
                }
                on_path_s += dt * rate;
                measured.duration_s += dt;
                let offset = path(on_path_s.min(duration_s));
                let along = (0..3)
                    .map(|k| (state.O_T_EE[12 + k] - measured_start[12 + k]) * base[k])
                    .sum::<f64>();
                measured.furthest_m = measured.furthest_m.max(along);
                let before = std::mem::replace(&mut lately[cycles % SPEED_CYCLES], along);
                cycles += 1;
                if cycles > SPEED_CYCLES {
                    measured.top_m_s =
                        measured.top_m_s.max((along - before).abs() / (1e-3 * SPEED_CYCLES as f64));
                }
                desk.show(pitch_deg + offset.turned_deg, displacement_mm + offset.along_m * 1e3);
                let command = CartesianPose::new(placed(&base, &offset));
                if on_path_s >= duration_s || rate == 0.0 {
                    motion_finished(command)
                } else {
                    command
                }
            },
            ControllerMode::CartesianImpedance,
            true,
            MAX_CUTOFF_FREQUENCY,
        );
        match (outcome, brake.get()) {
            (Err(error), _) => Err(self.after(error)),
            (Ok(()), Some(end)) if on_path_s < duration_s => Err(*end),
            _ => Ok(measured),
        }
    }

    /// Why the robot ended a motion by itself.
    fn after(&self, error: franka::FrankaError) -> End {
        let mode = self
            .robot
            .as_ref()
            .and_then(|robot| robot.read_once().ok())
            .map(|state| state.robot_mode);
        match mode {
            Some(RobotMode::UserStopped) => End::UserStop,
            _ => failed(error),
        }
    }
}

fn failed(error: franka::FrankaError) -> End {
    telemetry::say(format_args!("the robot: {error}"));
    End::Reflex
}

/// A pose (column-major, as the robot takes it) with an offset.
fn placed(base: &[f64; 16], offset: &Offset) -> [f64; 16] {
    let (sin, cos) = offset.turned_deg.to_radians().sin_cos();
    let mut pose = *base;
    for k in 0..3 {
        let (x, z) = (base[k], base[8 + k]);
        (pose[k], pose[8 + k]) = (x * cos - z * sin, x * sin + z * cos);
        pose[12 + k] = base[12 + k] + offset.moved_m[k] + offset.along_m * x;
    }
    pose
}
