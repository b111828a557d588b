# The types of the extension module; its docstrings say shapes, units, ranges and errors. `python -m mypy.stubtest rigidformer`
# compares this file with the module.

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Optional, Union, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "BatchSimulator",
    "Bond",
    "Camera",
    "Cem",
    "Cloud",
    "Commands",
    "Dataset",
    "DepthView",
    "Estimate",
    "Forecast",
    "Futures",
    "Joint",
    "Launch",
    "Model",
    "Mppi",
    "Observation",
    "Parameter",
    "Pivot",
    "Plan",
    "Plane",
    "Planner",
    "PushGoal",
    "PushPlan",
    "PushPlanner",
    "Scene",
    "Start",
    "StepReport",
    "Track",
    "Tracker",
    "Trajectory",
    "Unit",
    "VelocityNoise",
    "WalkPlan",
    "WalkPlanner",
    "World",
    "check",
    "evaluate",
    "free_fall",
    "kernels",
    "pack",
    "rollout",
]

# What is given: real numbers, best as C-contiguous float32.
_Numbers = npt.ArrayLike
_Floats = npt.NDArray[np.float32]
_Path = Union[str, "os.PathLike[str]"]
_Dtype = Literal["f32", "f16", "i8", "mixed"]
_Scope = Literal["all", "near"]
_Role = Literal["free", "driven", "fixed"]
# Ids of two units.
_Pair = Union[tuple[int, int], Sequence[int]]
_Split = Literal["train", "validation", "test", "extra"]

@final
class Model:
    def __new__(cls, source: _Path) -> Model: ...
    @staticmethod
    def from_bytes(data: bytes, name: str = "<bytes>") -> Model: ...
    def quantised(
        self, dtype: _Dtype = "i8", *, wide: Sequence[str] = ..., narrow: Sequence[str] = ...
    ) -> Model: ...
    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path: ...
    @property
    def parameters(self) -> int: ...
    @property
    def nbytes(self) -> int: ...
    @property
    def frame_rate_hz(self) -> float: ...
    @property
    def command_size(self) -> int: ...
    @property
    def provenance(self) -> dict[str, str]: ...

@final
class Unit:
    def __new__(
        cls,
        points: _Numbers,
        mass_kg: float = 1.0,
        friction: float = 0.5,
        restitution: float = 0.4,
        *,
        role: _Role = "free",
        body: Optional[int] = None,
        inertia_kg_m2: Optional[_Numbers] = None,
        pieces: Sequence[_Numbers] = ...,
        rest: Optional[_Numbers] = None,
        young_pa: Optional[float] = None,
    ) -> Unit: ...
    def with_points(self, points: _Numbers) -> Unit: ...
    @property
    def points(self) -> _Floats: ...
    @property
    def mass_kg(self) -> float: ...
    @property
    def friction(self) -> float: ...
    @property
    def restitution(self) -> float: ...
    @property
    def role(self) -> _Role: ...
    @property
    def body(self) -> Optional[int]: ...
    @property
    def rest(self) -> Optional[_Floats]: ...
    @property
    def young_pa(self) -> Optional[float]: ...

@final
class Plane:
    def __new__(
        cls, normal: _Numbers, offset_m: float = 0.0, friction: float = 0.5, restitution: float = 0.4
    ) -> Plane: ...
    @property
    def normal(self) -> _Floats: ...
    @property
    def offset_m(self) -> float: ...
    @property
    def friction(self) -> float: ...
    @property
    def restitution(self) -> float: ...

@final
class Bond:
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    @property
    def units(self) -> tuple[int, int]: ...
    @property
    def holds(self) -> bool: ...

@final
class Joint:
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    @property
    def unit(self) -> int: ...
    @property
    def parent(self) -> int: ...
    @property
    def pivot(self) -> _Floats: ...
    @property
    def parent_pivot(self) -> _Floats: ...

@final
class Pivot:
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    @property
    def unit(self) -> int: ...
    @property
    def parent(self) -> int: ...
    @property
    def pivot(self) -> _Floats: ...
    @property
    def parent_pivot(self) -> _Floats: ...
    @property
    def residual_m(self) -> float: ...

@final
class StepReport:
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    @property
    def active_units(self) -> int: ...
    @property
    def degenerate_units(self) -> int: ...
    @property
    def quarantined_units(self) -> int: ...

