//! Numbers of contact that recordings tell: which there are, how a scene takes them, and their file, `contact.toml`.
//!
//! A row of [`NUMBERS`] is all that a number is: its name, its range, how a search steps through it, how a scene gives it and takes it.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use rigidformer_core::geometry::{centre_of_mass, radius};
use rigidformer_core::kernels::in_own_environment;
use rigidformer_core::{Plane, Role};
use rigidformer_runtime::files::{FileError, read_whole, shown};
use toml::de::{DeTable, DeValue};

use crate::scenes::{RecordedScene, RecordedUnit, SceneError};

/// What the file says that it is.
const FORMAT: &str = "rigidformer-contact";
/// The one version of the file.
const VERSION: &str = "1";
/// Bytes of a file, at most: notes take most of them.
const MOST_BYTES: usize = 1 << 20;
/// Contact as stiff as this counts as rigid, N/m.
const RIGID_N_M: f32 = 1e9;
/// Where searches for a stiffness begin: on this many contact points a unit at rest sinks in by this share of its size.
const CORNERS: f32 = 4.0;
const SAG: f32 = 1e-3;
/// Where searches for a dissipation begin, by the speed (s/m) of what falls from half its size.
const LOST: f32 = 4.0;
/// Least friction or restitution of a plane that a unit's own can be told by. With less, a product of 2 asks for more than the 1000 that
/// the core takes.
const LEAST_COEFFICIENT: f32 = 2e-3;
/// A unit counts as a ball where its points reach this share of its radius in all directions, as in the solver.
const BALL: f32 = 0.975;
/// Subdivision of the octahedron whose lattice points those directions are, as in the solver.
const LATTICE: i32 = 8;

/// How a search steps through a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// By sums.
    Linear,
    /// By factors: the number is above 0.
    Log,
}

/// A number of contact.
pub struct Number {
    /// As the file and tables call it.
    pub name: &'static str,
    /// As options call it: several numbers may go together.
    pub group: &'static str,
    /// What it means.
    pub meaning: &'static str,
    /// The least and the greatest that it may be.
    pub range: [f32; 2],
    /// How it is searched.
    pub scale: Scale,
    /// The first step of a search: a difference, or the logarithm of a factor.
    pub spread: f64,
    /// What a scene has.
    get: fn(&Parts) -> f32,
    /// Gives it to a scene.
    set: fn(&mut Parts, f32),
    /// Where a search begins; `None`: with what a scene has.
    begin: Option<fn(&Parts) -> f32>,
    /// Whether a scene needs a plane for it.
    needs_plane: bool,
}

