"""A small MeshGraphNets to measure models of soft bodies against: the same scenes, the same windows, the same time.

    python -m rigidformer_lab.research.mesh_network --preset shell --data shell.safetensors --run runs/mesh-shell --minutes 60
    python -m rigidformer_lab.research.mesh_network --preset shell --run runs/mesh-shell --test shell-test.safetensors

After Pfaff et al. 2021: nodes are the masses of a body, edges those of the scene's own mesh, both ways; an encoder, message passing
with residuals, a decoder that gives accelerations, and Verlet integration with s frames a step. What stands around is told to each
node as the way to the nearest surface, of spheres and planes alike. It is given the mesh, which the project's model is not.
"""

from __future__ import annotations

import argparse
import json
import math
import pathlib
import sys
import time

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from ..config import PRESETS
from ..soft_data import records
from ..train import BETA_M_S, positive, save
from ..train_soft import EARLY, LAST_START

WIDTH, PASSES, REACH_M = 64, 6, 0.2


def network(inputs, outputs, norm=True):
    layers = [nn.Linear(inputs, WIDTH), nn.SiLU(), nn.Linear(WIDTH, WIDTH), nn.SiLU(), nn.Linear(WIDTH, outputs)]
    return nn.Sequential(*layers, *([nn.LayerNorm(outputs)] if norm else []))


class MeshNetwork(nn.Module):
    def __init__(self):
        super().__init__()
        self.node, self.edge = network(3 + 4 + 4 + 2, WIDTH), network(8, WIDTH)
        self.messages = nn.ModuleList(network(3 * WIDTH, WIDTH) for _ in range(PASSES))
        self.updates = nn.ModuleList(network(2 * WIDTH, WIDTH) for _ in range(PASSES))
        self.out = network(WIDTH, 3, norm=False)
        nn.init.zeros_(self.out[-1].weight)
        nn.init.zeros_(self.out[-1].bias)
        self.register_buffer("scale", torch.tensor(10.0))  # m/s^2

    def forward(self, graph, x, before, dt):
        """Accelerations (N, 3) of the masses of several scenes, one after another."""
        velocity = (x - before) / dt
        first, second = graph["edges"]
        rest, now = graph["rest"][second] - graph["rest"][first], x[second] - x[first]
        edge = torch.cat((rest, rest.norm(dim=-1, keepdim=True), now, now.norm(dim=-1, keepdim=True)), -1) / graph["spacing"][first]
        toward, plane = graph["around"](x)
        h = self.node(torch.cat((velocity, toward, plane, graph["material"]), -1))
        e = self.edge(edge)
        for message, update in zip(self.messages, self.updates):
            e = e + message(torch.cat((e, h[first], h[second]), -1))
            total = torch.zeros_like(h).index_add(0, second, e)
            h = h + update(torch.cat((h, total), -1))
        return self.out(h) * self.scale


def known(scenes):
    """The scenes, if a network can be told what stands around in all of them: the ground z = 0, and at most one rigid ball."""
    for r in scenes:
        if r.planes[:, :4].tolist() != [[0, 0, 1, 0]] or len(r.centre) > 1 or not r.obstacles.ball.all():
            raise SystemExit(f"{r.name}: has other planes than the ground, or other rigid units than one ball, which the network "
                             "is not told of; give scenes of rigidformer_lab.shell or .soft_cube")
    return scenes


def graph_of(scenes):
    """The masses of scenes as one graph."""
    rest, edges, material, spacing, balls, owner, start = [], [], [], [], [], [], 0
    for r in scenes:
        masses = np.unique(r.web.owner)
        index = np.full(len(r.unit), -1)
        index[masses] = np.arange(len(masses))
        own = index[r.web.owner]
        pairs = np.unique(np.sort(own[r.edges], axis=1), axis=0)
        edges.append(np.concatenate((pairs, pairs[:, ::-1])) + start)
        rest.append(r.rest[masses])
        material.append(np.stack((r.ln_young[r.unit][masses] - 11.0, r.web.friction[masses]), 1))
        spacing.append(np.full((len(masses), 1), r.web.spacing.mean()))
        ball = np.zeros((len(masses), 4), np.float32)
        if len(r.centre):
            ball[:] = [*r.centre[0, 0], r.obstacles.ball[0]]
        balls.append(ball)
        owner.append((masses, own, start))
        start += len(masses)
    t = lambda arrays: torch.from_numpy(np.concatenate(arrays).astype(np.float32))  # noqa: E731
    ball = t(balls)

    def around(x):
        away = x - ball[:, :3]
        size = away.norm(dim=-1, keepdim=True).clamp(min=1e-6)
        gap = (size - ball[:, 3:]).clamp(max=REACH_M) / REACH_M
        there = ball[:, 3:] > 0
        toward = torch.where(there, torch.cat((away / size, gap), -1), torch.tensor([0.0, 0.0, 0.0, 1.0]))
        height = x[:, 2:].clamp(max=REACH_M) / REACH_M
        return toward, torch.cat((torch.zeros_like(x), height), -1)

    return {"rest": t(rest), "edges": torch.from_numpy(np.concatenate(edges).T.copy()), "material": t(material),
            "spacing": t(spacing), "around": around, "owner": owner, "size": start}  # fmt: skip


def frames_at(scenes, graph, frames):
    return torch.from_numpy(np.concatenate([r.points[f][m] for r, f, (m, _, _) in zip(scenes, frames, graph["owner"])]))


def advance(model, graph, x, before, dt):
    return 2 * x - before + model(graph, x, before, dt) * dt**2


