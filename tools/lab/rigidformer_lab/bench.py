"""Times PyTorch and ONNX Runtime on the workloads of the Rust runtime's benchmark.

    python -m rigidformer_lab.bench
    python -m rigidformer_lab.bench --workloads W-edge gemm --engines torch-f32 ort-int8 --json peers.json
    python -m rigidformer_lab.bench --serve    # slices, for `cargo xtask bench --peers`

W-edge, W-paper and W-wreck are whole steps from a fixed state: nearest points by KD-trees (SciPy), features, the
network, integration, Kabsch. Weights and points are random, which costs the same time as trained ones. `gemm` are bare
matrix products, M x K x N, f32 in and out.

The peers get what the Rust runtime has: points are not padded (units of equal size are one dense group), so attention
needs no mask; pooling weights of rigid units are computed once; points of the previous frame are kept; the bf16
engine's weights are cast once, not every step as autocast does; of three KD-tree searches the fastest is used. ort-int8
is what `quantize_dynamic` makes: DynamicQuantizeLinear, MatMulInteger and scaling, one scale an output channel,
attention in f32; how many products became integer ones is printed.

Stages: `nearest` is the search alone, `network` the learned part, `rest` all else; `step` is their sum. Everything but
`network` is the same code for all engines. What they compute is compared before it is timed. They take turns in bursts,
so that ratios are of one run; warm-up calls are not counted, and a sample of `gemm` is the mean of about 1 ms of them.

Needs the optional extra `bench` (onnx, onnxruntime, onnxscript, scipy).
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import dataclasses
import functools
import gc
import importlib
import importlib.util
import json
import logging
import os
import pathlib
import platform
import sys
import tempfile
import time
import warnings

import numpy as np
import torch
from torch import nn

from .config import PRESETS, ModelConfig
from .geometry import prepare_points, quaternion_to_matrix
from .model import ANCHORS, RigidFormer, Scene, State, transform, wide

ENGINES = ("torch-f32", "torch-bf16", "ort-f32", "ort-int8")
EXTRA = 'pip install -e "tools/lab[bench]"'

STEP_CODE = 10
SEED = 1
LEVELS = 4  # of pooling

GEMMS = (
    (26, 256, 256), (26, 768, 768), (64, 768, 768), (26, 768, 3072), (64, 3072, 768), (1, 768, 768),
)  # fmt: skip
STEPS = {  # name: preset, points of each unit
    "W-edge": ("edge-points", (64,) * 10),  # the peers are spared the impacts
    "W-paper": ("paper", (64, 51, 1142, 64, 64, 682, 682, 647, 51, 569)),
    "W-wreck-edge": ("edge-points", (8,) * 216 + (43,)),
    "W-wreck-paper": ("paper", (8,) * 216 + (43,)),
}
WORKLOADS = (*STEPS, "gemm")

OPSET = 23  # the first with operators for attention and RMSNorm

BURST_S = 0.05  # an engine's turn
SETTLE_S = 0.01  # before it: the last engine's threads go to sleep
GEMM_SAMPLE_S = 0.001  # one sample is the mean of so many products
BUSY = 0.5  # load average from which to warn
MOST_RUNS = 1000
MOST_SETUP_RUNS = 5


def needed(module):
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise SystemExit(
            f"bench: {module.partition('.')[0]} is missing ({error}); {EXTRA}, or leave out what needs it: "
            "ONNX Runtime is needed by --engines ort-f32 ort-int8, SciPy by all --workloads but gemm"
        ) from None


# --- Scenes ---------------------------------------------------------------------------------------------------------


@dataclasses.dataclass
class Cloud:
    """Units' points one after the other, units sorted by their number of points: those
    of equal size are dense groups without padding."""

    counts: np.ndarray  # (M,)
    local: np.ndarray  # (T, 3) f32, relative to the unit's centre
    radius: np.ndarray  # (M,)

    def __post_init__(self):
        self.start = np.concatenate(([0], np.cumsum(self.counts)))
        self.owner = np.repeat(np.arange(len(self.counts)), self.counts)
        sizes, units = np.unique(self.counts, return_counts=True)
        self.groups = list(zip(units.tolist(), sizes.tolist()))  # (units, points of each)

    def split(self, rows):
        """(T, ...) -> one (units, points, ...) a group."""
        at = 0
        for units, points in self.groups:
            yield rows[at : at + units * points].reshape(units, points, *rows.shape[1:])
            at += units * points

    def world(self, rotation, centre):
        """(M, 3, 3), (M, 3) -> (T, 3)."""
        parts, at = [], 0
        for local in self.split(torch.from_numpy(self.local)):
            some = slice(at, at + len(local))
            parts.append(transform(rotation[some], centre[some], local).flatten(0, 1))
            at += len(local)
        return torch.cat(parts)


def make_scene(counts, seed=SEED):
    """Units on a jittered grid, the lowest near the ground, each moving a little: Cloud, Scene, State. Units of 8
    points are cubes in stacks that nearly touch, others ellipsoids. The scene holds anchors alone as its points."""
    random = np.random.default_rng(seed)
    counts = np.sort(np.asarray(counts))
    m = len(counts)
    corners = np.stack(np.meshgrid(*[[-0.1, 0.1]] * 3), -1).reshape(-1, 3)
    locals_ = []
    for n in counts:
        if n == 8:
            points = corners
        else:
            points = random.normal(size=(n, 3))
            points *= random.uniform(0.1, 0.3, 3) / np.linalg.norm(points, axis=1, keepdims=True)
        locals_.append(prepare_points(points.astype(np.float32))[0])
    radius = np.array([np.linalg.norm(p, axis=1).max() for p in locals_], np.float32)
    cubes = int((counts == 8).sum())
    side = max(2, round(cubes ** (1 / 3)))
    centre = np.empty((m, 3))
    cell = np.stack(np.unravel_index(np.arange(cubes), (side, side, -(-cubes // side**2) or 1)), -1)
    is_cube = counts == 8
    centre[is_cube] = cell * 0.21 + [0, 0, 0.11]
    rest = m - cubes
    side = max(1, round((rest / 2) ** 0.5))
    cell = np.stack(np.unravel_index(np.arange(rest), (-(-rest // (2 * side)), side, 2)), -1)
    centre[~is_cube] = cell * 0.55 + [-0.6, 0, 0.3] + random.uniform(-0.05, 0.05, (rest, 3))
    turn = random.normal(size=(m, 4)) * np.where(is_cube, 0.02, 1)[:, None] + [1, 0, 0, 0]
    spin = random.normal(size=(m, 4)) * 0.02 + [1, 0, 0, 0]
    turn, spin = (
        quaternion_to_matrix(q / np.linalg.norm(q, axis=1, keepdims=True)) for q in (turn, spin)
    )
    put = lambda a: torch.from_numpy(np.ascontiguousarray(a, np.float32))[None]  # noqa: E731
    state = State(
        put(turn), put(centre + random.normal(size=(m, 3)) * 0.01), put(spin @ turn), put(centre)
    )
    cloud = Cloud(counts, np.concatenate(locals_), radius)
    whole = torch.from_numpy(counts)[None]
    scene = Scene(
        points=put(np.stack([p[:ANCHORS] for p in locals_])), points_in_use=whole.clamp(max=ANCHORS),
        mask=torch.ones(1, m, dtype=torch.bool), physics=put(random.uniform(0.2, 1.0, (m, 3))),
        radius=put(radius), reference=(put(turn), put(centre + 0.1)),
        start=torch.from_numpy(cloud.start[:-1])[None], count=whole, scale=torch.ones(1, m),
        bank=torch.from_numpy(cloud.local), step=torch.tensor([STEP_CODE]),
    )  # fmt: skip
    return cloud, scene, state


# --- Nearest points -------------------------------------------------------------------------------------------------


class Search:
    """For every point the row of the nearest point of any other unit, -1: the ground is nearer. Three ways that agree;
    each takes points (T, 3), rotations (M, 3, 3) and centres (M, 3) as arrays."""

    def __init__(self, cloud: Cloud):
        self.spatial = needed("scipy.spatial")
        self.cloud = cloud
        self.trees = [
            self.spatial.cKDTree(cloud.local[a:b]) for a, b in zip(cloud.start, cloud.start[1:])
        ]

    def unit_trees(self, points, rotation, centre, workers=1):
        """One tree a unit, built once; asked, in the unit's frame, by the points near enough to its bounding sphere."""
        cloud = self.cloud
        best, index = np.abs(points[:, 2]).astype(np.float64), np.full(len(points), -1)
        gap = self.spatial.distance.cdist(points, centre) - cloud.radius
        gap[np.arange(len(points)), cloud.owner] = np.inf
        for j, tree in enumerate(self.trees):
            rows = np.flatnonzero(gap[:, j] < best)
            if len(rows):
                local = (points[rows] - centre[j]) @ rotation[j]
                self._take(tree, local, rows, best, index, workers, lambda i: i + cloud.start[j])
        return index

    def trees_of_the_rest(self, points, rotation, centre, workers=1):
        """A tree of all other units' points for each unit, built every step."""
        cloud = self.cloud
        best, index = np.abs(points[:, 2]).astype(np.float64), np.full(len(points), -1)
        for a, b in zip(cloud.start, cloud.start[1:]):
            rest = np.concatenate((points[:a], points[b:]))
            tree = self.spatial.cKDTree(rest, compact_nodes=False, balanced_tree=False)
            rows = np.arange(a, b)
            self._take(tree, points[a:b], rows, best, index, workers, lambda i: np.where(i < a, i, i + b - a))
        return index

    def one_tree(self, points, rotation, centre, workers=1):
        """One tree of all points, built every step; asked for more and more neighbours until one is another unit's."""
        cloud, total = self.cloud, len(points)
        best, index = np.abs(points[:, 2]).astype(np.float64), np.full(total, -1)
        tree = self.spatial.cKDTree(points, compact_nodes=False, balanced_tree=False)
        owner = np.append(cloud.owner, -1)
        most = int(cloud.counts.max()) + 1
        k = min(int(cloud.counts.min()) + 1, 16)
        rows = np.arange(total)
        while len(rows):
            limit = best[rows]
            distance, i = tree.query(points[rows], k, distance_upper_bound=limit.max(), workers=workers)
            other = (i < total) & (owner[i] != owner[rows, None])
            first = other.argmax(1)[:, None]
            found = other.any(1)
            near = np.take_along_axis(distance, first, 1)[:, 0]
            better = found & (near < limit)
            index[rows[better]] = np.take_along_axis(i, first, 1)[better, 0]
            rows = rows[~found & (distance[:, -1] < limit)]
            k = min(4 * k, most)
        return index

    @staticmethod
    def _take(tree, queries, rows, best, index, workers, name):
        limit = best[rows]
        distance, i = tree.query(queries, distance_upper_bound=limit.max(), workers=workers)
        better = distance < limit
        best[rows[better]] = distance[better]
        index[rows[better]] = name(i[better])

    def fastest(self, threads, *poses):
        """The fastest way here, and what it is called."""
        ways = [self.unit_trees, self.trees_of_the_rest, self.one_tree]
        took = {}
        for way in ways:
            for workers in sorted({1, threads}):
                samples = []
                for _ in range(MOST_SETUP_RUNS):
                    begin = time.perf_counter()
                    way(*poses, workers=workers)
                    samples.append(time.perf_counter() - begin)
                took[way, workers] = min(samples)
        way, workers = min(took, key=took.get)
        text = ", ".join(f"{w.__name__} x {n}: {t * 1e3:.2f}" for (w, n), t in took.items())
        return functools.partial(way, workers=workers), f"{way.__name__}, {workers} worker(s) (ms: {text})"


