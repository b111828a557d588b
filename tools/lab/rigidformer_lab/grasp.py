"""Grasps by a parallel gripper: MuJoCo records them, and the runtime predicts their outcome.

    python -m rigidformer_lab.grasp --model ../../weights/models/edge-i8.rfm --seeds 200 --json grasps.json
    python -m rigidformer_lab.grasp --model ../../weights/models/edge-i8.rfm --seeds 100 --choose 64

A gripper is moved along a given way. One of its parallel jaws is fixed, as those of SO-100 arms are, the other one slides: a drive of
limited force closes it on a box or a cylinder that stands on the ground. The gripper lifts it by 15 cm and shakes it sideways. The outcome is `held` (it hangs between the jaws at
the end), `slipped` (they touched it, and it does not), or `missed` (they never touched it).

MuJoCo's contact is soft and has an elliptic cone of friction; its steps are 1 ms. The runtime has the same shapes, masses, inertias,
frictions, joints and drives, and moves by impulses. With `--choose N` the runtime tries so many grasps of each object and takes the one that holds
longest against the strongest shaking; the table says in how many scenes MuJoCo holds it too.

Needs the runtime's Python package `rigidformer`, and MuJoCo.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

HELD, SLIPPED, MISSED = "held", "slipped", "missed"
FRICTIONS = (0.25, 0.5, 0.9)
JAW = (0.010, 0.006, 0.025)  # half of its lengths, metres: along, across (the way it closes), upwards
JAW_KG = 0.1
OPEN_M = 0.045  # from the middle to a jaw's inner face
STEP_S, MUJOCO_S = 1 / 60, 1e-3
REST_S, CLOSE_S, LIFT_S, HANG_S, SHAKE_S = 0.1, 0.6, 0.6, 0.2, 0.7
LIFT_M, SHAKE_M, SHAKE_HZ = 0.15, 0.02, 3.0
END_S = REST_S + CLOSE_S + LIFT_S + HANG_S + SHAKE_S
AROUND = 12  # sides of the prism that a cylinder is for the runtime: of more sides, each is too narrow to keep it from creeping
GRAVITY = 9.81
CARRIER_KG = 1e5  # MuJoCo's: nothing that it carries counts
DRIVE_N_M = 2000.0  # of the drive, below its greatest force
TOUCH_KG_M3 = (300.0, 1500.0)


@dataclass(frozen=True)
class Grasp:
    """An object and where the gripper closes on it. Lengths in metres."""

    kind: str  # box, cylinder
    half: tuple[float, float, float]  # half of the lengths of a box; radius, radius and half of the height of a cylinder
    mass_kg: float
    friction: float
    turn_rad: float  # of the object about the vertical, in the gripper's frame
    aside: tuple[float, float]  # of the object's centre from the middle between the open jaws, along and across
    height: float  # of the jaws' middle over the ground
    force_n: float  # of the drive, at most

    @property
    def inertia(self) -> tuple[float, float, float]:
        x, y, z = self.half
        if self.kind == "box":
            return tuple(self.mass_kg / 3 * s for s in (y * y + z * z, x * x + z * z, x * x + y * y))
        side = self.mass_kg * (x * x / 4 + z * z / 3)
        return side, side, self.mass_kg * x * x / 2


def draw(seed: int) -> Grasp:
    """A grasp by a seed: from sure ones to such that slip or miss."""
    rng = np.random.default_rng([917, seed])
    kind = ("box", "cylinder")[rng.integers(2)]
    half = rng.uniform((0.012, 0.012, 0.02), (0.035, 0.035, 0.05))
    if kind == "cylinder":
        half[1] = half[0] = min(half[0], 0.032)
    volume = 8 * half.prod() if kind == "box" else 2 * math.pi * half[0] ** 2 * half[2]
    mass = float(volume * rng.uniform(*TOUCH_KG_M3))
    friction = float(rng.choice(FRICTIONS))
    # About what it takes to hold it, from a third to ten times that.
    force = float(mass * GRAVITY / (2 * friction) * np.exp(rng.uniform(math.log(0.35), math.log(10))))
    turn = float(rng.uniform(-0.25, 0.25) + rng.choice((0.0, math.pi / 2)))
    reach = JAW[0] + half[:2].max()
    along = float(rng.uniform(-1, 1) * (1.6 * reach if rng.random() < 0.2 else 0.4 * reach))
    wide = abs(half[0] * math.sin(turn)) + abs(half[1] * math.cos(turn))
    wide = half[0] if kind == "cylinder" else wide
    across = float(rng.uniform(-1, 1) * max(OPEN_M - wide - 0.004, 0.0))
    height = float(rng.uniform(JAW[2] + 0.004, min(2 * half[2], 0.08) + JAW[2] * 0.3))
    return Grasp(kind, tuple(map(float, half)), mass, friction, turn, (along, across), max(height, JAW[2] + 0.004), force)


def fits(grasp: Grasp) -> bool:
    """Whether the object is between the open jaws, so that nothing overlaps at the start."""
    x, y, _ = grasp.half
    wide = x if grasp.kind == "cylinder" else abs(x * math.sin(grasp.turn_rad)) + abs(y * math.cos(grasp.turn_rad))
    return wide + abs(grasp.aside[1]) < OPEN_M - 0.002


def way(t: float) -> tuple[float, float]:
    """Where the gripper is at a time, along and upwards from its first place, metres."""
    lifted = np.clip((t - REST_S - CLOSE_S) / LIFT_S, 0.0, 1.0)
    shaken = max(t - REST_S - CLOSE_S - LIFT_S - HANG_S, 0.0)
    swell = min(shaken * SHAKE_HZ, 1.0)
    return SHAKE_M * swell * math.sin(2 * math.pi * SHAKE_HZ * shaken), LIFT_M * float(lifted * lifted * (3 - 2 * lifted))


def asked(t: float) -> float:
    """Where the drive wants the sliding jaw, metres inwards: at the fixed one, if nothing is between them."""
    return 2 * OPEN_M * float(np.clip((t - REST_S) / CLOSE_S, 0.0, 1.0))


def outcome(touched: bool, place: np.ndarray, jaw: np.ndarray) -> str:
    """`place`: of the object's centre, `jaw`: of the fixed jaw, at the end."""
    if not touched:
        return MISSED
    return HELD if np.linalg.norm(place - jaw) < 0.12 and place[2] > LIFT_M / 2 else SLIPPED


