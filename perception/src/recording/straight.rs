//! Lenses: images without distortion from those with it.

use super::error::CaptureProblem;
use crate::camera::Camera;

/// A camera, and what its lens does to its images.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lens {
    pub(super) camera: Camera,
    /// None where images have no distortion.
    pub(super) model: Option<Model>,
}

/// Where a lens puts what a pinhole camera sees.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Model {
    /// Radial polynomials over each other and tangential terms: `plumb_bob` (k1, k2, p1, p2, k3) and `rational_polynomial` (k4 to k6 more).
    Rational([f64; 8]),
    /// A polynomial of the angle: `equidistant`.
    Angle([f64; 4]),
}

impl Model {
    /// None where all coefficients are 0.
    pub(super) fn of(name: &str, d: &[f64]) -> Result<Option<Model>, CaptureProblem> {
        let refused = || CaptureProblem::Distorted(format!("{name:?} {d:?}"));
        if d.iter().any(|coefficient| !coefficient.is_finite()) {
            return Err(refused());
        }
        if d.iter().all(|coefficient| *coefficient == 0.0) {
            return Ok(None);
        }
        let at = |index: usize| d.get(index).copied().unwrap_or(0.0);
        match name {
            "plumb_bob" | "rational_polynomial"
                if d.iter().skip(8).all(|v| *v == 0.0) && d.len() >= 4 =>
            {
                Ok(Some(Model::Rational(std::array::from_fn(at))))
            }
            "equidistant" | "fisheye" | "kannala_brandt4" if d.len() == 4 => {
                Ok(Some(Model::Angle(std::array::from_fn(at))))
            }
            _ => Err(refused()),
        }
    }

    /// From a place in front of the pinhole to where the lens puts it, both at a depth of 1.
    fn bent(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        match self {
            Model::Rational([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
                    / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
                [
                    x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                    y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
                ]
            }
            Model::Angle([k1, k2, k3, k4]) => {
                let r = r2.sqrt();
                if r < 1e-9 {
                    return [x, y];
                }
                let angle = r.atan();
                let a2 = angle * angle;
                let bent = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                [x * bent / r, y * bent / r]
            }
        }
    }
}

impl Lens {
    /// An image as the pinhole camera would see it: each pixel has the depth of the nearest one that the lens shows there. Depths are
    /// distances from the camera's plane, so they stay. (height * width)
    pub(super) fn straightened(&self, depths: Vec<u16>) -> Vec<u16> {
        let Some(model) = &self.model else { return depths };
        let [width, height] = self.camera.size();
        let ([fx, fy], [cx, cy]) =
            (self.camera.focal().map(f64::from), self.camera.centre().map(f64::from));
        let mut straight = Vec::with_capacity(depths.len());
        for row in 0..height {
            for column in 0..width {
                let ideal = [(f64::from(column) - cx) / fx, (f64::from(row) - cy) / fy];
                let [x, y] = model.bent(ideal);
                let (u, v) = ((x * fx + cx).round(), (y * fy + cy).round());
                // What is not a number is not within the image either.
                let is_inside =
                    (0.0..f64::from(width)).contains(&u) && (0.0..f64::from(height)).contains(&v);
                let seen = is_inside.then(|| depths.get(v as usize * width as usize + u as usize));
                straight.push(seen.flatten().copied().unwrap_or(0));
            }
        }
        straight
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;

    #[test]
    fn lenses_without_coefficients_are_none_and_unknown_ones_are_refused() {
        assert_eq!(Model::of("plumb_bob", &[0.0; 5]).unwrap(), None);
        assert_eq!(Model::of("anything", &[]).unwrap(), None);
        for (name, d) in [
            ("plumb_bob", vec![0.1]),
            ("thin_prism", vec![0.1; 12]),
            ("rational_polynomial", vec![0.1; 14]),
            ("equidistant", vec![0.1; 5]),
            ("plumb_bob", vec![f64::NAN; 5]),
        ] {
            let text = Model::of(name, &d).unwrap_err().to_string();
            assert!(text.contains(name), "{text}");
        }
    }

    /// A wall with an edge: where the pinhole sees it is where it is after straightening.
    #[test]
    fn a_bent_edge_becomes_straight() {
        let camera =
            Camera::new([160, 120], [120.0; 2], [79.5, 59.5], Isometry3::identity()).unwrap();
        for (name, d) in [
            ("plumb_bob", vec![-0.25, 0.06, 0.001, -0.002, 0.0]),
            ("rational_polynomial", vec![0.2, 0.1, 0.001, 0.0, 0.01, 0.5, 0.1, 0.02]),
            ("equidistant", vec![-0.05, 0.01, 0.0, 0.0]),
        ] {
            let model = Model::of(name, &d).unwrap().unwrap();
            // The lens shows at each pixel what a pinhole shows elsewhere: found by iteration.
            let mut bent = Vec::new();
            for row in 0..120 {
                for column in 0..160 {
                    let wanted =
                        [(f64::from(column) - 79.5) / 120.0, (f64::from(row) - 59.5) / 120.0];
                    let mut place = wanted;
                    for _ in 0..60 {
                        let [x, y] = model.bent(place);
                        place = [place[0] + wanted[0] - x, place[1] + wanted[1] - y];
                    }
                    bent.push(if place[0] < 0.3 { 1000 } else { 2000 });
                }
            }
            let lens = Lens { camera, model: Some(model) };
            let straight = lens.straightened(bent);
            // 0.3 lies at column 115.5.
            for row in 5..115 {
                for (column, wanted) in [(112, 1000), (119, 2000)] {
                    let seen = straight[row * 160 + column];
                    assert!(seen == wanted || seen == 0, "{name} {row} {column}: {seen}");
                }
            }
        }
    }
}