# --- The learned part -----------------------------------------------------------------------------------------------


def pool_prefixes(x):
    """(N, U C) -> eight (U C): maximum and mean of the first N, N / 2, N / 4 and N / 8 rows, rounded up."""
    ends = [max(1, (len(x) + (1 << level) - 1) >> level) for level in range(LEVELS)]
    most = total = None
    pools, begin = [], 0
    for end in reversed(ends):
        if end > begin:
            part = x[begin:end]
            most = part.amax(0) if most is None else torch.maximum(most, part.amax(0))
            total = part.sum(0) if total is None else total + part.sum(0)
            begin = end
        pools = [most, total / end, *pools]
    return pools


class Learned(nn.Module):
    """`RigidFormer.network` without padding, for one set of units. In a group the first points of all units come first,
    then all second ones, so that pooling reduces the outermost axis (ONNX Runtime takes ten times as long for another),
    and each point once: the levels are prefixes of one another."""

    def __init__(self, model: RigidFormer, cloud: Cloud):
        super().__init__()
        self.model = model
        self.groups = cloud.groups
        anchors = torch.from_numpy(cloud.start[:-1, None] + np.arange(ANCHORS))
        self.register_buffer("anchor_rows", anchors.flatten(), persistent=False)
        rows = torch.cat([g.T.flatten() for g in cloud.split(torch.arange(len(cloud.local)))])
        self.register_buffer("rows", rows, persistent=False)
        for i, local in enumerate(cloud.split(torch.from_numpy(cloud.local))):
            everything = torch.full((1, len(local)), local.shape[1])
            weights = model.anchors.weights(local[None], everything)[0].detach()
            self.register_buffer(f"weights_{i}", weights, persistent=False)

    def forward(self, raw, anchors, step):
        """raw (T, F), anchors (1, M, A, 3), step condition (1, 2) -> (1, M, A, 3)."""
        encoder = self.model.encoder
        features = encoder.normalise(raw)
        hidden = wide(encoder.point(features[self.rows]))
        pools, pooled, at = [], [], 0
        for i, (units, points) in enumerate(self.groups):
            group = hidden[at : at + units * points]
            at += units * points
            prefixes = pool_prefixes(group.reshape(points, units * group.shape[-1]))
            pools.append(torch.cat([p.reshape(units, -1) for p in prefixes], -1))
            group = group.reshape(points, units, -1).transpose(0, 1)
            pooled.append(wide(getattr(self, f"weights_{i}") @ group))
        token = encoder.token(torch.cat(pools)[None], step, None)
        chosen = features[self.anchor_rows].reshape(1, -1, ANCHORS, features.shape[-1])
        out = self.model.interact(anchors, token, chosen, torch.cat(pooled)[None], None, step, None)
        return out * self.model.config.output_scale


