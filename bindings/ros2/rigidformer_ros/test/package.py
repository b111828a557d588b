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

launch = ast.parse((folder / "launch/predictor.launch.py").read_text())
imports = {node.module.split(".")[0] for node in ast.walk(launch) if isinstance(node, ast.ImportFrom)}
if missing := imports - {depend.name for depend in package.exec_depends}:
    faults.append(f"the launch file imports {sorted(missing)}, on which package.xml does not depend")

# Parameters of the example that the node would not look at.
source = (folder / "src/predictor_node.cpp").read_text()
known = set(re.findall(r'declare_parameter\(\s*"([\w.]+)"', source))
of_unit = set(re.findall(r'declare_parameter\(\s*prefix \+ "(\w+)"', source))
(node,) = yaml.safe_load((folder / "config/predictor.yaml").read_text()).values()
parameters = node["ros__parameters"]
units = parameters.pop("units")
names = units.pop("names")
faults += [f"the example has a parameter {name}" for name in parameters.keys() - known]
if list(units) != names:
    faults.append(f"the example names units {names} and describes {list(units)}")
for name, unit in units.items():
    faults += [f"the example's unit {name} has a parameter {key}" for key in unit.keys() - of_unit]

if faults:
    sys.exit("\n".join(faults))
print(f"ROS 2: catkin_pkg reads package.xml; {len(depends)} dependencies as in CMakeLists.txt, "
      f"{len(known) + len(of_unit)} parameters")
