"""RigidFormer: predicts how rigid bodies move from points on them.

Metres, kilograms, seconds, radians; the world is right-handed with z up. A pose is seven float32: x, y, z, then w, x, y, z of a
unit quaternion. Arrays of float32 that are C-contiguous are read in place; other real numbers are converted.
"""

from ._errors import FileError, InputError, RigidFormerError, StepError
from ._native import (
    Dataset,
    Model,
    Observation,
    Plane,
    Scene,
    StepReport,
    Trajectory,
    Unit,
    World,
    free_fall,
    kernels,
    rollout,
)

__all__ = [
    "Dataset",
    "FileError",
    "InputError",
    "Model",
    "Observation",
    "Plane",
    "RigidFormerError",
    "Scene",
    "StepError",
    "StepReport",
    "Trajectory",
    "Unit",
    "World",
    "free_fall",
    "kernels",
    "rollout",
]
