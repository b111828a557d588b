//! Which crate may depend on which, and which file of a crate on which.

mod circles;
mod files;
mod names;
mod tree;
mod uses;

use anyhow::{Result, bail};
use cargo_metadata::{Metadata, MetadataCommand};

use files::Files;

/// The arrows: a crate and those of our crates that it may use. Crates in `tools`, `tests` and `fuzz`
/// may use anything.
const ARROWS: &[(&str, &[&str])] = &[
    ("rigidformer-weights", &[]),
    ("rigidformer-core", &["rigidformer-weights"]),
    ("rigidformer-kernels", &["rigidformer-core", "rigidformer-weights"]),
    ("rigidformer-runtime", &["rigidformer-kernels", "rigidformer-core", "rigidformer-weights"]),
    ("rigidformer-perception", &["rigidformer-runtime", "rigidformer-core", "rigidformer-weights"]),
    (
        "rigidformer-evaluation",
        &[
            "rigidformer-perception",
            "rigidformer-runtime",
            "rigidformer-core",
            "rigidformer-weights",
        ],
    ),
    (
        "rigidformer-planning",
        &[
            "rigidformer-evaluation",
            "rigidformer-runtime",
            "rigidformer-core",
            "rigidformer-weights",
        ],
    ),
    (
        "rigidformer-robots",
        &[
            "rigidformer-evaluation",
            "rigidformer-runtime",
            "rigidformer-core",
            "rigidformer-weights",
        ],
    ),
    (
        "rigidformer-capi",
        &[
            "rigidformer-perception",
            "rigidformer-runtime",
            "rigidformer-kernels",
            "rigidformer-core",
            "rigidformer-weights",
        ],
    ),
    ("rigidformer-firmware", &["rigidformer-core", "rigidformer-weights"]),
    ("rigidformer-firmware-sim", &["rigidformer-evaluation", "rigidformer-runtime"]),
];

/// What tests, benchmarks and examples of a crate may use besides: models are packed for those of the runtime, and the examples of
/// planning print and draw as the program does.
const FOR_TESTS: &[(&str, &str)] = &[
    ("rigidformer-runtime", "rigidformer-evaluation"),
    ("rigidformer-planning", "rigidformer-cli"),
];

/// Crates that build without std and without an allocator, so their dependencies must too.
pub(crate) const NO_STD: &[&str] = &["rigidformer-core", "rigidformer-weights", "rigidformer-capi"];

/// Folders of the crates whose files may not need each other in a circle.
const WITHOUT_CIRCLES: &[&str] = &[
    "weights",
    "core",
    "kernels",
    "runtime-std",
    "perception",
    "evaluation",
    "planning",
    "robots",
    "bindings/c",
    "firmware-sim",
    "firmware-sim/firmware",
    "tools/cli",
];

/// Those of them that have circles yet.
const NOT_YET: &[&str] = &[];

/// Parts of core's forward pass, which never use each other.
const BLOCKS: &[&str] = &["encoder", "interaction", "anchors", "motion"];

/// Parts that core may get.
const PLANNED_BLOCKS: &[&str] = &["blend"];

/// Features by which crates ask for std or an allocator.
const STD_FEATURES: &[&str] = &["std", "alloc", "use-std", "use-alloc", "default"];

/// A crate of the workspace.
struct Package {
    name: String,
    /// Below `tools`, `tests` or `fuzz`.
    free: bool,
    dependencies: Vec<Dependency>,
}

struct Dependency {
    name: String,
    /// Of the workspace.
    ours: bool,
    /// Always there in a normal build: neither optional nor for tests or build scripts.
    always: bool,
    /// For tests, benchmarks and examples alone.
    for_tests: bool,
    default_features: bool,
    features: Vec<String>,
}

