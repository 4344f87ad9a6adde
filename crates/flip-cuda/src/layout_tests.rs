//! States in words.

use super::*;

#[test]
fn anchors_survive_fixed_point_and_stay_opposite() {
    for a in [[0.3, -0.91, 1.04], [0.0, 1e-6, -1.0], [1.4, 0.123_456, -0.000_7]] {
        let (there, back) = (unpack(pack(a)), unpack(pack(a.map(|x: f32| -x))));
        for k in 0..3 {
            assert!((there[k] - a[k]).abs() < 1e-6, "{there:?} for {a:?}");
            assert_eq!(there[k], -back[k]);
        }
    }
}

#[test]
fn a_state_survives_its_image() {
    let grain = |id: u32, x: f32| Grain {
        id,
        radius: 0.5,
        x: [x, 0.5, -2.0],
        v: [0.01, 0.0, x],
        contacts: 2.0,
        wall_anchor: (id == 1).then_some([x, 0.0, -2.5]),
    };
    let state = State {
        grains: vec![grain(4, 0.0), grain(1, 1.0), grain(9, 2.0)],
        stuck: vec![([0, 1], [-1.0, 0.0, 0.0]), ([1, 2], [-0.75, 0.25, 0.0])],
        ..State::default()
    };
    let through = |kernel, state| super::state(kernel, &image(kernel, state).expect("few grains"));
    let turning =
        |spin, clings| Turning { spin: [spin, 0.0, -0.1], wall_stretch: [0.0; 3], clings };
    let turns = State {
        turning: vec![
            turning(0.1, false),
            Turning { wall_stretch: [0.0, 0.01, 0.02], ..turning(0.2, true) },
            turning(0.0, false),
        ],
        rolls: vec![[0.5, 0.0, -0.25], [0.0, 1e-9, 0.0]],
        ages: vec![3.0, 120_000.0],
        bridged: vec![[0, 2]],
        elapsed: 77,
        ..state.clone()
    };
    assert_eq!(through(Kernel::Extended, &turns), turns);
    let found = through(Kernel::Base, &state);
    assert_eq!((&found.turning, &found.rolls), (&vec![], &vec![]));
    assert_eq!(found.grains, state.grains);
    for ((ends, anchor), (expected, exact)) in found.stuck.iter().zip(&state.stuck) {
        assert_eq!(ends, expected);
        assert!((0..3).all(|k| (anchor[k] - exact[k]).abs() < 1e-6));
    }
}
