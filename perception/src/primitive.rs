//! Fits boxes, cylinders and balls to the observed surface of a unit.
//!
//! Most bodies that robots handle are about one of these. The front determines such a body: two faces and their boundaries give a box.

use nalgebra::{Matrix3, Matrix4, Point3, Rotation3, Unit, Vector2, Vector3, Vector4};

/// A surface element: point and outward normal.
pub(super) type Element = (Point3<f32>, Vector3<f32>);

/// Elements that a fit needs.
const MIN_ELEMENTS: usize = 24;
/// Distance from a form within which an element is an inlier, in radii of the observed surface.
// Surfels average points over a cell, and lie off curved surfaces by a few per cent of the radius.
const INLIER_DISTANCE: f32 = 0.04;
/// Least share of inliers of a form.
const MIN_INLIER_SHARE: f32 = 0.8;
/// Elements of a face, at least.
const MIN_FACE_ELEMENTS: usize = 6;
/// Least cosine between normals of one flat face while its direction is searched.
const FACE_SEARCH_COSINE: f32 = 0.985;
/// The same while its offset is measured.
// The direction is known then, so noisier normals count too.
const FACE_COSINE: f32 = 0.94;
/// Normals that are tried as that of the largest face.
// Each costs a pass over all elements, and a large face has many of them.
const MAX_TRIED_NORMALS: usize = 80;
/// Rounds of iteratively reweighted least squares.
const REWEIGHTING_ROUNDS: usize = 5;
/// Median residuals above which Huber's weight falls.
const HUBER_MEDIANS: f32 = 2.5;
/// Outermost elements that are left out where an end shows no face.
// They may be of another body.
const TRIMMED_ELEMENTS: usize = 2;
/// Points on a ball, and their distance from its centre in radii.
// Faces of a hull lie inside the ball: a larger radius makes the hull as large as the ball.
const BALL_POINTS: usize = 96;
const BALL_SCALE: f32 = 1.015;
/// Points around each end of a cylinder, and their distance from its axis in radii.
// As for a ball: a polygon's edges lie inside its circle.
const RING_POINTS: usize = 24;
const RING_SCALE: f32 = 1.003;

/// A convex form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Form {
    Box { centre: Point3<f32>, axes: Rotation3<f32>, half_m: Vector3<f32> },
    Cylinder { centre: Point3<f32>, axis: Unit<Vector3<f32>>, radius_m: f32, half_m: f32 },
    Ball { centre: Point3<f32>, radius_m: f32 },
}

