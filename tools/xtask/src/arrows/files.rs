//! The files of a crate, and which of them uses which.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};

use super::circles::Graph;
use super::tree::{Read, Tree};
use super::uses::{Places, uses};

pub(crate) struct Files {
    tree: Tree,
    uses: BTreeMap<(usize, usize), Places>,
    graph: Graph,
}

impl Files {
    /// Those of the crate in `folder`: its library, then its programs, by cargo's conventions.
    pub(crate) fn open(folder: &str) -> Result<Self> {
        let manifest = Path::new(folder).join("Cargo.toml");
        let text = fs::read_to_string(&manifest)
            .with_context(|| format!("cannot read {}", manifest.display()))?;
        let table: toml::Table = text.parse()?;
        let name = table
            .get("package")
            .and_then(|package| package.get("name"))
            .and_then(|name| name.as_str())
            .with_context(|| format!("{} has no package.name", manifest.display()))?;
        let source = Path::new(folder).join("src");
        let mut programs = Vec::new();
        if let Ok(entries) = fs::read_dir(source.join("bin")) {
            for entry in entries {
                programs.push(entry?.path());
            }
        }
        programs.retain(|program| program.extension().is_some_and(|extension| extension == "rs"));
        programs.sort();
        let mut roots = vec![source.join("lib.rs"), source.join("main.rs")];
        roots.retain(|root| root.is_file());
        roots.extend(programs);
        Self::read(&name.replace('-', "_"), &roots, &from_disk)
    }

    /// `library` is the name by which programs call the library.
    pub(crate) fn read(library: &str, roots: &[PathBuf], read: Read<'_>) -> Result<Self> {
        let tree = Tree::read(library, roots, read)?;
        let uses = uses(&tree);
        let graph = Graph::new(tree.files.len(), uses.keys().copied());
        Ok(Self { tree, uses, graph })
    }

    pub(crate) fn len(&self) -> usize {
        self.tree.files.len()
    }

    fn name(&self, file: usize) -> String {
        self.tree.files[file].display().to_string()
    }

    /// The file's name below `src`.
    fn short(&self, file: usize) -> String {
        let name = self.name(file);
        name.split_once("src/").map(|(_, below)| below.into()).unwrap_or(name)
    }

    /// The first line of `from` that names an item of `to`.
    fn place(&self, from: usize, to: usize) -> String {
        let (line, item) = match self.uses.get(&(from, to)).and_then(BTreeSet::first) {
            Some((line, item)) => (*line, item.as_str()),
            None => (0, "nothing"),
        };
        format!("{}:{line} uses {item} of {}", self.name(from), self.name(to))
    }

    /// Every group of files that need each other, each with its shortest circle.
    pub(crate) fn circles(&self) -> Vec<String> {
        let fault = |group: &Vec<usize>| {
            let names: Vec<String> = group.iter().map(|file| self.name(*file)).collect();
            let circle = self.graph.shortest(group);
            let next = circle.iter().cycle().skip(1);
            let places = circle.iter().zip(next).map(|(from, to)| self.place(*from, *to));
            let places = places.map(|place| format!("\n    {place}")).collect::<String>();
            format!("{} files in a circle: {}{places}", group.len(), names.join(" "))
        };
        self.graph.circles().iter().map(fault).collect()
    }

    /// Every use of one of the modules by another of them. Files below a module belong to it. Those in `planned` may
    /// be missing.
    pub(crate) fn strangers(&self, present: &[&str], planned: &[&str]) -> Vec<String> {
        let modules = [present, planned].concat();
        let mut of_file: BTreeMap<usize, &str> = BTreeMap::new();
        for index in 0..self.tree.modules.len() {
            let names = self.tree.ancestors(index).map(|index| &self.tree.module(index).name);
            let names: BTreeSet<&str> = names.map(String::as_str).collect();
            if let Some(module) = modules.iter().find(|module| names.contains(**module)) {
                of_file.insert(self.tree.module(index).file, module);
            }
        }
        let mut faults: Vec<String> = present
            .iter()
            .filter(|module| !of_file.values().any(|known| known == *module))
            .map(|module| {
                format!("there is no module {module} any more; name its successor in the rule")
            })
            .collect();
        for (from, to) in self.uses.keys() {
            let (a, b) = (of_file.get(from), of_file.get(to));
            if let Some((a, b)) = a.zip(b).filter(|(a, b)| a != b) {
                let place = self.place(*from, *to);
                faults.push(format!("{place}, and {a} and {b} must not use each other"));
            }
        }
        faults
    }

