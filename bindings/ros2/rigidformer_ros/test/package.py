"""Reads the package as ROS 2's tools do: package.py FOLDER VERSION. Exits with what contradicts what."""

import ast
import pathlib
import re
import sys

import yaml
from catkin_pkg.package import parse_package

folder, version = pathlib.Path(sys.argv[1]), sys.argv[2]
warnings = []
package = parse_package(str(folder), warnings=warnings)
faults = [f"package.xml: {warning}" for warning in warnings]
if package.version != version:
    faults.append(f"package.xml has version {package.version}, and the workspace {version}")
if package.get_build_type() != "ament_cmake":
    faults.append(f"package.xml has build type {package.get_build_type()}, not ament_cmake")

found = set(re.findall(r"^find_package\((\w+)", (folder / "CMakeLists.txt").read_text(), re.MULTILINE))
depends = {depend.name for depend in package.build_depends + package.buildtool_depends}
# The library is no ROS package: it comes from `cargo xtask capi --prefix`.
if found - {"rigidformer"} != depends:
    faults.append(f"CMakeLists.txt finds {sorted(found)}, and package.xml depends on {sorted(depends)}")

for file in sorted(folder.glob("launch/*.py")):
    launch = ast.parse(file.read_text())
    imports = {node.module.split(".")[0] for node in ast.walk(launch) if isinstance(node, ast.ImportFrom)}
    if missing := imports - {depend.name for depend in package.exec_depends}:
        faults.append(f"{file.name} imports {sorted(missing)}, on which package.xml does not depend")


def declared(source):
    """Parameters that a node looks at."""
    text = (folder / "src" / source).read_text()
    return set(re.findall(r'(?:declare_parameter|number|count)\(\s*"([\w.]+)"', text))


def example(file):
    """Parameters of an example."""
    (node,) = yaml.safe_load((folder / "config" / file).read_text()).values()
    return node["ros__parameters"]


# Parameters of the examples that the nodes would not look at.
source = (folder / "src/predictor_node.cpp").read_text()
known = declared("predictor_node.cpp")
of_unit = set(re.findall(r'declare_parameter\(\s*prefix \+ "(\w+)"', source))
parameters = example("predictor.yaml")
units = parameters.pop("units")
names = units.pop("names")
faults += [f"the example has a parameter {name}" for name in parameters.keys() - known]
if list(units) != names:
    faults.append(f"the example names units {names} and describes {list(units)}")
for name, unit in units.items():
    faults += [f"the example's unit {name} has a parameter {key}" for key in unit.keys() - of_unit]
of_track = declared("track_node.cpp")
faults += [f"track.yaml has a parameter {name}" for name in example("track.yaml").keys() - of_track]

if faults:
    sys.exit("\n".join(faults))
print(f"ROS 2: catkin_pkg reads package.xml; {len(depends)} dependencies as in CMakeLists.txt, "
      f"{len(known) + len(of_unit) + len(of_track)} parameters")
