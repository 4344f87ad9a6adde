//! Heaps by the kernel's source, on a processor and on a card, beside flip-sim.

use crate::heaps::Held;
use crate::layout::Kernel;
use crate::twin::{built, carry_out_by};
use crate::{Card, layout};
use flip_core::domain::parameters::ParameterSet;
use flip_core::domain::seed::derive;
use flip_sim::batch::heaps::{Falling, Heaps, Order, Stand, Wanted, pour};
use flip_sim::batch::{Engine, Failed};
use flip_sim::dispense::outside::State;
use flip_sim::mechanisms::Extensions;
use flip_sim::repose::{Repose, Settings, pile, repose};
use flip_sim::snapshot::{Camera, Snapshot};
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};

/// The twin as a solver of heaps.
struct Twin {
    kernel: Kernel,
    source: &'static str,
    held: Held,
    laws: Vec<Vec<u32>>,
    words: Vec<Vec<u32>>,
    /// Substeps that the first heap has made after each order, and its grains then.
    seen: Vec<(u32, State)>,
}

impl Twin {
    /// None where it cannot be compiled.
    fn of(kernel: Kernel, count: usize) -> Option<Self> {
        let source = match kernel {
            Kernel::Base => "cuda/heaps_twin.cpp",
            Kernel::Extended => "cuda/heaps_extended_twin.cpp",
        };
        built(source)?;
        let nothing = layout::image(kernel, &State::default()).expect("it has no grains");
        let laws = vec![vec![0; kernel.law()]; count];
        let held = Held::empty(kernel, count);
        Some(Self { kernel, source, held, laws, words: vec![nothing; count], seen: Vec::new() })
    }
}

impl Heaps for Twin {
    fn places(&self) -> usize {
        self.words.len()
    }
    fn room(&self) -> u32 {
        layout::GRAINS as u32
    }
    fn carry_out(&mut self, orders: &[(usize, Order)]) -> Result<Vec<Stand>, Failed> {
        let orders: Vec<(usize, &Order)> = orders.iter().map(|(at, order)| (*at, order)).collect();
        for (place, law) in self.held.begin(&orders)? {
            self.laws[place] = law;
            self.words[place][..layout::HEAD].fill(0);
        }
        let planned = self.held.plan(&orders)?;
        let (words, raw) =
            carry_out_by(self.source, &self.laws, &self.words, &planned).expect("it was compiled");
        self.words = words;
        let mut stands = self.held.stands(&orders, &raw)?;
        let state = |place: usize| layout::state(self.kernel, &self.words[place]);
        for ((place, order), stand) in orders.iter().zip(&mut stands) {
            stand.state = order.look.then(|| state(*place));
        }
        let done = self.seen.last().map_or(0, |(substeps, _)| *substeps);
        self.seen.push((done + orders[0].1.substeps, state(0)));
        Ok(stands)
    }
}

fn wanted(cohesion: f64, particles: u32, seed: u64) -> Wanted {
    let set = ParameterSet::default().with("cohesion", cohesion).expect("it is within its bounds");
    Wanted { set, settings: Settings::with_particles(particles), seed }
}

/// The same with mechanisms.
fn extended(extensions: Extensions, particles: u32, seed: u64) -> Wanted {
    let mut one = wanted(0.5, particles, seed);
    one.settings.extensions = extensions;
    one
}

/// Mechanisms that change how steep a heap is, and one with all.
fn mechanisms() -> [Extensions; 3] {
    let turns = Extensions { rotation: 1.0, rolling_friction: 0.2, ..Extensions::default() };
    let all = Extensions {
        size_spread: 0.15,
        consolidation: 1.0,
        humidity: 0.5,
        spoon_adhesion: 1.0,
        hold_up: 0.5,
        vibration_g: 0.3,
        charge: 1.0,
        air: 1.0,
        ..turns
    };
    [turns, Extensions { size_spread: 0.2, ..Extensions::default() }, all]
}

fn poured(heaps: &mut dyn Heaps, wanted: &[Wanted]) -> Vec<Repose> {
    let mut found = vec![None; wanted.len()];
    pour(&mut [heaps], wanted, &mut |place, outcome| {
        found[place] = Some(outcome.expect("it has an angle"));
        ControlFlow::Continue(())
    })
    .expect("the solver does not fail");
    found.into_iter().map(|it| it.expect("all were poured")).collect()
}

