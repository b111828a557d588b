//! Elements of a file that know their lines. Files are hostile: no entities, bounded sizes and depths.

use std::collections::HashSet;
use std::path::Path;
use std::rc::Rc;

use rigidformer_runtime::files::{self, shown};
use roxmltree::{Document, Node, ParsingOptions, TextPos};

use crate::error::{Problem, RobotError, SHOWN};

/// Bytes of a robot's file, at most: descriptions are text by hand or from macros, and meshes are files of their own.
const MOST_BYTES: usize = 32 << 20;
/// Nodes of a file, at most.
const MOST_NODES: u32 = 2_000_000;
/// Elements within each other, at most: readers walk them by recursion.
pub(crate) const MOST_DEPTH: usize = 300;
/// Attributes of an element, at most: roxmltree compares each with those before it.
const MOST_ATTRIBUTES: usize = 64;
/// Names of namespaces in a file, at most: roxmltree copies those of an element to each within that has one of its own.
const MOST_NAMESPACES: usize = 16;
/// Bytes of an element's text that is kept: Gazebo's numbers.
const MOST_TEXT: usize = 64;
/// Bytes of the name of a namespace, at most.
const MOST_NAME: usize = 128;

/// An attribute's name and value, which copies of its element share.
pub(crate) type Attribute = (Rc<str>, Rc<str>);

/// Ways to say how an element is turned: one of them stands for all.
const ORIENTATIONS: [&str; 5] = ["quat", "axisangle", "euler", "xyaxes", "zaxis"];

/// Whether an attribute says how its element is turned.
pub(crate) fn is_orientation((name, _): &Attribute) -> bool {
    ORIENTATIONS.contains(&&**name)
}

/// An element, without its text and comments.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub(crate) tag: String,
    attributes: Vec<Attribute>,
    pub(crate) children: Vec<Element>,
    /// Its first text, where that is short.
    text: Option<String>,
    line: u32,
    /// The file that it is in.
    pub(crate) file: Rc<Path>,
}

/// Reads a file's root element.
pub(crate) fn read(path: &Path) -> Result<Element, RobotError> {
    let bytes = files::read_whole(path)?;
    parse(path, &bytes)
}

/// The root element of a file's bytes.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Element, RobotError> {
    let fail = |line: u32, problem: String| RobotError::Element {
        path: path.into(),
        line,
        element: "the file".into(),
        problem: Box::new(Problem::Xml(shown(&problem, SHOWN))),
    };
    if bytes.len() > MOST_BYTES {
        return Err(fail(0, format!("it has more than {MOST_BYTES} bytes")));
    }
    // Some programs write the zero that ends a text in C.
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let text = std::str::from_utf8(bytes.get(..end).unwrap_or_default());
    let text = text.map_err(|_| fail(0, "it is not UTF-8".into()))?;
    check(text).map_err(|problem| fail(0, problem.into()))?;
    let options =
        ParsingOptions { allow_dtd: false, nodes_limit: MOST_NODES, ..ParsingOptions::default() };
    let trimmed = text.trim_start_matches('\u{feff}').trim_start();
    // Lines before the first element that trimming took.
    let taken = text.get(..text.len() - trimmed.len()).unwrap_or_default();
    let before = taken.matches('\n').count() as u32;
    let document = Document::parse_with_options(trimmed, options)
        .map_err(|error| fail(before + error.pos().row, placed(&error, before)))?;
    // The tree's own search for a line starts at the beginning each time.
    let text = document.input_text();
    let ends: Vec<usize> = text.match_indices('\n').map(|(at, _)| at).collect();
    let line = |node: &Node<'_, '_>| {
        before + 1 + ends.partition_point(|end| *end < node.range().start) as u32
    };
    let file: Rc<Path> = path.into();
    element(document.root_element(), &file, &line, 0)
        .map_err(|at| fail(at, "its elements are within each other too deeply".into()))
}

/// What is wrong, with the line of the file: roxmltree counts from where it began.
fn placed(error: &roxmltree::Error, before: u32) -> String {
    let place = error.pos();
    let own = TextPos::new(before + place.row, place.col);
    error.to_string().replacen(&place.to_string(), &own.to_string(), 1)
}

/// Refuses what roxmltree takes the square of its length for.
fn check(text: &str) -> Result<(), &'static str> {
    // No value of an attribute has a `<`, and a comment has no attributes.
    for tag in text.split('<').filter(|tag| !tag.starts_with(['!', '?', '/'])) {
        let values = tag.split('=').skip(1);
        let quoted = values.filter(|value| value.trim_start().starts_with(['"', '\'']));
        if quoted.take(MOST_ATTRIBUTES + 1).count() > MOST_ATTRIBUTES {
            return Err("an element has too many attributes");
        }
    }
    let mut names = HashSet::new();
    for (at, _) in text.match_indices("xmlns") {
        let rest = text.as_bytes().get(at..).unwrap_or_default();
        let is_name = |byte: &&u8| **byte != b'=' && !byte.is_ascii_whitespace();
        let name: Vec<u8> = rest.iter().take(MOST_NAME).take_while(is_name).copied().collect();
        if name.len() == MOST_NAME || (names.insert(name) && names.len() > MOST_NAMESPACES) {
            return Err("it names too many namespaces, or one too long");
        }
    }
    Ok(())
}

