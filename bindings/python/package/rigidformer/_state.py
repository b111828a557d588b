"""What pickle calls: it finds functions of modules by their names."""

from __future__ import annotations

from ._native import Model, World


def model(data: bytes, name: str) -> Model:
    return Model.from_bytes(data, name)


def world(model: Model, units: int, points: int, threads: int, snapshot: bytes) -> World:
    world = World(model, units=units, points=points, threads=threads)
    world.restore(snapshot)
    return world