@final
class Observation:
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    @property
    def residual_m(self) -> float: ...
    @property
    def degenerate_units(self) -> int: ...

@final
class World:
    def __new__(
        cls,
        model: Model,
        *,
        units: int = 64,
        points: int = 8192,
        threads: Optional[int] = None,
        kernel: Optional[str] = None,
    ) -> World: ...
    def observe(
        self, dt_s: float, units: Sequence[Unit], current: Sequence[_Numbers]
    ) -> Observation: ...
    def observe_poses(
        self, dt_s: float, units: Sequence[Unit], previous: _Numbers, current: _Numbers
    ) -> Observation: ...
    def add(self, unit: Unit, pose: _Numbers, previous: Optional[_Numbers] = None) -> int: ...
    def remove(self, id: int) -> None: ...
    def drive(self, id: int, pose: _Numbers) -> None: ...
    def command(self, command: _Numbers) -> None: ...
    def set_poses(self, id: int, previous: _Numbers, current: _Numbers) -> None: ...
    def set_velocity(self, id: int, linear_m_s: _Numbers, angular_rad_s: _Numbers) -> None: ...
    def set_physics(
        self, id: int, mass_kg: float, friction: float, restitution: float
    ) -> None: ...
    def bond(self, pairs: Sequence[_Pair]) -> None: ...
    def break_bond(self, pair: _Pair) -> bool: ...
    def join(self, unit: int, parent: int, pivot: _Numbers, parent_pivot: _Numbers) -> None: ...
    def unjoin(self, id: int) -> Optional[Joint]: ...
    def set_role(self, id: int, role: _Role) -> None: ...
    def role(self, id: int) -> _Role: ...
    def step(self, steps: int = 1) -> StepReport: ...
    def rollout(self, steps: int) -> _Floats: ...
    def pose(self, id: int) -> _Floats: ...
    def poses(self, out: Optional[_Floats] = None) -> _Floats: ...
    def previous_pose(self, id: int) -> _Floats: ...
    def points(self, id: int) -> _Floats: ...
    def soft_points(self, id: int) -> _Floats: ...
    def is_soft(self, id: int) -> bool: ...
    def health(self, id: int) -> Optional[tuple[str, float]]: ...
    @property
    def ids(self) -> list[int]: ...
    @property
    def bonds(self) -> list[Bond]: ...
    @property
    def joints(self) -> list[Joint]: ...
    @property
    def dt_s(self) -> Optional[float]: ...
    @dt_s.setter
    def dt_s(self, value: float, /) -> None: ...
    @property
    def gravity_m_s2(self) -> _Floats: ...
    @gravity_m_s2.setter
    def gravity_m_s2(self, value: _Numbers, /) -> None: ...
    @property
    def planes(self) -> list[Plane]: ...
    @planes.setter
    def planes(self, value: Sequence[Plane], /) -> None: ...
    @property
    def quarantine(self) -> bool: ...
    @quarantine.setter
    def quarantine(self, value: bool, /) -> None: ...
    def __len__(self, /) -> int: ...

@final
class Dataset:
    def __new__(cls, path: _Path) -> Dataset: ...
    @staticmethod
    def embedded() -> Dataset: ...
    def scene(self, index: int, frames: Optional[int] = None) -> Scene: ...
    def scenes_of(self, split: _Split) -> list[int]: ...
    @property
    def name(self) -> str: ...
    @property
    def path(self) -> Path: ...
    @property
    def frame_rate_hz(self) -> float: ...
    @property
    def command_size(self) -> int: ...
    def __len__(self, /) -> int: ...

