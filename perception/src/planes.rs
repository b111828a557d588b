//! Support planes: the floor, a wall, the top of a table.
//!
//! RANSAC with a seed and a fixed number of trials finds a plane, and least squares over the inliers refine it. Inliers of later captures
//! refine it further. Older sums are forgotten exponentially, so that a plane follows a camera whose pose drifts. A plane of the scene has
//! nothing behind it. A level face with points below it is a [`Tabletop`].

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_core::Plane;
use rigidformer_core::geometry::dot;
use rigidformer_core::kernels::in_own_environment;
use rigidformer_runtime::noise::Noise;

/// Planes that are found in a scene, at most.
pub const MAX_FOUND_PLANES: usize = 4;
/// Triples of points that RANSAC tries for a plane.
// Three points of a plane with a third of all points are drawn in 160 trials with probability .997.
const RANSAC_TRIALS: u64 = 160;
/// Least share of all points that a plane of the scene has.
const MIN_PLANE_SHARE: f32 = 0.08;
/// Factor of older sums at each capture.
// Ten captures count, so that a plane follows a camera whose pose drifts.
const FORGETTING_FACTOR: f64 = 0.9;
/// Standard deviations within which a point is an inlier of a plane.
const INLIER_DEVIATIONS: f32 = 3.0;
/// Largest share of outliers behind a floor or a wall.
// Sensors see nothing behind a floor or a wall. The share leaves room for noise and mirrors.
const MAX_SHARE_BEHIND: f32 = 0.03;
/// Least share of all points that a tabletop has.
const MIN_TABLETOP_SHARE: f32 = 0.02;
/// Tabletops, at most.
// The sampler has one bit for each tabletop in a u8 per pixel.
pub const MAX_TABLETOPS: usize = 8;
/// Share of a tabletop's first points below which it is dropped.
// A tabletop is part of a body, and the body may move away.
const MIN_SHARE_VISIBLE: f32 = 0.6;
/// Least cosine between a tabletop's normal and the vertical.
// Bodies stand on level faces alone: 10 degrees leave room for noise of the normal.
const LEVEL_COSINE: f32 = 0.985;

/// Inliers that tell the errors of a sensor, at least.
const MIN_SMOOTH: usize = 60;
/// Deviations of the noise from which smooth errors are told from it.
const MIN_SMOOTH_SHARE: f32 = 2.0;
/// Standard deviation over the median of absolute values, of a normal distribution.
const DEVIATION_OF_MEDIAN: f32 = 1.4826;
/// Distance of a capture from the planes of those before that counts as none, metres.
// Noise of pixels, and steps of a sensor, shift a plane by less.
const MIN_SHIFT_M: f32 = 1e-3;
/// Weight of a capture in the errors of the sensor.
// They belong to the sensor and do not change; planes that come into view show more of them.
const SMOOTHING: f32 = 0.1;

/// As [`Plane::height_m`], within the environment that the caller has entered for all points.
pub(crate) fn height_m(plane: &Plane, point: &Vector3<f32>) -> f32 {
    dot(&plane.normal, point) - plane.offset_m
}

/// A measured point, an inlier of a plane or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// In the world, metres.
    pub point: Point3<f32>,
    /// Direction of the sensor, of any length.
    pub towards: Vector3<f32>,
    /// Standard deviation along the ray, metres.
    pub deviation_m: f32,
}

impl Measurement {
    /// Distance from a plane within which the point is an inlier, metres.
    fn inlier_distance_m(&self, normal: &Vector3<f32>, smooth: SmoothError) -> f32 {
        let range_m = self.towards.norm();
        // Noise lies along the ray: only its share along the normal moves a point off the plane.
        let slant = normal.dot(&self.towards).abs() / range_m.max(1e-9);
        let smooth_m = smooth.deviation_m(range_m);
        let deviation_m = (self.deviation_m * self.deviation_m + smooth_m * smooth_m).sqrt();
        INLIER_DEVIATIONS * deviation_m * slant + 0.002
    }
}