/// All numbers, in the order in which scenes take them.
pub const NUMBERS: [Number; 9] = [
    Number {
        name: "friction",
        group: "friction",
        meaning: "of a unit with the roughest plane: the product of both",
        range: [0.005, 2.0],
        scale: Scale::Log,
        spread: 0.25,
        get: |parts| product(parts, |plane| plane.friction, |unit| unit.physics.friction),
        set: |parts, value| {
            let (own, planes) = shares(parts.reference(|plane| plane.friction), value);
            parts.free().for_each(|unit| unit.physics.friction = own);
            parts
                .planes
                .iter_mut()
                .for_each(|plane| plane.friction = planes.unwrap_or(plane.friction));
        },
        begin: None,
        needs_plane: false,
    },
    Number {
        name: "restitution",
        group: "restitution",
        meaning: "of a unit with the roughest plane: the product of both",
        range: [0.0, 1.0],
        scale: Scale::Linear,
        spread: 0.06,
        get: |parts| product(parts, |plane| plane.restitution, |unit| unit.physics.restitution),
        set: |parts, value| {
            let (own, planes) = shares(parts.reference(|plane| plane.restitution), value);
            parts.free().for_each(|unit| unit.physics.restitution = own);
            let set = |plane: &mut Plane| plane.restitution = planes.unwrap_or(plane.restitution);
            parts.planes.iter_mut().for_each(set);
        },
        begin: None,
        needs_plane: false,
    },
    Number {
        name: "stiffness_n_m",
        group: "stiffness",
        meaning: "of a unit's contact points against what is rigid, N/m; 1e9 is rigid",
        range: [1.0, RIGID_N_M],
        scale: Scale::Log,
        spread: 0.7,
        get: |parts| parts.mean(stiffness),
        set: |parts, value| {
            let stiffness_n_m = if value < RIGID_N_M { value } else { 0.0 };
            parts.free().for_each(|unit| unit.compliance.stiffness_n_m = stiffness_n_m);
        },
        // A search that begins with what is rigid goes nowhere.
        begin: Some(|parts| {
            parts.mean(|unit| match unit.compliance.is_rigid() {
                true => {
                    let weight = unit.physics.mass_kg * parts.pull(unit);
                    weight / (CORNERS * SAG * side(unit))
                }
                false => unit.compliance.stiffness_n_m,
            })
        }),
        needs_plane: false,
    },
    Number {
        name: "dissipation_s_m",
        group: "stiffness",
        meaning: "of a unit's contact points that give way, s/m",
        range: [0.0, 1e3],
        scale: Scale::Linear,
        spread: 1.0,
        get: |parts| parts.mean(|unit| unit.compliance.dissipation_s_m),
        set: |parts, value| parts.free().for_each(|unit| unit.compliance.dissipation_s_m = value),
        begin: Some(|parts| {
            parts.mean(|unit| match unit.compliance.is_rigid() {
                true => LOST / (parts.pull(unit) * side(unit)).sqrt(),
                false => unit.compliance.dissipation_s_m,
            })
        }),
        needs_plane: false,
    },
    Number {
        name: "gravity_factor",
        group: "gravity",
        meaning: "how strong gravity is, by that in the file: below 1 where a record's lengths are too short",
        range: [0.5, 2.0],
        scale: Scale::Log,
        spread: 0.02,
        get: |_| 1.0,
        set: |parts, value| parts.gravity_m_s2 *= value,
        begin: None,
        needs_plane: false,
    },
    Number {
        name: "table_height_m",
        group: "height",
        meaning: "how much higher the table is than in the file",
        range: [-0.05, 0.05],
        scale: Scale::Linear,
        spread: 0.001,
        get: |_| 0.0,
        set: |parts, value| {
            if let Some(table) = parts.table() {
                table.offset_m += value;
            }
        },
        begin: None,
        needs_plane: true,
    },
    Number {
        name: "table_slope_x",
        group: "tilt",
        meaning: "how far the table rises along x, a share of the way",
        range: [-0.1, 0.1],
        scale: Scale::Linear,
        spread: 0.002,
        get: |_| 0.0,
        set: |parts, value| parts.tilt([value, 0.0]),
        begin: None,
        needs_plane: true,
    },
    Number {
        name: "table_slope_y",
        group: "tilt",
        meaning: "how far the table rises along y, a share of the way",
        range: [-0.1, 0.1],
        scale: Scale::Linear,
        spread: 0.002,
        get: |_| 0.0,
        set: |parts, value| parts.tilt([0.0, value]),
        begin: None,
        needs_plane: true,
    },
    Number {
        name: "inertia_factor",
        group: "inertia",
        meaning: "how much the moments of inertia are of those in the file",
        range: [0.2, 5.0],
        scale: Scale::Log,
        spread: 0.15,
        get: |_| 1.0,
        set: |parts, value| {
            // Of a factor of 1 the solver's own moments stay, to the bit.
            if value != 1.0 {
                parts
                    .free()
                    .for_each(|unit| unit.inertia = Some(moments(unit).map(|of| of * value)));
            }
        },
        begin: None,
        needs_plane: false,
    },
];

/// What of a scene numbers change.
struct Parts {
    units: Vec<RecordedUnit>,
    planes: Vec<Plane>,
    /// The place of the plane that things lie on, before any is tilted: of parallel ones another would come first afterwards.
    table: Option<usize>,
    gravity_m_s2: Vector3<f32>,
}

impl Parts {
    fn of(scene: &RecordedScene) -> Parts {
        let planes = scene.planes().unwrap_or_default().to_vec();
        let down = scene.gravity_m_s2();
        let rising = |plane: &Plane| -plane.normal.dot(&down);
        // Of equal ones the first, so that the order of a file decides.
        let best = planes.iter().map(rising).fold(f32::NEG_INFINITY, f32::max);
        let table = planes.iter().position(|plane| rising(plane) >= best);
        Parts { units: scene.units().to_vec(), planes, table, gravity_m_s2: down }
    }

