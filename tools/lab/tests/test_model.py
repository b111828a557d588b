"""The PyTorch model: geometry, symmetries, one training step. No assets needed."""

import dataclasses
import json

import numpy as np
import torch

from rigidformer_lab import geometry
from rigidformer_lab.config import PRESETS, ModelConfig
from rigidformer_lab.model import ANCHORS, Encoder, RigidFormer, Scene, State


def random_rotation(generator, shape):
    q = torch.randn(*shape, 4, generator=generator, dtype=torch.float64)
    return geometry.quaternion_to_matrix(q / q.norm(dim=-1, keepdim=True))


def random_scene(units=3, points=12, seed=0, dtype=torch.float64, command=3):
    g = torch.Generator().manual_seed(seed)
    locals_ = []
    for _ in range(units):
        p = torch.rand(points, 3, generator=g).numpy() - 0.5
        locals_.append(geometry.prepare_points(p)[0])
    local = torch.from_numpy(np.stack(locals_))[None].to(dtype)
    rotation = random_rotation(g, (1, units)).to(dtype)
    centre = torch.rand(1, units, 3, generator=g, dtype=dtype) * 1.5
    state = State(rotation, centre, random_rotation(g, (1, units)).to(dtype), centre + 0.05)
    return Scene(
        points=local, points_in_use=torch.full((1, units), points), mask=torch.ones(1, units, dtype=torch.bool),
        physics=torch.rand(1, units, 3, generator=g, dtype=dtype) + 0.2, radius=local.norm(dim=-1).amax(-1),
        reference=(rotation, centre), start=(torch.arange(units) * points)[None],
        count=torch.full((1, units), points), scale=torch.ones(1, units, dtype=dtype),
        bank=local[0].flatten(0, 1), step=torch.tensor([10]), command=torch.rand(1, command, generator=g, dtype=dtype),
    ), state  # fmt: skip


def tiny(seed=0):
    torch.manual_seed(seed)
    model = RigidFormer(PRESETS["tiny"]).double()
    for p in model.parameters():
        p.data.add_(torch.randn_like(p) * 0.05)
    return model


def test_procrustes_derivative_equals_finite_differences():
    g = torch.Generator().manual_seed(1)
    h = torch.randn(4, 3, 3, generator=g, dtype=torch.float64)
    h = h @ h.transpose(-1, -2) + 2 * torch.eye(3, dtype=torch.float64)  # well-conditioned
    h = (random_rotation(g, (4,)) @ h).requires_grad_()
    weight = torch.randn(4, 3, 3, generator=g, dtype=torch.float64)
    (geometry._Procrustes.apply(h) * weight).sum().backward()
    for index in np.ndindex(4, 3, 3):
        step = torch.zeros_like(h)
        step[index] = 1e-6
        up, down = (geometry._Procrustes.apply(h.detach() + s * step) for s in (1, -1))
        slope = ((up - down) * weight).sum() / 2e-6
        assert abs(slope - h.grad[index]) < 1e-3 * (1 + abs(slope))  # damped by 1e-4 on purpose


def test_nearest_points_agree_between_the_two_searches():
    scene, state = random_scene(units=5, points=20, seed=2, dtype=torch.float32)
    query = torch.rand(1, 5, 7, 3) * 2
    arguments = (state.rotation, state.centre)
    bank = (scene.start, scene.count, scene.bank, scene.scale)
    fast = geometry.nearest_points(query, torch.full((1, 5), 7), *arguments, scene.radius, *bank)
    plain = geometry._nearest_torch(query, *arguments, *bank)
    assert torch.equal(fast[0], plain[0])
    assert torch.allclose(fast[1][fast[0] >= 0], plain[1][fast[0] >= 0], atol=1e-6)


