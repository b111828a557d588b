"""RigidFormer in PyTorch: the independent check of the Rust core, and what is trained.

Shapes: B scenes, M units (padded, `mask`), P points a unit (padded, `points_in_use`;
the first four are the anchors, all in farthest-point order), A = 4 anchors,
D width, C point width, H heads. Section numbers are those of docs/MODEL.md.
"""

from __future__ import annotations

import dataclasses

import torch
import torch.nn.functional as F
from torch import nn

from .bonds import hold_together as put_together, most
from .breaking import NEVER, SHARE, BondHead, Bonds, describe as describe_bonds
from .config import IMPACT_FEATURES, IMPACT_PUSHES, IMPACTS, ModelConfig
from .geometry import kabsch, nearest_points
from .ground import Planes, coming_motion, groups, landing, level_ground, meeting, next_poses
from .impacts import GROUND, depths, find_impacts
from .joints import Joints, hold_together, turn_together
from .prior import kept_apart, solve
from .roles import FREE

ANCHORS = 4
EPS = 1e-6
FEATURE_CLAMP = 10.0
PROXIMITY_M = 0.1
RAMP_M = 0.05
TOUCHING_M = 0.02
GAP_CLAMP_M = 0.5
TINY_M = 1e-6
TINY_TURN = 1e-6


@dataclasses.dataclass
class Scene:
    """What does not change during a rollout."""

    points: torch.Tensor  # (B, M, P, 3) local to the unit's centre, metres
    points_in_use: torch.Tensor  # (B, M) int64
    mask: torch.Tensor  # (B, M) bool, unit exists
    physics: torch.Tensor  # (B, M, 3) mass kg, friction, restitution
    radius: torch.Tensor  # (B, M) bounding sphere about the centre, metres
    reference: tuple[torch.Tensor, torch.Tensor]  # first pose: (B,M,3,3), (B,M,3)
    start: torch.Tensor  # (B, M) first row of the unit's shape in the bank
    count: torch.Tensor  # (B, M) its rows, 0 for padding
    scale: torch.Tensor  # (B, M) bank units to metres
    bank: torch.Tensor  # (K, 3) all points of all shapes, relative to their centres
    step: torch.Tensor  # (B,) frames s a step; where frame_rate is None this is the step code
    command: torch.Tensor | None = None  # (B, command_size)
    # For models with impacts: as start, count and bank, of the extreme points alone.
    hull_start: torch.Tensor | None = None
    hull_count: torch.Tensor | None = None
    hull_bank: torch.Tensor | None = None
    # Convex pieces of units, as in `solver.World`: their first row and how many (B, M), rows of hull_bank (P, 2) and balls
    # around them (P, 4). None: each unit is one.
    piece_start: torch.Tensor | None = None
    piece_count: torch.Tensor | None = None
    piece_bank: torch.Tensor | None = None
    piece_ball: torch.Tensor | None = None
    extent: torch.Tensor | None = None  # (B, M, 3) sides of the box that has a unit's inertia, metres
    ball: torch.Tensor | None = None  # (B, M) bool: a ball to the impulses; None: none is
    full: bool = False  # every unit that exists has P points
    # What else belongs to a scene; each has a default.
    frame_rate: torch.Tensor | None = None  # (B,) frames a second, Hz; None: the model's
    role: torch.Tensor | None = None  # (B, M) FREE, DRIVEN or FIXED; None: all free
    body: torch.Tensor | None = None  # (B, M) units of one body share a number, -1: of its own; None: all their own
    planes: Planes | None = None  # None: z = 0 with the model's friction and restitution
    gravity: torch.Tensor | None = None  # (B, 3) m/s^2; None: the model's
    law: torch.Tensor | None = None  # (B, 2) contact law: restitution offset, and 1 for a pyramid of friction; None: all are rigid
    commands: torch.Tensor | None = None  # (B, T - 1, command_size) of the steps of a recorded window of T frames
    typical: torch.Tensor | None = None  # (B, 2) as `typical` says, of units that are not all here; None: of those here
    length: torch.Tensor | None = None  # (B,) metres that stand for one, where the scene is measured in its own length
    frame: tuple[torch.Tensor, torch.Tensor] | None = None  # heading (B, 3, 3), origin (B, 3), where all is seen from there
    # Of a recorded window of T frames: what the velocity at each is in a step, metres (B, M, T, 3), and its turn (B, M, T, 3, 3).
    pace: tuple[torch.Tensor, torch.Tensor] | None = None
    # The first unit of the cluster that a unit is in, which bonds hold together, or itself (B, M); None: all are alone.
    lead: torch.Tensor | None = None
    bonds: Bonds | None = None
    # Of a recorded window of T frames: leads and bodies in the steps from each to the next (B, M, T - 1).
    clusters: tuple[torch.Tensor, torch.Tensor] | None = None
    joints: Joints | None = None  # None: no unit hangs from another; others need `extent`


@dataclasses.dataclass
class Prior:
    """The motion that the network corrects, where it is that by impulses: poses at the end of the step, poses that the
    state keeps as previous ones then, and what a correction of 1 is (section 6)."""

    rotation: torch.Tensor  # (B, M, 3, 3)
    centre: torch.Tensor  # (B, M, 3)
    before_rotation: torch.Tensor
    before_centre: torch.Tensor
    share: torch.Tensor  # (B, M) m/s; 0: nothing touches the unit, -1: it rests
    met: list  # what `kept_apart` takes


@dataclasses.dataclass
class State:
    """Poses of the previous and the current frame, about the units' centres."""

    previous_rotation: torch.Tensor  # (B, M, 3, 3)
    previous_centre: torch.Tensor  # (B, M, 3)
    rotation: torch.Tensor
    centre: torch.Tensor
    # Where driven units go in the next step, (B, M, 3, 3) and (B, M, 3); those of others are not read. None: they
    # stay.
    target_rotation: torch.Tensor | None = None
    target_centre: torch.Tensor | None = None


def transform(rotation, centre, local):
    """(B, M, 3, 3), (B, M, 3), (B, M, P, 3) -> (B, M, P, 3) in the world frame."""
    return local @ rotation.transpose(-1, -2) + centre[..., None, :]