    /// The mean over free units.
    fn mean(&self, of: impl Fn(&RecordedUnit) -> f32) -> f32 {
        let free = self.units.iter().filter(|unit| unit.role == Role::Free);
        free.clone().map(of).sum::<f32>() / free.count().max(1) as f32
    }

    fn free(&mut self) -> impl Iterator<Item = &mut RecordedUnit> {
        self.units.iter_mut().filter(|unit| unit.role == Role::Free)
    }

    /// How strong gravity is, m/s^2; without any, as much as moves a unit by its size in a second.
    fn pull(&self, unit: &RecordedUnit) -> f32 {
        let strong = self.gravity_m_s2.norm();
        if strong > 0.0 { strong } else { side(unit) }
    }

    /// A coefficient of the roughest plane, as identification has it; 1 without planes.
    fn reference(&self, of: impl Fn(&Plane) -> f32) -> f32 {
        let rough = self.planes.iter().max_by(|a, b| a.friction.total_cmp(&b.friction));
        rough.map_or(1.0, of)
    }

    /// The plane that things lie on.
    fn table(&mut self) -> Option<&mut Plane> {
        self.planes.get_mut(self.table?)
    }

    /// Tilts the table about its point that is nearest to the origin.
    fn tilt(&mut self, [x, y]: [f32; 2]) {
        let Some(table) = self.table() else { return };
        let normal = table.normal;
        let flat = |axis: Vector3<f32>| axis - normal * normal.dot(&axis);
        // Of a wall x is across.
        let first = flat(if normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() });
        let first = first / first.norm();
        let second = normal.cross(&first);
        let tilted = normal - first * x - second * y;
        let tilted = tilted / tilted.norm();
        table.offset_m *= tilted.dot(&normal);
        table.normal = tilted;
    }
}

/// The mean over free units of the products with the roughest plane's coefficient.
fn product(parts: &Parts, plane: fn(&Plane) -> f32, unit: fn(&RecordedUnit) -> f32) -> f32 {
    parts.mean(unit) * parts.reference(plane)
}

/// What a unit's own coefficient is for a product, and that of planes where it changes: a plane that has hardly any tells nothing of the
/// unit.
fn shares(plane: f32, value: f32) -> (f32, Option<f32>) {
    match plane >= LEAST_COEFFICIENT {
        true => (value / plane, None),
        false => (value.sqrt(), Some(value.sqrt())),
    }
}

/// Moments of inertia of a unit, kg m^2: its own, or those of a ball or of the box around its points.
fn moments(unit: &RecordedUnit) -> [f32; 3] {
    if let Some(own) = unit.inertia {
        return own;
    }
    let mass = unit.physics.mass_kg;
    if let Some(radius) = ball(unit) {
        return [0.4 * mass * radius * radius; 3];
    }
    let [low, high] = bounds(unit);
    let sides = high - low;
    let square = sides.component_mul(&sides);
    let own = |axis: f32| (mass * (square.sum() - axis) / 12.0).max(f32::MIN_POSITIVE);
    [own(square.x), own(square.y), own(square.z)]
}

/// The radius of a unit that the solver takes for a ball, metres.
fn ball(unit: &RecordedUnit) -> Option<f32> {
    if !unit.pieces.is_empty() {
        return None;
    }
    let mut points = unit.points.clone();
    let middle = centre_of_mass(&mut points);
    points.iter_mut().for_each(|point| *point -= middle.coords);
    let radius = radius(&points);
    let reaches = |along: Vector3<f32>| {
        let least = BALL * radius * along.norm();
        points.iter().any(|point| point.coords.dot(&along) >= least)
    };
    directions().all(reaches).then_some(radius)
}

/// The directions in which the solver feels for hulls, |x| + |y| + |z| = [`LATTICE`]; of no unit length.
fn directions() -> impl Iterator<Item = Vector3<f32>> {
    (-LATTICE..=LATTICE).flat_map(|y| {
        let reach = LATTICE - y.abs();
        (-reach..=reach).flat_map(move |x| {
            let z = reach - x.abs();
            // On the equator both halves are one.
            let both = [-z, z].into_iter().take(if z == 0 { 1 } else { 2 });
            both.map(move |z| Vector3::from([x, y, z].map(|value| value as f32)))
        })
    })
}

