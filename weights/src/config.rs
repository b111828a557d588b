//! What a model file says about its model: widths, inputs, integrator and physics.

use crate::order::order;
use serde::{Deserialize, Serialize};

/// Inputs of a point (docs/MODEL.md, section 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FeatureSet {
    /// The paper's 12 inputs: displacement to the nearest point, increment, offset, physics.
    Paper,
    /// Those 12 in SI units and 22 quantities derived from the same observation.
    Contact,
    /// Those of [`Contact`](FeatureSet::Contact) for points, and for each unit its most urgent
    /// [impacts](IMPACTS) under free motion, between the convex hulls of points.
    Impact,
    /// Those of [`Contact`](FeatureSet::Contact), the logarithm of Young's modulus (0: rigid), and what springs and contact change of a
    /// point's motion in the step: its way and its velocity, m/s. With [`Motion::Soft`] alone.
    #[cfg(feature = "deform")]
    Soft,
}

/// Numbers of an anchor that its points are told beside its way and its velocity, with [`Motion::Soft`].
pub const BLEND_CODE: usize = 16;
/// Hidden channels of the network that reads them for each point.
pub const BLEND_HIDDEN: usize = 32;
/// Springs of a point to its nearest neighbours, at most.
pub const MAX_NEIGHBOURS: usize = 32;

/// Numbers that the network of bonds is told of a bond beside the tokens of its units (docs/MODEL.md, section 7).
pub const BOND_FEATURES: usize = 16;

/// Impacts of a unit that a model with them is told of, at most.
pub const IMPACTS: usize = 4;
/// Numbers of an impact.
pub const IMPACT_FEATURES: usize = 43;
/// Numbers that impacts add to an anchor's query: its velocity changes by them, with what is left of the step, and
/// without (m/s).
pub const IMPACT_PUSHES: usize = 6;

impl FeatureSet {
    /// Numbers per point.
    pub const fn len(self) -> usize {
        match self {
            FeatureSet::Paper => 12,
            FeatureSet::Contact | FeatureSet::Impact => 34,
            #[cfg(feature = "deform")]
            FeatureSet::Soft => 41,
        }
    }

    /// Whether points are told of elastic motion.
    pub const fn is_soft(self) -> bool {
        match self {
            #[cfg(feature = "deform")]
            FeatureSet::Soft => true,
            _ => false,
        }
    }

    /// Whether units are told of their impacts.
    pub const fn has_impacts(self) -> bool {
        matches!(self, FeatureSet::Impact)
    }

    /// Never: a point always has inputs.
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// What the head's output means (docs/MODEL.md, section 6).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Motion {
    /// Accelerations in m/s², integrated by Verlet (paper, eq. 3).
    Verlet,
    /// Velocity changes in m/s against exact free motion.
    Free,
    /// Against motion with contact by sequential impulses, in m/s: an anchor's way, by the step's time, and its velocity at
    /// the end of the step. With the inputs [`FeatureSet::Impact`] alone; version 4 of the format.
    Impulses,
    /// Velocity changes in m/s against a motion that carries all units alike: the turn of heading and the way over the ground
    /// of the heaviest unit in the last step, once more. Inputs and outputs are seen from that unit's heading. For the parts
    /// of a robot under command; with the inputs [`FeatureSet::Contact`] or [`FeatureSet::Paper`]; version 5 of the format.
    Robot,
    /// Against the elastic motion of soft bodies, with contact: an anchor's way, by the step's time, and its velocity at the end of
    /// the step, m/s, and [`BLEND_CODE`] numbers that its points are told. With the inputs [`FeatureSet::Soft`] alone; version 6 of
    /// the format.
    #[cfg(feature = "deform")]
    Soft,
}

impl Motion {
    /// Numbers that the head gives for each anchor.
    pub const fn outputs(self) -> usize {
        match self {
            Motion::Verlet | Motion::Free | Motion::Robot => 3,
            Motion::Impulses => 6,
            #[cfg(feature = "deform")]
            Motion::Soft => 6 + BLEND_CODE,
        }
    }