def heading(scene: Scene, rotation, centre):
    """The frame that goes with the heaviest free unit (of all where none is free), the first of equals: its turn about the vertical (B, 3, 3), and the point
    of z = 0 below its centre (B, 3) (section 1)."""
    free = scene.mask if scene.role is None else scene.mask & (scene.role == FREE)
    counted = torch.where(free.any(-1, keepdim=True), free, scene.mask)
    heaviest = scene.physics[..., 0].masked_fill(~counted, -1.0).argmax(1)
    batch = torch.arange(len(heaviest), device=heaviest.device)
    rotation, centre = rotation[batch, heaviest], centre[batch, heaviest]
    cos, sin = rotation[:, 0, 0] + rotation[:, 1, 1], rotation[:, 1, 0] - rotation[:, 0, 1]
    square = cos.square() + sin.square()
    open_ = square < TINY_TURN  # upside down: no heading is nearer than others
    size = torch.where(open_, torch.ones_like(square), square).sqrt()
    cos, sin = torch.where(open_, torch.ones_like(cos), cos / size), torch.where(open_, torch.zeros_like(sin), sin / size)
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    turn = torch.stack((torch.stack((cos, -sin, zero), 1), torch.stack((sin, cos, zero), 1), torch.stack((zero, zero, one), 1)), 1)
    return turn, centre * centre.new_tensor((1.0, 1.0, 0.0))


def typical(scene: Scene):
    """Mean radius about the centre of the box around a unit's points, metres, and mean mass, kg, of the free units, or of
    all where none is free (B, 2) (section 1)."""
    row = torch.arange(scene.points.shape[2], device=scene.points.device)
    outside = ~(row < scene.points_in_use[..., None])[..., None]
    low = scene.points.masked_fill(outside, float("inf")).amin(2)
    high = scene.points.masked_fill(outside, -float("inf")).amax(2)
    reach = (scene.points - ((low + high) / 2)[:, :, None]).square().sum(-1).sqrt()
    size = torch.stack((reach.masked_fill(outside[..., 0], 0.0).amax(2), scene.physics[..., 0]), -1)
    free = scene.mask if scene.role is None else scene.mask & (scene.role == FREE)
    counted = torch.where(free.any(-1, keepdim=True), free, scene.mask)[..., None]
    return (size * counted).sum(1) / counted.sum(1)


def wide(x):
    """Back from bf16 matrix products; f32 and f64 stay."""
    return x.float() if x.dtype == torch.bfloat16 else x


