//! Convex pieces of hollow units, owned.

use nalgebra::Point3;
use rigidformer_core::Pieces;

/// Convex pieces of a unit: [`Pieces`] with memory of their own. None: the unit is the hull of its points.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_core::{Physics, Unit};
/// use rigidformer_runtime::pieces::ConvexPieces;
/// let corner = |k: u8, bit: u8| if k & bit == 0 { -0.1 } else { 0.1 };
/// let cube: Vec<Point3<f32>> = (0..8).map(|k| Point3::new(corner(k, 1), corner(k, 2), corner(k, 4))).collect();
/// let beside: Vec<_> = cube.iter().map(|point| point + nalgebra::Vector3::x()).collect();
/// let pieces: ConvexPieces = [cube, beside].into_iter().collect();
/// let wood = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.2 };
/// let unit = Unit::new(pieces.points(), wood).pieces(pieces.view());
/// assert_eq!((pieces.len(), unit.room()), (2, 20));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ConvexPieces {
    /// Of all, one piece after another.
    points: Vec<Point3<f32>>,
    counts: Vec<u16>,
}

impl ConvexPieces {
    /// As a unit takes them.
    pub fn view(&self) -> Pieces<'_> {
        Pieces::new(&self.points, &self.counts)
    }

    /// Points of each piece, in the frame of the unit's points, metres.
    pub fn iter(&self) -> impl Iterator<Item = &[Point3<f32>]> {
        self.view().iter()
    }

    /// Points of all, one piece after another.
    pub fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    /// How many points each has.
    pub fn counts(&self) -> &[u16] {
        &self.counts
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.counts.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }
}

impl FromIterator<Vec<Point3<f32>>> for ConvexPieces {
    /// Of more than 65535 points in a piece the first count: a simulator takes 255 at most, and says so.
    fn from_iter<I: IntoIterator<Item = Vec<Point3<f32>>>>(pieces: I) -> Self {
        let mut all = ConvexPieces::default();
        for piece in pieces {
            let count = u16::try_from(piece.len()).unwrap_or(u16::MAX);
            all.points.extend(piece.into_iter().take(usize::from(count)));
            all.counts.push(count);
        }
        all
    }
}
