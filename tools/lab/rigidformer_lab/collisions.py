"""Two bodies that hit once: the solver and other engines beside the closed form of a rigid impact.

    python -m rigidformer_lab.collisions --out DIR --program rigidformer --rapier rigidformer-analytic

For each case a scene file is written to DIR whose motion is the closed form: Newton's restitution and Coulomb's friction at
one point, no gravity. A file has SETTINGS x PHASES scenes of two free bodies: frictions and restitutions, and starts that are parts of a
frame from each other. Errors are those of `rigidformer evaluate` at frame 100: root mean squares over both bodies, then means over
scenes. They are given in per cent of the way of the approach since the touch, turns as arcs at half a side of the boxes.

`--program` runs impulses alone at the step codes 1 and 10, `--rapier` the tool of tools/analytic. Bullet and MuJoCo run here, at
2,400 and 24,000 steps a second: Bullet with the settings of the MOVi scenes, and with `erp 0` without what it adds to push bodies
apart. MuJoCo has springs and dampers, here of half a millisecond and the damping that gives the restitution to a head-on hit.
Engines without a given program are left out.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from . import bullet
from .movi import FRAME_RATE_HZ, GOLDEN_ANGLE
from .scenes import TEST, Scenes, write_scenes

SIZE_M = 0.1  # half a side of boxes, and the radius of balls
BALL_POINTS = 160
HEIGHT_M = 10.0  # far from the ground, which engines may want
SETTINGS = ((0.0, 0.5), (0.0, 1.0), (0.1, 0.5), (0.9, 0.5))  # friction and restitution of the pair
PHASES = 12
TOUCH_FRAME = 13  # the first start touches so many frames after frame 0; step code 10 observes frame 10
SPREAD_FRAMES = 10 / 6  # a solver's substep at step code 10
FRAMES, LAST_FRAME = 101, 100
STEPS = (1, 10)
BULLET_SUB_STEPS, MUJOCO_SUB_STEPS = 10, 100
MUJOCO_PULSE_S = 5e-4
#: Moments of inertia in masses times the square of SIZE_M; a hollow ball has all of its mass at the surface.
MOMENTS = {"box": 2 / 3, "ball": 2 / 5, "hollow": 2 / 3}


@dataclass(frozen=True)
class Body:
    """A body as it touches the other one, in metres, m/s and rad/s."""

    kind: str
    centre: np.ndarray
    velocity: np.ndarray
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    mass: float = 1.0
    spin: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def moment(self) -> float:
        return MOMENTS[self.kind] * self.mass * SIZE_M**2


@dataclass(frozen=True)
class Impact:
    """Two bodies that touch at a point; the normal goes from the first to the second."""

    name: str
    bodies: tuple[Body, Body]
    point: np.ndarray
    normal: np.ndarray

    @property
    def approach_m_s(self) -> float:
        first, second = self.bodies
        return float(np.linalg.norm(first.velocity - second.velocity))

    def after(self, friction: float, restitution: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Velocity and spin of both bodies after the impact."""
        arms = [self.point - body.centre for body in self.bodies]
        soft = np.zeros((3, 3))
        for body, arm in zip(self.bodies, arms):
            cross = _cross_matrix(arm)
            soft += np.eye(3) / body.mass - cross @ cross / body.moment

        def hit(impulse):
            return [
                (body.velocity + sign * impulse / body.mass, body.spin + sign * np.cross(arm, impulse) / body.moment)
                for body, arm, sign in zip(self.bodies, arms, (-1, 1))
            ]

        def leaving(motion):
            (v, w), (u, q) = motion
            return u + np.cross(q, arms[1]) - v - np.cross(w, arms[0])

        n = self.normal
        before = leaving(hit(np.zeros(3)))
        approach = before @ n
        impulse = np.linalg.solve(soft, -restitution * approach * n - before)
        if np.linalg.norm(impulse - n * (impulse @ n)) > friction * (impulse @ n):
            slides = before - n * approach
            for _ in range(50):
                size = np.linalg.norm(slides)
                along = n - (friction * slides / size if size > 1e-9 else 0)
                impulse = along * (-(1 + restitution) * approach / (n @ soft @ along))
                after = leaving(hit(impulse))
                turned = after - n * (after @ n)
                if np.linalg.norm(turned) < 1e-9:
                    break
                slides = turned
        return hit(impulse)