/// Errors of a sensor that neighbouring pixels share: of its lens, of its calibration, of its steps. Filters over pixels do not show
/// them, and means over pixels keep them. They are measured off planes, and grow with the square of the range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothError {
    /// Standard deviation over the square of the range, 1/m.
    per_m2: f32,
    /// Standard deviation over the range, at most.
    share: f32,
}

impl SmoothError {
    /// A sensor with none.
    pub const NONE: SmoothError = SmoothError { per_m2: 0.0, share: 0.0 };
    /// Of a sensor about which nothing is known: a Kinect's, and a third of a percent of the range at most.
    // Beyond three metres a Kinect's errors would let small bodies sink in the floor.
    const UNKNOWN: SmoothError = SmoothError { per_m2: 0.0016, share: 0.0033 };

    /// Standard deviation at a range, metres.
    pub fn deviation_m(self, range_m: f32) -> f32 {
        (self.per_m2 * range_m * range_m).min(self.share * range_m)
    }

    /// Standard deviation over the square of the range, 1/m.
    pub fn per_m2(self) -> f32 {
        self.per_m2
    }
}

/// A bounded level face of a body, such as the top of a table or of a box. It is no plane of the scene, because there are points below it.
/// The sampler separates bodies that stand on it from the body that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tabletop {
    /// The plane of the face, with the normal up.
    pub plane: Plane,
    /// Two directions in the plane, of length 1.
    pub axes: [Vector3<f32>; 2],
    /// Its extent along them, metres.
    pub ranges: [[f32; 2]; 2],
    /// Inliers when it was found.
    points: usize,
}

impl Tabletop {
    fn new(plane: Plane, inliers: &[Point3<f32>]) -> Self {
        // Any axis that is far from parallel with the normal gives a stable cross product.
        let beside = if plane.normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let first = plane.normal.cross(&beside).normalize();
        let axes = [first, plane.normal.cross(&first)];
        let ranges = axes.map(|axis| {
            let along = inliers.iter().map(|point| axis.dot(&point.coords));
            along.fold([f32::MAX, f32::MIN], |[low, high], at| [low.min(at), high.max(at)])
        });
        Tabletop { plane, axes, ranges, points: inliers.len() }
    }

    /// Whether a point lies over or under its extent.
    pub fn is_under(&self, point: &Vector3<f32>) -> bool {
        self.axes
            .iter()
            .zip(&self.ranges)
            .all(|(axis, [low, high])| (*low..=*high).contains(&axis.dot(point)))
    }

    fn is_near(&self, measurement: &Measurement, smooth: SmoothError) -> bool {
        self.is_under(&measurement.point.coords)
            && height_m(&self.plane, &measurement.point.coords).abs()
                < measurement.inlier_distance_m(&self.plane.normal, smooth)
    }
}

/// A plane and the sums over its inliers.
#[derive(Clone, Debug, PartialEq)]
struct FittedPlane {
    plane: Plane,
    sums: Sums,
}

/// Weighted sums over points, about a constant origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    weight: f64,
    first: Vector3<f64>,
    second: Matrix3<f64>,
}

impl Sums {
    fn add(&mut self, point: &Point3<f32>, deviation_m: f32) {
        // The bound keeps one noiseless point from outweighing all others.
        let weight = 1.0 / f64::from(deviation_m.max(1e-5)).powi(2);
        let p: Vector3<f64> = point.coords.cast();
        self.weight += weight;
        self.first += p * weight;
        self.second += p * p.transpose() * weight;
    }

    fn fade(&mut self) {
        self.weight *= FORGETTING_FACTOR;
        self.first *= FORGETTING_FACTOR;
        self.second *= FORGETTING_FACTOR;
    }

