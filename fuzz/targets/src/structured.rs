//! Inputs that stand for values.

use arbitrary::{Arbitrary, Unstructured};

/// What the bytes of an input stand for, as libFuzzer's own macro reads them.
pub(crate) fn structured<'a, T: Arbitrary<'a>>(data: &'a [u8]) -> Option<T> {
    let least = T::size_hint(0).0;
    if data.len() < least { None } else { T::arbitrary_take_rest(Unstructured::new(data)).ok() }
}
