//! Bodies and joints of `<worldbody>`.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::rc::Rc;

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};

use super::compiler::{Compiler, FromGeometry};
use super::defaults::{Defaults, MAIN};
use crate::error::{Problem, RobotError};
use crate::inertia::{BELOW_0, Inertia, doubt, matrix};
use crate::meshes::{MeshFile, MeshInertia, Meshes};
use crate::options::LoadOptions;
use crate::robot::{JointKind, Link, RobotJoint};
use crate::tree::{MOST_LINKS, Shapes, is_short};
use crate::xml::Element;

/// Notes, at most.
const MOST_NOTES: usize = 32;

/// A file while it is read.
pub(super) struct Reader<'f> {
    pub(super) compiler: Compiler,
    pub(super) defaults: Defaults,
    pub(super) assets: HashMap<String, &'f Element>,
    pub(super) folder: PathBuf,
    pub(super) meshes: Meshes,
    pub(super) options: &'f LoadOptions,
    pub(super) links: Vec<Link>,
    pub(super) joints: Vec<RobotJoint>,
    pub(super) names: HashSet<String>,
    pub(super) joint_names: HashSet<String>,
    pub(super) planes: Vec<([f64; 3], f64, f64)>,
    pub(super) notes: Vec<String>,
    pub(super) geometries: usize,
    /// Of meshes at 1 kg/m3.
    pub(super) inertias: HashMap<(String, MeshInertia), Option<Inertia>>,
    /// Meshes by name; none where the file is passed over.
    pub(super) loaded: HashMap<String, Option<Loaded>>,
}

/// A mesh as geometries take it: with its own reference taken off.
#[derive(Clone)]
pub(super) struct Loaded {
    pub(super) file: Rc<MeshFile>,
    pub(super) scale: Vector3<f64>,
}

/// What a body's elements make of it.
#[derive(Default)]
pub(super) struct Parts<'f> {
    pub(super) touching: Shapes,
    pub(super) seen: Shapes,
    pub(super) weights: Vec<Inertia>,
    pub(super) friction: Option<f64>,
    inertial: Option<(&'f Element, Isometry3<f64>)>,
    joints: Vec<(&'f Element, &'f str, Isometry3<f64>)>,
    bodies: Vec<(&'f Element, &'f str, Isometry3<f64>)>,
    pub(super) geometries: Vec<(&'f Element, &'f str, Isometry3<f64>)>,
    /// Those that are for pictures alone.
    pub(super) later: Vec<(&'f Element, &'f str, Isometry3<f64>)>,
}

impl<'f> Reader<'f> {
    pub(super) fn note(&mut self, text: String) {
        if self.notes.len() < MOST_NOTES && !self.notes.contains(&text) {
            self.notes.push(text);
        }
    }

    /// All bodies, below a link for the world.
    pub(super) fn world(&mut self, root: &'f Element) -> Result<(), RobotError> {
        self.names.insert("world".into());
        self.links.push(Link { name: "world".into(), ..Link::default() });
        let mut parts = Parts::default();
        for world in root.all("worldbody") {
            self.collect(world, MAIN, &Isometry3::identity(), &mut parts)?;
        }
        self.add_all(&mut parts, (true, false))?;
        let shapes = if parts.touching.is_empty() { parts.seen } else { parts.touching };
        let world = shapes.link("world".into(), Inertia::default(), parts.friction);
        if let Some(first) = self.links.first_mut() {
            *first = world;
        }
        for (body, class, frame) in parts.bodies {
            self.body(body, class, &frame, 0)?;
        }
        Ok(())
    }

