//! How contacts that bounce differ from rigid ones in whatever recorded a scene.

use core::fmt;
use core::str::FromStr;
use thiserror::Error;

/// Where friction at a contact that bounces is limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrictionLimit {
    /// Along and across the sliding together: Coulomb's law.
    #[default]
    Cone,
    /// Along the sliding and across it apart, as Bullet does.
    Pyramid,
}

/// How contacts that bounce differ from rigid ones in what recorded a scene, such as a physics engine (docs/CONTACT.md). Its text is
/// what scene files have: the offset, and `,pyramid` behind it.
///
/// ```
/// use rigidformer_core::{ContactLaw, FrictionLimit};
/// let bullet: ContactLaw = "0.03,pyramid".parse()?;
/// assert_eq!(bullet, ContactLaw { restitution_offset: 0.03, friction: FrictionLimit::Pyramid });
/// assert!(ContactLaw::default().is_rigid() && bullet.is_sound());
/// # Ok::<(), rigidformer_core::NoContactLaw>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactLaw {
    /// Is added to the restitution of each pair, up to 1; 0 to 1.
    pub restitution_offset: f32,
    /// Of contacts that bounce.
    pub friction: FrictionLimit,
}

impl ContactLaw {
    /// That of rigid contacts: the default.
    pub const RIGID: ContactLaw =
        ContactLaw { restitution_offset: 0.0, friction: FrictionLimit::Cone };

    /// Whether contacts are rigid ones, in any floating-point environment.
    pub const fn is_rigid(&self) -> bool {
        let is_zero = self.restitution_offset.to_bits() << 1 == 0;
        is_zero && matches!(self.friction, FrictionLimit::Cone)
    }

    /// Whether its number is in range, in any floating-point environment.
    pub const fn is_sound(&self) -> bool {
        // Bits of numbers from 0 on rise as they do. Negative numbers are above, and so is what is no number.
        let bits = self.restitution_offset.to_bits();
        bits <= 1.0_f32.to_bits() || bits == (-0.0_f32).to_bits()
    }

    /// The same law, whose zero has no sign.
    pub(crate) const fn plain(self) -> Self {
        ContactLaw { restitution_offset: self.restitution_offset.abs(), ..self }
    }
}

impl fmt::Display for ContactLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.plain().restitution_offset)?;
        match self.friction {
            FrictionLimit::Cone => Ok(()),
            FrictionLimit::Pyramid => f.write_str(",pyramid"),
        }
    }
}

/// A text that is no contact law.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "a contact law is a number from 0 to 1, with `,pyramid` behind it or without, such as 0.03,pyramid"
)]
pub struct NoContactLaw;

impl FromStr for ContactLaw {
    type Err = NoContactLaw;

    fn from_str(text: &str) -> Result<Self, NoContactLaw> {
        let (offset, friction) = match text.split_once(',') {
            None => (text, FrictionLimit::Cone),
            Some((offset, "pyramid")) => (offset, FrictionLimit::Pyramid),
            Some(_) => return Err(NoContactLaw),
        };
        let restitution_offset = offset.parse().map_err(|_| NoContactLaw)?;
        let law = ContactLaw { restitution_offset, friction };
        if law.is_sound() { Ok(law.plain()) } else { Err(NoContactLaw) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn laws_come_back_from_their_texts() {
        for (text, offset, friction) in [
            ("0", 0.0, FrictionLimit::Cone),
            ("0,pyramid", 0.0, FrictionLimit::Pyramid),
            ("0.03", 0.03, FrictionLimit::Cone),
            ("0.03,pyramid", 0.03, FrictionLimit::Pyramid),
            ("1", 1.0, FrictionLimit::Cone),
        ] {
            let law: ContactLaw = text.parse().unwrap();
            assert_eq!(law, ContactLaw { restitution_offset: offset, friction });
            assert_eq!(law.to_string(), text);
        }
        assert_eq!("-0".parse::<ContactLaw>().unwrap().to_string(), "0");
        for text in
            ["", ",", "0.1,", "0.1,cone", "0.1,pyramid,", "1.1", "-0.1", "nan", "inf", " 0", "a"]
        {
            assert_eq!(text.parse::<ContactLaw>(), Err(NoContactLaw), "{text}");
        }
    }

    #[test]
    fn offsets_are_from_0_to_1() {
        let law = |restitution_offset| ContactLaw { restitution_offset, ..ContactLaw::RIGID };
        let tiny = f32::from_bits(1);
        for sound in [0.0, -0.0, tiny, 0.5, 1.0] {
            assert!(law(sound).is_sound(), "{sound}");
        }
        for wrong in [-tiny, 1.0 + f32::EPSILON, -1.0, f32::INFINITY, f32::NAN, -f32::NAN] {
            assert!(!law(wrong).is_sound(), "{wrong}");
        }
        assert!(law(-0.0).is_rigid() && !law(tiny).is_rigid());
        assert!(!ContactLaw { friction: FrictionLimit::Pyramid, ..ContactLaw::RIGID }.is_rigid());
    }
}
