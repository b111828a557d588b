//! Ground of varying height that owns its heights.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rigidformer_core::{HeightField, HeightFieldError};

/// A [`HeightField`] that owns its heights. Clones share them.
///
/// ```
/// use nalgebra::Vector3;
/// use rigidformer_runtime::terrain::HeightFieldBuf;
///
/// // A bowl: one (rows, columns) height every 10 cm.
/// let height = |i: i32| ((i % 11 - 5).pow(2) + (i / 11 - 5).pow(2)) as f32 * 0.01;
/// let bowl = HeightFieldBuf {
///     heights_m: (0..121).map(height).collect(),
///     columns: 11,
///     spacing_m: [0.1, 0.1],
///     corner_m: Vector3::new(-0.5, -0.5, 0.0),
///     friction: 0.5,
///     restitution: 0.2,
/// };
/// bowl.view().check()?;
/// assert_eq!(bowl.view().height_m(0.0, 0.0), Some(0.0));
/// assert_eq!(bowl.triangles().count(), 200);
/// # Ok::<(), rigidformer_runtime::core::HeightFieldError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct HeightFieldBuf {
    /// (rows, columns) heights above the corner, metres.
    pub heights_m: Arc<[f32]>,
    /// Heights of a row.
    pub columns: usize,
    /// Between columns along x and between rows along y, metres.
    pub spacing_m: [f32; 2],
    /// The place of a first height of zero, metres.
    pub corner_m: Vector3<f32>,
    /// Friction coefficient.
    pub friction: f32,
    /// Restitution coefficient.
    pub restitution: f32,
}

impl HeightFieldBuf {
    /// The field, with these heights.
    pub fn view(&self) -> HeightField<'_> {
        self.over(&self.heights_m)
    }

    /// Its triangles, which go round to the left as seen from above, metres: to draw it.
    pub fn triangles(&self) -> impl Iterator<Item = [Point3<f32>; 3]> + '_ {
        let [dx, dy] = self.spacing_m;
        let corner = move |row: usize, column: usize| {
            let height = self.heights_m.get(row * self.columns + column).copied();
            let way = Vector3::new(dx * column as f32, dy * row as f32, height.unwrap_or_default());
            Point3::from(self.corner_m + way)
        };
        let rows = self.view().rows().saturating_sub(1);
        let columns = self.columns.saturating_sub(1);
        (0..rows).flat_map(move |row| {
            (0..columns).flat_map(move |column| {
                let (first, opposite) = (corner(row, column), corner(row + 1, column + 1));
                let (right, left) = (corner(row, column + 1), corner(row + 1, column));
                [[first, right, opposite], [first, opposite, left]]
            })
        })
    }

    /// The same field over its heights elsewhere in memory.
    pub(crate) fn over<'a>(&self, heights_m: &'a [f32]) -> HeightField<'a> {
        let HeightFieldBuf { columns, spacing_m, corner_m, friction, restitution, .. } = *self;
        HeightField { heights_m, columns, spacing_m, corner_m, friction, restitution }
    }

    /// Of heights that are shared already.
    pub(crate) fn shared(field: &HeightField<'_>, heights_m: Arc<[f32]>) -> Self {
        let HeightField { columns, spacing_m, corner_m, friction, restitution, .. } = *field;
        HeightFieldBuf { heights_m, columns, spacing_m, corner_m, friction, restitution }
    }

    /// A copy of a field.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn copy_of(field: &HeightField<'_>) -> Result<Self, HeightFieldError> {
        field.check()?;
        Ok(HeightFieldBuf::shared(field, field.heights_m.into()))
    }
}
