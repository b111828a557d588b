//! The network: a block of the paper a file, and what the blocks share.
//!
//! | file | does |
//! |---|---|
//! | `features` | what the network is told about a point |
//! | `nearest` | the nearest plane, or point of another body |
//! | `encoder` | points to unit tokens |
//! | `interaction` | blocks over unit tokens and registers |
//! | `anchors` | pooled neighbourhood, attention to the units, head |
//! | `motion` | integration of the head's output |
//! | `layers` | slices in, slices out |
//! | `present` | which units the network sees, and in which rows |
//! | `wanted` | which rows of the output somebody reads |

use crate::scene::Scene;
use crate::sizes::Sizes;
use crate::workspace::{Lasting, Rows};
use present::Present;

/// What of the scene all blocks read.
#[derive(Clone, Copy)]
pub(crate) struct View<'a> {
    pub(crate) scene: &'a Scene<'a>,
    pub(crate) present: Present<'a>,
}

impl<'a> View<'a> {
    /// Of the units that [`present::find`] found, where the model sees some of them.
    pub(crate) fn new(sizes: &Sizes, scene: &'a Scene<'_>, found: Option<&'a [f32]>) -> Self {
        View { scene, present: Present::of(sizes, scene, found) }
    }
}

/// What blocks write.
pub(crate) struct Buffers<'a, 's> {
    pub(crate) lasting: &'a mut Lasting<'s>,
    pub(crate) rows: &'a mut Rows<'s>,
}

pub(crate) mod anchors;
pub(crate) mod encoder;
pub(crate) mod features;
pub(crate) mod interaction;
pub(crate) mod layers;
pub(crate) mod motion;
pub(crate) mod nearest;
pub(crate) mod present;
pub(crate) mod wanted;
