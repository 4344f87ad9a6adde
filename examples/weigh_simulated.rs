//! The story of one weighing: a full spoon over a vial, a controller that proposes, a guard that
//! decides, a balance.
//!
//! `cargo run --release --example weigh_simulated [target mg] [seed]`

use flip_bench::hardware::simulated::SimulatedBench;
use flip_bench::weigh::{Event, Order, Settings, weigh};
use flip_core::domain::parameters::ParameterSet;
use flip_policy::{Controller, Rules, ScheduledStep};
use flip_sim::{balance, dispense};
use std::ops::ControlFlow;
use std::sync::atomic::AtomicBool;

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let target_mg = arguments.next().map_or(Ok(15.0), |text| text.parse())?;
    let seed = arguments.next().map_or(Ok(1), |text| text.parse())?;

    // A powder that flows about as well as salt, in the spoon of a simulated bench.
    let powder = ParameterSet::default().with("friction", 0.8)?;
    let mut bench = SimulatedBench::new(
        &powder,
        &dispense::Settings::default(),
        &balance::Settings::default(),
        seed,
    );

    // Gentle shakes at a slant. A learned policy is `Controller::Learned`, and nothing else
    // changes.
    let controller = Controller::Fixed(ScheduledStep { pitch_deg: 24.0, shake_mm: 8.0 });
    let order =
        Order { target_mg, tolerance_lower_mg: 1.0, tolerance_upper_mg: 1.0, readability_mg: 1.0 };
    // The listener gets each phase and decision before the motion that follows, and could veto it.
    let print = |event: &Event<'_>| {
        match event {
            Event::Phase(phase) => println!("{phase:?}"),
            Event::Pan(flaw) => println!("{flaw}"),
            Event::Decision(decision) => {
                decision.reason.iter().for_each(|reason| println!("    {reason}"))
            }
            Event::Tick(tick) => println!(
                "{:>2}  {:5.1} s  pitch {:5.1} deg  shake {:4.1} mm  balance {:5.1} mg",
                tick.step, tick.t_s, tick.pitch_deg, tick.action.shake_mm, tick.reading.mass_mg
            ),
        }
        ControlFlow::Continue(())
    };
    let (rules, settings, stop) = (Rules::FLIP, Settings::BENCH, AtomicBool::new(false));
    let weighed = weigh(&mut bench, &controller, &rules, &order, &settings, print, &stop);
    println!(
        "{:?}: {:.2} mg in the vial, {:.1} mg read, {target_mg} mg wanted; {} shakes in {:.1} s",
        weighed.outcome,
        bench.vial_mg(),
        weighed.reading_mg.unwrap_or(f64::NAN),
        weighed.shakes,
        weighed.seconds
    );
    Ok(())
}
