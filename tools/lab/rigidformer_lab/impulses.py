"""Motion with contact of batches of scenes: `solver` between PyTorch tensors. docs/MODEL.md, section 6, has the definition.

No gradient passes through impulses: what was pushed goes on from where it is, in a straight line.
"""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from .ground import groups
from .roles import DRIVEN, FREE
from .solver import Motion, World, advance, room

PARTS_HZ = 96.0  # a part of a step is at most so many parts of a second
MOST_PARTS = 16

_threads = ThreadPoolExecutor(max(1, min(8, os.cpu_count() or 1)))


def use_threads(count: int):
    """Solves so many scenes at a time."""
    global _threads
    _threads = ThreadPoolExecutor(count)


def parts(dt: float) -> int:
    """Parts that the solver takes a step in."""
    return min(max(1, math.ceil(dt * PARTS_HZ - 0.01)), MOST_PARTS)


def _rotvec(matrices):
    return Rotation.from_matrix(matrices).as_rotvec()


def _solved(job):
    """Next poses, poses before and shares of one scene, as arrays; and which units are touched."""
    world, rotation, centre, previous, goal, free, driven, dt = job
    gravity = world.gravity
    velocity, spin = np.zeros_like(centre), np.zeros_like(centre)
    if free.any():
        velocity[free] = (centre[free] - previous[1][free]) / dt + gravity * (0.5 * dt)
        spin[free] = _rotvec(rotation[free] @ previous[0][free].transpose(0, 2, 1)) / dt
    if driven.any():
        velocity[driven] = (goal[1][driven] - centre[driven]) / dt
        spin[driven] = _rotvec(goal[0][driven] @ rotation[driven].transpose(0, 2, 1)) / dt
    moving = Motion(rotation.copy(), centre.copy(), velocity, spin)
    _, touched, share = advance(world, moving, dt, parts(dt), *room(len(free)))
    back = Rotation.from_rotvec(moving.spin * -dt).as_matrix()
    before = back @ moving.rotation
    still = (moving.velocity == 0).all(1) & (moving.spin == 0).all(1)
    before[still] = moving.rotation[still]
    return moving.rotation, moving.centre, before, moving.centre - moving.velocity * dt + gravity * (0.5 * dt * dt), touched, share


def solve(scene, state, planes, gravity, dt):
    """(B, M, ...): rotation, centre, rotation before, centre before, touched, share (section 6); no gradient."""
    array = lambda t, kind=np.float64: np.ascontiguousarray(t.detach().cpu().numpy().astype(kind))  # noqa: E731
    mask = array(scene.mask, bool)
    role = np.zeros(mask.shape, np.int64) if scene.role is None else array(scene.role, np.int64)
    group = array(groups(scene.body, scene.mask), np.int64)
    rotation, centre = array(state.rotation), array(state.centre)
    previous = array(state.previous_rotation), array(state.previous_centre)
    goal = rotation, centre
    if state.target_rotation is not None:
        goal = array(state.target_rotation), array(state.target_centre)
    physics, radius, extent = array(scene.physics), array(scene.radius), array(scene.extent)
    start, count, scale = array(scene.hull_start, np.int64), array(scene.hull_count, np.int64), array(scene.scale)
    bank = np.concatenate((array(scene.hull_bank), np.zeros((1, 3))))
    ball = np.zeros(mask.shape, bool) if scene.ball is None else array(scene.ball, bool)
    start[ball], count[ball] = len(bank) - 1, 1
    rows = np.concatenate(
        (array(planes.normal), *(array(v)[..., None] for v in (planes.offset, planes.friction, planes.restitution))), -1
    )
    valid, gravity, dt = array(planes.valid, bool), array(gravity), array(dt)
    square = extent**2
    moment = np.maximum((square.sum(-1, keepdims=True) - square) / 12, 1e-6) * physics[..., :1]
    jobs = []
    for b in range(len(mask)):
        m = mask[b]
        free = role[b][m] == FREE
        mass = physics[b][m, 0]
        world = World(
            free, group[b][m], np.where(free, 1 / mass, 0.0), moment[b][m], physics[b][m, 1], physics[b][m, 2],
            radius[b][m], start[b][m], count[b][m], scale[b][m], bank, np.where(ball, radius, 0.0)[b][m], rows[b][valid[b]], gravity[b],
        )  # fmt: skip
        world = World(*(np.ascontiguousarray(v) for v in world))
        pick = lambda pair, b=b, m=m: tuple(v[b][m] for v in pair)  # noqa: E731
        jobs.append((
            world, *pick((rotation, centre)), pick(previous), pick(goal), free, role[b][m] == DRIVEN, float(dt[b]),
        ))  # fmt: skip
    out = [rotation.copy(), centre.copy(), rotation.copy(), centre.copy(), np.zeros(mask.shape, bool), np.zeros(mask.shape)]
    for b, found in enumerate(_threads.map(_solved, jobs)):
        for whole, part in zip(out, found):
            whole[b][mask[b]] = part
    put = lambda a, like: torch.from_numpy(a).to(like)  # noqa: E731
    return (*(put(a, state.centre) for a in out[:4]), put(out[4], scene.mask), put(out[5], state.centre))
