//! Cards of spoons whose law is known.

use super::*;

/// A spoon of 40 mg that releases exp(k (pitch - onset)) - 0.3 mg at each full stroke from its onset
/// on, a factor less at half strokes, and never its last 4 mg.
struct Spoon {
    onset_deg: f64,
    per_deg: f64,
}

impl Spoon {
    fn shaken(&self, shake_mm: f64, factor: f64, row: &[(f64, u32)]) -> Spoonful {
        let mut left_mg = 40.0;
        let shake = |&(pitch_deg, strokes): &(f64, u32)| {
            let flows = pitch_deg >= self.onset_deg - 1e-9;
            let each_mg = factor * (self.per_deg * (pitch_deg - self.onset_deg)).exp() - STEP_MG;
            let fell_mg =
                if flows { (each_mg * f64::from(strokes)).min(left_mg - 4.0) } else { 0.0 };
            let shake = Shake {
                pitch_deg,
                shake_mm,
                strokes,
                acceleration_m_s2: None,
                spoon_mg: Some(left_mg),
                fell_mg,
                sd_mg: 0.04,
                since_filled_s: None,
            };
            left_mg -= fell_mg;
            shake
        };
        let shakes = row.iter().map(shake).collect();
        Spoonful {
            weighing: "w".to_owned(),
            spoonful: 1,
            powder: "salt".to_owned(),
            lot: None,
            session: None,
            readability_mg: None,
            shakes,
        }
    }
}

const SPOON: Spoon = Spoon { onset_deg: 22.0, per_deg: 0.05 };

/// Two strokes at each pitch up to 34 deg, then what a probing run ends with.
fn row() -> Vec<(f64, u32)> {
    let rising = (0..8).flat_map(|k| [(6.0 + 4.0 * f64::from(k), 1); 2]);
    rising.chain([(50.0, 4); 4]).collect()
}

fn near(estimate: Option<Estimate>, truth: f64) {
    let it = estimate.unwrap();
    assert!((it.mean - truth).abs() < 1e-9, "{it:?}, not {truth}");
    assert!(it.low <= it.mean && it.mean <= it.high, "{it:?}");
}

#[test]
fn a_spoon_of_known_law_has_its_numbers_on_the_card() {
    let full = [SPOON.shaken(16.0, 2.0, &row()), SPOON.shaken(8.0, 1.0, &row())];
    let card = card_of(&full);
    assert_eq!((card.spoonfuls, card.shakes, card.missing.clone()), (2, 40, None));
    near(card.onset_deg, 22.0);
    assert_eq!(card.never_flowed, 0);
    // Until the spoon runs out, which is no law of the powder.
    let rising =
        [(16.0, 2.0), (8.0, 1.0)].map(|(mm, factor)| SPOON.shaken(mm, factor, &row()[..16]));
    let early = card_of(&rising);
    near(early.slope_per_deg, 0.05);
    assert!(early.scatter.unwrap() < 1e-9 && early.left.is_none());
    let [long, short] = &card.curves[..] else { panic!("{:?}", card.curves) };
    assert_eq!((long.stroke, long.shake_mm), (StrokeClass::Full, 16.0));
    assert_eq!((short.stroke, short.shake_mm), (StrokeClass::Half, 8.0));
    for (curve, factor) in [(long, 2.0), (short, 1.0)] {
        assert_eq!(curve.cells.len(), 8, "steps of several strokes are in no cell");
        for cell in &curve.cells {
            let flows = cell.pitch_deg >= 22.0;
            let mg =
                if flows { factor * (0.05 * (cell.pitch_deg - 22.0)).exp() - 0.3 } else { 0.0 };
            assert!((cell.mean_mg - mg).abs() < 1e-9 && cell.n == 2, "{cell:?}, not {mg}");
            // Pairs of equal readings in eight cells: the balance's own noise, with t of 8 degrees.
            let [low, high] = cell.band_mg.unwrap();
            assert!((high - low - 2.0 * 1.860 * 0.04 / 2f64.sqrt()).abs() < 1e-4, "{cell:?}");
        }
    }
    // The short stroke was not full, so that one spoonful alone was shaken to its end.
    let left = card.left.unwrap();
    assert_eq!(left.spoonfuls, 1);
    near(Some(left.mass_mg), 4.0);
    near(Some(left.share), 0.1);
}

#[test]
fn scatter_and_intervals_are_those_of_the_shakes() {
    let spoons = [18.0, 22.0, 26.0].map(|onset_deg| Spoon { onset_deg, ..SPOON });
    let shaken: Vec<Spoonful> =
        spoons.iter().map(|spoon| spoon.shaken(16.0, 2.0, &row())).collect();
    let onset = card_of(&shaken).onset_deg.unwrap();
    assert!((onset.mean - 22.0).abs() < 1e-9);
    assert!((18.0..22.0).contains(&onset.low) && (22.0..=26.0).contains(&onset.high), "{onset:?}");
    // e^(+-0.2) about the law: an SD of 0.2 sqrt 2 in every cell of two.
    let mut noisy = vec![SPOON.shaken(16.0, 2.0, &row()), SPOON.shaken(8.0, 1.0, &row())];
    for spoonful in &mut noisy {
        for (k, shake) in spoonful.shakes.iter_mut().enumerate().filter(|(_, it)| it.fell_mg > 0.0)
        {
            let sign = if k % 2 == 0 { 0.2f64 } else { -0.2 };
            shake.fell_mg = (shake.fell_mg + STEP_MG) * sign.exp() - STEP_MG;
        }
        spoonful.shakes.truncate(16);
    }
    let scatter = card_of(&noisy).scatter.unwrap();
    assert!((scatter - 0.2 * 2f64.sqrt()).abs() < 1e-9, "{scatter}");
    assert_eq!(card_of(&noisy), card_of(&noisy));
}

#[test]
fn a_powder_that_never_flowed_begins_beyond_the_last_pitch_and_stays_whole() {
    let stuck = Spoon { onset_deg: 90.0, ..SPOON };
    let two = [stuck.shaken(16.0, 1.0, &row()), stuck.shaken(16.0, 1.0, &row())];
    let card = card_of(&two);
    near(card.onset_deg, 55.0);
    assert_eq!((card.never_flowed, card.slope_per_deg, card.scatter), (2, None, None));
    near(card.left.map(|left| left.share), 1.0);
}

#[test]
fn strokes_of_a_spent_spoon_and_gentle_ones_are_in_no_curve() {
    let fast = Spoon { onset_deg: 22.0, per_deg: 0.5 };
    let card = card_of(&[fast.shaken(16.0, 2.0, &row()), fast.shaken(2.0, 2.0, &row())]);
    let [curve] = &card.curves[..] else { panic!("{:?}", card.curves) };
    assert!(curve.cells.iter().all(|cell| cell.pitch_deg < 40.0), "{:?}", curve.cells);
}

#[test]
fn one_spoonful_is_no_card_and_none_is_none() {
    for (n, said) in [(0, "0 of at least 2"), (1, "1 of at least 2")] {
        let card = card_of(&vec![SPOON.shaken(16.0, 2.0, &row()); n]);
        assert!(card.missing.as_ref().unwrap().contains(said), "{card:?}");
        assert_eq!((card.spoonfuls, card.onset_deg, card.curves.len()), (n, None, 0));
    }
}

#[test]
fn the_students_points_are_those_of_the_table() {
    for (freedom, point) in
        [(1, 6.314), (2, 2.920), (3, 2.353), (5, 2.015), (10, 1.812), (60, 1.671)]
    {
        assert!((student_95(freedom) / point - 1.0).abs() < 0.003, "{freedom}");
    }
}