    /// Sorts a body's children, also those in frames.
    fn collect(
        &mut self,
        element: &'f Element,
        class: &'f str,
        frame: &Isometry3<f64>,
        parts: &mut Parts<'f>,
    ) -> Result<(), RobotError> {
        for child in &element.children {
            let around = child.get("childclass").unwrap_or(class);
            match child.tag.as_str() {
                "frame" => {
                    let inner = frame * self.compiler.pose(child)?;
                    self.collect(child, around, &inner, parts)?;
                }
                "body" => parts.bodies.push((child, around, *frame)),
                "geom" => parts.geometries.push((child, class, *frame)),
                "joint" | "freejoint" => parts.joints.push((child, class, *frame)),
                "inertial" if parts.inertial.is_some() => {
                    return Err(
                        child.fail(Problem::Duplicate { kind: "inertial", name: String::new() })
                    );
                }
                "inertial" => parts.inertial = Some((child, *frame)),
                "replicate" | "attach" | "composite" | "flexcomp" => {
                    let what = "an element that makes others";
                    let remedy =
                        "write the model out with MuJoCo (mj_saveLastXML) and give that file";
                    return Err(child.fail(Problem::Unsupported { what, remedy }));
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn body(
        &mut self,
        element: &'f Element,
        class: &'f str,
        frame: &Isometry3<f64>,
        parent: usize,
    ) -> Result<(), RobotError> {
        let name = match element.get("name") {
            Some(name) => name.to_owned(),
            None => (self.links.len()..)
                .map(|n| format!("body{n}"))
                .find(|n| !self.names.contains(n))
                .unwrap_or_default(),
        };
        is_short(&name).map_err(|problem| element.fail(problem))?;
        if !self.names.insert(name.clone()) {
            return Err(element.fail(Problem::duplicate("body", &name)));
        }
        let mut parts = Parts::default();
        self.collect(element, class, &Isometry3::identity(), &mut parts)?;
        let mut origin = frame * self.compiler.pose(element)?;
        let mut from = parent;
        let joints = std::mem::take(&mut parts.joints);
        let mut last = None;
        for (number, (joint, class, frame)) in joints.iter().enumerate() {
            // Several joints of a body follow each other, through links that have no mass.
            if let Some(joint) = last.take() {
                let between = self
                    .add(element, Link { name: format!("{name}/{number}"), ..Link::default() })?;
                self.hang(from, between, origin, Some(joint));
                (from, origin) = (between, Isometry3::identity());
            }
            last = Some(self.joint(joint, (class, frame), (parent, joints.len()))?);
        }
        if element.flag("mocap")? == Some(true) {
            self.note(format!("the body {name} is moved by mocap, and taken for fixed"));
        }
        let own = self.links.len();
        // Its children count from here on.
        self.add(element, Link::default())?;
        self.hang(from, own, origin, last);
        let link = self.link(element, name, &mut parts)?;
        if let Some(slot) = self.links.get_mut(own) {
            *slot = link;
        }
        for (body, class, frame) in parts.bodies {
            self.body(body, class, &frame, own)?;
        }
        Ok(())
    }

    fn add(&mut self, element: &Element, link: Link) -> Result<usize, RobotError> {
        if self.links.len() >= MOST_LINKS {
            return Err(element.fail(Problem::TooMany { what: "links", most: MOST_LINKS }));
        }
        self.links.push(link);
        Ok(self.links.len() - 1)
    }

    fn hang(&mut self, parent: usize, child: usize, origin: Isometry3<f64>, joint: Option<Axis>) {
        let joint = joint.unwrap_or(Axis {
            name: String::new(),
            kind: JointKind::Fixed,
            anchor: Point3::origin(),
            reference: 0.0,
        });
        let Axis { name, kind, anchor, reference } = joint;
        self.joints.push(RobotJoint {
            name,
            parent,
            child,
            origin,
            kind,
            anchor,
            reference,
            mimic: None,
        });
    }

    fn joint(
        &mut self,
        element: &Element,
        (class, frame): (&str, &Isometry3<f64>),
        (parent, count): (usize, usize),
    ) -> Result<Axis, RobotError> {
        let is_free = element.tag == "freejoint";
        let element = &match is_free {
            true => element.clone(),
            false => self.defaults.filled(element, "joint", class)?,
        };
        let name = element.get("name").unwrap_or_default().to_owned();
        if !name.is_empty() && !self.joint_names.insert(name.clone()) {
            return Err(element.fail(Problem::duplicate("joint", &name)));
        }
        let kind = if is_free { "free" } else { element.get("type").unwrap_or("hinge") };
        let anchor = frame * Point3::from(element.numbers::<3>("pos")?.unwrap_or([0.0; 3]));
        let reference = element.number("ref")?.unwrap_or(0.0);
        let axis = || -> Result<UnitVector3<f64>, RobotError> {
            let numbers = element.numbers("axis")?.unwrap_or([0.0, 0.0, 1.0]);
            let axis = UnitVector3::try_new(Vector3::from(numbers), 1e-10).ok_or_else(|| {
                let found = format!("{numbers:?}");
                element.fail(Problem::Number {
                    attribute: "axis".into(),
                    found,
                    expected: "a direction",
                })
            })?;
            Ok(frame.rotation * axis)
        };
        Ok(match kind {
            "free" if parent != 0 || count != 1 => {
                let what = "a free joint below another body, or beside other joints";
                return Err(element
                    .fail(Problem::Unsupported { what, remedy: "put its body into the world" }));
            }
            "free" => {
                Axis { name, kind: JointKind::Free, anchor: Point3::origin(), reference: 0.0 }
            }
            "ball" => Axis { name, kind: JointKind::Ball, anchor, reference: 0.0 },
            "slide" => {
                let kind = JointKind::Prismatic {
                    axis: axis()?,
                    limits: self.limits(element, |way| way)?,
                };
                Axis { name, kind, anchor, reference }
            }
            "hinge" => {
                let kind = match self.limits(element, |angle| self.compiler.angle(angle))? {
                    Some(limits) => JointKind::Revolute { axis: axis()?, limits },
                    None => JointKind::Continuous { axis: axis()? },
                };
                Axis { name, kind, anchor, reference: self.compiler.angle(reference) }
            }
            other => {
                return Err(element.fail(Problem::word(
                    "type",
                    other,
                    "hinge, slide, ball or free",
                )));
            }
        })
    }

    /// The range of a joint that has one.
    fn limits(
        &self,
        element: &Element,
        of: impl Fn(f64) -> f64,
    ) -> Result<Option<[f64; 2]>, RobotError> {
        let range = element.numbers::<2>("range")?;
        let said = [("true", Some(true)), ("false", Some(false)), ("auto", None)];
        let limited = element.word("limited", &said, "true, false or auto")?.flatten();
        // A range that does not rise is none, unless the joint says that it counts.
        let rises = range.is_some_and(|[low, high]| low < high);
        let is_limited = limited.unwrap_or(self.compiler.auto_limits && rises);
        match range.filter(|_| is_limited) {
            Some([low, high]) if !rises => {
                let found = format!("{low} {high}");
                Err(element.fail(Problem::Number {
                    attribute: "range".into(),
                    found,
                    expected: "a range that rises",
                }))
            }
            Some(range) => Ok(Some(range.map(of))),
            None if limited == Some(true) => Err(element.fail(Problem::Missing("range"))),
            None => Ok(None),
        }
    }

    fn link(
        &mut self,
        element: &Element,
        name: String,
        parts: &mut Parts<'f>,
    ) -> Result<Link, RobotError> {
        let given = match self.compiler.from_geometry {
            FromGeometry::Always => None,
            _ => parts.inertial,
        };
        let weighs = given.is_none() && self.compiler.from_geometry != FromGeometry::Never;
        self.add_all(parts, (false, weighs))?;
        let (own, of) = match given {
            Some((inertial, frame)) => (self.inertial(inertial)?.moved(&frame), inertial),
            None => (Inertia::sum(&parts.weights), element),
        };
        let own = self.bounded(own, of, &name)?;
        let touching = std::mem::take(&mut parts.touching);
        let shapes = if touching.is_empty() { std::mem::take(&mut parts.seen) } else { touching };
        Ok(shapes.link(name, own, parts.friction))
    }

    /// What an `<inertial>` says.
    fn inertial(&self, element: &Element) -> Result<Inertia, RobotError> {
        element.need("mass")?;
        let mass_kg = element.number("mass")?.unwrap_or_default();
        // A bound on masses would hide the sign.
        if mass_kg < 0.0 {
            return Err(element.fail(BELOW_0));
        }
        let moments =
            match (element.numbers::<6>("fullinertia")?, element.numbers::<3>("diaginertia")?) {
                (Some(full), _) => full,
                (None, Some([x, y, z])) => [x, y, z, 0.0, 0.0, 0.0],
                (None, None) if mass_kg == 0.0 => [0.0; 6],
                (None, None) => {
                    return Err(element.fail(Problem::Missing("diaginertia or fullinertia")));
                }
            };
        let own = Inertia { mass_kg, centre_m: Point3::origin(), about_centre: matrix(moments) };
        Ok(own.moved(&self.compiler.pose(element)?))
    }

    /// With bounds, and balanced where the file or the caller asks for it.
    fn bounded(
        &mut self,
        mut own: Inertia,
        of: &Element,
        name: &str,
    ) -> Result<Inertia, RobotError> {
        own.mass_kg = own.mass_kg.max(self.compiler.bound_mass);
        let bound = self.compiler.bound_inertia;
        if bound > 0.0 && own.about_centre.iter().all(|moment| moment.is_finite()) {
            let mut parted = nalgebra::SymmetricEigen::new(own.about_centre);
            parted.eigenvalues.iter_mut().for_each(|moment| *moment = moment.max(bound));
            own.about_centre = parted.recompose();
        }
        let balances =
            own.mass_kg >= 0.0 && (self.compiler.balances || self.options.balance_inertia);
        if let Some(problem) = own.problem().filter(|_| !balances) {
            return Err(of.fail(problem));
        }
        if own.is_of_a_body() {
            return Ok(own);
        }
        self.note(doubt(name, balances));
        Ok(if balances { own.balanced() } else { own })
    }
}

/// A joint before its links are known.
struct Axis {
    name: String,
    kind: JointKind,
    anchor: Point3<f64>,
    reference: f64,
}
