"""What lets a whole training live on an accelerator: scenes in its memory, windows drawn and told in tensors of fixed shapes, and one
flat optimizer. Nothing is copied and nobody waits, so that a whole update can be a CUDA graph.

The lab's `data`, `model` and `train` are what all of this is held to by tests.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import torch

from .data import IMPULSE_M_S, LATEST_START, SUBSETS
from .geometry import _nearest_torch, nearest_points, prepare_points, quaternion_to_matrix
from .ground import groups, planes_of
from .impacts import extreme_points
from .model import ANCHORS, RigidFormer, Scene, State, transform
from .pieces import centre_of, rows_of
from .scenes import EXTRA, TRAIN, Scenes

try:
    import triton
    import triton.language as tl
except ImportError:  # there is none for processors
    triton = None

#: Query points and candidates that a program of the kernel compares at a time.
QUERIES, CANDIDATES = 64, 64


if triton is not None:

    @triton.jit
    def _nearest_kernel(
        query, rotation, centre, radius, start, count, bank, scale, below, row_out, unit_out, units, points,
        QUERIES: tl.constexpr, CANDIDATES: tl.constexpr,
    ):  # fmt: skip
        """The nearest row of the bank to each of a unit's points, among other units' points nearer than `below`; unit -1: none."""
        job = tl.program_id(0)
        batch, mine = job // units, job % units
        p = tl.program_id(1) * QUERIES + tl.arange(0, QUERIES)
        inside = p < points
        at = (job.to(tl.int64) * points + p) * 3
        x = tl.load(query + at, mask=inside, other=0.0)
        y = tl.load(query + at + 1, mask=inside, other=0.0)
        z = tl.load(query + at + 2, mask=inside, other=0.0)
        far = tl.load(below + job.to(tl.int64) * points + p, mask=inside, other=0.0)
        best = far * far
        who = tl.full((QUERIES,), -1, tl.int32)
        row = tl.zeros((QUERIES,), tl.int32)
        for j in range(units):
            other = batch * units + j
            rows = tl.load(count + other)
            if (j != mine) & (rows > 0):
                dx = x - tl.load(centre + other * 3)
                dy = y - tl.load(centre + other * 3 + 1)
                dz = z - tl.load(centre + other * 3 + 2)
                gap = tl.sqrt(dx * dx + dy * dy + dz * dz) - tl.load(radius + other)
                near = inside & ((gap <= 0) | (gap * gap <= best))
                if tl.max(near.to(tl.int32), 0) > 0:
                    r = rotation + other * 9
                    size = tl.load(scale + other)
                    by = 1.0 / size
                    qx = (tl.load(r) * dx + tl.load(r + 3) * dy + tl.load(r + 6) * dz) * by
                    qy = (tl.load(r + 1) * dx + tl.load(r + 4) * dy + tl.load(r + 7) * dz) * by
                    qz = (tl.load(r + 2) * dx + tl.load(r + 5) * dy + tl.load(r + 8) * dz) * by
                    low = best * by * by
                    first = tl.load(start + other)
                    for k in range(0, rows, CANDIDATES):
                        c = k + tl.arange(0, CANDIDATES)
                        there = c < rows
                        from_ = bank + (first + c) * 3
                        ex = tl.load(from_, mask=there, other=1e9)[None, :] - qx[:, None]
                        ey = tl.load(from_ + 1, mask=there, other=1e9)[None, :] - qy[:, None]
                        ez = tl.load(from_ + 2, mask=there, other=1e9)[None, :] - qz[:, None]
                        d2 = ex * ex + ey * ey + ez * ez
                        least = tl.min(d2, 1)
                        index = tl.argmin(d2, 1).to(tl.int32)
                        better = least < low
                        low = tl.where(better, least, low)
                        row = tl.where(better, first + k + index, row)
                        who = tl.where(better, j, who)
                        best = tl.where(better, least * size * size, best)
        tl.store(row_out + job.to(tl.int64) * points + p, row, mask=inside)
        tl.store(unit_out + job.to(tl.int64) * points + p, who, mask=inside)


def nearest_by_kernel(query, rotation, centre, radius, start, count, bank, scale, below, unit):
    """As `nearest_points`, of units that are bodies of their own. below, unit: what `Planes.nearest` gives."""
    b, m, p, _ = query.shape
    narrow = lambda t: t.to(torch.int32).contiguous()  # noqa: E731
    row, who = (torch.empty(b, m, p, dtype=torch.int32, device=query.device) for _ in range(2))
    _nearest_kernel[(b * m, -(-p // QUERIES))](
        query.contiguous(), rotation.contiguous(), centre.contiguous(), radius.contiguous(), narrow(start), narrow(count),
        bank, scale.contiguous(), below.contiguous(), row, who, m, p, QUERIES, CANDIDATES, num_warps=4,
    )  # fmt: skip
    found = who >= 0
    size = scale.gather(1, who.clamp(min=0).flatten(1).long()).view(b, m, p, 1)
    local = bank[row.long()] * size
    return torch.where(found, who.long(), unit), torch.where(found[..., None], local, torch.zeros_like(local))


def moved(rotation, centre, local):
    """As `transform`, on accelerators without products of small matrices, which those take one by one."""
    if not local.is_cuda:
        return transform(rotation, centre, local)
    return (local[..., None, :] * rotation[..., None, :, :]).sum(-1) + centre[..., None, :]


class FastRigidFormer(RigidFormer):
    """The same model whose inputs "paper" are told without waiting, and whose learned part may use an accelerator's short floats."""

    tf32 = False
    compiled = None  # of the learned part

    def features(self, scene: Scene, state: State):
        if self.config.features != "paper" or scene.role is not None or scene.body is not None:
            return super().features(scene, state)
        planes = self.planes(scene)
        points = moved(state.rotation, state.centre, scene.points)
        before = moved(state.previous_rotation, state.previous_centre, scene.points)
        first = moved(*scene.reference, scene.points)
        with torch.no_grad():
            where = (state.rotation, state.centre, scene.radius, scene.start, scene.count, scene.bank, scene.scale)
            if points.is_cuda:
                below, unit = planes.nearest(points)
                if triton is not None:
                    unit, local = nearest_by_kernel(points, *where, below, unit)
                else:
                    rotation, centre, _, *rest = where
                    group = groups(None, scene.count)
                    unit, local = _nearest_torch(points, rotation, centre, *rest, group, below, unit)
            else:
                unit, local = nearest_points(points, scene.points_in_use * scene.mask, *where, planes, None)
        b, m, p = unit.shape
        other = unit.clamp(min=0).flatten(1)[..., None]
        turn = state.rotation.flatten(2).gather(1, other.expand(-1, -1, 9)).view(b, m, p, 3, 3)
        near = (local[..., None, :] * turn).sum(-1) + state.centre.gather(1, other.expand(-1, -1, 3)).view(b, m, p, 3)
        up, height, _, _ = planes.under(points, unit)
        displacement = torch.where((unit < 0)[..., None], up * -height[..., None], near - points)
        physics = scene.physics[:, :, None].expand(points.shape)
        return torch.cat((displacement, points - before, points - first, physics), -1)

    def learned(self, *arguments, **more):
        plain = super().learned if self.compiled is None or not self.training else self.compiled
        if not self.tf32:
            return plain(*arguments, **more)
        torch.backends.cuda.matmul.allow_tf32 = True
        out = plain(*arguments, **more)
        torch.backends.cuda.matmul.allow_tf32 = False  # poses need all bits
        return out


