//! Support planes: the floor, a wall, the top of a table.
//!
//! RANSAC with a seed and a fixed number of trials finds a plane; least squares over its points make it exact. A plane that was found is
//! kept, and its points of later captures refine it: sums of them fade, so that a plane follows a camera whose pose drifts. A plane of the
//! scene has nothing behind it. A level face that has is a ledge.

use nalgebra::{Matrix3, Point3, Vector3};
use rigidformer_core::Plane;
use rigidformer_runtime::noise::Noise;

/// Planes, at most.
pub const MOST_PLANES: usize = 4;
/// Triples of points that are tried for a plane.
const TRIALS: u64 = 160;
/// A plane has this share of all points at least.
const LEAST_SHARE: f32 = 0.08;
/// What is kept of older sums at each capture.
const KEPT: f64 = 0.9;
/// Deviations of a point that still belongs to a plane.
const DEVIATIONS: f32 = 3.0;
/// Behind a floor or a wall there is nothing: at most this share of the points that are not the plane's own.
const BEHIND: f32 = 0.03;
/// A ledge has this share of all points at least.
const LEDGE_SHARE: f32 = 0.02;
/// Ledges, at most.
pub const MOST_LEDGES: usize = 8;
/// A ledge is there as long as this part of its points is still seen.
const STILL_THERE: f32 = 0.6;
/// How level it is: the cosine of its normal against the vertical.
const LEVEL: f32 = 0.985;

/// A point that may be of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// In the world, metres.
    pub point: Point3<f32>,
    /// Towards the sensor: not of any length.
    pub towards: Vector3<f32>,
    /// Standard deviation along the ray, metres.
    pub deviation_m: f32,
}

impl Spot {
    /// How far a point may be from a plane that it is of, metres.
    fn reach_m(&self, normal: &Vector3<f32>) -> f32 {
        let slant = normal.dot(&self.towards).abs() / self.towards.norm().max(1e-9);
        DEVIATIONS * self.deviation_m * slant + 0.002
    }
}

/// A level face that ends somewhere, such as the top of a table or of a box: something is seen below it. It is a body's face and no
/// plane of the scene. What stands on it is told from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ledge {
    /// The face's plane, the normal up.
    pub plane: Plane,
    /// Two directions in the plane, of length 1.
    pub axes: [Vector3<f32>; 2],
    /// Where it lies along them, metres.
    pub ranges: [[f32; 2]; 2],
    /// Points that it had when it was found.
    points: usize,
}

impl Ledge {
    fn new(plane: Plane, own: &[Point3<f32>]) -> Self {
        let beside = if plane.normal.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let first = plane.normal.cross(&beside).normalize();
        let axes = [first, plane.normal.cross(&first)];
        let ranges = axes.map(|axis| {
            let along = own.iter().map(|point| axis.dot(&point.coords));
            along.fold([f32::MAX, f32::MIN], |[low, high], at| [low.min(at), high.max(at)])
        });
        Ledge { plane, axes, ranges, points: own.len() }
    }

    /// Whether a place is over it.
    pub fn is_under(&self, point: &Vector3<f32>) -> bool {
        self.axes
            .iter()
            .zip(&self.ranges)
            .all(|(axis, [low, high])| (*low..=*high).contains(&axis.dot(point)))
    }

    fn is_near(&self, spot: &Spot) -> bool {
        self.is_under(&spot.point.coords)
            && self.plane.height_m(&spot.point.coords).abs() < spot.reach_m(&self.plane.normal)
    }
}

/// A plane that was found, and the points that it was found from.
#[derive(Clone, Debug, PartialEq)]
struct Found {
    plane: Plane,
    sums: Sums,
}

/// Weighted sums over points, about an origin that stays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sums {
    weight: f64,
    first: Vector3<f64>,
    second: Matrix3<f64>,
}

impl Sums {
    fn add(&mut self, point: &Point3<f32>, deviation_m: f32) {
        let weight = 1.0 / f64::from(deviation_m.max(1e-5)).powi(2);
        let p: Vector3<f64> = point.coords.cast();
        self.weight += weight;
        self.first += p * weight;
        self.second += p * p.transpose() * weight;
    }