/// Corners of the box around a unit's points, in its frame.
fn bounds(unit: &RecordedUnit) -> [Vector3<f32>; 2] {
    let start = [Vector3::repeat(f32::INFINITY), Vector3::repeat(f32::NEG_INFINITY)];
    unit.points
        .iter()
        .fold(start, |[low, high], point| [low.inf(&point.coords), high.sup(&point.coords)])
}

/// The mean side of the box around a unit's points, metres.
fn side(unit: &RecordedUnit) -> f32 {
    let [low, high] = bounds(unit);
    (high - low).sum() / 3.0
}

/// N/m; of a rigid unit the least that counts as rigid.
fn stiffness(unit: &RecordedUnit) -> f32 {
    match unit.compliance.is_rigid() {
        true => RIGID_N_M,
        false => unit.compliance.stiffness_n_m,
    }
}

/// How large the free units of a scene are, metres: the mean side of the boxes around their points, of a cube its edge.
pub fn size_m(scene: &RecordedScene) -> f64 {
    let sides = |unit: &RecordedUnit| {
        let [low, high] = bounds(unit);
        (high - low).iter().map(|side| f64::from(*side)).sum::<f64>() / 3.0
    };
    let free = scene.units().iter().filter(|unit| unit.role == Role::Free);
    let sum: f64 = free.clone().map(sides).sum();
    sum / free.count().max(1) as f64
}

/// What is wrong with numbers of contact, their file, or a scene that is to take them. Its text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ContactError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file is none of such numbers.
    #[error("{}: line {line}: {what}; {remedy}", .path.display())]
    Text {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A scene without the plane that a number belongs to.
    #[error(
        "{scene}: has no plane, which {number} is of; leave {number} out, or give a scene with planes"
    )]
    NoPlane {
        /// The scene.
        scene: String,
        /// The number.
        number: &'static str,
    },
    /// A scene that is none with such numbers.
    #[error("{0}; give other numbers of contact")]
    Scene(#[from] SceneError),
}

/// Some of the [`NUMBERS`], each within its range.
///
/// ```
/// use rigidformer_evaluation::contact::Contact;
/// let contact = Contact::parse("contact.toml".as_ref(), "format = 'rigidformer-contact'\nversion = 1\nfriction = 0.2\n")?;
/// assert_eq!(contact.get("friction"), Some(0.2));
/// assert_eq!(Contact::parse("again.toml".as_ref(), &contact.text(&[]))?, contact);
/// # Ok::<(), rigidformer_evaluation::contact::ContactError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contact {
    values: [Option<f32>; NUMBERS.len()],
}

impl Contact {
    /// What a scene has: no change.
    pub fn of(scene: &RecordedScene) -> Contact {
        let parts = Parts::of(scene);
        let within = |number: Number| {
            let [least, most] = number.range;
            Some((number.get)(&parts).clamp(least, most))
        };
        Contact { values: NUMBERS.map(within) }
    }

    /// Where a search for a scene's numbers begins: with what it has, and for a stiffness of what is rigid with that by which a unit at
    /// rest sinks in by a thousandth of its size.
    pub fn begin(scene: &RecordedScene) -> Contact {
        let parts = Parts::of(scene);
        let at = |number: Number| (number.begin.unwrap_or(number.get))(&parts);
        let within = |number: Number| {
            let [least, most] = number.range;
            Some(at(number).clamp(least, most))
        };
        Contact { values: NUMBERS.map(within) }
    }

    /// By name.
    pub fn get(&self, name: &str) -> Option<f32> {
        self.values().find(|(number, _)| number.name == name).map(|(_, value)| value)
    }

    /// The numbers that it has.
    pub fn values(&self) -> impl Iterator<Item = (&'static Number, f32)> {
        static ALL: [Number; NUMBERS.len()] = NUMBERS;
        ALL.iter().zip(self.values).filter_map(|(number, value)| Some((number, value?)))
    }

    /// By its place among the [`NUMBERS`], if that is given.
    pub fn at(&self, index: usize) -> Option<f32> {
        self.values.get(index).copied().flatten()
    }

