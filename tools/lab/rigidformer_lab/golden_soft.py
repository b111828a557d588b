"""Writes the golden vectors of soft bodies: a small scene, a model with random weights, and what it makes of the scene.

    python -m rigidformer_lab.golden_soft --out tests/data

The scene: a sheet of 7 x 7 points in four patches over a fixed ball, a fixed box and a free ball, above the ground. The Rust tests
hold the core to the points that this writes.
"""

from __future__ import annotations

import argparse
import pathlib
import sys

import numpy as np
import torch
from safetensors.numpy import save_file

from .config import PRESETS
from .export import write_model
from .patches import cut
from .roles import FIXED, FREE, OWN_BODY
from .scenes import write_scenes
from .shell import icosphere
from .soft_data import batch_of, records, state_at
from .soft_model import SoftFormer
from .trials import one_scene

NAME, STEP, STEPS = "tiny-soft", 5, 4
SIDE, SPACING_M, FRAMES = 7, 0.06, 11


def sheet():
    """(49, 3) points at rest, and the triangles between them."""
    at = np.arange(SIDE)
    rest = np.array([((i - 3) * SPACING_M, (j - 3) * SPACING_M, 0.0) for i in at for j in at])
    corner = [(i * SIDE + j) for i in at[:-1] for j in at[:-1]]
    triangles = [(c, c + SIDE, c + 1) for c in corner] + [(c + 1, c + SIDE, c + SIDE + 1) for c in corner]
    return rest, np.array(triangles)


def scene():
    rest, triangles = sheet()
    patches = cut(rest, triangles, (2, 2))
    time = np.arange(FRAMES) / 60.0
    fall = np.stack([0.1 * time, 0 * time, 0.24 - 4.905 * time**2 - 0.3 * time], 1)
    wave = 0.01 * np.sin(20 * rest[:, :1]) * [0.0, 0.0, 1.0]
    vertices = rest[None] + wave[None] + fall[:, None]
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.08, 0.05, 0.06]

    def still(x, y, z):
        return np.tile([x, y, z, 1, 0, 0, 0], (1, FRAMES, 1)).astype(float)

    ball = still(-0.06, 0.12, 0.28)
    ball[0, :, 2] -= 4.905 * time**2
    shapes = {f"patch-{k}": points for k, points in enumerate(patches.shapes)}
    shapes |= {"rock": 0.08 * icosphere(), "box": corners, "ball": 0.04 * icosphere()}
    shares = [(mass, 0.5, 0.0) for mass in patches.masses(0.06)]
    count = len(shares)
    return one_scene(
        1, "golden", shapes, np.concatenate([patches.poses(vertices), still(0.02, -0.02, 0.08), still(0.2, 0.1, 0.06), ball]),
        [*shares, (1.0, 1.0, 0.0), (1.0, 0.8, 0.0), (0.05, 0.6, 0.0)], "a sheet over a ball, a box and a ball that falls.",
        unit_role=np.array([FREE] * count + [FIXED, FIXED, FREE], np.uint8),
        unit_body=np.array([0] * count + [OWN_BODY] * 3, np.int32),
        unit_soft=np.array([1] * count + [0] * 3, np.uint8),
        unit_young=np.array([4e5] * count + [0] * 3, np.float32),
        soft_points=patches.points(vertices),
        **patches.lists(),
    )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    torch.manual_seed(5)
    path = args.out / f"{NAME}.scene.safetensors"
    write_scenes(path, scene())
    config = PRESETS[NAME]
    own = records(config, [path], [0, 1, 2, 3])
    model = SoftFormer(config).initialise()
    for layer in (model.anchors.head, model.blend["residual"]):
        for p in layer.parameters():
            torch.nn.init.normal_(p, std=0.1)
    write_model(args.out / f"{NAME}.model.safetensors", config, model.state_dict(), {"weights": "random, for tests"}, {})
    batch, state = batch_of(own, STEP, most=10**6), state_at(own, [STEP], STEP)
    rows, balls = [], []
    with torch.no_grad():
        for _ in range(STEPS):
            trace = {}
            state, _, _ = model.step(batch, state, trace)
            if not rows:
                used = torch.arange(batch.rest.shape[2]) < batch.points_in_use[..., None]
                first = {name: trace[name][used].numpy().astype(np.float32) for name in ("raw_features", "features")}
                first["head"] = trace["head"].numpy().astype(np.float32)
            rows.append(state.points[0])
            balls.append(state.centre[0])
    taken = own[0].given
    points = np.zeros((STEPS, len(taken), 3), np.float32)
    points[:, taken] = np.stack(rows)
    save_file(first | {"points": points, "rigid_centres": np.stack(balls).astype(np.float32)}, args.out / f"{NAME}.golden.safetensors")
    print(f"wrote {path} and the model and golden of {NAME}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
