"""Bonds: which units hold together, and which of the bonds break in a step (docs/MODEL.md, section 7)."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from .bonds import bodies, leads

#: Numbers that the network of bonds is told beside the tokens of both units.
BOND_FEATURES = 16
#: Points of two units touch that are closer than this share of the smaller unit's radius; at most so many pairs are looked at.
TOUCH, TOUCHES = 0.12, 32
FEATURE_CLAMP = 8.0
#: Place of the share among the features.
SHARE = 11
#: What is said of bonds between units that impulses do not act on.
NEVER = -30.0
#: Heights over planes that are told are at most so large, metres.
HIGH_M = 1.0
#: What is added before logarithms are taken: of a joint's spread, m2, and of a momentum, kg m/s.
LEAST_M2, LEAST_KG_M_S = 1e-4, 1e-2


@dataclasses.dataclass
class Bonds:
    """Pairs of units that hold together, of scenes of a batch."""

    pairs: torch.Tensor  # (B, N, 2) units of the scene
    mask: torch.Tensor  # (B, N) bool, the bond exists
    spread: torch.Tensor  # (B, N) m2, see `joint`
    touches: torch.Tensor  # (B, N) pairs of points that touch
    middle: torch.Tensor  # (B, N, 3) middle of those, from the centre of the first unit and in its axes, metres
    until: torch.Tensor  # (B, N) first frame of the record in which it does not hold


def joint(points, rotation, centre, radius):
    """Of two units where they meet: how far the pairs of points that touch are spread, m2, how many pairs there are, and their middle,
    from the first unit's centre and in its axes. points: of each (P, 3) about its centre. Spread is half the mean area of the
    parallelograms that two pairs and their middle span, which goes with the area of a joint whose corners touch."""
    a, b = (own @ turn.T + place for own, turn, place in zip(points, rotation, centre))
    reach = TOUCH * min(radius)
    near = np.argwhere(((a[:, None] - b[None]) ** 2).sum(-1) < reach * reach)[:TOUCHES]
    if not len(near):
        return 0.0, 0, rotation[0].T @ (centre[1] - centre[0]) / 2
    places = (a[near[:, 0]] + b[near[:, 1]]) / 2
    middle = places.mean(0)
    arms = places - middle
    count = len(arms)
    area = np.linalg.norm(np.cross(arms[:, None], arms[None]), axis=-1).sum() / 2  # each two of them once
    return 0.5 * area / max(count * (count - 1) / 2, 1), count, rotation[0].T @ (middle - centre[0])


def clusters_at(pairs, until, units: int, body, frame):
    """(lead, body) of the units of a scene, where the bonds hold that are not broken at a frame."""
    whole, lead = leads(units, pairs), leads(units, pairs[until > frame])
    return lead, bodies(body, whole, lead)


def describe(bonds: Bonds, scene, state, prior, push, low, holds):
    """(B, N, BOND_FEATURES) what the network of bonds is told; push (B, M, 3): how a step's impulses change the units' velocities,
    m/s; low (B, M): how high the units' lowest points are in the step, metres; holds (B, N): which bonds do."""
    at = lambda values, k: torch.gather(  # noqa: E731
        values, 1, bonds.pairs[..., k].reshape(*bonds.pairs.shape[:2], *[1] * (values.dim() - 2)).expand(-1, -1, *values.shape[2:])
    )
    mass = scene.physics[..., 0]
    middle = at(state.centre, 0) + (at(state.rotation, 0) @ bonds.middle[..., None])[..., 0]
    across = at(state.centre, 1) - at(state.centre, 0)
    apart = across.norm(dim=-1)
    normal = across / apart.clamp(min=1e-12)[..., None]
    heavy = at(mass, 0).log(), at(mass, 1).log()
    both, odd = (at(push, 0) + at(push, 1)) / 2, at(push, 0) - at(push, 1)
    # Momentum that goes through the plane of the joint, if what pushes is on one side of it.
    lead = torch.arange(mass.shape[1], device=mass.device) if scene.lead is None else scene.lead
    lead = lead.expand(mass.shape)
    same = (at(lead, 0)[..., None] == lead[:, None]) & scene.mask[:, None]  # (B, N, M)
    beyond = ((state.centre[:, None] - middle[:, :, None]) * normal[:, :, None]).sum(-1) > 0
    momentum = (mass[..., None] * push)[:, None]
    sides = [((same & side)[..., None] * momentum).sum(2).norm(dim=-1) for side in (beyond, ~beyond)]
    own = same * mass[:, None]
    whole = own.sum(-1)
    centre = own @ state.centre / whole.clamp(min=1e-30)[..., None]
    share = prior.share
    ends = torch.zeros_like(mass)
    for k in range(2):
        ends = ends.scatter_add(1, bonds.pairs[..., k], holds.to(mass.dtype))
    low = low.clamp(max=HIGH_M)
    return torch.stack((
        (bonds.spread + LEAST_M2).log(), bonds.touches.to(mass.dtype) / 8, heavy[0] + heavy[1], (heavy[0] - heavy[1]).abs(), apart,
        both.norm(dim=-1), odd.norm(dim=-1), (both * normal).sum(-1).abs(),
        (torch.minimum(*sides) + LEAST_KG_M_S).log(), (torch.maximum(*sides) + LEAST_KG_M_S).log(),
        (middle - centre).norm(dim=-1), torch.maximum(at(share, 0), at(share, 1)),
        torch.minimum(at(low, 0), at(low, 1)), torch.maximum(at(low, 0), at(low, 1)),
        torch.maximum(at(ends, 0), at(ends, 1)) / 8, whole.clamp(min=1e-30).log(),
    ), -1)  # fmt: skip


