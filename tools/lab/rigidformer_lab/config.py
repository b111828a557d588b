"""Model configurations: the same fields as `rigidformer_weights::ModelConfig`."""

from __future__ import annotations

import dataclasses
import json

#: Inputs per point of each feature set.
FEATURE_COUNT = {"paper": 12, "contact": 34, "impact": 34, "soft": 41}

#: With the inputs `impact`: impacts of a unit that its token is told of, at most; numbers of each;
#: numbers that they add to an anchor's query.
IMPACTS, IMPACT_FEATURES, IMPACT_PUSHES = 4, 43, 6

#: With the motion "soft": numbers of an anchor that its points are told, beside its way and its velocity; hidden channels of the
#: network that reads them.
BLEND_CODE, BLEND_HIDDEN = 16, 32

#: Springs of a point to its nearest neighbours at rest, at most.
MAX_NEIGHBOURS = 32

#: Numbers of a command among which directions may stand.
MAX_DIRECTIONS = 32

#: Hidden layers of the per-point network, at most.
MAX_POINT_HIDDEN = 2

#: Fields that older files lack.
OPTIONAL = ("point_hidden", "fuse_hidden", "length_m", "longest_step", "directions", "elastic", "bonds", "scope", "most_units")


@dataclasses.dataclass(frozen=True)
class Elastic:
    """The elastic motion that a model of soft bodies corrects (docs/MODEL.md, section 6). Springs join each point of a body to its
    nearest ones at rest."""

    neighbours: int  # of a point
    thickness_m: float  # a spring's stiffness is Young's modulus times this; 0: a solid, times the distance between points
    stiffness: float  # what that is multiplied by
    falloff: int  # and by the distance between points over the spring's length, to this power
    damping_s: float  # time in which a spring loses its rate
    skin_m: float  # points keep so far away from planes and from units of other bodies
    rate_hz: float  # sub-steps a second
    strain_sweeps: int = 0  # over all springs after the network's correction; 0: strain is not limited
    strain_limit: float = 0.0  # springs are at most so much longer than at rest, short ones also shorter, as a share

    def __post_init__(self):
        ranges = dict(neighbours=(1, MAX_NEIGHBOURS), thickness_m=(0, 1e3), stiffness=(1e-6, 1e6), falloff=(0, 16),
                      damping_s=(0, 1e3), skin_m=(0, 1e3), rate_hz=(1, 1e5), strain_sweeps=(0, 64), strain_limit=(0, 1))  # fmt: skip
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"elastic: {name} is {getattr(self, name)}; give a number from {low} to {high}")


