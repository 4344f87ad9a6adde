use super::*;

fn pile(tip_deg: f64) -> Scene {
    Scene::of(Surface::Cone(Cone::of_deg(tip_deg)))
}

#[test]
fn the_depth_of_an_exact_picture_lies_on_the_surface() {
    let (scene, pose, optics) = (pile(35.0), Pose::default(), Optics::coarse());
    let frame = frames(&scene, &pose, &optics, &Noise::NONE, 1, 1).remove(0);
    // From camera coordinates to scene coordinates, by the pose.
    let lens = optics.intrinsics;
    let (se, ce) = pose.elevation_deg.to_radians().sin_cos();
    let mut on_pile = 0;
    for (k, &steps) in frame.depth.iter().enumerate().filter(|(_, steps)| **steps > 0) {
        let pixel = [(k % 424) as f64, (k / 424) as f64];
        let [x, y, z] = lens.deproject(pixel, f64::from(steps) * optics.unit_mm);
        let at = [x, -200.0 * ce - se * y + ce * z, 25.0 + 200.0 * se - ce * y - se * z];
        let r = at[0].hypot(at[1]);
        if r < 28.0 && at[2] < 40.0 && at[2] > 1.0 {
            on_pile += 1;
            let surface = 35.0_f64.to_radians().tan() * (30.0 - r);
            // Half a depth step along the ray.
            assert!((at[2] - surface).abs() < 0.15, "{at:?} {surface}");
        }
    }
    assert!(on_pile > 1000, "{on_pile}");
}

#[test]
fn the_same_seed_gives_the_same_frames_and_noise_is_as_large_as_it_says() {
    let (scene, pose, optics) = (pile(40.0), Pose::default(), Optics::coarse());
    let noise = Noise { fixed_mm: 0.0, edge_pixels: 0, ..Noise::default() };
    let taken = frames(&scene, &pose, &optics, &noise, 7, 2);
    assert_eq!(taken, frames(&scene, &pose, &optics, &noise, 7, 2));
    let pairs = taken[0].depth.iter().zip(&taken[1].depth).filter(|(a, b)| **a > 0 && **b > 0);
    let scaled = |(a, b): (&u16, &u16)| {
        let mm = f64::from(*a) * 0.1;
        (f64::from(*a) - f64::from(*b)) * 0.1 / (mm / 200.0).powi(2)
    };
    let squares: Vec<f64> = pairs.map(scaled).map(|d| d * d).collect();
    let sd = (squares.iter().sum::<f64>() / squares.len() as f64 / 2.0).sqrt();
    assert!((sd - 0.5).abs() < 0.02, "{sd}");
    // Missing at random and without texture; part of the scene is out of range.
    assert!((0.02..0.6).contains(&taken[0].invalid_share()));
}

#[test]
fn a_pointed_cone_has_one_angle_and_a_rounded_one_two() {
    assert!((Cone::of_deg(35.0).cone_deg() - 35.0).abs() < 1e-6);
    let rounded = Cone { rounding: 0.15, ..Cone::of_deg(35.0) };
    assert!(rounded.cone_deg() > 36.5, "{}", rounded.cone_deg());
}

#[test]
fn a_heap_of_grains_is_as_high_as_its_highest_grain() {
    let heap = Surface::Heap(Heap::of_grains(&[[0.0, 0.0, 3.0], [1.0, 0.5, 1.0]], 1.0));
    assert!((heap.height_at([0.0, 0.0], 10.0) - 3.5).abs() < 1e-9);
    assert!((heap.height_at([1.0, 0.5], 10.0) - 1.5).abs() < 0.01);
    assert_eq!(heap.height_at([8.0, 0.0], 10.0), 0.0);
}

#[test]
fn faults_have_the_names_of_the_menu() {
    assert!(CameraFault::ALL.iter().all(|(name, fault)| name.parse() == Ok(*fault)));
    assert!("fog".parse::<CameraFault>().unwrap_err().contains("frozen_frames"));
}

#[test]
fn an_upload_decodes_to_its_frame() {
    let frame =
        frames(&pile(30.0), &Pose::default(), &Optics::coarse(), &Noise::default(), 3, 1).remove(0);
    assert_eq!(upload(&frame).unwrap().decode(), Ok(frame));
}
