"""Golden vectors: what PyTorch computes in f64 for small models and a contact-rich scene,
block by block and over a 20-step rollout, for the Rust core to reproduce.

    python -m rigidformer_lab.golden --scenes primitives.safetensors --out tests/data
    python -m rigidformer_lab.golden --cases tiny-roles tiny-similar tiny-impulses tiny-carried --out tests/data

The case tiny-roles is a scene made here, of units of all roles between three planes, and needs no scene file. tiny-similar
is the same at the size of a hand's things, under another gravity, for a model that measures scenes in their own length.
tiny-impulses is tiny-roles for a model that corrects motion by impulses, tiny-carried for one that sees all from the
heading of the heaviest unit. tiny-joints is the scene and the model of tiny-similar, with units that are joined; it has no
model file of its own. Nor has tiny-bonds, the scene and the model of tiny-impulses with units that hold together, and tiny-near,
that model with the scope "near". tiny-breaking is that scene for a model that says which bonds break.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pathlib

import numpy as np
import torch
from safetensors.numpy import save_file

from . import breaking
from .bonds import leads
from .config import PRESETS, ModelConfig
from .evaluate import load
from .export import write_model
from .geometry import prepare_points, quaternion_to_matrix
from .ground import planes_of
from .impacts import extreme_points
from .joints import Pivot, joints_of
from .model import RigidFormer, Scene, State
from .movi import primitive_shapes
from .roles import DRIVEN, FIXED, FREE
from .scenes import TEST, Scenes, read_scenes

STEPS = 20
PURPOSE = {"purpose": "golden vectors"}
#: Step code, first frame, rank of the scene by contacts, seed of the weights. With some weights a box comes to lie on a
#: face, and its lowest corner is one in f32 and another in f64: tiny-impact's do not.
RECORDED = {
    "tiny": (10, 30, 0, 0),
    "tiny-paper-inputs": (1, 60, 1, 1),
    "tiny-impact": (10, 30, 3, 4),
    "edge": (5, 45, 4, 0),  # of ten units one with many contacts, none of them in the first step
}
#: Of some cases: later rounding decides between one contact and another.
FEWER_STEPS = {"edge": 4, "tiny-impact": 14}
ROLES_SEED = 0
#: Of tiny-impulses: frames that the scene begins before the others', and its steps. Where edges meet, rounding decides between
#: one contact and another: of the beginnings tried this is the one with most contacts where f32 and f64 choose alike.
IMPULSES_START, IMPULSES_STEPS = -5.0, 6
#: Of tiny-similar: what lengths and gravity are multiplied by. Times follow.
SIMILAR_LENGTH, SIMILAR_GRAVITY, SIMILAR_MASS = 0.11, 0.7, 0.02
#: The cases of the scene with all roles, and how much of it they have.
ROLES = {"tiny-roles": 12, "tiny-similar": 12, "tiny-impulses": IMPULSES_STEPS, "tiny-carried": 12, "tiny-joints": 12,
         "tiny-bonds": IMPULSES_STEPS, "tiny-breaking": IMPULSES_STEPS, "tiny-near": 5}  # fmt: skip
#: Those that have the model of another.
SHARED = {"tiny-joints": "tiny-similar", "tiny-bonds": "tiny-impulses", "tiny-near": "tiny-impulses"}
#: Of tiny-bonds: pairs that hold together, all of one body, and the frames that the scene begins before the others': chosen as that of
#: tiny-impulses was.
BONDS, BONDS_START = ((4, 5), (5, 8)), -1.0
#: Of tiny-near: frames that the scene begins before the others', chosen as that of tiny-impulses was: from the first step on the network
#: sees some of the units.
NEAR_START = -1.5
#: Of tiny-breaking: what the last layer of its network of bonds, turned round, says more, so that one bond breaks and the other holds.
BREAKING_BIAS = -0.815
#: Of tiny-joints: units and those that they hang from, by pivots half way between their centres. A tree of free ones, whose parents
#: stand behind and before, and two that hang from driven ones.
JOINTS = ((4, 8), (5, 4), (9, 4), (3, 2), (6, 7))


def golden_scene(file, index, frame, step, dtype=torch.float64):
    """One recorded scene as the model sees it: Scene, State, and the raw inputs."""
    rows = np.arange(file.scene_units[index], file.scene_units[index + 1])
    points, locals_, centres = [], [], []
    for u in rows:
        k = file.unit_shape[u]
        shape = file.shape_points[file.shape_offsets[k] : file.shape_offsets[k + 1]]
        reference = (shape * file.unit_scale[u]).astype(np.float32)
        local, centre = prepare_points(reference)
        points.append(reference)
        locals_.append(local)
        centres.append(centre)
    count = np.array([len(p) for p in locals_])
    longest = count.max()
    padded = np.stack([np.pad(p, ((0, longest - len(p)), (0, 0))) for p in locals_])
    put = lambda a: torch.from_numpy(np.ascontiguousarray(a))[None].to(dtype)  # noqa: E731
    whole = lambda a: torch.from_numpy(np.asarray(a, np.int64))[None]  # noqa: E731
    centres = np.stack(centres)

    def pose(f):
        raw = np.asarray(file.unit_poses[rows, f], np.float64)
        rotation = quaternion_to_matrix(raw[:, 3:] / np.linalg.norm(raw[:, 3:], axis=1, keepdims=True))
        return put(rotation), put(np.einsum("uij,uj->ui", rotation, centres) + raw[:, :3])

    previous, current = pose(frame), pose(frame + step)
    scene = Scene(
        points=put(padded), points_in_use=whole(count), mask=torch.ones(1, len(rows), dtype=torch.bool),
        physics=put(file.unit_physics[rows]),
        radius=put([np.linalg.norm(p, axis=1).max() for p in locals_]), reference=previous,
        start=whole(np.concatenate(([0], np.cumsum(count)[:-1]))), count=whole(count),
        scale=put(np.ones(len(rows), np.float32)),
        bank=torch.from_numpy(np.concatenate(locals_)).to(dtype), step=whole(step)[:, None].reshape(1),
    )  # fmt: skip
    hulls = [local[extreme_points(local)] for local in locals_]
    scene = dataclasses.replace(
        scene, extent=put([np.ptp(local, axis=0) for local in locals_]), hull_bank=put(np.concatenate(hulls))[0],
        hull_start=whole(np.cumsum([0] + [len(h) for h in hulls[:-1]])), hull_count=whole([len(h) for h in hulls]),
    )  # fmt: skip
    inputs = {
        "points": np.concatenate(points), "point_counts": count.astype(np.int64),
        "physics": np.asarray(file.unit_physics[rows], np.float32),
        "previous": np.asarray(file.unit_poses[rows, frame], np.float32),
        "current": np.asarray(file.unit_poses[rows, frame + step], np.float32),
    }  # fmt: skip
    return scene, State(*previous, *current), inputs, centres


# The scene of tiny-roles. Nothing of it is aligned with anything, so that f32 and f64 choose the same points.
ROLES_STEPS = 12
ROLES_DT_S = np.float32(6.5 / 240)
ROLES_GRAVITY_M_S2 = np.array([0.5, -1.25, -9.25], np.float32)
ROLES_PLANES = (  # normal, as long as it comes; a point of the plane; friction, restitution
    ((np.sin(np.radians(10)) * 0.8, np.sin(np.radians(10)) * 0.6, np.cos(np.radians(10))), (0, 0, -0.1), 0.35, 0.6),
    ((-0.96, 0.28, 0.02), (1.6, 0, 0), 0.2, 0.8),
    ((0.1, 0.9, 0.3), (0, -1.3, 0), 0.5, 0.4),
)
ROLES_UNITS = (  # shape, scale, role, body, mass kg, friction, restitution, place, axis and angle, velocity, turn a second
    ("sphere", 0.5, FREE, -1, 0.9, 0.5, 0.5, (1.0, -0.95, 0.14), (1, 2, 3, 0.3), (2.5, -2, -1.5), (1, -2, 0.5)),
    ("box", 0.6, FIXED, 1, 50.0, 0.6, 0.3, (-0.2, 0.9, 0.1), (0.2, 0.1, 1, 0.7), (0, 0, 0), (0, 0, 0)),
    ("box_bar", 0.5, DRIVEN, -1, 4.0, 0.7, 0.2, (-0.9, -0.35, 0.3), (0.3, 1, 0.5, 0.4), (1.5, 0.3, 0.1), (0, 0.3, 1)),
    ("box", 0.45, FREE, -1, 1.4, 0.4, 0.6, (-0.32, -0.27, 0.31), (1, 0.4, 0.2, 0.9), (0.2, 0, -0.8), (0.5, 0, 2)),
    ("cylinder", 0.5, FREE, 7, 1.1, 0.3, 0.7, (0.75, 0.35, 0.25), (0.1, 1, 0.3, 1.1), (0.3, -0.9, -1.2), (0.7, 0.9, -0.4)),
    ("box_slab", 0.5, FREE, 7, 1.6, 0.6, 0.5, (0.75, 0.1, 0.35), (0.1, 1, 0.3, 0.8), (0.3, -0.9, -1.2), (0.7, 0.9, -0.4)),
    ("sphere", 0.4, FREE, -1, 0.5, 0.8, 0.7, (-0.12, 0.95, 0.72), (2, 1, 0.3, 0.2), (0.1, 0.1, -2.5), (0, 3, 1)),
    ("cylinder_disc", 0.4, DRIVEN, 1, 2.5, 0.5, 0.4, (0.05, 0.75, 0.4), (1, 0.2, 0.1, 0.6), (0.6, -0.9, 0.2), (0, 1.5, 0)),
    ("box_bar", 0.35, FREE, -1, 0.7, 0.5, 0.5, (0.8, 0.25, 0.83), (0.6, 0.2, 1, 1.3), (0.2, -0.7, -2.6), (2, 1, -1)),
    ("box_slab", 0.3, FREE, -1, 0.4, 0.2, 0.9, (0.2, 0.3, 2.6), (0.7, 1, 0.4, 2.3), (-0.5, 0.4, 0.3), (-1, 2, 3)),
)  # fmt: skip


def _turned(axis_angle, spin, seconds):
    """Quaternion of a rotation by an axis and an angle, then by `spin` (rad/s) for a time."""

    def quaternion(vector):
        angle = np.linalg.norm(vector)
        return np.concatenate(([np.cos(angle / 2)], np.sin(angle / 2) * np.asarray(vector) / max(angle, 1e-12)))

    axis = np.asarray(axis_angle[:3]) / np.linalg.norm(axis_angle[:3])
    w, x, y, z = quaternion(np.asarray(spin) * seconds)
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return left @ quaternion(axis * axis_angle[3])


def _resized(poses, length):
    """Poses (..., 7) in a world of another size."""
    poses = np.array(poses, np.float32)
    poses[..., :3] *= np.float32(length)
    return poses


def _roles_pose(unit, frame):
    """Pose (7) of a unit that keeps its velocity, frames from the current one; driven ones swing about that way, and
    disc-shaped ones rest for the last steps."""
    shape, _, role, _, _, _, _, place, axis_angle, velocity, spin = unit
    if shape == "cylinder_disc":
        frame = min(frame, ROLES_STEPS - 3)
    time = frame * float(ROLES_DT_S)
    swing = np.array([0.05 * np.sin(9 * time), 0.0, 0.04 * (1 - np.cos(7 * time))]) * (role == DRIVEN)
    turn = _turned(axis_angle, spin, time + 0.1 * np.sin(6 * time) * (role == DRIVEN))
    return np.concatenate((np.asarray(place) + np.asarray(velocity) * time + swing, turn)).astype(np.float32)


def roles_scene(length=1.0, pull=1.0, weight=1.0, steps=ROLES_STEPS, start=0.0):
    """Units of all roles between three planes: Scene, State, raw inputs, centres, and the targets of driven units as
    poses (steps, units, 7) and as rotations and centres. Lengths, gravity and masses are multiplied as asked, and the time
    step so that the motion is the same."""
    shapes = primitive_shapes()
    number = {shape.name: k for k, shape in enumerate(shapes)}
    names, scales, roles, bodies, masses, frictions, bounces = zip(*(unit[:7] for unit in ROLES_UNITS))
    units = len(ROLES_UNITS)
    file = Scenes(
        dataset="roles", shape_names=list(number), shape_points=np.concatenate([s.points for s in shapes]),
        shape_offsets=np.cumsum([0] + [len(s.points) for s in shapes]), scene_seed=np.zeros(1, np.int64),
        scene_split=np.full(1, TEST, np.uint8), scene_units=np.array([0, units]),
        unit_shape=np.array([number[name] for name in names], np.int32),
        unit_scale=np.array(scales, np.float32) * np.float32(length),
        unit_physics=np.column_stack((np.array(masses) * weight, frictions, bounces)).astype(np.float32),
        unit_poses=_resized([[_roles_pose(unit, start + frame) for frame in (-1, 0)] for unit in ROLES_UNITS], length),
        provenance="", licence="",
    )  # fmt: skip
    scene, state, inputs, centres = golden_scene(file, 0, 0, 1)
    rows = []
    for normal, point, friction, restitution in ROLES_PLANES:
        normal = np.asarray(normal) / np.linalg.norm(normal)
        rows.append([*normal, normal @ np.asarray(point) * length, friction, restitution])
    planes = np.array(rows, np.float32)
    identity = np.array([0, 0, 0, 1, 0, 0, 0], np.float32)
    targets = _resized([
        [_roles_pose(unit, start + step + 1) if unit[2] == DRIVEN else identity for unit in ROLES_UNITS]
        for step in range(steps)
    ], length)  # fmt: skip
    gravity = ROLES_GRAVITY_M_S2 * np.float32(pull)
    dt = ROLES_DT_S if length == pull else np.float32(ROLES_DT_S * np.sqrt(length / pull))
    put = lambda a: torch.from_numpy(np.asarray(a)).double()  # noqa: E731
    quaternion = targets[..., 3:].astype(np.float64)
    rotation = quaternion_to_matrix(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True))
    centre = np.einsum("suij,uj->sui", rotation, centres) + targets[..., :3]
    scene = dataclasses.replace(
        scene, step=put([dt * np.float64(PRESETS["tiny-roles"].frame_rate_hz)]), role=torch.tensor([roles]),
        body=torch.tensor([bodies]), planes=planes_of(put(planes)[None]), gravity=put(gravity)[None],
    )  # fmt: skip
    inputs |= {
        "role": np.array(roles, np.int64), "body": np.array(bodies, np.int64), "planes": planes,
        "gravity": gravity, "dt": np.array([dt]), "targets": targets,
    }  # fmt: skip
    return scene, state, inputs, centres, (put(rotation), put(centre))


def record(model: RigidFormer, scene, state, inputs, centres, command, points, targets=None, steps=STEPS):
    """One traced step and the rollout, as flat f32 tensors. targets: rotations and centres of driven units (steps, units,
    ...), as many as there are steps. Of models that break bonds the rollout alone, and what they say of bonds
    that hold, which impulses act on."""
    out = dict(inputs)
    trace = {}
    breaks = bool(model.config.bonds)
    holds = scene.bonds.mask if breaks else None

    def with_targets(state, step):
        if targets is None:
            return state
        rotation, centre = targets
        return dataclasses.replace(state, target_rotation=rotation[step][None], target_centre=centre[step][None])

    with torch.no_grad():
        if not breaks:
            _, _, active = model.step(scene, with_targets(state, 0), trace)
        inside = torch.arange(scene.points.shape[2]) < scene.points_in_use[..., None]
        if points and not breaks:
            out["features"] = trace["features"][inside].numpy()
            if model.config.has_impacts:
                out["impacts"] = trace["impacts"].numpy()
                out["pushes"] = trace["pushes"][0].numpy()
            out["point_features"] = trace["point_features"][inside].numpy()
        if not breaks:
            for i in range(model.config.blocks + 1):
                out[f"tokens_{i}"] = trace[f"block_{i}"][0].numpy()
            out["head"] = trace["head"][0].numpy()
            if model.config.scope != "all":
                out["seen"] = trace["seen"][0].numpy().astype(np.int64)
            out["advanced"] = trace["advanced"][0].numpy()  # in the scene's measure, as all layers
            out["active"] = active[0].numpy().astype(np.int64)
        poses, used, held, said = [], [], [], []
        for step in range(steps if targets is None else len(targets[0])):
            if breaks:
                asked = breaking.said(model, scene, with_targets(state, step), holds)
                said.append(torch.where(holds, asked, breaking.NEVER)[0].numpy())
                state, holds, active = breaking.step(model, scene, with_targets(state, step), holds)
                held.append(holds[0].numpy())
            else:
                state, _, active = model.step(scene, with_targets(state, step))
            rotation, centre = state.rotation[0].numpy(), state.centre[0].numpy()
            position = centre - np.einsum("uij,uj->ui", rotation, centres)
            poses.append(np.concatenate((position[..., None], rotation), -1))
            used.append(active[0].numpy())
    out["rollout"] = np.stack(poses)  # (steps, units, 3, 4): translation, then rotation columns
    out["rollout_active"] = np.stack(used).astype(np.int64)
    if breaks:
        out["rollout_holds"] = np.stack(held).astype(np.int64)
        out["breaking"] = np.stack(said)  # by step
    if command is not None:
        out["command"] = command
    return {k: v.astype(np.float32) if v.dtype.kind == "f" else v for k, v in out.items()}


def small_random_model(config: ModelConfig, scene, state, seed):
    """Weights at which every layer matters and the head moves things by decimetres a second."""
    torch.manual_seed(seed)
    model = RigidFormer(config)
    for p in model.parameters():
        if p.dim() == 2:
            torch.nn.init.normal_(p, std=0.7 * p.shape[1] ** -0.5)
        elif p.dim() == 1:
            p.data.add_(torch.randn_like(p) * 0.05)
    model = model.double()
    raw = model.features(scene, state).flatten(0, 2)
    model.encoder.feature_mean.copy_(raw.mean(0).float())
    model.encoder.feature_scale.copy_((1 / raw.std(0).clamp(min=1e-2)).float())
    if config.has_impacts:
        rows, valid, _ = model.impacts(scene, state)
        model.encoder.impact_mean.copy_(rows[valid].mean(0).float())
        model.encoder.impact_scale.copy_((1 / rows[valid].std(0).clamp(min=1e-2)).float())
    for p in list(model.parameters()) + list(model.buffers()):
        p.data.copy_(p.data.float())  # exactly what the packed file will hold
    return model


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=pathlib.Path, help=f"scene file, for all cases but {', '.join(ROLES)}")
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--cases", nargs="+", choices=[*RECORDED, *ROLES], help="default: those that can be made")
    parser.add_argument("--index", type=int, default=None, help="scene in the file; default: the one with most contacts")
    parser.add_argument("--trained", type=pathlib.Path, help="checkpoint: also a rollout of this model")
    args = parser.parse_args()
    wanted = args.cases or [*(RECORDED if args.scenes else ()), *ROLES]
    if args.scenes is None and any(name in RECORDED for name in wanted):
        parser.error(f"{' '.join(name for name in wanted if name in RECORDED)} needs --scenes, a scene file")
    file = args.scenes and read_scenes(args.scenes)
    for name, (step, frame, rank, seed) in RECORDED.items():
        if name not in wanted or (name == "edge" and not args.trained):
            continue
        test = np.flatnonzero(np.asarray(file.scene_split) == TEST)
        order = sorted(test, key=lambda s: -contacts(file, s, frame, frame + step * (STEPS + 1)))
        index = order[rank] if args.index is None else args.index
        scene, state, inputs, centres = golden_scene(file, index, frame, step)
        command = None
        if name == "edge":
            model = load(args.trained)[0].double()
        else:
            config = PRESETS[name]
            model = small_random_model(config, scene, state, seed)
            if config.command_size:
                command = np.linspace(-0.5, 0.8, config.command_size).astype(np.float32)
                scene = dataclasses.replace(scene, command=torch.from_numpy(command)[None].double())
            write_model(args.out / f"{name}.model.safetensors", config, model.state_dict(), PURPOSE, {})
        steps = FEWER_STEPS.get(name, STEPS)
        out = record(model, scene, state, inputs, centres, command, points=name != "edge", steps=steps)
        save(args.out, name, out, step=step, seed=file.scene_seed[index], frame=frame)
    for name, steps in ROLES.items():
        if name not in wanted:
            continue
        whose = SHARED.get(name, name)
        is_similar = whose == "tiny-similar"
        similar = (SIMILAR_LENGTH, SIMILAR_GRAVITY, SIMILAR_MASS) if is_similar else ()
        start = IMPULSES_START if whose in ("tiny-impulses", "tiny-breaking") else 0.0
        scene, state, inputs, centres, targets = roles_scene(*similar, steps=steps, start=start)
        first = dataclasses.replace(state, target_rotation=targets[0][:1], target_centre=targets[1][:1])
        command = None
        if PRESETS[whose].command_size:
            command = np.linspace(-0.5, 0.8, PRESETS[whose].command_size).astype(np.float32)
            scene = dataclasses.replace(scene, command=torch.from_numpy(command)[None].double())
        model = small_random_model(PRESETS[whose], scene, first, ROLES_SEED)
        if name == "tiny-near":
            scene, state, inputs, centres, targets = roles_scene(*similar, steps=steps, start=NEAR_START)
            model.config = dataclasses.replace(model.config, scope="near")
        if name == "tiny-joints":
            scene, inputs = joined(scene, state, inputs, centres)
        elif name in ("tiny-bonds", "tiny-breaking"):
            scene, state, inputs, centres, targets = roles_scene(*similar, steps=steps, start=BONDS_START)
            scene, inputs = bonded(scene, inputs)
            if name == "tiny-breaking":
                scene = meeting(scene, state)
                last = getattr(model.bonds.net, "1")
                last.weight.data.neg_()
                last.bias.data.neg_().add_(BREAKING_BIAS)
                write_model(args.out / f"{name}.model.safetensors", model.config, model.state_dict(), PURPOSE, {})
        elif name not in SHARED:
            write_model(args.out / f"{name}.model.safetensors", model.config, model.state_dict(), PURPOSE, {})
        out = record(model, scene, state, inputs, centres, command, name not in SHARED, targets)
        save(args.out, name, out, step=0, seed=ROLES_SEED, frame=0)  # the time step is in `dt`


def joined(scene, state, inputs, centres):
    """The scene with JOINTS, and the inputs with them: (joints, 8) unit, parent, and the pivot in both frames."""
    rotation, centre = state.rotation[0].numpy(), state.centre[0].numpy()
    rows = []
    for unit, parent in JOINTS:
        middle = (centre[unit] + centre[parent]) / 2
        pivots = [rotation[u].T @ (middle - centre[u]) + centres[u] for u in (unit, parent)]
        rows.append([unit, parent, *pivots[0], *pivots[1]])
    rows = np.array(rows, np.float32)
    pivots = [Pivot(int(row[0]), int(row[1]), row[2:5].astype(float), row[5:].astype(float), 0.0) for row in rows]
    return dataclasses.replace(scene, joints=joints_of(pivots, centres)), inputs | {"joints": rows}


def bonded(scene, inputs):
    """The scene with BONDS, and the inputs with them: (bonds, 2) units."""
    body = scene.body.clone()
    body[:, sorted({unit for pair in BONDS for unit in pair})] = int(body[0, BONDS[0][0]])
    lead = torch.from_numpy(leads(body.shape[1], BONDS))[None]
    return dataclasses.replace(scene, body=body, lead=lead), inputs | {"body": body[0].numpy(), "bonds": np.array(BONDS, np.int64)}


def meeting(scene, state):
    """The scene with where the units of BONDS meet."""
    points = [p[:n].numpy() for p, n in zip(scene.points[0], scene.points_in_use[0])]
    rotation, centre, radius = state.rotation[0].numpy(), state.centre[0].numpy(), scene.radius[0].numpy()
    found = [breaking.joint([points[k] for k in pair], rotation[list(pair)], centre[list(pair)], radius[list(pair)]) for pair in BONDS]
    spread, touches, middle = (torch.from_numpy(np.array(own, np.float64))[None] for own in zip(*found))
    pairs = torch.tensor([BONDS])
    never = torch.full(pairs.shape[:2], STEPS)
    return dataclasses.replace(scene, bonds=breaking.Bonds(pairs, never > 0, spread, touches, middle, never))


def save(folder, name, out, **meta):
    meta = {"format": "rigidformer-golden"} | {key: str(value) for key, value in meta.items()}
    save_file(out, folder / f"{name}.golden.safetensors", meta)
    active = int(out["rollout_active"].sum())
    print(json.dumps({"case": name, "units": len(out["physics"]), "active in rollout": active}))


def contacts(file, s, first, last):
    """Velocity changes that free motion does not explain, of free units over frames of a scene."""
    rows = np.arange(file.scene_units[s], file.scene_units[s + 1])
    rows = rows[file.roles[rows] == FREE]
    c = np.asarray(file.unit_poses[rows, first : last + 1, :3], np.float64)
    rate = file.frame_rate_hz
    bend = c[:, 2:] - 2 * c[:, 1:-1] + c[:, :-2] - np.array(file.gravity_m_s2) / rate**2
    return int((np.linalg.norm(bend, axis=-1) * rate > 0.03).sum()) if c.shape[1] > 2 else 0


if __name__ == "__main__":
    main()