def start(grasp: Grasp):
    """(place, quaternion) of the object."""
    return np.array((*grasp.aside, grasp.half[2])), np.array((math.cos(grasp.turn_rad / 2), 0, 0, math.sin(grasp.turn_rad / 2)))


def jaws(grasp: Grasp) -> list[np.ndarray]:
    """Where the fixed jaw and the sliding one begin."""
    return [np.array((0.0, side * (OPEN_M + JAW[1]), grasp.height)) for side in (-1, 1)]


# MuJoCo -----------------------------------------------------------------------------------------------------------------------------


def scene_xml(grasp: Grasp) -> str:
    text = lambda numbers: " ".join(f"{v:.9g}" for v in numbers)  # noqa: E731
    place, turn = start(grasp)
    size = grasp.half if grasp.kind == "box" else (grasp.half[0], grasp.half[2])
    fixed, sliding = jaws(grasp)
    pair = f'condim="4" friction="{grasp.friction} {grasp.friction} 0.002 0 0" solref="0.004 1" solimp=".95 .99 .0005"'
    pairs = "".join(f'<pair geom1="g{k}" geom2="o" {pair}/>' for k in range(2))
    pairs += f'<pair geom1="ground" geom2="o" {pair}/>'
    return (
        f'<mujoco><option timestep="{MUJOCO_S}" gravity="0 0 -{GRAVITY}" cone="elliptic" impratio="20" noslip_iterations="5" integrator="implicitfast"/>'
        '<default><geom contype="0" conaffinity="0"/></default><worldbody>'
        '<geom name="ground" type="plane" size="5 5 1"/>'
        f'<body name="fixed" pos="{text(fixed)}"><joint name="along" type="slide" axis="1 0 0"/><joint name="up" type="slide" axis="0 0 1"/>'
        f'<geom name="g0" type="box" size="{text(JAW)}" mass="{CARRIER_KG:.9g}"/>'
        f'<body name="sliding" pos="{text(sliding - fixed)}"><joint name="closes" type="slide" axis="0 -1 0"/>'
        f'<geom name="g1" type="box" size="{text(JAW)}" mass="{JAW_KG}"/></body></body>'
        f'<body name="o" pos="{text(place)}" quat="{text(turn)}"><freejoint/><inertial pos="0 0 0" mass="{grasp.mass_kg:.9g}" '
        f'diaginertia="{text(grasp.inertia)}"/><geom name="o" type="{grasp.kind}" size="{text(size)}"/></body>'
        f'</worldbody><actuator><position joint="closes" kp="{DRIVE_N_M}" kv="{2 * math.sqrt(DRIVE_N_M * JAW_KG):.9g}" '
        f'forcerange="{-grasp.force_n:.9g} {grasp.force_n:.9g}"/></actuator><contact>{pairs}</contact></mujoco>'
    )


