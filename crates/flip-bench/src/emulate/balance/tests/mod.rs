//! The driver and the emulator over real wires: every command and every condition in every dialect.

mod faults;
mod wire;

use super::{Balance, Fault, Settings, Socket};
use crate::emulate::pan::Pan;
use crate::hardware::DeviceError;
use crate::hardware::balance::{self as driver, Dialect, Identity, StableBy};
use crate::hardware::clock::Clock;
use crate::hardware::wire::Tap;

/// Initial load on the pan, mg: a vial.
const VIAL_MG: f64 = 12_345.6;

fn tcp() -> Socket {
    Socket::Tcp(([127, 0, 0, 1], 0).into())
}

/// A balance with a vial on it, and a driver that has it open.
struct Lab {
    balance: Balance,
    driver: driver::Balance,
}

fn lab(dialect: Dialect, socket: Socket) -> Lab {
    lab_with(Settings { dialect, ..calm() }, socket, |_| {})
}

/// These tests are about the wire, not about air.
fn calm() -> Settings {
    Settings { wander_mg: 0.0, ..Settings::default() }
}

fn lab_with(settings: Settings, socket: Socket, change: impl FnOnce(&mut driver::Settings)) -> Lab {
    let clock = Clock::standing();
    let dialect = settings.dialect;
    let balance =
        Balance::start(settings.checked().unwrap(), Pan::holding(VIAL_MG, clock.clone()), socket)
            .unwrap();
    // Replies come at once, so this is long enough on a busy machine.
    let mut settings =
        driver::Settings { timeout_s: 0.6, ..driver::Settings::new(dialect, balance.address()) };
    change(&mut settings);
    let driver = driver::Balance::open(&settings.checked().unwrap(), Tap::none(), clock).unwrap();
    Lab { balance, driver }
}

impl Lab {
    /// Let powder land; returns the reading shortly after.
    fn pour(&mut self, mass_mg: f64) -> driver::Sample {
        self.balance.pan().add_mg(mass_mg);
        self.driver.immediate().unwrap()
    }

    fn wait_s(&self, seconds: f64) {
        self.balance.pan().clock().wait_s(seconds);
    }
}

/// Four SD of 0.1 mg and half a display step of 1 mg.
fn is_near(shown_mg: f64, true_mg: f64) -> bool {
    (shown_mg - true_mg).abs() <= 0.9
}

fn words(error: &DeviceError) -> String {
    error.to_string()
}

#[test]
fn every_verb_works_in_every_dialect_on_a_terminal_and_over_tcp() {
    for dialect in Dialect::ALL {
        for socket in [Socket::Pty, tcp()] {
            let mut lab = lab(dialect, socket);
            let gross = lab.driver.stable(5.0).unwrap();
            assert!(gross.stable && is_near(gross.mass_mg, VIAL_MG), "{dialect:?}: {gross:?}");
            let zero = lab.driver.tare().unwrap();
            assert!(zero.stable && is_near(zero.mass_mg, 0.0), "{dialect:?}: {zero:?}");
            assert!((lab.balance.tare_mg() - VIAL_MG).abs() < 1e-6);

            let moving = lab.pour(15.0);
            assert!(!moving.stable && moving.mass_mg < 15.0, "{dialect:?}: {moving:?}");
            let net = lab.driver.stable(5.0).unwrap();
            assert!(net.stable && is_near(net.mass_mg, 15.0), "{dialect:?}: {net:?}");
            assert!(
                net.t_s > moving.t_s + 1.0 && net.raw.contains("0.015") | net.raw.contains("0.014"),
                "{net:?}"
            );

            lab.balance.pan().add_mg(-VIAL_MG - 15.0);
            lab.wait_s(5.0);
            let zero = lab.driver.zero().unwrap();
            assert!(
                is_near(zero.mass_mg, 0.0) && lab.balance.tare_mg() == 0.0,
                "{dialect:?}: {zero:?}"
            );
            let Identity { model, serial, software, .. } = lab.driver.identify().unwrap();
            assert!(serial.is_some() && (model.is_some() || software.is_some()), "{dialect:?}");
        }
    }
}