class Shapes:
    """Points of all shapes, each once: the bank, and random subsets to draw from."""

    def __init__(self):
        self.known, self.bank, self.start, self.count, self.centre, self.radius, self.rows = {}, [], [], [], [], [], 0

    def number(self, points, pieces):
        """The shape's number; a new one if nobody had it yet."""
        key = points.tobytes()
        if key not in self.known:
            local, centre = prepare_points(points, centre_of(pieces) if pieces else None)
            hull = np.concatenate(rows_of(pieces, centre) or [local[extreme_points(local)]])
            self.known[key] = len(self.start)
            self.bank.append(local)
            self.start.append(self.rows)
            self.count.append(len(local))
            self.centre.append(centre)
            self.radius.append(np.linalg.norm(np.concatenate((local, hull)), axis=1).max())
            self.rows += len(local)
        return self.known[key]

    def subsets(self, rng, points):
        """(shapes, SUBSETS, points) rows of the bank: anchors, and random others in order; no shape has fewer points."""
        if min(self.count) < points:
            raise ValueError(f"a shape has {min(self.count)} points, and {points} are asked for; give fewer --points")
        out = np.zeros((len(self.count), SUBSETS, points), np.int64)
        for k, n in enumerate(self.count):
            keys = rng.random((SUBSETS, n))
            keys[:, :ANCHORS] = -1.0
            out[k] = self.start[k] + np.sort(np.argsort(keys, axis=1)[:, :points], axis=1)
        return out