    /// Whether soft units move by springs.
    pub const fn is_soft(self) -> bool {
        match self {
            #[cfg(feature = "deform")]
            Motion::Soft => true,
            _ => false,
        }
    }

    /// Whether contact is solved before the network corrects it.
    pub const fn has_impulses(self) -> bool {
        matches!(self, Motion::Impulses)
    }

    /// Whether the network sees all from the heading of the heaviest unit.
    pub const fn is_robot(self) -> bool {
        matches!(self, Motion::Robot)
    }
}

/// The encoder output (0) and block outputs (1..) that anchors attend to, as a bit set:
/// sorted and unique by construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Scales(pub u32);

impl Scales {
    /// Scales from their levels, each below 32 (a higher one counts as 31).
    ///
    /// ```
    /// use rigidformer_weights::Scales;
    ///
    /// let scales = Scales::new(&[0, 1, 2, 4]);
    /// assert_eq!((scales.len(), scales.highest(), scales.position(4)), (4, 4, Some(3)));
    /// ```
    pub const fn new(mut levels: &[u32]) -> Self {
        let mut bits = 0;
        while let [level, rest @ ..] = levels {
            bits |= 1 << if *level < 31 { *level } else { 31 };
            levels = rest;
        }
        Scales(bits)
    }

    /// How many scales.
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether there is none, which no valid model has.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The highest level, 0 when empty.
    pub const fn highest(self) -> usize {
        if self.0 == 0 { 0 } else { 31u32.saturating_sub(self.0.leading_zeros()) as usize }
    }

    /// Position of a level among the scales in ascending order, if it is one.
    pub const fn position(self, level: usize) -> Option<usize> {
        if level > 31 || self.0 & (1 << level) == 0 {
            return None;
        }
        Some((self.0 & (1u32 << level).wrapping_sub(1)).count_ones() as usize)
    }
}

/// Inner widths that version 1 of the format takes from others; 0 stands for those.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hidden {
    /// Hidden channels of the point network, layer by layer; `[0, 0]` is one hidden layer of
    /// `point_width`, a second 0 one hidden layer of the first.
    pub point: [u32; 2],
    /// Hidden channels of the fusion of pooled levels; 0 is `width`.
    pub fuse: u32,
}

impl Hidden {
    /// Those of version 1.
    pub const DEFAULT: Hidden = Hidden { point: [0, 0], fuse: 0 };
}

/// What lets one model predict scenes of any size (docs/MODEL.md, section 1); version 3 of the format.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Typical radius of the units that the model was trained on, metres: scenes are measured in their own lengths, times
    /// and masses. 0: they are taken as they come, in SI units.
    pub length_m: f32,
    /// Longest step code that the model was trained on: longer steps are taken in equal parts. 0: all are taken whole.
    pub longest_step: f32,
}

impl Similarity {
    /// SI units and whole steps, which versions 1 and 2 have.
    pub const OFF: Similarity = Similarity { length_m: 0.0, longest_step: 0.0 };

    /// Whether it is [`OFF`](Self::OFF), in any floating-point environment.
    pub(crate) const fn is_off(&self) -> bool {
        order(self.length_m) == 0 && order(self.longest_step) == 0
    }
}

/// Where in a command two numbers, one after the other, are a horizontal direction in the world, such as the way to go: a
/// model of [`Motion::Robot`] is told it in the heading. Bit k stands for the numbers k and k + 1, of the command's first
/// 32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Directions(pub u32);

impl Directions {
    /// Commands hold no directions in the world.
    pub const NONE: Directions = Directions(0);

    /// Directions by the index of their first number, each below 31 (a higher one counts as 31).
    ///
    /// ```
    /// use rigidformer_weights::Directions;
    ///
    /// // Speed, direction of travel, direction to face.
    /// let directions = Directions::new(&[1, 3]);
    /// assert_eq!(directions.indices().collect::<Vec<_>>(), [1, 3]);
    /// ```
    pub const fn new(mut indices: &[u32]) -> Self {
        let mut bits = 0;
        while let [index, rest @ ..] = indices {
            bits |= 1 << if *index < 31 { *index } else { 31 };
            indices = rest;
        }
        Directions(bits)
    }

