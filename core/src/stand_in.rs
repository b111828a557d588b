//! What a build leaves out: a type of no bytes stands in for a value that it has no room for.

use core::marker::PhantomData;

/// Whether the build has copies of a scene, wide kernels and an index of points. Kernels of controllers cannot serve those:
/// on Cortex-M with DSP this is false with the feature `host` too, while [`OfHost`] has a value there.
pub(crate) const IS_HOST: bool = cfg!(rigidformer_host);

/// A value of builds with the feature `host`, whatever the processor: [`IS_HOST`] may be false.
#[cfg(feature = "host")]
pub(crate) type OfHost<T> = Stored<T>;
#[cfg(not(feature = "host"))]
pub(crate) type OfHost<T> = Absent<T>;

/// A value of builds with the feature `health`.
#[cfg(feature = "health")]
pub(crate) type OfHealth<T> = Stored<T>;
#[cfg(not(feature = "health"))]
pub(crate) type OfHealth<T> = Absent<T>;

/// A value of builds with the feature `compliance`.
#[cfg(feature = "compliance")]
pub(crate) type OfCompliance<T> = Stored<T>;
#[cfg(not(feature = "compliance"))]
pub(crate) type OfCompliance<T> = Absent<T>;

/// A value of builds with `compliance` or `robot`.
#[cfg(any(feature = "compliance", feature = "robot"))]
pub(crate) type OfForce<T> = Stored<T>;
#[cfg(not(any(feature = "compliance", feature = "robot")))]
pub(crate) type OfForce<T> = Absent<T>;

/// A value that is there.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code, reason = "builds without features have none")]
pub(crate) struct Stored<T>(T);

/// In the place of a value: takes no bytes, and the compiler knows that there is none.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code, reason = "builds with all features have none")]
pub(crate) struct Absent<T>(PhantomData<T>);

#[allow(dead_code, reason = "builds without features have none")]
impl<T> Stored<T> {
    pub(crate) const fn new(value: T) -> Self {
        Stored(value)
    }

    #[inline(always)]
    pub(crate) fn get(&self) -> Option<&T> {
        Some(&self.0)
    }

    #[inline(always)]
    pub(crate) fn get_mut(&mut self) -> Option<&mut T> {
        Some(&mut self.0)
    }
}

#[allow(dead_code, reason = "builds with all features have none")]
impl<T> Absent<T> {
    pub(crate) const fn new(value: T) -> Self {
        // No value that is kept here has anything to drop.
        core::mem::forget(value);
        Absent(PhantomData)
    }

    #[inline(always)]
    pub(crate) fn get(&self) -> Option<&T> {
        None
    }

    #[inline(always)]
    pub(crate) fn get_mut(&mut self) -> Option<&mut T> {
        None
    }
}
