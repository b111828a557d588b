//! Triangles that reach behind a camera.

/// Corners of a triangle that is cut by a plane.
const MOST_CORNERS: usize = 4;

/// The part of a triangle that is so far in front of a camera, or farther, as triangles. `depth_m` is a corner's; `between` is such a part of the
/// way from one corner to another.
pub(super) fn in_front<C: Copy>(
    corners: [C; 3],
    near_m: f32,
    depth_m: impl Fn(&C) -> f32,
    between: impl Fn(&C, &C, f32) -> C,
) -> impl Iterator<Item = [C; 3]> {
    let (mut kept, mut count) = ([corners[0]; MOST_CORNERS], 0);
    let mut keep = |corner: C| {
        if let Some(place) = kept.get_mut(count) {
            *place = corner;
            count += 1;
        }
    };
    for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        let [at_a, at_b] = [a, b].map(&depth_m);
        if at_a >= near_m {
            keep(*a);
        }
        if (at_a >= near_m) != (at_b >= near_m) {
            keep(between(a, b, (near_m - at_a) / (at_b - at_a)));
        }
    }
    let [a, b, c, d] = kept;
    [[a, b, c], [a, c, d]].into_iter().take(count.saturating_sub(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Depths, and places across.
    fn cut(corners: [[f32; 2]; 3]) -> Vec<[[f32; 2]; 3]> {
        let between =
            |a: &[f32; 2], b: &[f32; 2], part: f32| [0, 1].map(|k| a[k] + (b[k] - a[k]) * part);
        in_front(corners, 1.0, |corner| corner[0], between).collect()
    }

    #[test]
    fn what_is_in_front_is_kept_and_the_rest_is_cut_off() {
        let (a, b, c) = ([2.0, 0.0], [3.0, 1.0], [2.0, 2.0]);
        assert_eq!(cut([a, b, c]), [[a, b, c]]);
        let behind = [0.0, 4.0];
        assert_eq!(cut([a, behind, behind]), [[a, [1.0, 2.0], [1.0, 2.0]]]);
        let [near_b, near_a] = [[1.0, 3.0], [1.0, 2.0]];
        assert_eq!(cut([a, b, behind]), [[a, b, near_b], [a, near_b, near_a]]);
        assert!(cut([behind; 3]).is_empty());
        assert!(cut([[f32::NAN; 2]; 3]).is_empty());
    }
}
