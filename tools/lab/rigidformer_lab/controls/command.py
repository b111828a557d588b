"""The command line of `python -m rigidformer_lab.controls`."""

from __future__ import annotations

import argparse
import json
import math
import re
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..scenes import TEST, SceneFileError, read_scenes
from . import camera as cameras, tracking
from .errors import Failure, Usage
from .looks import shape_of
from .motion import Motion, record
from .tracking import Palette

#: The camera is fitted to no more instants of the motion than this, which bounds memory and time.
MOST_INSTANTS = 512
#: Whatever is farther from the origin counts as a mistake, metres.
FARTHEST_M = 1e6
#: A time that misses the end by less is within the motion, seconds.
ROUNDING_S = 1e-6
#: Frames between two predictions: usually, and with soft units or bonds.
STEP, SOFT_STEP = 10, 5
MOST_PIXELS = 4096
#: The scene that comes with the program.
DEFAULT_SCENE = Path(__file__).resolve().parents[4] / "tools/cli/scenes/default.safetensors"
PROGRAM = "python -m rigidformer_lab.controls"

DESCRIPTION = """\
Writes what drives rendering by Diffusion as Shader, which reads 49 frames of 720 x 480 pixels (docs/CONTROLS.md):
  --out FILE.mp4        the tracking video: points in colours that say where they were in the first frame, before black
  --rendered FILE.mp4   the shaded units and planes, from the same camera
  --png DIR             the frames of both as PNG, bit for bit; DIR must not exist or be empty"""
EXAMPLES = """\
The colour of a point is that of its place in the first frame. Red goes from the left to the right edge, green from the upper to the lower
one. Blue goes from the farthest to the nearest points, by inverse depth between the 2nd and the 98th percentile of the points in the
picture; it is 128 where both are equal. A point that begins beside the picture has the colour of the nearest edge.

The frames are spread evenly over the motion. Poses between two predictions are interpolated. --fps says how fast the file plays. The camera
looks from --azimuth and --elevation at the whole motion, as near as shows all of it, or from --eye to --look-at.

H.264 at 4:2:0 shares chroma among four pixels, which blurs squares of 2 pixels. --exact keeps every bit (RGB, profile High 4:4:4
Predictive). FFmpeg and what is built on it read that; browsers and phones mostly do not.

Predictions need the package rigidformer (`python -m pip install ./bindings/python` in the repository's root); --recorded does not.

examples:
  python -m rigidformer_lab.controls
  python -m rigidformer_lab.controls --mesh --rendered rendered.mp4
  python -m rigidformer_lab.controls movi-b.safetensors --index 71 --step 5 --mesh --exact --out b72.mp4
  python -m rigidformer_lab.controls movi-a.safetensors --recorded --seconds 0.5 --azimuth 30 --elevation 20
  python -m rigidformer_lab.controls rollout/predicted.safetensors --recorded --mesh
  python -m rigidformer_lab.controls --eye 3,-3,2 --look-at 0,0,0.5 --view 50 --size 960x540 --fps 24 --frames 121 --png frames --json"""


def number(low: float, high: float, kind=float):
    """A type of argparse: a number within bounds."""

    def parse(text: str):
        try:
            value = kind(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"{text!r} is not a{' whole' if kind is int else ''} number") from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text} is not from {low:g} to {high:g}")
        return value

    return parse


def size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    sides = tuple(map(int, match.groups())) if match else ()
    if not match or not all(16 <= side <= MOST_PIXELS for side in sides):
        raise argparse.ArgumentTypeError(f"{text!r} is not WxH with sides of 16 to {MOST_PIXELS} pixels, such as 720x480")
    if any(side % 2 for side in sides):
        width, height = (side + side % 2 for side in sides)
        raise argparse.ArgumentTypeError(f"{text} has an odd side, which H.264 at 4:2:0 does not take; give {width}x{height}")
    return sides


