"""Writes a trained model as safetensors, for `rigidformer pack`.

    python -m rigidformer_lab.export runs/edge/checkpoint.pt --out edge.safetensors
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib

import torch
from safetensors.numpy import save_file

from .config import ModelConfig


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


def measured(evaluation) -> dict[str, float]:
    """The errors of one `rigidformer evaluate --json`, named as packed files name them."""
    metrics = {}
    for row in evaluation["model"]["steps"]:
        for frame in row["figures"]["frames"]:
            key = f"{evaluation['dataset']}.{evaluation['split']}.step{row['step']}.frame{frame['frame']}"
            metrics[f"{key}.position_rmse_m"] = round(frame["position_m"], 5)
            metrics[f"{key}.orientation_rmse_deg"] = round(frame["orientation_rms_deg"], 4)
    return metrics


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--metrics", type=pathlib.Path, nargs="+", default=[],
                        help="outputs of `rigidformer evaluate --json`, whose errors to keep with the model")
    args = parser.parse_args()
    saved = torch.load(args.checkpoint, map_location="cpu", weights_only=False)
    config = ModelConfig.from_json(saved["config"])
    arguments = saved["arguments"]
    provenance = {
        "paper": "RigidFormer, arXiv 2605.09196",
        "data": ", ".join(pathlib.Path(p).stem for p in arguments["data"]) + "; splits train and extra",
        "shapes": "KuBasic (CC BY-SA 4.0) for MOVi; the lab's own primitives",
        "trained": f"{saved['spent'] / 60:.1f} min, {saved['updates']} updates, {saved['seen']} windows",
        "steps": " ".join(map(str, arguments["steps"])),
        "licence": "MIT OR Apache-2.0",
    }
    metrics = {}
    for path in args.metrics:
        metrics |= measured(json.loads(path.read_text()))
    write_model(args.out, config, saved["average"], provenance, metrics)


if __name__ == "__main__":
    main()
