//! URDF.
//!
//! Not by urdf-rs: it knows no lines for its errors, reads with three parsers of XML, and drops `<contact>` and `<gazebo>`.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, UnitVector3, Vector3};

use crate::error::{Problem, RobotError};
use crate::inertia::{Inertia, doubt, matrix};
use crate::meshes::Meshes;
use crate::options::LoadOptions;
use crate::robot::{JointKind, Link, Mimic, Robot, RobotJoint, turn};
use crate::solid::Solid;
use crate::tree::{MOST_GEOMETRIES, MOST_LINKS, Shapes, is_short, ordered};
use crate::xml::{Element, MOST};

/// Roots that an error names, at most.
const NAMED: usize = 4;

pub(crate) fn robot(root: &Element, options: &LoadOptions) -> Result<Robot, RobotError> {
    let mut reader = Reader {
        meshes: Meshes::new(&root.file, options),
        options,
        friction: friction_of_gazebo(root)?,
        notes: Vec::new(),
        geometries: 0,
    };
    let mut links = Vec::new();
    let mut numbers = HashMap::new();
    for element in root.all("link") {
        let name = element.need("name")?;
        is_short(name).map_err(|problem| element.fail(problem))?;
        if numbers.insert(name.to_owned(), links.len()).is_some() {
            return Err(element.fail(Problem::duplicate("link", name)));
        }
        if links.len() == MOST_LINKS {
            return Err(element.fail(Problem::TooMany { what: "links", most: MOST_LINKS }));
        }
        links.push(reader.link(element, name)?);
    }
    if links.is_empty() {
        return Err(root.fail(Problem::Missing("link")));
    }
    let joints = joints(root, &mut links, (&numbers, &mut reader.notes))?;
    let (links, joints) = rooted(root, links, joints)?;
    let name = root.get("name").unwrap_or("robot").to_owned();
    let is_in_world = links.first().is_some_and(|link| {
        link.name == "world" && link.inertia.mass_kg == 0.0 && link.pieces.is_empty()
    });
    let Reader { meshes, notes, .. } = reader;
    let files = meshes.files().collect();
    Ok(Robot { name, links, joints, is_in_world, planes: Vec::new(), notes, files })
}

/// Links with the root first, and joints with parents first.
fn rooted(
    root: &Element,
    mut links: Vec<Link>,
    mut joints: Vec<RobotJoint>,
) -> Result<(Vec<Link>, Vec<RobotJoint>), RobotError> {
    let children: HashSet<usize> = joints.iter().map(|joint| joint.child).collect();
    let roots: Vec<usize> = (0..links.len()).filter(|link| !children.contains(link)).collect();
    let [first] = roots[..] else {
        let names = roots.iter().take(NAMED).filter_map(|link| links.get(*link));
        let names: Vec<&str> = names.map(|link| link.name.as_str()).collect();
        return Err(root.fail(match roots.is_empty() {
            true => Problem::Loop("each link hangs from another, in a circle"),
            false => Problem::Roots { found: roots.len(), names: names.join(", ") },
        }));
    };
    links.swap(0, first);
    let swapped = |link: usize| match link {
        link if link == first => 0,
        0 => first,
        link => link,
    };
    for joint in &mut joints {
        (joint.parent, joint.child) = (swapped(joint.parent), swapped(joint.child));
    }
    let circle = Problem::Loop("some links hang from each other, in a circle");
    let joints = ordered(&joints, links.len(), 0).ok_or_else(|| root.fail(circle))?;
    Ok((links, joints))
}

/// Friction that `<gazebo reference="LINK">` gives.
fn friction_of_gazebo(root: &Element) -> Result<HashMap<String, f64>, RobotError> {
    let mut friction = HashMap::new();
    for gazebo in root.all("gazebo") {
        let Some(link) = gazebo.get("reference") else { continue };
        // Its text is no attribute, and Gazebo writes it as either.
        let own = gazebo.child("mu1").or(gazebo.child("mu"));
        if let Some(own) = own
            && let Some(number) = own.number("value")?.or(own.text_number())
        {
            friction.insert(link.to_owned(), number);
        }
    }
    Ok(friction)
}

struct Reader<'o> {
    meshes: Meshes,
    options: &'o LoadOptions,
    friction: HashMap<String, f64>,
    notes: Vec<String>,
    geometries: usize,
}

