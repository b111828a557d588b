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
    pub(crate) guide: Guide,
}

/// What a joint lets the unit do, besides.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guide {
    pub(crate) way: Way,
    /// Of length 1, in the unit's frame; 0 without an axis.
    pub(crate) axis: Vector3<f32>,
    /// The unit's rotation in its parent's frame at position 0: i, j, k, w.
    pub(crate) rest: [f32; 4],
    /// Least and greatest position, rad or m; infinite without limits.
    pub(crate) limits: [f32; 2],
    /// The most that reaches the target, N m or N; infinite without a limit.
    pub(crate) force: f32,
    /// Where the caller wants the joint, rad or m.
    pub(crate) target: Option<f32>,
}

/// Ways that a joint leaves open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// All turns about the pivot.
    Ball,
    /// Turns about the axis.
    Turns,
    /// Slides along the axis.
    Slides,
    /// None.
    Fixed,
}

impl Way {
    /// Whether it has a position.
    pub(crate) fn has_axis(self) -> bool {
        matches!(self, Way::Turns | Way::Slides)
    }
}

impl Guide {
    /// Of a pivot alone.
    pub(crate) const BALL: Guide = Guide {
        way: Way::Ball,
        axis: Vector3::new(0.0, 0.0, 0.0),
        rest: [0.0, 0.0, 0.0, 1.0],
        limits: [f32::NEG_INFINITY, f32::INFINITY],
        force: f32::INFINITY,
        target: None,
    };
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