@dataclasses.dataclass(frozen=True)
class ModelConfig:
    """Widths and physics of one model. Lengths in metres, angles in radians."""

    name: str = "edge"
    width: int = 128  # D: channels of a unit token
    heads: int = 4
    head_dim: int = 32
    blocks: int = 4  # L
    point_width: int = 128  # C: channels of a point
    registers: int = 4  # learned tokens beside the units
    feed_forward_width: int = 320  # 2.5 D
    avp_width: int = 64
    film_width: int = 32
    command_size: int = 0  # 0: a model without commands
    features: str = "contact"  # or "impact": with first impacts; or "paper": the paper's plain 12 inputs
    #: or "soft": springs of soft bodies, with contact (inputs "soft" alone);
    #: or "impulses": with contact (inputs "impact" alone); or "verlet": the paper's plain integrator; or "robot": all
    #: parts go on as the heaviest one's heading does, and the network sees all from that heading
    motion: str = "free"
    gate: bool = True  # units that can touch nothing move freely, exactly
    rope_frequencies: int = 4  # per axis
    rope_min_rad_per_m: float = 0.25
    rope_max_rad_per_m: float = 12.0
    output_scale: float = 1.0  # m/s (free) or m/s^2 (verlet) per unit of head output
    frame_rate_hz: float = 240.0
    gravity_m_s2: tuple[float, float, float] = (0.0, 0.0, -10.0)
    ground_friction: float = 0.3
    ground_restitution: float = 0.5
    scales: tuple[int, ...] = (0, 1, 2, 4)
    point_hidden: tuple[int, ...] = ()  # hidden widths of the per-point network; empty: one of point_width
    fuse_hidden: int = 0  # hidden channels of the encoder's fusion; 0: width
    length_m: float = 0.0  # typical radius of the units trained on: scenes are measured in their own length; 0: in metres
    longest_step: float = 0.0  # longest step code trained on: longer steps are taken in equal parts; 0: all whole

    #: With motion "robot": where in a command two numbers are a horizontal direction in the world; the network is told
    #: it in the heading
    directions: tuple[int, ...] = ()

    elastic: Elastic | None = None  # with motion "soft" alone
    bonds: int = 0  # hidden channels of the network that says which bonds break, with motion "impulses" alone; 0: none

    #: Units that the network sees: "all", or with motion "impulses" "near": those that it corrects, and those that may touch one
    #: of them within the step
    scope: str = "all"

    most_units: int = 0  # scenes of more units, or with a contact law, move by impulses alone, with motion "impulses" alone; 0: none do

    def __post_init__(self):
        # Older files have other names.
        object.__setattr__(self, "motion", {"carried": "robot", "elastic": "soft"}.get(self.motion, self.motion))
        if isinstance(self.elastic, dict):
            object.__setattr__(self, "elastic", Elastic(**self.elastic))
        if self.most_units and (self.motion != "impulses" or self.bonds):
            raise ValueError('most_units goes with motion "impulses", without bonds')
        if not (self.motion == "soft") == (self.features == "soft") == (self.elastic is not None):
            raise ValueError('motion "soft", features "soft" and `elastic` go together; give all three or none')
        if self.motion == "soft" and (self.length_m or self.longest_step or self.gate):
            raise ValueError('motion "soft" goes without length_m, longest_step and gate')
        if self.bonds and (self.motion != "impulses" or self.length_m or self.longest_step):
            # What a bond bears is so much a square metre: it is not measured in the scene's own length.
            raise ValueError('bonds go with motion "impulses", without length_m and longest_step')
        if self.scope not in ("all", "near") or self.scope == "near" and (self.motion != "impulses" or self.bonds):
            raise ValueError(f'scope is "{self.scope}"; give "all", or with motion "impulses" and without bonds "near"')
        if len(self.point_hidden) > MAX_POINT_HIDDEN:
            raise ValueError(f"point_hidden names {len(self.point_hidden)} widths; give at most {MAX_POINT_HIDDEN}")
        if self.motion == "impulses" and self.features != "impact":
            raise ValueError(f'motion "impulses" needs the hulls of features "impact", not "{self.features}"')
        if self.motion == "robot":
            if self.features == "impact" or self.length_m or self.longest_step:
                raise ValueError('motion "robot" goes with features "contact" or "paper", without length_m and longest_step')
        elif self.directions:
            raise ValueError(f'directions go with motion "robot", not "{self.motion}"')
        taken = [k for first in self.directions for k in (first, first + 1)]
        if len(set(taken)) < len(taken) or not all(0 <= k < min(self.command_size, MAX_DIRECTIONS) for k in taken):
            raise ValueError(f"directions {list(self.directions)} do not name two numbers each of a command of "
                             f"{self.command_size}, among the first {MAX_DIRECTIONS}")
        for name in ("length_m", "longest_step"):
            if not (getattr(self, name) == 0 or 1e-6 <= getattr(self, name) <= 1e6):
                raise ValueError(f"{name} is {getattr(self, name)}; give 0, or a number from 1e-6 to 1e6")

    @property
    def has_impacts(self) -> bool:
        return self.features == "impact"

    @property
    def outputs(self) -> int:
        """Numbers of an anchor that the head gives: with impulses its way and its velocity at the end of the step; with the motion
        "soft" those, and what its points are told."""
        return {"impulses": 6, "soft": 6 + BLEND_CODE}.get(self.motion, 3)

    @property
    def feature_count(self) -> int:
        return FEATURE_COUNT[self.features]

    def to_json(self) -> str:
        raw = dataclasses.asdict(self)
        for name in OPTIONAL:  # left out where they say nothing: older readers refuse fields that they do not know
            if not raw[name] or raw[name] == "all":
                del raw[name]
        return json.dumps(raw)

    @staticmethod
    def from_json(text: str) -> "ModelConfig":
        raw = json.loads(text)
        if raw.pop("law", None):  # older files may say that there is none
            raise ValueError("law: contact laws are those of scenes (`Scenes.contact_law`), not of models; leave it out")
        raw["gravity_m_s2"] = tuple(raw["gravity_m_s2"])
        raw["scales"] = tuple(sorted(raw["scales"]))
        raw["point_hidden"] = tuple(raw.get("point_hidden", ()))
        raw["directions"] = tuple(sorted(raw.get("directions", ())))
        return ModelConfig(**raw)


#: Of models that move by impulses: the typical radius of MOVi's bodies, and steps up to 10 / 240 s among the smallest.
SOLVED = dict(features="impact", motion="impulses", length_m=0.7, longest_step=16.0)

#: Of models that move a robot. Nothing pulls its parts down: what carries it is the network's.
ROBOT = dict(
    width=96, head_dim=24, point_width=48, feed_forward_width=240, avp_width=32, scales=(0, 2, 4), motion="robot", gate=False,
    frame_rate_hz=30.0, gravity_m_s2=(0.0, 0.0, -9.81),
)  # fmt: skip

#: Of models that move soft bodies.
SOFT = dict(
    width=64, heads=2, blocks=3, point_width=48, feed_forward_width=160, avp_width=32, film_width=16, scales=(0, 1, 3),
    features="soft", motion="soft", gate=False, frame_rate_hz=60.0, gravity_m_s2=(0.0, 0.0, -9.81), ground_friction=1.0,
    ground_restitution=0.0,
)  # fmt: skip

