//! What captures are like, in numbers, and what is odd about them.

use nalgebra::Point3;

use super::{Capture, Cloud, DepthView, View};

/// Points whose nearest neighbour is looked for, at most.
const ASKED: usize = 64;
/// Pixels and points are counted by distance in so many steps a power of two, from 2^LOWEST m on.
const STEPS: f32 = 8.0;
const LOWEST: f32 = -10.0;
const BINS: usize = 240;
/// Every so many rows and columns of an image give a point to the extent.
const STRIDE: usize = 8;

/// Extent above which a scene of a coarse spacing is doubted, metres; and one of any spacing.
const WIDE_M: f32 = 100.0;
const COARSE_M: f32 = 0.25;
const WIDEST_M: f32 = 2000.0;
/// Extent below which a scene is doubted, metres.
const NARROW_M: f32 = 0.02;
/// Median depths of images that are doubted lie outside of these, metres.
const DEEP_M: f32 = 50.0;
const SHALLOW_M: f32 = 0.03;
/// Share of unmeasured pixels, and of points at the origin, that is doubted.
const EMPTY: f64 = 0.9;
const AT_ORIGIN: f64 = 0.01;
/// Seconds between captures that are doubted, and how many times the mean a gap has.
const SLOW_S: f64 = 0.5;
const GAP: f64 = 5.0;

/// What captures are like: their times, extents and depths.
///
/// ```
/// use nalgebra::Point3;
/// use rigidformer_perception::capture::{Capture, Cloud, Facts, View};
///
/// let mut facts = Facts::default();
/// for number in 0..3 {
///     let points = (0..9).map(|k| Point3::new(400.0 * k as f32, 0.0, 1.0)).collect();
///     let views = vec![View::Cloud(Cloud { points, ..Cloud::default() })];
///     facts.add(&Capture { time_s: 0.1 * f64::from(number), views });
/// }
/// assert!((facts.interval_s().unwrap_or(0.0) - 0.1).abs() < 1e-9);
/// assert_eq!(facts.extent_m(), Some(3200.0));
/// let doubts: Vec<String> = facts.doubts().iter().map(ToString::to_string).collect();
/// assert_eq!(doubts, ["extent 3,200 m: millimetres? use --scale .001"]);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// How many captures were added.
    pub captures: usize,
    /// Time of the first and of the last one, seconds.
    pub span_s: Option<[f64; 2]>,
    /// Longest time between two captures, and when it began, seconds.
    pub longest_gap_s: Option<[f64; 2]>,
    /// Least and greatest x, y and z of all points in the world, metres; of images, every eighth row and column.
    pub bounds_m: Option<[Point3<f32>; 2]>,
    /// Median distance of a point from its nearest neighbour in the first capture with points, metres.
    pub spacing_m: Option<f32>,
    /// Pixels of depth images, and those of them that were not measured.
    pub pixels: u64,
    /// Unmeasured ones of `pixels`.
    pub pixels_unmeasured: u64,
    /// Points of clouds.
    pub points: u64,
    /// Those of `points` that are at (0, 0, 0) exactly, which many scanners write for beams without a return.
    pub points_at_origin: u64,
    depths: Histogram,
    ranges: Histogram,
}