class BondHead(nn.Module):
    """Says of each bond whether it breaks in a step: above 0 it does."""

    def __init__(self, width: int, hidden: int):
        super().__init__()
        from .model import Mlp

        self.register_buffer("feature_mean", torch.zeros(BOND_FEATURES))
        self.register_buffer("feature_scale", torch.ones(BOND_FEATURES))
        self.net = Mlp(2 * width + BOND_FEATURES, hidden, 1)

    def inputs(self, tokens, pairs, raw):
        """tokens (B, M, D), pairs (B, N, 2), raw (B, N, BOND_FEATURES) -> (B, N, inputs of `net`)."""
        a, b = (torch.gather(tokens, 1, pairs[..., k : k + 1].expand(-1, -1, tokens.shape[-1])) for k in range(2))
        seen = ((raw - self.feature_mean) * self.feature_scale).clamp(-FEATURE_CLAMP, FEATURE_CLAMP)
        return torch.cat((a + b, (a - b).abs(), seen), -1)

    def forward(self, tokens, pairs, raw):
        return self.net(self.inputs(tokens, pairs, raw))[..., 0]


def said(model, scene, state, holds):
    """What the model says of the bonds (B, N): above 0 one breaks in the coming step, in which those hold before that `holds` says."""
    return model.breaking(held_together(scene, holds), state, holds)


def held_together(scene, holds):
    """The scene (B scenes) in whose coming step the bonds hold that `holds` (B, N) says."""
    lead, body = [], []
    own = scene.body if scene.body is not None else torch.full(scene.mask.shape, -1)
    array = lambda values: values.cpu().numpy()  # noqa: E731
    for pairs, mask, hold, units in zip(*map(array, (scene.bonds.pairs, scene.bonds.mask, holds, own))):
        found = clusters_at(pairs[mask], hold[mask].astype(np.int64), len(units), units, 0)
        lead.append(found[0])
        body.append(found[1])
    put = lambda rows: torch.from_numpy(np.stack(rows)).to(scene.mask.device)  # noqa: E731
    return dataclasses.replace(scene, lead=put(lead), body=put(body))


def step(model, scene, state, holds):
    """The next state, the bonds (B, N) that hold from there on, and which units were predicted. What breaks in the step does not
    hold in it."""
    broken = (said(model, scene, state, holds) > 0) & holds
    state, _, active = model.step(held_together(scene, holds & ~broken), state)
    return state, holds & ~broken, active


def loss(model, scene, state, frames):
    """Binary cross entropy of what breaks in the step from frames[:, 0] of the record to frames[:, 1], over the bonds that hold until
    then."""
    bonds = scene.bonds
    holds = bonds.mask & (bonds.until > frames[:, :1])
    breaks = (bonds.until <= frames[:, 1:]).float()
    found = model.breaking(scene, state, holds)
    holds = holds & (found > NEVER)  # of the others nothing can be learnt
    each = F.binary_cross_entropy_with_logits(found, breaks, reduction="none")
    return (each * holds).sum() / holds.sum().clamp(min=1)


@torch.no_grad()
def fit_normalisation(model, batches):
    """Constants of the features, from (scene, state, frames) as `loss` takes them."""
    seen = []
    for scene, state, frames in batches:
        holds = scene.bonds.mask & (scene.bonds.until > frames[:, :1])
        seen.append(model.bond_features(scene, state, model.prior(scene, state), holds)[holds])
    seen = torch.cat(seen)
    model.bonds.feature_mean.copy_(seen.mean(0))
    model.bonds.feature_scale.copy_(1 / seen.std(0).clamp(min=1e-3))
