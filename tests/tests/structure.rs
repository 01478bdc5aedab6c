//! The structure of the code: no two files import each other in a circle, and the trainer builds
//! nothing that it does not need.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use end_to_end::repository;
use syn::{
    Attribute, ItemMod, ItemUse, UseTree, Visibility,
    visit::{self, Visit},
};

/// A module by its path in the crate; the root is empty.
type Module = Vec<String>;

/// An imported path, whether it is re-exported, and the depth of inline modules around it.
struct Import {
    path: Vec<String>,
    is_reexport: bool,
    depth: usize,
}

/// Collects the imports of a file, those of its tests left out.
#[derive(Default)]
struct Imports {
    found: Vec<Import>,
    depth: usize,
}

impl<'ast> Visit<'ast> for Imports {
    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        if module.content.is_none() || is_for_tests(&module.attrs) {
            return;
        }
        self.depth += 1;
        visit::visit_item_mod(self, module);
        self.depth -= 1;
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        // A path that begins with `::` is one of another crate.
        if is_for_tests(&item.attrs) || item.leading_colon.is_some() {
            return;
        }
        let is_reexport = !matches!(item.vis, Visibility::Inherited);
        let mut paths = Vec::new();
        collect(&item.tree, &mut Vec::new(), &mut paths);
        let depth = self.depth;
        self.found.extend(paths.into_iter().map(|path| Import {
            path,
            is_reexport,
            depth,
        }));
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute
                .meta
                .require_list()
                .is_ok_and(|list| list.tokens.to_string().contains("test"))
    })
}

/// Writes out the paths of a `use` tree.
fn collect(tree: &UseTree, before: &mut Vec<String>, paths: &mut Vec<Vec<String>>) {
    let with = |before: &[String], last: String| {
        let mut path = before.to_vec();
        path.push(last);
        path
    };
    match tree {
        UseTree::Path(path) => {
            before.push(path.ident.to_string());
            collect(&path.tree, before, paths);
            before.pop();
        }
        UseTree::Name(name) => paths.push(with(before, name.ident.to_string())),
        UseTree::Rename(rename) => paths.push(with(before, rename.ident.to_string())),
        UseTree::Glob(_) => paths.push(before.clone()),
        UseTree::Group(group) => {
            for tree in &group.items {
                collect(tree, before, paths);
            }
        }
    }
}

/// The files of a crate and what they import.
struct Crate {
    imports: BTreeMap<Module, Vec<Import>>,
}

impl Crate {
    fn read(source: &Path) -> Self {
        let mut files = Vec::new();
        find_files(source, &mut files);
        let imports = files.into_iter().map(|file| {
            let text = fs::read_to_string(&file).expect("readable");
            let parsed = syn::parse_file(&text).expect("Rust");
            let mut imports = Imports::default();
            imports.visit_file(&parsed);
            (module_of(source, &file), imports.found)
        });
        Self {
            imports: imports.collect(),
        }
    }

    /// The module whose file an import of `from` names.
    fn target(&self, from: &Module, import: &Import) -> Option<Module> {
        let path = import.path.as_slice();
        // `super` within an inline module may stay in the file.
        let supers = path.iter().take_while(|part| *part == "super").count();
        let outwards = supers.saturating_sub(import.depth);
        let (start, rest) = match path.first().map(String::as_str)? {
            "crate" => (Vec::new(), &path[1..]),
            "self" => (from.clone(), &path[1..]),
            "super" => {
                let kept = from.len().checked_sub(outwards)?;
                (from[..kept].to_vec(), &path[supers..])
            }
            first => {
                let mut child = from.clone();
                child.push(first.to_owned());
                // Any other path begins with another crate.
                self.imports.get(&child)?;
                (from.clone(), path)
            }
        };
        Some(self.descend(start, rest, 0))
    }