/// Something odd about captures. Its text asks, and says what may help.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Doubt {
    /// A scene so wide that its unit may be another.
    #[error("extent {} m: millimetres? use --scale .001", thousands(*extent_m))]
    Wide {
        /// Diagonal of the box around all points, metres.
        extent_m: f32,
    },
    /// A scene so small that its unit may be another.
    #[error("extent {:.2} mm: is the unit larger than a metre? use --scale", extent_m * 1e3)]
    Narrow {
        /// Diagonal of the box around all points, metres.
        extent_m: f32,
    },
    /// Depths that no camera of bodies measures.
    #[error("half of the depths are beyond {} m: use --scale, or correct depth_scale_m", thousands(*median_m))]
    Deep {
        /// Median depth, metres.
        median_m: f32,
    },
    /// Depths nearer than cameras see.
    #[error("half of the depths are below {:.2} mm: use --scale, or correct depth_scale_m", median_m * 1e3)]
    Shallow {
        /// Median depth, metres.
        median_m: f32,
    },
    /// Images that show little.
    #[error("{:.0} % of the pixels were not measured", share * 100.0)]
    Unmeasured {
        /// Share of all pixels.
        share: f64,
    },
    /// Points where the sensor is.
    #[error("{:.0} % of the points are at 0,0,0: beams without a return? leave them out", share * 100.0)]
    AtOrigin {
        /// Share of all points.
        share: f64,
    },
    /// Captures so far apart that bodies move far between them.
    #[error("{interval_s:.2} s between captures: units that move may be lost between two of them")]
    Slow {
        /// Mean time between captures, seconds.
        interval_s: f64,
    },
    /// A time without captures.
    #[error("no capture for {length_s:.2} s from {from_s:.2} s on")]
    Gap {
        /// When it began, seconds.
        from_s: f64,
        /// Its length, seconds.
        length_s: f64,
    },
    /// No more than one capture.
    #[error("one capture: nothing tells motion")]
    Alone,
    /// Captures without any point.
    #[error("no capture has a point")]
    Blind,
}

/// Distances by their logarithm.
#[derive(Clone, Debug, PartialEq)]
struct Histogram {
    counts: [u64; BINS],
    all: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Histogram { counts: [0; BINS], all: 0 }
    }
}

impl Histogram {
    fn add(&mut self, distance_m: f32) {
        let bin = ((distance_m.log2() - LOWEST) * STEPS).clamp(0.0, (BINS - 1) as f32) as usize;
        if let Some(count) = self.counts.get_mut(bin) {
            *count += 1;
            self.all += 1;
        }
    }

    /// The distance below which so much of all lies, within a step of 9 %.
    fn quantile(&self, share: f64) -> Option<f32> {
        let wanted = (self.all as f64 * share) as u64;
        let mut before = 0;
        for (bin, count) in self.counts.iter().enumerate() {
            before += count;
            if before > wanted.min(self.all.saturating_sub(1)) {
                return Some(((bin as f32 + 0.5) / STEPS + LOWEST).exp2());
            }
        }
        None
    }
}

impl Facts {
    /// Counts one more capture, which is later than those before.
    pub fn add(&mut self, capture: &Capture) {
        self.captures += 1;
        let now_s = capture.time_s;
        let first_s = match self.span_s {
            None => now_s,
            Some([first_s, before_s]) => {
                let gap_s = now_s - before_s;
                if self.longest_gap_s.is_none_or(|[longest_s, _]| gap_s > longest_s) {
                    self.longest_gap_s = Some([gap_s, before_s]);
                }
                first_s
            }
        };
        self.span_s = Some([first_s, now_s]);
        let mut spacings = Vec::new();
        let is_first = self.spacing_m.is_none();
        for view in &capture.views {
            match view {
                View::Depth(view) => self.add_image(view, &mut spacings),
                View::Cloud(cloud) => {
                    self.add_cloud(cloud);
                    if is_first {
                        spacings.extend(nearest(&cloud.points));
                    }
                }
            }
        }
        if is_first {
            spacings.sort_by(f32::total_cmp);
            self.spacing_m = spacings.get(spacings.len() / 2).copied();
        }
    }

    fn add_image(&mut self, view: &DepthView, spacings: &mut Vec<f32>) {
        self.pixels += view.depth.len() as u64;
        for steps in &view.depth {
            match steps {
                0 => self.pixels_unmeasured += 1,
                steps => self.depths.add(f32::from(*steps) * view.scale_m),
            }
        }
        let ([width, height], focal) = (view.camera.size(), view.camera.focal()[0]);
        for row in (0..height).step_by(STRIDE) {
            for column in (0..width).step_by(STRIDE) {
                let Some(depth_m) = view.depth_m(column, row) else { continue };
                self.reach(view.camera.point([column as f32, row as f32], depth_m));
                if self.spacing_m.is_none() {
                    spacings.push(depth_m / focal);
                }
            }
        }
    }

    fn add_cloud(&mut self, cloud: &Cloud) {
        self.points += cloud.points.len() as u64;
        for point in &cloud.points {
            if *point == Point3::origin() {
                self.points_at_origin += 1;
            }
            if let Some(sensor) = cloud.sensor {
                self.ranges.add((point - sensor).norm());
            }
            self.reach(*point);
        }
    }