    fn fade(&mut self) {
        self.weight *= KEPT;
        self.first *= KEPT;
        self.second *= KEPT;
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
        let middle = eigen.eigenvalues.iter().sum::<f64>()
            - eigen.eigenvalues.max()
            - eigen.eigenvalues[least];
        // Points of a line have no plane.
        (middle > 4.0 * eigen.eigenvalues[least].max(0.0) && normal.iter().all(|n| n.is_finite()))
            .then(|| (normal.cast(), normal.dot(&mean) as f32))
    }
}

/// The planes of a scene.
///
/// ```
/// use nalgebra::{Point3, Vector3};
/// use rigidformer_perception::planes::{Planes, Spot};
///
/// // A floor half a metre below the origin, seen from above.
/// let spot = |i: u32| Spot {
///     point: Point3::new((i % 20) as f32 * 0.1, (i / 20) as f32 * 0.1, -0.5),
///     towards: Vector3::z(),
///     deviation_m: 0.001,
/// };
/// let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 1);
/// planes.look(&(0..400).map(spot).collect::<Vec<_>>());
/// let floor = planes.all().first().ok_or("no plane")?;
/// assert!((floor.normal.z - 1.0).abs() < 1e-4 && (floor.offset_m + 0.5).abs() < 1e-4);
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Debug)]
pub struct Planes {
    found: Vec<Found>,
    all: Vec<Plane>,
    ledges: Vec<Ledge>,
    given: bool,
    /// Of planes that are found: friction and restitution.
    physics: [f32; 2],
    up: Vector3<f32>,
    seed: u64,
    looks: u64,
}

impl Planes {
    /// Planes that are yet to be found. They will have this friction and restitution; the seed is that of RANSAC's draws.
    pub fn new(physics: [f32; 2], gravity_m_s2: Vector3<f32>, seed: u64) -> Self {
        let up = (-gravity_m_s2).try_normalize(1e-6).unwrap_or_else(Vector3::z);
        let (found, all, ledges) = (Vec::new(), Vec::new(), Vec::new());
        Planes { found, all, ledges, given: false, physics, up, seed, looks: 0 }
    }

    /// Planes that are known: only ledges are looked for.
    pub fn given(planes: Vec<Plane>, gravity_m_s2: Vector3<f32>, seed: u64) -> Self {
        let known = Planes::new([0.0; 2], gravity_m_s2, seed);
        Planes { all: planes, given: true, ..known }
    }

    /// All planes; the free side of those that were found is the sensor's.
    pub fn all(&self) -> &[Plane] {
        &self.all
    }

    /// Level faces of bodies that others may stand on.
    pub fn ledges(&self) -> &[Ledge] {
        &self.ledges
    }

    /// What a unit may stand on: the planes, and the ledge under it if its lowest point is above that.
    pub(super) fn under(
        &self,
        middle: &Vector3<f32>,
        lowest_above: impl Fn(&Plane) -> f32,
    ) -> Vec<Plane> {
        let mut all = self.all.clone();
        let above = |ledge: &&Ledge| ledge.is_under(middle) && lowest_above(&ledge.plane) > -0.004;
        all.extend(self.ledges.iter().filter(above).map(|ledge| ledge.plane));
        all
    }

