"""A model of soft bodies: what the network adds to their elastic motion, blended from anchors to points (docs/MODEL.md, sections 6
and 7)."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from . import soft
from .config import BLEND_CODE, BLEND_HIDDEN, ModelConfig
from .geometry import kabsch, nearest_points
from .ground import planes_of
from .model import ANCHORS, Mlp, RigidFormer, wide
from .roles import FREE, MAX_PLANES
from .soft_data import Batch, State

#: Changes of motion by springs and contact that the network is told, m/s.
CHANGE_CLAMP = 10.0


class SoftFormer(RigidFormer):
    """As `RigidFormer`, of scenes with soft units. Rigid units beside them go as the elastic motion says."""

    def __init__(self, config: ModelConfig):
        super().__init__(config)
        self.blend = nn.ModuleDict({"residual": Mlp(config.point_width + BLEND_CODE, BLEND_HIDDEN, 6, zero=True)})
        self.log_radius = nn.Parameter(torch.tensor(-0.5))  # of the blend's kernel, in radii of units

    def motion_of(self, batch: Batch, state: State):
        """Per scene what `soft.advance` returns."""
        out = []
        for b, r in enumerate(batch.records):
            frame = state.frame[b]
            later = min(frame + int(batch.step[b]), r.frames - 1)
            start = state.centre[b], state.centre_before[b], r.rotation[:, frame]
            target = r.centre[:, later]
            out.append(soft.advance(self.config.elastic, r.web, r.obstacles, np.delete(r.planes, 5, 1), r.gravity,
                                       float(batch.dt[b]), state.points[b], state.before[b], start, target))  # fmt: skip
        return out

    def padded(self, batch: Batch, rows) -> torch.Tensor:
        """(B, M, P, 3) of each scene's (R, 3), zeros elsewhere."""
        out = np.zeros((*batch.rest.shape[:2], batch.rest.shape[2], 3), np.float32)
        for b, values in enumerate(rows):
            out[b].reshape(-1, 3)[batch.slots[b]] = values
        return torch.from_numpy(out)

    def places(self, batch: Batch, state: State):
        """Points of all units and where they were a step before (B, M, P, 3), and their centres then and now (B, M, 3)."""
        points, before = self.padded(batch, state.points), self.padded(batch, state.before)
        used = batch.points_in_use.clamp(min=1)[..., None]
        centre, earlier = points.sum(2) / used, before.sum(2) / used
        for b, r in enumerate(batch.records):
            for k, m in enumerate(np.flatnonzero(~r.soft)):
                local = torch.from_numpy(batch.local[b][k] @ r.rotation[k, state.frame[b]].T)
                for where, own, middles in ((points, state.centre[b][k], centre), (before, state.centre_before[b][k], earlier)):
                    middles[b, m] = torch.from_numpy(own)
                    where[b, m, : len(local)] = local + middles[b, m]
        return points, before, centre, earlier

    def soft_features(self, batch: Batch, state: State, moved):
        """Raw features (B, M, P, F), and the points' places."""
        points, before, centre, _ = self.places(batch, state)
        dt = batch.dt[:, None, None, None]
        rows = np.zeros((len(batch.records), MAX_PLANES, 6), np.float32)
        valid = np.zeros(rows.shape[:2], bool)
        for b, r in enumerate(batch.records):
            rows[b, : len(r.planes)], valid[b, : len(r.planes)] = r.planes, True
        most = max(len(r.planes) for r in batch.records)
        planes = planes_of(torch.from_numpy(rows[:, :max(most, 1)]), torch.from_numpy(valid[:, :max(most, 1)]))
        # Each unit's points as they are now, about its centre: a soft unit's shape changes.
        b, m, p = points.shape[:3]
        bank = (points - centre[:, :, None]).reshape(-1, 3)
        eye = torch.eye(3).expand(b, m, 3, 3).contiguous()
        start = (torch.arange(b * m) * p).view(b, m)
        row = torch.arange(p)
        inside = row < batch.points_in_use[..., None]
        radius = (bank.view(b, m, p, 3).square().sum(-1) * inside).amax(-1).sqrt()
        unit, local = nearest_points(points, batch.points_in_use * batch.mask, eye, centre, radius, start,
                                     batch.points_in_use * batch.mask, bank, torch.ones(b, m), planes,
                                     torch.where(batch.mask, batch.body, -1 - torch.arange(m)))  # fmt: skip
        index = torch.arange(b)[:, None, None]
        other = unit.clamp(min=0)
        near = local + centre[index, other]
        # The rate of the nearest point: found again among that unit's points.
        increment = points - before
        near_increment = self._increment_at(increment, points, other, near)
        gravity = torch.from_numpy(np.stack([r.gravity for r in batch.records]))
        placed = self.fitted(batch, points)
        raw = self.describe(
            points, increment, placed, near, near_increment, unit < 0, points - centre[:, :, None],
            batch.physics[:, :, None].expand(points.shape), batch.physics[index, other], dt, planes.under(points, unit),
            batch.free[:, :, None], batch.free[index, other], gravity[:, None, None],
        )  # fmt: skip
        after, velocity = self.padded(batch, [v[0] for v in moved]), self.padded(batch, [v[1] for v in moved])
        fall = gravity[:, None, None] * dt
        way = (after - (points + increment + fall * dt)) / dt
        rate = velocity - (increment / dt + fall * 1.5)
        soft = batch.soft[:, :, None, None]
        change = (torch.cat((way, rate), -1) * soft).clamp(-CHANGE_CLAMP, CHANGE_CLAMP)
        young = batch.ln_young[:, :, None, None].expand(*points.shape[:3], 1)
        return torch.cat((raw, young, change), -1) * inside[..., None], points, after, velocity

    @staticmethod
    def _increment_at(increment, points, unit, near):
        """(B, M, P, 3): the increment of the point of `unit` at `near`."""
        b, m, p = unit.shape
        out = torch.zeros_like(near)
        for scene in range(b):
            for other in unit[scene].unique():
                asks = unit[scene] == other
                apart = torch.cdist(near[scene][asks], points[scene, other])
                out[scene][asks] = increment[scene, other][apart.argmin(1)]
        return out

    def fitted(self, batch: Batch, points):
        """Where the points of soft units would be if the units were rigid, by their anchors (B, M, P, 3); rigid ones: as they are."""
        anchors = batch.rest[:, :, :ANCHORS]
        rotation, shift = kabsch(anchors, points[:, :, :ANCHORS])
        rigid = batch.rest @ rotation.transpose(-1, -2) + shift[:, :, None]
        return torch.where(batch.soft[:, :, None, None], rigid, points)

    def kernel(self, batch: Batch):
        """(B, M P, M A): weights of anchors for points."""
        reach = self.log_radius.exp() * batch.radius
        own = torch.isfinite(batch.weights)
        near = -batch.weights.masked_fill(~own, 0.0) / reach.square()[:, None, None]  # infinity would have no gradient
        some = own.any(-1, keepdim=True)
        return torch.softmax(near.masked_fill(~own & some, -torch.inf), -1) * some

    def predict(self, batch: Batch, state: State, trace=None):
        """The points of soft units after a step and their velocities then (B, M, P, 3) each, before those of one mass are made one;
        and what `motion_of` says."""
        with torch.no_grad():
            moved = self.motion_of(batch, state)
            raw, points, after, velocity = self.soft_features(batch, state, moved)
        anchors = points[:, :, :ANCHORS]
        code = batch.step * (self.config.frame_rate_hz / torch.tensor([r.frame_rate for r in batch.records])) / 10.0
        step = torch.stack((code, code.square()), -1)
        features = self.encoder.normalise(raw)
        token, hidden = self.encoder(features, batch.points_in_use, step, None)
        pooled = self.anchors.weights(points, batch.points_in_use) @ hidden
        out = self.interact(anchors, token, features[:, :, :ANCHORS], pooled, batch.mask, step, None, trace)
        b, m, p = points.shape[:3]
        dt = batch.dt[:, None, None, None]
        way, rate, told = out.split((3, 3, BLEND_CODE), -1)
        scale = self.config.output_scale
        from_ = after[:, :, :ANCHORS]
        advanced = from_ + way * (scale * dt)
        turn, _ = kabsch(from_, advanced)
        rotated = (turn[:, :, None] @ from_[..., None])[..., 0]
        kernel = self.kernel(batch)

        def spread(values):
            return kernel @ values.flatten(1, 2)

        turns = spread(turn.flatten(2)[:, :, None].expand(b, m, ANCHORS, 9)).view(b, -1, 3, 3)
        moved_points = (turns @ after.flatten(1, 2)[..., None])[..., 0] + spread(advanced - rotated)
        velocities = velocity.flatten(1, 2) + spread(rate) * scale
        residual = wide(self.blend["residual"](torch.cat((hidden.flatten(1, 2), spread(told)), -1)))
        moved_points = moved_points + residual[..., :3] * (scale * batch.dt[:, None, None])
        velocities = velocities + residual[..., 3:] * scale
        if trace is not None:
            trace.update(raw_features=raw, features=features, point_features=hidden, tokens=token, head=out)
        return moved_points, velocities, moved

    @staticmethod
    def welded(batch: Batch, values):
        """(B, M P, 3): the mean of the rows that are one mass, for each of them."""
        index = batch.owner[..., None].expand_as(values)
        total = torch.zeros_like(values).scatter_add(1, index, values)
        return total.gather(1, index) / batch.copies[..., None]

    def step(self, batch: Batch, state: State, trace=None):
        """The next state, and points and velocities (B, M P, 3) with gradients."""
        points, velocities, moved = self.predict(batch, state, trace)
        points, velocities = self.welded(batch, points), self.welded(batch, velocities)
        after, before, centre, earlier, frame = [], [], [], [], []
        x, v = points.detach().numpy(), velocities.detach().numpy()
        for b, r in enumerate(batch.records):
            dt, g = np.float32(batch.dt[b]), r.gravity
            own = soft.limit(self.config.elastic, r.web, x[b][batch.slots[b]])
            own = self.outside(r, own, moved[b][2], min(state.frame[b] + int(batch.step[b]), r.frames - 1))
            after.append(own)
            before.append(own - (v[b][batch.slots[b]] - g * (dt / 2)) * dt)
            centre.append(moved[b][2])
            earlier.append(moved[b][2] - (moved[b][3] - g * (dt / 2)) * dt)
            frame.append(min(state.frame[b] + int(batch.step[b]), r.frames - 1))
            free = r.role[~r.soft] == FREE
            earlier[-1][~free] = state.centre[b][~free]
        return State(after, before, centre, earlier, frame), points, velocities

    def outside(self, r, x, centre, frame):
        """Points out of planes and of rigid balls."""
        skin = np.float32(self.config.elastic.skin_m)
        x = x.copy()
        for k in range(len(centre)):
            if r.obstacles.ball[k] > 0:
                away = x - centre[k]
                size = np.linalg.norm(away, axis=1, keepdims=True).clip(1e-9)
                x += away / size * (r.obstacles.ball[k] + skin - size).clip(0)
        for plane in r.planes:
            depth = plane[3] + skin - x @ plane[:3]
            x += plane[:3] * depth.clip(0)[:, None]
        return x