    /// A line for each layer, lowest first: a file uses files of lower layers alone. Files of a circle stand
    /// in brackets, and their uses of each other below.
    pub(crate) fn layers(&self) -> Vec<String> {
        let below = |group: &[usize]| -> Vec<String> {
            let inside =
                self.uses.keys().filter(|(from, to)| group.contains(from) && group.contains(to));
            let all = |(from, to): &(usize, usize)| {
                let items: BTreeSet<&str> =
                    self.uses[&(*from, *to)].iter().map(|(_, item)| item.as_str()).collect();
                let items = items.into_iter().collect::<Vec<_>>().join(", ");
                format!("        {} uses {items} of {}", self.short(*from), self.short(*to))
            };
            inside.map(all).collect()
        };
        let mut lines = Vec::new();
        for (height, layer) in self.graph.layers().iter().enumerate() {
            let names = layer.iter().map(|group| {
                let names: Vec<String> = group.iter().map(|file| self.short(*file)).collect();
                let names = names.join(" ");
                if group.len() > 1 { format!("[{names}]") } else { names }
            });
            lines.push(format!("  {height:>2}  {}", names.collect::<Vec<_>>().join(" ")));
            lines.extend(
                layer.iter().filter(|group| group.len() > 1).flat_map(|group| below(group)),
            );
        }
        lines
    }
}

