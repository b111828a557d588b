"""What tests share."""

from __future__ import annotations

import importlib
import os
from pathlib import Path

import numpy as np
import pytest

import rigidformer as rf

ROOT = Path(__file__).resolve().parents[3]
MODELS = ROOT / "weights" / "models"


def cube(half: float = 0.2) -> np.ndarray:
    """(8, 3) corners, metres."""
    return half * np.array(
        [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32
    )


def at(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A pose without a turn."""
    return np.array([x, y, z, 1, 0, 0, 0], np.float32)


def falling(model: rf.Model, height: float = 1.0) -> tuple[rf.World, int]:
    """A world with a cube at rest in the air."""
    world = rf.World(model, units=4, points=64)
    world.dt_s = 1 / 24
    return world, world.add(rf.Unit(cube()), at(z=height))


@pytest.fixture(scope="session")
def edge() -> rf.Model:
    return rf.Model("edge")


@pytest.fixture(scope="session")
def nano() -> rf.Model:
    return rf.Model("nano")


@pytest.fixture(scope="session")
def scene() -> rf.Scene:
    return rf.Dataset.embedded().scene(0)


def needed(name: str):
    """A package, without which tests are skipped as by `missing`."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing(str(error))


def missing(what: str) -> None:
    """Skips a test, or fails where a command says that what tests need is there: `cargo xtask python`."""
    if os.environ.get("RIGIDFORMER_COMPLETE"):
        pytest.fail(what)
    pytest.skip(what)


@pytest.fixture(scope="session")
def program() -> str:
    """The program `rigidformer`; `cargo xtask python` builds it and says where it is."""
    path = os.environ.get("RIGIDFORMER_PROGRAM")
    if not path:
        missing("RIGIDFORMER_PROGRAM does not name the program")
    return path


@pytest.fixture(scope="session")
def walk_example(program) -> Path:
    """The example `walk` of rigidformer-planning, which `cargo xtask python` builds beside the program."""
    path = Path(program).parent / "examples" / "walk"
    if not path.exists():
        missing(f"there is no {path}")
    return path
