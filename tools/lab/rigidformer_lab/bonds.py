"""Clusters: units that bonds hold together move as one rigid body (docs/MODEL.md, section 7)."""

from __future__ import annotations

import numpy as np
import torch

from .geometry import _Procrustes


def leads(units: int, pairs) -> np.ndarray:
    """(units) the first unit of the cluster that each is in, itself where it is alone; pairs: the bonds that hold."""
    lead = np.arange(units)
    for _ in range(units):
        before = lead.copy()
        for a, b in pairs:
            lead[a] = lead[b] = min(lead[a], lead[b])
        if (lead == before).all():
            break
    return lead


def bound(lead: np.ndarray) -> np.ndarray:
    """Which units are in a cluster of several."""
    return np.bincount(lead, minlength=len(lead))[lead] > 1


def bodies(body: np.ndarray, before: np.ndarray, lead: np.ndarray) -> np.ndarray:
    """Bodies once clusters have parted from `before` to `lead`: what has the first unit of a cluster keeps its body, each other part
    gets the least number that none has, from 0 on."""
    body = body.copy()
    for unit in np.flatnonzero((lead == np.arange(len(lead))) & bound(before) & (before != lead)):
        body[lead == unit] = next(number for number in range(len(body) + 1) if number not in body)
    return body


def _together(lead, mask):
    """Which units are in one cluster (B, M, M), and which are in one of several (B, M)."""
    same = (lead[:, :, None] == lead[:, None]) & mask[:, None] & mask[:, :, None]
    return same, same.sum(-1) > 1


def hold_together(lead, mass, mask, inertia, now, next_, before, anchors):
    """Poses (rotation, centre) after a step, and those that the state keeps as previous ones then, that make each cluster one rigid
    body: from those that its units come to one by one. inertia (B, M, 3): of a kilogram, along the units' axes.

    The ways from `now` to `next_` become one rigid motion: the cluster's centre of mass goes where that of its units does, and it
    turns as fits their anchors (B, M, A, 3) best, weighted by mass (B, M). Its velocity and spin are those that have the
    momentum and the spin of its units together, as `before` and `next_` tell them."""
    same, several = _together(lead, mask)
    weight = same * mass[:, None]
    share = weight / weight.sum(-1, keepdim=True).clamp(min=1e-30)
    arms = [
        anchors @ rotation.transpose(-1, -2) + (centre - share @ centre)[..., None, :] for rotation, centre in (now, next_)
    ]
    whole = lambda own: (weight @ own.flatten(2)).reshape(own.shape)  # noqa: E731
    turn = _Procrustes.apply(whole(arms[1].transpose(-1, -2) @ arms[0]))
    rotation = turn @ now[0]
    centre = share @ next_[1] + (turn @ (now[1] - share @ now[1])[..., None])[..., 0]

    arm, way = next_[1] - share @ next_[1], next_[1] - before[1]
    alone = next_[0] @ (inertia[..., None] * next_[0].transpose(-1, -2))
    far = arm.square().sum(-1)[..., None, None] * torch.eye(3).to(arm) - arm[..., :, None] * arm[..., None, :]
    own = _turn_between(before[0], next_[0])
    spin = torch.linalg.cross(arm, way) + (alone @ own[..., None])[..., 0]
    odd = (~several)[..., None, None] * torch.eye(3).to(arm)  # what is alone is not solved for
    spin = torch.linalg.solve(whole(alone + far) + odd, whole(spin))
    way = share @ way + torch.linalg.cross(spin, centre - share @ centre)
    pick = lambda own, each: torch.where(several.reshape(*several.shape, *[1] * (own.dim() - 2)), own, each)  # noqa: E731
    return (
        (pick(rotation, next_[0]), pick(centre, next_[1])),
        (pick(_turned_back(rotation, spin), before[0]), pick(centre - way, before[1])),
    )


def _turn_between(before, now):
    """Radians (..., 3) from one rotation to another, along the axis; below half a turn."""
    turn = now @ before.transpose(-1, -2)
    half = torch.stack((turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1]), -1) / 2
    square = half.square().sum(-1, keepdim=True)
    small = square < 1e-16
    sine = torch.where(small, torch.ones_like(square), square).sqrt()
    cosine = (turn.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1) / 2
    return half * torch.where(small, torch.ones_like(sine), torch.atan2(sine, cosine) / sine)


def _turned_back(rotation, turn):
    """Rotations before a turn of radians (..., 3)."""
    x, y, z = (-turn).unbind(-1)
    zero = torch.zeros_like(x)
    across = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    return torch.linalg.matrix_exp(across) @ rotation


def most(lead, mask, values):
    """Of each unit the largest value (B, M) of its cluster."""
    same, several = _together(lead, mask)
    largest = values[:, None].masked_fill(~same, -torch.inf).amax(-1)
    return torch.where(several, largest, values)