    /// The same with one number, by its place among the [`NUMBERS`], set to the nearest in its range, or left out.
    pub fn with(mut self, index: usize, value: Option<f32>) -> Contact {
        if let (Some(slot), Some(number)) = (self.values.get_mut(index), NUMBERS.get(index)) {
            *slot = value
                .filter(|value| !value.is_nan())
                .map(|value| value.clamp(number.range[0], number.range[1]));
        }
        self
    }

    /// A scene with these numbers in place of its own.
    ///
    /// # Errors
    /// [`ContactError::NoPlane`], or [`ContactError::Scene`] where a number makes it none.
    pub fn applied(&self, scene: &RecordedScene) -> Result<RecordedScene, ContactError> {
        in_own_environment(|| {
            let mut parts = Parts::of(scene);
            for (number, value) in self.values() {
                if number.needs_plane && parts.planes.is_empty() {
                    return Err(ContactError::NoPlane {
                        scene: scene.name().to_owned(),
                        number: number.name,
                    });
                }
                (number.set)(&mut parts, value);
            }
            let planes = scene.planes().map(|_| parts.planes);
            Ok(scene.with_parts(parts.units, planes, parts.gravity_m_s2)?)
        })
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`ContactError`]: what is wrong, with its line.
    pub fn open(path: &Path) -> Result<Contact, ContactError> {
        let bytes = read_whole(path)?;
        let bad = |what: &str| text_error(path, 1, what.to_owned());
        if bytes.len() > MOST_BYTES {
            return Err(bad("the file is longer than a MiB"));
        }
        let text = String::from_utf8(bytes).map_err(|_| bad("the file is no text in UTF-8"))?;
        Self::parse(path, &text)
    }

    /// Numbers from the text of a file; errors name `path`.
    ///
    /// # Errors
    /// [`ContactError::Text`]
    pub fn parse(path: &Path, text: &str) -> Result<Contact, ContactError> {
        let line_at = |at: usize| 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
        let table = DeTable::parse(text).map_err(|error| {
            let line = error.span().map_or(1, |span| line_at(span.start));
            text_error(path, line, shown(error.message(), 200))
        })?;
        let (mut contact, mut format, mut version) = (Contact::default(), false, false);
        for (key, value) in table.get_ref() {
            let fail = |what: String| Err(text_error(path, line_at(key.span().start), what));
            let (key, value) = (key.get_ref().as_ref(), value.get_ref());
            let name = shown(key, 60);
            if key == "format" {
                format = value.as_str() == Some(FORMAT);
                if !format {
                    return fail(format!("format is not \"{FORMAT}\""));
                }
                continue;
            }
            if key == "version" {
                version = matches!(value, DeValue::Integer(number) if number.as_str() == VERSION);
                if !version {
                    return fail(format!(
                        "version is not {VERSION}, the one that this program knows"
                    ));
                }
                continue;
            }
            let Some(index) = NUMBERS.iter().position(|number| number.name == key) else {
                return fail(format!("{name} is no number of contact"));
            };
            let [least, most] = NUMBERS[index].range;
            let found = match value {
                DeValue::Float(number) => number.as_str().parse::<f32>().ok(),
                DeValue::Integer(number) if number.radix() == 10 => {
                    number.as_str().parse::<f32>().ok()
                }
                _ => None,
            };
            match found {
                Some(found) if (least..=most).contains(&found) => {
                    contact.values[index] = Some(found)
                }
                _ => return fail(format!("{name} is not a number from {least} to {most}")),
            }
        }
        match (format, version) {
            (true, true) => Ok(contact),
            (false, _) => Err(text_error(path, 1, format!("format = \"{FORMAT}\" is missing"))),
            _ => Err(text_error(path, 1, format!("version = {VERSION} is missing"))),
        }
    }

