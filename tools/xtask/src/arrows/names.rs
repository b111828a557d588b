//! What a path names: the item, and the file that defines it.

use std::collections::{BTreeSet, HashSet};

use super::tree::{Import, Tree};

/// What a name stands for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Target {
    /// A module.
    Module(usize),
    /// An item of a module. Where the module is known and the item is not (a macro makes it, say), the
    /// name as the path says it.
    Item { module: usize, name: String },
    /// Something of another crate.
    Outside,
}

/// Imports that are being followed: the module, the number of its import, and the name. An import that leads back to itself
/// stands for nothing. Other meanings of the same name count: `pub use walk::walk` finds `walk` in the module `walk`.
type Open = HashSet<(usize, usize, String)>;

/// What `path` stands for inside `module`; several where a name is an item and a module, or has
/// one definition a target.
pub(crate) fn resolve(tree: &Tree, module: usize, path: &[String]) -> BTreeSet<Target> {
    follow(tree, module, path, &mut Open::new())
}

/// What `name` stands for inside `module`.
pub(crate) fn lookup(tree: &Tree, module: usize, name: &str) -> BTreeSet<Target> {
    find(tree, module, name, &mut Open::new())
}

fn follow(tree: &Tree, module: usize, path: &[String], open: &mut Open) -> BTreeSet<Target> {
    let Some((first, mut rest)) = path.split_first() else { return BTreeSet::new() };
    let mut found = match first.as_str() {
        "crate" => BTreeSet::from([Target::Module(tree.root(module))]),
        "self" => BTreeSet::from([Target::Module(module)]),
        "super" => {
            let mut above = tree.module(module).parent;
            while let Some(("super", more)) =
                rest.split_first().map(|(first, m)| (first.as_str(), m))
            {
                above = above.and_then(|module| tree.module(module).parent);
                rest = more;
            }
            above.map(Target::Module).into_iter().collect()
        }
        name => {
            let here = find(tree, module, name, open);
            if here.is_empty() { outside(tree, name) } else { here }
        }
    };
    for name in rest {
        let inside = |target| match target {
            Target::Module(module) => {
                let found = find(tree, module, name, open);
                if found.is_empty() {
                    BTreeSet::from([Target::Item { module, name: name.clone() }])
                } else {
                    found
                }
            }
            // Variants, constants and functions of a type belong to the type.
            target => BTreeSet::from([target]),
        };
        found = found.into_iter().flat_map(inside).collect();
    }
    found
}

fn outside(tree: &Tree, name: &str) -> BTreeSet<Target> {
    BTreeSet::from([tree.library(name).map_or(Target::Outside, Target::Module)])
}

fn find(tree: &Tree, module: usize, name: &str, open: &mut Open) -> BTreeSet<Target> {
    let here = tree.module(module);
    let mut found = BTreeSet::new();
    if here.defines.contains(name) {
        found.insert(Target::Item { module, name: name.into() });
    }
    found.extend(here.children.get(name).into_iter().flatten().map(|child| Target::Module(*child)));
    let named = |import: &Import| import.name.as_deref() == Some(name);
    for (number, import) in here.imports.iter().enumerate().filter(|(_, import)| named(import)) {
        let key = (module, number, name.to_string());
        if open.insert(key.clone()) {
            found.extend(follow(tree, module, &import.path, open));
            open.remove(&key);
        }
    }
    if found.is_empty() {
        let globs = here.imports.iter().enumerate().filter(|(_, import)| import.name.is_none());
        for (number, import) in globs {
            let key = (module, number, name.to_string());
            if !open.insert(key.clone()) {
                continue;
            }
            for target in follow(tree, module, &import.path, open) {
                if let Target::Module(all) = target {
                    found.extend(find(tree, all, name, open));
                }
            }
            open.remove(&key);
        }
    }
    found
}