impl Form {
    /// The form with the smallest sum of truncated distances, of those with enough inliers.
    pub(super) fn fit(elements: &[Element]) -> Option<Form> {
        if elements.len() < MIN_ELEMENTS {
            return None;
        }
        let (first, _) = elements.first()?;
        let bounds =
            elements.iter().fold((first.coords, first.coords), |(low, high), (point, _)| {
                (low.inf(&point.coords), high.sup(&point.coords))
            });
        let radius_m = 0.5 * (bounds.1 - bounds.0).norm();
        let limit = INLIER_DISTANCE * radius_m;
        let face = largest_face(elements, None);
        let forms =
            [box_of(elements, face, limit), cylinder_of(elements, face, limit), ball_of(elements)];
        let rated = forms.into_iter().flatten().filter_map(|form| {
            // A form far larger than its elements extrapolates noise.
            let far = form.is_larger_than(2.5 * radius_m);
            let distances = elements.iter().map(|(point, _)| form.distance_m(point).abs());
            let (on, sum) = distances.fold((0_usize, 0.0_f32), |(on, sum), distance| {
                (on + usize::from(distance < limit), sum + distance.min(2.0 * limit))
            });
            let is_good =
                !far && sum.is_finite() && on as f32 >= MIN_INLIER_SHARE * elements.len() as f32;
            is_good.then_some((sum, form))
        });
        rated.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, form)| form)
    }

    /// Signed distance of a point from the surface, metres: below 0 inside.
    pub(super) fn distance_m(&self, point: &Point3<f32>) -> f32 {
        let signed = |excess: Vector3<f32>| {
            let outside = excess.map(|e| e.max(0.0)).norm();
            outside + excess.max().min(0.0)
        };
        match self {
            Form::Box { centre, axes, half_m } => {
                signed(axes.inverse_transform_vector(&(point - centre)).abs() - half_m)
            }
            Form::Cylinder { centre, axis, radius_m, half_m } => {
                let along = axis.dot(&(point - centre));
                let orthogonal_axes = ((point - centre) - axis.as_ref() * along).norm();
                // A cylinder has two constraints, and the box's formula takes three.
                signed(Vector3::new(orthogonal_axes - radius_m, along.abs() - half_m, f32::MIN))
            }
            Form::Ball { centre, radius_m } => (point - centre).norm() - radius_m,
        }
    }

    /// Points whose hull is the form: 26 of a box, 48 of a cylinder, 96 of a ball.
    pub(super) fn points(&self) -> Vec<Point3<f32>> {
        match self {
            Form::Box { centre, axes, half_m } => (0..27)
                .filter(|at| *at != 13)
                .map(|at| [at % 3, at / 3 % 3, at / 9].map(|side| side as f32 - 1.0))
                .map(|side| centre + axes * half_m.component_mul(&Vector3::from(side)))
                .collect(),
            Form::Cylinder { centre, axis, radius_m, half_m } => {
                let (a, b) = orthogonal_axes(axis);
                let radius = RING_SCALE * radius_m;
                let ring = (0..RING_POINTS)
                    .map(|at| at as f32 * std::f32::consts::TAU / RING_POINTS as f32);
                ring.map(|angle| angle.sin_cos())
                    .map(|(sin, cos)| (a * cos + b * sin) * radius)
                    .flat_map(|out| {
                        [-*half_m, *half_m].map(|along| centre + out + axis.as_ref() * along)
                    })
                    .collect()
            }
            Form::Ball { centre, radius_m } => {
                // A Fibonacci lattice: steps of the golden angle space the points evenly.
                let golden = std::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
                let points = (0..BALL_POINTS).map(|at| {
                    let z = 1.0 - 2.0 * (at as f32 + 0.5) / BALL_POINTS as f32;
                    let (sin, cos) = (golden * at as f32).sin_cos();
                    let out =
                        Vector3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
                    centre + out * (BALL_SCALE * radius_m)
                });
                points.collect()
            }
        }
    }

    fn is_larger_than(&self, most_m: f32) -> bool {
        match self {
            Form::Box { half_m, .. } => half_m.max() > most_m,
            Form::Cylinder { radius_m, half_m, .. } => radius_m.max(*half_m) > most_m,
            // A nearly flat surface lies on a ball of any size.
            Form::Ball { radius_m, .. } => *radius_m > 0.6 * most_m,
        }
    }
}

/// Two unit vectors that are orthogonal to an axis and to each other.
fn orthogonal_axes(axis: &Unit<Vector3<f32>>) -> (Vector3<f32>, Vector3<f32>) {
    let mut beside = Vector3::zeros();
    beside[axis.iamin()] = 1.0;
    let a = axis.cross(&beside).normalize();
    (a, axis.cross(&a))
}

/// The direction of most normals, up to sign; orthogonal to `beside`, if given.
fn largest_face(elements: &[Element], beside: Option<&Vector3<f32>>) -> Option<Unit<Vector3<f32>>> {
    let is_beside =
        |normal: &Vector3<f32>| beside.is_none_or(|other| normal.dot(other).abs() < 0.2);
    let normals: Vec<Vector3<f32>> =
        elements.iter().map(|element| element.1).filter(is_beside).collect();
    let count = |direction: &Vector3<f32>| {
        normals.iter().filter(|n| n.dot(direction).abs() > FACE_SEARCH_COSINE).count()
    };
    let candidates = normals
        .iter()
        .step_by((normals.len() / MAX_TRIED_NORMALS).max(1))
        .map(|direction| (count(direction), direction));
    // The first of equal ones, so that the result does not depend on the iterator.
    let (most, direction) =
        candidates.reduce(|best, next| if next.0 > best.0 { next } else { best })?;
    // Few equal normals are chance, as on a ball.
    if most < MIN_FACE_ELEMENTS {
        return None;
    }
    let mut direction = *direction;
    for _ in 0..3 {
        let facing = normals.iter().filter(|n| n.dot(&direction).abs() > FACE_SEARCH_COSINE);
        direction = facing
            .map(|n| n * n.dot(&direction).signum())
            .sum::<Vector3<f32>>()
            .try_normalize(1e-6)?;
    }
    Some(Unit::new_unchecked(direction))
}

