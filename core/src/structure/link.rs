//! What a unit keeps of the joint that it hangs by.

use nalgebra::{Point3, Vector3};

/// What a unit hangs from, and how far it goes to stay there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Link {
    /// What it hangs from.
    pub(crate) above: Option<Above>,
    /// How far the unit goes if the root of its tree stays.
    pub(crate) way: Vector3<f32>,
    /// Number of the root of its tree in the copy, once `way` is known.
    pub(crate) root: Option<usize>,
    /// Of the first unit on the way to the root that nothing moves, the unit itself among them.
    pub(crate) held: Option<usize>,
    /// Of a root: whether units hang from it.
    pub(crate) carries: bool,
}

/// A parent, and the pivot in the reference frames of both, metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Above {
    /// The bits of the parent's name.
    pub(crate) parent: u64,
    pub(crate) pivot: Point3<f32>,
    pub(crate) parent_pivot: Point3<f32>,
}

impl Link {
    /// Of a unit that hangs from none.
    pub(crate) const NONE: Link = Link {
        above: None,
        way: Vector3::new(0.0, 0.0, 0.0),
        root: None,
        held: None,
        carries: false,
    };
}