def make_model(config: ModelConfig, seed=SEED):
    """Random weights of a trained model's size, in the last layers too."""
    torch.manual_seed(seed)
    model = RigidFormer(config)
    with torch.no_grad():
        for name, p in model.named_parameters():
            if p.dim() == 2:
                p.normal_(std=p.shape[1] ** -0.5)
            elif name.endswith("bias"):
                p.normal_(std=0.1)
    return model.eval().requires_grad_(False)


# --- Engines --------------------------------------------------------------------------------------------------------


def cast_once(module):
    """Linear layers in bf16, as autocast would make them anew each step."""
    for part in module.modules():
        if isinstance(part, nn.Linear):
            part.bfloat16()
    return module


def torch_engine(module, bf16):
    module = cast_once(copy.deepcopy(module)) if bf16 else module

    def run(*inputs):
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            return module(*inputs).float()

    return run


def onnx_file(module, inputs, path):
    """The module as an ONNX file, without inferred shapes: the quantiser makes its own and refuses others."""
    onnx = needed("onnx")
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = [f"input_{i}" for i in range(len(inputs))]
        program = torch.onnx.export(
            module, inputs, input_names=names, output_names=["out"], dynamo=True, opset_version=OPSET, verbose=False
        )
    proto = program.model_proto
    del proto.graph.value_info[:]
    onnx.save(proto, path)


