"""Makes the committed models from nothing: scenes, training, packed files. Run it again, and it goes on where it stopped.

    python -m rigidformer_lab.recipe --assets KUBASIC --work work

KUBASIC holds the KuBasic shapes of Kubric's public assets (README.md). Scenes take hours on two cores, each model as
long as --minutes says. The packed files are made by `rigidformer pack`, which has to be on the PATH.
"""

from __future__ import annotations

import argparse
import os
import pathlib
import subprocess
import sys

MOVI = ("movi-a", "movi-b", "movi-sphere")
#: Bodies unlike MOVi's: masses and frictions from wide ranges.
VARIED = ("--seeds", "300", "--first-seed", "1201", "--frames", "210", "--mass-factor", "0.1", "10", "--friction", "0", "1")
#: (cubes, seeds); the tests are seeds from 1001 on.
WRECKING = ((27, 200), (64, 60))
#: Of both models; repeated steps weigh more.
STEPS = ("1", "2", "3", "5", "7", "10", "10")
#: Half of what is learned is better on validation scenes: impulses are right where the data's engine is not (docs/ACCURACY.md).
HEAD_SCALE = "0.5"
TRAINING = ("--rigid", "--horizon", "3", "--slots", "192", "--steps", *STEPS)
#: Layers that `pack` narrows to int8 beside those that it takes, and the learning rate.
MODELS = {"edge": ((), "1.5e-3"), "nano": (("encoder.point.0", "anchors.head.1"), "2e-3"), "edge-paper-inputs": ((), "1.5e-3")}


def module(name, *arguments):
    return [sys.executable, "-m", f"rigidformer_lab.{name}", *map(str, arguments)]


def scenes(assets, data):
    """(file, command) of each scene file."""
    for name in MOVI:
        path = data / f"{name}.safetensors"
        yield path, module("movi", name, "--assets", assets, "--out", path)
    for name in MOVI:
        path = data / f"{name}-varied.safetensors"
        yield path, module("movi", name, "--assets", assets, *VARIED, "--out", path)
    path = data / "contacts.safetensors"
    yield path, module("contacts", "--seeds", "1000", "--out", path)
    path = data / "thrown.safetensors"
    yield path, module("contacts", "--kinds", "toss", "--seeds", "500", "--first-seed", "2001", "--out", path)
    for cubes, seeds in WRECKING:
        path = data / f"wrecking-{cubes}.safetensors"
        yield path, module("wrecking", "--cubes", cubes, "--seeds", seeds, "--frames", "140", "--out", path)


def alone(**more):
    """The environment of a child that runs this very package: Python looks in the current folder first, which nobody named."""
    package = str(pathlib.Path(__file__).resolve().parents[1])
    paths = [package, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return os.environ | {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(paths)} | more


def run(command):
    print("+", *command, file=sys.stderr, flush=True)
    subprocess.run(command, check=True, env=alone())


def finish(name, work, start):
    """Exports a trained model and packs it."""
    narrow, _ = MODELS[name]
    exported, wide, packed = (work / f"{name}{end}" for end in (".safetensors", ".rfm", "-i8.rfm"))
    scale = () if name == "edge-paper-inputs" else ("--head-scale", HEAD_SCALE)
    run(module("export", work / name / "checkpoint.pt", "--out", exported, *scale))
    run(["rigidformer", "pack", exported, "--out", wide])
    options = [option for layer in narrow for option in ("--narrow", layer)]
    run(["rigidformer", "pack", wide, "--dtype", "i8", *options, "--out", packed])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--assets", required=True, type=pathlib.Path, help="folder of the KuBasic shapes")
    parser.add_argument("--work", required=True, type=pathlib.Path, help="folder of scenes, checkpoints and models")
    parser.add_argument("--models", nargs="+", default=["edge", "nano"], choices=MODELS,
                        help="default: edge nano; edge-paper-inputs is the paper's plain variant of edge")  # fmt: skip
    parser.add_argument("--minutes", type=float, default=75, help="training time of each model (default 75)")
    parser.add_argument("--start", type=pathlib.Path, metavar="FOLDER",
                        help="packed f32 models to start from, MODEL.rfm each (default: random weights)")  # fmt: skip
    parser.add_argument("--together", action="store_true", help="train the models at the same time, one thread each")
    args = parser.parse_args()
    data = args.work / "data"
    data.mkdir(parents=True, exist_ok=True)
    files = []
    for path, command in scenes(args.assets, data):
        if not path.exists():
            run(command)
        files.append(path)
    trainings = []
    for name in args.models:
        command = module("train", "--preset", name, "--data", *files, "--run", args.work / name, "--minutes", args.minutes,
                         "--lr", MODELS[name][1], *TRAINING)  # fmt: skip
        if args.start:
            command += ["--start-from", str(args.start / f"{name}.rfm")]
        if args.together:
            command += ["--threads", "1"]
        trainings.append(command)
    if args.together:
        print(*(" ".join(("+", *command)) for command in trainings), sep="\n", file=sys.stderr, flush=True)
        # Threads of OpenMP that wait for each other on a shared core spin: a training takes ten times as long then.
        running = [subprocess.Popen(command, env=alone(OMP_NUM_THREADS="1")) for command in trainings]
        if any([process.wait() for process in running]):
            raise SystemExit("a training failed; see above, and run the same command again")
    else:
        for command in trainings:
            run(command)
    for name in args.models:
        finish(name, args.work, args.start)


if __name__ == "__main__":
    main()
