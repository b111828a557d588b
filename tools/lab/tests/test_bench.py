"""What the benchmark of peers runs is the model, and its nearest-point searches are right. Times are not tested."""

import dataclasses
import sys

import numpy as np
import pytest
import torch

from rigidformer_lab import bench
from rigidformer_lab.config import PRESETS
from rigidformer_lab.geometry import nearest_points
from rigidformer_lab.model import RigidFormer, transform

COUNTS = (12, 8, 30, 8, 5, 12, 9)


def padded(cloud, scene):
    """The scene as the model takes it: all points, padded."""
    points = torch.zeros(1, len(cloud.counts), int(cloud.counts.max()), 3)
    for m, (a, b) in enumerate(zip(cloud.start, cloud.start[1:])):
        points[0, m, : b - a] = torch.from_numpy(cloud.local[a:b])
    return dataclasses.replace(scene, points=points, points_in_use=scene.count)


@pytest.mark.parametrize("way", ["unit_trees", "trees_of_the_rest", "one_tree"])
@pytest.mark.parametrize("counts", [COUNTS, bench.STEPS["W-edge"][1]])
def test_kd_trees_find_the_nearest_points(way, counts):
    pytest.importorskip("scipy")
    cloud, scene, state = bench.make_scene(counts)
    whole = padded(cloud, scene)
    points = cloud.world(state.rotation[0], state.centre[0])
    index = getattr(bench.Search(cloud), way)(points.numpy(), state.rotation[0].numpy(), state.centre[0].numpy())
    query = transform(state.rotation, state.centre, whole.points)
    bank = (scene.start, scene.count, scene.bank, scene.scale)
    unit, local = nearest_points(query, scene.count, state.rotation, state.centre, scene.radius, *bank)
    inside = np.concatenate([np.arange(n) + m * query.shape[2] for m, n in enumerate(cloud.counts)])
    unit, local = unit[0].flatten()[inside].numpy(), local[0].flatten(0, 1)[inside].numpy()
    assert np.array_equal(np.where(index < 0, -1, cloud.owner[index]), unit)
    found = index >= 0
    assert found.any() and not found.all()
    assert np.array_equal(cloud.local[index[found]], local[found])


@pytest.mark.parametrize("preset", ["tiny", "tiny-paper-inputs"])
def test_a_benchmarked_step_is_a_step_of_the_model(preset):
    pytest.importorskip("scipy")
    cloud, scene, state = bench.make_scene(COUNTS)
    config = dataclasses.replace(PRESETS[preset], command_size=0, point_hidden=(24, 16), fuse_hidden=40)
    model = bench.make_model(config)
    learned = bench.Learned(model, cloud)
    first = cloud.world(*(t[0] for t in scene.reference))
    before = cloud.world(state.previous_rotation[0], state.previous_centre[0])
    with torch.inference_mode():
        after, seconds = bench.run_step(
            cloud, scene, state, model, bench.Search(cloud).unit_trees, first, before, learned
        )
        expected, _, _ = model.step(padded(cloud, scene), state)
    assert torch.allclose(after.centre, expected.centre, atol=1e-5)
    assert torch.allclose(after.rotation, expected.rotation, atol=1e-4)
    assert (after.centre - state.centre).abs().amax() > 1e-3
    assert all(s >= 0 for s in seconds)


def test_multiply_accumulates_are_those_of_linear_layers():
    config, counts = PRESETS["tiny-paper-inputs"], (5, 9)
    with torch.device("meta"):
        model = RigidFormer(config)
    point = sum(p.numel() for n, p in model.encoder.point.named_parameters() if n.endswith("weight"))
    more = bench.macs(config, (5, 10)) - bench.macs(config, counts)
    assert more == point


def test_a_missing_package_is_named_with_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(SystemExit, match=r"onnxruntime is missing .*tools/lab\[bench\].*--engines"):
        bench.needed("onnxruntime")