@final
class Scene:
    def __new__(
        cls,
        units: Sequence[Unit],
        poses: _Numbers,
        frame_rate_hz: float,
        *,
        gravity_m_s2: Optional[_Numbers] = None,
        planes: Optional[Sequence[Plane]] = None,
        commands: Optional[_Numbers] = None,
        soft_points: Optional[_Numbers] = None,
        bonds: Sequence[tuple[int, int, Optional[int]]] = ...,
        name: str = "scene",
        seed: int = 0,
        split: _Split = "extra",
    ) -> Scene: ...
    @property
    def name(self) -> str: ...
    @property
    def seed(self) -> int: ...
    @property
    def split(self) -> _Split: ...
    @property
    def frame_rate_hz(self) -> float: ...
    @property
    def gravity_m_s2(self) -> _Floats: ...
    @property
    def units(self) -> list[Unit]: ...
    @property
    def shapes(self) -> list[str]: ...
    @property
    def planes(self) -> Optional[list[Plane]]: ...
    @property
    def frames(self) -> int: ...
    @property
    def poses(self) -> _Floats: ...
    @property
    def soft_points(self) -> Optional[_Floats]: ...
    @property
    def bonds(self) -> list[tuple[int, int, Optional[int]]]: ...
    def points(self, frame: int) -> list[_Floats]: ...
    def pivots(self, last: int) -> list[Pivot]: ...
    @property
    def commands(self) -> Optional[_Floats]: ...
    def save(self, path: _Path, *, dataset: str, provenance: str, licence: str) -> None: ...

@final
class Trajectory:
    @property
    def poses(self) -> _Floats: ...
    @property
    def frames(self) -> npt.NDArray[np.uint32]: ...
    @property
    def step(self) -> int: ...
    @property
    def points(self) -> Optional[_Floats]: ...
    @property
    def holding(self) -> Optional[list[list[bool]]]: ...
    def errors(self, scene: Scene, frame: int) -> tuple[float, float]: ...
    def __len__(self, /) -> int: ...

@final
class Start:
    def __new__(
        cls,
        dt_s: float,
        units: Sequence[Unit],
        previous: _Numbers,
        current: _Numbers,
        *,
        command: Optional[_Numbers] = None,
        planes: Optional[Sequence[Plane]] = None,
        gravity_m_s2: Optional[_Numbers] = None,
    ) -> Start: ...
    @staticmethod
    def of_scene(
        scene: Scene, step: int = 10, *, frame: Optional[int] = None, join: bool = False
    ) -> Start: ...
    @property
    def dt_s(self) -> float: ...

@final
class VelocityNoise:
    def __new__(
        cls, seed: int, linear_m_s: float = 0.0, angular_rad_s: float = 0.0
    ) -> VelocityNoise: ...
    @property
    def seed(self) -> int: ...
    @property
    def linear_m_s(self) -> float: ...
    @property
    def angular_rad_s(self) -> float: ...

@final
class BatchSimulator:
    def __new__(
        cls, model: Model, *, threads: Optional[int] = None, kernel: Optional[str] = None
    ) -> BatchSimulator: ...
    def run(
        self,
        start: Start,
        futures: int,
        steps: int,
        *,
        velocities: Optional[_Numbers] = None,
        pushes: Optional[_Numbers] = None,
        noise: Optional[VelocityNoise] = None,
        physics: Optional[_Numbers] = None,
        commands: Optional[_Numbers] = None,
        targets: Optional[Mapping[int, _Numbers]] = None,
    ) -> Futures: ...

@final
class Futures:
    @property
    def poses(self) -> _Floats: ...
    @property
    def steps(self) -> npt.NDArray[np.uint32]: ...
    @property
    def ends(self) -> list[Optional[str]]: ...
    def __len__(self, /) -> int: ...

@final
class Parameter:
    def __new__(
        cls, mean: float, deviation: float, low: float = ..., high: float = ...
    ) -> Parameter: ...
    @property
    def mean(self) -> float: ...
    @property
    def deviation(self) -> float: ...
    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...

@final
class Mppi:
    def __new__(cls, temperature: float, narrowing: float = 0.7) -> Mppi: ...
    @property
    def temperature(self) -> float: ...
    @property
    def narrowing(self) -> float: ...

@final
class Cem:
    def __new__(cls, elite: float = 0.1, smoothing: float = 0.2) -> Cem: ...
    @property
    def elite(self) -> float: ...
    @property
    def smoothing(self) -> float: ...

@final
class Launch:
    def __new__(cls, unit: int) -> Launch: ...
    @property
    def unit(self) -> int: ...

@final
class Commands:
    def __new__(cls, size: int, hold: int = 1) -> Commands: ...
    @property
    def size(self) -> int: ...
    @property
    def hold(self) -> int: ...

