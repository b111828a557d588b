//! The reader allocates nothing.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use rigidformer_weights::{Aligned, ModelFile, TensorData, include_model};

static TINY: &Aligned<[u8]> = include_model!("../data/tiny.rfm");

fn allocations(run: impl FnOnce()) -> u64 {
    allocation_counter::measure(run).count_total
}

#[test]
fn parsing_and_reading_allocate_nothing() {
    assert_eq!(allocations(|| drop(std::hint::black_box(vec![1]))), 1, "the counter counts");
    let count = allocations(|| {
        let model = ModelFile::parse(TINY).unwrap();
        assert_eq!(model.tensors().count(), 4);
        assert!(matches!(model.tensor("weight").unwrap().data, TensorData::F32(_)));
        assert_eq!(model.provenance().count() + model.metrics().count(), 3);
    });
    assert_eq!(count, 0);
}

#[test]
fn refusing_allocates_nothing() {
    let cut = &TINY[..TINY.len() - 64];
    assert_eq!(allocations(|| assert!(ModelFile::parse(cut).is_err())), 0);
}
