//! The limits of a model's configuration.

use crate::decimal::Decimal;
use crate::order::order;
use crate::{ModelConfig, Scales};

/// Why a [`ModelConfig`] is no model: the field, its limits and what it held.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A size outside its limits.
    #[error("`{field}` is {found}; a model has {minimum} to {maximum}")]
    Size {
        /// Name of the field.
        field: &'static str,
        /// Smallest accepted value.
        minimum: u32,
        /// Largest accepted value.
        maximum: u32,
        /// The value.
        found: u32,
    },
    /// A real number outside its limits, infinite or not a number.
    #[error(
        "`{field}` is {}; a model has {} to {}",
        Decimal(*.found),
        Decimal(*.minimum),
        Decimal(*.maximum)
    )]
    Number {
        /// Name of the field.
        field: &'static str,
        /// Smallest accepted value.
        minimum: f32,
        /// Largest accepted value.
        maximum: f32,
        /// The value.
        found: f32,
    },
    /// `head_dim` is odd: rotations need pairs of channels.
    #[error("`head_dim` is {found}; rotations turn pairs of channels, so it must be even")]
    OddHead {
        /// The value.
        found: u32,
    },
    /// ARoPE turns more channels than a head has.
    #[error(
        "`rope_frequencies` is {frequencies}; six channels each do not fit into a `head_dim` of {head_dim}"
    )]
    Rope {
        /// Frequencies per axis.
        frequencies: u32,
        /// Channels of a head.
        head_dim: u32,
    },
    /// Motion by impulses without the hulls that it works on.
    #[error("`motion` is Impulses with `features` {found:?}; impulses need the hulls of Impact")]
    Hulls {
        /// The inputs.
        found: crate::FeatureSet,
    },
    /// Motion by a heading with what it does not go with: hulls, or scenes measured in their own length.
    #[error(
        "`motion` is Robot with `{field}`; it goes with the inputs Contact or Paper, SI units and whole steps"
    )]
    Robot {
        /// The field that does not go with it.
        field: &'static str,
    },
    /// Directions without a motion that turns them, beyond the command, or over one another.
    #[error(
        "`directions` are {found:#b} with a command of {command_size}; each takes two numbers of the command, among the first 32, and `motion` Robot"
    )]
    Directions {
        /// The places, as bits.
        found: u32,
        /// Numbers of a command.
        command_size: u32,
    },
    /// Elastic motion, its inputs or its springs without the other two, or with what they do not go with.
    #[cfg(feature = "deform")]
    #[error(
        "`{field}` does not go with the rest: `motion` Soft, `features` Soft and `elastic` come together, without `gate`, a command and `similarity`"
    )]
    Soft {
        /// The field that does not go with it.
        field: &'static str,
    },
    /// A network of bonds with a motion or a measure that it does not go with.
    #[cfg(feature = "deform")]
    #[error(
        "`bonds` do not go with this `{field}`; they go with `motion` Impulses, SI units and whole steps"
    )]
    Bonds {
        /// The field that does not go with it.
        field: &'static str,
    },
    /// A network that sees what is near without impulses, or beside one of bonds.
    #[cfg(feature = "host")]
    #[error(
        "`scope` Near does not go with this `{field}`; it goes with `motion` Impulses, without `bonds`"
    )]
    Scope {
        /// The field that does not go with it.
        field: &'static str,
    },
    /// A limit of units, with what it does not go with.
    #[error(
        "`{field}` goes with `motion` Impulses, without `bonds`; leave it out for other models"
    )]
    Rules {
        /// The field that is there.
        field: &'static str,
    },
    /// Anchors attend to no level at all.
    #[error("`scales` is empty; anchors need at least one level to attend to, such as 0")]
    NoScales,
    /// Anchors attend to a block that does not exist.
    #[error("`scales` names level {highest} of a model with {blocks} blocks")]
    Scale {
        /// The highest level of `scales`.
        highest: u32,
        /// Blocks of the model.
        blocks: u32,
    },
}

/// The widest layer, in channels.
const MAX_WIDTH: u32 = 16_384;
/// The widest point of a model with impacts: ten times this is at most eight times [`MAX_WIDTH`].
const MAX_IMPACT_POINTS: u32 = 13_107;

