"""What pickle calls: it finds functions of modules by their names."""

from __future__ import annotations

from ._native import HeightField, Model, World


def model(data: bytes, name: str) -> Model:
    return Model.from_bytes(data, name)


def world(
    model: Model, units: int, points: int, threads: int, snapshot: bytes, field: HeightField | None = None
) -> World:
    world = World(model, units=units, points=points, threads=threads)
    # A snapshot has none.
    world.height_field = field
    world.restore(snapshot)
    return world