    /// Normal and offset of the plane through the points.
    fn plane(&self) -> Option<(Vector3<f32>, f32)> {
        if self.weight <= 0.0 {
            return None;
        }
        let mean = self.first / self.weight;
        let spread = self.second / self.weight - mean * mean.transpose();
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let normal: Vector3<f64> = eigen.eigenvectors.column(least).into_owned();
        let normal = normal.try_normalize(1e-9)?;
        // The middle eigenvalue is what the other two leave of the trace.
        let middle = eigen.eigenvalues.iter().sum::<f64>()
            - eigen.eigenvalues.max()
            - eigen.eigenvalues[least];
        // Collinear points determine no plane: their second eigenvalue is as small as the first.
        (middle > 4.0 * eigen.eigenvalues[least].max(0.0) && normal.iter().all(|n| n.is_finite()))
            .then(|| (normal.cast(), normal.dot(&mean) as f32))
    }
}

/// The planes of a scene.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use rigidformer_perception::planes::{Measurement, Planes};
///
/// // A floor half a metre below the origin, seen from above.
/// let measurement = |i: u32| Measurement {
///     point: Point3::new((i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1, -0.5),
///     towards: Vector3::z(),
///     deviation_m: 0.001,
/// };
/// let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 1);
/// planes.update(&(0..400).map(measurement).collect::<Vec<_>>());
/// let floor = planes.all().first().ok_or("no plane")?;
/// assert!((floor.normal.z - 1.0).abs() < 1e-4 && (floor.offset_m + 0.5).abs() < 1e-4);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug)]
pub struct Planes {
    found: Vec<FittedPlane>,
    all: Vec<Plane>,
    tabletops: Vec<Tabletop>,
    given: bool,
    /// Of planes that are found: friction and restitution.
    physics: [f32; 2],
    up: Vector3<f32>,
    seed: u64,
    updates: u64,
    /// Of the sensor; none until a plane has shown it.
    smooth: Option<SmoothError>,
    shift_m: f32,
}

impl Planes {
    /// An empty set, whose planes will have this friction and restitution. The seed is that of RANSAC's draws.
    pub fn new(physics: [f32; 2], gravity_m_s2: Vector3<f32>, seed: u64) -> Self {
        let up = in_own_environment(|| (-gravity_m_s2).try_normalize(1e-6));
        let up = up.unwrap_or_else(Vector3::z);
        let (found, all, tabletops) = (Vec::new(), Vec::new(), Vec::new());
        Planes {
            found,
            all,
            tabletops,
            given: false,
            physics,
            up,
            seed,
            updates: 0,
            smooth: None,
            shift_m: 0.0,
        }
    }

    /// Known planes: only tabletops are searched.
    pub fn given(planes: Vec<Plane>, gravity_m_s2: Vector3<f32>, seed: u64) -> Self {
        let known = Planes::new([0.0; 2], gravity_m_s2, seed);
        Planes { all: planes, given: true, ..known }
    }

    /// All planes; the free side of those that were found is the sensor's.
    pub fn all(&self) -> &[Plane] {
        &self.all
    }

    /// Level faces of bodies that other bodies may stand on.
    pub fn tabletops(&self) -> &[Tabletop] {
        &self.tabletops
    }

    /// The vertical, of length 1.
    pub(super) fn up(&self) -> Vector3<f32> {
        self.up
    }

    /// Errors of the sensor that neighbouring pixels share, as far as its planes show them.
    pub fn smooth_error(&self) -> SmoothError {
        self.smooth.unwrap_or(SmoothError::NONE)
    }

    /// How far the last capture is from the planes of those before, metres: the error of a sensor's pose.
    pub(super) fn shift_m(&self) -> f32 {
        self.shift_m
    }

    /// Planes that a unit may stand on: all planes of the scene, and tabletops below the unit's lowest point.
    pub(super) fn under(
        &self,
        middle: &Vector3<f32>,
        lowest_above: impl Fn(&Plane) -> f32,
    ) -> Vec<Plane> {
        let mut all = self.all.clone();
        // Four millimetres of tolerance: noise puts the lowest point of a standing unit below the tabletop.
        let above = |tabletop: &&Tabletop| {
            tabletop.is_under(middle) && lowest_above(&tabletop.plane) > -0.004
        };
        all.extend(self.tabletops.iter().filter(above).map(|tabletop| tabletop.plane));
        all
    }

