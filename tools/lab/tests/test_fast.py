"""The fast trainer beside what it is a faster form of: `data`, `model` and `train`. No assets needed."""

import json
import time

import numpy as np
import pytest
import torch

from rigidformer_lab import evaluate, export, movi, train_fast
from rigidformer_lab.config import PRESETS
from rigidformer_lab.data import Dataset, state_at
from rigidformer_lab.fast import Bucket, FastRigidFormer, Flat, Sampler, Shapes, nearest_by_kernel, prepare, shares
from rigidformer_lab.geometry import _Procrustes, nearest_points, nearest_rotation, solve_three
from rigidformer_lab.ground import level_ground
from rigidformer_lab.model import RigidFormer, transform
from rigidformer_lab.scenes import read_scenes, write_scenes
from rigidformer_lab.train import window_loss

CONFIG = PRESETS["tiny-paper-inputs"]
GROUND = CONFIG.ground_friction, CONFIG.ground_restitution
FRAMES, POINTS = 60, 16


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("fast") / "primitives.safetensors"
    write_scenes(path, movi.make_scenes(movi.Recipe("primitives", 1, 9, FRAMES, None), range(1, 10)))
    return path


@pytest.fixture(scope="module")
def loaded(path):
    """Shapes, buckets by numbers of units, and their sampler."""
    shapes, buckets = Shapes(), {}
    for units, part in prepare(read_scenes(path), shapes, FRAMES).items():
        buckets[units] = Bucket(units, len(part.shape) + 1, FRAMES, "cpu")
        assert buckets[units].add(part) == len(part.shape)
        buckets[units].refresh([1, 5], 2)
    return shapes, buckets, Sampler(shapes, CONFIG, GROUND, "cpu")


def models(config=CONFIG):
    torch.manual_seed(3)
    model = RigidFormer(config).initialise()
    torch.nn.init.normal_(model.anchors.head.get_submodule("1").weight, std=0.1)
    fast = FastRigidFormer(config)
    fast.load_state_dict(model.state_dict())
    return model, fast


def both(path, loaded, horizon=2):
    """The same windows as `Dataset` and as `Sampler` tell them, with all points of cubes' least number."""
    _, buckets, sampler = loaded
    dataset = Dataset([path], [0], last_frame=FRAMES - 1)
    dataset.refresh_subsets(POINTS)
    units = max(buckets, key=lambda m: buckets[m].used)
    scenes = np.flatnonzero(np.diff(dataset.first_unit) == units)
    windows = [(int(scenes[0]), 3, 5), (int(scenes[-1]), 20, 1)]
    rows = [dataset.chosen_units(w, horizon, True) for w in windows]
    scene, rotation, centre, _ = dataset.tensors(windows, rows, horizon, POINTS, False)
    _, frame, code = torch.tensor(windows).unbind(1)
    number = torch.tensor([0, buckets[units].used - 1])
    # The rows of the bank that the dataset has drawn, in this bank.
    mine = sampler.window(buckets[units], number, frame, code, horizon, POINTS, False, pick=torch.zeros(2, units, POINTS, dtype=torch.int64))[0]
    near = torch.stack([
        torch.cdist(scene.points[b, m] / scene.scale[b, m], sampler.bank[mine.start[b, m] : mine.start[b, m] + mine.count[b, m]]).argmin(1) + mine.start[b, m]
        for b in range(2) for m in range(units)
    ]).view(2, units, POINTS)  # fmt: skip
    return (scene, rotation, centre), sampler.window(buckets[units], number, frame, code, horizon, POINTS, False, pick=near)


def test_windows_are_those_of_the_dataset(path, loaded):
    (scene, rotation, centre), (mine, my_rotation, my_centre) = both(path, loaded)
    assert torch.allclose(my_rotation, rotation, atol=1e-6) and torch.allclose(my_centre, centre, atol=1e-5)
    for name in ("points", "physics", "radius", "scale", "step", "mask", "count", "points_in_use"):
        assert torch.allclose(getattr(mine, name).double(), getattr(scene, name).double(), atol=1e-5), name
    for k in range(2):
        assert torch.allclose(mine.reference[k], scene.reference[k], atol=1e-5)
    assert torch.equal(mine.planes.normal, scene.planes.normal[:, :1]) and torch.equal(mine.planes.friction, scene.planes.friction[:, :1])