@dataclasses.dataclass
class Prepared:
    """Scenes of one number of units, as arrays (scenes, ...)."""

    shape: np.ndarray  # (S, M)
    scale: np.ndarray  # (S, M)
    physics: np.ndarray  # (S, M, 3)
    poses: np.ndarray  # (S, T, M, 7): centre, quaternion
    hits: np.ndarray  # (S, T)


def prepare(file: Scenes, shapes: Shapes, frames: int, splits=(TRAIN, EXTRA)) -> dict[int, Prepared]:
    """Scenes of a file by their number of units, as `Dataset` has them; units are free bodies of their own on the ground z = 0."""
    if file.frames < frames or (file.scene_frames is not None and (file.scene_frames < frames).any()):
        raise ValueError(f"scenes have fewer than {frames} frames; give a smaller --last-frame, or longer scenes")
    plain = file._ground() is not None and file.commands is None and not file.soft_offsets[-1]
    if not plain or np.any(file.roles) or np.any(file.bodies >= 0):
        raise ValueError("scenes have planes, parts, driven or soft units, or commands; train on them with `train`")
    number = np.array([shapes.number(file.points_of_shape(k), file.pieces_of_shape(k)) for k in range(len(file.shape_names))])
    gravity = np.array(file.gravity_m_s2)
    out, count = {}, np.diff(file.scene_units)
    chosen = np.isin(file.scene_split, splits)
    for m in sorted(set(count[chosen].tolist())):
        scenes = np.flatnonzero(chosen & (count == m))
        rows = file.scene_units[scenes][:, None] + np.arange(m)  # (S, M)
        shape, scale = number[file.unit_shape[rows]], file.unit_scale[rows]
        pose = file.unit_poses[rows, :frames].astype(np.float32)  # (S, M, T, 7)
        offset = np.stack(shapes.centre).astype(np.float32)[shape] * scale[..., None]
        centre = pose[..., :3] + np.einsum("smtij,smj->smti", quaternion_to_matrix(pose[..., 3:]), offset, optimize=True)
        c = centre.astype(np.float64)
        bend = c[:, :, 2:] - 2 * c[:, :, 1:-1] + c[:, :, :-2] - gravity / file.frame_rate_hz**2
        push = np.zeros(c.shape[:3], bool)
        push[:, :, 1:-1] = np.linalg.norm(bend, axis=-1) * file.frame_rate_hz > IMPULSE_M_S
        poses = np.concatenate((centre, pose[..., 3:]), -1).swapaxes(1, 2)
        out[m] = Prepared(shape, scale, file.unit_physics[rows], poses, np.cumsum(push.any(1), axis=1).astype(np.int16))
    return out


