//! What training saw: the range of each quantity of a unit that the core measures.

use crate::order::{is_finite, order};
use serde::{Deserialize, Serialize};

/// A quantity of a unit in its scene that training saw a range of (docs/HEALTH.md). Lengths, times and masses are as the model is
/// told them: metres, seconds and kilograms, or those of the scene for models that measure it in its own length. Ranges are of free
/// units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Quantity {
    /// Speed of its centre in the last step, m/s.
    Speed,
    /// Chord of its turn in the last step, twice the sine of half the angle, a second; for small turns the spin, rad/s.
    Spin,
    /// Natural logarithm of its radius, the greatest distance of a point from its centre, m.
    LnRadius,
    /// Least distance from the centre to the end of the points along any of 258 directions, in radii: 0 of a plate.
    Thickness,
    /// Natural logarithm of its mass, kg.
    LnMass,
    /// Friction coefficient.
    Friction,
    /// Restitution coefficient.
    Restitution,
    /// Native frames of the model in a step, or in a part of it: the step code.
    StepCode,
    /// Gravity, m/s^2.
    Gravity,
    /// Cosine of the angle between gravity and the way into the plane that it points into most: 1 on level ground, -1 under it. 0 without
    /// planes.
    Footing,
    /// Natural logarithm of the number of its points.
    LnPoints,
    /// Greatest distance of a point from the one nearest to it, in radii.
    Spacing,
    /// Widest view from the centre that no point is in, of 258 directions: 1 less the cosine of its half angle.
    Hole,
    /// Depth of its lowest point below a plane, in radii; 0 above.
    Depth,
}

impl Quantity {
    /// How many there are.
    pub const COUNT: usize = 14;

    /// All, in the order of [`Ranges::of`].
    pub const ALL: [Quantity; Quantity::COUNT] = [
        Quantity::Speed,
        Quantity::Spin,
        Quantity::LnRadius,
        Quantity::Thickness,
        Quantity::LnMass,
        Quantity::Friction,
        Quantity::Restitution,
        Quantity::StepCode,
        Quantity::Gravity,
        Quantity::Footing,
        Quantity::LnPoints,
        Quantity::Spacing,
        Quantity::Hole,
        Quantity::Depth,
    ];

    /// Whether it counts for units that are not free too: of scenery and of what its owner moves, size and make are nobody's fault.
    pub const fn is_of_all(self) -> bool {
        matches!(
            self,
            Quantity::Speed
                | Quantity::Spin
                | Quantity::StepCode
                | Quantity::Gravity
                | Quantity::Footing
        )
    }

    /// A name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Quantity::Speed => "speed",
            Quantity::Spin => "spin",
            Quantity::LnRadius => "ln radius",
            Quantity::Thickness => "thickness",
            Quantity::LnMass => "ln mass",
            Quantity::Friction => "friction",
            Quantity::Restitution => "restitution",
            Quantity::StepCode => "step code",
            Quantity::Gravity => "gravity",
            Quantity::Footing => "footing",
            Quantity::LnPoints => "ln points",
            Quantity::Spacing => "spacing",
            Quantity::Hole => "hole",
            Quantity::Depth => "depth",
        }
    }
}

/// Ranges of all quantities that training saw; version 9 of the format.
///
/// ```
/// use rigidformer_weights::{Quantity, Ranges};
///
/// let mut ranges = Ranges { of: [[0.0, 1.0]; Quantity::COUNT] };
/// ranges.of[Quantity::Speed as usize] = [0.0, 8.0];
/// assert!(ranges.are_sound());
/// assert_eq!(ranges.beyond(Quantity::Speed, 10.0), 0.25); // a quarter of the range outside
/// assert_eq!(ranges.beyond(Quantity::Speed, 2.0), -0.25); // inside
/// assert_eq!(ranges.beyond(Quantity::Speed, f32::NAN), f32::INFINITY);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ranges {
    /// Lowest and highest value of each of [`Quantity::ALL`].
    pub of: [[f32; 2]; Quantity::COUNT],
}

impl Ranges {
    /// Whether all are finite, each at most half the largest number, and each lowest value is below the highest.
    pub fn are_sound(&self) -> bool {
        self.first_bad().is_none()
    }

    /// The first range that is none.
    pub(crate) fn first_bad(&self) -> Option<usize> {
        // The width of a range is finite too.
        let (least, most) = (order(f32::MIN / 2.0), order(f32::MAX / 2.0));
        let is_sound = |[low, high]: &[f32; 2]| {
            order(*low) < order(*high) && order(*low) >= least && order(*high) <= most
        };
        self.of.iter().position(|range| !is_sound(range))
    }

    /// How far a value is beyond its range, in widths of the range: above 0 outside, below 0 inside, where it counts from the
    /// nearer end. Infinite for what is no number. It computes as the thread is set; `Simulator::health` of `rigidformer-core`
    /// computes to nearest.
    pub fn beyond(&self, quantity: Quantity, value: f32) -> f32 {
        let [low, high] = self.of.get(quantity as usize).copied().unwrap_or_default();
        if !is_finite(value) {
            return f32::INFINITY;
        }
        (low - value).max(value - high) / (high - low)
    }
}