PRESETS = {
    "edge": ModelConfig(most_units=24, **SOLVED),
    "edge-points": ModelConfig(name="edge-points"),  # without impacts
    "edge-paper-inputs": ModelConfig(
        name="edge-paper-inputs",
        features="paper",
        motion="verlet",
        gate=False,
        output_scale=50.0,
    ),
    # The paper's size, for speed against it. What it does not disclose is put into the fusion, so that as many bytes
    # of weights are read a step as its 174.8 M parameters are.
    "paper": ModelConfig(
        name="paper",
        width=768,
        heads=6,
        head_dim=128,
        point_width=1024,
        registers=16,
        feed_forward_width=1920,
        avp_width=256,
        film_width=64,
        features="paper",
        motion="verlet",
        gate=False,
        rope_frequencies=16,
        output_scale=50.0,
        point_hidden=(256, 512),
        fuse_hidden=14592,
    ),
    # For microcontrollers: at most 512 KiB of flash as int8 and 20 million instructions a step at 10 units x 64 points.
    "nano": ModelConfig(
        name="nano",
        width=64,
        heads=2,
        blocks=3,
        point_width=48,
        feed_forward_width=160,
        avp_width=32,
        film_width=16,
        scales=(0, 1, 3),
        most_units=24,
        **SOLVED,
    ),
    # Robots under command: parts of one body, seen from its heading. At most 70 million instructions a step at 31 parts x
    # 32 points on a Cortex-M7.
    "g1": ModelConfig(name="g1", command_size=3, **ROBOT),
    "humanoid": ModelConfig(name="humanoid", command_size=2, directions=(0,), **ROBOT),
    "ase": ModelConfig(name="ase", command_size=5, **ROBOT),
    "arm": ModelConfig(name="arm", command_size=7, **{**ROBOT, "frame_rate_hz": 60.0, "film_width": 128}),
    # Pieces that hold together until their bonds break, of nano size.
    "fragments": ModelConfig(
        name="fragments",
        width=64,
        heads=2,
        blocks=3,
        point_width=48,
        feed_forward_width=160,
        avp_width=32,
        film_width=16,
        scales=(0, 1, 3),
        bonds=48,
        **{**SOLVED, "length_m": 0.0, "longest_step": 0.0},
    ),
    # Soft bodies, of nano size.
    "shell": ModelConfig(
        name="shell", elastic=Elastic(8, 2e-3, 1.0, 8, 0.0, 0.009, 960.0, 8, 0.02), **SOFT,
    ),
    "soft": ModelConfig(
        name="soft", elastic=Elastic(26, 0.0, 0.15, 1, 0.05, 0.005, 960.0), **SOFT,
    ),
    "tiny": ModelConfig(  # goldens and tests only
        name="tiny",
        width=32,
        heads=2,
        head_dim=16,
        blocks=4,
        point_width=32,
        registers=2,
        feed_forward_width=80,
        avp_width=16,
        film_width=8,
        command_size=3,
        rope_frequencies=2,
    ),
    "tiny-impact": ModelConfig(
        name="tiny-impact",
        width=32,
        heads=2,
        head_dim=16,
        blocks=2,
        point_width=32,
        registers=2,
        feed_forward_width=80,
        avp_width=16,
        film_width=8,
        features="impact",
        rope_frequencies=2,
        scales=(0, 2),
    ),
    "tiny-paper-inputs": ModelConfig(
        name="tiny-paper-inputs",
        width=32,
        heads=2,
        head_dim=16,
        blocks=4,
        point_width=32,
        registers=2,
        feed_forward_width=80,
        avp_width=16,
        film_width=8,
        features="paper",
        motion="verlet",
        gate=False,
        rope_frequencies=2,
        output_scale=10.0,
    ),
}
# Goldens only.
PRESETS["tiny-soft"] = ModelConfig(
    name="tiny-soft", elastic=Elastic(8, 2e-3, 1.0, 8, 0.01, 0.009, 480.0, 3, 0.02),
    **{**SOFT, "width": 32, "head_dim": 16, "point_width": 32, "feed_forward_width": 80, "avp_width": 16, "film_width": 8,
       "blocks": 2, "registers": 2, "rope_frequencies": 2, "scales": (0, 2)},
)  # fmt: skip
PRESETS["tiny-impulses"] = dataclasses.replace(PRESETS["tiny-impact"], name="tiny-impulses", motion="impulses")
PRESETS["tiny-breaking"] = dataclasses.replace(PRESETS["tiny-impulses"], name="tiny-breaking", bonds=8)
PRESETS["tiny-roles"] = dataclasses.replace(PRESETS["tiny-impact"], name="tiny-roles")
PRESETS["tiny-carried"] = dataclasses.replace(
    PRESETS["tiny"], name="tiny-carried", motion="robot", gate=False, directions=(1,)
)
PRESETS["tiny-similar"] = dataclasses.replace(PRESETS["tiny-impact"], name="tiny-similar", length_m=0.25)
