//! The cost of the simulator: the kernel on a flowing column and on a resting one, its neighbour
//! list, one heap and one step of the spoon (the two building blocks of every calibration and
//! training): `cargo bench --bench simulator`.

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use flip_core::domain::bench::Action;
use flip_core::domain::parameters::ParameterSet;
use flip_sim::column::{self, Column};
use flip_sim::dispense::{self, Dispenser};
use flip_sim::repose::{self, repose};
use std::hint::black_box;

/// Substeps of one kernel measurement: 2 ms.
const STRETCH: u32 = 25;

/// A column this many substeps after its release.
fn column_after(particles: u32, substeps: u32) -> Column {
    let mut column = Column::new(&column::bed(particles).expect("a bed settles"));
    column.advance(substeps);
    column
}

fn kernel(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("kernel");
    group.sample_size(20);
    for particles in [2000, 10_000] {
        group.throughput(Throughput::Elements(u64::from(particles * STRETCH)));
        for (scene, substeps) in [("flowing", 50), ("at rest", 5000)] {
            group.bench_function(format!("{particles} grains {scene}"), |bencher| {
                let column = column_after(particles, substeps);
                bencher.iter_batched_ref(
                    || column.clone(),
                    |column| column.advance(STRETCH),
                    BatchSize::LargeInput,
                );
            });
        }
        // Any cost beyond 1/25 of a measurement above is the list's.
        group.throughput(Throughput::Elements(u64::from(particles)));
        group.bench_function(format!("{particles} grains, one substep and list"), |bencher| {
            let mut column = column_after(particles, 50);
            column.outdate();
            bencher.iter_batched_ref(
                || column.clone(),
                |column| column.advance(1),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

fn heap(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("heap");
    group.sample_size(10);
    for particles in [500, 1000, 2000] {
        let settings = repose::Settings::with_particles(particles);
        group.bench_function(format!("{particles} grains"), |bencher| {
            bencher.iter(|| repose(black_box(&ParameterSet::default()), &settings, 1));
        });
    }
    group.finish();
}

fn spoon(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("spoon");
    group.sample_size(10);
    let settings = dispense::Settings::default();
    group.bench_function("fill 2500 grains", |bencher| {
        bencher.iter(|| Dispenser::new(black_box(&ParameterSet::default()), &settings, 1));
    });
    let mut tilted = Dispenser::new(&ParameterSet::default(), &settings, 1);
    for _ in 0..3 {
        tilted.step(Action::once(8.0, 0.0));
    }
    for shake_mm in [2.0, 8.0, 16.0] {
        group.bench_function(format!("shake {shake_mm} mm at 24 deg"), |bencher| {
            bencher.iter(|| tilted.clone().step(black_box(Action::once(0.0, shake_mm))));
        });
    }
    group.finish();
}

criterion_group!(simulator, kernel, heap, spoon);
criterion_main!(simulator);
