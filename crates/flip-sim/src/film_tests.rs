use super::*;
use crate::dispense::Settings;
use crate::law::GRAVITY;
use crate::replay::{Step, replay};
use flip_core::domain::parameters::ParameterSet;

const STEPS: [(f64, f64, u32); 4] =
    [(12.0, 0.0, 1), (26.0, 4.0, 1), (26.0, 8.0, 2), (40.0, 8.0, 1)];

fn scene(moves: Moves) -> Scene {
    let step = |(pitch_deg, shake_mm, strokes)| Step {
        pitch_deg,
        shake_mm,
        strokes,
        acceleration_m_s2: None,
    };
    let settings =
        Settings { particles: 300, semi_axes_mm: [2.2, 1.6, 1.0], ..Settings::default() };
    let steps = STEPS.map(step).to_vec();
    Scene { replay: Replay { set: ParameterSet::default(), settings, steps, seed: 7 }, moves }
}

fn filmed(moves: Moves) -> Film {
    film(&scene(moves), &mut |_, _| ControlFlow::Continue(())).unwrap()
}

#[test]
fn a_film_in_turn_drops_what_the_replay_drops_and_loses_no_grain() {
    let Film { head, radii_um, falls, frames } = filmed(Moves::InTurn);
    let replayed = replay(&scene(Moves::InTurn).replay).unwrap();
    let fell_mg: Vec<f64> = head.steps.iter().map(|step| step.fell_mg).collect();
    assert_eq!(fell_mg[..4], replayed.fell_mg);
    assert_eq!(head.filled_mg, replayed.filled_mg);
    assert!(head.vial_mg > 1.0, "{head:?}");
    // Equal grains: their number is their mass.
    let reached = falls.iter().filter(|fall| fall.reaches).count() as f64;
    assert!((reached * head.grain_mg - head.vial_mg).abs() < 1e-9, "{reached} {head:?}");
    let missed = falls.len() as f64 - reached;
    assert!((missed * head.grain_mg - head.spilled_mg).abs() < 1e-9, "{missed} {head:?}");
    let last = head.steps.last().unwrap();
    assert_eq!((last.pitch_deg, last.shake_mm), (0.0, 0.0));
    assert!((last.spoon_mg + head.vial_mg + head.spilled_mg - head.filled_mg).abs() < 1e-9);
    assert_eq!(frames[0].moved.len() as u32, (head.filled_mg / head.grain_mg).round() as u32);
    assert!(
        radii_um
            .iter()
            .filter(|um| **um > 0)
            .all(|um| f64::from(*um) == (head.grain_mm * 500.0).round())
    );
    assert!(frames.windows(2).all(|pair| pair[0].at_s < pair[1].at_s));
    assert!((f64::from(frames.last().unwrap().at_s) - head.duration_s).abs() < 1e-6);
}

#[test]
fn the_moves_of_the_simulated_bench_are_its_own_steps() {
    use flip_core::domain::bench::Action;
    let mut spoon =
        Dispenser::new(&ParameterSet::default(), &scene(Moves::AtOnce).replay.settings, 7);
    let by_hand = STEPS.map(|(pitch_deg, shake_mm, strokes)| {
        let incline_change_deg = pitch_deg - spoon.pitch_deg();
        spoon.step(Action { incline_change_deg, shake_mm, strokes }).vial_mg
    });
    let level_mg = spoon.level().vial_mg;
    let head = filmed(Moves::AtOnce).head;
    let seen: Vec<f64> = head.steps.iter().map(|step| step.fell_mg).collect();
    assert_eq!(seen, [&by_hand[..], &[level_mg]].concat());
    assert_eq!(head.vial_mg, spoon.vial_mg());
}

#[test]
fn a_grain_that_reaches_the_mouth_falls_within_its_rim_and_any_other_beside_it() {
    let Film { head, falls, .. } = filmed(Moves::InTurn);
    assert!(!falls.is_empty());
    for fall in &falls {
        let [x, y, z] = fall.from_mm.map(f64::from);
        let [vx, vy, vz] = fall.speed_mm_s.map(f64::from);
        let g = GRAVITY * 1e3;
        let time = (vz + (vz * vz + 2.0 * g * (z + head.drop_height_mm)).sqrt()) / g;
        let off_mm = (x + vx * time - head.vial_offset_mm).hypot(y + vy * time);
        let within = off_mm - head.vial_radius_mm;
        assert!(if fall.reaches { within < 1e-3 } else { within > -1e-3 }, "{fall:?}: {within}");
    }
}

#[test]
fn a_film_has_the_same_bytes_alone_and_beside_another() {
    let alone = filmed(Moves::AtOnce).to_bytes();
    let beside: Vec<Vec<u8>> = std::thread::scope(|scope| {
        let both = [0, 1].map(|_| scope.spawn(|| filmed(Moves::AtOnce).to_bytes()));
        both.map(|one| one.join().unwrap()).into()
    });
    assert!(beside.iter().all(|bytes| *bytes == alone));
}