    /// Refines the planes by the points of a capture, and searches the outliers for more planes.
    pub fn update(&mut self, measurements: &[Measurement]) {
        in_own_environment(|| self.update_here(measurements));
    }

    fn update_here(&mut self, measurements: &[Measurement]) {
        // Too few points determine no plane.
        if measurements.len() < 20 {
            return;
        }
        self.updates += 1;
        self.measure_smooth_error(measurements);
        let smooth = self.smooth.unwrap_or(SmoothError::UNKNOWN);
        let mut rest: Vec<&Measurement> = measurements.iter().collect();
        let shifts = self.found.iter().filter_map(|found| found.shift_m(measurements, smooth));
        self.shift_m = shifts.map(|shift| shift * shift).sum::<f32>().sqrt();
        for found in &mut self.found {
            found.sums.fade();
            let mut inliers = 0;
            rest.retain(|measurement| {
                let plane = &found.plane;
                let near = height_m(plane, &measurement.point.coords).abs()
                    < measurement.inlier_distance_m(&plane.normal, smooth);
                if near {
                    found.sums.add(&measurement.point, measurement.deviation_m);
                    inliers += 1;
                }
                !near
            });
            // A plane that a capture hardly shows keeps its estimate.
            if inliers >= 20 {
                found.refine();
            }
        }
        if self.given {
            let is_off = |measurement: &&Measurement| {
                let off = |plane: &Plane| {
                    height_m(plane, &measurement.point.coords)
                        > measurement.inlier_distance_m(&plane.normal, smooth)
                };
                self.all.iter().all(off)
            };
            rest.retain(is_off);
        }
        self.tabletops.retain(|tabletop| {
            let visible =
                rest.iter().filter(|measurement| tabletop.is_near(measurement, smooth)).count();
            visible as f32 >= MIN_SHARE_VISIBLE * tabletop.points as f32
        });
        // Points of known tabletops would be found again as new ones.
        for tabletop in &self.tabletops {
            rest.retain(|measurement| !tabletop.is_near(measurement, smooth));
        }
        // The search is the dearest part. The first captures find most planes, and a moving camera may show others later.
        if self.updates <= 3 || self.updates.is_multiple_of(16) {
            for _ in 0..MAX_FOUND_PLANES + MAX_TABLETOPS {
                let Some((found, is_boundary, smooth)) = self.search(measurements, &rest) else {
                    break;
                };
                let share = MIN_PLANE_SHARE * measurements.len() as f32;
                let inliers: Vec<Point3<f32>> = rest
                    .iter()
                    .filter(|measurement| found.is_inlier(measurement, smooth))
                    .map(|measurement| measurement.point)
                    .collect();
                rest.retain(|measurement| !found.is_inlier(measurement, smooth));
                let is_level = found.plane.normal.dot(&self.up) > LEVEL_COSINE;
                // A boundary plane needs more points: small faces of bodies may have nothing behind them.
                if is_boundary && inliers.len() as f32 >= share {
                    if self.smooth.is_none() {
                        self.smooth = Some(smooth);
                    }
                    if !self.given && self.found.len() < MAX_FOUND_PLANES {
                        self.found.push(found);
                    }
                } else if is_level && self.tabletops.len() < MAX_TABLETOPS {
                    self.tabletops.push(Tabletop::new(found.plane, &inliers));
                }
            }
        }
        if self.given {
            return;
        }
        self.all = self.found.iter().map(|found| found.plane).collect();
    }

