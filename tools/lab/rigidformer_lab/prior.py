"""The motion that the network corrects, of batches of scenes: `solver` between PyTorch tensors. docs/MODEL.md, section 6, has the definition.

No gradient passes through impulses: what was pushed goes on from where it is, in a straight line.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from .bonds import bound
from .ground import groups
from .roles import DRIVEN, FREE
from .solver import Motion, World, advance, in_one_piece, keep_apart, meetings, parts, room

_threads = ThreadPoolExecutor(max(1, min(8, os.cpu_count() or 1)))


def use_threads(count: int):
    """Solves so many scenes at a time."""
    global _threads
    _threads = ThreadPoolExecutor(count)


def _rotvec(matrices):
    return Rotation.from_matrix(matrices).as_rotvec()


def _solved(job):
    """Next poses, poses before and shares of one scene, as arrays, which units are touched, and what `keep_apart` takes."""
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
    contacts = room(len(free))
    _, count, touched, share = advance(world, moving, dt, parts(dt), *contacts)
    back = Rotation.from_rotvec(moving.spin * -dt).as_matrix()
    before = back @ moving.rotation
    still = (moving.velocity == 0).all(1) & (moving.spin == 0).all(1)
    before[still] = moving.rotation[still]
    earlier = moving.centre - moving.velocity * dt + gravity * (0.5 * dt * dt)
    touched |= bound(world.lead)  # what is in a cluster flies freely about its centre alone
    return moving.rotation, moving.centre, before, earlier, touched, share, (world, *meetings(contacts[0], count))


def solve(scene, state, planes, gravity, dt):
    """(B, M, ...): rotation, centre, rotation before, centre before, whether they are not those of free motion, share
    (section 6), and what `kept_apart` takes; no gradient."""
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
    if scene.piece_bank is not None:
        rows = array(scene.piece_bank, np.int64), array(scene.piece_ball)
        first, pieces = array(scene.piece_start, np.int64), array(scene.piece_count, np.int64)
    ground = np.concatenate(
        (array(planes.normal), *(array(v)[..., None] for v in (planes.offset, planes.friction, planes.restitution))), -1
    )
    law = np.zeros((len(mask), 2)) if scene.law is None else array(scene.law)
    lead = None if scene.lead is None else array(scene.lead, np.int64)
    valid, gravity, dt = array(planes.valid, bool), array(gravity), array(dt)
    square = extent**2
    moment = np.maximum((square.sum(-1, keepdims=True) - square) / 12, 1e-6) * physics[..., :1]
    def in_pieces(b, m):
        """first, pieces, piece and ball of a scene's units."""
        if scene.piece_bank is None:
            return in_one_piece(start[b][m], count[b][m], radius[b][m] / scale[b][m])
        chosen = [np.arange(low, low + many) for low, many in zip(first[b][m], pieces[b][m])]
        many = pieces[b][m]
        piece, around = (table[np.concatenate(chosen)] for table in rows)
        for unit in np.flatnonzero(ball[b][m]):
            at = int(many[:unit].sum())
            piece[at] = start[b][m][unit], 1
        return np.cumsum(many) - many, many, piece, around

    jobs = []
    for b in range(len(mask)):
        m = mask[b]
        free = role[b][m] == FREE
        mass = physics[b][m, 0]
        world = World(
            free, group[b][m], np.where(free, 1 / mass, 0.0), moment[b][m], physics[b][m, 1], physics[b][m, 2],
            radius[b][m], start[b][m], count[b][m], scale[b][m], bank, *in_pieces(b, m), np.where(ball, radius, 0.0)[b][m], ground[b][valid[b]], gravity[b],
            np.arange(m.sum()) if lead is None else (np.cumsum(m) - 1)[lead[b][m]], law[b],
        )  # fmt: skip
        world = World(*(np.ascontiguousarray(v) for v in world))
        pick = lambda pair, b=b, m=m: tuple(v[b][m] for v in pair)  # noqa: E731
        jobs.append((
            world, *pick((rotation, centre)), pick(previous), pick(goal), free, role[b][m] == DRIVEN, float(dt[b]),
        ))  # fmt: skip
    out = [rotation.copy(), centre.copy(), rotation.copy(), centre.copy(), np.zeros(mask.shape, bool), np.zeros(mask.shape)]
    met = []
    for b, (*found, meeting) in enumerate(_threads.map(_solved, jobs)):
        met.append(meeting)
        for whole, part in zip(out, found):
            whole[b][mask[b]] = part
    put = lambda a, like: torch.from_numpy(a).to(like)  # noqa: E731
    return (*(put(a, state.centre) for a in out[:4]), put(out[4], scene.mask), put(out[5], state.centre), met)


def _apart(job):
    (world, pairs, normals), rotation, centre = job
    keep_apart(world, Motion(rotation, centre, centre, centre), pairs, normals)
    return centre


def kept_apart(scene, met, rotation, centre):
    """Ways (B, M, 3) that take units of a step's end out of each other (section 7); no gradient."""
    array = lambda t: np.ascontiguousarray(t.detach().cpu().numpy().astype(np.float64))  # noqa: E731
    mask = scene.mask.cpu().numpy()
    rotation, centre = array(rotation), array(centre)
    out = np.zeros_like(centre)
    jobs = [(one, rotation[b][mask[b]], centre[b][mask[b]]) for b, one in enumerate(met)]
    for b, found in enumerate(_threads.map(_apart, jobs)):
        out[b][mask[b]] = found - centre[b][mask[b]]
    return torch.from_numpy(out).to(scene.points)


if __name__ == "__main__":
    raise SystemExit("rigidformer_lab.prior is no command; `python -m rigidformer_lab.research.impulses_alone` measures impulses alone")
