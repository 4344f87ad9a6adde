//! `flip emulate`: emulated devices, for trying out FLIP and for testing other software that talks
//! to such devices.

use super::Common;
use super::failure::Failure;
use super::session::{StopSignals, runtime};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flip_bench::emulate::arm::{self, Arm, Flow, FormulaSpoon, Spoon};
use flip_bench::emulate::balance::{self, Balance, Socket};
use flip_bench::emulate::camera::{
    CameraFault, Noise, Optics, Pose, Scene, Studio, Surface, faulty_uploads, frames, upload,
};
use flip_bench::emulate::gate::{self, EmulatedGate, Slide};
use flip_bench::emulate::gripper::{self, EmulatedGripper, Fingers};
use flip_bench::emulate::hidden::{self, Hidden};
use flip_bench::emulate::lab::{self, Laboratory};
use flip_bench::emulate::pan::Pan;
use flip_bench::emulate::port::Port;
use flip_bench::hardware::balance::Dialect;
use flip_bench::hardware::camera::Upload;
use flip_bench::hardware::clock::Clock;
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::{FieldError, bounded};
use flip_sim::dispense;
use serde::Serialize;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Mass on an emulated balance that runs on its own, mg.
const VIAL_MG: f64 = 12_000.0;

/// Arguments of `flip emulate`.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
    /// Bench seconds per wall-clock second.
    #[arg(long, global = true, value_name = "FACTOR", default_value_t = 1.0)]
    speed: f64,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Balance, arm, gripper and gate around one vial; writes a bench file that points to them.
    Lab(LabArguments),
    /// A balance with a vial on it.
    Balance(BalanceArguments),
    /// An arm with a spoon of powder and nothing below it.
    Arm(DeviceArguments),
    /// A gripper holding a spoon.
    Gripper(DeviceArguments),
    /// A slide gate.
    Gate(DeviceArguments),
    /// A depth camera over a cone of powder: writes frames as files ready to upload, then exits.
    Camera(CameraArguments),
}

