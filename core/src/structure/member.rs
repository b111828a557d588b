//! What a unit knows of the cluster that it is in: below the scene, so that no file needs one that needs it.

/// What a unit keeps of the cluster that it is in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Member {
    /// One more than the number of the cluster's first unit in the copy; 0 for a unit alone.
    pub(crate) cluster_root: u32,
    /// The number of the next unit of the cluster; behind the last comes the first.
    pub(crate) next: u32,
    /// While clusters are found: a unit that it hangs together with, itself for the first.
    pub(crate) root: u32,
    /// The unit's body before the step under way broke bonds.
    pub(crate) body: u32,
}

impl Member {
    /// Of a unit alone.
    pub(crate) const ALONE: Member = Member { cluster_root: 0, next: 0, root: 0, body: 0 };

    pub(crate) fn cluster_root(&self) -> Option<usize> {
        self.cluster_root.checked_sub(1).map(|cluster_root| cluster_root as usize)
    }

    pub(crate) fn next(&self) -> usize {
        self.next as usize
    }
}