/// Offset along a direction of the flat face whose normal it is.
fn face_offset(elements: &[Element], direction: &Vector3<f32>, limit: f32) -> Option<f32> {
    let facing = elements.iter().filter(|(_, normal)| normal.dot(direction) > FACE_COSINE);
    let mut heights: Vec<f32> = facing.map(|(point, _)| direction.dot(&point.coords)).collect();
    if heights.len() < MIN_FACE_ELEMENTS {
        return None;
    }
    // The median ignores parallel faces at other offsets.
    let median = median(&mut heights);
    let near = heights.iter().filter(|height| (**height - median).abs() < limit);
    let (sum, count) = near.fold((0.0, 0), |(sum, count), height| (sum + height, count + 1));
    Some(sum / count.max(1) as f32)
}

fn median(numbers: &mut [f32]) -> f32 {
    let middle = numbers.len() / 2;
    if numbers.is_empty() { 0.0 } else { *numbers.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

/// The largest number after trimming.
fn outermost(mut numbers: Vec<f32>) -> Option<f32> {
    numbers.sort_unstable_by(|a, b| b.total_cmp(a));
    let at = if numbers.len() > 4 * TRIMMED_ELEMENTS { TRIMMED_ELEMENTS } else { 0 };
    numbers.get(at).copied()
}

fn box_of(elements: &[Element], face: Option<Unit<Vector3<f32>>>, limit: f32) -> Option<Form> {
    let first = face?.into_inner();
    let second = largest_face(elements, Some(&first))?;
    let second = (second.as_ref() - first * first.dot(&second)).try_normalize(1e-6)?;
    let axes = [first, second, first.cross(&second)];
    let ends =
        axes.map(|axis| [axis, -axis].map(|direction| face_offset(elements, &direction, limit)));
    // An end without a visible face is where the neighbouring faces end.
    let is_on_face = |axis: usize, (point, normal): &Element| {
        let [high, low] = ends[axis];
        [(axes[axis], high), (-axes[axis], low)].iter().any(|(direction, at)| {
            let off = at.map(|at| (direction.dot(&point.coords) - at).abs() < limit);
            off.unwrap_or(false) && normal.dot(direction) > 0.8
        })
    };
    let mut half_m = Vector3::zeros();
    let mut centre = Vector3::zeros();
    for (number, axis) in axes.iter().enumerate() {
        let [high, low] =
            [(*axis, ends[number][0]), (-axis, ends[number][1])].map(|(direction, at)| {
                at.or_else(|| {
                    let beside = elements.iter().filter(|element| {
                        (0..3).any(|other| other != number && is_on_face(other, element))
                    });
                    outermost(beside.map(|(point, _)| direction.dot(&point.coords)).collect())
                })
            });
        let (high, low) = (high?, -low?);
        half_m[number] = 0.5 * (high - low);
        centre += axis * (0.5 * (high + low));
    }
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&axes));
    (half_m.min() > 0.0).then_some(Form::Box { centre: centre.into(), axes, half_m })
}

/// Huber's weight of a residual, by the median of all.
fn huber_weight(residuals: &[f32]) -> impl Fn(f32) -> f32 + use<> {
    let limit = (HUBER_MEDIANS * median(&mut residuals.to_vec())).max(1e-9);
    move |residual| if residual < limit { 1.0 } else { limit / residual }
}

fn ball_of(elements: &[Element]) -> Option<Form> {
    // Centre = point - radius x normal is linear in the unknowns, and gives the start of the iteration.
    let (mut matrix, mut right) = (Matrix4::zeros(), Vector4::zeros());
    for (point, normal) in elements {
        for axis in 0..3 {
            let mut row = Vector4::zeros();
            row[axis] = 1.0;
            row[3] = normal[axis];
            matrix += row * row.transpose();
            right += row * point[axis];
        }
    }
    let start: Vector4<f32> = matrix.cholesky()?.solve(&right);
    let (mut centre, mut radius_m) = (Point3::from(start.xyz()), start.w);
    for _ in 0..REWEIGHTING_ROUNDS {
        let off = |point: &Point3<f32>| (point - centre).norm() - radius_m;
        let residuals: Vec<f32> = elements.iter().map(|(point, _)| off(point).abs()).collect();
        let weight = huber_weight(&residuals);
        // A little regularisation keeps the matrix invertible for elements on one side.
        let (mut matrix, mut right) = (Matrix4::identity() * 1e-6, Vector4::zeros());
        for (point, _) in elements {
            let Some(direction) = (point - centre).try_normalize(1e-9) else { continue };
            let (row, off) = (direction.push(1.0), off(point));
            let weight = weight(off.abs()).powi(2);
            matrix += row * row.transpose() * weight;
            right += row * (off * weight);
        }
        let change = matrix.cholesky()?.solve(&right);
        centre += change.xyz();
        radius_m += change.w;
    }
    (radius_m > 0.0 && radius_m.is_finite()).then_some(Form::Ball { centre, radius_m })
}

