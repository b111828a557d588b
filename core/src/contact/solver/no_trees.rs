//! In the place of `trees` in builds without joints: nothing hangs.

use super::bodies::{Bodies, World};
use core::marker::PhantomData;

/// Numbers of a unit.
pub(super) const LIMB: usize = 0;

/// No trees.
pub(super) struct Trees<'r>(PhantomData<&'r ()>);

impl<'r> Trees<'r> {
    pub(super) fn new(_: &'r mut [f32], _: usize) -> Self {
        Trees(PhantomData)
    }

    #[inline(always)]
    pub(super) fn moves(&self, _: usize) -> bool {
        false
    }

    #[inline(always)]
    pub(super) fn begin(&mut self, _: &World<'_>, _: &mut Bodies<'_>) {}

    #[inline(always)]
    pub(super) fn choose(&mut self, _: &World<'_>, _: &mut Bodies<'_>, _: f32) {}

    #[inline(always)]
    pub(super) fn follow(&mut self, _: &World<'_>, _: &mut Bodies<'_>, _: bool) {}

    #[inline(always)]
    pub(super) fn advance(&mut self, _: &World<'_>, _: &mut Bodies<'_>) {}

    #[inline(always)]
    pub(super) fn finish(&mut self, _: &World<'_>, _: &mut Bodies<'_>) {}
}