impl ModelConfig {
    /// A small valid configuration, for examples and tests.
    pub const TINY: ModelConfig = ModelConfig {
        width: 24,
        heads: 2,
        head_dim: 12,
        blocks: 2,
        point_width: 16,
        registers: 2,
        feed_forward_width: 60,
        avp_width: 8,
        film_width: 8,
        command_size: 0,
        rope_frequencies: 2,
        scales: Scales::new(&[0, 1, 2]),
        features: crate::FeatureSet::Paper,
        motion: crate::Motion::Free,
        gate: true,
        output_scale: 1.0,
        frame_rate_hz: 240.0,
        gravity_m_s2: [0.0, 0.0, -9.81],
        ground_friction: 0.3,
        ground_restitution: 0.5,
        hidden: crate::Hidden::DEFAULT,
        similarity: crate::Similarity::OFF,
        directions: crate::Directions::NONE,
        elastic: crate::Elastic::NONE,
        bonds: 0,
        scope: crate::Scope::All,
        most_units: 0,
    };

    /// Checks every field against its limits, in the order of the fields.
    ///
    /// ```
    /// use rigidformer_weights::{ConfigError, ModelConfig};
    ///
    /// assert_eq!(ModelConfig::TINY.validate(), Ok(()));
    /// let odd = ModelConfig { head_dim: 13, ..ModelConfig::TINY };
    /// assert_eq!(odd.validate(), Err(ConfigError::OddHead { found: 13 }));
    /// let features = rigidformer_weights::FeatureSet::Impact;
    /// let wide = ModelConfig { point_width: 13_108, features, ..ModelConfig::TINY };
    /// assert!(matches!(wide.validate(), Err(ConfigError::Size { field: "point_width", .. })));
    /// ```
    ///
    /// # Errors
    /// The first field that is outside its limits.
    pub fn validate(&self) -> Result<(), ConfigError> {
        size("width", self.width, 1, MAX_WIDTH)?;
        size("heads", self.heads, 1, 256)?;
        size("head_dim", self.head_dim, 2, 1024)?;
        if !self.head_dim.is_multiple_of(2) {
            return Err(ConfigError::OddHead { found: self.head_dim });
        }
        // So that int8 products of a layer over eight scales' heads add up within an i32.
        size("heads x head_dim", self.heads.saturating_mul(self.head_dim), 2, MAX_WIDTH)?;
        size("blocks", self.blocks, 1, 32)?;
        // Ten pools of impact models, eight of others, add up within an i32.
        let pools = if self.features.has_impacts() { MAX_IMPACT_POINTS } else { MAX_WIDTH };
        size("point_width", self.point_width, 1, pools)?;
        size("registers", self.registers, 0, 1024)?;
        size("feed_forward_width", self.feed_forward_width, 1, MAX_WIDTH)?;
        size("avp_width", self.avp_width, 1, MAX_WIDTH)?;
        size("film_width", self.film_width, 1, MAX_WIDTH)?;
        size("command_size", self.command_size, 0, 1024)?;
        size("rope_frequencies", self.rope_frequencies, 1, u32::MAX)?;
        if self.rope_frequencies.saturating_mul(6) > self.head_dim {
            return Err(ConfigError::Rope {
                frequencies: self.rope_frequencies,
                head_dim: self.head_dim,
            });
        }
        if self.motion.has_impulses() && !self.features.has_impacts() {
            return Err(ConfigError::Hulls { found: self.features });
        }
        if self.motion.is_robot() && self.features.has_impacts() {
            return Err(ConfigError::Robot { field: "features" });
        }
        if self.motion.is_robot() && !self.similarity.is_off() {
            return Err(ConfigError::Robot { field: "similarity" });
        }
        let room = if self.motion.is_robot() { self.command_size } else { 0 };
        if !self.directions.fit(room) {
            let (found, command_size) = (self.directions.0, self.command_size);
            return Err(ConfigError::Directions { found, command_size });
        }
        #[cfg(feature = "deform")]
        self.validate_soft()?;
        #[cfg(feature = "deform")]
        self.validate_bonds()?;
        #[cfg(feature = "host")]
        self.validate_scope()?;
        self.validate_rules()?;
        if self.scales.is_empty() {
            return Err(ConfigError::NoScales);
        }
        let highest = self.scales.highest() as u32;
        if highest > self.blocks {
            return Err(ConfigError::Scale { highest, blocks: self.blocks });
        }
        number("output_scale", self.output_scale, 1e-6, 1e6)?;
        number("frame_rate_hz", self.frame_rate_hz, 1e-3, 1e6)?;
        for axis in self.gravity_m_s2 {
            number("gravity_m_s2", axis, -1e4, 1e4)?;
        }
        number("ground_friction", self.ground_friction, 0.0, 1e3)?;
        number("ground_restitution", self.ground_restitution, 0.0, 1e3)?;
        let crate::Similarity { length_m, longest_step } = self.similarity;
        if order(length_m) != 0 {
            number("similarity.length_m", length_m, 1e-6, 1e6)?;
        }
        if order(longest_step) != 0 {
            number("similarity.longest_step", longest_step, 1e-6, 1e6)?;
        }
        if cfg!(not(feature = "host")) {
            return Ok(());
        }
        let [first, second] = self.hidden.point;
        size("hidden.point", first, 0, MAX_WIDTH)?;
        // A second layer follows a first.
        size("second hidden.point", second, 0, if first == 0 { 0 } else { MAX_WIDTH })?;
        size("hidden.fuse", self.hidden.fuse, 0, MAX_WIDTH)
    }
}