/// Every substep of a heap on flip-sim.
fn filmed(of: &Wanted) -> Vec<Snapshot> {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let see = {
        let seen = seen.clone();
        Arc::new(move |snapshot| seen.lock().expect("nobody panicked").push(snapshot))
    };
    let camera = Camera { every_s: of.settings.substep_s, see };
    pile(&of.set, &of.settings, of.seed, Some(camera)).expect("it has an angle");
    std::mem::take(&mut *seen.lock().expect("nobody panicked"))
}

/// Substeps, and how far grains are from those of flip-sim at most then, diameters; none without a twin.
fn apart(one: Wanted) -> Option<Vec<(u32, f64)>> {
    let mut twin = Twin::of(Kernel::of_heap(&one.ground()), 1)?;
    poured(&mut twin, &[one]);
    let film = filmed(&one);
    let diameter_mm = one.set.particle_diameter_mm();
    let mut apart = Vec::new();
    for (substeps, state) in &twin.seen {
        let time_s = f64::from(substeps - 1) * one.settings.substep_s;
        let there =
            film.iter().find(|it| (it.time_s - time_s).abs() < 1e-9).expect("every substep");
        if *substeps > 250 || there.ids.len() != state.grains.len() {
            break;
        }
        let mut largest = 0.0f64;
        for grain in &state.grains {
            let k = there.ids.iter().position(|id| *id == grain.id).expect("it was poured there");
            for axis in 0..3 {
                let steps = f64::from(there.grains[k][axis]) * f64::from(there.step_mm);
                let mm = f64::from(there.origin_mm[axis]) + steps;
                largest = largest.max((mm / diameter_mm - f64::from(grain.x[axis])).abs());
            }
        }
        apart.push((*substeps, largest));
    }
    println!("substeps, and diameters apart at most: {apart:?}");
    Some(apart)
}

#[test]
fn a_heap_of_the_twin_begins_like_that_of_flip_sim() {
    let extended = mechanisms().map(|it| extended(it, 250, 3));
    for one in [wanted(0.5, 150, 3)].into_iter().chain(extended) {
        let Some(apart) = apart(one) else { return };
        // The first layer has fallen for 200 substeps, onto the base and then onto itself: gravity that is
        // off by a thousandth moves it by 0.004 diameters. A snapshot resolves 5e-5.
        assert!(apart.len() >= 6, "{apart:?}");
        assert!(apart.iter().all(|(_, largest)| *largest < 2e-3), "{apart:?}");
    }
}

/// Mean and its squared standard error.
fn mean(of: &[f64]) -> (f64, f64) {
    let n = of.len() as f64;
    let mean = of.iter().sum::<f64>() / n;
    let variance = of.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, variance / n)
}

#[test]
fn a_heap_with_too_many_grains_is_given_up_alone() {
    let Some(mut twin) = Twin::of(Kernel::Base, 2) else { return };
    let ground = Some(wanted(0.5, 150, 1).ground());
    let falling = |k: usize| {
        let [x, y, z] = [k % 16, k / 16 % 16, k / 256].map(|it| 1.2 * it as f32);
        Falling { x: [x - 9.0, y - 9.0, z + 1.0], v: [0.0; 3], radius: 0.5 }
    };
    let order = |pour: usize, substeps| Order {
        begin: ground.filter(|_| pour > 0),
        pour: (0..pour).map(falling).collect(),
        substeps,
        look: true,
    };
    let stands = twin.carry_out(&[(0, order(2561, 5)), (1, order(10, 5))]).expect("the other");
    let said = stands[0].fault.as_deref().unwrap_or_default();
    assert!(said.contains("room for 2560 grains"), "{said}");
    assert_eq!(stands[1].fault, None);
    assert_eq!(stands[1].state.as_ref().map(|it| it.grains.len()), Some(10));
    let again = twin.carry_out(&[(0, order(0, 5))]).expect("it stays given up");
    assert_eq!(again[0].fault, stands[0].fault);
    assert_eq!(twin.carry_out(&[(0, order(10, 5))]).expect("it begins anew")[0].fault, None);
}

