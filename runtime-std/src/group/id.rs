//! Names of members.

/// Name of a member of a group, which no other member is ever given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MemberId(u64);

impl MemberId {
    pub(super) const fn new(number: u64) -> Self {
        MemberId(number)
    }

    /// As a number.
    pub const fn to_bits(self) -> u64 {
        self.0
    }
}