fn cylinder_of(elements: &[Element], face: Option<Unit<Vector3<f32>>>, limit: f32) -> Option<Form> {
    // The axis is the normal of an end, or the direction orthogonal to the normals of the side.
    let spread = |without: Option<&Vector3<f32>>| {
        let normals = elements.iter().map(|(_, normal)| normal);
        let of_side = normals.filter(|n| without.is_none_or(|end| n.dot(end).abs() < 0.9));
        let eigen = of_side.map(|n| n * n.transpose()).sum::<Matrix3<f32>>().symmetric_eigen();
        let (least, most) = (eigen.eigenvalues.imin(), eigen.eigenvalues.imax());
        [least, most].map(|at| Unit::new_normalize(eigen.eigenvectors.column(at).into_owned()))
    };
    // The side's normals span a plane: the axis has their least moment, or their largest on a flat disc.
    let [least, most] = spread(None);
    let beside = face.map(|face| spread(Some(&face))[0]);
    let candidates = [face, Some(least), Some(most), beside].into_iter().flatten();
    let fitted = candidates.filter_map(|axis| {
        let form = cylinder_along(elements, &axis, limit)?;
        let distances = elements.iter().map(|(point, _)| form.distance_m(point).abs());
        Some((distances.map(|distance| distance.min(2.5 * limit)).sum::<f32>(), form))
    });
    fitted.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, form)| form)
}

