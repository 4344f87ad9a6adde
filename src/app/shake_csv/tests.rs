use super::*;
use proptest::collection::vec;
use proptest::option::of as maybe;
use proptest::prelude::*;

fn entries(text: &str) -> Vec<Entry> {
    read(text).unwrap_or_else(|error| panic!("{error:?}: {text}")).0
}

fn refused(text: &str) -> Vec<String> {
    match read(text) {
        Err(Error::Invalid(errors)) => errors.into_iter().map(|error| error.field).collect(),
        other => panic!("{other:?}"),
    }
}

fn fell(entry: &Entry) -> Vec<f64> {
    entry.spoonful.shakes.iter().map(|shake| shake.fell_mg).collect()
}

#[test]
fn single_shakes_and_readings_below_zero_are_data() {
    let text = "Weighing;Powder;Pitch_deg;Shake_mm;Fell mg;readability_mg\n\
                a;salt;30;3;-1;1\n\
                b;Lactose 200M;45;16;0,5;0,1\n";
    let found = entries(text);
    let powders: Vec<&str> = found.iter().map(|it| it.spoonful.powder.as_str()).collect();
    assert_eq!(powders, ["salt", "lactose_200m"]);
    assert_eq!((fell(&found[0]), fell(&found[1])), (vec![-1.0], vec![0.5]));
    let sd = |k: usize| found[k].spoonful.shakes[0].sd_mg;
    assert!((sd(0) - (1.0f64 / 6.0).sqrt()).abs() < 1e-12 && (sd(0) / sd(1) - 10.0).abs() < 1e-9);
}

#[test]
fn rows_of_a_spoonful_belong_together_wherever_they_stand() {
    let text = "weighing,spoonful,step,powder,lot,pitch_deg,shake_mm,fell_mg,sd_mg\n\
                a,1,2,salt,,30,3,2,0.4\n\
                b,1,1,salt,L2,30,3,7,0.4\n\
                a,2,1,salt,L1,30,3,5,0.4\n\
                a,1,1,salt,L1,20,0,1,0.4\n";
    let found = entries(text);
    assert_eq!(found.iter().map(fell).collect::<Vec<_>>(), [vec![1.0, 2.0], vec![7.0], vec![5.0]]);
    assert_eq!(found[0].spoonful.lot.as_deref(), Some("L1"));
    assert_eq!(found.iter().map(|it| it.row).collect::<Vec<_>>(), [2, 3, 4]);
}

#[test]
fn a_trace_gives_the_differences_of_its_last_readings() {
    let text = "weighing_id,t_s,balance_mg,kind,powder,session,shake_index,shake_mm,spoon_pitch_deg\n\
                a,0,0.1,dose,salt,d1,0,,\n\
                a,3,2.0,dose,salt,,1,4,30\n\
                a,2,9.0,dose,salt,,1,4,30\n\
                a,5,1.9,dose,salt,,2,4,34\n\
                z,5,1.0,zero,salt,,2,4,34\n\
                b,5,7,,salt,,1,4,30\n";
    let found = entries(text);
    let [a, b] = &found[..] else { panic!("{found:?}") };
    let near = |found: Vec<f64>, wanted: &[f64]| {
        found.len() == wanted.len() && found.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-9)
    };
    assert!(near(fell(a), &[1.9, -0.1]) && near(fell(b), &[7.0]), "{found:?}");
    // 0.1 mg is the coarsest step that shows all of these readings.
    assert_eq!(a.spoonful.readability_mg, Some(0.1));
    assert_eq!(a.spoonful.session.as_deref(), Some("d1"));
    assert!((b.spoonful.shakes[0].sd_mg - 0.1 / 6.0f64.sqrt()).abs() < 1e-12);
}