#[cfg(feature = "deform")]
impl ModelConfig {
    /// Checks what belongs to elastic motion, and that nothing of it is there without the rest.
    fn validate_soft(&self) -> Result<(), ConfigError> {
        let amiss = |field| Err(ConfigError::Soft { field });
        let motion = self.motion.is_soft();
        if self.features.is_soft() != motion {
            return amiss("features");
        }
        let crate::Elastic { neighbours, falloff, .. } = self.elastic;
        if !motion {
            return if self.elastic.is_none() { Ok(()) } else { amiss("elastic") };
        }
        for (field, is_there) in [
            ("gate", self.gate),
            ("command_size", self.command_size > 0),
            ("similarity", !self.similarity.is_off()),
        ] {
            if is_there {
                return amiss(field);
            }
        }
        size("elastic.neighbours", neighbours, 1, crate::MAX_NEIGHBOURS as u32)?;
        size("elastic.falloff", falloff, 0, 16)?;
        number("elastic.thickness_m", self.elastic.thickness_m, 0.0, 1e3)?;
        number("elastic.stiffness", self.elastic.stiffness, 1e-6, 1e6)?;
        number("elastic.damping_s", self.elastic.damping_s, 0.0, 1e3)?;
        number("elastic.skin_m", self.elastic.skin_m, 0.0, 1e3)?;
        number("elastic.rate_hz", self.elastic.rate_hz, 1.0, 1e5)?;
        size("elastic.strain_sweeps", self.elastic.strain_sweeps, 0, 64)?;
        number("elastic.strain_limit", self.elastic.strain_limit, 0.0, 1.0)
    }
}

#[cfg(feature = "deform")]
impl ModelConfig {
    /// Checks that a network of bonds has a solver whose motion it reads.
    fn validate_bonds(&self) -> Result<(), ConfigError> {
        size("bonds", self.bonds, 0, MAX_WIDTH)?;
        let amiss = |field| Err(ConfigError::Bonds { field });
        match self.bonds {
            0 => Ok(()),
            _ if !self.motion.has_impulses() => amiss("motion"),
            _ if !self.similarity.is_off() => amiss("similarity"),
            _ => Ok(()),
        }
    }
}

#[cfg(feature = "host")]
impl ModelConfig {
    /// Checks that a network that sees what is near corrects impulses, which say what it corrects.
    fn validate_scope(&self) -> Result<(), ConfigError> {
        let amiss = |field| Err(ConfigError::Scope { field });
        match self.scope {
            crate::Scope::All => Ok(()),
            _ if !self.motion.has_impulses() => amiss("motion"),
            _ if self.bonds > 0 => amiss("bonds"),
            _ => Ok(()),
        }
    }
}

impl ModelConfig {
    /// Checks that a limit of what is corrected is that of impulses.
    fn validate_rules(&self) -> Result<(), ConfigError> {
        let is_of_impulses = self.motion.has_impulses() && self.bonds == 0;
        match is_of_impulses || self.most_units == 0 {
            true => Ok(()),
            false => Err(ConfigError::Rules { field: "most_units" }),
        }
    }
}

fn size(field: &'static str, found: u32, minimum: u32, maximum: u32) -> Result<(), ConfigError> {
    if (minimum..=maximum).contains(&found) {
        return Ok(());
    }
    Err(ConfigError::Size { field, minimum, maximum, found })
}

fn number(field: &'static str, found: f32, minimum: f32, maximum: f32) -> Result<(), ConfigError> {
    // False for NaN.
    if (order(minimum)..=order(maximum)).contains(&order(found)) {
        return Ok(());
    }
    Err(ConfigError::Number { field, minimum, maximum, found })
}