def record(grasp: Grasp) -> dict:
    """What MuJoCo makes of it: the outcome, and the object's poses each STEP_S, (steps + 1, 7)."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(scene_xml(grasp))
    data = mujoco.MjData(model)
    joints = [model.joint(name) for name in ("along", "up")]
    at = [(int(j.qposadr[0]), int(j.dofadr[0])) for j in joints]
    geoms = {model.geom(f"g{k}").id for k in range(2)}
    thing = model.geom("o").id
    mujoco.mj_forward(model, data)
    poses, touched = [np.concatenate((data.body("o").xpos, data.body("o").xquat))], False
    next_s = STEP_S
    for n in range(round(END_S / MUJOCO_S)):
        t = n * MUJOCO_S
        # The gripper goes its way whatever pulls at it. It is heavy and carried, so that contacts know how it accelerates.
        before, here, there = way(t - MUJOCO_S), way(t), way(t + MUJOCO_S)
        for axis in range(2):
            q, v = at[axis]
            data.qpos[q], data.qvel[v] = here[axis], (here[axis] - before[axis]) / MUJOCO_S
            acceleration = (there[axis] - 2 * here[axis] + before[axis]) / MUJOCO_S**2 + GRAVITY * axis
            data.qfrc_applied[v] = (CARRIER_KG + JAW_KG) * acceleration
        data.ctrl[:] = asked(t + MUJOCO_S)
        mujoco.mj_step(model, data)
        touched = touched or any({int(c.geom1), int(c.geom2)} & geoms and thing in (c.geom1, c.geom2) and c.dist < 0 for c in data.contact)
        if data.time >= next_s - MUJOCO_S / 2:
            poses.append(np.concatenate((data.body("o").xpos, data.body("o").xquat)))
            next_s += STEP_S
    return {"outcome": outcome(touched, poses[-1][:3], data.body("fixed").xpos), "poses": np.array(poses)}


# The runtime ------------------------------------------------------------------------------------------------------------------------


def corners(half) -> np.ndarray:
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half


def points(grasp: Grasp) -> np.ndarray:
    """The outline of the object: corners of the box, or two rings."""
    if grasp.kind == "box":
        return corners(grasp.half)
    angle = np.arange(AROUND) * (2 * math.pi / AROUND)
    ring = np.stack((np.cos(angle), np.sin(angle)), 1) * grasp.half[0]
    return np.concatenate([np.column_stack((ring, np.full(AROUND, z * grasp.half[2]))) for z in (-1, 1)])


def pose(place, turn=(1.0, 0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array((*place, *turn))


class Hand:
    """A world with the gripper and the object, before it closes."""

    def __init__(self, model, grasp: Grasp, network: bool = True, step_s: float = STEP_S):
        import rigidformer

        self.grasp, self.step_s = grasp, step_s
        self.world = world = rigidformer.World(model, units=4, points=256, threads=1)
        world.dt_s, world.gravity_m_s2 = step_s, (0.0, 0.0, -GRAVITY)
        world.network = network
        world.planes = [rigidformer.Plane((0.0, 0.0, 1.0), 0.0, 1.0, 0.0)]
        self.first, sliding = jaws(grasp)
        jaw = {"friction": 1.0, "restitution": 0.0, "body": 1}
        self.fixed = world.add(rigidformer.Unit(corners(JAW), 1.0, role="driven", **jaw), pose(self.first))
        self.sliding = world.add(rigidformer.Unit(corners(JAW), JAW_KG, **jaw), pose(sliding))
        world.join(self.sliding, self.fixed, np.zeros(3), sliding - self.first, kind="prismatic", axis=(0.0, -1.0, 0.0),
                   max_force=grasp.force_n)  # fmt: skip
        unit = rigidformer.Unit(points(grasp), grasp.mass_kg, grasp.friction, 0.0, inertia_kg_m2=grasp.inertia)
        self.thing = world.add(unit, pose(*start(grasp)))
        self.place, self.time_s, self.touched = self.first, 0.0, False

    def step(self) -> np.ndarray:
        """The object's pose at the end of a step."""
        end = self.time_s + self.step_s
        along, up = way(end)
        self.place = self.first + (along, 0.0, up)
        self.world.drive(self.fixed, pose(self.place))
        self.world.set_joint_target(self.sliding, asked(end))
        self.world.step()
        self.time_s = end
        # What keeps the jaws apart is between them.
        self.touched = self.touched or (end > REST_S + CLOSE_S + 0.05 and asked(end) - self.world.joint_position(self.sliding) > 0.002)
        return self.world.pose(self.thing)

    def outcome(self) -> str:
        moved = np.linalg.norm(self.world.pose(self.thing)[:2] - start(self.grasp)[0][:2]) > 0.001
        return outcome(self.touched or moved, self.world.pose(self.thing)[:3], self.place)


