use flip::domain::{bench::Action, parameters::ParameterSet};
use flip::sim::{dispense, repose};
fn cpu() -> f64 { let s = std::fs::read_to_string("/proc/self/schedstat").unwrap(); s.split_whitespace().next().unwrap().parse::<f64>().unwrap() / 1e9 }
fn main() {
    let set = ParameterSet::default().with("cohesion", 0.3).unwrap();
    let t = cpu();
    let r = repose::repose(&set, &repose::Settings::default(), 1).unwrap();
    let t1 = cpu();
    let mut d = dispense::Dispenser::new(&set, &dispense::Settings::default(), 1);
    let t2 = cpu();
    let mut total = 0.0; let mut sim = 0.0;
    for k in 0..8 { let p = d.step(Action { incline_change_deg: if k < 5 { 8.0 } else { 0.0 }, shake_mm: 8.0 }); total += p.vial_mg; sim += p.duration_s; }
    let t3 = cpu();
    println!("repose {:.2} s cpu ({:.3} s sim, {:.2} deg)  fill {:.2}  8 steps {:.2} ({:.2} s sim, {:.2} mg)", t1 - t, r.simulated_s, r.tip_deg, t2 - t1, t3 - t2, sim, total);
}