    /// Follows a path down to a file, through re-exports.
    fn descend(&self, mut module: Module, path: &[String], jumps: usize) -> Module {
        let Some((first, rest)) = path.split_first() else {
            return module;
        };
        let mut child = module.clone();
        child.push(first.clone());
        if self.imports.contains_key(&child) {
            return self.descend(child, rest, jumps);
        }
        let reexport = self.imports.get(&module).into_iter().flatten();
        let mut reexport =
            reexport.filter(|import| import.is_reexport && import.path.last() == Some(first));
        if jumps < 8
            && let Some(import) = reexport.next()
            && let Some(target) = self.target_of_reexport(&module, import, jumps)
        {
            module = target;
        }
        module
    }

    fn target_of_reexport(&self, from: &Module, import: &Import, jumps: usize) -> Option<Module> {
        let (first, rest) = import.path.split_first()?;
        let start = match first.as_str() {
            "crate" => Vec::new(),
            "self" => from.clone(),
            "super" => from[..from.len().checked_sub(1)?].to_vec(),
            _ => {
                let mut child = from.clone();
                child.push(first.clone());
                self.imports.get(&child)?;
                child
            }
        };
        Some(self.descend(start, rest, jumps + 1))
    }

    /// Which files import which. What a module re-exports of its own children does not count.
    fn edges(&self) -> BTreeMap<&Module, BTreeSet<Module>> {
        let edges = self.imports.iter().map(|(module, imports)| {
            let targets = imports.iter().filter_map(|import| {
                let target = self.target(module, import)?;
                let is_own_child = target.starts_with(module) && target.len() > module.len();
                let counts = target != *module && !(import.is_reexport && is_own_child);
                counts.then_some(target)
            });
            (module, targets.collect())
        });
        edges.collect()
    }

    /// A circle of files, if there is one.
    fn circle(&self) -> Option<Vec<Module>> {
        let edges = self.edges();
        let mut done = BTreeSet::new();
        edges
            .keys()
            .find_map(|&module| search(module, &edges, &mut Vec::new(), &mut done))
    }
}

fn search(
    module: &Module,
    edges: &BTreeMap<&Module, BTreeSet<Module>>,
    path: &mut Vec<Module>,
    done: &mut BTreeSet<Module>,
) -> Option<Vec<Module>> {
    if let Some(begin) = path.iter().position(|known| known == module) {
        return Some(path[begin..].to_vec());
    }
    if done.contains(module) {
        return None;
    }
    path.push(module.clone());
    let found = edges
        .get(module)
        .into_iter()
        .flatten()
        .find_map(|next| search(next, edges, path, done));
    path.pop();
    done.insert(module.clone());
    found
}

/// Files that are tests themselves are left out.
fn find_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().unwrap_or_default();
        if path.is_dir() {
            find_files(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs")
            && name != "tests.rs"
            && name != "fixture.rs"
        {
            files.push(path);
        }
    }
}

/// `main.rs` is the root of another crate, whose modules import each other through it.
fn module_of(source: &Path, file: &Path) -> Module {
    let relative = file.strip_prefix(source).expect("below the source");
    let mut module: Module = relative
        .with_extension("")
        .iter()
        .map(|part| part.to_string_lossy().into_owned())
        .collect();
    if module.last().is_some_and(|last| last == "mod") || module == ["lib"] {
        module.pop();
    }
    module
}

fn sources() -> Vec<PathBuf> {
    let root = repository();
    let own = ["firmware-core", "host-sim", "trainer", "xtask"].map(|name| root.join(name));
    let libraries = fs::read_dir(root.join("crates")).expect("crates");
    let libraries = libraries.map(|entry| entry.expect("an entry").path());
    own.into_iter()
        .chain(libraries)
        .map(|folder| folder.join("src"))
        .collect()
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let sources = sources();
    assert!(sources.len() > 10, "{sources:?}");
    let mut circles = Vec::new();
    for source in sources {
        let files = Crate::read(&source);
        assert!(!files.imports.is_empty(), "{source:?}");
        if let Some(circle) = files.circle() {
            let names: Vec<String> = circle.iter().map(|module| module.join("::")).collect();
            circles.push(format!("{}: {}", source.display(), names.join(" -> ")));
        }
    }
    assert!(circles.is_empty(), "{circles:#?}");
}

