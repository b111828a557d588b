"""Robots as `rigidformer import-robot` reads them, beside MuJoCo.

    python -m rigidformer_lab.research.robots_compare arm.urdf humanoid.xml --program target/release/rigidformer

Of each file: links and joints, and the worst relative differences of masses, of centres of mass (in metres), of inertia tensors in the
world, of joint axes and of limits, all at rest. Numbers of bodies and joints, and kinds of joints, are equal, or the file fails. MuJoCo
reads a URDF without its shapes, and with a root that floats, since it would weigh nothing. Ends with 1 after a failure, or a difference.
Needs `mujoco`.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np

# Bodies without mass are frames alone: below this a difference says nothing.
LEAST_KG = 1e-9
GOOD = 1e-4
# MuJoCo takes no moments of zero, and has this.
LEAST_MOMENT = 1e-14
ADDED = "of_the_comparison"
KINDS = {
    int(mujoco.mjtJoint.mjJNT_FREE): ("free",),
    int(mujoco.mjtJoint.mjJNT_BALL): ("ball",),
    int(mujoco.mjtJoint.mjJNT_SLIDE): ("prismatic",),
    int(mujoco.mjtJoint.mjJNT_HINGE): ("revolute", "continuous"),
}


def without_shapes(path: str, balances: bool) -> str:
    """A URDF as MuJoCo is to read it: links and joints alone."""
    with open(path, "rb") as file:
        root = ElementTree.fromstring(file.read().rstrip(b"\0"))
    for link in root.findall("link"):
        for tag in ("visual", "collision"):
            for shape in link.findall(tag):
                link.remove(shape)
    children = {joint.find("child").get("link") for joint in root.findall("joint") if joint.find("child") is not None}
    [first] = [link.get("name") for link in root.findall("link") if link.get("name") not in children]
    for element in [element for element in root if element.tag not in ("link", "joint")]:
        root.remove(element)
    # Only below a link of that name may a link float.
    if first != "world":
        ElementTree.SubElement(root, "link", name="world")
        floating = ElementTree.SubElement(root, "joint", name=ADDED, type="floating")
        ElementTree.SubElement(floating, "parent", link="world")
        ElementTree.SubElement(floating, "child", link=first)
    extension = ElementTree.SubElement(root, "mujoco")
    ElementTree.SubElement(
        extension,
        "compiler",
        fusestatic="false",
        inertiafromgeom="false",
        boundmass="1e-14",
        boundinertia=str(LEAST_MOMENT),
        balanceinertia=str(balances).lower(),
    )
    return ElementTree.tostring(root, encoding="unicode")


def theirs(path: str, balances: bool) -> tuple[mujoco.MjModel, mujoco.MjData]:
    with open(path, encoding="utf-8", errors="replace") as file:
        is_urdf = "<robot" in file.read()
    if is_urdf:
        model = mujoco.MjModel.from_xml_string(without_shapes(path, balances))
    else:
        model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return model, data


def ours(path: str, arguments: argparse.Namespace) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "robot.safetensors")
        command = [arguments.program, "import-robot", path, "--out", out, "--json", "--skip-meshes"]
        command += ["--balance"] if arguments.balance else []
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        said = done.stderr.strip().splitlines() or [f"no text, and exit code {done.returncode}"]
        raise RuntimeError(said[-1])
    return json.loads(done.stdout)


def rotation(pose: list[float]) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.array(pose[3:]))
    return matrix.reshape(3, 3)


def finite(number: float) -> float:
    """What is no number is no difference that a comparison could be good by."""
    if not np.isfinite(number):
        raise RuntimeError("a number is not finite")
    return float(number)


def distance(a: np.ndarray, b: np.ndarray) -> float:
    return finite(np.linalg.norm(np.asarray(a) - np.asarray(b)))


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return finite(distance(a, b) / max(np.linalg.norm(b), 1e-300))


def counted(what: str, own: int, other: int) -> None:
    if own != other:
        raise RuntimeError(f"{own} {what}, and MuJoCo has {other}")


def compare(path: str, arguments: argparse.Namespace) -> dict:
    robot = ours(path, arguments)
    model, data = theirs(path, arguments.balance)
    # Several joints of a body hang from links without mass here.
    is_between = re.compile(r".*/\d+$")
    links = [
        link
        for link in robot["links"]
        if not (is_between.match(link["name"]) and link["mass_kg"] == 0 and link["triangles"] == 0)
    ]
    names = [model.body(number).name for number in range(model.nbody)]
    by_name = {name: number for number, name in enumerate(names) if name}
    mass, centre, inertia, compared = 0.0, 0.0, 0.0, set()
    for place, link in enumerate(links):
        number = by_name.get(link["name"], place if place < len(names) and not names[place] else None)
        if number is None:
            raise RuntimeError(f"MuJoCo has no body {link['name']}")
        # The world weighs nothing.
        if number == 0:
            continue
        if number in compared:
            raise RuntimeError(f"two links are the body {names[number]} of MuJoCo")
        compared.add(number)
        if max(link["mass_kg"], model.body_mass[number]) < LEAST_KG:
            continue
        other = model.body_mass[number]
        mass = max(mass, finite(abs(link["mass_kg"] - other) / max(other, LEAST_KG)))
        turn = rotation(link["pose"])
        at = np.array(link["pose"][:3]) + turn @ np.array(link["centre_of_mass_m"])
        centre = max(centre, distance(at, data.xipos[number]))
        own = turn @ np.array(link["inertia_kg_m2"]) @ turn.T
        axes = data.ximat[number].reshape(3, 3)
        other = axes @ np.diag(model.body_inertia[number]) @ axes.T
        if np.any(own) or np.abs(other).max() > 2 * LEAST_MOMENT:
            inertia = max(inertia, relative(own, other))
    counted("bodies", len(compared), model.nbody - 1)
    if not compared:
        raise RuntimeError("there is no body to compare")
    axis, limit = 0.0, 0.0
    moving = [joint for joint in robot["joints"] if joint["kind"] != "fixed"]
    others = [number for number in range(model.njnt) if model.joint(number).name != ADDED]
    counted("joints that move", len(moving), len(others))
    known = {model.joint(number).name: number for number in others if model.joint(number).name}
    for place, joint in enumerate(moving):
        number = known.get(joint["name"], others[place])
        if joint["kind"] not in KINDS[int(model.jnt_type[number])]:
            raise RuntimeError(f"the joint {joint['name']} is {joint['kind']}, and MuJoCo has another kind")
        if joint["axis_at_rest"] is not None:
            if (joint["limits"] is not None) != bool(model.jnt_limited[number]):
                raise RuntimeError(f"the joint {joint['name']} has limits {joint['limits']}, and MuJoCo differs")
            if joint["limits"] is not None:
                limit = max(limit, distance(joint["limits"], model.jnt_range[number]))
            axis = max(axis, relative(np.array(joint["axis_at_rest"]), data.xaxis[number]))
            child = next(link for link in robot["links"] if link["name"] == joint["child"])
            anchor = np.array(child["pose"][:3]) + rotation(child["pose"]) @ np.array(joint["anchor"])
            centre = max(centre, distance(anchor, data.xanchor[number]))
    total = sum(link["mass_kg"] for link in links)
    return {
        "links": len(compared),
        "joints": len(moving),
        "kg": finite(total),
        "mass": mass,
        "inertia": inertia,
        "place_m": centre,
        "axis": axis,
        "limits": limit,
        "notes": len(robot["notes"]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+")
    parser.add_argument("--program", default="rigidformer")
    parser.add_argument("--balance", action="store_true", help="both balance inertia that no body has")
    arguments = parser.parse_args()
    print("|file|links|joints|kg|mass|inertia|centres, anchors m|axes|limits|")
    print("|---|---|---|---|---|---|---|---|---|")
    good = 0
    for path in arguments.files:
        name = "/".join(path.split("/")[-2:])
        try:
            row = compare(path, arguments)
        except Exception as error:  # Each file says why for itself.
            said = str(error).splitlines() or [type(error).__name__]
            print(f"|{name}|failed: {said[0][:200]}|", flush=True)
            continue
        differences = [row[key] for key in ("mass", "inertia", "place_m", "axis", "limits")]
        good += max(differences) <= GOOD
        numbers = "|".join(f"{difference:.1e}" for difference in differences)
        print(f"|{name}|{row['links']}|{row['joints']}|{row['kg']:.4g}|{numbers}|", flush=True)
    print(f"{good} of {len(arguments.files)} equal within {GOOD}", file=sys.stderr)
    sys.exit(good != len(arguments.files))


if __name__ == "__main__":
    main()
