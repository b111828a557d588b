//! Classes of default attributes.

use std::collections::HashMap;

use crate::error::{Problem, RobotError};
use crate::xml::Element;

/// The class of elements that name none.
pub(super) const MAIN: &str = "main";
/// Elements that have classes here.
const TAGS: [&str; 3] = ["geom", "joint", "mesh"];
/// Classes of a file, at most: each keeps what it inherits.
const MOST_CLASSES: usize = 2000;

type Attributes = Vec<(String, String)>;

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
                for (name, value) in own.attributes() {
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