/// The checker itself, on files that do import each other.
#[test]
fn a_circle_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).expect("written");
    };
    write("lib.rs", "mod a; mod b; mod c; pub use b::B;");
    write("a.rs", "use crate::B; pub struct A;");
    write("b.rs", "use super::c::C; pub struct B;");
    write(
        "c.rs",
        "#[cfg(test)] mod tests { use crate::a::A; } pub struct C;",
    );
    assert_eq!(Crate::read(folder.path()).circle(), None);
    write("c.rs", "use crate::{a::A, b}; pub struct C;");
    let circle = Crate::read(folder.path()).circle().expect("a circle");
    assert!(circle.len() >= 2, "{circle:?}");
    // A parent with items of its own that its child imports.
    write("c.rs", "pub struct C;");
    write("b.rs", "use super::Shared; pub struct B;");
    write(
        "lib.rs",
        "mod a; mod b; mod c; use b::B; pub struct Shared(B);",
    );
    assert_eq!(
        Crate::read(folder.path())
            .circle()
            .map(|circle| circle.len()),
        Some(2)
    );
}

/// firmware-core is the crate that is published: each of its files states its license.
#[test]
fn each_file_of_firmware_core_states_its_license() {
    let mut folders = vec![repository().join("firmware-core")];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    assert!(files.len() > 100, "{files:?}");
    files.retain(|file| {
        let text = fs::read_to_string(file).expect("readable");
        !text.starts_with("// SPDX-License-Identifier: MIT OR Apache-2.0\n")
    });
    assert!(files.is_empty(), "{files:#?}");
}

#[test]
fn the_trainer_builds_no_links_and_no_clarabel() {
    let tree = |package| -> BTreeSet<String> {
        let lines = cargo_tree(package, "{lib}", "normal");
        let names = lines.into_keys();
        names.map(|package| name(&package).to_owned()).collect()
    };
    let (trainer, host_sim) = (tree("trainer"), tree("host-sim"));
    for foreign in ["clarabel", "link", "vehicle", "reference"] {
        assert!(!trainer.contains(foreign), "the trainer builds {foreign}");
        assert!(
            host_sim.contains(foreign),
            "{foreign} is gone: mend this test"
        );
    }
    assert!(!trainer.contains("host-sim"));
}

/// Building one after the other builds no crate again: the features are those of the other.
#[test]
fn the_trainer_and_host_sim_build_shared_crates_with_the_same_features() {
    let [trainer, host_sim] =
        ["trainer", "host-sim"].map(|package| cargo_tree(package, "{f}", "normal,build"));
    let mut shared = 0;
    for (package, features) in &trainer {
        if let Some(others) = host_sim.get(package) {
            // There may be two: build scripts have features of their own.
            let known = features.is_subset(others);
            assert!(known, "{package}: {features:?}, in host-sim {others:?}");
            shared += 1;
        }
    }
    assert!(shared > 100, "only {shared} crates are shared");
}

fn name(package: &str) -> &str {
    package.split(' ').next().unwrap_or(package)
}

/// Returns each package that a package is built from, with what `format` says of it.
fn cargo_tree(package: &str, format: &str, edges: &str) -> BTreeMap<String, BTreeSet<String>> {
    let cargo = option_env!("CARGO").unwrap_or("cargo");
    let output = Command::new(cargo)
        .args(["tree", "--locked", "--prefix", "none", "--edges", edges])
        .args(["--package", package, "--format", &format!("{{p}}|{format}")])
        .current_dir(repository())
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{output:?}");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let mut packages = BTreeMap::new();
    for line in text.lines() {
        let (package, words) = line.split_once('|').unwrap_or((line, ""));
        let words = words.trim_end_matches(" (*)").to_owned();
        let said: &mut BTreeSet<String> = packages.entry(package.to_owned()).or_default();
        said.insert(words);
    }
    packages
}