/// Checks the workspace in the current folder. With `graph`, prints the files of each crate in layers first.
pub(crate) fn run(graph: bool) -> Result<()> {
    let packages = packages(&MetadataCommand::new().no_deps().exec()?);
    let mut faults = faults(&packages);
    let mut files = 0;
    for folder in WITHOUT_CIRCLES {
        let crate_files = Files::open(folder)?;
        files += crate_files.len();
        if graph {
            println!("{folder}\n{}", crate_files.layers().join("\n"));
        }
        let circles = crate_files.circles();
        if NOT_YET.contains(folder) {
            println!(
                "{folder}: {} circles of files, not a fault yet; `cargo xtask arrows --graph` shows them",
                circles.len()
            );
        } else {
            faults.extend(circles);
        }
        if *folder == "core" {
            faults.extend(crate_files.strangers(BLOCKS, PLANNED_BLOCKS));
        }
    }
    if !faults.is_empty() {
        bail!("{}\nthe arrows are in tools/xtask/src/arrows.rs", faults.join("\n"));
    }
    println!("{} crates and {files} files keep to the arrows", packages.len());
    Ok(())
}

fn packages(metadata: &Metadata) -> Vec<Package> {
    let members = metadata.workspace_packages();
    let free = ["tools", "tests", "fuzz"].map(|folder| metadata.workspace_root.join(folder));
    let dependency = |dependency: &cargo_metadata::Dependency| Dependency {
        name: dependency.name.clone(),
        ours: dependency.path.is_some()
            && members.iter().any(|member| *member.name == dependency.name),
        always: !dependency.optional && dependency.kind == cargo_metadata::DependencyKind::Normal,
        for_tests: dependency.kind == cargo_metadata::DependencyKind::Development,
        default_features: dependency.uses_default_features,
        features: dependency.features.clone(),
    };
    members
        .iter()
        .map(|package| Package {
            name: package.name.to_string(),
            free: free.iter().any(|folder| package.manifest_path.starts_with(folder)),
            dependencies: package.dependencies.iter().map(dependency).collect(),
        })
        .collect()
}

/// Every arrow that is not allowed, as a sentence.
fn faults(packages: &[Package]) -> Vec<String> {
    let mut faults = Vec::new();
    for package in packages {
        if !package.free {
            wrong_arrows(package, &mut faults);
        }
        if NO_STD.contains(&package.name.as_str()) {
            std_dependencies(package, &mut faults);
        }
    }
    faults
}

fn wrong_arrows(package: &Package, faults: &mut Vec<String>) {
    let Some((_, allowed)) = ARROWS.iter().find(|(name, _)| *name == package.name) else {
        faults.push(format!(
            "{} has no rule: give it one, or put it into tools, tests or fuzz",
            package.name
        ));
        return;
    };
    // Its own name: tests of a crate that turn on its features.
    let ours = package
        .dependencies
        .iter()
        .filter(|dependency| dependency.ours && dependency.name != package.name);
    let is_allowed = |dependency: &&Dependency| {
        let arrow = (package.name.as_str(), dependency.name.as_str());
        allowed.contains(&arrow.1) || (dependency.for_tests && FOR_TESTS.contains(&arrow))
    };
    for dependency in ours.filter(|dependency| !is_allowed(dependency)) {
        faults.push(format!("{} must not depend on {}", package.name, dependency.name));
    }
}

fn std_dependencies(package: &Package, faults: &mut Vec<String>) {
    for dependency in package.dependencies.iter().filter(|dependency| dependency.always) {
        if dependency.default_features {
            faults.push(format!(
                "{}: {} needs `default-features = false`",
                package.name, dependency.name
            ));
        }
        for feature in
            dependency.features.iter().filter(|feature| STD_FEATURES.contains(&feature.as_str()))
        {
            faults.push(format!(
                "{} must not turn on `{feature}` of {}",
                package.name, dependency.name
            ));
        }
    }
}

#[cfg(test)]
#[allow(clippy::panic)]
mod tests {
    use super::*;

    fn on(name: &str) -> Dependency {
        let ours = name.starts_with("rigidformer-");
        Dependency {
            name: name.into(),
            ours,
            always: true,
            for_tests: false,
            default_features: false,
            features: vec![],
        }
    }