#[test]
fn displays_of_tenths_and_in_mg_and_kg_are_read_without_loss() {
    use crate::hardware::balance::value::Unit;
    for dialect in Dialect::ALL {
        for (unit, readability_mg) in
            [(Unit::Milligram, 0.1), (Unit::Gram, 0.1), (Unit::Kilogram, 1.0)]
        {
            let settings = Settings { dialect, unit, readability_mg, noise_mg: 0.0, ..calm() };
            let mut lab = lab_with(settings, Socket::Pty, |settings| {
                settings.readability_mg = Some(readability_mg)
            });
            let shown = lab.driver.stable(5.0).unwrap().mass_mg;
            assert_eq!(
                shown,
                if readability_mg < 1.0 { 12_345.6 } else { 12_346.0 },
                "{dialect:?} {unit:?}"
            );
        }
    }
}

#[test]
fn what_the_balance_cannot_weigh_is_refused_by_its_reason() {
    for dialect in Dialect::ALL {
        let mut lab = lab(dialect, Socket::Pty);
        lab.driver.tare().unwrap();
        for (fault, cause) in [
            (Fault::Overload, "overload"),
            (Fault::Underload, "underload"),
            (Fault::UnitSwitched, "shows oz"),
            (
                Fault::NotReady,
                if dialect == Dialect::Ohaus { "know a command" } else { "not ready" },
            ),
        ] {
            lab.balance.inject(fault);
            for answer in [
                lab.driver.immediate(),
                lab.driver.stable(2.0),
                lab.driver.tare(),
                lab.driver.zero(),
            ] {
                let error = answer.unwrap_err();
                let is_fault = matches!(error, DeviceError::Faulted { .. });
                assert!(
                    is_fault && words(&error).contains(cause),
                    "{dialect:?} {fault:?}: {error}"
                );
            }
            lab.balance.clear();
            assert!(
                is_near(lab.driver.stable(5.0).unwrap().mass_mg, 0.0),
                "{dialect:?} after {fault:?}"
            );
        }
    }
}

#[test]
fn too_much_and_nothing_at_all_on_the_pan_are_over_and_underload() {
    let mut lab = lab(Dialect::MtSics, Socket::Pty);
    lab.balance.pan().add_mg(250_000.0);
    lab.wait_s(3.0);
    assert!(words(&lab.driver.immediate().unwrap_err()).contains("overload"));
    lab.balance.pan().add_mg(-280_000.0);
    lab.wait_s(3.0);
    assert!(words(&lab.driver.immediate().unwrap_err()).contains("underload"));
}

#[test]
fn the_balances_own_stable_command_answers_or_gives_up_in_its_way() {
    for dialect in [Dialect::MtSics, Dialect::Ohaus, Dialect::Aandd] {
        let settings = Settings { dialect, ..calm() };
        let mut lab = lab_with(settings, tcp(), |settings| settings.stable_by = StableBy::Command);
        lab.driver.tare().unwrap();
        lab.pour(15.0);
        let net = lab.driver.stable(5.0).unwrap();
        assert!(net.stable && is_near(net.mass_mg, 15.0), "{dialect:?}: {net:?}");
        lab.balance.inject(Fault::Draught);
        assert!(!lab.driver.stable(5.0).unwrap().stable, "{dialect:?}");
    }
}

#[test]
fn a_vial_is_too_heavy_for_the_zero_point_and_that_is_said() {
    for dialect in Dialect::ALL {
        let settings = Settings { dialect, ..calm() };
        let mut lab = lab_with(settings, Socket::Pty, |settings| settings.stable_timeout_s = 3.0);
        let refused = lab.driver.zero().unwrap_err();
        let cause = if dialect == Dialect::MtSics { "refused to zero" } else { "did not zero" };
        assert!(words(&refused).contains(cause), "{dialect:?}: {refused}");
    }
}

#[test]
fn the_flag_comes_when_the_load_has_been_at_rest_as_long_as_measured() {
    let mut flagged_s = Vec::new();
    for seed in 0..8 {
        let mut lab = lab_with(Settings { seed, ..calm() }, tcp(), |_| {});
        lab.driver.tare().unwrap();
        let began_s = lab.balance.pan().clock().now_s();
        lab.pour(15.0);
        flagged_s.push(lab.driver.stable(10.0).unwrap().t_s - began_s);
    }
    // Two frames of 0.19 s and the pauses between polls may pass before it is seen.
    assert!(flagged_s.iter().all(|after_s| (1.5..2.8).contains(after_s)), "{flagged_s:?}");
    let spread_s = flagged_s.iter().fold(0.0f64, |most, at| most.max(*at))
        - flagged_s.iter().fold(9.0f64, |least, at| least.min(*at));
    assert!(spread_s > 0.3, "{flagged_s:?}");
}