impl Reader<'_> {
    fn link(&mut self, element: &Element, name: &str) -> Result<Link, RobotError> {
        let inertia = match element.child("inertial") {
            Some(inertial) => self.inertia(inertial, name)?,
            None => Inertia::default(),
        };
        let mut shapes = Shapes::default();
        for collision in element.all("collision") {
            self.shape(collision, &mut shapes)?;
        }
        // What is seen stands for what touches where nothing touches.
        if element.child("collision").is_none() {
            for visual in element.all("visual") {
                self.shape(visual, &mut shapes)?;
            }
        }
        let contact =
            element.child("contact").and_then(|contact| contact.child("lateral_friction"));
        let friction = match contact {
            Some(friction) => friction.number("value")?,
            None => self.friction.get(name).copied(),
        };
        let friction = friction.map(|friction| friction.clamp(0.0, 1e3));
        Ok(shapes.link(name.to_owned(), inertia, friction))
    }

    fn inertia(&mut self, inertial: &Element, link: &str) -> Result<Inertia, RobotError> {
        let mass = inertial.child("mass").ok_or_else(|| inertial.fail(Problem::Missing("mass")))?;
        mass.need("value")?;
        let mass_kg = mass.number("value")?.unwrap_or_default();
        let mut moments = [0.0; 6];
        if let Some(inertia) = inertial.child("inertia") {
            for (moment, name) in moments.iter_mut().zip(["ixx", "iyy", "izz", "ixy", "ixz", "iyz"])
            {
                *moment = inertia.number(name)?.unwrap_or_default();
            }
        }
        let own = Inertia { mass_kg, centre_m: Point3::origin(), about_centre: matrix(moments) };
        let own = own.moved(&origin(inertial)?);
        // Bodies without mass have no inertia either, whatever a file gives as a placeholder.
        if mass_kg == 0.0 {
            return Ok(Inertia { about_centre: nalgebra::Matrix3::zeros(), ..own });
        }
        let balances = self.options.balance_inertia && mass_kg > 0.0;
        if let Some(problem) = own.problem().filter(|_| !balances) {
            return Err(inertial.fail(problem));
        }
        if own.is_of_a_body() {
            return Ok(own);
        }
        self.notes.push(doubt(link, balances));
        Ok(if balances { own.balanced() } else { own })
    }

    /// Adds a collision or visual element's geometry.
    fn shape(&mut self, element: &Element, shapes: &mut Shapes) -> Result<(), RobotError> {
        let geometry =
            element.child("geometry").ok_or_else(|| element.fail(Problem::Missing("geometry")))?;
        let pose = origin(element)?;
        self.geometries += 1;
        if self.geometries > MOST_GEOMETRIES {
            return Err(
                element.fail(Problem::TooMany { what: "geometries", most: MOST_GEOMETRIES })
            );
        }
        let Some(kind) = geometry.children.first() else {
            return Err(geometry.fail(Problem::Missing("shape")));
        };
        let number = |name: &'static str| -> Result<f64, RobotError> {
            kind.need(name)?;
            Ok(kind.number(name)?.unwrap_or_default())
        };
        let solid = match kind.tag.as_str() {
            "box" => {
                // Whole sides, unlike MJCF's.
                kind.need("size")?;
                Solid::Box(kind.numbers("size")?.unwrap_or_default().map(|side: f64| side / 2.0))
            }
            "sphere" => Solid::Ellipsoid([number("radius")?; 3]),
            "cylinder" => Solid::Cylinder(number("radius")?, number("length")? / 2.0),
            "capsule" => Solid::Capsule(number("radius")?, number("length")? / 2.0),
            "mesh" => return self.mesh(kind, &pose, shapes),
            "plane" => {
                self.notes
                    .push("a plane of a link is passed over; give planes to the scene".into());
                return Ok(());
            }
            _ => {
                let expected = "box, sphere, cylinder, capsule or mesh";
                return Err(kind.fail(Problem::word("geometry", &kind.tag, expected)));
            }
        };
        let lengths = "give whole sides, or radius and length, in metres";
        shapes
            .add_solid(&solid, (&pose, lengths), &mut self.meshes)
            .map_err(|problem| kind.fail(problem))
    }

    fn mesh(
        &mut self,
        kind: &Element,
        pose: &Isometry3<f64>,
        shapes: &mut Shapes,
    ) -> Result<(), RobotError> {
        let uri = kind.need("filename")?;
        // One number scales all axes.
        let scale = match kind.get("scale") {
            Some(text) if text.split_ascii_whitespace().count() == 1 => {
                Vector3::repeat(kind.number("scale")?.unwrap_or(1.0))
            }
            _ => Vector3::from(kind.numbers("scale")?.unwrap_or([1.0; 3])),
        };
        let folder = kind.file.parent().unwrap_or(Path::new("."));
        let path = match self.meshes.find(uri, folder) {
            Err(Problem::NoMesh { uri }) if self.options.skip_missing_meshes => {
                self.notes.push(format!("the mesh {uri:?} is not found, and passed over"));
                return Ok(());
            }
            found => found.map_err(|problem| kind.fail(problem))?,
        };
        let read = self
            .meshes
            .read(&path, uri)
            .and_then(|file| shapes.add_mesh(&file, (&scale, pose), true, &mut self.meshes));
        read.map_err(|problem| kind.fail(problem))
    }
}

