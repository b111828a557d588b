//! Units as their owner looks at them.

use super::state::Simulator;
use crate::geometry::Pose;
use crate::kernels::in_own_environment;
use crate::measure::Measure;
use crate::scene::{Physics, Role, Scene, UnitId, UnitSlot};
use core::ops::Range;
use nalgebra::{Isometry3, Point3};

/// A unit of a simulator's scene, as it is now.
#[derive(Clone, Copy)]
pub struct UnitView<'a> {
    scene: &'a Scene<'a>,
    unit: &'a UnitSlot,
}

impl<'a> UnitView<'a> {
    /// Its name; the copies of a unit share it.
    pub fn id(&self) -> UnitId {
        self.unit.id
    }

    /// Who moves it.
    pub fn role(&self) -> Role {
        self.unit.given_role()
    }

    /// Whether it diverged, and stays where it was until [`set_poses`](Simulator::set_poses) gives it poses: see
    /// [`set_quarantine`](Simulator::set_quarantine).
    #[cfg(feature = "health")]
    pub fn is_quarantined(&self) -> bool {
        self.unit.is_quarantined()
    }

    /// The body that it is a part of, if it is not one of its own.
    pub fn body(&self) -> Option<u16> {
        self.unit.body.checked_sub(1).and_then(|body| u16::try_from(body).ok())
    }

    /// What it is made of.
    pub fn physics(&self) -> Physics {
        self.unit.physics
    }

    /// How contact with it gives way.
    #[cfg(feature = "compliance")]
    pub fn compliance(&self) -> crate::Compliance {
        self.unit.compliance()
    }

    /// Pose in the current frame: carries its reference points to the world.
    pub fn pose(&self) -> Isometry3<f32> {
        in_own_environment(|| {
            self.measure().outward_isometry(&self.unit.state(), &self.unit.offset)
        })
    }

    /// Where a driven unit goes in the next step ([`Simulator::drive`]): its pose then. None of others.
    pub fn target(&self) -> Option<Isometry3<f32>> {
        let driven = self.unit.role == Role::Driven;
        driven.then(|| {
            in_own_environment(|| {
                self.measure().outward_isometry(&self.unit.driven(), &self.unit.offset)
            })
        })
    }

    /// As [`pose`](Self::pose), a step earlier, if it has flown as its motion in the last substep says: with `pose` it is that
    /// motion to [`set_poses`](Simulator::set_poses). What lies still counts as having risen against gravity.
    pub fn previous_pose(&self) -> Isometry3<f32> {
        in_own_environment(|| {
            self.measure().outward_isometry(&self.scene.step_ago(self.unit), &self.unit.offset)
        })
    }

    /// Pose as rotation and centre of its internal frame: the bits that targets are compared by.
    pub fn internal_pose(&self) -> Pose {
        in_own_environment(|| self.measure().outward(&self.unit.state()))
    }

    /// Whether it is a patch of a soft body. The pose of a patch is the place of its points' mean, without a turn.
    pub fn is_soft(&self) -> bool {
        self.unit.is_soft()
    }

    /// Where the points of a soft unit are in the current frame, metres, each with its number among the points that it was given
    /// by; in the simulator's own order. None of rigid units, whose poses say it.
    #[cfg(feature = "deform")]
    pub fn soft_points(&self) -> impl Iterator<Item = (usize, Point3<f32>)> + use<'a> {
        let (unit, scene) = (self.unit, self.scene);
        let count = if unit.is_soft() { unit.count } else { 0 };
        let rows = unit.start..unit.start + count;
        Batches::new(rows, move |row| scene.soft.numbered_point(row))
    }

    /// Its centre of mass in the current frame, metres, with the digits that a pose's f32 leave out.
    pub fn centre(&self) -> Point3<f64> {
        in_own_environment(|| self.measure().centre(&self.unit.state()))
    }

    fn measure(&self) -> &Measure {
        &self.scene.measure
    }

    /// How many points it has.
    pub fn point_count(&self) -> usize {
        self.unit.count
    }

    /// World positions of its points in the current frame, metres, in the simulator's
    /// own (farthest-point) order.
    pub fn points(&self) -> impl Iterator<Item = Point3<f32>> + use<'a> {
        let (state, measure) = (self.unit.state(), self.scene.measure);
        let local = self.scene.points_of(self.unit).iter();
        Batches::new(local, move |point| measure.outward_point(&state, &point.coords))
    }
}

/// Computes many at a time in an own environment: to enter it takes as long as a point.
struct Batches<I, F, T> {
    of: I,
    compute: F,
    computed: [T; BATCH],
    /// Which of the computed ones are still to come.
    left: Range<usize>,
}

const BATCH: usize = 16;

impl<I: Iterator, F: Fn(I::Item) -> T, T: Copy + Default> Batches<I, F, T> {
    fn new(of: I, compute: F) -> Self {
        Batches { of, compute, computed: [T::default(); BATCH], left: 0..0 }
    }

    fn fill(&mut self) {
        let Batches { of, compute, computed, left } = self;
        let mut count = 0;
        in_own_environment(|| {
            // The slot first: what `of` gives is not to be lost.
            for (slot, item) in computed.iter_mut().zip(of) {
                *slot = compute(item);
                count += 1;
            }
        });
        *left = 0..count;
    }
}

impl<I: Iterator, F: Fn(I::Item) -> T, T: Copy + Default> Iterator for Batches<I, F, T> {
    type Item = T;

    fn next(&mut self) -> Option<T> {
        if self.left.is_empty() {
            self.fill();
        }
        let at = self.left.next()?;
        self.computed.get(at).copied()
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let (least, most) = self.of.size_hint();
        let left = self.left.len();
        (least.saturating_add(left), most.and_then(|most| most.checked_add(left)))
    }
}

impl Simulator<'_, '_> {
    /// Units in order, those of the first copy.
    pub fn units(&self) -> impl Iterator<Item = UnitView<'_>> {
        let units = self.scene.units().iter().take(self.scene.per_copy);
        units.map(|unit| UnitView { scene: &self.scene, unit })
    }

    /// A unit by its number in the order in which units were observed and added, from 0; that of copy `c` by
    /// `c * len()` more.
    pub fn unit(&self, number: usize) -> Option<UnitView<'_>> {
        let unit = self.scene.units().get(number)?;
        Some(UnitView { scene: &self.scene, unit })
    }

    /// A unit by its name, in the first copy.
    pub fn get(&self, id: UnitId) -> Option<UnitView<'_>> {
        self.unit(self.number(id)?)
    }

    /// Number of a unit in the first copy, by its name.
    pub fn number(&self, id: UnitId) -> Option<usize> {
        // Units keep their order, and names rise.
        let units = self.scene.units().get(..self.scene.per_copy)?;
        units.binary_search_by_key(&id, |unit| unit.id).ok()
    }

    /// Pose of a unit in the current frame: carries its reference points to the world.
    pub fn pose(&self, id: UnitId) -> Option<Isometry3<f32>> {
        Some(self.get(id)?.pose())
    }
}
