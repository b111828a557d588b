//! The nodes for ROS 2: against stand-ins for ROS 2's headers, and built by ament_cmake itself.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail};

use super::{Place, build, configure};
use crate::apt::{self, Tool};
use crate::process::output;
use crate::report::{Missing, Report};

const PACKAGE: &str = "bindings/ros2/rigidformer_ros";
/// Models whose predictions are compared with those of C calls.
const MODELS: [&str; 2] = ["weights/models/nano.rfm", "weights/models/edge.rfm"];
/// The tracker's test, and the model that predicts what is followed.
const TRACKED: (&str, &str) = ("track_test", "weights/models/edge.rfm");
/// The interpreter that Debian's ament_cmake has its modules for.
const PYTHON: &str = "-DPython3_EXECUTABLE=/usr/bin/python3";

const PROOF: &str = "cmake_minimum_required(VERSION 3.18)\nproject(proof LANGUAGES CXX)\n\
    find_package(ament_cmake REQUIRED)\nament_package()\n";
const PROOF_PACKAGE: &str = "<package format=\"3\"><name>proof</name><version>1.0.0</version>\
    <description>proof</description><maintainer email=\"a@example.org\">a</maintainer>\
    <license>MIT</license></package>\n";

const AMENT: Tool = Tool {
    name: "ament_cmake",
    packages: &["ament-cmake"],
    movable: false,
    proof: |folder| {
        fs::write(folder.join("CMakeLists.txt"), PROOF)?;
        fs::write(folder.join("package.xml"), PROOF_PACKAGE)?;
        output(configure(folder, &folder.join("build")).arg(PYTHON)).map(drop)
    },
};

/// What an installed package has at least: ros2 run, ros2 launch and colcon look there.
const INSTALLED: [&str; 9] = [
    "lib/rigidformer_ros/predictor_node",
    "lib/rigidformer_ros/track_node",
    "share/rigidformer_ros/launch/track.launch.py",
    "share/rigidformer_ros/config/track.yaml",
    "share/rigidformer_ros/launch/predictor.launch.py",
    "share/rigidformer_ros/config/predictor.yaml",
    "share/rigidformer_ros/package.xml",
    "share/ament_index/resource_index/packages/rigidformer_ros",
    "share/rigidformer_ros/cmake/rigidformer_rosConfig.cmake",
];

/// Whoever hands on the node hands on the library within it.
const LICENCES: [&str; 2] = ["LICENSE-MIT", "LICENSE-APACHE"];
/// And the licences of the crates within that.
const THIRD_PARTY: &str = "THIRD-PARTY.txt";

pub(super) fn run(
    place: &Place,
    python: &std::result::Result<(), Missing>,
    report: &mut Report,
) -> Result<()> {
    let package = Path::new(PACKAGE);
    let folder = place.folder.join("node");
    let mut test = configure(&package.join("test"), &folder);
    output(test.arg(format!("-DCMAKE_PREFIX_PATH={}", place.prefix.display())))?;
    build(&folder)?;
    for (test, model) in MODELS.map(|model| ("node_test", model)).into_iter().chain([TRACKED]) {
        let printed = output(Command::new(folder.join(test)).arg(model))?;
        print!("ROS 2, {model}: {printed}");
    }
    match python {
        Ok(()) => {
            let script = package.join("test/package.py");
            let version = env!("CARGO_PKG_VERSION");
            print!("{}", output(place.program("python").arg(script).arg(package).arg(version))?);
        }
        Err(missing) => report.skip_part("package.xml of the ROS 2 node", missing.clone()),
    }
    match apt::ensure(&[AMENT]) {
        Ok(()) => ament(package, place),
        Err(missing) => {
            report.skip_part("the ROS 2 node by ament_cmake", missing);
            Ok(())
        }
    }
}

/// Builds and installs the package as colcon does, with stand-ins for the packages that it finds.
fn ament(package: &Path, place: &Place) -> Result<()> {
    let (folder, prefix) = (place.empty("ament")?, place.empty("ament-prefix")?);
    let stubs = package.join("test/stubs/cmake").canonicalize().context("no stand-ins")?;
    let mut command = configure(package, &folder);
    command.arg(format!("-DCMAKE_PREFIX_PATH={};{}", place.prefix.display(), stubs.display()));
    command.arg(format!("-DCMAKE_INSTALL_PREFIX={}", prefix.display())).arg(PYTHON);
    output(&mut command)?;
    build(&folder)?;
    output(Command::new("cmake").arg("--install").arg(&folder))?;
    if let Some(name) = INSTALLED.iter().find(|name| !prefix.join(name).is_file()) {
        bail!("{PACKAGE} installs no {name}: see install() in its CMakeLists.txt");
    }
    for name in LICENCES {
        let installed = prefix.join("share/rigidformer_ros").join(name);
        // A link would lead nowhere in a package of the installed files.
        let is_file = fs::symlink_metadata(&installed).is_ok_and(|found| found.is_file());
        if !is_file || fs::read(&installed)? != fs::read(name)? {
            bail!(
                "{PACKAGE} does not install the text of {name}: see install() in its CMakeLists.txt"
            );
        }
    }
    let of_library = place.prefix.join("share/doc/rigidformer").join(THIRD_PARTY);
    if fs::read(prefix.join("share/rigidformer_ros").join(THIRD_PARTY))? != fs::read(of_library)? {
        bail!("{PACKAGE} does not install the library's {THIRD_PARTY}: see its CMakeLists.txt");
    }
    println!("ROS 2: ament_cmake builds and installs the package");
    Ok(())
}