/// The pose that an element's `<origin>` says.
fn origin(element: &Element) -> Result<Isometry3<f64>, RobotError> {
    let Some(origin) = element.child("origin") else { return Ok(Isometry3::identity()) };
    let xyz = origin.numbers("xyz")?.unwrap_or([0.0; 3]);
    let rotation = match (origin.numbers("rpy")?, origin.numbers("quat_xyzw")?) {
        (None, Some([x, y, z, w])) => turn([w, x, y, z]).ok_or_else(|| {
            let (attribute, found) = ("quat_xyzw".to_owned(), "0 0 0 0".to_owned());
            origin.fail(Problem::Number { attribute, found, expected: "a quaternion" })
        })?,
        (rpy, _) => {
            let [roll, pitch, yaw] = rpy.unwrap_or([0.0; 3]);
            UnitQuaternion::from_euler_angles(roll, pitch, yaw)
        }
    };
    Ok(Isometry3::from_parts(Translation3::from(Vector3::from(xyz)), rotation))
}

fn joints(
    root: &Element,
    links: &mut Vec<Link>,
    (numbers, notes): (&HashMap<String, usize>, &mut Vec<String>),
) -> Result<Vec<RobotJoint>, RobotError> {
    let mut joints: Vec<RobotJoint> = Vec::new();
    let mut names: HashMap<String, usize> = HashMap::new();
    let mut children = HashSet::new();
    let mut mimics = Vec::new();
    // Those of transmissions name joints alone.
    for element in root
        .all("joint")
        .filter(|joint| joint.get("type").is_some() || joint.child("child").is_some())
    {
        let name = element.need("name")?.to_owned();
        if names.contains_key(&name) {
            return Err(element.fail(Problem::duplicate("joint", &name)));
        }
        let end = |tag: &'static str| -> Result<usize, RobotError> {
            let end = element.child(tag).ok_or_else(|| element.fail(Problem::Missing(tag)))?;
            let link = end.need("link")?;
            numbers.get(link).copied().ok_or_else(|| end.fail(Problem::unknown("link", link)))
        };
        let (parent, child) = (end("parent")?, end("child")?);
        if !children.insert(child) {
            return Err(element.fail(Problem::Loop("a second joint has the same child")));
        }
        if parent == child {
            return Err(element.fail(Problem::Loop("a link hangs from itself")));
        }
        let origin = origin(element)?;
        let joint = |kind: JointKind| RobotJoint {
            name: name.clone(),
            parent,
            child,
            origin,
            kind,
            anchor: Point3::origin(),
            reference: 0.0,
            mimic: None,
        };
        let kind = match element.need("type")? {
            "fixed" => JointKind::Fixed,
            "continuous" => JointKind::Continuous { axis: axis(element)? },
            "revolute" => {
                element.child("limit").ok_or_else(|| element.fail(Problem::Missing("limit")))?;
                match limits(element)? {
                    Some(limits) => JointKind::Revolute { axis: axis(element)?, limits },
                    None => JointKind::Continuous { axis: axis(element)? },
                }
            }
            "prismatic" => JointKind::Prismatic { axis: axis(element)?, limits: limits(element)? },
            "floating" => JointKind::Free,
            "spherical" => JointKind::Ball,
            "planar" => {
                // Two slides and a turn, through two links that have no mass.
                let normal = axis(element)?;
                let [first, second] = across(&normal);
                let mut from = parent;
                for (number, axis) in [first, second].into_iter().enumerate() {
                    let between = links.len();
                    let origin = if number == 0 { origin } else { Isometry3::identity() };
                    links.push(Link { name: format!("{name}/{number}"), ..Link::default() });
                    let kind = JointKind::Prismatic { axis, limits: None };
                    let name = format!("{name}/{number}");
                    joints.push(RobotJoint {
                        name,
                        parent: from,
                        child: between,
                        origin,
                        ..joint(kind)
                    });
                    from = between;
                }
                if element.child("mimic").is_some() {
                    notes.push(format!(
                        "the joint {name} is planar, and moves in three ways: it follows no other"
                    ));
                }
                names.insert(name.clone(), joints.len());
                let turn = joint(JointKind::Continuous { axis: normal });
                joints.push(RobotJoint { parent: from, origin: Isometry3::identity(), ..turn });
                continue;
            }
            other => {
                let expected =
                    "fixed, revolute, continuous, prismatic, planar, floating or spherical";
                return Err(element.fail(Problem::word("type", other, expected)));
            }
        };
        if let Some(mimic) = element.child("mimic") {
            mimics.push((joints.len(), mimic));
        }
        names.insert(name.clone(), joints.len());
        joints.push(joint(kind));
    }
    for (joint, element) in mimics {
        let leader = element.need("joint")?;
        let leader =
            *names.get(leader).ok_or_else(|| element.fail(Problem::unknown("joint", leader)))?;
        let multiplier = element.number("multiplier")?.unwrap_or(1.0);
        let mimic =
            Mimic { joint: leader, multiplier, offset: element.number("offset")?.unwrap_or(0.0) };
        if let Some(joint) = joints.get_mut(joint) {
            joint.mimic = Some(mimic);
        }
        follows(&joints, joint).map_err(|problem| element.fail(problem))?;
    }
    Ok(joints)
}