def test_unit_permutation_permutes_the_step():
    scene, state = random_scene()
    model = tiny()
    order = torch.tensor([2, 0, 1])
    pick = lambda t: t[:, order]  # noqa: E731
    moved = dataclasses.replace(
        scene, points=pick(scene.points), physics=pick(scene.physics), radius=pick(scene.radius),
        reference=tuple(pick(t) for t in scene.reference), start=pick(scene.start),
    )  # fmt: skip
    other = State(*(pick(t) for t in (state.previous_rotation, state.previous_centre, state.rotation, state.centre)))
    with torch.no_grad():
        a, _, _ = model.step(scene, state)
        b, _, _ = model.step(moved, other)
    assert torch.allclose(pick(a.centre), b.centre, atol=1e-12)
    assert torch.allclose(pick(a.rotation), b.rotation, atol=1e-12)


def test_a_new_model_moves_freely():
    scene, state = random_scene()
    model = RigidFormer(dataclasses.replace(PRESETS["tiny"], command_size=0)).initialise().double()
    with torch.no_grad():
        after, _, _ = model.step(scene, state)
        rotation, centre = model.free(scene, state)
    assert torch.allclose(after.centre, centre, atol=1e-12)
    assert torch.allclose(after.rotation, rotation, atol=1e-10)


def test_gradients_flow_through_a_closed_loop_of_symmetric_units():
    scene, state = random_scene()
    corners = torch.tensor(np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(-1, 3)) * 0.4
    corners = torch.from_numpy(geometry.prepare_points(corners.numpy().astype(np.float32))[0]).double()
    scene = dataclasses.replace(
        scene, points=corners.expand(1, 3, -1, -1).clone(), points_in_use=torch.full((1, 3), 8),
        count=torch.full((1, 3), 8), start=torch.zeros(1, 3, dtype=torch.int64), bank=corners,
    )  # fmt: skip
    model = tiny()
    for _ in range(3):
        state, _, _ = model.step(scene, state)
    state.centre.square().sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in model.parameters() if p.grad is not None)


def test_prepared_points_do_not_depend_on_their_order():
    points = np.random.default_rng(3).random((50, 3)).astype(np.float32)
    a, centre = geometry.prepare_points(points)
    b, other = geometry.prepare_points(points[::-1])
    assert np.array_equal(a, b) and np.array_equal(centre, other)
    assert len(a[:ANCHORS]) == ANCHORS


def test_config_survives_json():
    for config in PRESETS.values():
        assert ModelConfig.from_json(config.to_json()) == config


def test_config_reads_what_was_written_before_it_grew():
    raw = json.loads(PRESETS["paper"].to_json())
    del raw["point_hidden"], raw["fuse_hidden"]
    old = ModelConfig.from_json(json.dumps(raw))
    assert (old.point_hidden, old.fuse_hidden) == ((), 0)
    assert not {"point_hidden", "fuse_hidden"} & json.loads(PRESETS["edge"].to_json()).keys()


def test_the_point_network_is_a_chain_named_by_position():
    with torch.device("meta"):
        paper = RigidFormer(PRESETS["paper"])
        edge = RigidFormer(PRESETS["edge"])
    shapes = lambda m: {n: tuple(p.shape) for n, p in m.encoder.point.named_parameters()}  # noqa: E731
    assert shapes(paper) == {
        "0.weight": (256, 12), "0.bias": (256,), "1.weight": (512, 256), "1.bias": (512,),
        "2.weight": (1024, 512), "2.bias": (1024,),
    }  # fmt: skip
    assert list(shapes(edge)) == ["0.weight", "0.bias", "1.weight", "1.bias"]
    assert tuple(paper.encoder.fuse.get_parameter("0.weight").shape) == (14592, 8192)


def test_the_paper_preset_has_the_papers_parameters():
    with torch.device("meta"):
        count = sum(p.numel() for p in RigidFormer(PRESETS["paper"]).parameters())
    assert count == 175_056_516
    assert abs(count / 174.8e6 - 1) < 0.01


def test_full_pools_equal_the_pools_of_all_points():
    encoder = Encoder(PRESETS["tiny"])
    for points in (4, 5, 7, 32):
        hidden = torch.randn(2, 3, points, 8, dtype=torch.float64)
        all_points = torch.full((2, 3), points)
        one = torch.cat(encoder.pools(hidden, all_points), -1)
        assert torch.allclose(one, torch.cat(encoder.full_pools(hidden), -1), atol=1e-12)
