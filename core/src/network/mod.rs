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

pub(crate) mod anchors;
pub(crate) mod encoder;
pub(crate) mod features;
pub(crate) mod interaction;
pub(crate) mod layers;
pub(crate) mod motion;
pub(crate) mod nearest;
pub(crate) mod present;
pub(crate) mod wanted;