    /// Errors of the sensor, by the planes that are known.
    fn measure_smooth_error(&mut self, measurements: &[Measurement]) {
        // Errors of one plane may be its own: a cloth, a bent board.
        let seen = self.all.iter().filter_map(|plane| {
            let fitted = FittedPlane { plane: *plane, sums: Sums::default() };
            fitted.smooth_error(measurements.iter(), SmoothError::UNKNOWN)
        });
        let Some(seen) = seen.min_by(|a, b| a.per_m2.total_cmp(&b.per_m2)) else { return };
        let per_m2 = match self.smooth {
            Some(known) => known.per_m2 + SMOOTHING * (seen.per_m2 - known.per_m2),
            None => seen.per_m2,
        };
        self.smooth = Some(SmoothError { per_m2, ..seen });
    }

    /// The plane with most inliers among the outliers of all other planes, and whether it bounds the scene.
    fn search(
        &self,
        measurements: &[Measurement],
        rest: &[&Measurement],
    ) -> Option<(FittedPlane, bool, SmoothError)> {
        let needed = (MIN_TABLETOP_SHARE * measurements.len() as f32).max(20.0) as usize;
        let allowed = self.smooth.unwrap_or(SmoothError::UNKNOWN);
        let mut smooth = allowed;
        if rest.len() < needed {
            return None;
        }
        // The stream depends on the capture and on the points left, so that searches draw different triples.
        let mut noise = Noise::new(self.seed, (self.updates << 20) ^ rest.len() as u64);
        let mut draw = || ((noise.uniform() * rest.len() as f32) as usize).min(rest.len() - 1);
        // A subset of 1,000 points suffices to rank the trials.
        let stride = rest.len().div_ceil(1000);
        let mut best: Option<(usize, Vector3<f32>, f32)> = None;
        for _ in 0..RANSAC_TRIALS {
            let [a, b, c] = [draw(), draw(), draw()].map(|at| rest[at].point);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-9) else { continue };
            let offset = normal.dot(&a.coords);
            let near = |measurement: &&&Measurement| {
                (normal.dot(&measurement.point.coords) - offset).abs()
                    < measurement.inlier_distance_m(&normal, smooth)
            };
            let count = rest.iter().step_by(stride).filter(near).count();
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, normal, offset));
            }
        }
        let (_, normal, offset) = best?;
        let [friction, restitution] = self.physics;
        let mut found = FittedPlane {
            plane: Plane { normal, offset_m: offset, friction, restitution },
            sums: Sums::default(),
        };
        let mut inliers = 0;
        // The refined plane has other inliers than the sampled one, so inliers and plane are found in turn.
        for _ in 0..3 {
            found.sums = Sums::default();
            inliers = 0;
            for measurement in rest {
                if found.is_inlier(measurement, smooth) {
                    found.sums.add(&measurement.point, measurement.deviation_m);
                    inliers += 1;
                }
            }
            found.orient(measurements, smooth);
            found.refine();
            // Of an unknown sensor the first plane tells the errors, and then which points are its own.
            if self.smooth.is_none()
                && let Some(seen) = found.smooth_error(rest.iter().copied(), smooth)
            {
                smooth = seen;
            }
        }
        // Fewer inliers are chance.
        if inliers < needed {
            return None;
        }
        let others =
            measurements.iter().filter(|measurement| !found.is_inlier(measurement, smooth));
        // Errors of a lens grow towards the corners: there a plane itself is behind what its median error allows.
        let is_behind = |measurement: &&Measurement| {
            height_m(&found.plane, &measurement.point.coords)
                < -measurement.inlier_distance_m(&found.plane.normal, allowed)
        };
        let behind = others.filter(is_behind).count() as f32;
        let is_boundary = behind <= MAX_SHARE_BEHIND * measurements.len() as f32;
        Some((found, is_boundary, smooth))
    }
}

impl FittedPlane {
    fn is_inlier(&self, measurement: &Measurement, smooth: SmoothError) -> bool {
        height_m(&self.plane, &measurement.point.coords).abs()
            < measurement.inlier_distance_m(&self.plane.normal, smooth)
    }