    /// Indices of the first numbers, ascending.
    pub fn indices(self) -> impl Iterator<Item = usize> {
        (0..32).filter(move |index| self.0 >> index & 1 == 1)
    }

    /// Whether commands of so many numbers have room for them, and none shares a number with another.
    pub(crate) const fn fit(self, command_size: u32) -> bool {
        let apart = self.0 & (self.0 << 1) == 0;
        let highest = 32u32.saturating_sub(self.0.leading_zeros());
        apart && self.0 >> 31 == 0 && (self.0 == 0 || highest < command_size)
    }
}

/// The elastic motion that a model of soft bodies corrects: springs join each point of a body to its nearest ones at rest
/// (docs/MODEL.md, section 6); version 6 of the format. Without the feature `deform` it has no fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Elastic {
    /// Springs of a point to its nearest neighbours, 1 to [`MAX_NEIGHBOURS`]; 0 for models of other motion.
    #[cfg(feature = "deform")]
    pub neighbours: u32,
    /// How often a spring's stiffness is multiplied by the distance between points over its length, 0 to 16.
    #[cfg(feature = "deform")]
    pub falloff: u32,
    /// Metres that Young's modulus is multiplied by, for a spring's stiffness, N/m; 0: a solid, by the distance between points.
    #[cfg(feature = "deform")]
    pub thickness_m: f32,
    /// What the stiffness is multiplied by.
    #[cfg(feature = "deform")]
    pub stiffness: f32,
    /// Time in which a spring loses its rate, s.
    #[cfg(feature = "deform")]
    pub damping_s: f32,
    /// Points keep so far away from planes and from units of other bodies, metres.
    #[cfg(feature = "deform")]
    pub skin_m: f32,
    /// Sub-steps a second, Hz.
    #[cfg(feature = "deform")]
    pub rate_hz: f32,
    /// Sweeps over all springs after the network's correction, 0 to 64; 0: strain is not limited.
    #[cfg(feature = "deform")]
    pub strain_sweeps: u32,
    /// Springs are at most so much longer than at rest, and short ones shorter, as a share, 0 to 1.
    #[cfg(feature = "deform")]
    pub strain_limit: f32,
}

impl Elastic {
    /// None: for models of other motion.
    pub const NONE: Elastic = Elastic {
        #[cfg(feature = "deform")]
        neighbours: 0,
        #[cfg(feature = "deform")]
        falloff: 0,
        #[cfg(feature = "deform")]
        thickness_m: 0.0,
        #[cfg(feature = "deform")]
        stiffness: 0.0,
        #[cfg(feature = "deform")]
        damping_s: 0.0,
        #[cfg(feature = "deform")]
        skin_m: 0.0,
        #[cfg(feature = "deform")]
        rate_hz: 0.0,
        #[cfg(feature = "deform")]
        strain_sweeps: 0,
        #[cfg(feature = "deform")]
        strain_limit: 0.0,
    };

    /// Whether it is [`NONE`](Self::NONE), in any floating-point environment.
    #[cfg(feature = "deform")]
    pub(crate) fn is_none(&self) -> bool {
        let Elastic { neighbours, falloff, strain_sweeps, .. } = *self;
        let numbers = [self.thickness_m, self.stiffness, self.damping_s, self.skin_m];
        let numbers = numbers.iter().chain([&self.rate_hz, &self.strain_limit]);
        [neighbours, falloff, strain_sweeps] == [0; 3]
            && numbers.into_iter().all(|v| order(*v) == 0)
    }
}

/// Which units of a scene the network sees in a step (docs/MODEL.md, section 4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scope {
    /// All.
    #[default]
    All,
    /// Those that it corrects, and those that may touch one of them within the step: a step costs what is in contact, not what there
    /// is. With [`Motion::Impulses`] alone; version 8 of the format.
    #[cfg(feature = "host")]
    Near,
}