def quantised_file(path):
    """Dynamic int8 as ONNX Runtime makes it; returns the file and what became of the matrix products."""
    onnx, quantization = needed("onnx"), needed("onnxruntime.quantization")
    out = path.with_name("int8.onnx")
    root = logging.getLogger()
    level = root.level
    root.setLevel(logging.ERROR)  # it advises a pre-processing that changes nothing here
    try:
        quantization.quantize_dynamic(
            path, out, per_channel=True, weight_type=quantization.QuantType.QInt8,
            op_types_to_quantize=["MatMul"],  # Gemm counts as one; an Attention it takes for ONNX Runtime's older own
        )  # fmt: skip
    finally:
        root.setLevel(level)
    graph = onnx.load(out).graph
    constant = {t.name for t in graph.initializer}
    integer = sum(n.op_type == "MatMulInteger" for n in graph.node)
    left = [n.op_type for n in graph.node if n.op_type in ("MatMul", "Gemm") and n.input[1] in constant]
    total = integer + len(left)
    return out, f"of {total} matrix products with weights {integer} became MatMulInteger, {len(left)} stayed f32"


def ort_engine(path, threads):
    ort = needed("onnxruntime")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.force_spinning_stop", "1")  # between runs; else it robs the next engine
    session = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    names = [i.name for i in session.get_inputs()]
    return lambda *inputs: torch.from_numpy(
        session.run(None, {n: t.numpy() for n, t in zip(names, inputs)})[0]
    )