class Bucket:
    """Scenes of one number of units on the device. Tensors stay where they are as scenes are added."""

    def __init__(self, units, capacity, frames, device):
        self.units, self.frames, self.device, self.used = units, frames, device, 0
        kind = dict(device=device)
        self.shape = torch.zeros(capacity, units, dtype=torch.int64, **kind)
        self.scale = torch.ones(capacity, units, **kind)
        self.physics = torch.zeros(capacity, units, 3, **kind)
        self.poses = torch.zeros(capacity, frames, units, 7, **kind)
        self.hits = torch.zeros(capacity, frames, dtype=torch.int16, **kind)
        self.starts, self.counts = {}, {}

    def add(self, part: Prepared):
        """Takes as many as there is room for; how many."""
        many = min(len(part.shape), len(self.shape) - self.used)
        for name in ("shape", "scale", "physics", "poses", "hits"):
            value = torch.from_numpy(np.ascontiguousarray(getattr(part, name)[:many]))
            getattr(self, name)[self.used : self.used + many] = value.to(self.device)
        self.used += many
        return many

    def refresh(self, steps, horizon, latest=LATEST_START):
        """Where windows may begin, of every step code: (scene, frame) as scene x frames + frame, with a contact and without."""
        for code in sorted(set(steps)):
            last = min(latest, self.frames - 1 - code * (horizon + 1))
            if last < 0:
                raise ValueError(f"{horizon} predictions of {code} frames take {code * (horizon + 1) + 1} frames of a scene")
            hits = self.hits[: self.used]
            hit = hits[:, code * (horizon + 1) : code * (horizon + 1) + last + 1] > hits[:, code : code + last + 1]
            for with_contact, chosen in ((True, hit), (False, ~hit)):
                if not chosen.any():
                    chosen = torch.ones_like(chosen)
                scene, frame = chosen.nonzero(as_tuple=True)
                key = code, with_contact
                if key not in self.starts:
                    self.starts[key] = torch.zeros(len(self.shape) * self.frames, dtype=torch.int32, device=self.device)
                    self.counts[key] = torch.zeros((), dtype=torch.int64, device=self.device)
                self.starts[key][: len(scene)] = (scene * self.frames + frame).int()
                self.counts[key].fill_(len(scene))


def shares(count, steps, contact_share):
    """(step code, with a contact, how many windows) of a batch of `count`, as `Dataset.windows` has them on average."""
    out, done = [], 0
    for k, code in enumerate(steps):
        upto = round(count * (k + 1) / len(steps))
        many, done = upto - done, upto
        with_contact = round(many * contact_share)
        out += [(code, True, with_contact), (code, False, many - with_contact)]
    return [part for part in out if part[2]]


