//! Loading, observing and stepping allocate nothing, whatever the storage.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use nalgebra::Point3;
use rigidformer_core::{Limits, Model, Simulator, SlabSizes, Slabs};
use rigidformer_tests::Golden;
use rigidformer_tests::bits::{PRECISIONS, quantised};
use rigidformer_tests::packed_model;

fn allocations(run: impl FnOnce()) -> u64 {
    allocation_counter::measure(run).count_total
}

#[test]
fn nothing_is_allocated() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![1]))), 1, "the counter counts");
    let golden = Golden::read("tiny");
    let inputs = golden.inputs();
    let (units, command) = (inputs.units(), golden.command().unwrap());
    let (before, now) = (inputs.frame(&inputs.previous), inputs.frame(&inputs.current));
    let [before, now] = [&before, &now].map(|f| f.iter().map(Vec::as_slice).collect::<Vec<_>>());
    for (name, precision) in PRECISIONS {
        let file = quantised(&packed_model("tiny"), precision);
        let limits = Limits { units: 16, points: inputs.points.iter().map(Vec::len).sum() };
        let sizes = SlabSizes::new(Model::load(&file).unwrap().config(), limits);
        let (mut numbers, mut bytes) = (vec![0.0; sizes.f32], vec![0; sizes.i8]);
        let mut points = vec![Point3::origin(); sizes.points];
        let count = allocations(|| {
            let model = Model::load(&file).unwrap();
            let slabs = Slabs { f32: &mut numbers, i8: &mut bytes, points: &mut points };
            let mut simulator: Simulator<'_, '_, 16> =
                Simulator::new(&model, limits, slabs).unwrap();
            simulator.set_command(&command).unwrap();
            simulator.observe(golden.step, &inputs.physics, &before, &now).unwrap();
            simulator.step().unwrap();
            simulator
                .observe_poses(golden.step, &units, &inputs.previous, &inputs.current)
                .unwrap();
            simulator.step().unwrap();
            assert!(simulator.pose(0).is_some() && simulator.points(0).count() > 3);
            // Refusals allocate nothing either.
            assert!(simulator.observe(0, &inputs.physics, &before, &now).is_err());
            assert!(Model::load(&file[..file.len() - 64]).is_err());
        });
        assert_eq!(count, 0, "{name}");
    }
}