#[test]
fn what_is_missing_contradictory_or_out_of_bounds_is_named() {
    const HEADER: &str = "weighing,spoonful,step,powder,session,pitch_deg,shake_mm,fell_mg,sd_mg";
    let with = |rows: &str| refused(&format!("{HEADER}\n{rows}\n"));
    assert_eq!(with("a,1,1,salt,,30,3,,0.4"), ["row[2].fell_mg"], "empty is not zero");
    assert_eq!(with("a,1,1,salt,,,3,1,0.4"), ["row[2].pitch_deg"]);
    assert_eq!(with("a,1,1,salt,,30,3,1,"), ["row[2].sd_mg"]);
    assert_eq!(with("a,1,1,salt,,30,3,1,0"), ["row[2].sd_mg"]);
    assert_eq!(with("a,0,1,salt,,30,200,1,1"), ["row[2].spoonful", "row[2].shake_mm"]);
    assert_eq!(with(",1,1,Mean,,30,2,1,1"), ["row[2].weighing", "row[2].powder"]);
    assert_eq!(with("a,1,1,salt,x,30,3,1,1\na,1,2,salt,y,30,3,1,1"), ["row[3].session"]);
    assert_eq!(with("a,1,1,salt,x,30,3,1,1\na,1,1,salt,x,30,3,1,1"), ["row[3].step"]);
    assert_eq!(refused("weighing,powder,pitch_deg,shake_mm\na,salt,1,1\n"), ["fell_mg"]);
    let both = "weighing,powder,step,pitch_deg,shake_mm,fell_mg,balance_mg\na,salt,1,1,1,1,1\n";
    assert_eq!(refused(both), ["balance_mg"]);
    let typo = "weighing,powder,pitch_deg,shake_mm,fell_mg,sd_mg,spon_mg\na,salt,1,1,1,1,1\n";
    assert_eq!(refused(typo), ["spon_mg"]);
    let readings = "weighing,powder,pitch_deg,shake_mm,balance_mg\na,salt,1,1,1\n";
    assert_eq!(refused(readings), ["step"]);
    let unmoved = "weighing,powder,step,pitch_deg,shake_mm,balance_mg\na,salt,0,,,0\n";
    assert_eq!(refused(unmoved), ["row[2].step"]);
}

prop_compose! {
    fn shake()(
        pitch_deg in -90.0..180.0f64, shake_mm in 0.0..16.0f64, strokes in 1..9u32, thousandths in -50_000i32..50_000,
        acceleration_m_s2 in maybe(0.0..20.0f64), spoon_mg in maybe(-5.0..40.0f64),
        sd_mg in 0.001..2.0f64, tenths in maybe(0u32..10_000),
    ) -> Shake {
        Shake {
            pitch_deg, shake_mm: if shake_mm < 2.0 { 0.0 } else { shake_mm }, strokes, acceleration_m_s2, spoon_mg,
            fell_mg: f64::from(thousandths) / 1000.0, sd_mg,
            since_filled_s: tenths.map(|tenths| f64::from(tenths) / 10.0),
        }
    }
}

prop_compose! {
    fn spoonful()(
        lot in maybe("L[a-z0-9 ,;\"./-]{0,8}[a-z0-9]"), session in maybe("2026-1[0-2]-2[0-8]"),
        readability_mg in maybe(prop_oneof![Just(1.0), Just(0.1), Just(0.01)]),
        shakes in vec(shake(), 1..6),
    ) -> Spoonful {
        let (weighing, powder) = (String::new(), "salt".to_owned());
        Spoonful { weighing, spoonful: 1, powder, lot, session, readability_mg, shakes }
    }
}

proptest! {
    #[test]
    fn what_was_exported_is_imported_as_it_was(all in vec(spoonful(), 1..5)) {
        let numbered = |(k, it): (usize, Spoonful)| {
            Spoonful { weighing: format!("w-{}", k / 2), spoonful: k as u32 % 2 + 1, ..it }
        };
        let all: Vec<Spoonful> = all.into_iter().enumerate().map(numbered).collect();
        let text = write(all.iter(), true);
        let found: Vec<Spoonful> = entries(&text).into_iter().map(|it| it.spoonful).collect();
        prop_assert_eq!(found, all, "{}", text);
    }
}
