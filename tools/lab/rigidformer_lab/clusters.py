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


def hold_together(lead, mass, mask, now, next_, anchors):
    """Poses (rotation, centre) that make the ways of each cluster's units from `now` to `next_` one rigid motion: its centre of mass
    goes where theirs does, and it turns as fits their anchors (B, M, A, 3) best, weighted by mass (B, M)."""
    same, several = _together(lead, mask)
    weight = same * mass[:, None]
    share = weight / weight.sum(-1, keepdim=True).clamp(min=1e-30)
    arms = [
        anchors @ rotation.transpose(-1, -2) + (centre - share @ centre)[..., None, :] for rotation, centre in (now, next_)
    ]
    own = (arms[1].transpose(-1, -2) @ arms[0]).flatten(-2)
    turn = _Procrustes.apply((weight @ own).unflatten(-1, (3, 3)))
    rotation, centre = now
    swung = (turn @ (centre - share @ centre)[..., None])[..., 0]
    return (
        torch.where(several[..., None, None], turn @ rotation, next_[0]),
        torch.where(several[..., None], share @ next_[1] + swung, next_[1]),
    )


def most(lead, mask, values):
    """Of each unit the largest value (B, M) of its cluster."""
    same, several = _together(lead, mask)
    largest = values[:, None].masked_fill(~same, -torch.inf).amax(-1)
    return torch.where(several, largest, values)
