//! What the solver keeps of a unit in a tree, as rows of numbers.

use super::super::bodies::rows;
use crate::geometry::{columns, read_pose};
use crate::structure::articulation::{INERTIA, Inertia, SIX, Six};
use nalgebra::{Matrix3, Vector3};

/// Numbers of a [`Head`], and the unit at a place of the order.
const HEAD: usize = 10;
const LEVERS: usize = 9;
const GAINS: usize = 3 * SIX + SIX;
const LOADS: usize = 3 * SIX;
const START: usize = 9 + SIX + SIX;
/// Numbers of a unit; of those that are f64 each takes two.
pub(in super::super) const LIMB: usize = HEAD + LEVERS + 2 * (INERTIA + GAINS + LOADS) + START;

/// A number of 48 bits: what the first f32 leaves out is in the second.
type Long = [f32; 2];

/// As two f32.
fn split(number: f64) -> Long {
    let high = number as f32;
    [high, (number - f64::from(high)) as f32]
}

/// From two f32.
fn whole([high, low]: Long) -> f64 {
    f64::from(high) + f64::from(low)
}

/// Where a unit is in its tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// In none.
    Outside,
    /// At the top, free.
    Root,
    /// At the top, and nothing moves it.
    Held,
    /// It hangs, free.
    Hangs,
    /// It hangs, and nothing moves it.
    HeldBelow,
}

impl Place {
    /// Whether it has a joint.
    pub(super) fn hangs(self) -> bool {
        matches!(self, Place::Hangs | Place::HeldBelow)
    }
}

/// What a joint with an axis does in a substep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// It is free along its axis.
    Passive,
    /// It goes to its target at a rate.
    Driven,
    /// It would, but pushes with all of its force.
    Pushed,
    /// It is stopped at its greatest position.
    AtMost,
    /// And at its least.
    AtLeast,
}

impl Mode {
    /// Whether its rate is known, and the impulse along its axis follows.
    pub(super) fn is_locked(self) -> bool {
        matches!(self, Mode::Driven | Mode::AtMost | Mode::AtLeast)
    }

    pub(super) fn is_at_limit(self) -> bool {
        matches!(self, Mode::AtMost | Mode::AtLeast)
    }
}

/// A unit in its tree, and its joint in the substep at hand.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub(super) place: Place,
    /// Number of what it hangs from, if it hangs.
    pub(super) parent: usize,
    pub(super) mode: Mode,
    /// Of its position, where it is locked: rad/s or m/s.
    pub(super) rate: f32,
    /// The greatest rate in this step, of one that goes to a target.
    pub(super) pace: f32,
    /// At the start of the substep, rad or m.
    pub(super) position: f32,
    /// Along its axis, in the substep so far: N m s or N s.
    pub(super) held: f32,
    /// Along its axis, to act once: likewise.
    pub(super) push: f32,
    /// Whether contact pushes its tree.
    pub(super) is_touched: bool,
}

impl Head {
    pub(super) const NONE: Head = Head {
        place: Place::Outside,
        parent: 0,
        mode: Mode::Passive,
        rate: 0.0,
        pace: 0.0,
        position: 0.0,
        held: 0.0,
        push: 0.0,
        is_touched: false,
    };
}

/// Rows of all units of a copy.
pub(super) struct Limbs<'r> {
    heads: &'r mut [[f32; HEAD]],
    levers: &'r mut [[f32; LEVERS]],
    inertias: &'r mut [[f32; 2 * INERTIA]],
    gains: &'r mut [[f32; 2 * GAINS]],
    loads: &'r mut [[f32; 2 * LOADS]],
    starts: &'r mut [[f32; START]],
}

impl<'r> Limbs<'r> {
    pub(super) fn new(slab: &'r mut [f32], count: usize) -> Self {
        let mut rest = slab;
        Limbs {
            heads: rows(&mut rest, count),
            levers: rows(&mut rest, count),
            inertias: rows(&mut rest, count),
            gains: rows(&mut rest, count),
            loads: rows(&mut rest, count),
            starts: rows(&mut rest, count),
        }
    }

    /// The unit at a place of the order.
    pub(super) fn listed(&self, place: usize) -> usize {
        self.heads.get(place).map_or(0, |[unit, ..]| *unit as usize)
    }

    pub(super) fn list(&mut self, place: usize, number: usize) {
        if let Some([unit, ..]) = self.heads.get_mut(place) {
            *unit = number as f32;
        }
    }

    pub(super) fn head(&self, number: usize) -> Head {
        let Some([_, place, parent, mode, rate, pace, position, held, push, touched]) =
            self.heads.get(number).copied()
        else {
            return Head::NONE;
        };
        let place = match place {
            1.0 => Place::Root,
            2.0 => Place::Held,
            3.0 => Place::Hangs,
            4.0 => Place::HeldBelow,
            _ => Place::Outside,
        };
        let mode = match mode {
            1.0 => Mode::Driven,
            2.0 => Mode::Pushed,
            3.0 => Mode::AtMost,
            4.0 => Mode::AtLeast,
            _ => Mode::Passive,
        };
        let (parent, is_touched) = (parent as usize, touched > 0.0);
        Head { place, parent, mode, rate, pace, position, held, push, is_touched }
    }

    pub(super) fn set_head(&mut self, number: usize, head: &Head) {
        let Some([_, row @ ..]) = self.heads.get_mut(number) else { return };
        let place = match head.place {
            Place::Outside => 0.0,
            Place::Root => 1.0,
            Place::Held => 2.0,
            Place::Hangs => 3.0,
            Place::HeldBelow => 4.0,
        };
        let mode = match head.mode {
            Mode::Passive => 0.0,
            Mode::Driven => 1.0,
            Mode::Pushed => 2.0,
            Mode::AtMost => 3.0,
            Mode::AtLeast => 4.0,
        };
        let touched = if head.is_touched { 1.0 } else { 0.0 };
        let Head { parent, rate, pace, position, held, push, .. } = *head;
        *row = [place, parent as f32, mode, rate, pace, position, held, push, touched];
    }

