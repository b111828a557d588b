"""Writes a trained model as safetensors, for `rigidformer pack`.

    python -m rigidformer_lab.export runs/edge/checkpoint.pt --out edge.safetensors
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib

import torch
from safetensors import safe_open
from safetensors.numpy import save_file

from .config import ModelConfig
from .packed import read_provenance, read_weights

SPLITS = (0, 3)
#: Arguments that say nothing about what was learnt.
SILENT = ("run", "minutes", "updates", "threads", "checkpoint_minutes", "validate_minutes")


def described(paths) -> str:
    """The scene files that a run learns from, with seeds and splits."""
    parts = []
    for path in paths:
        with safe_open(path, "numpy") as file:
            seeds, splits = file.get_tensor("scene_seed"), file.get_tensor("scene_split")
        seeds = seeds[[split in SPLITS for split in splits]]
        text = f"seeds {seeds.min()}-{seeds.max()}, {len(seeds)} scenes" if len(seeds) else "no scenes"
        parts.append(f"{pathlib.Path(path).stem} ({text})")
    return ", ".join(parts) + "; splits train and extra"


def changed(before, after) -> str:
    """What two runs' arguments do not agree on, `before` as a checkpoint has them."""
    before, after = {"processes": 1, **before}, json.loads(json.dumps(after, default=str))

    def plain(arguments, key):
        value = arguments.get(key)
        if key == "data":
            return " ".join(pathlib.Path(path).stem for path in value or [])
        return pathlib.Path(value).name if value and key in ("start_from", "teacher") else value

    keys = sorted(key for key in after if key not in SILENT and before.get(key) != after[key])
    return ", ".join(f"{key} {plain(after, key)} instead of {plain(before, key)}" for key in keys)


def horizon_text(horizon) -> str:
    """Closed-loop predictions a window, as a number or as (number, until which share of the time)."""
    if isinstance(horizon, int):
        return str(horizon)
    return ", then ".join(f"{number}" if until == 1 else f"{number} until {until:g} of the time" for number, until in horizon)


def run_line(saved) -> str:
    """One run of the trainer, from its checkpoint."""
    arguments = saved["arguments"]
    data = saved.get("data") or ", ".join(pathlib.Path(p).stem for p in arguments["data"]) + "; splits train and extra"
    processes = arguments.get("processes", 1)
    together = f" in each of {processes} processes" if processes > 1 else ""
    loops, late = "single steps", []  # of `train_steps`
    if "horizon" in arguments:
        loops = f"horizon {horizon_text(arguments['horizon'])}"
        late = [f"late frames {'yes' if arguments.get('late') else 'no'}, masked {arguments.get('masked', 0):g}"]
    parts = [
        data,
        f"{saved['spent'] / 60:.1f} min, {saved['updates']} updates, {saved['seen']} windows",
        f"learning rate {arguments['lr']:g} to {arguments['lr'] / 100:g}",
        "step codes " + " ".join(map(str, arguments["steps"])),
        f"{loops}, {arguments['points']} points a unit, about {arguments['slots']} units a batch{together}",
        *late,
        f"seed {arguments['seed']}",
    ]
    if arguments.get("join"):
        parts.append("parts held together at pivots in the loop")
    if arguments.get("start_from"):
        parts.append(f"from {pathlib.Path(arguments['start_from']).name}")
    return "; ".join(parts + saved.get("resumed", []))


def runs_of(path) -> list[str]:
    """Every run behind a checkpoint or packed model, one line each."""
    if pathlib.Path(path).suffix != ".rfm":
        saved = torch.load(path, map_location="cpu", weights_only=False)
        return saved.get("runs", []) + [run_line(saved)]
    provenance = read_provenance(path)
    runs = []
    while line := provenance.get(f"run {len(runs) + 1}"):
        runs.append(line)
    older = [provenance[key] for key in ("data", "trained") if key in provenance]  # from before runs were kept
    if "steps" in provenance:
        older.append(f"step codes {provenance['steps']}")
    return runs or ["; ".join(older) or "not known"]


def write_model(path, config: ModelConfig, weights, provenance, metrics):
    """All tensors f32 under their PyTorch names, with what the packed file must know."""
    tensors = {k: v.detach().cpu().float().contiguous().numpy() for k, v in weights.items()}
    metadata = {
        "format": "rigidformer-model",
        "config": config.to_json(),
        "provenance": json.dumps(provenance),
        "metrics": json.dumps(metrics),
    }
    temporary = pathlib.Path(path).with_suffix(".tmp")
    save_file(tensors, temporary, metadata)
    os.replace(temporary, path)