#[test]
fn a_recorded_position_is_within_half_a_step_of_the_grain() {
    let Scene { replay: Replay { set, settings, seed, .. }, .. } = scene(Moves::InTurn);
    let mut spoon = Dispenser::new(&set, &settings, seed);
    spoon.record(0.04, POSITIONS_MAX);
    spoon.carry_out(35.0, 8.0, 1);
    let recorder = spoon.recorded().unwrap();
    let (last, mm) = (&recorder.shots.last().unwrap().grains, set.particle_diameter_mm());
    let grains = spoon.grains();
    assert!(!last.is_empty() && last.len() == grains.ids().len());
    for (id, x) in grains.ids().iter().zip(grains.centres()) {
        let placed = last.iter().find(|grain| u32::from(grain.id) == *id).unwrap();
        for (at, x) in placed.at.iter().zip(x.iter()) {
            let error_mm = f64::from(*at) * STEP_MM - f64::from(*x) * mm;
            assert!(error_mm.abs() <= STEP_MM / 2.0 + 1e-9, "{error_mm}");
        }
    }
}

#[test]
fn a_film_that_grows_too_long_keeps_every_second_frame() {
    let Scene { replay: Replay { set, settings, seed, .. }, .. } = scene(Moves::InTurn);
    let recorded = |most: usize| {
        let mut spoon = Dispenser::new(&set, &settings, seed);
        spoon.record(0.02, most);
        spoon.carry_out(20.0, 8.0, 3);
        spoon.recorded().unwrap()
    };
    let (whole, short) = (recorded(POSITIONS_MAX), recorded(3000));
    let ratio = short.every / whole.every;
    assert!(ratio >= 2 && ratio.is_power_of_two(), "{ratio}");
    assert!(short.positions <= 3000 && short.positions > 1000, "{}", short.positions);
    assert_eq!(short.falls, whole.falls);
    let (all, kept) = (whole.developed().2, short.developed().2);
    assert_eq!((kept[0].at_s, kept[0].moved.len()), (0.0, all[0].moved.len()));
    // Each frame that is left is one of the whole film: the same pose at the same time.
    for frame in &kept[..kept.len() - 1] {
        let same = all.iter().find(|other| other.at_s == frame.at_s).unwrap();
        assert_eq!((frame.pitch_deg, frame.shift_mm), (same.pitch_deg, same.shift_mm));
    }
}

/// Reads a file by its description, knowing nothing of how it is written.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let (taken, rest) = self.0.split_at(N);
        self.0 = rest;
        taken.try_into().unwrap()
    }
    fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }
    fn i16(&mut self) -> i16 {
        i16::from_le_bytes(self.take())
    }
    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
    fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }
}

#[test]
fn the_file_is_as_described() {
    let film = filmed(Moves::InTurn);
    let bytes = film.to_bytes();
    let mut file = Reader(&bytes);
    assert_eq!((&file.take::<8>(), file.u32()), (b"FLIPFILM", 1));
    let length = file.u32() as usize;
    let (head, rest) = file.0.split_at(length);
    file.0 = rest;
    let head: Head = serde_json::from_slice(head).unwrap();
    assert_eq!(head, film.head);
    let radii_um: Vec<u16> = (0..head.grains).map(|_| file.u16()).collect();
    let fall = |file: &mut Reader<'_>| {
        let (id, reaches, at_s) = (file.u16(), file.u16() == 1, file.f32());
        let from_mm = [file.f32(), file.f32(), file.f32()];
        let speed_mm_s = [file.f32(), file.f32(), file.f32()];
        Fall { id, reaches, at_s, from_mm, speed_mm_s }
    };
    let falls: Vec<Fall> = (0..head.falls).map(|_| fall(&mut file)).collect();
    let frame = |file: &mut Reader<'_>| {
        let (at_s, pitch_deg, shift_mm) = (file.f32(), file.f32(), file.f32());
        let moved = (0..file.u32())
            .map(|_| Placed { id: file.u16(), at: [file.i16(), file.i16(), file.i16()] })
            .collect();
        Frame { at_s, pitch_deg, shift_mm, moved }
    };
    let frames: Vec<Frame> = (0..head.frames).map(|_| frame(&mut file)).collect();
    assert!(file.0.is_empty());
    assert_eq!(Film { head, radii_um, falls, frames }, film);
}

#[test]
fn a_film_that_is_stopped_makes_no_further_step() {
    let mut heard = Vec::new();
    let stopped = film(&scene(Moves::AtOnce), &mut |done, all| {
        heard.push((done, all));
        if done == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert_eq!(stopped, Err(NoFilm::Stopped));
    assert_eq!(heard, [(0, 5), (1, 5), (2, 5)]);
}
