//! The modules of a crate, read from its files: what each defines, imports and contains.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, bail};
use syn::{Attribute, Expr, ForeignItem, Item, ItemMod, Lit, Meta, UseTree, Visibility};

/// Reads a file; none where there is no such file.
pub(crate) type Read<'r> = &'r dyn Fn(&Path) -> Result<Option<String>>;

/// The modules of a library and of the programs beside it.
#[derive(Default)]
pub(crate) struct Tree {
    /// Files, by their path. A file that several modules name is here once.
    pub(crate) files: Vec<PathBuf>,
    pub(crate) modules: Vec<Module>,
    /// The name by which programs call the library, and its root.
    library: Option<(String, usize)>,
}

pub(crate) struct Module {
    pub(crate) name: String,
    /// Index of its file. Modules inside a file belong to that file.
    pub(crate) file: usize,
    pub(crate) parent: Option<usize>,
    pub(crate) children: BTreeMap<String, Vec<usize>>,
    /// Names of the items that it defines.
    pub(crate) defines: BTreeSet<String>,
    pub(crate) imports: Vec<Import>,
    /// Without modules, imports and what is for tests alone.
    pub(crate) items: Vec<Item>,
}

/// One name of a `use`, or one `*`.
pub(crate) struct Import {
    pub(crate) path: Vec<String>,
    /// The name here; none for `*`.
    pub(crate) name: Option<String>,
    pub(crate) line: usize,
    pub(crate) re_export: bool,
}

/// Where a module's child modules lie.
struct Place {
    /// The folder of the file, which `#[path]` starts from outside inline modules.
    file: PathBuf,
    /// The folder of the children.
    children: PathBuf,
    inline: bool,
}

impl Tree {
    /// Reads the library first, then the programs. `name` is what programs call the library.
    pub(crate) fn read(name: &str, roots: &[PathBuf], read: Read<'_>) -> Result<Self> {
        let mut tree = Self::default();
        for root in roots {
            let source = read(root)?.with_context(|| format!("no file {}", root.display()))?;
            let folder = folder(root);
            let module = tree.file(root, &source, "crate", None, &folder, read)?;
            if root.ends_with("lib.rs") {
                tree.library = Some((name.to_string(), module));
            }
        }
        Ok(tree)
    }

    pub(crate) fn library(&self, name: &str) -> Option<usize> {
        self.library.as_ref().filter(|(library, _)| library == name).map(|(_, root)| *root)
    }

    pub(crate) fn module(&self, index: usize) -> &Module {
        &self.modules[index]
    }

    pub(crate) fn root(&self, module: usize) -> usize {
        self.ancestors(module).last().unwrap_or(module)
    }

    /// The module, its parent and so on.
    pub(crate) fn ancestors(&self, module: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(module), |module| self.module(*module).parent)
    }

    fn file(
        &mut self,
        path: &Path,
        source: &str,
        name: &str,
        parent: Option<usize>,
        children: &Path,
        read: Read<'_>,
    ) -> Result<usize> {
        let parsed =
            syn::parse_file(source).with_context(|| format!("cannot parse {}", path.display()))?;
        let file = self.files.iter().position(|known| known == path).unwrap_or_else(|| {
            self.files.push(path.into());
            self.files.len() - 1
        });
        let place = Place { file: folder(path), children: children.into(), inline: false };
        self.contents(file, name, parent, parsed.items, &place, read)
    }

    fn contents(
        &mut self,
        file: usize,
        name: &str,
        parent: Option<usize>,
        items: Vec<Item>,
        place: &Place,
        read: Read<'_>,
    ) -> Result<usize> {
        let index = self.modules.len();
        self.modules.push(Module {
            name: name.into(),
            file,
            parent,
            children: BTreeMap::new(),
            defines: BTreeSet::new(),
            imports: Vec::new(),
            items: Vec::new(),
        });
        for item in items.into_iter().filter(|item| !for_tests(attributes(item))) {
            match item {
                Item::Mod(child) => {
                    let name = plain(&child.ident);
                    let child = self.child(index, file, &name, child, place, read)?;
                    self.modules[index].children.entry(name).or_default().push(child);
                }
                Item::Use(item) => {
                    let re_export = !matches!(item.vis, Visibility::Inherited);
                    self.modules[index].imports.extend(imports(
                        &item.tree,
                        item.leading_colon.is_some(),
                        re_export,
                    ));
                }
                item => {
                    self.modules[index].defines.extend(defined(&item));
                    self.modules[index].items.push(item);
                }
            }
        }
        Ok(index)
    }

    fn child(
        &mut self,
        parent: usize,
        file: usize,
        name: &str,
        child: ItemMod,
        place: &Place,
        read: Read<'_>,
    ) -> Result<usize> {
        let below = place.children.join(name);
        if let Some((_, items)) = child.content {
            let place = Place { file: place.file.clone(), children: below, inline: true };
            return self.contents(file, name, Some(parent), items, &place, read);
        }
        if let Some(given) = path_attribute(&child.attrs) {
            let from = if place.inline { &place.children } else { &place.file };
            let path = normal(&from.join(given));
            let source = self.source(parent, name, &path, read)?;
            // The children of such a file lie beside it.
            return self.file(&path, &source, name, Some(parent), &folder(&path), read);
        }
        let (beside, inside) = (below.with_extension("rs"), below.join("mod.rs"));
        let path = if read(&beside)?.is_some() { beside } else { inside };
        let source = self.source(parent, name, &path, read)?;
        self.file(&path, &source, name, Some(parent), &below, read)
    }

    fn source(&self, parent: usize, name: &str, path: &Path, read: Read<'_>) -> Result<String> {
        let Some(source) = read(path)? else {
            let file = self.files[self.module(parent).file].display();
            bail!("{file} declares `mod {name}`, and there is no {}", path.display());
        };
        Ok(source)
    }
}

