"""Parts that stay together, as in the runtime's `pivots` and the core's joints (section 7).

`find_pivots` reads pivots off observed poses; `Joints` are those of a batch of scenes. `turn_together` pushes the two images of
each pivot towards each other, which turns units too; `hold_together` then moves centres so that they are one.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

TOLERANCE_M = 0.005  # pairs whose images of the best pivot lie farther apart, root mean square, are not joined
NEAR_SHARE = 0.3  # pairs of points count as nearest up to this share of the smaller part beyond the least distance
LEAST_WEIGHT = 1e-9  # of the distance from the nearest place, beside that of the images: rounding of poses
SPREAD_M = 0.1  # how far from there a pivot is thought to lie: the weight that noise of poses asks for
TURNS = 4  # sweeps over the joints that also turn units
DISTANCE_SHARE = 0.1  # a metre between two parts counts as so many of residual


@dataclasses.dataclass(frozen=True)
class Pivot:
    """A pivot of a unit and the one that it hangs from, each in the frame of its poses, metres."""

    unit: int
    parent: int
    pivot: np.ndarray
    parent_pivot: np.ndarray
    residual_m: float


def find_pivots(rotation, place, points, body) -> list[Pivot]:
    """Pivots of all bodies of several parts, parents first. rotation: (units, frames, 3, 3), place: (units, frames, 3),
    points: of each unit (points, 3) in its own frame, body: (units), -1: a body of its own."""
    rotation, place = np.asarray(rotation, np.float64), np.asarray(place, np.float64)
    units, frames = place.shape[:2]
    if frames < 2:
        raise ValueError(f"{frames} frames are given; pivots take 2 or more")
    points = [np.asarray(own, np.float64) for own in points]
    pairs = []
    for j in range(units):
        for i in range(j):
            if body[i] >= 0 and body[i] == body[j]:
                pairs.append(_pair((i, j), rotation[[i, j]], place[[i, j]], (points[i], points[j])))
    tree, kept = list(range(units)), []
    for cost, parts, pivots, residual in sorted(pairs, key=lambda pair: pair[:2]):
        a, b = tree[parts[0]], tree[parts[1]]
        if residual <= TOLERANCE_M and a != b:
            tree = [a if own == b else own for own in tree]
            kept.append((parts, pivots, residual))
    found, hung = [], set()
    for root in range(units):
        above = [] if root in hung else [root]
        hung.add(root)
        while above:
            parent = above.pop()
            for parts, pivots, residual in kept:
                own = 1 if parts[0] == parent else 0
                if parent in parts and parts[own] not in hung:
                    hung.add(parts[own])
                    above.append(parts[own])
                    found.append(Pivot(parts[own], parent, pivots[own], pivots[1 - own], residual))
    return found


def _pair(parts, rotation, place, points):
    """Cost, parts, the best pivot in both frames, and its residual."""
    world = [own @ rotation[k, -1].T + place[k, -1] for k, own in enumerate(points)]
    apart = np.linalg.norm(world[0][:, None] - world[1], axis=-1)
    distance = apart.min()
    reach = distance + NEAR_SHARE * min(np.ptp(own, axis=0).max() for own in points)
    a, b = np.nonzero(apart <= reach)
    near = (world[0][a].mean(0) + world[1][b].mean(0)) / 2
    start = np.einsum("kji,kj->ki", rotation[:, -1], near - place[:, -1])
    frames = place.shape[1]

    def gap(pivots):
        image = np.einsum("kfij,kj->kfi", rotation, pivots) + place
        return image[0] - image[1]

    matrix = np.eye(6)
    matrix[:3, 3:] = -np.einsum("fji,fjk->ik", rotation[0], rotation[1]) / frames
    matrix[3:, :3] = matrix[:3, 3:].T
    left = np.einsum("kfji,fj->ki", rotation, gap(start)) / frames
    left = np.concatenate((left[0], -left[1]))

    def solve(weight):
        pivots = start - np.linalg.solve(matrix + weight * np.eye(6), left).reshape(2, 3)
        return pivots, float(np.sqrt(np.square(gap(pivots)).sum(-1).mean()))

    _, residual = solve(LEAST_WEIGHT)
    open_ = 3 * frames - 6
    noise = residual**2 * frames / open_ if open_ > 0 else 0.0
    pivots, residual = solve(LEAST_WEIGHT + noise / SPREAD_M**2)
    return residual + DISTANCE_SHARE * distance, parts, pivots, residual


@dataclasses.dataclass
class Joints:
    """Joints of a batch of scenes: each unit hangs from one other or none."""

    parent: torch.Tensor  # (B, M) int64, -1: hangs from none
    pivot: torch.Tensor  # (B, M, 3) relative to the unit's centre, in its frame; of any value where it hangs from none
    parent_pivot: torch.Tensor  # (B, M, 3) relative to the parent's centre, in the parent's frame

    def scaled(self, share):
        """In another length; share (B)."""
        share = share[:, None, None]
        return Joints(self.parent, self.pivot * share, self.parent_pivot * share)


def joints_of(pivots, offsets, dtype=torch.float64) -> Joints:
    """Joints of one scene, from pivots in the frames of poses; offsets: (units, 3) centres in those."""
    units = len(offsets)
    parent, own, parents = np.full(units, -1), np.zeros((units, 3)), np.zeros((units, 3))
    for found in pivots:
        parent[found.unit] = found.parent
        own[found.unit] = found.pivot - offsets[found.unit]
        parents[found.unit] = found.parent_pivot - offsets[found.parent]
    put = lambda values: torch.from_numpy(values)[None]  # noqa: E731
    return Joints(put(parent), put(own).to(dtype), put(parents).to(dtype))


def turn_together(joints: Joints, rotation, centre, mass, inertia, free, mask):
    """Rotations (B, M, 3, 3) and centres (B, M, 3) after sweeps over the joints, in the order of the units that hang. Each pushes a
    unit and its parent at their pivot, one against the other, so that its images would meet if turns were small. inertia:
    (B, M, 3) along the unit's axes, of a kilogram."""
    light = torch.where(free, 1 / mass.clamp(min=1e-30), torch.zeros_like(mass))
    yields = light[..., None] / inertia
    hangs = mask & (joints.parent >= 0)
    batch = torch.arange(len(mass), device=mass.device)
    axes = torch.eye(3, dtype=centre.dtype, device=centre.device)

    def turn(rotation, arm, yields, push):
        about = (rotation.transpose(-1, -2) @ torch.linalg.cross(arm, push)[..., None])[..., 0]
        return (rotation @ (about * yields)[..., None])[..., 0]

    for _ in range(TURNS):
        for number in range(mass.shape[1]):
            if not bool(hangs[:, number].any()):
                continue
            sides = []
            for unit, pivot in ((torch.full_like(batch, number), joints.pivot), (joints.parent[:, number].clamp(min=0), joints.parent_pivot)):
                r, c = rotation[batch, unit], centre[batch, unit]
                arm = (r @ pivot[:, number, :, None])[..., 0]
                sides.append((unit, r, c, arm, light[batch, unit][:, None], yields[batch, unit]))
            gap = (sides[1][2] + sides[1][3]) - (sides[0][2] + sides[0][3])
            matrix = torch.stack([
                sum(push * w + torch.linalg.cross(turn(r, arm, y, push.expand_as(arm)), arm) for _, r, _, arm, w, y in sides)
                for push in axes
            ], -1)  # fmt: skip
            works = hangs[:, number] & ((sides[0][4] + sides[1][4])[:, 0] > 0)
            matrix = torch.where(works[:, None, None], matrix, axes)
            push = torch.linalg.solve(matrix, gap) * works[:, None]
            rotation, centre = rotation.clone(), centre.clone()
            for sign, (unit, r, c, arm, w, y) in zip((1, -1), sides):
                moved = turned(r, turn(r, arm, y, sign * push))
                rotation[batch, unit] = torch.where(works[:, None, None], moved, r)
                centre[batch, unit] = torch.where(works[:, None], c + sign * push * w, c)
    return rotation, centre


