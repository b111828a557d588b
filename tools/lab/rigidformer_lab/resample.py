"""Other points on the same bodies: the same scenes, seen by another sensor.

    python -m rigidformer_lab.resample movi-b.safetensors --points 768 --assets KUBASIC --out movi-b-768.safetensors
    python -m rigidformer_lab.resample movi-b.safetensors --keep 0.75 --out movi-b-masked.safetensors
    python -m rigidformer_lab.resample movi-b.safetensors --pieces 0 --out movi-b-hulls.safetensors

`--points` samples the surface of each MOVi shape evenly, parts inside another piece of the shape aside; `--keep` keeps a
random share of the points that the file has; `--pieces` keeps the points and gives each MOVi shape its mesh's convex pieces,
merged to so many, or with 0 takes all pieces away. Poses, masses and splits stay. Convex pieces stay with `--points` and go with
`--keep`: who misses points does not know the shape.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np

from .pieces import PIECES, MeshError, file_pieces, read_pieces, read_triangles
from .scenes import SceneFileError, read_scenes, write_scenes

INSIDE = 1e-3  # of a piece's extent: nearer to a face counts as on it
LEAST = 4  # points that a unit needs


def inside(points: np.ndarray, piece: np.ndarray) -> np.ndarray:
    """Which points (N, 3) lie inside a convex piece (T, 3, 3), clear of its faces."""
    normal = np.cross(piece[:, 1] - piece[:, 0], piece[:, 2] - piece[:, 0])
    length = np.linalg.norm(normal, axis=1)
    corner, normal = piece[length > 0, 0], normal[length > 0] / length[length > 0, None]
    middle = piece.reshape(-1, 3).mean(0)
    normal *= np.sign(((corner - middle) * normal).sum(1, keepdims=True))
    distance = points @ normal.T - (corner * normal).sum(1)
    return (distance < -INSIDE * np.ptp(piece.reshape(-1, 3), axis=0).max()).all(1)


def sample_surface(pieces: list[np.ndarray], count: int, rng) -> np.ndarray:
    """Points spread evenly over the outer surface of a shape made of convex pieces, (count, 3)."""
    triangles = np.concatenate(pieces)
    owner = np.repeat(np.arange(len(pieces)), [len(piece) for piece in pieces])
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    found = np.zeros((0, 3))
    for _ in range(100):
        chosen = rng.choice(len(triangles), 2 * count, p=area / area.sum())
        a, b = np.sqrt(rng.random((2 * count, 1))), rng.random((2 * count, 1))
        x, y, z = np.swapaxes(triangles[chosen], 0, 1)
        points = (1 - a) * x + a * (1 - b) * y + a * b * z
        hidden = np.zeros(len(points), bool)
        for k, piece in enumerate(pieces):
            hidden |= inside(points, piece) & (owner[chosen] != k)
        found = np.concatenate((found, points[~hidden]))
        if len(found) >= count:
            return found[:count].astype(np.float32)
    raise MeshError("every sampled point lies inside a piece: the mesh is not made of convex pieces")


def resample(scenes, choose, pieces=True):
    """The scenes with `choose(name, points)` as the points of each shape, with their pieces or without."""
    if scenes.soft_offsets[-1]:
        raise MeshError("some units are deformable (unit_soft): their points are recorded one by one; give a file "
                        "without such units")
    if not pieces:
        scenes = dataclasses.replace(scenes, shape_pieces=None, piece_offsets=None, piece_points=None)
    points = [choose(name, scenes.points_of_shape(k)) for k, name in enumerate(scenes.shape_names)]
    return dataclasses.replace(
        scenes,
        shape_points=np.concatenate(points).astype(np.float32),
        shape_offsets=np.concatenate([[0], np.cumsum([len(p) for p in points])]).astype(np.int64),
    )


def with_pieces(scenes, assets, most: int):
    """The scenes with each shape's convex pieces, merged to so many; 0: with none."""
    names = [] if most == 0 else scenes.shape_names
    pieces = [read_pieces(assets / name / "collision_geometry.obj", most) for name in names]
    return dataclasses.replace(scenes, **{"shape_pieces": None, "piece_offsets": None, "piece_points": None, **file_pieces(pieces)})


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.resample", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", type=Path, help="scene file to read")
    parser.add_argument("--out", type=Path, required=True, help="scene file to make")
    how = parser.add_mutually_exclusive_group(required=True)
    how.add_argument("--points", type=int, help="points on the surface of each shape; needs --assets")
    how.add_argument("--keep", type=float, help="share of the file's points to keep, above 0 to 1")
    how.add_argument("--pieces", type=int, help=f"convex pieces of a shape, at most, 0 to {PIECES}; needs --assets but for 0")
    parser.add_argument("--assets", type=Path, help="folder of the KuBasic shapes")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    options = parser.parse_args(arguments)
    if options.points is not None and (options.points < LEAST or options.assets is None):
        parser.error(f"--points takes {LEAST} or more, and --assets")
    if options.keep is not None and not 0 < options.keep <= 1:
        parser.error("--keep takes a share above 0, at most 1")
    if options.pieces is not None and not 0 <= options.pieces <= PIECES:
        parser.error(f"--pieces takes 0 to {PIECES}")
    if options.pieces and options.assets is None:
        parser.error("--pieces takes --assets too")
    rng = np.random.default_rng(options.seed)

    def choose(name, points):
        if options.points is not None:
            return sample_surface(read_triangles(options.assets / name / "collision_geometry.obj"), options.points, rng)
        kept = max(min(LEAST, len(points)), round(options.keep * len(points)))
        return points[np.sort(rng.permutation(len(points))[:kept])]

    try:
        scenes = read_scenes(options.scenes)
        if options.pieces is not None:
            scenes = with_pieces(scenes, options.assets, options.pieces)
            scenes.provenance += f"; at most {options.pieces} convex pieces a shape"
        else:
            scenes = resample(scenes, choose, pieces=options.points is not None)
            how = f"{options.points} points on each surface" if options.points else f"{options.keep:g} of the points"
            scenes.provenance += f"; resampled: {how}, seed {options.seed}"
        write_scenes(options.out, scenes)
    except (MeshError, SceneFileError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    counts = np.diff(scenes.shape_offsets)
    print(f"{options.out}: {scenes.scenes} scenes, {counts.min()} to {counts.max()} points a shape")
    return 0


if __name__ == "__main__":
    sys.exit(main())