@final
class Planner:
    def __new__(
        cls,
        parameters: Sequence[Parameter],
        *,
        method: Optional[Union[Mppi, Cem]] = None,
        futures: int = 256,
        iterations: int = 4,
        steps: int = 10,
        seed: int = 1,
    ) -> Planner: ...
    def plan(
        self,
        simulator: BatchSimulator,
        start: Start,
        action: Union[Launch, Commands],
        cost: Callable[[_Floats, _Floats], float],
        *,
        deadline_s: Optional[float] = None,
    ) -> Plan: ...
    def plan_by(
        self, evaluate: Callable[[_Floats], _Numbers], *, deadline_s: Optional[float] = None
    ) -> Plan: ...
    def shift(self, passed: int, a_step: int) -> None: ...
    def set_mean(self, mean: _Numbers) -> None: ...
    def propose(self, samples: _Numbers) -> None: ...
    @property
    def mean(self) -> _Floats: ...

@final
class Plan:
    @property
    def best(self) -> _Floats: ...
    @property
    def cost(self) -> float: ...
    @property
    def poses(self) -> Optional[_Floats]: ...
    @property
    def mean(self) -> _Floats: ...
    @property
    def deviations(self) -> _Floats: ...
    @property
    def iterations(self) -> int: ...
    @property
    def futures(self) -> int: ...
    @property
    def unusable(self) -> int: ...
    @property
    def cut(self) -> Optional[str]: ...

@final
class PushGoal:
    def __new__(
        cls, place_m: _Numbers, yaw_rad: float = 0.0, *, lever_m: float = 0.1, haste_m_s: float = 0.005
    ) -> PushGoal: ...
    @property
    def place_m(self) -> _Floats: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def lever_m(self) -> float: ...
    @property
    def haste_m_s(self) -> float: ...
    def errors(self, pose: _Numbers) -> tuple[float, float]: ...

@final
class PushPlanner:
    def __new__(
        cls,
        body: Unit,
        pusher: Unit,
        radius_m: float,
        *,
        dt_s: float = ...,
        push_m_s: float = 0.2,
        travel_m_s: float = 0.4,
        room_m: float = 0.008,
        longest_m: float = 0.12,
        settle_s: float = 0.05,
        planes: Optional[Sequence[Plane]] = None,
        gravity_m_s2: Optional[_Numbers] = None,
        method: Optional[Union[Mppi, Cem]] = None,
        futures: int = 8,
        iterations: int = 2,
        seed: int = 1,
        heading_rad: float = 0.25,
        offset: float = 0.25,
        length_m: float = 0.03,
    ) -> PushPlanner: ...
    def plan(
        self,
        simulator: BatchSimulator,
        previous: _Numbers,
        current: _Numbers,
        goal: PushGoal,
        *,
        cost: Optional[Callable[[_Floats, float, _Floats], float]] = None,
        deadline_s: Optional[float] = None,
    ) -> PushPlan: ...
    def passed(self, plan: PushPlan, steps: int) -> None: ...
    def forget(self) -> None: ...
    @property
    def dt_s(self) -> float: ...

@final
class PushPlan:
    @property
    def heading_rad(self) -> float: ...
    @property
    def offset_m(self) -> float: ...
    @property
    def length_m(self) -> float: ...
    @property
    def cost(self) -> float: ...
    @property
    def stay(self) -> float: ...
    @property
    def path_m(self) -> _Floats: ...
    @property
    def approach(self) -> int: ...
    @property
    def poses(self) -> _Floats: ...
    @property
    def search(self) -> Plan: ...

@final
class WalkPlanner:
    def __new__(
        cls,
        *,
        method: Optional[Union[Mppi, Cem]] = None,
        futures: int = 16,
        iterations: int = 2,
        commands: int = 3,
        hold: int = 3,
        seed: int = 1,
        low: Optional[_Numbers] = None,
        high: Optional[_Numbers] = None,
    ) -> WalkPlanner: ...
    def plan(
        self,
        simulator: BatchSimulator,
        start: Start,
        place_m: _Numbers,
        heading_rad: Optional[float] = None,
        *,
        deadline_s: Optional[float] = None,
    ) -> WalkPlan: ...
    def begin_with(self, commands: _Numbers) -> None: ...
    def passed(self, steps: int) -> None: ...