def test_features_and_loss_are_those_of_the_model(path, loaded):
    batches = both(path, loaded)
    model, fast = models()
    found = []
    for one, (scene, rotation, centre) in zip((model, fast), batches):
        one.zero_grad()
        features = one.features(scene, state_at(rotation, centre, 1))
        loss = window_loss(one, scene, rotation, centre, 2, noise=0.0)
        loss.backward()
        found.append((features, loss, torch.cat([p.grad.flatten() for p in one.parameters() if p.grad is not None])))
    (features, loss, gradient), (mine, my_loss, my_gradient) = found
    assert torch.allclose(mine, features, atol=1e-4)
    assert torch.allclose(my_loss, loss, rtol=1e-4) and gradient.abs().max() > 0
    assert (my_gradient - gradient).norm() < 1e-3 * gradient.norm()
    fine = window_loss(fast, *batches[1], 2, noise=0.0, fine=0.1)
    assert loss < fine < loss + 0.1 * 20


def test_turned_windows_tell_the_same(path, loaded):
    _, buckets, sampler = loaded
    units = max(buckets, key=lambda m: buckets[m].used)
    torch.manual_seed(1)
    sampler.refresh(POINTS)
    scene, frame, code = sampler.draw(buckets[units], 6, [1, 5])
    assert sorted(code.tolist()) == [1] * 3 + [5] * 3 and (frame + 3 * code < FRAMES).all() and (scene < buckets[units].used).all()
    told, rotation, centre = sampler.window(buckets[units], scene, frame, code, 1, POINTS)
    plain = buckets[units].poses[scene, frame, :, :3]
    apart = lambda c: (c[:, 1:] - c[:, :1]).norm(dim=-1)  # noqa: E731
    assert torch.allclose(apart(centre[:, :, 0]), apart(plain), atol=1e-4) and torch.allclose(centre[:, :, 0, 2], plain[..., 2], atol=1e-5)
    assert not torch.allclose(centre[:, :, 0], plain)
    eye = torch.eye(3).expand(rotation.shape)
    assert torch.allclose(rotation @ rotation.transpose(-1, -2), eye, atol=1e-5)
    anchors = sampler.bank[told.start[..., None] + torch.arange(4)] * told.scale[..., None, None]
    assert torch.equal(told.points[:, :, :4], anchors)
    # A full turn of augmentation keeps what the network predicts, beside its own frame.
    state = state_at(rotation, centre, 1)
    features = FastRigidFormer(CONFIG).features(told, state)
    assert torch.allclose(features[..., 3:6].norm(dim=-1).mean(-1), (centre[:, :, 1] - centre[:, :, 0]).norm(dim=-1), atol=0.05)


def test_windows_with_contacts_have_them(loaded):
    _, buckets, _ = loaded
    for bucket in buckets.values():
        for (code, with_contact), starts in bucket.starts.items():
            start = starts[: int(bucket.counts[code, with_contact])].long()
            scene, frame = start // FRAMES, start % FRAMES
            hit = bucket.hits[scene, frame + 3 * code] > bucket.hits[scene, frame + code]
            assert (hit == with_contact).all() or hit.all() or not hit.any()
    assert shares(10, [1, 5], 0.8) == [(1, True, 4), (1, False, 1), (5, True, 4), (5, False, 1)]


@pytest.mark.parametrize("noise", [0.05, 0.8])
def test_rotations_without_decompositions(noise):
    torch.manual_seed(0)
    reference = torch.randn(500, 4, 3)
    turn = nearest_rotation(torch.randn(500, 3, 3))
    target = reference @ turn.transpose(-1, -2) + noise * torch.randn(500, 4, 3)
    centred = [v - v.mean(-2, keepdim=True) for v in (target, reference)]
    covariance = centred[0].transpose(-1, -2) @ centred[1]
    assert torch.allclose(nearest_rotation(covariance), _Procrustes.apply(covariance.double()).float(), atol=1e-5)
    assert torch.equal(nearest_rotation(torch.zeros(1, 3, 3)), torch.eye(3)[None])
    matrix, vector = torch.randn(500, 3, 3).double(), torch.randn(500, 3).double()
    assert torch.allclose(solve_three(matrix, vector), torch.linalg.solve(matrix, vector[..., None])[..., 0], rtol=1e-6, atol=1e-8)