    fn reach(&mut self, point: Point3<f32>) {
        let [least, most] = self.bounds_m.unwrap_or([point, point]);
        self.bounds_m = Some([least.inf(&point), most.sup(&point)]);
    }

    /// Diagonal of the box around all points, metres.
    pub fn extent_m(&self) -> Option<f32> {
        self.bounds_m.map(|[least, most]| (most - least).norm())
    }

    /// Mean time between captures, seconds.
    pub fn interval_s(&self) -> Option<f64> {
        let [first_s, last_s] = self.span_s?;
        (self.captures > 1).then(|| (last_s - first_s) / (self.captures - 1) as f64)
    }

    /// Depths below which 1 %, 50 % and 99 % of the measured pixels lie, metres, within 5 %.
    pub fn depths_m(&self) -> Option<[f32; 3]> {
        let of = |share| self.depths.quantile(share);
        Some([of(0.01)?, of(0.5)?, of(0.99)?])
    }

    /// Distances from the sensor below which 1 %, 50 % and 99 % of the points lie, metres, within 5 %, where clouds say where it was.
    pub fn ranges_m(&self) -> Option<[f32; 3]> {
        let of = |share| self.ranges.quantile(share);
        Some([of(0.01)?, of(0.5)?, of(0.99)?])
    }

    /// Share of the pixels that were not measured.
    pub fn unmeasured_share(&self) -> Option<f64> {
        (self.pixels > 0).then(|| self.pixels_unmeasured as f64 / self.pixels as f64)
    }

    /// Share of the points that are at (0, 0, 0) exactly.
    pub fn at_origin_share(&self) -> Option<f64> {
        (self.points > 0).then(|| self.points_at_origin as f64 / self.points as f64)
    }

    /// What is odd about the captures so far.
    pub fn doubts(&self) -> Vec<Doubt> {
        let mut doubts = Vec::new();
        match self.extent_m() {
            None if self.captures > 0 => doubts.push(Doubt::Blind),
            Some(extent_m) if extent_m > WIDEST_M => doubts.push(Doubt::Wide { extent_m }),
            Some(extent_m) if extent_m > WIDE_M && self.spacing_m.is_some_and(|m| m > COARSE_M) => {
                doubts.push(Doubt::Wide { extent_m });
            }
            // A single point has no extent, and no unit either.
            Some(extent_m) if extent_m > 0.0 && extent_m < NARROW_M => {
                doubts.push(Doubt::Narrow { extent_m });
            }
            _ => {}
        }
        if let Some([_, median_m, _]) = self.depths_m() {
            if median_m > DEEP_M {
                doubts.push(Doubt::Deep { median_m });
            } else if median_m < SHALLOW_M {
                doubts.push(Doubt::Shallow { median_m });
            }
        }
        if let Some(share) = self.unmeasured_share().filter(|share| *share > EMPTY) {
            doubts.push(Doubt::Unmeasured { share });
        }
        if let Some(share) = self.at_origin_share().filter(|share| *share > AT_ORIGIN) {
            doubts.push(Doubt::AtOrigin { share });
        }
        doubts.extend(self.doubts_of_time());
        doubts
    }

    fn doubts_of_time(&self) -> Option<Doubt> {
        if self.captures == 1 {
            return Some(Doubt::Alone);
        }
        let interval_s = self.interval_s()?;
        if interval_s > SLOW_S {
            return Some(Doubt::Slow { interval_s });
        }
        let [length_s, from_s] = self.longest_gap_s?;
        (self.captures > 3 && length_s > GAP * interval_s)
            .then_some(Doubt::Gap { from_s, length_s })
    }
}

/// Distances of some points from their nearest neighbours; others at the same place are none.
fn nearest(points: &[Point3<f32>]) -> Vec<f32> {
    let stride = points.len().div_ceil(ASKED).max(1);
    let asked = points.iter().step_by(stride);
    let distance = |asked: &Point3<f32>| {
        let squares = points.iter().map(|point| (point - asked).norm_squared());
        squares.filter(|square| *square > 0.0).fold(f32::INFINITY, f32::min).sqrt()
    };
    asked.map(distance).filter(|distance| distance.is_finite()).collect()
}