fn from_disk(path: &Path) -> Result<Option<String>> {
    match fs::read_to_string(path) {
        Ok(source) => Ok(Some(source)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(anyhow!(error).context(format!("cannot read {}", path.display()))),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// A library of these files, whose programs call it `house`.
    fn files(files: &[(&str, &str)]) -> Files {
        let files: BTreeMap<PathBuf, String> =
            files.iter().map(|(path, source)| (path.into(), source.to_string())).collect();
        let read = |path: &Path| Ok(files.get(path).cloned());
        let mut roots = vec![PathBuf::from("src/lib.rs")];
        roots.extend(files.keys().filter(|path| path.starts_with("src/bin")).cloned());
        Files::read("house", &roots, &read).unwrap()
    }

    /// Every arrow, by the names of files below `src`: `a.rs > b.rs: LINE ITEM, ..`
    fn arrows(sources: &[(&str, &str)]) -> Vec<String> {
        let files = files(sources);
        let arrow = |((from, to), places): (&(usize, usize), &Places)| {
            let places = places.iter().map(|(line, item)| format!("{line} {item}"));
            let places = places.collect::<Vec<_>>().join(", ");
            format!("{} > {}: {places}", files.short(*from), files.short(*to))
        };
        files.uses.iter().map(arrow).collect()
    }

    #[test]
    fn a_re_export_leads_to_the_file_that_defines_the_item() {
        let root = ("src/lib.rs", "mod a;\nmod shapes;\npub use shapes::Square;");
        let shapes = (
            "src/shapes/mod.rs",
            "mod flat;\npub(crate) use flat::{Square, area as size};\npub(crate) use flat::sides;",
        );
        let flat =
            ("src/shapes/flat.rs", "pub struct Square;\npub fn area() {}\npub fn sides() {}");
        let a = (
            "src/a.rs",
            "use crate::Square;\nuse crate::shapes::size;\nfn f() { super::shapes::sides(); }",
        );
        assert_eq!(
            arrows(&[root, shapes, flat, a]),
            ["a.rs > shapes/flat.rs: 1 Square, 2 area, 3 sides"]
        );
    }

    #[test]
    fn a_re_export_of_what_is_called_as_its_module_is_followed() {
        let root = ("src/lib.rs", "mod drive;\nmod picture;");
        let picture = ("src/picture.rs", "mod walk;\npub(crate) use walk::walk;");
        let walk = ("src/picture/walk.rs", "use crate::drive::Drive;\npub fn walk(_: Drive) {}");
        let drive = (
            "src/drive.rs",
            "use crate::picture;\npub struct Drive;\nfn f() { picture::walk(Drive) }",
        );
        let sources = [root, picture, walk, drive];
        assert_eq!(
            arrows(&sources),
            ["drive.rs > picture/walk.rs: 3 walk", "picture/walk.rs > drive.rs: 1 Drive, 2 Drive"]
        );
        assert_eq!(files(&sources).circles().len(), 1);
    }

    #[test]
    fn imports_that_lead_back_to_themselves_end() {
        let root = ("src/lib.rs", "mod a;\nmod b;\npub use b::*;");
        let a = (
            "src/a.rs",
            "pub use crate::b::*;\nuse crate::b::again as again;\nfn f() { again(); g() }",
        );
        let b = ("src/b.rs", "pub use crate::a::*;\npub use crate::a::again;\npub fn g() {}");
        assert_eq!(arrows(&[root, a, b]), ["a.rs > b.rs: 2 again, 3 g", "b.rs > a.rs: 2 again"]);
    }

    #[test]
    fn a_re_export_of_a_stranger_and_a_private_use_are_arrows() {
        let root = ("src/lib.rs", "mod a;\nmod b;\nuse b::B;");
        let a = ("src/a.rs", "pub use crate::b::B;");
        assert_eq!(
            arrows(&[root, a, ("src/b.rs", "pub struct B;")]),
            ["lib.rs > b.rs: 3 B", "a.rs > b.rs: 1 B"]
        );
    }

    #[test]
    fn names_come_through_globs_aliases_and_modules() {
        let root = ("src/lib.rs", "mod a;\nmod b;\nmod c;");
        let a = (
            "src/a.rs",
            "use super::b::*;\nuse super::b as letters;\nuse crate::c::{self, Far as Near};\n\
             fn f(x: First) -> Near { letters::second(); c::Far::new(x) }",
        );
        let b = ("src/b.rs", "pub struct First;\npub fn second() {}");
        let c = ("src/c.rs", "pub struct Far;\nimpl Far { pub fn new() {} }");
        assert_eq!(
            arrows(&[root, a, b, c]),
            ["a.rs > b.rs: 4 First, 4 second", "a.rs > c.rs: 3 Far, 4 Far"]
        );
    }

    #[test]
    fn super_self_and_inline_modules_belong_to_their_file() {
        let root = ("src/lib.rs", "mod a;\npub const ROOM: usize = 1;");
        let a = (
            "src/a.rs",
            "mod below;\nmod inline {\n  pub fn g() { super::super::ROOM; self::h() }\n  fn h() {}\n}\n\
             fn f() { inline::g(); self::below::BELOW }",
        );
        let below = (
            "src/a/below.rs",
            "pub const BELOW: () = ();\nconst HERE: usize = super::super::ROOM;",
        );
        assert_eq!(
            arrows(&[root, a, below]),
            ["a.rs > lib.rs: 3 ROOM", "a.rs > a/below.rs: 6 BELOW", "a/below.rs > lib.rs: 2 ROOM"]
        );
    }

    #[test]
    fn where_only_the_module_is_known_the_module_counts() {
        let root = ("src/lib.rs", "mod a;\nmod b;");
        let b = ("src/b.rs", "make! { struct Made; }");
        let a = ("src/a.rs", "use crate::b::Made;\nuse other::Thing;\nfn f() { unknown::g() }");
        assert_eq!(arrows(&[root, a, b]), ["a.rs > b.rs: 1 Made"]);
    }

    #[test]
    fn tests_documents_attributes_and_variables_are_no_arrows() {
        let root = ("src/lib.rs", "mod a;\npub fn room() {}\npub fn area() {}\npub struct Wide;");
        let a = (
            "src/a.rs",
            "//! [`crate::room`]\n\
             use super::*;\n\
             /// As [`crate::room`].\n\
             #[doc = \"crate::room\"]\n\
             fn f(area: usize) -> usize { let room = area; room }\n\
             fn g<Wide>(w: Wide) { if let Some(room) = w { room } for area in 0..1 { area } }\n\
             fn h() { match 1 { room => room, } || |area| area; fn room() {} room() }\n\
             #[cfg(test)]\nmod tests { use crate::room; }\n\
             #[cfg(all(test, unix))]\nfn t() { crate::room() }\n\
             impl f { #[cfg(test)] fn t() { crate::room() } }\n\
             pub(in crate::a) fn p() {}",
        );
        assert_eq!(arrows(&[root, a]), [""; 0]);
        let calls = ("src/a.rs", "use super::*;\nfn f() { let room = room(); area(room) }");
        assert_eq!(arrows(&[root, calls]), ["a.rs > lib.rs: 2 area, 2 room"]);
    }

    #[test]
    fn macros_are_searched_for_paths() {
        let root = ("src/lib.rs", "mod a;\nmod b;");
        let b = (
            "src/b.rs",
            "pub const ONE: u8 = 1;\npub const TWO: u8 = 2;\npub fn three() {}\npub struct Four;",
        );
        let a = (
            "src/a.rs",
            "use crate::b;\nfn f() {\n assert_eq!(b::ONE, x.TWO);\n}\n\
             macro_rules! m { ($b:ident) => { $crate::b::TWO + $b::ONE }; }\n\
             many! { [a => super::b::three; 1], b : Four }",
        );
        assert_eq!(arrows(&[root, a, b]), ["a.rs > b.rs: 3 ONE, 5 TWO, 6 three"]);
    }

    #[test]
    fn names_of_a_block_stay_in_it() {
        let root = ("src/lib.rs", "mod a;\nmod b;");
        let b = ("src/b.rs", "pub enum Kind { One }\npub fn g() {}");
        let a = (
            "src/a.rs",
            "fn f() { use crate::b::{Kind::*, g as other}; match k { One => other() } }\nfn h() { other() }",
        );
        assert_eq!(arrows(&[root, a, b]), ["a.rs > b.rs: 1 Kind, 1 g"]);
    }

    #[test]
    fn files_are_found_where_the_compiler_finds_them() {
        let root =
            ("src/lib.rs", "#[path = \"deep/../odd.rs\"] mod a;\nmod inline { mod b; }\nmod c;");
        let odd = ("src/odd.rs", "mod beside;\nfn f() { beside::B }");
        let beside = ("src/beside.rs", "pub struct B;");
        let b = ("src/inline/b.rs", "fn f() { crate::c::C }");
        let c = ("src/c/mod.rs", "pub struct C;");
        let program = (
            "src/bin/run.rs",
            "#[path = \"../beside.rs\"] mod same;\nuse house::a;\nfn main() { same::B; crate::same::B; a::f() }",
        );
        assert_eq!(
            arrows(&[root, odd, beside, b, c, program]),
            [
                "odd.rs > beside.rs: 2 B",
                "inline/b.rs > c/mod.rs: 1 C",
                "bin/run.rs > odd.rs: 3 f",
                "bin/run.rs > beside.rs: 3 B"
            ]
        );
    }

    #[test]
    fn a_missing_file_is_named() {
        let read = |path: &Path| Ok((path == "src/lib.rs").then(|| "mod gone;".to_string()));
        let error = Files::read("house", &["src/lib.rs".into()], &read).err().unwrap();
        assert_eq!(
            error.to_string(),
            "src/lib.rs declares `mod gone`, and there is no src/gone/mod.rs"
        );
    }

    #[test]
    fn circles_are_named_with_their_lines() {
        let sources = [
            ("src/lib.rs", "mod a;\nmod b;\nmod c;\nmod d;"),
            ("src/a.rs", "use crate::b::B;\npub struct A;"),
            ("src/b.rs", "\npub struct B(crate::c::C);"),
            ("src/c.rs", "pub struct C;\n\nuse super::a::A;\nuse crate::b::B;"),
            ("src/d.rs", "use crate::a::A;"),
        ];
        assert_eq!(
            files(&sources).circles(),
            ["3 files in a circle: src/a.rs src/b.rs src/c.rs\n    \
              src/b.rs:2 uses C of src/c.rs\n    \
              src/c.rs:4 uses B of src/b.rs"]
        );
        assert_eq!(
            files(&sources).layers(),
            [
                "   0  lib.rs [a.rs b.rs c.rs]",
                "        a.rs uses B of b.rs",
                "        b.rs uses C of c.rs",
                "        c.rs uses A of a.rs",
                "        c.rs uses B of b.rs",
                "   1  d.rs"
            ]
        );
        let [root, a, b, _, d] = sources;
        assert_eq!(files(&[root, a, b, ("src/c.rs", "pub struct C;"), d]).circles(), [""; 0]);
    }

    #[test]
    fn strangers_are_named() {
        let sources = [
            ("src/lib.rs", "mod blocks;\nmod motion;\nmod other;"),
            ("src/blocks/mod.rs", "pub mod encoder;"),
            ("src/blocks/encoder.rs", "pub mod part;\npub fn f() { crate::other::f() }"),
            ("src/blocks/encoder/part.rs", "use super::f;\nuse crate::motion::advance;"),
            ("src/motion.rs", "pub fn advance() {}\nfn f() { crate::other::f() }"),
            ("src/other.rs", "pub fn f() {}"),
        ];
        let files = files(&sources);
        assert_eq!(
            files.strangers(&["encoder", "motion"], &["blend"]),
            [
                "src/blocks/encoder/part.rs:2 uses advance of src/motion.rs, and encoder and motion must \
              not use each other"
            ]
        );
        assert_eq!(
            files.strangers(&["encoder", "anchors"], &[]),
            ["there is no module anchors any more; name its successor in the rule"]
        );
    }
}
