//! What is known of a unit, in words.

use rigidformer_perception::estimate::{Rest, Visibility};

/// Whether a capture shows a unit, in a word.
pub(super) fn sight_word(visibility: Visibility) -> &'static str {
    match visibility {
        Visibility::Seen => "seen",
        Visibility::Hidden => "hidden",
        Visibility::Missed => "missed",
    }
}

/// Whether a unit rests, in a word.
pub(super) fn rest_word(rest: Rest) -> &'static str {
    match rest {
        Rest::Moving => "moving",
        Rest::Supported => "supported",
        Rest::Held => "unsupported, held",
    }
}