    /// From the parent's centre to the unit's, as its joint has them; from the unit's to its pivot; the axis.
    pub(super) fn levers(&self, number: usize) -> [Vector3<f32>; 3] {
        let Some([a, b, c, d, e, f, g, h, i]) = self.levers.get(number).copied() else {
            return Default::default();
        };
        [Vector3::new(a, b, c), Vector3::new(d, e, f), Vector3::new(g, h, i)]
    }

    pub(super) fn set_levers(&mut self, number: usize, [a, b, c]: [Vector3<f32>; 3]) {
        if let Some(row) = self.levers.get_mut(number) {
            *row = [a.x, a.y, a.z, b.x, b.y, b.z, c.x, c.y, c.z];
        }
    }

    /// Of a unit with what hangs from it, as its parent feels it; of a free root inverted.
    pub(super) fn inertia(&self, number: usize) -> Inertia {
        let row = self.inertias.get(number).and_then(|row| row.as_chunks().0.first_chunk());
        Inertia::read(&row.map_or([0.0; INERTIA], |row| row.map(whole)))
    }

    pub(super) fn set_inertia(&mut self, number: usize, inertia: &Inertia) {
        if let Some(row) = self.inertias.get_mut(number) {
            row.as_chunks_mut().0.iter_mut().zip(inertia.row()).for_each(|(to, v)| *to = split(v));
        }
    }

    /// Impulses of motions along the open ways, and the ways for impulses along them.
    pub(super) fn gains(&self, number: usize) -> ([Six; 3], [f64; SIX]) {
        let row = self.gains.get(number).and_then(|row| row.as_chunks().0.first_chunk());
        let row: [f64; GAINS] = row.map_or([0.0; GAINS], |row| row.map(whole));
        let [x, y, z, weights] = row.as_chunks().0.first_chunk().copied().unwrap_or_default();
        ([x, y, z].map(|row| Six::read(&row)), weights)
    }

    pub(super) fn set_gains(&mut self, number: usize, gains: &[Six; 3], weights: &[f64; SIX]) {
        if let Some(row) = self.gains.get_mut(number) {
            let [x, y, z] = gains.map(|gain| gain.row());
            let numbers = [x, y, z, *weights];
            let places = row.as_chunks_mut().0.iter_mut();
            places.zip(numbers.as_flattened()).for_each(|(to, v)| *to = split(*v));
        }
    }

    fn six(&self, number: usize, which: usize) -> Six {
        let rows = self.loads.get(number).map(|row| row.as_chunks::<2>().0.as_chunks::<SIX>().0);
        let row = rows.and_then(|rows| rows.get(which));
        row.map_or(Six::ZERO, |row| Six::read(&row.map(whole)))
    }

    fn set_six(&mut self, number: usize, which: usize, six: &Six) {
        let row = self.loads.get_mut(number);
        let rows = row.map(|row| row.as_chunks_mut::<2>().0.as_chunks_mut::<SIX>().0);
        if let Some(row) = rows.and_then(|rows| rows.get_mut(which)) {
            *row = six.row().map(split);
        }
    }

    /// Impulses that reach a unit from below.
    pub(super) fn load(&self, number: usize) -> Six {
        self.six(number, 0)
    }

    pub(super) fn set_load(&mut self, number: usize, load: &Six) {
        self.set_six(number, 0, load);
    }

    /// What a joint wants of a unit's motion beside its parent's.
    pub(super) fn wanted(&self, number: usize) -> Six {
        self.six(number, 1)
    }

    pub(super) fn set_wanted(&mut self, number: usize, wanted: &Six) {
        self.set_six(number, 1, wanted);
    }

    /// What changes of a unit's motion; before, what its joint lacks.
    pub(super) fn change(&self, number: usize) -> Six {
        self.six(number, 2)
    }

    pub(super) fn set_change(&mut self, number: usize, change: &Six) {
        self.set_six(number, 2, change);
    }

    /// The rotation at the start of the substep, and the way and turn since the step began.
    pub(super) fn start(&self, number: usize) -> (Matrix3<f32>, [f32; SIX]) {
        let Some([a, b, c, d, e, f, g, h, i, p, q, r, s, t, u, ..]) = self.starts.get(number)
        else {
            return (Matrix3::identity(), [0.0; SIX]);
        };
        let pose = read_pose(&[*a, *b, *c, *d, *e, *f, *g, *h, *i, 0.0, 0.0, 0.0]);
        (pose.rotation, [*p, *q, *r, *s, *t, *u])
    }

    pub(super) fn set_start(
        &mut self,
        number: usize,
        (rotation, moved): &(Matrix3<f32>, [f32; SIX]),
    ) {
        let Some(row) = self.starts.get_mut(number) else { return };
        let [x, y, z] = columns(rotation);
        let [p, q, r, s, t, u] = *moved;
        let start = [x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z, p, q, r, s, t, u];
        row.iter_mut().zip(start).for_each(|(to, from)| *to = from);
    }

    /// What a joint lacked at the start of the substep, and will go on to lack.
    pub(super) fn open(&self, number: usize) -> Six {
        let row = self.starts.get(number).and_then(|row| row.last_chunk());
        row.map_or(Six::ZERO, |row| Six::read(&row.map(f64::from)))
    }

    pub(super) fn set_open(&mut self, number: usize, open: &Six) {
        if let Some(row) = self.starts.get_mut(number).and_then(|row| row.last_chunk_mut()) {
            *row = open.row().map(|v| v as f32);
        }
    }
}
