"""What pickle calls: it finds functions of modules by their names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Optional

from ._native import Group, HeightField, Model, World


def model(data: bytes, name: str) -> Model:
    return Model.from_bytes(data, name)


def world(
    model: Model, units: int, points: int, threads: int, snapshot: bytes, field: Optional[HeightField] = None
) -> World:
    world = World(model, units=units, points=points, threads=threads)
    # A snapshot has none.
    world.height_field = field
    world.restore(snapshot)
    return world


def group(threads: Optional[int], members: Sequence[tuple[str, World, Optional[float]]]) -> Group:
    group = Group(threads=threads)
    for name, world, within_m in members:
        group.add(name, world)
        group.set_neighbour_distance(name, within_m)
    return group