fn folder(file: &Path) -> PathBuf {
    file.parent().unwrap_or(Path::new("")).into()
}

/// Without `..`.
fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for component in path.components() {
        match component {
            Component::ParentDir if normal.parent().is_some() => {
                normal.pop();
            }
            Component::CurDir => {}
            component => normal.push(component),
        }
    }
    normal
}

/// A name without the `r#` of raw identifiers.
pub(crate) fn plain(name: &proc_macro2::Ident) -> String {
    let name = name.to_string();
    name.strip_prefix("r#").map(Into::into).unwrap_or(name)
}

/// The names of a `use`. A path from `::` is another crate's, and none of them is kept.
pub(crate) fn imports(tree: &UseTree, from_outside: bool, re_export: bool) -> Vec<Import> {
    let mut found = Vec::new();
    if !from_outside {
        names_of(tree, &mut Vec::new(), re_export, &mut found);
    }
    found
}

fn names_of(tree: &UseTree, path: &mut Vec<String>, re_export: bool, found: &mut Vec<Import>) {
    let mut push = |last: &proc_macro2::Ident, name: Option<&proc_macro2::Ident>| {
        let line = last.span().start().line;
        let mut path = path.clone();
        // `use a::{self}` is `use a`.
        if path.is_empty() || last != "self" {
            path.push(plain(last));
        }
        let name = match name {
            Some(name) => Some(plain(name)),
            None => path.last().cloned(),
        };
        found.push(Import { path, name, line, re_export });
    };
    match tree {
        UseTree::Path(part) => {
            path.push(plain(&part.ident));
            names_of(&part.tree, path, re_export, found);
            path.pop();
        }
        UseTree::Name(part) => push(&part.ident, None),
        UseTree::Rename(part) => push(&part.ident, Some(&part.rename)),
        UseTree::Glob(part) => {
            let line = part.star_token.spans[0].start().line;
            found.push(Import { path: path.clone(), name: None, line, re_export });
        }
        UseTree::Group(part) => {
            for tree in &part.items {
                names_of(tree, path, re_export, found);
            }
        }
    }
}

/// Whether it is compiled for tests alone.
pub(crate) fn for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<Meta>().is_ok_and(|condition| needs_test(&condition))
    })
}

fn needs_test(condition: &Meta) -> bool {
    match condition {
        Meta::Path(path) => path.is_ident("test"),
        Meta::List(list) if list.path.is_ident("all") => {
            let all = syn::punctuated::Punctuated::<Meta, syn::Token![,]>::parse_terminated;
            list.parse_args_with(all).is_ok_and(|all| all.iter().any(needs_test))
        }
        _ => false,
    }
}

fn path_attribute(attributes: &[Attribute]) -> Option<String> {
    attributes.iter().find(|attribute| attribute.path().is_ident("path")).and_then(|attribute| {
        let Meta::NameValue(given) = &attribute.meta else { return None };
        let Expr::Lit(literal) = &given.value else { return None };
        let Lit::Str(path) = &literal.lit else { return None };
        Some(path.value())
    })
}

pub(crate) fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::ExternCrate(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::ForeignMod(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::TraitAlias(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Union(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

/// Names that an item defines in its module. Macros by name follow other rules and are left out.
pub(crate) fn defined(item: &Item) -> Vec<String> {
    let name = match item {
        Item::Const(item) => &item.ident,
        Item::Enum(item) => &item.ident,
        Item::Fn(item) => &item.sig.ident,
        Item::Static(item) => &item.ident,
        Item::Struct(item) => &item.ident,
        Item::Trait(item) => &item.ident,
        Item::TraitAlias(item) => &item.ident,
        Item::Type(item) => &item.ident,
        Item::Union(item) => &item.ident,
        Item::ForeignMod(block) => {
            let name = |item: &ForeignItem| match item {
                ForeignItem::Fn(item) => Some(plain(&item.sig.ident)),
                ForeignItem::Static(item) => Some(plain(&item.ident)),
                ForeignItem::Type(item) => Some(plain(&item.ident)),
                _ => None,
            };
            return block.items.iter().filter_map(name).collect();
        }
        _ => return Vec::new(),
    };
    vec![plain(name)]
}