@final
class WalkPlan:
    @property
    def command(self) -> _Floats: ...
    @property
    def cost(self) -> float: ...
    @property
    def path(self) -> _Floats: ...
    @property
    def search(self) -> Plan: ...

@final
class Camera:
    def __new__(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        pose: Optional[_Numbers] = None,
    ) -> Camera: ...
    def moved(self, pose: _Numbers) -> Camera: ...
    @property
    def size(self) -> tuple[int, int]: ...
    @property
    def pose(self) -> _Floats: ...

@final
class DepthView:
    def __new__(
        cls,
        camera: Camera,
        depth: npt.NDArray[np.uint16],
        scale_m: float = 0.001,
        labels: Optional[npt.NDArray[np.uint16]] = None,
    ) -> DepthView: ...

@final
class Cloud:
    def __new__(
        cls,
        points: _Numbers,
        sensor: Optional[_Numbers] = None,
        labels: Optional[npt.NDArray[np.uint16]] = None,
    ) -> Cloud: ...

@final
class Tracker:
    def __new__(
        cls,
        model: Optional[Model] = None,
        *,
        segmentation: Literal["found", "given"] = "found",
        planes: Optional[Sequence[Plane]] = None,
        plane_physics: tuple[float, float] = ...,
        unit_physics: tuple[float, float] = ...,
        density_kg_m3: float = 1000.0,
        gravity_m_s2: Optional[_Numbers] = None,
        completion: Literal["fitted", "mirrored", "seen"] = "fitted",
        model_points: int = 96,
        confirm: int = 2,
        missed: int = 5,
        hidden_s: float = 3.0,
        clusters: int = 128,
        units: int = 64,
        extents_m: tuple[float, float] = ...,
        first_velocity: tuple[float, float] = ...,
        seed: int = 1,
    ) -> Tracker: ...
    def observe(self, time_s: float, views: Sequence[Union[DepthView, Cloud]]) -> Estimate: ...
    def predict(self, horizon_s: float) -> Forecast: ...
    @property
    def planes(self) -> list[Plane]: ...
    def shape(self, id: int) -> Optional[_Floats]: ...

@final
class Estimate:
    @property
    def time_s(self) -> float: ...
    @property
    def units(self) -> list[Track]: ...

@final
class Track:
    @property
    def id(self) -> int: ...
    @property
    def pose(self) -> _Floats: ...
    @property
    def covariance(self) -> _Floats: ...
    @property
    def velocity(self) -> _Floats: ...
    @property
    def velocity_covariance(self) -> _Floats: ...
    @property
    def points(self) -> _Floats: ...
    @property
    def sight(self) -> Literal["seen", "hidden", "missed"]: ...

@final
class Forecast:
    @property
    def step_s(self) -> float: ...
    @property
    def poses(self) -> dict[int, _Floats]: ...
    @property
    def left_out(self) -> dict[int, str]: ...

def check(
    float_model: Model,
    quantised: Model,
    dataset: Dataset,
    *,
    steps: Sequence[int] = ...,
    split: _Split = "test",
    limit: Optional[int] = None,
    tolerances: Optional[_Path] = None,
) -> dict[str, Any]: ...
def evaluate(
    model: Model,
    dataset: Dataset,
    *,
    steps: Sequence[int] = ...,
    split: _Split = "test",
    limit: Optional[int] = None,
    join: bool = False,
) -> dict[str, Any]: ...
def free_fall(scene: Scene, step: int = 10, last_frame: Optional[int] = None) -> Trajectory: ...
def kernels() -> list[str]: ...
def pack(
    source: _Path,
    out: _Path,
    *,
    dtype: _Dtype = "f32",
    wide: Sequence[str] = ...,
    narrow: Sequence[str] = ...,
    panels: bool = False,
    provenance: Optional[Mapping[str, str]] = None,
    scope: Optional[_Scope] = None,
    ranges: Optional[Sequence[_Path]] = None,
) -> dict[str, Any]: ...
def rollout(
    model: Model,
    scene: Scene,
    step: int = 10,
    last_frame: Optional[int] = None,
    *,
    join: bool = False,
    threads: Optional[int] = None,
    kernel: Optional[str] = None,
) -> Trajectory: ...