def make_engines(names, module, inputs, threads, note):
    """Engine by name: inputs -> output. Compares them, and tells `note` what is worth knowing."""
    engines = {}
    with tempfile.TemporaryDirectory(prefix="rigidformer-bench-") as folder:
        path = pathlib.Path(folder) / "f32.onnx"
        for name in names:
            if name.startswith("torch"):
                engines[name] = torch_engine(module, bf16=name == "torch-bf16")
                continue
            if not path.exists():
                onnx_file(module, inputs, path)
            if name == "ort-f32":
                engines[name] = ort_engine(path, threads)
            else:
                quantised, text = quantised_file(path)
                note(f"ort-int8: {text}")
                engines[name] = ort_engine(quantised, threads)
    exact = module(*inputs)
    size = lambda t: t.square().mean().sqrt()  # noqa: E731
    errors = (f"{n} {size(e(*inputs) - exact) / size(exact):.1e}" for n, e in engines.items() if n != "torch-f32")
    if errors := ", ".join(errors):
        note(f"outputs differ from torch-f32's by, relative (RMS): {errors}")
    return engines


# --- Timing ---------------------------------------------------------------------------------------------------------


def interleave(calls, seconds):
    """Samples of each call (what it returns), in turns: bursts of at least one sample until `seconds` are over."""
    samples, last = {name: [] for name in calls}, {}
    for name, call in calls.items():
        call()
        begin = time.perf_counter()
        call()
        last[name] = time.perf_counter() - begin
    begin = time.perf_counter()
    while True:
        for name, call in calls.items():
            time.sleep(SETTLE_S)
            if last[name] < BURST_S:
                call()
            end = time.perf_counter() + BURST_S
            while len(samples[name]) < MOST_RUNS:
                samples[name].append(call())
                if time.perf_counter() >= end:
                    break
        if time.perf_counter() - begin >= seconds or all(len(s) >= MOST_RUNS for s in samples.values()):
            return samples


def row(workload, engine, stage, seconds, **more):
    ms = np.asarray(seconds) * 1e3
    return {
        "workload": workload, "engine": engine, "stage": stage, "median_ms": round(float(np.median(ms)), 5),
        "p99_ms": round(float(np.percentile(ms, 99)), 5), "runs": len(ms), **more,
    }  # fmt: skip


def run_step(cloud, scene, state, model, search, first, before, engine):
    """One step: the next state, and the seconds of (nearest, network, rest)."""
    begin = time.perf_counter()
    points = cloud.world(state.rotation[0], state.centre[0])
    arrays = points.numpy(), state.rotation[0].numpy(), state.centre[0].numpy()
    searching = time.perf_counter()
    index = search(*arrays)
    searched = time.perf_counter()
    raw, anchors, condition = describe(cloud, scene, state, model, points, first, before, index)
    learning = time.perf_counter()
    out = engine(raw, anchors, condition)
    learned = time.perf_counter()
    after, _, _ = model.advance(scene, state, out)
    end = time.perf_counter()
    nearest, network = searched - searching, learned - learning
    return after, (nearest, network, end - begin - nearest - network)


def describe(cloud, scene, state, model, points, first, before, index):
    """What the network wants: raw features (T, F), anchors (1, M, A, 3), step condition (1, 2)."""
    index, owner = torch.from_numpy(index), torch.from_numpy(cloud.owner)
    near = index.clamp(min=0)
    physics = scene.physics[0]
    raw = model.describe(
        points, points - before, first, points[near], (points - before)[near], index < 0, points - state.centre[0, owner],
        physics[owner], physics[owner[near]], model.dt(scene),
    )  # fmt: skip
    rows = torch.from_numpy(cloud.start[:-1, None] + np.arange(ANCHORS))
    code = scene.step.float() / 10.0
    return raw, points[rows][None], torch.stack((code, code.square()), -1)