/// Refuses joints that follow themselves, or what has no one position.
pub(crate) fn follows(joints: &[RobotJoint], joint: usize) -> Result<(), Problem> {
    let (mut at, mut factor, mut offset) = (joint, 1.0_f64, 0.0_f64);
    for _ in 0..=joints.len() {
        let Some(own) = joints.get(at) else { break };
        if own.kind.positions() != 1 {
            let what = "a joint that follows, or leads, and has no one position";
            return Err(Problem::Unsupported {
                what,
                remedy: "let hinges and slides follow each other",
            });
        }
        let Some(mimic) = own.mimic else { return Ok(()) };
        (at, offset) = (mimic.joint, offset + factor * mimic.offset);
        factor *= mimic.multiplier;
        if factor.abs().max(offset.abs()) > MOST {
            let what = "a joint that follows others with a factor or an offset above 1e30";
            return Err(Problem::Unsupported { what, remedy: "give smaller multipliers" });
        }
    }
    Err(Problem::Loop("joints follow each other in a circle"))
}

/// A joint's axis, x where it has none.
fn axis(element: &Element) -> Result<UnitVector3<f64>, RobotError> {
    let Some(axis) = element.child("axis") else { return Ok(Vector3::x_axis()) };
    let numbers = axis.numbers("xyz")?.unwrap_or([1.0, 0.0, 0.0]);
    UnitVector3::try_new(Vector3::from(numbers), 1e-9).ok_or_else(|| {
        let (attribute, found) = ("xyz".to_owned(), axis.get("xyz").unwrap_or_default());
        let found = rigidformer_runtime::files::shown(found, crate::error::SHOWN);
        axis.fail(Problem::Number { attribute, found, expected: "a direction" })
    })
}

/// Two directions across one.
fn across(normal: &UnitVector3<f64>) -> [UnitVector3<f64>; 2] {
    let other = if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let first = UnitVector3::new_normalize(other - normal.into_inner() * normal.dot(&other));
    [first, UnitVector3::new_normalize(normal.cross(&first))]
}

/// Least and greatest position; none where they do not rise, which stands for no limits in MuJoCo and PyBullet too.
fn limits(element: &Element) -> Result<Option<[f64; 2]>, RobotError> {
    let Some(limit) = element.child("limit") else { return Ok(None) };
    let lower = limit.number("lower")?.unwrap_or(0.0);
    let upper = limit.number("upper")?.unwrap_or(0.0);
    Ok((lower < upper).then_some([lower, upper]))
}