class RmsNorm(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.weight = nn.Parameter(torch.ones(width))

    def forward(self, x):
        return F.rms_norm(wide(x), self.weight.shape, self.weight, EPS)


class Mlp(nn.Module):
    """Linear layers `0`, `1`, ... with SiLU between them; `last` adds one after the last.
    Widths are the inputs, the hidden ones and the outputs."""

    def __init__(self, *widths, last=False, zero=False):
        super().__init__()
        for i, (inputs, outputs) in enumerate(zip(widths, widths[1:])):
            self.add_module(str(i), nn.Linear(inputs, outputs))
        self.last = last
        if zero:
            final = getattr(self, str(len(widths) - 2))
            nn.init.zeros_(final.weight)
            nn.init.zeros_(final.bias)

    def forward(self, x):
        for i, layer in enumerate(self.children()):
            x = layer(F.silu(x) if i else x)
        return F.silu(x) if self.last else x


class Film(nn.Module):
    """h -> (1 + g(c)) h + b(c); starts as the identity."""

    def __init__(self, inputs, hidden, width):
        super().__init__()
        self.mlp = Mlp(inputs, hidden, 2 * width, zero=True)

    def forward(self, h, condition):  # (B, T, D), (B, inputs)
        gain, bias = wide(self.mlp(condition)).chunk(2, -1)
        return h * (1 + gain[:, None]) + bias[:, None]


def turns(angles, head_dim):
    """Angles (B, T, J) -> what `rotate` wants: cosines and signed sines (B, T, 1, Dh);
    channels beyond the 2 J rotated ones turn by nothing."""
    rest = (0, head_dim - 2 * angles.shape[-1])
    sin, cos = angles.sin(), angles.cos()
    cos = F.pad(cos.repeat_interleave(2, -1), rest, value=1.0)
    sin = F.pad(torch.stack((-sin, sin), -1).flatten(-2), rest)
    return cos[:, :, None], sin[:, :, None]


def rotate(x, turn):
    """Rotates channel pairs (2j, 2j+1) of (B, T, H, Dh)."""
    cos, sin = turn
    swapped = x.unflatten(-1, (-1, 2)).flip(-1).flatten(-2)
    return x * cos + swapped * sin


def attend(query, key, value, gate, mask):
    """Gated attention. query, gate (B, Tq, H, Dh); key, value (B, Tk, H, Dh);
    mask (B, Tk), None: all -> (B, Tq, H * Dh)."""
    if mask is not None:
        mask = mask[:, None, None]
    q, k, v = (t.transpose(1, 2) for t in (query, key, value))
    # In f32: among this few tokens bf16 attention is 10 times slower on a CPU.
    with torch.autocast(q.device.type, enabled=False):
        y = F.scaled_dot_product_attention(q, k, v, attn_mask=mask)
    return (torch.sigmoid(gate) * y.transpose(1, 2)).flatten(-2)


class SelfAttention(nn.Module):
    def __init__(self, c: ModelConfig):
        super().__init__()
        self.shape = (4, c.heads, c.head_dim)
        inner = c.heads * c.head_dim
        self.norm = RmsNorm(c.width)
        self.qkvg = nn.Linear(c.width, 4 * inner, bias=False)
        self.query_norm = RmsNorm(c.head_dim)
        self.key_norm = RmsNorm(c.head_dim)
        self.out = nn.Linear(inner, c.width, bias=False)

    def forward(self, z, turn, mask):
        qkvg = wide(self.qkvg(self.norm(z))).unflatten(-1, self.shape)
        q, k, v, g = qkvg.unbind(2)
        q = rotate(self.query_norm(q), turn)
        k = rotate(self.key_norm(k), turn)
        return wide(self.out(attend(q, k, v, g, mask)))


class CrossAttention(nn.Module):
    """Anchor queries to the unit tokens of one scale; the output projection is shared
    by all scales (`anchors.fuse`)."""

    def __init__(self, c: ModelConfig):
        super().__init__()
        self.shape = (2, c.heads, c.head_dim)
        inner = c.heads * c.head_dim
        self.input_norm = RmsNorm(c.width)
        self.unit_norm = RmsNorm(c.width)
        self.query_gate = nn.Linear(c.width, 2 * inner, bias=False)
        self.key_value = nn.Linear(c.width, 2 * inner, bias=False)
        self.query_norm = RmsNorm(c.head_dim)
        self.key_norm = RmsNorm(c.head_dim)

    def forward(self, query, units, query_turn, unit_turn, mask):
        q, g = wide(self.query_gate(self.input_norm(query))).unflatten(-1, self.shape).unbind(2)
        k, v = wide(self.key_value(self.unit_norm(units))).unflatten(-1, self.shape).unbind(2)
        q = rotate(self.query_norm(q), query_turn)
        k = rotate(self.key_norm(k), unit_turn)
        return attend(q, k, v, g, mask)


class FeedForward(nn.Module):
    def __init__(self, c: ModelConfig):
        super().__init__()
        self.norm = RmsNorm(c.width)
        self.gate_up = nn.Linear(c.width, 2 * c.feed_forward_width, bias=False)
        self.down = nn.Linear(c.feed_forward_width, c.width, bias=False)

    def forward(self, z):
        gate, up = self.gate_up(self.norm(z)).chunk(2, -1)
        return wide(self.down(F.silu(gate) * up))


class Block(nn.Module):
    def __init__(self, c: ModelConfig):
        super().__init__()
        self.attention = SelfAttention(c)
        self.film = Film(2, c.film_width, c.width)
        self.command = Film(c.command_size, c.film_width, c.width) if c.command_size else None
        self.feed_forward = FeedForward(c)

    def forward(self, z, turn, mask, step, command):
        z = z + self.attention(z, turn, mask)
        z = self.film(z, step)
        if self.command is not None:
            z = self.command(z, command)
        return z + self.feed_forward(z)


class Encoder(nn.Module):
    """Section 3: points to unit tokens."""

    def __init__(self, c: ModelConfig):
        super().__init__()
        self.register_buffer("feature_mean", torch.zeros(c.feature_count))
        self.register_buffer("feature_scale", torch.ones(c.feature_count))
        hidden = c.point_hidden or (c.point_width,)
        self.point = Mlp(c.feature_count, *hidden, c.point_width, last=True)
        if c.has_impacts:
            self.register_buffer("impact_mean", torch.zeros(IMPACT_FEATURES))
            self.register_buffer("impact_scale", torch.ones(IMPACT_FEATURES))
        self.impact = Mlp(IMPACT_FEATURES, c.point_width, c.point_width, last=True) if c.has_impacts else None
        self.fuse = Mlp((10 if c.has_impacts else 8) * c.point_width, c.fuse_hidden or c.width, c.width)
        self.film = Film(2, c.film_width, c.width)
        self.command = Film(c.command_size, c.film_width, c.width) if c.command_size else None

    def normalise(self, raw):
        return ((raw - self.feature_mean) * self.feature_scale).clamp(-FEATURE_CLAMP, FEATURE_CLAMP)

    def pools(self, hidden, points_in_use):
        """Maximum and mean over the levels' prefixes: list of 8 of (B, M, C)."""
        row = torch.arange(hidden.shape[2], device=hidden.device)
        pools = []
        for level in range(4):
            used = ((points_in_use + (1 << level) - 1) >> level).clamp(min=1)
            inside = (row < used[..., None])[..., None]
            pools.append(hidden.masked_fill(~inside, -1e9).amax(2))
            pools.append((hidden * inside).sum(2) / used[..., None])
        return pools

    def full_pools(self, hidden):
        """What `pools` returns where every row is a point: each row is read once."""
        ends = [(hidden.shape[2] + (1 << level) - 1) >> level for level in (3, 2, 1, 0)]
        parts = hidden.split([b - a for a, b in zip([0, *ends], ends)], 2)
        pools, most, total = [], None, None
        for end, part in zip(ends, parts):
            if part.shape[2]:
                part_most, part_total = part.amax(2), part.sum(2)
                most = part_most if most is None else torch.maximum(most, part_most)
                total = part_total if total is None else total + part_total
            pools = [most, total / end, *pools]
        return pools

    def normalise_impacts(self, raw):
        return ((raw - self.impact_mean) * self.impact_scale).clamp(-FEATURE_CLAMP, FEATURE_CLAMP)

    def impact_pools(self, features, valid):
        """features (B, M, K, F) raw, valid (B, M, K) -> maximum and sum (B, M, C) each, of valid rows; 0: none."""
        hidden = wide(self.impact(self.normalise_impacts(features)))
        most = hidden.masked_fill(~valid[..., None], -1e9).amax(2)
        some = valid.any(-1)[..., None]
        return [most * some, (hidden * valid[..., None]).sum(2)]

    def forward(self, features, points_in_use, step, command, full=False, impacts=None):
        """features (B, M, P, F) normalised -> tokens (B, M, D), point features (B, M, P, C).
        full: every unit that exists has P points."""
        hidden = wide(self.point(features))
        pools = self.full_pools(hidden) if full else self.pools(hidden, points_in_use)
        if impacts is not None:
            pools = pools + self.impact_pools(*impacts)
        return self.token(torch.cat(pools, -1), step, command), hidden

    def token(self, pools, step, command):
        """Pooled levels (B, M, 8 C) -> tokens (B, M, D)."""
        token = self.film(wide(self.fuse(pools)), step)
        if self.command is not None:
            token = self.command(token, command)
        return token


class Anchors(nn.Module):
    """Section 5: anchor queries, their attention to the units, and the head."""

    def __init__(self, c: ModelConfig):
        super().__init__()
        self.register_buffer("position_mean", torch.zeros(3))
        self.register_buffer("position_scale", torch.ones(3))
        self.log_sigma = nn.Parameter(torch.tensor(-1.5))
        self.avp = Mlp(c.point_width, c.avp_width, c.avp_width, zero=True)
        self.query = Mlp(3 + c.feature_count + c.avp_width + (IMPACT_PUSHES if c.has_impacts else 0), c.width, c.width)
        self.cross = nn.ModuleList(CrossAttention(c) for _ in c.scales)
        self.fuse = nn.Linear(len(c.scales) * c.heads * c.head_dim, c.width)
        self.film = Film(2, c.film_width, c.width)
        self.norm = RmsNorm(c.width)
        self.head = Mlp(c.width, c.width, c.outputs, zero=True)

    def weights(self, points, points_in_use):
        """Of anchor-vertex pooling: (B, M, A, P)."""
        reach = (points[:, :, :ANCHORS, None] - points[:, :, None]).square().sum(-1)
        distance = reach.clamp(min=1e-24).sqrt()
        row = torch.arange(points.shape[2], device=points.device)
        inside = (row < points_in_use[..., None])[:, :, None]
        weight = torch.exp(-distance * torch.exp(-self.log_sigma)) * inside
        return weight / weight.sum(-1, keepdim=True)

    def pool(self, scene: Scene, hidden):
        """Anchor-vertex pooling: (B, M, A, C)."""
        return self.weights(scene.points, scene.points_in_use) @ hidden

    def forward(self, position, features, pooled, scales, unit_turn, anchor_turn, mask, step, push=None):
        """position, features, pooled (B, M, A, .); scales: list of (B, M, D) -> (B, M, A, 3)."""
        b, m = position.shape[:2]
        position = (position - self.position_mean) * self.position_scale
        state = torch.cat((position, features, wide(self.avp(pooled))), -1)
        if push is not None:
            state = torch.cat((state, push), -1)
        query = wide(self.query(state)).flatten(1, 2)  # (B, M * A, D)
        seen = [
            cross(query, units, anchor_turn, unit_turn, mask)
            for cross, units in zip(self.cross, scales)
        ]
        token = query + wide(self.fuse(torch.cat(seen, -1)))
        token = self.film(token, step)
        return wide(self.head(self.norm(token))).unflatten(1, (m, ANCHORS))


class RigidFormer(nn.Module):
    def __init__(self, config: ModelConfig):
        super().__init__()
        self.config = config
        self.bf16 = False  # matrix products of the learned part only; geometry stays f32
        self.encoder = Encoder(config)
        self.registers = nn.Parameter(torch.randn(config.registers, config.width) * 0.02)
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.blocks))
        self.anchors = Anchors(config)
        if config.bonds:
            self.bonds = BondHead(config.width, config.bonds)
        k = config.rope_frequencies
        low, high = config.rope_min_rad_per_m, config.rope_max_rad_per_m
        ratio = torch.arange(k, dtype=torch.float64) / max(k - 1, 1)
        self.register_buffer("rope_frequencies", (low * (high / low) ** ratio).float())
        self.register_buffer("gravity", torch.tensor(config.gravity_m_s2), persistent=False)

    def initialise(self):
        """Small random weights; zeroed last layers stay zero."""
        for name, p in self.named_parameters():
            if p.dim() == 2 and p.abs().sum() > 0 and name != "registers":
                nn.init.normal_(p, std=p.shape[1] ** -0.5)
        return self

    def dt(self, scene):
        """Seconds of a step (B,)."""
        rate = self.config.frame_rate_hz if scene.frame_rate is None else scene.frame_rate.to(scene.points.dtype)
        return scene.step.to(scene.points.dtype) / rate

    def code(self, scene):
        """Step code (B,): the step's frames at the model's frame rate, a real number (section 1)."""
        code = scene.step.to(scene.points.dtype)
        if scene.frame_rate is None:
            return code
        return code * (self.config.frame_rate_hz / scene.frame_rate.to(scene.points.dtype))

    def measured(self, scene: Scene) -> Scene:
        """The scene in its own length, mass and time, where the model wants it so (section 1)."""
        if not self.config.length_m or scene.length is not None:
            return scene
        size, mass = (typical(scene) if scene.typical is None else scene.typical.to(scene.points.dtype)).unbind(-1)
        length = size / self.config.length_m
        gravity, own = self.gravity_of(scene), self.gravity.to(scene.points.dtype).norm()
        here = gravity.norm(dim=-1)
        pull = torch.where((here > 0) & (own > 0), own / here.clamp(min=1e-30), torch.ones_like(here))
        rate = scene.frame_rate
        if rate is None:
            rate = torch.full_like(length, self.config.frame_rate_hz)
        each = length[:, None]
        rotation, centre = scene.reference
        planes = self.planes(scene)
        return dataclasses.replace(
            scene, length=length, points=scene.points / each[..., None, None], radius=scene.radius / each,
            reference=(rotation, centre / each[..., None]), scale=scene.scale / each,
            extent=None if scene.extent is None else scene.extent / each[..., None],
            physics=torch.cat((scene.physics[..., :1] / mass[:, None, None], scene.physics[..., 1:]), -1),
            planes=dataclasses.replace(planes, offset=planes.offset / each), gravity=gravity * pull[:, None],
            frame_rate=rate.to(scene.points.dtype) * (length * pull).sqrt(),
            joints=None if scene.joints is None else scene.joints.scaled(1 / length),
        )  # fmt: skip

    def entered(self, scene: Scene, state: State):
        """Scene and state in the scene's own measure, or seen from its heading."""
        if self.config.motion == "robot" and scene.frame is None:
            return self.headed(scene, state)
        if not self.config.length_m or scene.length is not None:
            return scene, state
        scene = self.measured(scene)
        by = scene.length[:, None, None]
        target = state.target_centre
        return scene, dataclasses.replace(
            state, previous_centre=state.previous_centre / by, centre=state.centre / by,
            target_centre=None if target is None else target / by,
        )  # fmt: skip

    def headed(self, scene: Scene, state: State):
        """Scene and state seen from the heading of now, with all reference poses at its origin."""
        turn, origin = heading(scene, state.rotation, state.centre)
        each, from_ = turn[:, None], origin[:, None]

        def seen(rotation, centre):
            if rotation is None:
                return None, None
            return each.transpose(-1, -2) @ rotation, (centre - from_) @ turn

        rotation, centre = seen(state.rotation, state.centre)
        planes = self.planes(scene)
        command = scene.command
        if self.config.directions and command is not None:
            command = command.clone()
            for first in self.config.directions:
                pair = slice(first, first + 2)
                command[:, pair] = (scene.command[:, None, pair] @ turn[:, :2, :2])[:, 0]
        scene = dataclasses.replace(
            scene, frame=(turn, origin), command=command, gravity=(self.gravity_of(scene)[:, None] @ turn)[:, 0],
            reference=(torch.eye(3, dtype=rotation.dtype, device=rotation.device).expand_as(rotation), torch.zeros_like(centre)),
            planes=dataclasses.replace(
                planes, normal=planes.normal @ turn, offset=planes.offset - (planes.normal * from_).sum(-1)
            ),
        )  # fmt: skip
        return scene, State(*seen(state.previous_rotation, state.previous_centre), rotation, centre,
                            *seen(state.target_rotation, state.target_centre))  # fmt: skip

    def carried(self, scene: Scene, state: State):
        """Poses that go on as the heading of the heaviest unit did in the last step: its turn about the vertical, and its way
        over the ground."""
        turn, origin = heading(scene, state.rotation, state.centre)
        before, there = heading(scene, state.previous_rotation, state.previous_centre)
        on = turn @ before.transpose(-1, -2)
        return on[:, None] @ state.rotation, (state.centre - there[:, None]) @ on.transpose(-1, -2) + origin[:, None]

    def gravity_of(self, scene):
        """(B, 3) m/s^2."""
        return self.gravity.expand(len(scene.points), 3) if scene.gravity is None else scene.gravity

    def planes(self, scene):
        """What the scene stands on."""
        c = self.config
        return scene.planes or level_ground(c.ground_friction, c.ground_restitution, len(scene.points), scene.points)

    def motion(self, scene: Scene, state: State):
        """How all units are expected to move over the step (section 1)."""
        fall = self.gravity_of(scene) * self.dt(scene).square()[:, None]
        return coming_motion(state, scene.role, fall)

    def angles(self, position):
        """(B, T, 3) -> (B, T, 3 K): each axis times each frequency (section 4)."""
        return (position[..., None] * self.rope_frequencies).flatten(-2)

    def features(self, scene: Scene, state: State):
        """Raw features (B, M, P, F) of all points (section 2)."""
        scene, state = self.entered(scene, state)
        dt = self.dt(scene)[:, None, None, None]
        motion = self.motion(scene, state)
        planes = self.planes(scene)
        points = transform(state.rotation, state.centre, scene.points)
        before = transform(motion.from_rotation, motion.from_centre, scene.points)
        after = points if scene.role is None else transform(motion.to_rotation, motion.to_centre, scene.points)
        first = transform(*scene.reference, scene.points)
        unit, local = nearest_points(
            points, scene.points_in_use * scene.mask, state.rotation, state.centre, scene.radius,
            scene.start, scene.count, scene.bank, scene.scale, planes, groups(scene.body, scene.mask),
        )  # fmt: skip
        batch = torch.arange(len(points), device=points.device)[:, None, None]
        other = unit.clamp(min=0)

        def world(rotation, centre):
            return (rotation[batch, other] @ local[..., None])[..., 0] + centre[batch, other]

        near_after = world(motion.to_rotation, motion.to_centre)
        near = near_after if scene.role is None else world(state.rotation, state.centre)
        way = near_after - world(motion.from_rotation, motion.from_centre)
        return self.describe(
            points, after - before, first, near, way, unit < 0,
            points - state.centre[:, :, None], scene.physics[:, :, None].expand(points.shape),
            scene.physics[batch, other], dt, planes.under(points, unit), motion.free[:, :, None],
            motion.free[batch, other], self.gravity_of(scene)[:, None, None],
        )  # fmt: skip

    def describe(
        self, points, increment, first, near, near_increment, over, lever, physics, other_physics, dt, plane=None,
        free=True, other_free=True, gravity=None,
    ):  # fmt: skip
        """Raw features of points in any layout: all (..., 3) but `over` (...), whose points have a plane nearest, not
        `near`; dt broadcasts to (..., 1). Increments are those of the coming motion. plane: of those points, what
        `Planes.under` returns, None: z = 0; free, other_free (...): whether the model moves the unit and the other one;
        gravity None: the model's."""
        if plane is None:
            ground = level_ground(self.config.ground_friction, self.config.ground_restitution, 1, points)
            up, height, plane_friction, plane_restitution = (
                v[0] for v in ground.under(points[None], torch.full_like(over[None], -1, dtype=torch.int64))
            )
        else:
            up, height, plane_friction, plane_restitution = plane
        gravity = self.gravity if gravity is None else gravity
        free, other_free = (torch.as_tensor(f, device=points.device).expand(over.shape) for f in (free, other_free))
        displacement = torch.where(over[..., None], up * -height[..., None], near - points)
        offset = points - first
        if self.config.features == "paper":
            return torch.cat((displacement, increment, offset, physics), -1)
        mass, friction, restitution = physics.unbind(-1)
        velocity = increment / dt
        length = displacement.square().sum(-1).clamp(min=TINY_M**2).sqrt()
        # Towards the plane even from below it, where the displacement points up.
        normal = torch.where(over[..., None], -up, displacement / length[..., None])
        signed = torch.where(over, height, length)
        # In the frame that falls with gravity: there what is not free rises.
        rises = free.to(points.dtype) - (other_free & ~over).to(points.dtype)
        relative = velocity - torch.where(over[..., None], 0.0, near_increment / dt)
        relative = relative + rises[..., None] * (gravity * dt)
        other_mass, other_friction, other_restitution = other_physics.unbind(-1)
        share = torch.where(over | ~other_free, torch.ones_like(mass), other_mass / (mass + other_mass))
        share = torch.where(free, share, torch.zeros_like(mass))
        pair_friction = friction * torch.where(over, plane_friction, other_friction)
        pair_restitution = restitution * torch.where(over, plane_restitution, other_restitution)
        approach = (relative * normal).sum(-1)
        gap = (signed - approach * dt[..., 0]).clamp(-GAP_CLAMP_M, GAP_CLAMP_M)
        ramp = (0.5 - gap * (0.5 / RAMP_M)).clamp(0.0, 1.0)
        closing = approach.clamp(min=0.0) * ramp
        push = normal * -(closing * share)[..., None]
        scalars = torch.stack(
            (share, pair_friction, pair_restitution, approach, gap, ramp), -1
        )
        return torch.cat(
            (
                displacement, velocity, offset,
                torch.stack((mass.log(), friction, restitution), -1), lever,
                normal * (PROXIMITY_M / (PROXIMITY_M + length))[..., None], relative, scalars,
                push, torch.linalg.cross(lever, push), (pair_restitution * closing)[..., None],
            ),
            -1,
        )  # fmt: skip

    def depths(self, scene: Scene, rotation, centre, plane=0):
        """Metres that the lowest point of each unit's hull is below a plane (B, M); no gradient."""
        planes = self.planes(scene)
        return depths(
            rotation, planes.heights(centre)[..., plane], planes.normal[:, plane], scene.mask, scene.radius,
            scene.hull_start, scene.hull_count, scene.scale, scene.hull_bank,
        )  # fmt: skip

    def impacts(self, scene: Scene, state: State, prior: Prior | None = None):
        """First impacts under the coming motion: features (B, M, K, F), valid (B, M, K), and what the impulse of each
        gives the anchors, with what is left of the step and without, (B, M, A, 6) m/s. Only free units have any. prior:
        the anchors' changes of way and velocity are those of the prior against free motion instead."""
        scene, state = self.entered(scene, state)
        dt = self.dt(scene)[:, None, None, None]
        motion = self.motion(scene, state)
        planes = self.planes(scene)
        other, xi, xj, normal, fraction, gap = find_impacts(
            state, scene.mask, scene.radius, scene.hull_start, scene.hull_count, scene.scale, scene.hull_bank,
            motion.fall, IMPACTS, motion, planes, groups(scene.body, scene.mask),
        )  # fmt: skip
        valid = other != -1
        earth = other <= GROUND
        ground = earth[..., None]
        plane = (GROUND - other).clamp(0, len(planes) - 1)
        other = other.clamp(min=0)
        batch = torch.arange(len(other), device=other.device)[:, None, None]
        cross = torch.linalg.cross
        turn = motion.turns()
        trace = torch.diagonal(turn, dim1=-2, dim2=-1).sum(-1)
        skew = torch.stack(
            (turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1]), -1
        )
        half = skew / (1 + trace).clamp(min=0.1)[..., None]  # Rodrigues' parameters of a step's turn
        travel = motion.travels()
        f = fraction[..., None]
        inertia = scene.extent.square()
        inertia = (inertia.sum(-1, keepdim=True) - inertia) / 12  # of the box around the points, a kilogram

        def turned(b, x):
            c = cross(b, x)
            return x + (c + cross(b, c)) * (2 / (1 + b.square().sum(-1, keepdim=True)))

        def side(rotation, half, travel, local):
            b = half * f
            lever = turned(b, (rotation @ local[..., None])[..., 0])
            return b, lever, (travel + 2 * cross(half, lever)) / dt

        def yields(rotation, b, inertia, lever, along):
            """Turn (rad/s) of a kilogram by a unit impulse at the lever, (B, M, K, 3)."""
            torque = turned(-b, cross(lever, along))
            torque = (rotation.transpose(-1, -2) @ torque[..., None])[..., 0] / inertia.clamp(min=1e-6)
            return turned(b, (rotation @ torque[..., None])[..., 0])

        mine = (state.rotation[:, :, None], half[:, :, None], travel[:, :, None])
        theirs = (state.rotation[batch, other], half[batch, other], travel[batch, other])
        b, lever, velocity = side(*mine, xi)
        other_b, other_lever, other_velocity = side(*theirs, xj)
        relative = velocity - torch.where(ground, -self.gravity_of(scene)[:, None, None] * dt, other_velocity)
        mass, friction, restitution = scene.physics[:, :, None].expand(*other.shape, 3).unbind(-1)
        other_mass, other_friction, other_restitution = scene.physics[batch, other].unbind(-1)
        heavy = earth | ~motion.free[batch, other]
        light = torch.where(heavy, torch.zeros_like(mass), 1 / other_mass)
        friction = friction * torch.where(earth, planes.friction[batch, plane], other_friction)
        bounce = restitution * torch.where(earth, planes.restitution[batch, plane], other_restitution)

        def weight(along):
            """Impulse a (m/s) along a direction, and the own turn a unit impulse of a kilogram gives."""
            own = yields(mine[0], b, inertia[:, :, None], lever, along)
            his = yields(theirs[0], other_b, inertia[batch, other], other_lever, along)
            own_share = (cross(own, lever) * along).sum(-1).clamp(min=0.0) / mass
            soft = 1 / mass + light + own_share + (cross(his, other_lever) * along).sum(-1).clamp(min=0.0) * light
            return 1 / soft, own

        approach = (relative * normal).sum(-1)
        sliding = relative - normal * approach[..., None]
        speed = sliding.square().sum(-1).clamp(min=1e-12).sqrt()
        tangent = sliding / speed[..., None]
        after = (gap - approach * (1 - fraction) * dt[..., 0]).clamp(-GAP_CLAMP_M, GAP_CLAMP_M)
        touching = (1 - gap / TOUCHING_M).clamp(0.0, 1.0)
        effective, own = weight(normal)
        impulse = effective * approach.clamp(min=0.0) * touching
        drag_weight, drag_own = weight(tangent)
        drag = torch.minimum(friction * (1 + bounce) * impulse, drag_weight * speed * touching)
        push = normal * -(impulse / mass)[..., None]
        spin = own * -(impulse / mass)[..., None]
        rub = tangent * -(drag / mass)[..., None]
        roll = drag_own * -(drag / mass)[..., None]
        e = bounce[..., None]
        raw = torch.cat((
            normal, lever, velocity, relative, sliding,
            torch.stack((approach, after, gap.clamp(-GAP_CLAMP_M, GAP_CLAMP_M), fraction, touching,
                         mass.log(), mass * light / (1 + mass * light), friction, bounce, effective / mass), -1),
            push, e * push, rub, spin, e * spin, roll,
        ), -1)
        on = valid[..., None].to(raw.dtype)
        kick = ((1 + e) * push + rub) * on
        twist = ((1 + e) * spin + roll) * on
        left = 1 - f
        arms = (state.rotation[:, :, None] @ scene.points[:, :, :ANCHORS, :, None])[..., 0]
        given = [
            v.sum(2)[:, :, None] + cross(w.sum(2)[:, :, None].expand_as(arms), arms)
            for v, w in ((kick * left, twist * left), (kick, twist))
        ]
        if prior is not None:
            local, whole = scene.points[:, :, :ANCHORS], dt
            way = transform(prior.rotation, prior.centre, local) - transform(*self.free(scene, state), local)
            earlier = transform(prior.before_rotation, prior.before_centre, local)
            earlier = earlier - transform(state.rotation, state.centre, local)
            free = (motion.free & scene.mask)[..., None, None]
            given = [torch.where(free, v / whole, torch.zeros_like(v)) for v in (way, way - earlier)]
        return raw, valid, torch.cat(given, -1).clamp(-FEATURE_CLAMP, FEATURE_CLAMP)

    def prior(self, scene: Scene, state: State):
        """The motion that the network corrects; None where that is free motion, or the network moves all. Gradients pass
        through what is not touched; what is goes on from where it is."""
        if self.config.motion != "impulses":
            return None
        scene, state = self.entered(scene, state)
        rotation, centre, before_rotation, before_centre, touched, share, met = solve(
            scene, state, self.planes(scene), self.gravity_of(scene), self.dt(scene)
        )
        turn, shift = state.rotation @ state.rotation.detach().transpose(-1, -2), state.centre - state.centre.detach()
        turn = turn - turn.detach()  # zeros, and a gradient
        free_rotation, free_centre = self.free(scene, state)
        here, one = touched[..., None, None], touched[..., None]
        return Prior(
            torch.where(here, rotation + turn @ rotation, free_rotation), torch.where(one, centre + shift, free_centre),
            torch.where(here, before_rotation + turn @ before_rotation, state.rotation), torch.where(one, before_centre + shift, state.centre),
            share, met,
        )  # fmt: skip

    def corrects(self, scene: Scene):
        """Whether each scene has as few units as the model corrects, and rigid contact where it has such a limit (B,)."""
        units = scene.mask.sum(1)
        if not self.config.most_units:
            return units >= 0
        known = units <= self.config.most_units
        return known if scene.law is None else known & (scene.law == 0).all(-1)

    def active(self, scene: Scene, state: State):
        """Units that may touch something within the step (B, M); only free ones are (section 6)."""
        scene, state = self.entered(scene, state)
        motion = self.motion(scene, state)
        around = state.centre, motion.travels(), scene.radius
        pair = meeting(*around, scene.mask, groups(scene.body, scene.mask))
        return (pair.any(-1) | landing(*around, self.planes(scene), motion.fall)) & scene.mask & motion.free

    def free(self, scene: Scene, state: State):
        """Motion without contact: ballistic centre, constant spin."""
        dt = self.dt(scene)[:, None, None]
        centre = state.centre + (state.centre - state.previous_centre) + self.gravity_of(scene)[:, None] * dt.square()
        rotation = state.rotation @ state.previous_rotation.transpose(-1, -2) @ state.rotation
        return rotation, centre

    def network(self, scene: Scene, state: State, trace=None, prior: Prior | None = None):
        """The learned part: (B, M, A, 3 or 6), m/s or m/s^2 by `motion`, in the scene's measure. prior: what `prior`
        says."""
        scene, state = self.entered(scene, state)
        raw = self.features(scene, state)
        anchors = transform(state.rotation, state.centre, scene.points[:, :, :ANCHORS])
        impacts = self.impacts(scene, state, prior) if self.config.has_impacts else None
        seen = self.seen(scene, state, prior)
        if trace is not None:
            trace["seen"] = seen
        with torch.autocast(raw.device.type, torch.bfloat16, enabled=self.bf16):
            out = self.learned(scene, raw, anchors, trace, impacts, seen)
        return out * self.config.output_scale

    def seen(self, scene: Scene, state: State, prior: Prior | None):
        """Units that the network sees (B, M): all, or those that it corrects and those that may touch one of them within the step
        (section 4). Where it corrects none, all: nobody reads what comes out then."""
        if self.config.scope == "all":
            return scene.mask
        corrected = (prior.share > 0) & scene.mask
        motion = self.motion(scene, state)
        pair = meeting(state.centre, motion.travels(), scene.radius, scene.mask, groups(scene.body, scene.mask))
        seen = corrected | (pair & corrected[:, None]).any(-1)
        return torch.where(seen.any(-1, keepdim=True), seen, scene.mask)

    def learned(self, scene: Scene, raw, anchors, trace=None, impacts=None, seen=None):
        code = self.code(scene).to(raw.dtype) / 10.0
        step = torch.stack((code, code.square()), -1)
        features = self.encoder.normalise(raw)
        token, hidden = self.encoder(features, scene.points_in_use, step, scene.command, scene.full, impacts and impacts[:2])
        push = impacts and impacts[2]
        pooled = self.anchors.pool(scene, hidden)
        if trace is not None:
            if impacts is not None:
                trace["impacts"] = self.encoder.normalise_impacts(impacts[0])[impacts[1]]
                trace["pushes"] = impacts[2]
            trace.update(raw_features=raw, features=features, point_features=hidden, tokens=token)
        chosen = features[:, :, :ANCHORS]
        seen = scene.mask if seen is None else seen
        return self.interact(anchors, token, chosen, pooled, seen, step, scene.command, trace, push)

    def interact(self, anchors, token, features, pooled, unit_mask, step, command, trace=None, push=None):
        """Sections 4 and 5. anchors, features, pooled (B, M, A, .), token (B, M, D) -> (B, M, A, 3).
        unit_mask None: no padding."""
        middle = anchors.mean(2)
        b, m, _ = middle.shape
        registers = self.registers.expand(b, -1, -1)
        z = torch.cat((token, registers), 1)
        unit_angles = self.angles(middle)
        head_dim = self.config.head_dim
        unit_turn = turns(unit_angles, head_dim)
        anchor_turn = turns(self.angles(anchors.flatten(1, 2)), head_dim)
        turn = turns(F.pad(unit_angles, (0, 0, 0, registers.shape[1])), head_dim)
        mask = None
        if unit_mask is not None:
            mask = F.pad(unit_mask, (0, registers.shape[1]), value=True)
        outputs = [z]
        for block in self.blocks:
            outputs.append(block(outputs[-1], turn, mask, step, command))
        scales = [outputs[level][:, :m] for level in self.config.scales]
        out = self.anchors(anchors, features, pooled, scales, unit_turn, anchor_turn, unit_mask, step, push)
        if trace is not None:
            trace.update(unit_angles=unit_angles, head=out, **{f"block_{i}": o[:, :m] for i, o in enumerate(outputs)})
        return out

    def breaking(self, scene: Scene, state: State, holds):
        """Whether each bond breaks in the coming step (B, N): above 0 it does. The prior and the tokens are those of the step in
        which all hold that did, `holds` (B, N). Nothing breaks that impulses do not act on."""
        trace = {}
        prior = self.prior(scene, state)
        self.network(scene, state, trace, prior)
        features = self.bond_features(scene, state, prior, holds)
        found = self.bonds(trace[f"block_{self.config.blocks}"], scene.bonds.pairs, features)
        return torch.where(features[..., SHARE] > 0, found, torch.full_like(found, NEVER))

    def lowest(self, scene: Scene, rotation, centre):
        """How high the lowest point of each unit is over the planes (B, M), metres; infinite without any."""
        planes = self.planes(scene)
        heights = planes.heights(centre)
        below = [
            depths(rotation, torch.zeros_like(heights[..., plane]), planes.normal[:, plane], scene.mask, scene.radius,
                   scene.hull_start, scene.hull_count, scene.scale, scene.hull_bank)
            for plane in range(len(planes))
        ]  # fmt: skip
        return (heights - torch.stack(below, -1)).amin(-1) if below else torch.full_like(centre[..., 0], torch.inf)

    def bond_features(self, scene: Scene, state: State, prior: Prior, holds):
        """What the network of bonds is told beside the tokens (B, N, .)."""
        dt = self.dt(scene)[:, None, None]
        way, earlier = prior.centre - prior.before_centre, state.centre - state.previous_centre
        push = (way - earlier) / dt - self.gravity_of(scene)[:, None] * dt
        low = torch.minimum(
            self.lowest(scene, state.rotation, state.centre), self.lowest(scene, prior.rotation, prior.centre)
        ).detach()
        return describe_bonds(scene.bonds, scene, state, prior, push, low, holds)

    def step(self, scene: Scene, state: State, trace=None):
        """One step: the next state, the raw (unprojected) anchors (B, M, A, 3) and
        which units were predicted rather than moved freely (B, M). Steps are taken whole here: only the core takes those
        beyond `longest_step` in parts."""
        longest = self.config.longest_step
        if longest and (self.code(self.measured(scene)) > longest * (1 + 1e-6)).any():
            raise ValueError(f"a step code is above the model's longest_step {longest:g}; take shorter steps")
        prior = self.prior(scene, state)
        return self.advance(scene, state, self.network(scene, state, trace, prior), trace, prior)

    def advance(self, scene: Scene, state: State, out, trace=None, prior: Prior | None = None):
        """What `step` returns, from the network's output (B, M, A, 3 or 6) and the prior (sections 6 and 7)."""
        if self.config.length_m and scene.length is None:
            inner, state = self.entered(scene, state)
            by = inner.length[:, None, None]
            after, advanced, active = self.advance(inner, state, out, trace, prior)
            after.previous_centre, after.centre = after.previous_centre * by, after.centre * by
            return after, advanced * by[..., None], active
        dt = self.dt(scene)[:, None, None, None]
        local = scene.points[:, :, :ANCHORS]
        free = scene.mask & self.motion(scene, state).free
        earlier = None
        if self.config.motion == "impulses":
            active = free & (prior.share > 0) & self.corrects(scene)[:, None]
            out = out * prior.share.clamp(min=0.0)[..., None, None] * dt
            advanced = transform(prior.rotation, prior.centre, local) + out[..., :3]
            earlier = transform(prior.before_rotation, prior.before_centre, local) + (out[..., :3] - out[..., 3:])
        elif self.config.motion == "free":
            advanced = transform(*self.free(scene, state), local)
            active = self.active(scene, state) if self.config.gate else free
            advanced = advanced + (out * active[..., None, None]) * dt
        elif self.config.motion == "robot":
            active = free
            turn, _ = heading(scene, state.rotation, state.centre)
            advanced = transform(*self.carried(scene, state), local) + out @ turn[:, None].transpose(-1, -2) * dt
        else:
            active = free
            now = transform(state.rotation, state.centre, local)
            before = transform(state.previous_rotation, state.previous_centre, local)
            advanced = now + (now - before) + out * dt.square()
        if scene.role is not None:
            next_rotation, next_centre = next_poses(state, scene.role)
            advanced = torch.where(free[..., None, None], advanced, transform(next_rotation, next_centre, local))
        rotation, centre = kabsch(local, advanced)
        now = state.rotation, state.centre
        if earlier is not None:
            before = kabsch(local, earlier)
            rests = prior.share < 0  # exactly the prior, to the bit
            rotation = torch.where(rests[..., None, None], prior.rotation, rotation)
            centre = torch.where(rests[..., None], prior.centre, centre)
            here, one = active[..., None, None], active[..., None]
            now = torch.where(here, before[0], prior.before_rotation), torch.where(one, before[1], prior.before_centre)
            if scene.lead is not None:
                square = scene.extent.square()
                moment = ((square.sum(-1, keepdim=True) - square) / 12).clamp(min=1e-6)
                alone = (rotation, centre), now
                whole = put_together(
                    scene.lead, scene.physics[..., 0], scene.mask, moment, (state.rotation, state.centre), *alone, local
                )
                (rotation, centre), now = (
                    (torch.where(rests[..., None, None], a[0], b[0]), torch.where(rests[..., None], a[1], b[1]))
                    for a, b in zip(alone, whole)
                )
        if self.config.has_impacts:
            low, centre = centre, self.lifted(scene, state, rotation, centre)
            if earlier is not None:
                centre = centre + kept_apart(scene, prior.met, rotation, centre)
                now = now[0], now[1] + (centre - low)
        if scene.role is not None:
            rotation = torch.where(free[..., None, None], rotation, next_rotation)
            centre = torch.where(free[..., None], centre, next_centre)
            now = torch.where(free[..., None, None], now[0], state.rotation), torch.where(free[..., None], now[1], state.centre)
        if scene.joints is not None:
            mass, square = scene.physics[..., 0], scene.extent.square()
            inertia = ((square.sum(-1, keepdim=True) - square) / 12).clamp(min=1e-6)
            if self.config.motion != "robot":  # which predicts turns better than pushes at pivots do
                rotation, centre = turn_together(scene.joints, rotation, centre, mass, inertia, free, scene.mask)
            centre = hold_together(scene.joints, rotation, centre, mass, free, scene.mask)
        if trace is not None:
            trace.update(active=active, advanced=advanced, rotation=rotation, centre=centre)
        return State(*now, rotation, centre), advanced, active

    def lifted(self, scene: Scene, state: State, rotation, centre):
        """Centres, out of the planes where the poses are deeper in them than the current ones; no gradient through the
        way up (section 7)."""
        planes = self.planes(scene)
        for plane in range(len(planes)):
            lift = self.depths(scene, rotation, centre, plane) - self.depths(scene, state.rotation, state.centre, plane)
            lift = lift if scene.lead is None else most(scene.lead, scene.mask, lift)
            centre = centre + planes.normal[:, plane, None] * lift.clamp(min=0)[..., None]
        return centre