    /// What the inliers are off the plane, beyond their noise; none of too few.
    fn smooth_error<'m>(
        &self,
        measurements: impl Iterator<Item = &'m Measurement>,
        within: SmoothError,
    ) -> Option<SmoothError> {
        let mut off = Vec::new();
        let mut noise = Vec::new();
        for measurement in measurements.filter(|measurement| self.is_inlier(measurement, within)) {
            let range_m = measurement.towards.norm().max(1e-6);
            let slant = (self.plane.normal.dot(&measurement.towards) / range_m).abs().max(0.1);
            let height_m = height_m(&self.plane, &measurement.point.coords);
            let square = range_m * range_m;
            off.push(height_m.abs() / slant / square);
            noise.push(measurement.deviation_m / square);
        }
        if off.len() < MIN_SMOOTH {
            return None;
        }
        let median = |numbers: &mut Vec<f32>| {
            let middle = numbers.len() / 2;
            *numbers.select_nth_unstable_by(middle, f32::total_cmp).1
        };
        let (all, noise) = (median(&mut off) * DEVIATION_OF_MEDIAN, median(&mut noise));
        // Of two errors of about one size the noise is the likelier.
        let noise = MIN_SMOOTH_SHARE * noise;
        let per_m2 = (all * all - noise * noise).max(0.0).sqrt();
        let most = SmoothError::UNKNOWN;
        Some(SmoothError { per_m2: per_m2.min(2.0 * most.per_m2), share: 2.0 * most.share })
    }

    /// How far the points of a capture are off, in the middle; none of too few.
    fn shift_m(&self, measurements: &[Measurement], smooth: SmoothError) -> Option<f32> {
        // Twice the distance of inliers: those of a plane that has shifted too.
        let near = measurements.iter().filter_map(|measurement| {
            let height_m = self.plane.height_m(&measurement.point.coords);
            let limit_m = 2.0 * measurement.inlier_distance_m(&self.plane.normal, smooth);
            (height_m.abs() < limit_m).then_some(height_m)
        });
        let mut heights: Vec<f32> = near.collect();
        if heights.len() < MIN_SMOOTH {
            return None;
        }
        let middle = heights.len() / 2;
        let shift_m = heights.select_nth_unstable_by(middle, f32::total_cmp).1.abs();
        Some((shift_m - MIN_SHIFT_M).max(0.0))
    }

    fn refine(&mut self) {
        let Some((normal, offset_m)) = self.sums.plane() else { return };
        // An eigenvector has no sign: the free side stays where it was.
        let side = if normal.dot(&self.plane.normal) < 0.0 { -1.0 } else { 1.0 };
        self.plane = Plane { normal: normal * side, offset_m: offset_m * side, ..self.plane };
    }

    /// Turns the normal towards the sensor: only the free side of a plane is visible.
    fn orient(&mut self, measurements: &[Measurement], smooth: SmoothError) {
        let near = measurements.iter().filter(|measurement| self.is_inlier(measurement, smooth));
        let towards: Vector3<f32> = near.map(|measurement| measurement.towards.normalize()).sum();
        if towards.dot(&self.plane.normal) < 0.0 {
            self.plane.normal = -self.plane.normal;
            self.plane.offset_m = -self.plane.offset_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measurement(x: f32, y: f32, z: f32, eye: Point3<f32>) -> Measurement {
        let point = Point3::new(x, y, z);
        Measurement { point, towards: eye - point, deviation_m: 0.001 }
    }

    fn room(noise: &mut Noise) -> Vec<Measurement> {
        let eye = Point3::new(1.0, 1.0, 1.5);
        let mut measurements = Vec::new();
        for i in 0..1500 {
            let (a, b) = (noise.uniform() * 2.0, noise.uniform() * 2.0);
            let off = noise.normal() * 0.001;
            measurements.push(match i % 3 {
                0 | 1 => measurement(a, b, off, eye),
                _ => measurement(off, a, b, eye),
            });
        }
        // A box on the floor.
        for _ in 0..200 {
            let (a, b) = (noise.uniform() * 0.2, noise.uniform() * 0.2);
            measurements.push(measurement(1.0 + a, 1.0 + b, 0.2 + noise.normal() * 0.001, eye));
        }
        measurements
    }

    #[test]
    fn floor_and_wall_are_found_and_face_the_sensor() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let mut noise = Noise::new(1, 1);
        for _ in 0..5 {
            planes.update(&room(&mut noise));
        }
        assert_eq!(planes.all().len(), 2, "{:?}", planes.all());
        assert!((planes.all()[0].normal - Vector3::z()).norm() < 1e-3);
        assert!((planes.all()[1].normal - Vector3::x()).norm() < 1e-3);
        assert!(planes.all().iter().all(|plane| plane.offset_m.abs() < 3e-4));
        let mut again = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let mut noise = Noise::new(1, 1);
        for _ in 0..5 {
            again.update(&room(&mut noise));
        }
        assert_eq!(again.all(), planes.all());
    }

    /// A floor that a camera sees at a slant, with depths too large by this share in the corners of its image, and no noise.
    fn bowl(share: f32) -> Vec<Measurement> {
        let eye = Point3::new(0.0, 0.0, 1.2);
        let (forward, down) = (Vector3::new(0.0, 0.82, -0.57), Vector3::new(0.0, -0.57, -0.82));
        let rays = (0..60).flat_map(|row| (0..80).map(move |column| (row, column)));
        let rays =
            rays.map(|(row, column)| [(column as f32 - 39.5) / 70.0, (row as f32 - 29.5) / 70.0]);
        let corner = 39.5f32.hypot(29.5) / 70.0;
        let points = rays.filter_map(|[x, y]| {
            let ray = forward + Vector3::x() * x + down * y;
            let depth = -1.2 / ray.z * (1.0 + share * (x * x + y * y) / (corner * corner));
            let point = eye + ray * depth;
            (ray.z < -0.1 && depth < 9.0).then_some(Measurement {
                point,
                towards: eye - point,
                deviation_m: 0.0003,
            })
        });
        points.collect()
    }

    #[test]
    fn a_lens_that_is_off_in_the_corners_leaves_the_floor_a_plane() {
        for share in [0.0, 0.0025, 0.005, 0.01] {
            let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
            for _ in 0..5 {
                planes.update(&bowl(share));
            }
            assert_eq!(planes.all().len(), 1, "{share}");
            assert!(planes.all()[0].normal.z > 0.999, "{share}");
        }
    }

    #[test]
    fn lines_clouds_and_nothing_have_no_plane() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let eye = Point3::new(0.0, 0.0, 5.0);
        planes.update(&[]);
        planes.update(
            &(0..100).map(|i| measurement(i as f32 * 0.01, 0.0, 0.0, eye)).collect::<Vec<_>>(),
        );
        let mut noise = Noise::new(1, 1);
        let mut number = || noise.uniform();
        planes.update(
            &(0..900).map(|_| measurement(number(), number(), number(), eye)).collect::<Vec<_>>(),
        );
        assert!(planes.all().is_empty(), "{:?}", planes.all());
        let known = vec![Plane::ground(0.1, 0.2)];
        let mut planes = Planes::given(known.clone(), Vector3::new(0.0, 0.0, -9.81), 1);
        planes.update(&room(&mut Noise::new(1, 1)));
        assert_eq!(planes.all(), known);
    }

    #[test]
    fn the_top_of_a_box_is_a_tabletop_and_no_plane() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        planes.update(&room(&mut Noise::new(1, 1)));
        assert_eq!((planes.all().len(), planes.tabletops().len()), (2, 1));
        let tabletop = planes.tabletops()[0];
        assert!((tabletop.plane.offset_m - 0.2).abs() < 1e-3);
        let sides = tabletop.ranges.map(|[low, high]| high - low);
        assert!(sides.iter().all(|side| (0.15..0.25).contains(side)), "{sides:?}");
    }
}