    /// The text of a file, with notes behind the numbers by name, and at the top those that name none.
    pub fn text(&self, notes: &[(&str, String)]) -> String {
        let line = |text: &str| shown(text, 1000);
        let is_of = |name: &str| self.values().any(|(number, _)| number.name == name);
        let mut text = String::new();
        for (_, note) in notes.iter().filter(|(name, _)| !is_of(name)) {
            text += &format!("# {}\n", line(note));
        }
        text += &format!("format = \"{FORMAT}\"\nversion = {VERSION}\n");
        for (number, value) in self.values() {
            text += &format!("\n# {}\n", number.meaning);
            text += &format!("{} = {value:?}", number.name);
            if let Some((_, note)) = notes.iter().find(|(name, _)| *name == number.name) {
                text += &format!(" # {}", line(note));
            }
            text.push('\n');
        }
        text
    }
}

fn text_error(path: &Path, line: usize, what: String) -> ContactError {
    let names: Vec<&str> = NUMBERS.iter().map(|number| number.name).collect();
    let remedy = format!(
        "give a file that `rigidformer calibrate` wrote: format, version and some of {}",
        names.join(", ")
    );
    ContactError::Text { path: path.into(), line, what, remedy }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes::Split;
    use nalgebra::{Isometry3, Point3};
    use rigidformer_core::{Compliance, Physics};

    fn scene(planes: Vec<Plane>) -> RecordedScene {
        let corner =
            |i: i32| Point3::from([1, 2, 4].map(|bit| if i & bit == 0 { -0.05 } else { 0.05 }));
        let physics = Physics { mass_kg: 0.6, friction: 0.4, restitution: 0.3 };
        let unit = RecordedUnit::new(
            "cube",
            (0..8).map(corner).collect(),
            physics,
            vec![Isometry3::identity(); 3],
        );
        let shelf = unit.clone().with_role(Role::Fixed);
        let gravity = Vector3::new(0.0, 0.0, -9.81);
        let scene =
            RecordedScene::new("toss", 7, Split::Test, 100.0, gravity, vec![unit, shelf]).unwrap();
        scene.with_planes(planes).unwrap()
    }

    fn parse(text: &str) -> Result<Contact, String> {
        let head = "format = \"rigidformer-contact\"\nversion = 1\n";
        Contact::parse("c.toml".as_ref(), &format!("{head}{text}"))
            .map_err(|error| error.to_string())
    }

    #[test]
    fn a_file_says_what_was_written() {
        let mut contact = Contact::default();
        for (index, number) in NUMBERS.iter().enumerate() {
            contact = contact
                .with(index, Some(number.range[0] + (number.range[1] - number.range[0]) / 3.0));
        }
        let text = contact
            .text(&[("friction", "0.1 to\n 0.3".into()), ("", "of a \u{1b}[2J file".into())]);
        assert!(text.contains(" # 0.1 to 0.3\n") && !text.contains('\u{1b}'), "{text}");
        assert_eq!(Contact::parse("c.toml".as_ref(), &text).unwrap(), contact);
        assert_eq!(parse("").unwrap(), Contact::default());
        assert_eq!(parse("restitution = 1").unwrap().get("restitution"), Some(1.0));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line() {
        for (text, expected) in [
            ("\nfrictoin = 0.2", "c.toml: line 4: frictoin is no number of contact"),
            ("friction = 9", "line 3: friction is not a number from 0.005 to 2"),
            ("friction = nan", "line 3: friction is not a number"),
            ("friction = '0.2'", "line 3: friction is not a number"),
            ("friction = [0.2]", "line 3: friction is not a number"),
            ("restitution = 0.1\nfriction =", "line 4: "),
            ("friction = 0.1\nfriction = 0.1", "line 4: duplicate key"),
            ("\u{1b}[2J = 1", "line 3: "),
            ("'\u{7}' = 1", "line 3: "),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.contains(expected) && error.contains("calibrate"), "{text}: {error}");
        }
        let of = |text: &str| Contact::parse("c.toml".as_ref(), text).unwrap_err().to_string();
        assert!(of("friction = 0.2").contains("format = \"rigidformer-contact\" is missing"));
        assert!(of("format = 'rigidformer-contact'").contains("version = 1 is missing"));
        assert!(of("format = 'x'").contains("line 1: format is not"));
        assert!(of("version = 2").contains("version is not 1"));
        assert!(of(&"[".repeat(10_000)).contains("line 1"));
    }

    #[test]
    fn a_scene_takes_what_a_file_says() {
        let wall = Plane {
            normal: Vector3::new(-1.0, 0.0, 0.0),
            offset_m: -2.0,
            friction: 0.2,
            restitution: 0.3,
        };
        let given = scene(vec![wall, Plane::ground(0.5, 0.0)]);
        assert_eq!(Contact::of(&given).get("friction"), Some(0.2));
        let contact = parse(
            "friction = 0.1\nrestitution = 0.25\ngravity_factor = 0.5\ntable_height_m = 0.01\ntable_slope_x = 0.1\ninertia_factor = 2",
        )
        .unwrap();
        let scene = contact.applied(&given).unwrap();
        let [cube, shelf] = scene.units() else { panic!("two units") };
        let [across, table] = scene.planes().unwrap() else { panic!("two planes") };
        assert_eq!((cube.physics.friction, cube.physics.restitution), (0.2, 0.5));
        // The table bounced nothing, so both sides get the root.
        assert_eq!((across.friction, table.friction, table.restitution), (0.2, 0.5, 0.5));
        assert_eq!(shelf, &given.units()[1]);
        // A box of .1 m and .6 kg has 1e-3 kg m^2.
        assert!(cube.inertia.unwrap().iter().all(|moment| (moment - 2e-3).abs() < 1e-8));
        let over = |x: f32, z: f32| table.normal.dot(&Vector3::new(x, 0.3, z)) - table.offset_m;
        assert!(over(0.0, 0.01).abs() < 1e-6 && over(1.0, 0.11).abs() < 1e-6, "{table:?}");
        assert_eq!(across.normal, wall.normal);
        assert_eq!(scene.gravity_m_s2(), given.gravity_m_s2() * 0.5);
        assert_eq!(Contact::default().applied(&given).unwrap(), given);
        let error = contact.applied(&super::tests::scene(Vec::new())).unwrap_err().to_string();
        assert!(error.contains("toss") && error.contains("table_height_m"), "{error}");
    }

    /// After one tilt another of two parallel planes faces gravity more.
    #[test]
    fn one_of_two_parallel_planes_is_tilted() {
        let lower = Plane { offset_m: -0.5, ..Plane::ground(0.5, 0.5) };
        let given = scene(vec![Plane::ground(0.5, 0.5), lower]);
        let contact =
            parse("table_height_m = 0.01\ntable_slope_x = 0.05\ntable_slope_y = 0.02").unwrap();
        let tilted = contact.applied(&given).unwrap();
        let [table, other] = tilted.planes().unwrap() else { panic!("two planes") };
        assert_eq!(other, &lower);
        for (x, y, z) in [(0.0, 0.0, 0.01), (1.0, 0.0, 0.06), (0.0, 1.0, 0.03)] {
            let over = table.normal.dot(&Vector3::new(x, y, z)) - table.offset_m;
            assert!(over.abs() < 1e-4, "{x} {y}: {over} over {table:?}");
        }
    }

    /// No plane, however smooth, asks a unit for more than the core takes.
    #[test]
    fn coefficients_stay_in_the_range_of_the_core() {
        for smooth in [0.0, 1e-3, 1.5e-3, 1.999e-3, 2e-3, 2.1e-3, 1.0] {
            let given = scene(vec![Plane::ground(smooth, smooth)]);
            for value in [[0.005, 0.0], [2.0, 1.0]] {
                let contact = Contact::default().with(0, Some(value[0])).with(1, Some(value[1]));
                let taken = contact.applied(&given).unwrap();
                let own = taken.units()[0].physics;
                assert!(own.friction.max(own.restitution) <= 1e3, "{smooth}: {own:?}");
                let [friction, restitution] = [0, 1].map(|at| Contact::of(&taken).at(at).unwrap());
                let off = (friction - value[0]).abs().max((restitution - value[1]).abs());
                assert!(off < 1e-6, "{smooth}: {taken:?}");
            }
        }
    }

    #[test]
    fn a_factor_of_1_changes_no_inertia() {
        let given = scene(vec![Plane::ground(0.5, 0.5)]);
        let at = NUMBERS.iter().position(|number| number.name == "inertia_factor").unwrap();
        let contact = |factor: f32| Contact::default().with(at, Some(factor));
        assert_eq!(contact(1.0).applied(&given).unwrap(), given);
        let near = contact(1.0 + f32::EPSILON).applied(&given).unwrap();
        assert!(near.units()[0].inertia.is_some());
    }

    /// Round in 26 directions is not yet a ball.
    #[test]
    fn a_coarse_round_body_has_the_inertia_of_its_box() {
        let numbers = || [-1.0_f32, 0.0, 1.0].into_iter();
        let all = numbers()
            .flat_map(|x| numbers().flat_map(move |y| numbers().map(move |z| [x, y, z])))
            .map(Vector3::from);
        let points = all
            .filter(|along| along.norm() > 0.5)
            .map(|along| Point3::from(along.normalize() * 0.1));
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        let round =
            RecordedUnit::new("round", points.collect(), physics, vec![Isometry3::identity()]);
        // A cube of .2 m has 1 / 150, and the ball in it 1 / 250.
        let found = moments(&round);
        assert!(found.iter().all(|moment| (moment - 1.0 / 150.0).abs() < 1e-6), "{found:?}");
    }

    #[test]
    fn the_solver_s_directions_are_258() {
        let mut all: Vec<_> = directions().map(|along| along.data.0[0].map(|v| v as i32)).collect();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), 258);
        assert!(all.iter().all(|along| along.iter().map(|v| v.abs()).sum::<i32>() == LATTICE));
    }

    #[test]
    fn contact_gives_way_as_a_file_says() {
        let given = scene(vec![Plane::ground(0.5, 0.5)]);
        let rigid = Contact::of(&given);
        assert_eq!(rigid.get("stiffness_n_m"), Some(RIGID_N_M));
        // A corner carries .6 kg / 4 and sinks in by .1 mm.
        let begin = Contact::begin(&given);
        assert!((begin.get("stiffness_n_m").unwrap() / 14_715.0 - 1.0).abs() < 1e-4);
        assert!((begin.get("dissipation_s_m").unwrap() - 4.0 / 0.981_f32.sqrt()).abs() < 1e-4);
        assert_eq!(begin.get("friction"), rigid.get("friction"));
        let file = parse("stiffness_n_m = 2e4\ndissipation_s_m = 3").unwrap();
        let soft = file.applied(&given).unwrap();
        let [cube, shelf] = soft.units() else { panic!("two units") };
        let expected = Compliance { stiffness_n_m: 2e4, dissipation_s_m: 3.0 };
        assert_eq!((cube.compliance, shelf.compliance), (expected, Compliance::RIGID));
        assert_eq!(Contact::begin(&soft).get("stiffness_n_m"), Some(2e4));
        let back = parse("stiffness_n_m = 1e9\ndissipation_s_m = 0").unwrap();
        assert_eq!(back.applied(&soft).unwrap(), given);
    }

    #[test]
    fn a_search_begins_somewhere_without_gravity() {
        let given = scene(vec![Plane::ground(0.5, 0.5)]);
        let falls = Contact::begin(&given);
        let parts = Parts { gravity_m_s2: Vector3::zeros(), ..Parts::of(&given) };
        let begin = |name: &str| {
            let number = NUMBERS.iter().find(|number| number.name == name).unwrap();
            number.begin.unwrap()(&parts)
        };
        // A gravity of .1 m/s^2 in place of 9.81.
        let share = begin("stiffness_n_m") / falls.get("stiffness_n_m").unwrap();
        assert!((share * 98.1 - 1.0).abs() < 1e-4, "{share}");
        assert!((begin("dissipation_s_m") - 40.0).abs() < 1e-3);
    }

    #[test]
    fn a_ball_keeps_its_inertia() {
        let mut points = Vec::new();
        for i in 0..500 {
            let z = 1.0 - 2.0 * (i as f32 + 0.5) / 500.0;
            let (angle, ring) = (2.399_963_2 * i as f32, (1.0 - z * z).sqrt());
            points.push(Point3::new(ring * angle.cos(), ring * angle.sin(), z) * 0.1);
        }
        let physics = Physics { mass_kg: 1.0, friction: 0.4, restitution: 0.3 };
        let ball = RecordedUnit::new("ball", points, physics, vec![Isometry3::identity()]);
        assert!(
            moments(&ball).iter().all(|moment| (moment - 4e-3).abs() < 2e-4),
            "{:?}",
            moments(&ball)
        );
    }
}
