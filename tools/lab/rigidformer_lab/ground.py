"""What a scene stands on and falls through: its planes and its gravity, who moves a unit, and which units are one body.

The default ground, z = 0, is here alone.
"""

from __future__ import annotations

import dataclasses

import torch

from .roles import DRIVEN, FREE, MAX_PLANES

#: What is nearest to a point: a unit from 0 on, else plane p as PLANE - p, else nothing.
PLANE = -1
NOTHING = PLANE - MAX_PLANES
#: A point without a plane and without a unit of another body is as far as this above a plane without friction.
ABYSS_M = 1000.0

#: Allowance on the distance that things travel towards each other, and on every gap, metres (section 6).
REACH_FACTOR = 1.05
REACH_MARGIN_M = 0.03


@dataclasses.dataclass
class Planes:
    """Planes of B scenes, padded to P. The free side is where normal . x >= offset."""

    normal: torch.Tensor  # (B, P, 3), unit length
    offset: torch.Tensor  # (B, P) metres
    friction: torch.Tensor  # (B, P)
    restitution: torch.Tensor  # (B, P)
    valid: torch.Tensor  # (B, P) bool, plane exists

    def __len__(self):
        return self.normal.shape[1]

    def heights(self, points):
        """Metres (B, ..., P) that points (B, ..., 3) are above each plane; infinite for padding."""
        shape = (len(points), *[1] * (points.dim() - 2), len(self))
        height = (points[..., None, :] * self.normal.view(*shape, 3)).sum(-1) - self.offset.view(shape)
        return height.masked_fill(~self.valid.view(shape), float("inf"))

    def nearest(self, points):
        """Distance (B, ...) of points to the plane nearest to each, and that plane as PLANE - p; infinite and NOTHING
        without any. Of equals the lower number."""
        distance = self.heights(points).abs()
        best = torch.full(points.shape[:-1], float("inf"), dtype=points.dtype, device=points.device)
        which = torch.full(best.shape, NOTHING, dtype=torch.int64, device=points.device)
        for p in range(len(self)):
            closer = distance[..., p] < best
            best = torch.where(closer, distance[..., p], best)
            which = torch.where(closer, torch.full_like(which, PLANE - p), which)
        return best, which

    def under(self, points, which):
        """Of the plane that `which` names for each point: normal (..., 3), height (...), friction, restitution."""
        index = (PLANE - which).clamp(0, len(self) - 1)
        batch = torch.arange(len(points), device=points.device).view(-1, *[1] * (which.dim() - 1))
        normal = self.normal[batch, index]
        height = (points * normal).sum(-1) - self.offset[batch, index]
        nothing = which == NOTHING
        up = torch.eye(3, dtype=points.dtype, device=points.device)[2]  # nothing is copied to an accelerator
        nil = torch.zeros_like(height)
        return (
            torch.where(nothing[..., None], up, normal), torch.where(nothing, nil + ABYSS_M, height),
            torch.where(nothing, nil, self.friction[batch, index]),
            torch.where(nothing, nil, self.restitution[batch, index]),
        )  # fmt: skip


def planes_of(rows, valid=None):
    """Planes from rows (B, P, 6): normal, offset, friction, restitution. At least one row, be it an invalid one."""
    if valid is None:
        valid = torch.ones(rows.shape[:2], dtype=torch.bool, device=rows.device)
    if rows.shape[1] == 0:
        rows, valid = rows.new_zeros(len(rows), 1, 6), valid.new_zeros(len(rows), 1)
    return Planes(rows[..., :3], rows[..., 3], rows[..., 4], rows[..., 5], valid)


def level_ground(friction, restitution, batch, like):
    """The plane z = 0 with the free side above, for each of `batch` scenes."""
    row = torch.tensor([0.0, 0.0, 1.0, 0.0, friction, restitution], dtype=like.dtype, device=like.device)
    return planes_of(row.expand(batch, 1, 6))


def groups(body, mask):
    """Numbers (B, M) that units of one body share and no others; body None: every unit is a body of its own."""
    own = (-1 - torch.arange(mask.shape[1], device=mask.device)).expand(mask.shape)
    return own if body is None else torch.where(body >= 0, body, own)


@dataclasses.dataclass
class Motion:
    """How units are expected to move over the coming step, gravity apart: from one pose to another."""

    from_rotation: torch.Tensor  # (B, M, 3, 3)
    from_centre: torch.Tensor  # (B, M, 3)
    to_rotation: torch.Tensor
    to_centre: torch.Tensor
    free: torch.Tensor  # (B, M) bool
    fall: torch.Tensor  # (B, 3) what gravity adds to a step, metres: g dt^2

    def travels(self):
        """Way of the centres (B, M, 3) in the frame that falls with gravity, metres a step."""
        travel = self.to_centre - self.from_centre
        return torch.where(self.free[..., None], travel, travel - self.fall[:, None])

    def turns(self):
        """Rotations (B, M, 3, 3) of the step."""
        return self.to_rotation @ self.from_rotation.transpose(-1, -2)


def coming_motion(state, role, fall):
    """Free units move on as in the last step; driven ones go to their target, if they have one; fixed ones stay."""
    if role is None:
        free = torch.ones(state.centre.shape[:2], dtype=torch.bool, device=state.centre.device)
        return Motion(state.previous_rotation, state.previous_centre, state.rotation, state.centre, free, fall)
    free = role == FREE
    to_rotation, to_centre = next_poses(state, role)
    return Motion(
        torch.where(free[..., None, None], state.previous_rotation, state.rotation),
        torch.where(free[..., None], state.previous_centre, state.centre), to_rotation, to_centre, free, fall,
    )  # fmt: skip


def next_poses(state, role):
    """Rotations and centres of driven units after the step, and those of now of all others."""
    if state.target_rotation is None:
        return state.rotation, state.centre
    driven = role == DRIVEN
    return (
        torch.where(driven[..., None, None], state.target_rotation, state.rotation),
        torch.where(driven[..., None], state.target_centre, state.centre),
    )


def meeting(centre, travel, radius, mask, group):
    """Pairs of units (B, M, M) of different groups whose bounding spheres may meet within the step (section 6). travel:
    in the falling frame."""
    gap = torch.linalg.vector_norm(centre[:, :, None] - centre[:, None], dim=-1)
    gap = gap - radius[:, :, None] - radius[:, None]
    relative = torch.linalg.vector_norm(travel[:, :, None] - travel[:, None], dim=-1)
    pair = gap < relative * REACH_FACTOR + REACH_MARGIN_M
    return pair & mask[:, None] & mask[:, :, None] & (group[:, :, None] != group[:, None])


def landing(centre, travel, radius, planes: Planes, fall):
    """Units (B, M) whose bounding spheres may reach a plane within the step, were they free."""
    height = planes.heights(centre) - radius[..., None]
    sink = (travel[:, :, None] * planes.normal[:, None]).sum(-1) + (fall[:, None] * planes.normal).sum(-1)[:, None]
    return (height + sink.clamp(max=0.0) * REACH_FACTOR < REACH_MARGIN_M).any(-1)
