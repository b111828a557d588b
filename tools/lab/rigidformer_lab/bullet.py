"""What makers of scenes with PyBullet share: the engine's settings, materials, recorded poses, and the command's end."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from pathlib import Path

import numpy as np

from .movi import CONTACT_LAW as CONTACT_LAW  # with the settings of `engine`
from .movi import _terminate, generate
from .scenes import Scenes, SceneFileError


@contextlib.contextmanager
def world():
    """PyBullet with an empty world and its own settings, and the argument that names this world in calls."""
    import pybullet as pb

    client = pb.connect(pb.DIRECT)
    if client < 0:
        raise RuntimeError("PyBullet refused a direct connection; too many may be open in this process")
    try:
        yield pb, {"physicsClientId": client}
    finally:
        pb.disconnect(client)


@contextlib.contextmanager
def paced_world(gravity_m_s2, step_s: float):
    """A `world` with gravity and a time step, whose pairs always come in one order."""
    with world() as (pb, on):
        pb.setPhysicsEngineParameter(deterministicOverlappingPairs=True, **on)
        pb.setGravity(*gravity_m_s2, **on)
        pb.setTimeStep(step_s, **on)
        yield pb, on


@contextlib.contextmanager
def engine(gravity_m_s2, step_s: float):
    """A `paced_world` with the settings of `movi`."""
    with paced_world(gravity_m_s2, step_s) as (pb, on):
        pb.setPhysicsEngineParameter(restitutionVelocityThreshold=0.0, warmStartingFactor=0.0, useSplitImpulse=True,
                                     contactSlop=0.0, enableConeFriction=False, **on)
        yield pb, on


def data_file(name: str) -> str:
    """A file that comes with PyBullet."""
    import pybullet_data

    path = Path(pybullet_data.getDataPath()) / name
    if not path.is_file():
        raise RuntimeError(f"{path} is missing; install the package pybullet again")
    return str(path)


def add_body(pb, on: dict, collision: int, mass: float, friction: float, restitution: float, place=(0, 0, 0),
             turn=(1, 0, 0, 0)) -> int:
    """A body at a place with a quaternion w, x, y, z; mass 0: it stays. PyBullet's number of it."""
    w, x, y, z = turn
    number = pb.createMultiBody(mass, collision, basePosition=place, baseOrientation=(x, y, z, w),
                                useMaximalCoordinates=True, **on)
    pb.changeDynamics(number, -1, contactProcessingThreshold=0, **on)
    pb.changeDynamics(number, -1, lateralFriction=friction, restitution=restitution, mass=mass, **on)
    return number


def add_plane(pb, on: dict, plane) -> int:
    """A plane: normal, offset in metres, friction, restitution."""
    *normal, offset, friction, restitution = plane
    collision = pb.createCollisionShape(pb.GEOM_PLANE, planeNormal=normal, **on)
    return add_body(pb, on, collision, 0.0, friction, restitution, place=offset * np.array(normal))


def pose_of(pb, on: dict, number: int) -> tuple[float, ...]:
    """Position and quaternion w, x, y, z."""
    place, (x, y, z, w) = pb.getBasePositionAndOrientation(number, **on)
    return (*place, w, x, y, z)


def steady_signs(poses: np.ndarray) -> None:
    """Makes quaternions of (units, frames, 7) of length 1, their sign continuous over time."""
    quaternions = poses[:, :, 3:]
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    flips = np.einsum("ufk,ufk->uf", quaternions[:, 1:], quaternions[:, :-1]) < 0
    quaternions[:, 1:] *= np.where(np.cumsum(flips, axis=1) % 2, -1.0, 1.0)[:, :, None]


def check_seeds(parser, options) -> None:
    """Ends with an error of usage where numbers of seeds, frames or workers cannot be."""
    for name in ("seeds", "frames", "workers"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1")
    if options.first_seed < 0 or options.first_seed + options.seeds > 2**32:
        parser.error("seeds must lie between 0 and 2^32 - 1")


def run(recipe, out: Path, workers: int, dask: str | None = None) -> int:
    """Makes the file and says so; the exit code of the command."""
    signal.signal(signal.SIGTERM, _terminate)
    start = time.monotonic()
    try:
        scenes: Scenes = generate(recipe, out, workers, dask)
    except (SceneFileError, RuntimeError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"interrupted; the same command continues from {out}.parts", file=sys.stderr)
        return 130
    print(f"{out}: {scenes.scenes} scenes, {scenes.units} units, {scenes.frames} frames, {out.stat().st_size} bytes, "
          f"{time.monotonic() - start:.1f} s")
    return 0