/// Whether heaps of the twin are about as steep as those of flip-sim, whoever is beside them.
fn is_about_as_steep(all: &[Wanted]) {
    let kernel = Kernel::of_heap(&all[0].ground());
    let Some(mut twin) = Twin::of(kernel, 3) else { return };
    let mine = poured(&mut twin, all);
    let theirs: Vec<Repose> = crate::orders::on_all(all, |_, it| {
        repose(&it.set, &it.settings, it.seed).expect("it has an angle")
    });
    let angles = |of: &[Repose]| of.iter().map(|it| it.cone_deg).collect::<Vec<_>>();
    let (a, b) = (mean(&angles(&mine)), mean(&angles(&theirs)));
    println!("{a:?} and {b:?}");
    assert!((a.0 - b.0).powi(2) < 16.0 * (a.1 + b.1), "{a:?} and {b:?}");
    for (mine, theirs) in mine.iter().zip(&theirs) {
        assert!(mine.particles_on_base.abs_diff(theirs.particles_on_base) < 40);
        assert!((mine.simulated_s - theirs.simulated_s).abs() < 0.5, "{mine:?} {theirs:?}");
        assert!(mine.speed_rms_mm_s < 1.0 && mine.overlap_mean < 2.0 * theirs.overlap_mean);
    }
    let Some(mut alone) = Twin::of(kernel, 1) else { return };
    assert_eq!(poured(&mut alone, &all[4..5])[0], mine[4]);
}

#[test]
fn heaps_of_the_twin_are_about_as_steep_as_those_of_flip_sim_whoever_is_beside_them() {
    is_about_as_steep(&(0..6).map(|seed| wanted(0.5, 200, seed)).collect::<Vec<_>>());
}

#[test]
fn so_are_heaps_with_mechanisms() {
    let [turns, unequal, _] = mechanisms();
    for of in [turns, unequal] {
        is_about_as_steep(&(0..6).map(|seed| extended(of, 250, seed)).collect::<Vec<_>>());
    }
}

#[test]
fn a_card_pours_heaps_as_steep_as_the_cores_within_half_of_the_scatter_of_one() {
    let Ok(card) = Card::open(0) else {
        return println!("skipped: there is no graphics card here");
    };
    let seed = |k: u64| derive(7, &[k]);
    let [turns, unequal, every] = mechanisms();
    let powders: [&dyn Fn(u64) -> Wanted; 5] = [
        &|k| wanted(0.0, 600, seed(k)),
        &|k| wanted(1.0, 600, seed(k)),
        &|k| extended(turns, 600, seed(k)),
        &|k| extended(unequal, 600, seed(k)),
        &|k| extended(every, 600, seed(k)),
    ];
    for (number, powder) in powders.into_iter().enumerate() {
        let all: Vec<Wanted> = (0..96).map(powder).collect();
        let mut heaps = card.heaps(48).expect("it has memory").expect("it computes heaps");
        let mine = poured(heaps.as_mut(), &all);
        // Again, each beside one of the other kernel.
        let other = |k: u64| if number < 2 { extended(turns, 600, k) } else { wanted(0.0, 600, k) };
        let beside = (0..5).flat_map(|k| [all[k], other(k as u64)]).collect::<Vec<_>>();
        let repeated = poured(heaps.as_mut(), &beside).into_iter().step_by(2);
        assert_eq!(repeated.collect::<Vec<_>>(), mine[..5]);
        let theirs: Vec<Repose> = crate::orders::on_all(&all, |_, it| {
            repose(&it.set, &it.settings, it.seed).expect("it has an angle")
        });
        for of in [|it: &Repose| it.tip_deg, |it: &Repose| it.cone_deg] {
            let [a, b] = [&mine, &theirs].map(|of_all| {
                let values: Vec<f64> = of_all.iter().map(of).collect();
                mean(&values)
            });
            let (apart, error) = ((a.0 - b.0).abs(), (a.1 + b.1).sqrt());
            let scatter = (b.1 * 96.0).sqrt();
            println!("powder {number}: {a:?} and {b:?}, scatter of one {scatter}");
            // Two one-sided tests at 5 %: 190 degrees of freedom.
            assert!(apart + 1.653 * error < 0.5 * scatter, "{a:?} and {b:?}, scatter {scatter}");
        }
    }
}