    /// Refines the planes by points of a capture, and looks for more among the rest.
    pub fn look(&mut self, spots: &[Spot]) {
        if spots.len() < 20 {
            return;
        }
        self.looks += 1;
        let mut rest: Vec<&Spot> = spots.iter().collect();
        for found in &mut self.found {
            found.sums.fade();
            let mut seen = 0;
            rest.retain(|spot| {
                let plane = &found.plane;
                let near = plane.height_m(&spot.point.coords).abs() < spot.reach_m(&plane.normal);
                if near {
                    found.sums.add(&spot.point, spot.deviation_m);
                    seen += 1;
                }
                !near
            });
            if seen >= 20 {
                found.refine();
            }
        }
        if self.given {
            let is_off = |spot: &&Spot| {
                let off = |plane: &Plane| {
                    plane.height_m(&spot.point.coords) > spot.reach_m(&plane.normal)
                };
                self.all.iter().all(off)
            };
            rest.retain(is_off);
        }
        self.ledges.retain(|ledge| {
            let seen = rest.iter().filter(|spot| ledge.is_near(spot)).count();
            seen as f32 >= STILL_THERE * ledge.points as f32
        });
        for ledge in &self.ledges {
            rest.retain(|spot| !ledge.is_near(spot));
        }
        // The first captures find what there is. Later ones look now and then: a camera may have moved.
        if self.looks <= 3 || self.looks.is_multiple_of(16) {
            for _ in 0..MOST_PLANES + MOST_LEDGES {
                let Some((found, is_bound)) = self.search(spots, &rest) else { break };
                let share = LEAST_SHARE * spots.len() as f32;
                let own: Vec<Point3<f32>> =
                    rest.iter().filter(|spot| found.near(spot)).map(|spot| spot.point).collect();
                rest.retain(|spot| !found.near(spot));
                let is_level = found.plane.normal.dot(&self.up) > LEVEL;
                if is_bound && own.len() as f32 >= share {
                    if !self.given && self.found.len() < MOST_PLANES {
                        self.found.push(found);
                    }
                } else if is_level && self.ledges.len() < MOST_LEDGES {
                    self.ledges.push(Ledge::new(found.plane, &own));
                }
            }
        }
        if self.given {
            return;
        }
        self.all = self.found.iter().map(|found| found.plane).collect();
    }

    /// The plane of most points among those that are of no plane yet, and whether nothing is seen behind it.
    fn search(&self, spots: &[Spot], rest: &[&Spot]) -> Option<(Found, bool)> {
        let needed = (LEDGE_SHARE * spots.len() as f32).max(20.0) as usize;
        if rest.len() < needed {
            return None;
        }
        let mut noise = Noise::new(self.seed, (self.looks << 20) ^ rest.len() as u64);
        let mut draw = || ((noise.uniform() * rest.len() as f32) as usize).min(rest.len() - 1);
        // Counted on a part: 1,000 of them say which is best.
        let part = rest.len().div_ceil(1000);
        let mut best: Option<(usize, Vector3<f32>, f32)> = None;
        for _ in 0..TRIALS {
            let [a, b, c] = [draw(), draw(), draw()].map(|at| rest[at].point);
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-9) else { continue };
            let offset = normal.dot(&a.coords);
            let near = |spot: &&&Spot| {
                (normal.dot(&spot.point.coords) - offset).abs() < spot.reach_m(&normal)
            };
            let count = rest.iter().step_by(part).filter(near).count();
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, normal, offset));
            }
        }
        let (_, normal, offset) = best?;
        let [friction, restitution] = self.physics;
        let mut found = Found {
            plane: Plane { normal, offset_m: offset, friction, restitution },
            sums: Sums::default(),
        };
        let mut own = 0;
        for _ in 0..3 {
            found.sums = Sums::default();
            own = 0;
            for spot in rest {
                if found.near(spot) {
                    found.sums.add(&spot.point, spot.deviation_m);
                    own += 1;
                }
            }
            found.face(spots);
            found.refine();
        }
        if own < needed {
            return None;
        }
        let others = spots.iter().filter(|spot| !found.near(spot));
        let is_behind = |spot: &&Spot| {
            found.plane.height_m(&spot.point.coords) < -spot.reach_m(&found.plane.normal)
        };
        let behind = others.filter(is_behind).count() as f32;
        let is_bound = behind <= BEHIND * spots.len() as f32;
        Some((found, is_bound))
    }
}

impl Found {
    fn near(&self, spot: &Spot) -> bool {
        self.plane.height_m(&spot.point.coords).abs() < spot.reach_m(&self.plane.normal)
    }