fn cylinder_along(elements: &[Element], axis: &Unit<Vector3<f32>>, limit: f32) -> Option<Form> {
    let (a, b) = orthogonal_axes(axis);
    let flat = |vector: &Vector3<f32>| Vector2::new(a.dot(vector), b.dot(vector));
    let side: Vec<(Vector2<f32>, Vector2<f32>)> = elements
        .iter()
        .filter(|(_, normal)| normal.dot(axis).abs() < 0.35)
        .filter_map(|(point, normal)| {
            Some((flat(&point.coords), flat(normal).try_normalize(1e-6)?))
        })
        .collect();
    // Too few elements of the side determine no circle.
    if side.len() < 2 * MIN_FACE_ELEMENTS {
        return None;
    }
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (point, normal) in &side {
        for at in 0..2 {
            let mut row = Vector3::zeros();
            row[at] = 1.0;
            row[2] = normal[at];
            matrix += row * row.transpose();
            right += row * point[at];
        }
    }
    let start: Vector3<f32> = matrix.cholesky()?.solve(&right);
    let (mut centre, mut radius_m) = (start.xy(), start.z);
    for _ in 0..REWEIGHTING_ROUNDS {
        let off = |point: &Vector2<f32>| (point - centre).norm() - radius_m;
        let residuals: Vec<f32> = side.iter().map(|(point, _)| off(point).abs()).collect();
        let weight = huber_weight(&residuals);
        let (mut matrix, mut right) = (Matrix3::identity() * 1e-6, Vector3::zeros());
        for (point, _) in &side {
            let Some(direction) = (point - centre).try_normalize(1e-9) else { continue };
            let (row, off) = (direction.push(1.0), off(point));
            let weight = weight(off.abs()).powi(2);
            matrix += row * row.transpose() * weight;
            right += row * (off * weight);
        }
        let change = matrix.cholesky()?.solve(&right);
        centre += change.xy();
        radius_m += change.z;
    }
    let end = |direction: Vector3<f32>| {
        face_offset(elements, &direction, limit).or_else(|| {
            let of_side = elements.iter().filter(|(_, normal)| normal.dot(&direction).abs() < 0.35);
            outermost(of_side.map(|(point, _)| direction.dot(&point.coords)).collect())
        })
    };
    let (high, low) = (end(axis.into_inner())?, -end(-axis.into_inner())?);
    let half_m = 0.5 * (high - low);
    let is_sound = radius_m > 0.0 && half_m > 0.0 && (radius_m + half_m).is_finite();
    let centre = Point3::from(a * centre.x + b * centre.y + axis.as_ref() * (0.5 * (high + low)));
    is_sound.then_some(Form::Cylinder { centre, axis: *axis, radius_m, half_m })
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use rigidformer_runtime::noise::Noise;

    /// Elements of a grid on a form about `centre`, with noise, that a viewer sees.
    fn seen(form: &Form, viewer: &Point3<f32>, spacing_m: f32, deviation_m: f32) -> Vec<Element> {
        let mut noise = Noise::new(7, 1);
        let mut all = Vec::new();
        let steps = 60;
        for at in 0..steps * steps * steps {
            let at = [at % steps, at / steps % steps, at / steps / steps];
            let point = Point3::from(at.map(|step| (step as f32 - 0.5 * steps as f32) * spacing_m));
            let away = form.distance_m(&point);
            let slope = |axis: usize| {
                let mut step = Vector3::zeros();
                step[axis] = 0.05 * spacing_m;
                (form.distance_m(&(point + step)) - form.distance_m(&(point - step)))
                    / (0.1 * spacing_m)
            };
            let normal = Vector3::new(slope(0), slope(1), slope(2)).normalize();
            let towards = viewer - point;
            if away.abs() < 0.5 * spacing_m && normal.dot(&towards) > 0.2 * towards.norm() {
                let off = -away + noise.normal() * deviation_m;
                all.push((point + normal * off, normal));
            }
        }
        all
    }

    #[test]
    fn a_box_a_cylinder_and_a_ball_are_told_from_their_fronts() {
        let turn = UnitQuaternion::from_euler_angles(0.3, -0.4, 0.5).to_rotation_matrix();
        let centre = Point3::new(0.01, -0.02, 0.015);
        let viewer = turn * Point3::new(3.0, 2.0, 2.5);
        let axis = turn * Vector3::z_axis();
        let half_m = Vector3::new(0.05, 0.08, 0.1);
        let forms = [
            Form::Box { centre, axes: turn, half_m },
            Form::Cylinder { centre, axis, radius_m: 0.06, half_m: 0.08 },
            Form::Ball { centre, radius_m: 0.07 },
        ];
        for form in forms {
            let elements = seen(&form, &viewer, 0.005, 0.0005);
            let found =
                Form::fit(&elements).unwrap_or_else(|| panic!("{form:?} from {}", elements.len()));
            let kind = |form: &Form| std::mem::discriminant(form);
            assert_eq!(kind(&found), kind(&form), "{found:?} for {form:?}");
            // The hulls of both end at the same places, on the sides that nobody saw too.
            for direction in (0..50).map(|at| at as f32).map(|at| {
                Vector3::new((at * 1.3).sin(), (at * 2.1).cos(), (at * 0.7).sin()).normalize()
            }) {
                let end = |form: &Form| {
                    let points = form.points();
                    points.iter().map(|p| direction.dot(&p.coords)).fold(f32::MIN, f32::max)
                };
                assert!((end(&found) - end(&form)).abs() < 0.006, "{found:?} for {form:?}");
            }
        }
    }

    #[test]
    fn what_is_none_of_them_is_not_taken_for_one() {
        // Two balls that touch, one face alone, and nothing.
        let ball = |x: f32| Form::Ball { centre: Point3::new(x, 0.0, 0.0), radius_m: 0.05 };
        let viewer = Point3::new(0.0, 2.0, 2.0);
        let both = [ball(-0.05), ball(0.05)].map(|ball| seen(&ball, &viewer, 0.005, 0.0)).concat();
        assert_eq!(Form::fit(&both), None);
        let flat: Vec<Element> = (0..100)
            .map(|at| [at % 10, at / 10].map(|step| step as f32 * 0.01))
            .map(|[x, y]| (Point3::new(x, y, 0.0), Vector3::z()))
            .collect();
        assert_eq!(Form::fit(&flat), None);
        assert_eq!(Form::fit(&[]), None);
    }
}