@torch.no_grad()
def errors(model, scenes, step, frames=(25, 50, 100)):
    """Mean distance over all points, copies of shared ones too, as `rigidformer evaluate` has it; means over scenes."""
    found = {f: [] for f in frames}
    for r in scenes:
        graph, dt = graph_of([r]), step / r.frame_rate
        before, x = frames_at([r], graph, [0]), frames_at([r], graph, [step])
        for k in range(max(frames) // step):
            x, before = advance(model, graph, x, before, dt), x
            at = (k + 1) * step
            if at in found and step + at < r.frames:
                every = x.numpy()[graph["owner"][0][1]]
                found[at].append(float(np.linalg.norm(every - r.points[step + at], axis=1).mean()))
    return {f: round(float(np.mean(e)), 5) for f, e in found.items() if e}


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given = parser.add_mutually_exclusive_group(required=True)
    given.add_argument("--data", nargs="+", type=pathlib.Path, help="scene files to learn from")
    given.add_argument("--test", type=pathlib.Path, help="measure on this file's test scenes, instead of training")
    parser.add_argument("--run", required=True, type=pathlib.Path, help="folder of the checkpoint")
    parser.add_argument("--preset", default="shell", choices=[name for name, c in PRESETS.items() if c.motion == "soft"])
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--step", type=positive, default=5, help="frames a step")
    parser.add_argument("--horizon", type=positive, default=6, help="steps a window, each learnt by itself")
    parser.add_argument("--slots", type=positive, default=4, help="scenes a batch")
    parser.add_argument("--lr", type=float, default=1e-3)
    parser.add_argument("--noise", type=float, default=0.003, help="metres, on the points of a window's first frames")
    args = parser.parse_args(arguments)
    checkpoint = args.run / "checkpoint.pt"
    for name in ("minutes", "lr"):
        if not getattr(args, name) > 0:
            parser.error(f"--{name} must be above 0")
    if not args.noise >= 0:
        parser.error("--noise must be at least 0")
    for path in [*(args.data or ()), *filter(None, (args.test,))]:
        if not path.is_file():
            parser.error(f"{path}: no such file")
    if args.test and not checkpoint.is_file():
        parser.error(f"{checkpoint}: no such file; train with --data first")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    args.run.mkdir(parents=True, exist_ok=True)
    model, rng = MeshNetwork(), np.random.default_rng(0)
    spent, updates, optimizer = 0.0, 0, torch.optim.AdamW(model.parameters(), lr=args.lr)
    if checkpoint.exists():
        saved = torch.load(checkpoint, map_location="cpu", weights_only=False)
        model.load_state_dict(saved["model"])
        optimizer.load_state_dict(saved["optimizer"])
        spent, updates = saved["spent"], saved["updates"]
    if args.test:
        scenes = known(records(PRESETS[args.preset], [args.test], [2]))
        print(json.dumps({"minutes": round(spent / 60, 1), "scenes": len(scenes), "vertex_m": errors(model, scenes, args.step)}))
        return 0
    scenes = known(records(PRESETS[args.preset], args.data, [0, 3]))
    checked = known(records(PRESETS[args.preset], args.data, [1], 24))
    short = [r.name for r in scenes if r.frames <= args.step]
    if short:
        parser.error(f"--step {args.step}: {short[0]} has no frame {args.step}")
    print(f"{sum(p.numel() for p in model.parameters())} parameters, {len(scenes)} scenes", file=sys.stderr)
    last = last_kept = time.time()
    mean = None
    while spent < args.minutes * 60:
        began = time.time()
        for group in optimizer.param_groups:
            group["lr"] = args.lr * min(1, (updates + 1) / 200) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * spent / (args.minutes * 60))))
        own = [scenes[i] for i in rng.integers(len(scenes), size=args.slots)]
        graph, dt = graph_of(own), args.step / own[0].frame_rate
        latest = [max(args.step, min(LAST_START, r.frames - 1 - args.step * args.horizon)) for r in own]
        frames = [args.step if rng.random() < EARLY else int(rng.integers(args.step, last_ + 1)) for last_ in latest]
        noise = torch.randn(graph["size"], 3) * args.noise
        before, x = frames_at(own, graph, [f - args.step for f in frames]) + noise, frames_at(own, graph, frames) + noise
        optimizer.zero_grad(set_to_none=True)
        total = 0.0
        for _ in range(args.horizon):
            frames = [min(f + args.step, r.frames - 1) for f, r in zip(frames, own)]
            after = advance(model, graph, x, before, dt)
            error = (after - frames_at(own, graph, frames)) / dt
            loss = F.smooth_l1_loss(error, torch.zeros_like(error), beta=BETA_M_S)
            (loss / args.horizon).backward()
            total += float(loss.detach()) / args.horizon
            x, before = after.detach(), x
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        if torch.isfinite(norm):
            optimizer.step()
        updates, spent = updates + 1, spent + time.time() - began
        mean = total if mean is None else mean + 0.02 * (total - mean)
        if time.time() - last > 60:
            last = time.time()
            print({"min": round(spent / 60, 2), "updates": updates, "loss": round(mean, 5)}, file=sys.stderr, flush=True)
        if time.time() - last_kept > 300:
            last_kept = time.time()
            save(checkpoint, model=model.state_dict(), optimizer=optimizer.state_dict(), spent=spent, updates=updates)
            print({"min": round(spent / 60, 2), "validation": errors(model, checked, args.step)}, file=sys.stderr, flush=True)
    save(checkpoint, model=model.state_dict(), optimizer=optimizer.state_dict(), spent=spent, updates=updates)
    print({"min": round(spent / 60, 2), "validation": errors(model, checked, args.step)}, file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