def predict(model, grasp: Grasp, network: bool = True) -> dict:
    """What the runtime makes of it: as `record`."""
    hand = Hand(model, grasp, network)
    poses = [hand.world.pose(hand.thing)]
    for _ in range(round(END_S / STEP_S)):
        poses.append(hand.step())
    return {"outcome": hand.outcome(), "poses": np.array(poses)}


# Comparison -------------------------------------------------------------------------------------------------------------------------


def apart(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    turn = 2 * math.degrees(math.acos(min(1.0, abs(float(a[3:] @ b[3:])) / float(np.linalg.norm(a[3:]) * np.linalg.norm(b[3:])))))
    return float(np.linalg.norm(a[:3] - b[:3])), turn


def seeds_that_fit(first: int, count: int) -> list[int]:
    seeds, seed = [], first
    while len(seeds) < count:
        if fits(draw(seed)):
            seeds.append(seed)
        seed += 1
    return seeds


def compare(model, seeds, network: bool = True) -> dict:
    """Outcomes and poses after the lift beside MuJoCo's, a row for each seed."""
    lifted = round((REST_S + CLOSE_S + LIFT_S + HANG_S) / STEP_S)
    rows = []
    for seed in tqdm(seeds, disable=not sys.stderr.isatty(), unit="grasp"):
        grasp = draw(seed)
        truth, found = record(grasp), predict(model, grasp, network)
        metres, degrees = apart(truth["poses"][lifted], found["poses"][lifted])
        rows.append({"seed": seed, **asdict(grasp), "recorded": truth["outcome"], "predicted": found["outcome"], "m": metres, "deg": degrees})
    right = [row["recorded"] == row["predicted"] for row in rows]
    held = [row for row in rows if row["recorded"] == HELD and row["predicted"] == HELD]
    kinds = (HELD, SLIPPED, MISSED)
    return {
        "grasps": len(rows),
        "right": sum(right),
        "table": {a: {b: sum(r["recorded"] == a and r["predicted"] == b for r in rows) for b in kinds} for a in kinds},
        "held_m_median": float(np.median([row["m"] for row in held])) if held else None,
        "held_deg_median": float(np.median([row["deg"] for row in held])) if held else None,
        "rows": rows,
    }


def another(grasp: Grasp, seed: int, number: int) -> Grasp:
    """Another grasp of the same object, by a hand of the same strength: where it closes, and how it is turned."""
    rng = np.random.default_rng([918, seed, number])
    while True:
        turn = float(rng.uniform(-math.pi / 2, math.pi / 2))
        x, y, z = grasp.half
        aside = float(rng.uniform(-1.4, 1.4) * max(x, y)), float(rng.uniform(-0.02, 0.02))
        height = float(rng.uniform(JAW[2] + 0.004, max(JAW[2] + 0.005, 2 * z + JAW[2])))
        new = replace(grasp, turn_rad=turn, aside=aside, height=height)
        if fits(new):
            return new


def choose(model, grasp: Grasp, seed: int, count: int, network: bool = True) -> Grasp:
    """Of `count` grasps the one whose object the runtime moves least in the hand while it is shaken, of those that hold."""
    best, least = None, math.inf
    for number in range(count):
        tried = another(grasp, seed, number)
        hand = Hand(model, tried, network)
        first = None
        for _ in range(round(END_S / STEP_S)):
            hand.step()
            if first is None and hand.time_s > REST_S + CLOSE_S:
                first = hand.world.pose(hand.thing)[:3] - hand.place
        slid = float(np.linalg.norm(hand.world.pose(hand.thing)[:3] - hand.place - first))
        cost = slid if hand.outcome() == HELD else 1.0 + slid
        if cost < least:
            best, least = tried, cost
    return best


def strong_enough(grasp: Grasp) -> Grasp:
    """The same hand, with at least twice what a good grasp needs: choosing is about where to hold."""
    return replace(grasp, force_n=max(grasp.force_n, 2.5 * grasp.mass_kg * GRAVITY / (2 * grasp.friction)))


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", required=True, type=Path, help="packed model that moves by impulses, such as edge-i8.rfm")
    parser.add_argument("--seeds", type=int, default=200, help="grasps (default %(default)s)")
    parser.add_argument("--first-seed", type=int, default=200_001, help="default %(default)s")
    parser.add_argument("--choose", type=int, metavar="N", help="choose one of so many grasps of each object")
    parser.add_argument("--no-network", action="store_true", help="move by impulses alone")
    parser.add_argument("--json", type=Path, metavar="FILE", help="where all rows go")
    args = parser.parse_args(argv)
    if args.seeds < 1 or args.first_seed < 0 or (args.choose is not None and args.choose < 1):
        parser.error("--seeds and --choose take numbers from 1, --first-seed from 0")
    import rigidformer

    model = rigidformer.Model(args.model)
    seeds = seeds_that_fit(args.first_seed, args.seeds)
    if args.choose:
        rows = []
        for seed in tqdm(seeds, disable=not sys.stderr.isatty(), unit="object"):
            grasp = strong_enough(draw(seed))
            first, best = another(grasp, seed, 0), choose(model, grasp, seed, args.choose, not args.no_network)
            rows.append({"seed": seed, "chosen": record(best)["outcome"], "first": record(first)["outcome"], **asdict(best)})
        held = {name: sum(row[name] == HELD for row in rows) for name in ("chosen", "first")}
        document = {"objects": len(rows), "held": held, "rows": rows}
        print(f"of {len(rows)} objects MuJoCo holds {held['chosen']} by the chosen grasp, {held['first']} by the first of {args.choose}")
    else:
        document = compare(model, seeds, not args.no_network)
        print(f"{document['right']} of {document['grasps']} outcomes are right")
        for recorded, row in document["table"].items():
            print(f"  {recorded} by MuJoCo: " + ", ".join(f"{count} {name}" for name, count in row.items()))
        if document["held_m_median"] is not None:
            print(f"object after the lift, median: {1000 * document['held_m_median']:.2f} mm, {document['held_deg_median']:.2f} degrees")
    if args.json:
        from .movi import write_text

        write_text(args.json, json.dumps(document, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
