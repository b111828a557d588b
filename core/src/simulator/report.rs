//! What a step did.

/// What a step did; of a step in substeps the most that one of them did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepReport {
    /// Units whose motion the network predicted; the others can touch nothing within the
    /// step and moved freely, exactly, or are driven or fixed.
    pub active_units: u32,
    /// Units whose anchors left their rotation open; see [`Rank`](crate::geometry::Rank).
    pub degenerate_units: u32,
    /// Units in [quarantine](crate::Simulator::set_quarantine) after the step.
    #[cfg(feature = "health")]
    pub quarantined_units: u32,
}

impl StepReport {
    /// Of units, none of them in quarantine.
    pub(super) fn of(active_units: u32, degenerate_units: u32) -> Self {
        StepReport {
            active_units,
            degenerate_units,
            #[cfg(feature = "health")]
            quarantined_units: 0,
        }
    }

    /// The same of a copy with so many units in quarantine.
    pub(super) fn with_quarantined(self, units: u32) -> Self {
        #[cfg(feature = "health")]
        return StepReport { quarantined_units: units, ..self };
        #[cfg(not(feature = "health"))]
        {
            let _ = units;
            self
        }
    }

    /// Of a step whose substeps did this and that: the most.
    pub(super) fn or(self, other: StepReport) -> StepReport {
        StepReport {
            active_units: self.active_units.max(other.active_units),
            degenerate_units: self.degenerate_units.max(other.degenerate_units),
            #[cfg(feature = "health")]
            quarantined_units: self.quarantined_units.max(other.quarantined_units),
        }
    }

    /// Of these units and others: the sum.
    pub(super) fn and(self, other: StepReport) -> StepReport {
        StepReport {
            active_units: self.active_units + other.active_units,
            degenerate_units: self.degenerate_units + other.degenerate_units,
            #[cfg(feature = "health")]
            quarantined_units: self.quarantined_units + other.quarantined_units,
        }
    }
}