def place(text: str) -> tuple[float, ...]:
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not three numbers with commas between, such as 3,-3,2")
    return tuple(number(-1e6, 1e6)(part) for part in parts)


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(
        prog=PROGRAM, description=DESCRIPTION, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = made.add_argument
    add("scene", nargs="?", type=Path, help="scene file (default: the scene that comes with the program)")
    add("--index", type=number(0, 2**31, int), metavar="I",
        help="which scene of the file, from 0 (default: its first of the test split, else its first)")
    add("--model", type=Path, metavar="FILE", help="packed model (default: the one that comes with the package rigidformer)")
    add("--step", type=number(1, 10**6, int), metavar="S",
        help=f"frames of the record between two predictions; frames 0 and S are observed (default {STEP}; {SOFT_STEP} with soft "
             "units or bonds)")
    add("--join", action="store_true", help="hold the parts of each body together at pivots that are found from frames 0 to S (to 10 where "
        "the file has velocities)")
    add("--recorded", action="store_true", help="show the recorded motion instead of the predicted one")
    add("--mesh", action="store_true", help="surfaces instead of points: hulls of points or convex pieces, each of whose places has its colour")
    add("--side", type=number(1, 64, int), default=2, metavar="N", help="pixels a side of a point's square (default 2)")
    add("--frames", type=number(1, 100_000, int), default=49, metavar="N", help="frames of the video (default 49)")
    add("--fps", type=number(0.1, 240), default=8.0, metavar="HZ", help="frames a second that the video plays with (default 8)")
    add("--seconds", type=number(0.01, 1000), metavar="S",
        help="seconds of the motion, from its first frame on, that the video shows (default: all that is predicted, or recorded)")
    add("--size", type=size, default=(720, 480), metavar="WxH", help="columns and rows of the videos, even (default 720x480)")
    add("--azimuth", type=number(-360, 360), metavar="DEG",
        help="where the camera stands about the middle of the motion: degrees from x towards y (default -60)")
    add("--elevation", type=number(-89, 89), metavar="DEG", help="how far the camera looks down, degrees (default 35)")
    add("--view", type=number(1, 150), default=60.0, metavar="DEG", help="angle of view along the longer side, degrees (default 60)")
    add("--eye", type=place, metavar="X,Y,Z", help="where the camera stands, metres")
    add("--look-at", type=place, metavar="X,Y,Z", help="where that camera looks, metres (default: the middle of the motion)")
    add("--exact", action="store_true", help="keep every bit of colours: RGB, 4:4:4")
    add("--out", type=Path, default=Path("tracking.mp4"), metavar="FILE.mp4", help="the tracking video (default tracking.mp4)")
    add("--rendered", type=Path, metavar="FILE.mp4", help="also the shaded units from the same camera")
    add("--png", type=Path, metavar="DIR", help="also the frames as PNG, in a new folder")
    add("--json", action="store_true", help="print one JSON document instead of lines")
    return made  # fmt: skip


def options_of(arguments: list[str]) -> argparse.Namespace:
    """The options. A number below 0 may stand apart from its option."""
    joined, numbers = [], ("--eye", "--look-at", "--azimuth", "--elevation")
    for argument in arguments:
        if joined and joined[-1] in numbers and re.match(r"-[\d.]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    made = parser()
    options = made.parse_args(joined)
    for first, second in (("recorded", "join"), ("recorded", "model"), ("recorded", "step"), ("eye", "azimuth"), ("eye", "elevation")):
        if getattr(options, first) and getattr(options, second) not in (None, False):
            made.error(f"--{second} does not go with --{first}; leave one of them out")
    if options.look_at and not options.eye:
        made.error("--look-at goes with --eye; give both")
    for option, text in (("--out", options.out), ("--rendered", options.rendered)):
        given = [argument for argument in joined if argument.startswith(str(text)) and argument.endswith("/")] if text else []
        if given:
            made.error(f"{option} {given[0]}: ends like a folder; name a file")
    return options


def times(span_s: float, frames: int) -> np.ndarray:
    """Evenly spaced, the first at 0 and the last at the end."""
    return span_s * np.arange(frames) / max(frames - 1, 1)


def moving(options, scenes, index, source: Path, own) -> tuple[Motion, str]:
    """The motion to show, and what it is."""
    if options.recorded:
        return Motion(own.poses, own.soft_points, own.rate_hz), "recorded"
    from .predict import predicted

    quick = scenes.unit_soft is not None and scenes.unit_soft.any() or scenes.bonds is not None and len(scenes.bonds)
    step = options.step or (SOFT_STEP if quick else STEP)
    return predicted(source, index, own, options.model, step, options.join)


def span_of(options, motion: Motion, name: str) -> float:
    """Seconds of the motion that the video shows."""
    most_s = motion.duration_s
    wanted_s = most_s if options.seconds is None else options.seconds
    if wanted_s > most_s + ROUNDING_S:
        what = "recorded" if options.recorded else "predicted"
        raise Usage(f"--seconds {wanted_s:g}: {most_s:.3f} s of {name} are {what}; give less, or leave --seconds out")
    return min(wanted_s, most_s)


def whole_motion(options, motion: Motion, shape, name: str, at: np.ndarray) -> np.ndarray:
    """Everywhere that vertices are at these times, (N, 3)."""
    points = np.concatenate([shape.placed(*motion.at(time_s)).astype(np.float32) for time_s in at])
    if not len(points):
        raise Failure(f"{name}: has no point to track; give another scene")
    if not (np.abs(points) <= FARTHEST_M).all():
        what, remedy = ("record", "give another scene with --index") if options.recorded else (
            "prediction", "give a smaller --step, or --recorded")  # fmt: skip
        raise Failure(f"{name}: the {what} has points that are no numbers or more than {FARTHEST_M:.0f} m away; {remedy}")
    return points


def camera_of(options, points: np.ndarray) -> cameras.Camera:
    view = math.radians(options.view)
    if options.eye is None:
        azimuth, elevation = (usual if given is None else given for given, usual in ((options.azimuth, -60), (options.elevation, 35)))
        return cameras.fit(points, math.radians(azimuth), math.radians(elevation), options.size, view)
    target = cameras.middle(points) if options.look_at is None else np.array(options.look_at)
    found = cameras.between(np.array(options.eye), target, options.size, view)
    if found is None:
        raise Usage("--eye and --look-at: the camera stands where it looks; give two places")
    return found


def unseen(points: np.ndarray) -> Usage:
    x, y, z = cameras.middle(points)
    return Usage(
        f"the camera sees no unit in any frame; look at the middle of the motion with --look-at {x:.2f},{y:.2f},{z:.2f}, or leave --eye out"
    )


def run(options: argparse.Namespace):
    try:
        from .files import Files, check
    except ImportError as error:
        raise Failure(f"videos need PyAV ({error}); run `python -m pip install av`") from error
    source = options.scene or DEFAULT_SCENE
    check([("--out", options.out), ("--rendered", options.rendered), ("--png", options.png)],
          [path for path in (source, options.model) if path])  # fmt: skip
    scenes = read_scenes(source)
    index = options.index if options.index is not None else int(next(iter(scenes.scenes_of_split(TEST)), 0))
    if index >= scenes.scenes:
        raise Failure(f"--index {index}: scene {index} of {scenes.scenes}; give a number below {scenes.scenes}")
    own = record(scenes, index)
    motion, poses_are = moving(options, scenes, index, source, own)
    span_s = span_of(options, motion, own.name)
    shape = shape_of(own, options.mesh)
    everywhere = whole_motion(options, motion, shape, own.name, times(span_s, min(options.frames, MOST_INSTANTS)))
    camera = camera_of(options, everywhere)
    first = camera.seen(shape.placed(*motion.at(0.0)))
    palette = Palette(camera, first)
    beside = int((~palette.shows(first)).sum())
    # Of surfaces, and of more instants than these, only pictures tell.
    if not options.mesh and options.frames <= MOST_INSTANTS and not palette.shows(camera.seen(everywhere)).any():
        raise unseen(everywhere)
    stage = None
    if options.rendered:
        from .stage import Stage

        stage = Stage(own, camera, float(np.linalg.norm(camera.eye - cameras.middle(everywhere))))
    rate = Fraction(round(options.fps * 1000), 1000)
    used = []
    with Files(options.out, options.rendered, options.png, options.size, rate, options.exact) as files:
        at = tqdm(times(span_s, options.frames), own.name, leave=False, disable=None, unit="frame")
        for count, time_s in enumerate(at):
            poses, soft = motion.at(time_s)
            placed = shape.placed(poses, soft)
            pixels, is_used = tracking.frame(palette, shape, camera.seen(placed), first, shape.lift_m(placed), options.side)
            files.push(count, pixels, stage and stage.pixels(poses, soft))
            used.append(is_used)
        if not any(used):
            raise unseen(everywhere)
        videos = list(files.videos)
        files.finish()
    sizes = [video.bytes for video in videos]
    made = {
        "scene": own.name,
        "poses": poses_are,
        "frames": options.frames,
        "rate_hz": float(rate),
        "size": options.size,
        "span_s": span_s,
        "camera": {
            "pose": pose_of(camera),
            "focal_px": [camera.focal, camera.focal],
            "centre_px": [(side - 1) / 2 for side in options.size],
        },
        "tracked": "surfaces" if options.mesh else "points",
        "points": len(first),
        "points_beside_the_first_picture": beside,
        "inverse_depth_per_m": palette.inverse_m.tolist(),
        "exact": options.exact,
        "out": str(options.out),
        "bytes": sizes[0],
        "rendered": options.rendered and str(options.rendered),
        "rendered_bytes": sizes[1] if options.rendered else None,
        "png": options.png and str(options.png),
    }
    if options.json:
        print(json.dumps(made, indent=2))
    else:
        tell(made, len(own.role), sum(map(len, own.points)))
    if not used[0]:
        note("nothing is in the picture in the first frame, so colours say little; move the camera, or leave --eye out")
    elif beside:
        note(f"{beside} of {len(first)} points begin beside the picture and have the colours of its edges")
    if shape.flat:
        note(f"units {', '.join(map(str, shape.flat))} have no surface, and are drawn as their points")


def pose_of(camera: cameras.Camera) -> list[float]:
    """x, y, z of a camera and its quaternion, w first."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(camera.axes.T).as_quat(canonical=True)
    return [*camera.eye.tolist(), float(w), float(x), float(y), float(z)]


def tell(made: dict, units: int, points: int):
    width, height = made["size"]
    print(f"scene {made['scene']}: {units} units, {points} points; {made['poses']}")
    print(f"{made['frames']} frames of {width} x {height} pixels over {made['span_s']:.3f} s of the motion; at {made['rate_hz']:g} frames a "
          f"second they play {made['frames'] / made['rate_hz']:.2f} s")  # fmt: skip
    x, y, z = made["camera"]["pose"][:3]
    far, near = made["inverse_depth_per_m"]
    blue = f"blue is 0 at {1 / far:.2f} m and 255 at {1 / near:.2f} m" if near > far else "blue is 128 throughout: all points are equally far"
    print(f"camera at {x:.2f}, {y:.2f}, {z:.2f} m, focal length {made['camera']['focal_px'][0]:.1f} pixels; {blue}")
    for path, count in ((made["out"], made["bytes"]), (made["rendered"], made["rendered_bytes"])):
        if path:
            print(f"wrote {path}, {count / 1e6:.1f} MB")
    if made["png"]:
        print(f"wrote {made['png']}")


def note(text: str):
    print(f"note: {text}", file=sys.stderr)


def main(arguments: list[str] | None = None) -> int:
    try:
        run(options_of(sys.argv[1:] if arguments is None else arguments))
    except (Usage, Failure, SceneFileError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2 if isinstance(error, Usage) else 1
    except KeyboardInterrupt:
        note("interrupted; nothing was written")
        return 130
    return 0