class Sampler:
    """Draws windows on the device."""

    def __init__(self, shapes: Shapes, config, physics_of_ground, device, seed=0):
        self.shapes, self.config, self.device = shapes, config, device
        self.rng = np.random.default_rng(seed)
        put = lambda a, kind=torch.float32: torch.tensor(np.stack(a), dtype=kind, device=device)  # noqa: E731
        self.bank = torch.from_numpy(np.concatenate(shapes.bank).astype(np.float32)).to(device)
        self.start, self.count = put(shapes.start, torch.int64), put(shapes.count, torch.int64)
        self.radius = put(shapes.radius)
        self.ground = torch.tensor([[0.0, 0.0, 1.0, 0.0, *physics_of_ground]], device=device)
        self.subset = {}

    def refresh(self, points):
        """Other random points of every shape."""
        fresh = torch.from_numpy(self.shapes.subsets(self.rng, points)).to(self.device)
        if points in self.subset:
            self.subset[points].copy_(fresh)
        else:
            self.subset[points] = fresh

    def draw(self, bucket: Bucket, count, steps, contact_share=0.8):
        """Scenes, first frames and step codes (B,) of `count` windows."""
        scene, frame, code = [], [], []
        for step, with_contact, many in shares(count, steps, contact_share):
            total = bucket.counts[step, with_contact]
            index = (torch.rand(many, dtype=torch.float64, device=self.device) * total).long().minimum(total - 1)
            start = bucket.starts[step, with_contact][index].long()
            scene.append(start // bucket.frames)
            frame.append(start % bucket.frames)
            code.append(torch.full((many,), step, dtype=torch.int64, device=self.device))
        return torch.cat(scene), torch.cat(frame), torch.cat(code)

    def window(self, bucket: Bucket, scene, frame, code, horizon, points, augment=True, pick=None):
        """Scene, and truth as rotation (B, M, T, 3, 3), centre (B, M, T, 3), as `Dataset.tensors` has them. pick (B, M, points): rows of
        the bank; None: a random subset."""
        b, m, t = len(scene), bucket.units, horizon + 2
        frames = frame[:, None] + code[:, None] * torch.arange(t, device=self.device)
        origin = frame
        if augment:
            origin = (torch.rand(b, device=self.device) * (frame + 1)).long().minimum(frame)
        frames = torch.cat((frames, origin[:, None]), 1)
        pose = bucket.poses[scene[:, None], frames].transpose(1, 2)  # (B, M, T + 1, 7)
        centre, rotation = pose[..., :3], quaternion_to_matrix(pose[..., 3:])
        if augment:  # the world has no preferred heading and place
            angle = torch.rand(b, device=self.device) * (2 * math.pi)
            zero, cos, sin = torch.zeros_like(angle), angle.cos(), angle.sin()
            turn = torch.stack((cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1), -1).view(b, 1, 1, 3, 3)
            shift = torch.stack((torch.rand_like(angle), torch.rand_like(angle), zero + 0.5), -1) * 6 - 3
            centre = (turn * centre[..., None, :]).sum(-1) + shift[:, None, None]
            rotation = (turn[..., None] * rotation[..., None, :, :]).sum(-2)
        shape, scale = bucket.shape[scene], bucket.scale[scene]
        if pick is None:
            chosen = torch.randint(SUBSETS, (b, m), device=self.device)
            pick = self.subset[points][shape, chosen]
        local = self.bank[pick] * scale[..., None, None]
        out = Scene(
            points=local, points_in_use=torch.full((b, m), local.shape[2], dtype=torch.int64, device=self.device),
            mask=torch.ones(b, m, dtype=torch.bool, device=self.device), physics=bucket.physics[scene],
            radius=self.radius[shape] * scale, reference=(rotation[:, :, t], centre[:, :, t]),
            start=self.start[shape], count=self.count[shape], scale=scale, bank=self.bank, step=code, full=True,
            planes=planes_of(self.ground.expand(b, 1, 6)),
        )  # fmt: skip
        return out, rotation[:, :, :t], centre[:, :, :t]


class Flat:
    """AdamW, clipping and the moving average of all weights as one tensor each."""

    BETAS, EPS, WEIGHT_DECAY = (0.9, 0.999), 1e-8, 0.01

    def __init__(self, model, decay):
        self.names = [name for name, _ in model.named_parameters()]
        self.parameters = list(model.parameters())
        self.model, self.decay = model, decay
        self.sizes = [p.numel() for p in self.parameters]
        # Each at a multiple of 16 bytes, which fast products want.
        self.places, total = [], 0
        for size in self.sizes:
            self.places.append(total)
            total += -(-size // 4) * 4
        first = self.parameters[0]
        self.weights, self.gradient, self.mean, self.square, self.average = (
            torch.zeros(total, device=first.device, dtype=first.dtype) for _ in range(5)
        )
        for p, value, slope in zip(self.parameters, self.views(self.weights), self.views(self.gradient)):
            value.copy_(p.data)
            p.data, p.grad = value, slope
        self.average.copy_(self.weights)
        self.count = torch.zeros((), device=first.device)
        self.rate = torch.zeros((), device=first.device)

    def views(self, flat):
        return [flat[a : a + n].view(p.shape) for a, n, p in zip(self.places, self.sizes, self.parameters)]

    @torch.no_grad()
    def step(self, clip=1.0):
        """One update from the gradient; nothing where it is not finite. The gradient is zero afterwards."""
        norm = self.gradient.square().sum().sqrt()
        fine = torch.isfinite(norm)
        bad = (~fine).to(torch.float32)
        self.gradient.mul_((clip / (norm + 1e-6)).clamp(max=1.0))
        self.count += fine
        torch._fused_adamw_(
            [self.weights], [self.gradient], [self.mean], [self.square], [], [self.count], lr=self.rate, beta1=self.BETAS[0],
            beta2=self.BETAS[1], weight_decay=self.WEIGHT_DECAY, eps=self.EPS, amsgrad=False, maximize=False, found_inf=bad,
        )  # fmt: skip
        keep = torch.minimum((1 + self.count) / (10 + self.count), torch.full_like(self.count, self.decay))
        self.average.lerp_(self.weights, ((1 - keep) * fine).to(self.average.dtype))
        self.gradient.zero_()
        return norm

    def state(self, flat):
        """A state dict with values of a flat tensor, buffers as the model has them; copies."""
        own = {name: value.clone() for name, value in zip(self.names, self.views(flat))}
        return {name: own[name] if name in own else value.clone() for name, value in self.model.state_dict().items()}

    def load(self, flat, state):
        for name, value in zip(self.names, self.views(flat)):
            value.copy_(state[name])