/// A whole number with commas.
fn thousands(number: f32) -> String {
    let digits = format!("{number:.0}");
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;
    use crate::camera::Camera;

    fn clouds(times: &[f64], points: &[Point3<f32>]) -> Facts {
        let mut facts = Facts::default();
        for time_s in times {
            let views = vec![View::Cloud(Cloud { points: points.to_vec(), ..Cloud::default() })];
            facts.add(&Capture { time_s: *time_s, views });
        }
        facts
    }

    /// A table of 1 m with a point every 10 mm.
    fn table(unit: f32) -> Vec<Point3<f32>> {
        let grid = (0..100).flat_map(|x| (0..100).map(move |y| (x as f32, y as f32)));
        grid.map(|(x, y)| Point3::new(0.01 * x * unit, 0.01 * y * unit, 0.4 * unit)).collect()
    }

    fn texts(facts: &Facts) -> Vec<String> {
        facts.doubts().iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_scene_in_metres_raises_no_doubt_and_one_in_millimetres_does() {
        let times = [0.0, 0.1, 0.2, 0.3];
        let metres = clouds(&times, &table(1.0));
        assert_eq!(texts(&metres), [""; 0]);
        assert!((metres.spacing_m.unwrap() - 0.01).abs() < 1e-4);
        let millimetres = clouds(&times, &table(1000.0));
        assert_eq!(texts(&millimetres), ["extent 1,400 m: millimetres? use --scale .001"]);
        assert_eq!(texts(&clouds(&times, &table(0.001))).len(), 1);
        // A scanner outdoors has points far away, and near ones as well.
        let mut outdoors = table(1.0);
        outdoors.extend([Point3::new(180.0, 90.0, 3.0), Point3::new(-150.0, 20.0, 9.0)]);
        assert_eq!(texts(&clouds(&times, &outdoors)), [""; 0]);
    }

    #[test]
    fn beams_without_a_return_and_gaps_are_told() {
        let mut points = table(1.0);
        points.extend([Point3::origin(); 2000]);
        let facts = clouds(&[0.0, 0.1, 0.2, 0.3, 0.4, 3.0, 3.1, 3.2, 3.3, 3.4], &points);
        let [origin, gap] = &texts(&facts)[..] else { panic!("{:?}", facts.doubts()) };
        assert!(origin.starts_with("17 % of the points are at 0,0,0"), "{origin}");
        assert_eq!(gap, "no capture for 2.60 s from 0.40 s on");
        assert!(texts(&clouds(&[0.0, 1.0], &table(1.0)))[0].starts_with("1.00 s between captures"));
        assert_eq!(texts(&clouds(&[0.0], &table(1.0))), ["one capture: nothing tells motion"]);
        assert_eq!(texts(&clouds(&[0.0, 0.1], &[])), ["no capture has a point"]);
    }

    #[test]
    fn images_tell_their_depths() {
        let camera = Camera::new([40, 30], [30.0; 2], [20.0, 15.0], Isometry3::identity()).unwrap();
        let of = |scale_m: f32, depth: Vec<u16>| {
            let mut facts = Facts::default();
            let view = DepthView::new(camera, scale_m, depth, None).unwrap();
            let views = vec![View::Depth(view)];
            facts.add(&Capture { time_s: 0.0, views: views.clone() });
            facts.add(&Capture { time_s: 0.1, views });
            facts
        };
        let facts = of(0.001, vec![800; 1200]);
        let [_, median_m, _] = facts.depths_m().unwrap();
        assert!((median_m / 0.8 - 1.0).abs() < 0.06, "{median_m}");
        assert_eq!((texts(&facts), facts.unmeasured_share()), (vec![], Some(0.0)));
        assert!((facts.spacing_m.unwrap() - 0.8 / 30.0).abs() < 1e-5);
        assert!(texts(&of(1.0, vec![800; 1200])).iter().any(|text| text.contains("depth_scale_m")));
        assert!(texts(&of(1e-5, vec![800; 1200])).iter().any(|text| text.contains("below")));
        let mut sparse = vec![0; 1200];
        sparse[..60].fill(900);
        assert_eq!(texts(&of(0.001, sparse)), ["95 % of the pixels were not measured"]);
    }
}
