//! Units that hold together until their bond breaks, as recorded.

/// Two units of a scene that hold together until their bond breaks.
///
/// ```
/// use rigidformer_evaluation::scenes::RecordedBond;
/// let bond = RecordedBond { units: [0, 2], breaks_at: Some(24) };
/// assert!(bond.holds(23) && !bond.holds(24));
/// assert!(RecordedBond { breaks_at: None, ..bond }.holds(1000));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordedBond {
    /// Numbers of the units in the scene.
    pub units: [usize; 2],
    /// The first frame in which the bond is broken; `None`: it holds as long as the record goes.
    pub breaks_at: Option<usize>,
}

impl RecordedBond {
    /// Whether it holds at a frame.
    pub fn holds(&self, frame: usize) -> bool {
        self.breaks_at.is_none_or(|breaks_at| frame < breaks_at)
    }

    /// The same bond in a record of `frames` frames: beyond them nothing breaks.
    pub(super) fn within(self, frames: usize) -> Self {
        // A file says with a frame beyond the record that a bond never breaks.
        Self { breaks_at: self.breaks_at.filter(|frame| *frame < frames), ..self }
    }

    /// The same bond in a record that begins `skipped` frames later.
    pub(super) fn later(self, skipped: usize) -> Self {
        // A bond that broke in the frames that are left out is broken from frame 0 on.
        Self { breaks_at: self.breaks_at.map(|frame| frame.saturating_sub(skipped)), ..self }
    }
}

/// For each of so many units the lowest number of the units that it hangs together with, through pairs that hold, directly or
/// through others; its own number where there are none. Pairs of units that are not there count for nothing.
///
/// ```
/// use rigidformer_evaluation::scenes::clusters;
/// assert_eq!(clusters(5, [[4, 3], [1, 3]]), [0, 1, 2, 1, 1]);
/// ```
pub fn clusters(units: usize, pairs: impl IntoIterator<Item = [usize; 2]>) -> Vec<usize> {
    let mut roots: Vec<usize> = (0..units).collect();
    for [a, b] in pairs {
        let (Some(one), Some(other)) = (roots.get(a).copied(), roots.get(b).copied()) else {
            continue;
        };
        // The lowest number stands for a cluster, so that the order of the pairs does not matter.
        let (low, high) = (one.min(other), one.max(other));
        roots.iter_mut().filter(|root| **root == high).for_each(|root| *root = low);
    }
    roots
}