def test_the_kernel_finds_the_same_points():
    triton = pytest.importorskip("triton", reason="the kernel is of accelerators; Triton's interpreter stands in for one")
    if not triton.knobs.runtime.interpret:
        pytest.skip("set TRITON_INTERPRET=1 before the tests start")
    torch.manual_seed(0)
    scenes, units, points = 3, 4, 10
    bank = torch.randn(200, 3) * 0.5
    start, count = (torch.tensor(rows).expand(scenes, units).clone() for rows in ([0, 0, 64, 120], [64, 64, 56, 80]))
    count[2, 3] = 0
    scale, rotation = torch.rand(scenes, units) + 0.5, nearest_rotation(torch.randn(scenes, units, 3, 3))
    centre = torch.randn(scenes, units, 3) + torch.tensor([0, 0, 1.5])
    local = bank[start[..., None] + torch.arange(points)] * scale[..., None, None]
    radius = torch.full((scenes, units), float(bank.norm(dim=1).max())) * scale
    query, planes = transform(rotation, centre, local), level_ground(0.3, 0.5, scenes, bank)
    where = rotation, centre, radius, start, count, bank, scale
    unit, near = nearest_points(query, torch.full((scenes, units), points), *where, planes)
    mine, my_near = nearest_by_kernel(query, *where, *planes.nearest(query))
    there = count > 0
    assert torch.equal(mine[there], unit[there]) and torch.equal(my_near[there], near[there]) and (unit >= 0).any() and (unit < 0).any()


def test_the_flat_optimizer_is_adamw():
    torch.manual_seed(2)
    nets = [torch.nn.Sequential(torch.nn.Linear(5, 7), torch.nn.SiLU(), torch.nn.Linear(7, 2)).double() for _ in range(2)]
    nets[1].load_state_dict(nets[0].state_dict())
    flat = Flat(nets[1], 0.9)
    flat.rate.fill_(1e-2)
    plain = torch.optim.AdamW(nets[0].parameters(), lr=1e-2, weight_decay=Flat.WEIGHT_DECAY)
    for _ in range(5):
        x = torch.randn(9, 5).double()
        for net in nets:
            (net(x) ** 2).sum().mul(3.0).backward()
        torch.nn.utils.clip_grad_norm_(nets[0].parameters(), 1.0)
        plain.step()
        plain.zero_grad()
        flat.step()
    for a, b in zip(nets[0].parameters(), nets[1].parameters()):
        assert torch.allclose(a, b, atol=1e-9)
    before = flat.weights.clone(), flat.mean.clone(), flat.average.clone()
    flat.gradient.fill_(float("nan"))
    flat.step()
    assert torch.equal(before[0], flat.weights) and torch.equal(before[1], flat.mean) and torch.equal(before[2], flat.average)
    assert not flat.gradient.any()


def test_a_run_resumes_and_is_exported(path, tmp_path, capsys):
    run = tmp_path / "run"
    more = ["--preset", "tiny-paper-inputs", "--steps", "1", "5", "--frames", str(FRAMES), "--points", str(POINTS), "--slots", "16",
            "--horizon", "1:.5", "2:1:8", "--validate-scenes", "1"]  # fmt: skip
    train_fast.main(["--data", str(path), "--run", str(run), "--updates", "3", *more])
    first = torch.load(run / "checkpoint.pt", weights_only=False)
    train_fast.main(["--data", str(path), "--run", str(run), "--updates", "5", *more])
    second = torch.load(run / "checkpoint.pt", weights_only=False)
    assert (first["updates"], second["updates"]) == (3, 5) and second["seen"] > first["seen"] and second["average_count"] == 5
    assert "resumed" in capsys.readouterr().err
    for name in ("checkpoint.pt", "weights.pt"):
        model, _ = evaluate.load(run / name)
        assert all(torch.equal(value, second["average"][key]) for key, value in model.state_dict().items())
    assert "8 scenes" in export.run_line(second) and "step codes 1 5" in export.run_line(second)
    with pytest.raises(SystemExit):
        train_fast.main(["--data", str(tmp_path / "none"), "--run", str(run)])
    assert all(json.loads(line)["windows"] >= 0 for line in (run / "curve.jsonl").read_text().splitlines())


def test_folders_of_parts_are_read_as_they_come(path, tmp_path):
    folder = tmp_path / "x.parts"
    folder.mkdir()
    feed = train_fast.Feed([path, folder], FRAMES)
    assert [file.name for file in feed.files()] == [path.name]
    feed.read(path)
    (folder / ".seeds-9.tmp").write_text("half")
    (folder / "seeds-00000001-00000009").write_bytes(path.read_bytes())
    (file,) = feed.files()
    dataset, seeds, parts = feed.read(file)
    feed.describe(dataset, seeds, len(seeds))
    (folder / "seeds-00000010-00000018").write_bytes(path.read_bytes())
    (late,) = feed.files()
    late.unlink()
    feed.files = lambda: [late] if late not in feed.seen else []
    feed.watch()
    for _ in range(100):
        if late in feed.seen:
            break
        time.sleep(0.1)
    feed.stop.set()
    assert late in feed.seen and feed.ready.empty() and feed.problem is None
    del feed.files
    assert feed.text() == "primitives (seeds 1-8, 8 scenes); splits train and extra" and not list(feed.files())
