//! Classes of default attributes.

use std::collections::HashMap;

use crate::error::{Problem, RobotError};
use crate::xml::{Attribute, Element, is_orientation};

/// The class of elements that name none.
pub(super) const MAIN: &str = "main";
/// Elements that have classes here.
const TAGS: [&str; 3] = ["geom", "joint", "mesh"];
/// Attributes that are read of those: each class keeps what it inherits, and a file may make up any number of others.
const READ: [&str; 25] = [
    "axis",
    "axisangle",
    "conaffinity",
    "contype",
    "density",
    "euler",
    "friction",
    "fromto",
    "group",
    "inertia",
    "limited",
    "mass",
    "mesh",
    "pos",
    "quat",
    "range",
    "ref",
    "refpos",
    "refquat",
    "scale",
    "shellinertia",
    "size",
    "type",
    "xyaxes",
    "zaxis",
];
/// Classes of a file, at most: each keeps what it inherits.
const MOST_CLASSES: usize = 2000;

/// Bytes of a value, at most: each element of the class reads it again.
const MOST_VALUE: usize = 4096;

type Attributes = Vec<Attribute>;

/// Attributes by class and tag, with what classes inherit.
#[derive(Debug, Default)]
pub(super) struct Defaults {
    classes: HashMap<String, HashMap<&'static str, Attributes>>,
}

impl Defaults {
    pub(super) fn read(root: &Element) -> Result<Self, RobotError> {
        let mut own = Self::default();
        for element in root.all("default") {
            let class = element.get("class").unwrap_or(MAIN);
            // Several sections of the main class, of several files, are one.
            let above = own.classes.get(class).cloned().unwrap_or_default();
            own.add(element, class, above)?;
        }
        own.classes.entry(MAIN.into()).or_default();
        Ok(own)
    }

    fn add(
        &mut self,
        element: &Element,
        class: &str,
        mut inherited: HashMap<&'static str, Attributes>,
    ) -> Result<(), RobotError> {
        for tag in TAGS {
            for own in element.all(tag) {
                let attributes = inherited.entry(tag).or_default();
                if own.attributes().iter().any(is_orientation) {
                    attributes.retain(|known| !is_orientation(known));
                }
                for (name, value) in own.attributes() {
                    if !READ.contains(&&**name) {
                        continue;
                    }
                    if value.len() > MOST_VALUE {
                        let what = "a default of more than 4096 bytes";
                        let remedy = "give it to the elements themselves";
                        return Err(own.fail(Problem::Unsupported { what, remedy }));
                    }
                    attributes.retain(|(known, _)| known != name);
                    attributes.push((name.clone(), value.clone()));
                }
            }
        }
        self.classes.insert(class.to_owned(), inherited.clone());
        if self.classes.len() > MOST_CLASSES {
            return Err(
                element.fail(Problem::TooMany { what: "default classes", most: MOST_CLASSES })
            );
        }
        for child in element.all("default") {
            let name = child.need("class")?;
            if self.classes.contains_key(name) {
                return Err(child.fail(Problem::duplicate("default class", name)));
            }
            self.add(child, name, inherited.clone())?;
        }
        Ok(())
    }

    /// The element with the attributes of its class, else of the class around it.
    pub(super) fn filled(
        &self,
        element: &Element,
        tag: &str,
        around: &str,
    ) -> Result<Element, RobotError> {
        let class = element.get("class").unwrap_or(around);
        let found = self.classes.get(class);
        let found = found.ok_or_else(|| element.fail(Problem::unknown("default class", class)))?;
        Ok(element.filled(found.get(tag).map_or(&[], Vec::as_slice)))
    }
}