fn element(
    node: Node<'_, '_>,
    file: &Rc<Path>,
    line: &impl Fn(&Node<'_, '_>) -> u32,
    depth: usize,
) -> Result<Element, u32> {
    let own = line(&node);
    if depth > MOST_DEPTH {
        return Err(own);
    }
    let attributes = node.attributes().map(|a| (a.name().into(), a.value().into()));
    let children = node.children().filter(Node::is_element);
    Ok(Element {
        tag: node.tag_name().name().to_owned(),
        attributes: attributes.collect(),
        text: node
            .text()
            .map(str::trim)
            .filter(|text| (1..=MOST_TEXT).contains(&text.len()))
            .map(str::to_owned),
        children: children
            .map(|child| element(child, file, line, depth + 1))
            .collect::<Result<_, _>>()?,
        line: own,
        file: file.clone(),
    })
}

impl Element {
    /// Its text, where there is some.
    pub(crate) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(own, _)| **own == *name).map(|(_, value)| &**value)
    }

    /// The first child of that tag.
    pub(crate) fn child(&self, tag: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.tag == tag)
    }

    /// All children of that tag.
    pub(crate) fn all<'e>(&'e self, tag: &'static str) -> impl Iterator<Item = &'e Element> {
        self.children.iter().filter(move |child| child.tag == tag)
    }

    /// An error about it.
    pub(crate) fn fail(&self, problem: Problem) -> RobotError {
        let name = self
            .get("name")
            .or(self.get("file"))
            .map(|name| format!(" \"{}\"", shown(name, SHOWN)));
        RobotError::Element {
            path: self.file.to_path_buf(),
            line: self.line,
            element: format!("{}{}", shown(&self.tag, SHOWN), name.unwrap_or_default()),
            problem: Box::new(problem),
        }
    }

    /// The number that its text is.
    pub(crate) fn text_number(&self) -> Option<f64> {
        numbers::<1>(self.text.as_deref()?).map(|[number]| number)
    }

    /// Its attributes, with these where it has none of the name; its own orientation replaces any other. Without children.
    pub(crate) fn filled(&self, defaults: &[Attribute]) -> Element {
        let is_turned = self.attributes.iter().any(is_orientation);
        let own = |more: &Attribute| {
            (is_turned && is_orientation(more))
                || self.attributes.iter().any(|(known, _)| *known == more.0)
        };
        let more = defaults.iter().filter(|more| !own(more)).cloned();
        Element {
            tag: self.tag.clone(),
            attributes: self.attributes.iter().cloned().chain(more).collect(),
            children: Vec::new(),
            text: None,
            line: self.line,
            file: self.file.clone(),
        }
    }

    /// All its attributes.
    pub(crate) fn attributes(&self) -> &[Attribute] {
        &self.attributes
    }

    /// An attribute that must be there.
    pub(crate) fn need(&self, name: &'static str) -> Result<&str, RobotError> {
        self.get(name).ok_or_else(|| self.fail(Problem::Missing(name)))
    }

    /// A finite number, where there is one.
    pub(crate) fn number(&self, name: &str) -> Result<Option<f64>, RobotError> {
        Ok(self.numbers::<1>(name)?.map(|[number]| number))
    }

    /// At most so many finite numbers, where there are some.
    pub(crate) fn up_to<const N: usize>(&self, name: &str) -> Result<Option<Vec<f64>>, RobotError> {
        let read = |text| some_numbers(text, N).ok_or_else(|| self.fail(bad::<N>(name, text)));
        self.get(name).map(read).transpose()
    }

    /// A word of two or more.
    pub(crate) fn word<T: Copy>(
        &self,
        name: &'static str,
        known: &[(&str, T)],
        expected: &'static str,
    ) -> Result<Option<T>, RobotError> {
        let Some(text) = self.get(name) else { return Ok(None) };
        let found = known.iter().find(|(word, _)| *word == text);
        found
            .map(|(_, value)| Some(*value))
            .ok_or_else(|| self.fail(Problem::word(name, text, expected)))
    }

    /// Whether it says "true".
    pub(crate) fn flag(&self, name: &'static str) -> Result<Option<bool>, RobotError> {
        self.word(name, &[("true", true), ("false", false)], "true or false")
    }

    /// So many finite numbers, where there are some.
    pub(crate) fn numbers<const N: usize>(
        &self,
        name: &str,
    ) -> Result<Option<[f64; N]>, RobotError> {
        self.get(name)
            .map(|text| numbers(text).ok_or_else(|| self.fail(bad::<N>(name, text))))
            .transpose()
    }
}

/// What is wrong with text that is not so many numbers.
pub(crate) fn bad<const N: usize>(name: &str, text: &str) -> Problem {
    let expected = match N {
        1 => "a finite number",
        2 => "two finite numbers",
        3 => "three finite numbers",
        4 => "four finite numbers",
        _ => "as many finite numbers as it takes",
    };
    Problem::Number { attribute: name.to_owned(), found: shown(text, SHOWN), expected }
}

/// Exactly so many finite numbers.
pub(crate) fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let found = some_numbers(text, N)?;
    <[f64; N]>::try_from(found).ok()
}

/// Finite numbers, at most so many.
pub(crate) fn some_numbers(text: &str, most: usize) -> Option<Vec<f64>> {
    let mut found = Vec::new();
    for word in text.split_ascii_whitespace() {
        let number: f64 = word.parse().ok()?;
        // Larger ones square to no number.
        if number.is_nan() || number.abs() > MOST || found.len() == most {
            return None;
        }
        found.push(number);
    }
    Some(found)
}

/// Numbers of a file, at most.
pub(crate) const MOST: f64 = 1e30;