def _cross_matrix(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def points(kind: str) -> np.ndarray:
    """Corners of the box, or points about evenly over a ball."""
    if kind == "box":
        return np.array(np.meshgrid(*[(-SIZE_M, SIZE_M)] * 3, indexing="ij")).reshape(3, -1).T
    up = 1 - (2 * np.arange(BALL_POINTS) + 1) / BALL_POINTS
    turn = GOLDEN_ANGLE * np.arange(BALL_POINTS)
    across = np.sqrt(1 - up**2)
    return SIZE_M * np.column_stack([across * np.cos(turn), across * np.sin(turn), up])


def _tip(rotation):
    """The corner or the middle of an edge that is farthest along x."""
    at = points("box") @ rotation.T
    return at[at[:, 0] > at[:, 0].max() - 1e-9].mean(0)


def impacts() -> list[Impact]:
    """All cases. Of two bodies the second is 2.5 times as heavy, but for faces, which meet as one point only where the bodies are alike."""
    v = lambda *x: np.array(x, float)  # noqa: E731
    x, still = v(1, 0, 0), v(0, 0, 0)
    size = SIZE_M

    def pair(name, first, second, point, normal=x):
        heavy = 1.0 if name.startswith("face") else 2.5
        return Impact(name, (first, replace(second, mass=heavy)), point, normal)

    aside = v(0.75**0.5, 0.5, 0)
    corner = Rotation.from_rotvec([0, np.arctan(0.5**0.5), 0]).as_matrix() @ Rotation.from_rotvec([0, 0, np.pi / 4]).as_matrix()
    tilted = Rotation.from_rotvec([0, 0.1, 0.2]).as_matrix() @ corner
    upright, level = (Rotation.from_rotvec(np.pi / 4 * axis).as_matrix() for axis in (v(0, 1, 0), v(0, 0, 1)))
    far = size * 2**0.5
    end, tilted_end = _tip(corner), _tip(tilted)
    return [
        pair("balls, head on", Body("ball", still, x), Body("ball", v(2 * size, 0, 0), still), v(size, 0, 0)),
        pair("balls, offset", Body("ball", still, x), Body("ball", 2 * size * aside, still), size * aside, aside),
        pair("balls, offset, 5 m/s", Body("ball", still, 5 * x), Body("ball", 2 * size * aside, still), size * aside, aside),
        pair("hollow balls, offset", Body("hollow", still, x), Body("hollow", 2 * size * aside, still), size * aside, aside),
        pair("ball to face, oblique", Body("ball", still, v(1, -0.5, 0)), Body("box", v(2 * size, 0.05, 0.02), still), v(size, 0, 0)),
        pair("corner to face", Body("box", still, x, corner), Body("box", end + v(size, 0, 0), still), end),
        pair("corner to face, tilted", Body("box", still, v(1, 0.3, 0), tilted), Body("box", tilted_end + v(size, 0.05, 0.02), still), tilted_end),
        pair("edge to edge", Body("box", still, x, upright), Body("box", v(2 * far, 0, 0), still, level), v(far, 0, 0)),
        pair("edge to edge, offset", Body("box", still, x, upright), Body("box", v(2 * far, 0.04, 0.03), still, level), v(far, 0.04, 0)),
        pair("face to face", Body("box", still, x), Body("box", v(2 * size, 0, 0), still), v(size, 0, 0)),
        pair("face to face, offset", Body("box", still, x), Body("box", v(2 * size, 0.08, 0), still), v(size, 0.04, 0)),
    ]


def touch_frames() -> np.ndarray:
    """Frame of the touch of each phase."""
    return TOUCH_FRAME + SPREAD_FRAMES * (np.arange(PHASES) + 0.5) / PHASES


def pose(centre, rotation) -> np.ndarray:
    """(7): position and quaternion w, x, y, z."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return np.array([*centre, w, x, y, z])


def path(impact: Impact, friction: float, restitution: float, touch: float) -> np.ndarray:
    """(2, FRAMES, 7) poses of the closed form, raised by HEIGHT_M."""
    after = impact.after(friction, restitution)
    out = np.empty((2, FRAMES, 7))
    for frame in range(FRAMES):
        time = (frame - touch) / FRAME_RATE_HZ
        for unit, body in enumerate(impact.bodies):
            velocity, spin = (body.velocity, body.spin) if time < 0 else after[unit]
            rotation = Rotation.from_rotvec(spin * time).as_matrix() @ body.rotation
            out[unit, frame] = pose(body.centre + velocity * time + [0, 0, HEIGHT_M], rotation)
    bullet.steady_signs(out)
    return out


def scenes(impact: Impact) -> Scenes:
    """The scene file of a case."""
    kinds = sorted({body.kind for body in impact.bodies})
    shapes = [points(kind) for kind in kinds]
    runs = [(f, e, touch) for f, e in SETTINGS for touch in touch_frames()]
    physics = [(body.mass, f**0.5, e**0.5) for f, e, _ in runs for body in impact.bodies]
    count = len(runs)
    return Scenes(
        dataset="collisions",
        shape_names=kinds,
        shape_points=np.concatenate(shapes).astype(np.float32),
        shape_offsets=np.cumsum([0, *map(len, shapes)]).astype(np.int64),
        scene_seed=np.arange(count, dtype=np.int64),
        scene_split=np.full(count, TEST, np.uint8),
        scene_units=2 * np.arange(count + 1, dtype=np.int64),
        unit_shape=np.tile([kinds.index(body.kind) for body in impact.bodies], count).astype(np.int32),
        unit_scale=np.ones(2 * count, np.float32),
        unit_physics=np.array(physics, np.float32),
        unit_poses=np.concatenate([path(impact, *run) for run in runs]).astype(np.float32),
        provenance=f"Closed form of a rigid impact, by rigidformer_lab.collisions: {impact.name}",
        licence="the licence of the rigidformer project",
        frame_rate_hz=FRAME_RATE_HZ,
        gravity_m_s2=(0.0, 0.0, 0.0),
        ground_friction=1.0,
        ground_restitution=1.0,
        unit_inertia=np.repeat(np.tile([body.moment for body in impact.bodies], count)[:, None], 3, 1).astype(np.float32),
    )


def errors(found: np.ndarray, closed: np.ndarray) -> tuple[float, float]:
    """Of (2, 7) poses: metres and degrees, root mean squares over both bodies."""
    away = np.linalg.norm(found[:, :3] - closed[:, :3], axis=1)
    turn = [(_rotation(a) * _rotation(b).inv()).magnitude() for a, b in zip(found, closed)]
    return float(np.sqrt(np.mean(away**2))), float(np.degrees(np.sqrt(np.mean(np.square(turn)))))


def _rotation(pose):
    return Rotation.from_quat([*pose[4:], pose[3]])


def in_bullet(impact: Impact, friction: float, restitution: float, touch: float, erp: float | None = None) -> np.ndarray:
    """(2, 7): poses at the last frame."""
    with bullet.engine((0, 0, 0), 1.0 / (FRAME_RATE_HZ * BULLET_SUB_STEPS)) as (pb, on):
        if erp is not None:
            pb.setPhysicsEngineParameter(erp=erp, contactERP=erp, **on)
        numbers = []
        for body in impact.bodies:
            if body.kind == "box":
                shape = pb.createCollisionShape(pb.GEOM_MESH, vertices=points("box").tolist(), **on)
            else:
                shape = pb.createCollisionShape(pb.GEOM_SPHERE, radius=SIZE_M, **on)
            start = pose(body.centre - body.velocity * touch / FRAME_RATE_HZ + [0, 0, HEIGHT_M], body.rotation)
            number = bullet.add_body(pb, on, shape, body.mass, friction**0.5, restitution**0.5, start[:3], start[3:])
            pb.changeDynamics(number, -1, localInertiaDiagonal=[body.moment] * 3, linearDamping=0, angularDamping=0, **on)
            pb.resetBaseVelocity(number, body.velocity, body.spin, **on)
            numbers.append(number)
        for _ in range(LAST_FRAME * BULLET_SUB_STEPS):
            pb.stepSimulation(**on)
        return np.array([bullet.pose_of(pb, on, number) for number in numbers])


def in_mujoco(impact: Impact, friction: float, restitution: float, touch: float) -> np.ndarray:
    """(2, 7): poses at the last frame."""
    import mujoco

    pace = np.pi / MUJOCO_PULSE_S
    loss = -np.log(restitution)
    damping = 2 * pace * loss / np.hypot(np.pi, loss)
    bodies = ""
    for body in impact.bodies:
        start = pose(body.centre - body.velocity * touch / FRAME_RATE_HZ, body.rotation)
        shape = f'type="box" size="{SIZE_M} {SIZE_M} {SIZE_M}"' if body.kind == "box" else f'type="sphere" size="{SIZE_M}"'
        bodies += (
            f'<body pos="{start[0]} {start[1]} {start[2]}" quat="{start[3]} {start[4]} {start[5]} {start[6]}"><freejoint/>'
            f'<inertial pos="0 0 0" mass="{body.mass}" diaginertia="{body.moment} {body.moment} {body.moment}"/><geom {shape}/></body>'
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{1 / (FRAME_RATE_HZ * MUJOCO_SUB_STEPS)}" gravity="0 0 0" cone="elliptic" impratio="100"/>'
        f'<default><geom friction="{max(friction, 1e-5)} 0 0" condim="3" solref="{-(pace**2)} {-damping}" solimp="0.9999 0.9999 0.001"/>'
        f"</default><worldbody>{bodies}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    for unit, body in enumerate(impact.bodies):
        # A free joint's spin is in the body's own axes.
        data.qvel[6 * unit : 6 * unit + 6] = [*body.velocity, *(body.rotation.T @ body.spin)]
    for _ in range(LAST_FRAME * MUJOCO_SUB_STEPS):
        mujoco.mj_step(model, data)
    return data.qpos.reshape(2, 7) + [0, 0, HEIGHT_M, 0, 0, 0, 0]


ENGINES = {
    "Bullet": in_bullet,
    "Bullet, erp 0": lambda *run: in_bullet(*run, erp=0.0),
    "MuJoCo": in_mujoco,
}


def in_engines(impact: Impact) -> dict[str, tuple[float, float]]:
    """Metres and degrees of each engine that runs here, means over scenes."""
    sums = {name: np.zeros(2) for name in ENGINES}
    runs = [(f, e, touch) for f, e in SETTINGS for touch in touch_frames()]
    for run in runs:
        closed = path(impact, *run)[:, LAST_FRAME]
        for name, engine in ENGINES.items():
            sums[name] += errors(engine(impact, *run), closed)
    return {name: tuple(sum_ / len(runs)) for name, sum_ in sums.items()}


def _at_last_frame(frames: list[dict]) -> tuple[float, float]:
    (last,) = (frame for frame in frames if frame["frame"] == LAST_FRAME)
    return last["position_m"], last["orientation_rms_deg"]


def _json(command: list[str]) -> dict:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def in_programs(file: Path, program: str | None, rapier: str | None) -> dict[str, tuple[float, float]]:
    """Metres and degrees of the solver and of Rapier, as their programs tell."""
    found = {}
    if program:
        steps = ",".join(map(str, STEPS))
        told = _json([program, "evaluate", str(file), "--without-network", "--steps", steps, "--json"])
        for step in told["model"]["steps"]:
            found[f"impulses, s = {step['step']}"] = _at_last_frame(step["figures"]["frames"])
    if rapier:
        told = _json([rapier, "rapier", str(file), "--steps", "1", "--inertia", "file", "--balls", "--json"])
        found["Rapier"] = _at_last_frame(told["rapier"]["steps"][0]["frames"])
    return found


def in_per_cent(impact: Impact, metres: float, degrees: float) -> tuple[float, float]:
    """Of the way of the approach since the touch; degrees as arcs at SIZE_M."""
    way = impact.approach_m_s * (LAST_FRAME - touch_frames().mean()) / FRAME_RATE_HZ
    return 100 * metres / way, 100 * np.radians(degrees) * SIZE_M / way


def table(rows: dict[str, dict[str, tuple[float, float]]]) -> str:
    """As text: a line a case, a column an engine."""
    names = list(next(iter(rows.values())))
    width = max(map(len, rows))
    lines = [" " * width + "".join(f"{name:>18}" for name in names)]
    for case, cells in rows.items():
        lines.append(f"{case:<{width}}" + "".join(f"{cells[name][0]:>10.2f} /{cells[name][1]:>6.2f}" for name in names))
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for the scene files")
    parser.add_argument("--program", metavar="FILE", help="rigidformer")
    parser.add_argument("--rapier", metavar="FILE", help="rigidformer-analytic")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of a table")
    options = parser.parse_args(arguments)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        rows = {}
        for impact in impacts():
            file = options.out / f"{impact.name.replace(', ', '-').replace(' ', '-').replace('/', '')}.safetensors"
            write_scenes(file, scenes(impact))
            found = in_programs(file, options.program, options.rapier) | in_engines(impact)
            rows[impact.name] = {name: in_per_cent(impact, *cell) for name, cell in found.items()}
    except (OSError, RuntimeError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(json.dumps(rows, indent=2) if options.json else table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