#[derive(Debug, clap::Args)]
struct LabArguments {
    /// Bench file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Protocol of the balance.
    #[arg(long, value_name = "NAME", default_value = "mt_sics")]
    dialect: Dialect,
    /// Readability (display step) of the balance, mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0)]
    readability_mg: f64,
    /// Model the powder with a formula instead of simulated grains: thousands of doses a minute.
    #[arg(long)]
    formula: bool,
    /// Seed of a mechanism hidden in the powder; 0 hides none. Only that something is hidden is
    /// said.
    #[arg(long, value_name = "SEED", default_value_t = 0, conflicts_with = "formula")]
    hidden: u64,
    /// Say what is hidden.
    #[arg(long, requires = "hidden")]
    reveal: bool,
    /// File to append each motion to, one JSON document per line.
    #[arg(long, value_name = "FILE")]
    motions: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct BalanceArguments {
    /// Protocol of the balance.
    #[arg(long, value_name = "NAME", default_value = "mt_sics")]
    dialect: Dialect,
    /// Readability (display step), mg.
    #[arg(long, value_name = "MG", default_value_t = 1.0)]
    readability_mg: f64,
    /// TCP address to listen on; without it, a pseudo-terminal.
    #[arg(long, value_name = "ADDRESS")]
    listen: Option<SocketAddr>,
    /// Fault to emulate: draught, auto_print, partial_line and others; a wrong name lists them.
    #[arg(long, value_name = "NAME")]
    fault: Option<balance::Fault>,
}

#[derive(Debug, clap::Args)]
struct CameraArguments {
    /// Folder for frame-01.json and so on, each the body of one upload.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Angle of the cone, 5 to 80 deg.
    #[arg(long, value_name = "DEG", default_value_t = 35.0, allow_negative_numbers = true)]
    repose_deg: f64,
    /// Number of frames, 1 to 100.
    #[arg(long, value_name = "N", default_value_t = 10, allow_negative_numbers = true)]
    frames: u32,
    /// Fault to emulate: holes, heavy_noise, funnel_missing and others; a wrong name lists them. A
    /// faulty camera takes at most ten frames.
    #[arg(long, value_name = "NAME")]
    fault: Option<CameraFault>,
}

#[derive(Debug, clap::Args)]
struct DeviceArguments {
    /// Fault to emulate; a wrong name lists them.
    #[arg(long, value_name = "NAME")]
    fault: Option<String>,
}

/// A running device and its address.
#[derive(Debug, Serialize)]
struct Document {
    device: &'static str,
    /// A path, `tcp://host:port`, `http://host:port`, or the bench file.
    address: String,
    /// Whether a mechanism is hidden in the powder.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    hides: bool,
    /// Which and how strong, if it is to be revealed.
    #[serde(skip_serializing_if = "Option::is_none")]
    hidden: Option<Revealed>,
}

/// What is hidden.
#[derive(Debug, Serialize)]
struct Revealed {
    mechanism: &'static str,
    size: f64,
}

/// Runs it until asked to stop.
pub(super) fn run(common: &Common, arguments: &Arguments) -> Result<(), Failure> {
    if !(arguments.speed.is_finite() && (0.1..=1000.0).contains(&arguments.speed)) {
        let advice = format!("must be from 0.1 to 1000, got {}", arguments.speed);
        return Err(FieldError::new("speed", advice).into());
    }
    let clock = Clock::fast(arguments.speed);
    match &arguments.what {
        What::Lab(lab) => laboratory(common, lab, clock),
        What::Balance(asked) => {
            let settings = balance::Settings {
                dialect: asked.dialect,
                readability_mg: asked.readability_mg,
                seed: common.seed,
                ..balance::Settings::default()
            };
            let socket = asked.listen.map_or(Socket::Pty, Socket::Tcp);
            let mut device =
                Balance::start(settings.checked()?, Pan::holding(VIAL_MG, clock), socket)?;
            asked.fault.into_iter().for_each(|fault| device.inject(fault));
            until_stopped(common, "balance", device.address())
        }
        What::Arm(asked) => {
            let pan = Pan::holding(VIAL_MG, clock);
            let device = Arm::start(arm::Settings::default(), pan, spoon(common, false, None))?;
            if let Some(fault) = fault::<arm::Fault>(asked)? {
                device.inject(fault);
            }
            until_stopped(common, "arm", device.url())
        }
        What::Gripper(asked) => {
            let fingers = Fingers::holding(clock);
            if let Some(fault) = fault::<gripper::Fault>(asked)? {
                fingers.cause(fault, u32::MAX);
            }
            let port = Port::pty(EmulatedGripper::new(fingers))?;
            until_stopped(common, "gripper", port.address())
        }
        What::Gate(asked) => {
            let slide = Slide::new(gate::Settings::default(), clock);
            if let Some(fault) = fault::<gate::Fault>(asked)? {
                slide.cause(fault, u32::MAX);
            }
            let port = Port::pty(EmulatedGate::new(slide))?;
            until_stopped(common, "gate", port.address())
        }
        What::Camera(asked) => photograph(common, asked),
    }
}

fn photograph(common: &Common, asked: &CameraArguments) -> Result<(), Failure> {
    let CameraArguments { out, fault, .. } = asked;
    let deg = bounded("repose_deg", asked.repose_deg, 5.0, 80.0, "deg")?;
    let count = bounded("frames", f64::from(asked.frames), 1.0, 100.0, "frames")? as usize;
    let scene = Scene::of(Surface::Cone(Studio::drawn(deg, common.seed).cone));
    let uploads = match fault {
        Some(fault) => faulty_uploads(*fault, &scene, &Optics::default(), common.seed),
        None => {
            let taken = frames(
                &scene,
                &Pose::default(),
                &Optics::default(),
                &Noise::default(),
                common.seed,
                count,
            );
            taken.iter().map(upload).collect()
        }
    };
    std::fs::create_dir_all(out)?;
    for (k, Upload { depth, colour, description }) in
        uploads.map_err(anyhow::Error::from)?.into_iter().enumerate()
    {
        let description: serde_json::Value = serde_json::from_slice(&description)?;
        let [depth, colour] = [depth, colour].map(|bytes| STANDARD.encode(bytes));
        let body =
            serde_json::json!({ "depth": depth, "colour": colour, "description": description });
        std::fs::write(out.join(format!("frame-{:02}.json", k + 1)), body.to_string())?;
    }
    let document = Document::of("camera", &out.display().to_string());
    common.print(&document, || format!("frames of a cone of {deg} deg in {}", out.display()))
}

fn fault<F: std::str::FromStr<Err = FieldError>>(
    asked: &DeviceArguments,
) -> Result<Option<F>, FieldError> {
    asked.fault.as_deref().map(str::parse).transpose()
}

/// A spoon of the default powder, with what is hidden in it.
fn spoon(common: &Common, formula: bool, hidden: Option<Hidden>) -> Box<dyn Spoon> {
    match formula {
        true => Box::new(FormulaSpoon::new(Flow::default(), common.seed)),
        false => {
            let shake = arm::Settings::DEFAULT.executed();
            let shaken = dispense::Settings { shake, ..dispense::Settings::default() };
            hidden::spoon(hidden, &ParameterSet::default(), &shaken, common.seed)
        }
    }
}

fn laboratory(common: &Common, asked: &LabArguments, clock: Clock) -> Result<(), Failure> {
    let settings = balance::Settings {
        dialect: asked.dialect,
        readability_mg: asked.readability_mg,
        seed: common.seed,
        ..balance::Settings::default()
    };
    let settings = lab::Settings { balance: settings.checked()?, ..lab::Settings::default() };
    let hidden = Hidden::drawn(asked.hidden);
    let laboratory = Laboratory::start(settings, clock, spoon(common, asked.formula, hidden))?;
    let text = toml::to_string(&laboratory.file()).map_err(anyhow::Error::from)?;
    std::fs::write(&asked.out, text)?;
    let motions = asked.motions.clone().map(|path| Motions { path, written: 0 });
    runtime()?.block_on(async {
        let mut signals = StopSignals::catch()?;
        let document = Document::of("lab", &asked.out.display().to_string());
        say(common, document.hiding(hidden, asked.reveal))?;
        let Some(mut motions) = motions else {
            signals.received().await;
            return Ok(());
        };
        loop {
            tokio::select! {
                _ = signals.received() => return motions.append(&laboratory),
                () = tokio::time::sleep(std::time::Duration::from_millis(20)) => motions.append(&laboratory)?,
            }
        }
    })
}

/// Log of the arm's motions, as a file for other programs.
struct Motions {
    path: PathBuf,
    written: usize,
}

/// One motion of the arm.
#[derive(Debug, Serialize)]
struct Motion {
    at_s: f64,
    motion: String,
    why: String,
    ended: Option<String>,
    pitch_deg: f64,
    poured_mg: f64,
    /// Powder in the vial once everything has landed, mg.
    vial_mg: f64,
}

impl Motions {
    fn append(&mut self, laboratory: &Laboratory) -> Result<(), Failure> {
        use std::io::Write;
        let events = laboratory.arm.log();
        if events.len() == self.written {
            return Ok(());
        }
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(&self.path)?;
        for event in &events[self.written..] {
            let motion = Motion {
                at_s: event.at_s,
                motion: format!("{:?}", event.motion),
                why: format!("{:?}", event.why),
                ended: event.ended.map(|end| format!("{end:?}")),
                pitch_deg: event.pitch_deg,
                poured_mg: event.poured_mg,
                vial_mg: laboratory.dispensed_mg(),
            };
            writeln!(file, "{}", serde_json::to_string(&motion)?)?;
        }
        self.written = events.len();
        Ok(())
    }
}

impl Document {
    fn of(device: &'static str, address: &str) -> Self {
        Self { device, address: address.to_owned(), hides: false, hidden: None }
    }

    /// The same with something hidden in it, which is said or not.
    fn hiding(self, hidden: Option<Hidden>, is_revealed: bool) -> Self {
        let revealed = |it: Hidden| Revealed { mechanism: it.mechanism.name(), size: it.size };
        let told = hidden.filter(|_| is_revealed).map(revealed);
        Self { hides: hidden.is_some(), hidden: told, ..self }
    }

    fn text(&self) -> String {
        let Self { device, address, .. } = self;
        let hidden = match (&self.hidden, self.hides) {
            (Some(it), _) => format!("\nhidden in the powder: {}, {:.3}", it.mechanism, it.size),
            (None, true) => "\nsomething is hidden in the powder: --reveal says what".to_owned(),
            (None, false) => String::new(),
        };
        format!("{device} at {address}, until Ctrl-C{hidden}")
    }
}

fn say(common: &Common, document: Document) -> Result<(), Failure> {
    common.print(&document, || document.text())
}

fn until_stopped(common: &Common, device: &'static str, address: &str) -> Result<(), Failure> {
    runtime()?.block_on(async {
        let mut signals = StopSignals::catch()?;
        say(common, Document::of(device, address))?;
        signals.received().await;
        Ok(())
    })
}