impl Scope {
    /// Whether what is not near what it corrects is left out.
    pub const fn is_near(self) -> bool {
        match self {
            Scope::All => false,
            #[cfg(feature = "host")]
            Scope::Near => true,
        }
    }
}

/// Sizes and physics of one model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelConfig {
    /// Channels of a unit token (D).
    pub width: u32,
    /// Attention heads (H).
    pub heads: u32,
    /// Channels of a head; even.
    pub head_dim: u32,
    /// Interaction blocks (L).
    pub blocks: u32,
    /// Channels of a point (C).
    pub point_width: u32,
    /// Learned tokens beside the units (R).
    pub registers: u32,
    /// Hidden channels of SwiGLU.
    pub feed_forward_width: u32,
    /// Channels of anchor-vertex pooling after its projection.
    pub avp_width: u32,
    /// Hidden channels of the step and command modulation.
    pub film_width: u32,
    /// Numbers in a command vector, 0 for models without commands.
    pub command_size: u32,
    /// ARoPE frequencies per axis; six times this is at most `head_dim`.
    pub rope_frequencies: u32,
    /// Levels that anchors attend to, each at most `blocks`.
    pub scales: Scales,
    /// Inputs of a point.
    pub features: FeatureSet,
    /// Meaning of the head's output.
    pub motion: Motion,
    /// Whether units that can touch nothing within a step move freely, exactly.
    pub gate: bool,
    /// Head output times this is in the unit of `motion`.
    pub output_scale: f32,
    /// Native frames per second: step code s means s / this many seconds.
    pub frame_rate_hz: f32,
    /// Gravity, m/s².
    pub gravity_m_s2: [f32; 3],
    /// Friction coefficient of the ground plane z = 0.
    pub ground_friction: f32,
    /// Restitution coefficient of the ground plane.
    pub ground_restitution: f32,
    /// Inner widths.
    #[serde(skip)]
    pub hidden: Hidden,
    /// Scenes in their own units, and steps in parts.
    #[serde(skip)]
    pub similarity: Similarity,
    /// Directions in the world among a command's numbers.
    #[serde(skip)]
    pub directions: Directions,
    /// Springs of soft bodies.
    #[serde(skip)]
    pub elastic: Elastic,
    /// Hidden channels of the network that says which bonds between units break; 0: there is none. With [`Motion::Impulses`] alone,
    /// in SI units and whole steps; version 7 of the format.
    #[serde(skip)]
    pub bonds: u32,
    /// Units that the network sees.
    #[serde(skip)]
    pub scope: Scope,
    /// Copies of more units than this, and scenes whose contact law is not rigid, are not corrected: they move by impulses
    /// alone; 0: all are. With [`Motion::Impulses`] alone; version 10 of the format.
    #[serde(skip)]
    pub most_units: u32,
}

impl ModelConfig {
    /// Hidden channels of the point network: of its first hidden layer, and of its second or 0.
    pub const fn point_hidden(&self) -> [u32; 2] {
        match self.hidden.point {
            [0, _] => [self.point_width, 0],
            widths => widths,
        }
    }

    /// Hidden channels of the fusion of pooled levels.
    pub const fn fuse_hidden(&self) -> u32 {
        if self.hidden.fuse == 0 { self.width } else { self.hidden.fuse }
    }

    /// The oldest version of the format that holds the model.
    pub(crate) fn version(&self, panels: bool) -> u32 {
        if self.most_units > 0 {
            10
        } else if self.scope.is_near() {
            8
        } else if self.bonds > 0 {
            7
        } else if self.motion.is_soft() || self.features.is_soft() {
            6
        } else if self.motion.is_robot() {
            5
        } else if self.motion.has_impulses() {
            4
        } else if !self.similarity.is_off() {
            3
        } else if panels || self.hidden != Hidden::DEFAULT {
            2
        } else {
            1
        }
    }
}