def step_calls(name, engine_names, threads, note):
    """By engine: a step, which returns the seconds of its stages."""
    preset, counts = STEPS[name]
    cloud, scene, state = make_scene(counts)
    model = make_model(PRESETS[preset])
    learned = Learned(model, cloud)
    first = cloud.world(*(t[0] for t in scene.reference))
    before = cloud.world(state.previous_rotation[0], state.previous_centre[0])
    points = cloud.world(state.rotation[0], state.centre[0])
    poses = points.numpy(), state.rotation[0].numpy(), state.centre[0].numpy()
    search, text = Search(cloud).fastest(threads, *poses)
    index = search(*poses)
    note(f"{len(counts)} units, {len(points)} points, {np.mean(index < 0):.0%} of them nearest to the ground")
    note(f"nearest by {text}")
    parameters = sum(p.numel() for p in model.parameters())
    products = macs(model.config, counts)
    note(f"preset {preset}, {parameters / 1e6:.2f} M parameters, {products / 1e6:.0f} M multiply-accumulates")
    inputs = describe(cloud, scene, state, model, points, first, before, index)
    engines = make_engines(engine_names, learned, inputs, threads, note)
    return {
        engine: lambda e=call: run_step(cloud, scene, state, model, search, first, before, e)[1]
        for engine, call in engines.items()
    }


def bench_steps(name, engine_names, threads, seconds, note):
    calls = step_calls(name, engine_names, threads, note)
    rows = []
    for engine, samples in interleave(calls, seconds).items():
        stages = np.array(samples)
        for stage, times in zip(("nearest", "network", "rest"), stages.T):
            rows.append(row(name, engine, stage, times))
        rows.append(row(name, engine, "step", stages.sum(1)))
    return rows


def macs(c: ModelConfig, counts):
    """Multiply-accumulates of the layers with weights."""
    with torch.device("meta"):
        model = RigidFormer(c)
    units, points = len(counts), sum(counts)
    times = {"encoder.point": points, "encoder.fuse": units, "blocks": units + c.registers}
    total = 0
    for name, layer in model.named_modules():
        if isinstance(layer, nn.Linear) and "film" not in name:
            rows = next((n for prefix, n in times.items() if name.startswith(prefix)), units * ANCHORS)
            rows = units if name.endswith("key_value") else rows
            total += rows * layer.weight.numel()
    return total


def gemm_calls(m, k, n, engine_names, threads, note):
    """By engine: a product, which returns its seconds."""
    torch.manual_seed(SEED)
    linear = nn.Linear(k, n, bias=False).requires_grad_(False)
    x = torch.randn(m, k)
    engines = make_engines(engine_names, linear, (x,), threads, lambda text: note(f"{m}x{k}x{n} {text}"))
    return {engine: repeated(functools.partial(call, x)) for engine, call in engines.items()}


def bench_gemms(engine_names, threads, seconds, note):
    rows = []
    for m, k, n in GEMMS:
        name = f"gemm {m}x{k}x{n}"
        calls = gemm_calls(m, k, n, engine_names, threads, note)
        for engine, samples in interleave(calls, seconds / len(GEMMS)).items():
            gmacs = m * k * n / np.median(samples) / 1e9
            rows.append(row(name, engine, "gemm", samples, gmac_per_s=round(gmacs, 1)))
    return rows


def repeated(call):
    """Mean seconds of a call over enough of them."""
    call()
    begin = time.perf_counter()
    call()
    times = max(1, int(GEMM_SAMPLE_S / (time.perf_counter() - begin)))

    def run():
        begin = time.perf_counter()
        for _ in range(times):
            call()
        return (time.perf_counter() - begin) / times

    return run


# --- Turns ----------------------------------------------------------------------------------------------------------


def is_there(engine):
    modules = ("onnxruntime", "onnx", "onnxscript") if engine.startswith("ort") else ("torch",)
    return all(importlib.util.find_spec(module) for module in modules)


class Stand:
    """Slices of a workload. What it needs is kept until another group of workloads is asked for: products are one."""

    def __init__(self, engine_names, threads):
        self.engine_names, self.threads = engine_names, threads
        self.group, self.calls = None, {}

    def slice(self, workload, engine, seconds):
        """Milliseconds of runs for so many seconds, at least one; None: there is no such engine or workload."""
        known = workload in STEPS or workload in {f"gemm {m}x{k}x{n}" for m, k, n in GEMMS}
        if engine not in self.engine_names or not known:
            return None
        group = workload.partition(" ")[0]
        if group != self.group:
            self.group, self.calls = group, {}
            gc.collect()
        if workload not in self.calls:
            note = lambda text: print(f"{workload}: {text}", file=sys.stderr, flush=True)  # noqa: E731
            if group == "gemm":
                shape = map(int, workload.partition(" ")[2].split("x"))
                self.calls[workload] = gemm_calls(*shape, self.engine_names, self.threads, note)
            else:
                self.calls[workload] = step_calls(workload, self.engine_names, self.threads, note)
        call = self.calls[workload][engine]
        time.sleep(SETTLE_S)
        call()
        samples, end = [], time.perf_counter() + seconds
        while not samples or time.perf_counter() < end:
            samples.append(float(np.sum(call())) * 1e3)
        return samples