    fn package(name: &str, dependencies: Vec<Dependency>) -> Package {
        Package { name: name.into(), free: false, dependencies }
    }

    fn free(name: &str, dependencies: Vec<Dependency>) -> Package {
        Package { free: true, ..package(name, dependencies) }
    }

    #[test]
    fn the_house_as_planned_is_fine() {
        let (weights, core, runtime) =
            ("rigidformer-weights", "rigidformer-core", "rigidformer-runtime");
        let house = [
            package(weights, vec![on("half"), on(weights)]),
            package(core, vec![on(weights), on("libm")]),
            package(
                runtime,
                vec![on(core), on(weights), Dependency { default_features: true, ..on("rayon") }],
            ),
            package("rigidformer-capi", vec![on(core), on(weights)]),
            package("rigidformer-kernels", vec![on(core)]),
            package("rigidformer-firmware-sim", vec![on(runtime)]),
            free("rigidformer-tests", vec![on(runtime), on(core), on(weights)]),
            free("xtask", vec![]),
        ];
        assert_eq!(faults(&house), [""; 0]);
    }

    #[test]
    fn wrong_arrows_are_named() {
        let cases = [
            ("rigidformer-weights", "rigidformer-core"),
            ("rigidformer-core", "rigidformer-runtime"),
            ("rigidformer-runtime", "rigidformer-tests"),
            ("rigidformer-capi", "rigidformer-evaluation"),
            ("rigidformer-firmware-sim", "rigidformer-capi"),
        ];
        for (from, to) in cases {
            assert_eq!(
                faults(&[package(from, vec![on(to)])]),
                [format!("{from} must not depend on {to}")]
            );
            // Tests of the crate are bound by the same arrows, but for some.
            let for_tests = Dependency { always: false, for_tests: true, ..on(to) };
            assert_eq!(faults(&[package(from, vec![for_tests])]).len(), 1);
            assert_eq!(faults(&[free("anything", vec![on(to)])]), [""; 0]);
        }
    }

    #[test]
    fn tests_may_use_more_where_a_rule_says_so() {
        let (runtime, evaluation) = ("rigidformer-runtime", "rigidformer-evaluation");
        let for_tests = Dependency { always: false, for_tests: true, ..on(evaluation) };
        assert_eq!(faults(&[package(runtime, vec![for_tests])]), [""; 0]);
        assert_eq!(faults(&[package(runtime, vec![on(evaluation)])]).len(), 1);
    }

    #[test]
    fn a_crate_without_a_rule_is_named() {
        let fault = "rigidformer-new has no rule: give it one, or put it into tools, tests or fuzz";
        assert_eq!(faults(&[package("rigidformer-new", vec![])]), [fault]);
    }

    #[test]
    fn std_dependencies_of_no_std_crates_are_named() {
        let with_default = Dependency { default_features: true, ..on("half") };
        assert_eq!(
            faults(&[package("rigidformer-core", vec![with_default])]),
            ["rigidformer-core: half needs `default-features = false`"]
        );
        let with_alloc =
            Dependency { features: vec!["derive".into(), "alloc".into()], ..on("serde") };
        assert_eq!(
            faults(&[package("rigidformer-weights", vec![with_alloc])]),
            ["rigidformer-weights must not turn on `alloc` of serde"]
        );
        let optional = Dependency { always: false, default_features: true, ..on("tempfile") };
        assert_eq!(faults(&[package("rigidformer-weights", vec![optional])]), [""; 0]);
    }

    #[test]
    fn this_workspace_keeps_to_them() {
        let metadata =
            MetadataCommand::new().no_deps().exec().unwrap_or_else(|error| panic!("{error}"));
        let packages = packages(&metadata);
        assert!(
            packages.iter().any(|package| package.name == "rigidformer-weights" && !package.free)
        );
        assert!(packages.iter().any(|package| package.name == "xtask" && package.free));
        assert_eq!(faults(&packages), [""; 0]);
    }
}
