//! Which file names an item of which other file, and where.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use proc_macro2::{Spacing, TokenStream, TokenTree};
use syn::punctuated::Punctuated;
use syn::visit::{self, Visit};

use super::names::{Target, lookup, resolve};
use super::tree::{Import, Tree, attributes, defined, for_tests, imports, plain};

/// Lines of a file, and the items of another file that they name.
pub(crate) type Places = BTreeSet<(usize, String)>;

/// From each file to each other file of which it names an item. Files are those of [`Tree::files`].
pub(crate) fn uses(tree: &Tree) -> BTreeMap<(usize, usize), Places> {
    let mut found = BTreeMap::new();
    for module in 0..tree.modules.len() {
        let mut visitor = Visitor { tree, module, scopes: Vec::new(), found: &mut found };
        for import in &tree.module(module).imports {
            visitor.import(import);
        }
        for item in &tree.module(module).items {
            visitor.visit_item(item);
        }
    }
    found
}

struct Visitor<'t> {
    tree: &'t Tree,
    module: usize,
    scopes: Vec<Scope>,
    found: &'t mut BTreeMap<(usize, usize), Places>,
}

/// Names of a block, a function or an arm of a match.
#[derive(Default)]
struct Scope {
    /// Variables.
    values: HashSet<String>,
    /// Generics and items, and what a `use` brings in, with its path.
    names: HashMap<String, Option<Vec<String>>>,
    /// Paths of `use ..::*`.
    globs: Vec<Vec<String>>,
}

impl Visitor<'_> {
    fn import(&mut self, import: &Import) {
        for target in resolve(self.tree, self.module, &import.path) {
            let Target::Item { module, name } = target else { continue };
            // A module that hands on items of modules below it does not use them.
            let below = self.tree.ancestors(module).any(|module| module == self.module);
            if !(import.re_export && below) {
                self.note(module, name, import.line);
            }
        }
    }

    fn note(&mut self, module: usize, name: String, line: usize) {
        let (from, to) = (self.tree.module(self.module).file, self.tree.module(module).file);
        if from != to {
            self.found.entry((from, to)).or_default().insert((line, name));
        }
    }

    fn path(&mut self, path: &[String], line: usize) {
        let Some(first) = path.first() else { return };
        if first == "Self" {
            return;
        }
        for scope in self.scopes.iter().rev() {
            match scope.names.get(first) {
                Some(None) => return,
                Some(Some(brought)) => {
                    let whole = [brought.as_slice(), path.get(1..).unwrap_or_default()].concat();
                    return self.resolved(resolve(self.tree, self.module, &whole), line);
                }
                None => {}
            }
            for glob in &scope.globs {
                let modules = resolve(self.tree, self.module, glob);
                let known = modules.iter().find_map(|target| match target {
                    Target::Module(module) if !lookup(self.tree, *module, first).is_empty() => {
                        Some(*module)
                    }
                    _ => None,
                });
                if let Some(module) = known {
                    return self.resolved(resolve(self.tree, module, path), line);
                }
            }
        }
        self.resolved(resolve(self.tree, self.module, path), line);
    }

    fn resolved(&mut self, targets: BTreeSet<Target>, line: usize) {
        for target in targets {
            if let Target::Item { module, name } = target {
                self.note(module, name, line);
            }
        }
    }

    fn is_variable(&self, name: &str) -> bool {
        self.scopes.iter().any(|scope| scope.values.contains(name))
    }

    fn within(&mut self, scope: Scope, body: impl FnOnce(&mut Self)) {
        self.scopes.push(scope);
        body(self);
        self.scopes.pop();
    }

    fn scoped(&mut self, body: impl FnOnce(&mut Self)) {
        self.within(Scope::default(), body);
    }

    /// Paths in what may be no Rust: names joined by `::`, and single names of types and constants.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let (mut line, mut colons, mut skip) = (0, 0, false);
        for token in tokens {
            match token {
                TokenTree::Ident(name) if colons == 2 && !path.is_empty() => {
                    path.push(plain(&name));
                    colons = 0;
                }
                TokenTree::Ident(name) => {
                    self.end_of_path(&mut path, line);
                    (line, colons) = (name.span().start().line, 0);
                    // Not `.field` and not `$variable`, but `$crate`.
                    if !std::mem::take(&mut skip) || name == "crate" {
                        path.push(plain(&name));
                    }
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' => {
                    let second = colons == 1;
                    colons =
                        if second || mark.spacing() == Spacing::Joint { colons + 1 } else { 3 };
                }
                TokenTree::Punct(mark) => {
                    self.end_of_path(&mut path, line);
                    (colons, skip) = (0, matches!(mark.as_char(), '.' | '$'));
                }
                TokenTree::Group(group) => {
                    self.end_of_path(&mut path, line);
                    (colons, skip) = (0, false);
                    self.tokens(group.stream());
                }
                TokenTree::Literal(_) => {
                    self.end_of_path(&mut path, line);
                    (colons, skip) = (0, false);
                }
            }
        }
        self.end_of_path(&mut path, line);
    }

    fn end_of_path(&mut self, path: &mut Vec<String>, line: usize) {
        if path.len() > 1 || path.first().is_some_and(|name| is_upper(name)) {
            self.path(path, line);
        }
        path.clear();
    }
}

fn is_upper(name: &str) -> bool {
    name.starts_with(char::is_uppercase)
}