    fn refine(&mut self) {
        let Some((normal, offset_m)) = self.sums.plane() else { return };
        let side = if normal.dot(&self.plane.normal) < 0.0 { -1.0 } else { 1.0 };
        self.plane = Plane { normal: normal * side, offset_m: offset_m * side, ..self.plane };
    }

    /// Turns the free side to the sensor.
    fn face(&mut self, spots: &[Spot]) {
        let near = spots.iter().filter(|spot| self.near(spot));
        let towards: Vector3<f32> = near.map(|spot| spot.towards.normalize()).sum();
        if towards.dot(&self.plane.normal) < 0.0 {
            self.plane.normal = -self.plane.normal;
            self.plane.offset_m = -self.plane.offset_m;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot(x: f32, y: f32, z: f32, eye: Point3<f32>) -> Spot {
        let point = Point3::new(x, y, z);
        Spot { point, towards: eye - point, deviation_m: 0.001 }
    }

    fn room(noise: &mut Noise) -> Vec<Spot> {
        let eye = Point3::new(1.0, 1.0, 1.5);
        let mut spots = Vec::new();
        for i in 0..1500 {
            let (a, b) = (noise.uniform() * 2.0, noise.uniform() * 2.0);
            let off = noise.normal() * 0.001;
            spots.push(match i % 3 {
                0 | 1 => spot(a, b, off, eye),
                _ => spot(off, a, b, eye),
            });
        }
        // A box on the floor.
        for _ in 0..200 {
            let (a, b) = (noise.uniform() * 0.2, noise.uniform() * 0.2);
            spots.push(spot(1.0 + a, 1.0 + b, 0.2 + noise.normal() * 0.001, eye));
        }
        spots
    }

    #[test]
    fn floor_and_wall_are_found_and_face_the_sensor() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let mut noise = Noise::new(1, 1);
        for _ in 0..5 {
            planes.look(&room(&mut noise));
        }
        assert_eq!(planes.all().len(), 2, "{:?}", planes.all());
        assert!((planes.all()[0].normal - Vector3::z()).norm() < 1e-3);
        assert!((planes.all()[1].normal - Vector3::x()).norm() < 1e-3);
        assert!(planes.all().iter().all(|plane| plane.offset_m.abs() < 3e-4));
        let mut again = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let mut noise = Noise::new(1, 1);
        for _ in 0..5 {
            again.look(&room(&mut noise));
        }
        assert_eq!(again.all(), planes.all());
    }

    #[test]
    fn lines_clouds_and_nothing_have_no_plane() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        let eye = Point3::new(0.0, 0.0, 5.0);
        planes.look(&[]);
        planes.look(&(0..100).map(|i| spot(i as f32 * 0.01, 0.0, 0.0, eye)).collect::<Vec<_>>());
        let mut noise = Noise::new(1, 1);
        let mut number = || noise.uniform();
        planes.look(&(0..900).map(|_| spot(number(), number(), number(), eye)).collect::<Vec<_>>());
        assert!(planes.all().is_empty(), "{:?}", planes.all());
        let known = vec![Plane::ground(0.1, 0.2)];
        let mut planes = Planes::given(known.clone(), Vector3::new(0.0, 0.0, -9.81), 1);
        planes.look(&room(&mut Noise::new(1, 1)));
        assert_eq!(planes.all(), known);
    }

    #[test]
    fn the_top_of_a_box_is_a_ledge_and_no_plane() {
        let mut planes = Planes::new([0.4, 0.5], Vector3::new(0.0, 0.0, -9.81), 3);
        planes.look(&room(&mut Noise::new(1, 1)));
        assert_eq!((planes.all().len(), planes.ledges().len()), (2, 1));
        let ledge = planes.ledges()[0];
        assert!((ledge.plane.offset_m - 0.2).abs() < 1e-3);
        let sides = ledge.ranges.map(|[low, high]| high - low);
        assert!(sides.iter().all(|side| (0.15..0.25).contains(side)), "{sides:?}");
    }
}