def turned(rotation, turn):
    """Rotations (..., 3, 3) turned by radians along an axis (..., 3)."""
    angle = turn.norm(dim=-1)[..., None, None]
    half = 0.5 * angle
    # sin(x) / x
    share = torch.where(half > 1e-6, torch.sin(half) / half.clamp(min=1e-30), torch.ones_like(half))
    zero = torch.zeros_like(turn[..., 0])
    x, y, z = turn.unbind(-1)
    across = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    step = across @ rotation
    return rotation + step * (share * torch.cos(half)) + (across @ step) * (0.5 * share.square())


def hold_together(joints: Joints, rotation, centre, mass, free, mask):
    """Centres (B, M, 3) at which the two images of each pivot are one. rotation: (B, M, 3, 3), mass: (B, M), free: (B, M) bool,
    mask: (B, M) bool, unit exists. Free trees keep their centre of mass; units that are not free stay, and what hangs from
    them hangs from the nearest; the rest of the tree from the first that hangs from no other such."""
    units = centre.shape[1]
    above = joints.parent.clamp(min=0)
    hangs = mask & (joints.parent >= 0)
    at = above[..., None].expand_as(centre)
    own = (rotation @ joints.pivot[..., None])[..., 0]
    parents = torch.gather(rotation, 1, at[..., None].expand_as(rotation)) @ joints.parent_pivot[..., None]
    step = (torch.gather(centre, 1, at) - centre) + (parents[..., 0] - own)
    step = torch.where(hangs[..., None], step, torch.zeros_like(step))
    held = mask & ~free
    number = torch.arange(units).expand_as(above)
    # Up to the root, one link a pass.
    way, root = step, torch.where(hangs, above, number)
    holder = torch.where(held, number, torch.full_like(number, -1))
    for _ in range(units):
        more = torch.gather(hangs, 1, root)
        passes = (holder < 0) & torch.gather(held, 1, root)
        holder = torch.where(passes & hangs, root, holder)
        if not bool(more.any()):
            break
        way = way + torch.gather(step, 1, root[..., None].expand_as(way))
        root = torch.where(more, torch.gather(above, 1, root), root)
    # Of each tree: the first held unit that hangs from no other such, or the centre of mass.
    above_holder = torch.where(hangs, torch.gather(holder, 1, above), torch.full_like(holder, -1))
    top = held & (above_holder < 0)
    tree = (root[:, :, None] == number[:, None, :]) & mask[:, :, None]  # (B, M, roots)
    first = torch.where(top[:, :, None] & tree, number[:, :, None], torch.full_like(tree, units, dtype=torch.int64)).amin(1)
    weight = (tree * mass[:, :, None]).transpose(1, 2)
    mean = (weight @ way) / weight.sum(-1, keepdim=True).clamp(min=1e-30)
    on_top = torch.gather(way, 1, first.clamp(max=units - 1)[..., None].expand_as(way))
    stays = torch.where((first < units)[..., None], on_top, mean)
    stays = torch.gather(stays, 1, root[..., None].expand_as(way))
    stays = torch.where(
        (holder >= 0)[..., None], torch.gather(way, 1, holder.clamp(min=0)[..., None].expand_as(way)), stays
    )
    return torch.where(mask[..., None], centre + (way - stays), centre)