impl<'ast> Visit<'ast> for Visitor<'_> {
    fn visit_path(&mut self, path: &'ast syn::Path) {
        if let (None, Some(first)) = (&path.leading_colon, path.segments.first()) {
            let names: Vec<String> =
                path.segments.iter().map(|segment| plain(&segment.ident)).collect();
            self.path(&names, first.ident.span().start().line);
        }
        visit::visit_path(self, path);
    }

    fn visit_expr_path(&mut self, path: &'ast syn::ExprPath) {
        if !path.path.get_ident().is_some_and(|name| self.is_variable(&plain(name))) {
            visit::visit_expr_path(self, path);
        }
    }

    fn visit_pat_ident(&mut self, pattern: &'ast syn::PatIdent) {
        let name = plain(&pattern.ident);
        if is_upper(&name) {
            self.path(&[name], pattern.ident.span().start().line);
        } else if let Some(scope) = self.scopes.last_mut() {
            scope.values.insert(name);
        }
        visit::visit_pat_ident(self, pattern);
    }

    fn visit_generics(&mut self, generics: &'ast syn::Generics) {
        if let Some(scope) = self.scopes.last_mut() {
            let types = generics.type_params().map(|parameter| &parameter.ident);
            let values = generics.const_params().map(|parameter| &parameter.ident);
            scope.names.extend(types.chain(values).map(|name| (plain(name), None)));
        }
        visit::visit_generics(self, generics);
    }

    fn visit_block(&mut self, block: &'ast syn::Block) {
        // Items of a block are known from its first line on.
        let mut scope = Scope::default();
        let mut brought = Vec::new();
        for statement in &block.stmts {
            match statement {
                syn::Stmt::Item(syn::Item::Use(item)) => {
                    brought.extend(imports(&item.tree, item.leading_colon.is_some(), false));
                }
                syn::Stmt::Item(item) => {
                    scope.names.extend(defined(item).into_iter().map(|name| (name, None)));
                }
                _ => {}
            }
        }
        for import in brought {
            self.import(&import);
            match import.name {
                Some(name) => drop(scope.names.insert(name, Some(import.path))),
                None => scope.globs.push(import.path),
            }
        }
        self.within(scope, |visitor| visit::visit_block(visitor, block));
    }

    fn visit_local(&mut self, local: &'ast syn::Local) {
        // The value does not see the variable.
        if let Some(init) = &local.init {
            self.visit_local_init(init);
        }
        self.visit_pat(&local.pat);
    }

    fn visit_expr_let(&mut self, condition: &'ast syn::ExprLet) {
        self.visit_expr(&condition.expr);
        self.visit_pat(&condition.pat);
    }

    fn visit_expr_if(&mut self, choice: &'ast syn::ExprIf) {
        self.scoped(|visitor| {
            visitor.visit_expr(&choice.cond);
            visitor.visit_block(&choice.then_branch);
        });
        if let Some((_, otherwise)) = &choice.else_branch {
            self.visit_expr(otherwise);
        }
    }

    fn visit_expr_while(&mut self, repeated: &'ast syn::ExprWhile) {
        self.scoped(|visitor| visit::visit_expr_while(visitor, repeated));
    }

    fn visit_expr_for_loop(&mut self, repeated: &'ast syn::ExprForLoop) {
        self.visit_expr(&repeated.expr);
        self.scoped(|visitor| {
            visitor.visit_pat(&repeated.pat);
            visitor.visit_block(&repeated.body);
        });
    }

    fn visit_expr_closure(&mut self, closure: &'ast syn::ExprClosure) {
        self.scoped(|visitor| visit::visit_expr_closure(visitor, closure));
    }

    fn visit_arm(&mut self, arm: &'ast syn::Arm) {
        self.scoped(|visitor| visit::visit_arm(visitor, arm));
    }

    fn visit_item(&mut self, item: &'ast syn::Item) {
        if !for_tests(attributes(item)) {
            self.scoped(|visitor| visit::visit_item(visitor, item));
        }
    }

    fn visit_impl_item(&mut self, item: &'ast syn::ImplItem) {
        let attributes = match item {
            syn::ImplItem::Const(item) => &item.attrs,
            syn::ImplItem::Fn(item) => &item.attrs,
            syn::ImplItem::Type(item) => &item.attrs,
            syn::ImplItem::Macro(item) => &item.attrs,
            _ => return,
        };
        if !for_tests(attributes) {
            self.scoped(|visitor| visit::visit_impl_item(visitor, item));
        }
    }

    fn visit_trait_item(&mut self, item: &'ast syn::TraitItem) {
        self.scoped(|visitor| visit::visit_trait_item(visitor, item));
    }

    /// The tokens as expressions where they are, else as they come. The macro's own name is left out.
    fn visit_macro(&mut self, called: &'ast syn::Macro) {
        let expressions = Punctuated::<syn::Expr, syn::Token![,]>::parse_terminated;
        match called.parse_body_with(expressions) {
            Ok(expressions) => {
                for expression in &expressions {
                    self.visit_expr(expression);
                }
            }
            Err(_) => self.tokens(called.tokens.clone()),
        }
    }

    // Already known from the block.
    fn visit_item_use(&mut self, _: &'ast syn::ItemUse) {}

    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}

    // `pub(in path)` names a module, for nothing but who may see.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}
}