def serve(engine_names, threads):
    """Answers each line of input, {"workload": .., "engine": .., "seconds": ..}, with a line of output."""
    answers, sys.stdout = sys.stdout, sys.stderr  # what else is printed is no answer
    engines = [e for e in engine_names if is_there(e)]
    say = lambda answer: print(json.dumps(answer), file=answers, flush=True)  # noqa: E731
    say({"engines": engines, "absent": [e for e in engine_names if e not in engines], "threads": threads,
         "torch": torch.__version__})  # fmt: skip
    stand = Stand(engines, threads)
    for line in sys.stdin:
        request = json.loads(line)
        with torch.inference_mode():
            times = stand.slice(request["workload"], request["engine"], request["seconds"])
        say({"absent": "no such workload"} if times is None else {"times_ms": times})


# --- Output ---------------------------------------------------------------------------------------------------------


def cores():
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def cpu_name():
    with contextlib.suppress(OSError):
        for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def table(rows):
    head = ("workload", "engine", "stage", "median ms", "p99 ms", "runs", "GMAC/s")
    cells = [
        (r["workload"], r["engine"], r["stage"], f"{r['median_ms']:.3f}", f"{r['p99_ms']:.3f}", str(r["runs"]),
         f"{r['gmac_per_s']:.0f}" if "gmac_per_s" in r else "")
        for r in rows
    ]  # fmt: skip
    if not any(c[-1] for c in cells):
        head, cells = head[:-1], [c[:-1] for c in cells]
    widths = [max(len(c[i]) for c in (head, *cells)) for i in range(len(head))]
    left = 3  # columns of text
    line = lambda c: "| " + " | ".join(  # noqa: E731
        v.ljust(w) if i < left else v.rjust(w) for i, (v, w) in enumerate(zip(c, widths))
    ) + " |"
    rule = "|" + "|".join("-" * (w + 1) + ("-" if i < left else ":") for i, w in enumerate(widths)) + "|"
    return "\n".join([line(head), rule, *map(line, cells)])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workloads", nargs="+", choices=WORKLOADS, default=WORKLOADS, metavar="NAME",
                        help=", ".join(WORKLOADS))
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=ENGINES, metavar="NAME",
                        help=", ".join(ENGINES))
    parser.add_argument("--threads", type=int, default=cores(), help="default: all (%(default)s)")
    parser.add_argument("--seconds", type=float, default=15.0,
                        help="of timing each workload, all its engines together (default %(default)s)")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="the rows, for a table with other programs'")
    parser.add_argument("--serve", action="store_true",
                        help="measure slices as lines of input ask for them, until the input ends; engines that are not "
                        "installed are left out")
    args = parser.parse_args()
    if args.threads < 1:
        parser.error(f"--threads {args.threads}: at least 1")
    if args.serve:
        needed("scipy")
        torch.set_num_threads(args.threads)
        with contextlib.suppress(KeyboardInterrupt):  # who asks has been interrupted too, and says so
            serve(args.engines, args.threads)
        return
    if any(e.startswith("ort") for e in args.engines):
        for module in ("onnxruntime", "onnx", "onnxscript"):
            needed(module)
    if any(w in STEPS for w in args.workloads):
        needed("scipy")
    torch.set_num_threads(args.threads)
    print(f"{cpu_name()}, {args.threads} thread(s), torch {torch.__version__}", flush=True)
    with contextlib.suppress(OSError, AttributeError):
        load = os.getloadavg()[0]
        if load > BUSY and args.threads > 1:
            print(f"other programs are running (load {load:.1f}): PyTorch's threads wait for one another, often for "
                  "longer than they work; give --threads fewer, or measure on an idle machine", flush=True)
    rows = []
    for workload in args.workloads:
        note = lambda text: print(f"{workload}: {text}", flush=True)  # noqa: E731
        with torch.inference_mode():
            if workload == "gemm":
                rows += bench_gemms(args.engines, args.threads, args.seconds, note)
            else:
                rows += bench_steps(workload, args.engines, args.threads, args.seconds, note)
        gc.collect()
    print(table(rows))
    if args.json:
        report = {"machine": cpu_name(), "threads": args.threads, "rows": rows}
        args.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
