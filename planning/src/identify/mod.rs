//! Identifies the physics of units from their motion: friction, restitution, and mass ratios of units that collide.
//!
//! Motion is cut into windows of a few tenths of a second. Copies of the scene with different parameters predict each window from its
//! start ([`futures`](rigidformer_runtime::futures)), and parameters are weighed by their fit. The likelihood includes the uncertainty of the
//! start and the known error of the model. Where the posterior is about as wide as the prior, the result is [`Interval::NotSeen`]: only
//! sliding identifies friction, and only a bounce identifies restitution. docs/IDENTIFY.md has the method, what can be identified, and how
//! often the intervals hold the truth.
//!
//! A [`Filter`] takes poses as they come. [`recording`] takes whole scenes.
//!
//! ```
//! use nalgebra::{Isometry3, Point3, Vector3};
//! use rigidformer_runtime::core::{Physics, Plane};
//! use rigidformer_planning::identify::{Filter, Interval, Scene, Settings};
//! use rigidformer_runtime::models::LoadedModel;
//! use rigidformer_evaluation::scenes::RecordedUnit;
//!
//! let loaded = LoadedModel::embedded("edge", rigidformer_weights::EDGE)?;
//! let corner = |i: usize, bit| if i & bit == 0 { -0.05 } else { 0.05 };
//! let points = (0..8).map(|i| Point3::new(corner(i, 1), corner(i, 2), corner(i, 4))).collect();
//! let guess = Physics { mass_kg: 1.0, friction: 0.5, restitution: 0.5 };
//! let cube = RecordedUnit::new("cube", points, guess, Vec::new());
//! let scene = Scene { units: vec![cube], planes: vec![Plane::ground(1.0, 1.0)], gravity_m_s2: Vector3::new(0.0, 0.0, -9.81) };
//! let mut filter = Filter::new(&loaded, scene, Settings { particles: 16, ..Settings::default() })?;
//! // Observed at 60 Hz: it slides to a stop under friction .3.
//! for frame in 0..40 {
//!     let t = (f64::from(frame) / 60.0).min(1.0 / (0.3 * 9.81));
//!     let x = t - 0.5 * 0.3 * 9.81 * t * t;
//!     filter.observe(f64::from(frame) / 60.0, &[Some(Isometry3::translation(x as f32, 0.0, 0.05).into())])?;
//! }
//! filter.finish()?;
//! let found = filter.identified();
//! assert!(found.units[0].friction.holds(0.3), "{}", found.units[0].friction);
//! assert_eq!(found.units[0].restitution.middle(), None); // it never bounced
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod cloud;
mod estimator;
mod filter;
mod interval;
pub mod recording;
mod settings;
mod static_scene;
mod track;
mod window;

pub use estimator::{Identified, MassRatio, UnitPhysics};
pub use filter::{Filter, Scene};
pub use interval::Interval;
pub use settings::{IdentifyError, ModelError, PoseNoise, Prior, Settings};
pub use track::ObservedPose;