def scale_head(weights, scale: float):
    """Multiplies the last layer of the anchors' head, in place: what the network adds to the motion."""
    last = max(name for name in weights if name.startswith("anchors.head.") and name.endswith(".weight"))
    for name in (last, last.replace(".weight", ".bias")):
        if name in weights:
            weights[name] = weights[name] * scale


def blend(weights, start, share: float):
    """Weights between those of a model that a run started from and the run's, in place: what was learnt on few scenes goes too far."""
    for name, value in weights.items():
        if value.is_floating_point():
            weights[name] = start[name] + share * (value.cpu() - start[name])


def measured(evaluation) -> dict[str, float]:
    """The errors of one `rigidformer evaluate --json`, named as packed files name them."""
    metrics = {}
    for row in evaluation["model"]["steps"]:
        if bonds := row["figures"].get("bonds"):
            metrics[f"{evaluation['dataset']}.{evaluation['split']}.step{row['step']}.broken_f1"] = round(bonds["f1"], 4)
        for frame in row["figures"]["frames"]:
            key = f"{evaluation['dataset']}.{evaluation['split']}.step{row['step']}.frame{frame['frame']}"
            if "vertex_m" in frame:
                metrics[f"{key}.vertex_m"] = round(frame["vertex_m"], 5)
                continue
            metrics[f"{key}.position_rmse_m"] = round(frame["position_m"], 5)
            metrics[f"{key}.orientation_rmse_deg"] = round(frame["orientation_rms_deg"], 4)
    return metrics


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--metrics", type=pathlib.Path, nargs="+", default=[],
                        help="outputs of `rigidformer evaluate --json`, whose errors to keep with the model")
    parser.add_argument("--head-scale", type=float, default=1.0, metavar="X",
                        help="what the head's last layer, and so every correction, is multiplied by (default 1)")  # fmt: skip
    parser.add_argument("--blend", type=pathlib.Path, metavar="FILE",
                        help="packed f32 model that the run started from: the weights are between its and the run's")
    parser.add_argument("--share", type=float, default=0.5, metavar="X", help="with --blend: of the way from FILE to the run (default 0.5)")
    args = parser.parse_args()
    if not 0 <= args.share <= 1:
        parser.error("--share takes a number from 0 to 1")
    if not 0 <= args.head_scale <= 2:
        parser.error("--head-scale takes a number from 0 to 2")
    saved = torch.load(args.checkpoint, map_location="cpu", weights_only=False)
    config = ModelConfig.from_json(saved["config"])
    arguments = saved["arguments"]
    runs = saved.get("runs", []) + [run_line(saved)]
    last = f"run {len(runs)}: " if len(runs) > 1 else ""
    provenance = {
        "paper": "RigidFormer, arXiv 2605.09196",
        "data": last + ", ".join(pathlib.Path(p).stem for p in arguments["data"]) + "; splits train and extra",
        "shapes": "KuBasic (CC BY-SA 4.0) for MOVi; the lab's own primitives",
        "trained": f"{last}{saved['spent'] / 60:.1f} min, {saved['updates']} updates, {saved['seen']} windows",
        "steps": last + " ".join(map(str, arguments["steps"])),
        "licence": "MIT OR Apache-2.0",
    } | {f"run {number}": line for number, line in enumerate(runs, 1)}
    if args.blend:
        start = read_weights(args.blend)
        if {k: v.shape for k, v in start.items()} != {k: v.shape for k, v in saved["average"].items()}:
            parser.error(f"--blend {args.blend}: has other tensors than the run; give the model of its --start-from")
        provenance["blend"] = f"{args.share:g} of the way from {args.blend.name}"
        blend(saved["average"], start, args.share)
    if args.head_scale != 1:
        provenance["head"] = f"last layer times {args.head_scale:g}"
        scale_head(saved["average"], args.head_scale)
    metrics = {}
    for path in args.metrics:
        metrics |= measured(json.loads(path.read_text()))
    write_model(args.out, config, saved["average"], provenance, metrics)


if __name__ == "__main__":
    main()
