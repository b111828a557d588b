"""`rigidformer_lab.controls`: videos that decode to the frames that were drawn, and for every mistake its text and exit code.

Needs NumPy, SciPy, safetensors, tqdm and PyAV, and no PyTorch.
"""

import importlib.util
import json
import functools
import os
import shlex
import signal
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from conftest import needed

av = needed("av")

from rigidformer_lab.controls import looks, motion, raster, tracking  # noqa: E402
from rigidformer_lab.controls.camera import Camera, between, fit  # noqa: E402
from rigidformer_lab.controls.command import main, options_of, parser, times  # noqa: E402
from rigidformer_lab.controls.files import planes, png  # noqa: E402
from rigidformer_lab.controls.tracking import Palette  # noqa: E402
from rigidformer_lab.scenes import TEST, Scenes, write_scenes  # noqa: E402

ROOT = Path(__file__).parents[3]
SOFT = str(ROOT / "tests/data/tiny-soft.scene.safetensors")
SHELL = str(ROOT / "weights/models/shell.rfm")
NANO = str(ROOT / "weights/models/nano.rfm")
UP = (0, 0, 0, 1, 0, 0, 0)  # a pose
#: Whether there can be predictions.
HAS_PACKAGE = bool(os.environ.get("RIGIDFORMER_COMPLETE")) or importlib.util.find_spec("rigidformer") is not None
#: Levels that a colour may be off that shares its chroma with its like alone: Y'CbCr has fewer levels than red, green and blue.
ROUNDING = 3


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def works(folder, capsys):
    def check(*arguments):
        code = main(list(arguments))
        said = capsys.readouterr()
        assert code == 0, said.err
        return said.out + said.err

    return check


@pytest.fixture
def document(folder, capsys):
    """What `--json` prints, beside which notes are on the other stream."""

    def check(*arguments):
        code = main([*arguments, "--json"])
        said = capsys.readouterr()
        assert code == 0, said.err
        return json.loads(said.out), said.err

    return check


@pytest.fixture
def fails(folder, capsys):
    def check(arguments, code, *parts):
        try:
            found = main(list(arguments))
        except SystemExit as error:  # of argparse
            found = error.code
        said = capsys.readouterr().err
        assert found == code, said
        for part in parts:
            assert part in said, f"{arguments}: no {part!r} in: {said}"

    return check


def save(points, poses, **more):
    """Writes `scene.safetensors`, with one unit."""
    points, poses = np.asarray(points, np.float32), np.asarray(poses, np.float32)
    write_scenes("scene.safetensors", Scenes(
        dataset="a test", shape_names=["one"], shape_points=points, shape_offsets=np.array([0, len(points)]), scene_seed=np.array([1]),
        scene_split=np.array([TEST], np.uint8), scene_units=np.array([0, 1]), unit_shape=np.zeros(1, np.int32),
        unit_scale=np.ones(1, np.float32), unit_physics=np.array([[1, 0.4, 0.3]], np.float32), unit_poses=poses[None], provenance="a test",
        licence="none", frame_rate_hz=148.0, gravity_m_s2=(0.0, 0.0, -9.81), **more,
    ))  # fmt: skip


def box(x, y, z):
    """The corners of a box, metres, whose lower face is at z = 0."""
    corners = np.array([(i & 1, i >> 1 & 1, i >> 2) for i in range(8)], float)
    return (corners - (0.5, 0.5, 0)) * (x, y, z)


def decoded(path, form="rgb24"):
    """(frames, rows, columns, 3) of a video, and its stream."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format=form) for frame in container.decode(stream)]
        return np.array(frames), stream


def picture(path):
    with av.open(str(path)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


def pictures(folder, what):
    return np.array([picture(path) for path in sorted(Path(folder).glob(f"*-{what}.png"))])


def test_exact_videos_are_the_frames_bit_for_bit(folder, works):
    (folder / "png").mkdir()  # an empty folder makes room
    # Not whole macroblocks, so the pictures are cut.
    works("--recorded", "--mesh", "--exact", "--size", "90x52", "--frames", "7", "--fps", "29.97", "--rendered", "r.mp4", "--png", "png")
    for file, what in (("tracking.mp4", "tracking"), ("r.mp4", "rendered")):
        found, stream = decoded(file)
        assert stream.codec_context.profile == "High 4:4:4 Predictive" and stream.codec_context.pix_fmt == "gbrp"
        assert (stream.frames, stream.average_rate) == (7, Fraction(2997, 100))
        assert np.array_equal(found, pictures("png", what)), what
    assert sorted(os.listdir()) == ["png", "r.mp4", "tracking.mp4"], "nothing temporary"
    assert len(os.listdir("png")) == 14
    other = folder / "other"
    other.mkdir()
    assert (folder / "png").stat().st_mode == other.stat().st_mode


def test_usual_videos_are_the_frames_but_for_shared_chroma(works):
    works("--recorded", "--mesh", "--frames", "5", "--png", "png", "--rendered", "r.mp4")
    for file, what in (("tracking.mp4", "tracking"), ("r.mp4", "rendered")):
        drawn = pictures("png", what)
        samples, stream = decoded(file, "yuv420p")
        coder = stream.codec_context
        assert (coder.width, coder.height, stream.frames, stream.average_rate) == (720, 480, 5, 8)
        assert coder.profile == "High" and coder.pix_fmt == "yuv420p"
        # BT.601 in limited range; primaries of BT.709, transfer of sRGB.
        assert (coder.colorspace, coder.color_range, coder.color_primaries, coder.color_trc) == (5, 1, 1, 13)
        off = np.abs(samples.astype(int) - np.array([planes(frame) for frame in drawn]))
        assert off.max() <= 4 and (off <= 1).mean() > 0.999, (what, off.max(), (off <= 1).mean())
        # Of colours that share their chroma with their like.
        found = decoded(file)[0].astype(int)
        blocks = drawn.reshape(5, 240, 2, 360, 2, 3).astype(int)
        alike = (np.ptp(blocks, axis=(2, 4)) <= 1).all(-1).repeat(2, 1).repeat(2, 2)
        within = np.abs(found - drawn).max(-1)[alike] <= ROUNDING
        assert within.mean() >= 0.99 and drawn.any(), (what, within.mean())


def test_the_first_frame_has_the_colours_of_places(works):
    works("--recorded", "--size", "240x160", "--frames", "2", "--mesh", "--eye", "1,-6,6", "--look-at", "-1.6,0.2,1.5", "--png", "a")
    first, last = pictures("a", "tracking")
    row, column = np.nonzero(first.any(-1))
    assert len(row) > 1000
    assert np.abs(first[row, column, 0] - 255 * (column + 0.5) / 240).max() < 1
    assert np.abs(first[row, column, 1] - 255 * (row + 0.5) / 160).max() < 1
    assert not np.array_equal(first, last)


def test_predictions_are_those_of_the_package(works, document):
    needed("rigidformer")
    usual = ("--size", "240x160", "--frames", "3", "--mesh", "--eye", "1,-6,6", "--look-at", "-1.6,0.2,1.5", "--seconds", "0.5")
    made, notes = document(*usual, "--model", NANO, "--png", "a")
    assert made["poses"] == "predicted by nano, step 10"
    beside = made["points_beside_the_first_picture"]
    assert beside > 0 and f"note: {beside} of {made['points']} points begin beside the picture" in notes
    works(*usual, "--recorded", "--png", "b")
    predicted, recorded = pictures("a", "tracking"), pictures("b", "tracking")
    # Frame 0 is observed, up to the rounding of its rotations; later ones are predicted.
    off = np.abs(predicted.astype(int) - recorded).max(-1)
    assert (off[0] <= 1).mean() > 0.999 and (off[2] > 1).mean() > 0.01


def test_the_summary_says_what_was_made(works, document):
    usual = ("--recorded", "--size", "96x64", "--frames", "2")
    made, _ = document(*usual, "--seconds", "0.25", "--fps", "29.97")
    for name, value in {"frames": 2, "rate_hz": 29.97, "span_s": 0.25, "points": 296, "poses": "recorded", "rendered": None}.items():
        assert made[name] == value, name
    assert made["bytes"] == os.path.getsize("tracking.mp4")
    said = works(*usual)
    for part in ("2 frames of 96 x 64 pixels over 0.500 s", "camera at", "wrote tracking.mp4", "at 8 frames a second"):
        assert part in said, said


def test_surfaces_that_reach_behind_the_camera_are_in_both_videos(works, fails):
    save(box(10, 10, 0.2), [UP] * 3)
    usual = ("scene.safetensors", "--recorded", "--mesh", "--size", "240x160", "--frames", "1")
    # None of its corners is in the picture.
    said = works(*usual, "--view", "50", "--eye", "0,-3,1", "--look-at", "0,0,.8", "--png", "png", "--rendered", "rendered.mp4")
    assert "nothing is in" not in said
    [tracked], [rendered] = pictures("png", "tracking"), pictures("png", "rendered")
    lit = rendered[tracked.any(-1)].astype(int)
    assert len(lit) > 240 * 60
    # Units have colours, the ground has none to speak of. Edges are mixed with what is beside them.
    assert (np.ptp(lit, axis=1) > 40).sum() + 2 * 240 > len(lit)
    away = ("--eye", "0,-3,1", "--look-at", "0,-3,9", "--out", "away.mp4", "--png", "away")
    fails((*usual, *away), 2, "sees no unit", "--look-at 0.00,0.00,0.10")
    assert not [name for name in os.listdir() if name.startswith(("a", "."))]


def test_blue_is_in_the_middle_where_depths_do_not_differ(works):
    save([[0, 0, 0.5], [9, 0, 0.5], [0, 0, 9], [9, 9, 9]], [UP] * 3)
    said = works("scene.safetensors", "--recorded", "--size", "32x16", "--frames", "1", "--eye", "0,-3,.5", "--look-at", "0,0,.5", "--view", "30")
    assert "blue is 128 throughout" in said and "inf" not in said


def test_scenes_with_velocities_are_rolled_out(works):
    rigidformer = needed("rigidformer")
    t = np.arange(41) / 148
    places = np.outer(t, (1, 0.5, 0.25)) + np.outer(2 - 9.81 / 2 * t**2, (0, 0, 1))
    save(box(0.1, 0.1, 0.1), np.column_stack((places, np.cos(1.5 * t), 0 * t, 0 * t, np.sin(1.5 * t))),
         unit_velocity=np.array([[1, 0.5, 0.25, 0, 0, 3]], np.float32))  # fmt: skip
    for more in ((), ("--join",)):
        said = works("scene.safetensors", "--model", NANO, "--size", "32x16", "--frames", "3", *more)
        assert "predicted by nano" in said
    # In free flight the prediction is the record.
    from rigidformer_lab.controls.predict import open_loop
    from rigidformer_lab.scenes import read_scenes

    own = motion.record(read_scenes("scene.safetensors"), 0)
    scene = rigidformer.Dataset("scene.safetensors").scene(0)
    found = open_loop(rigidformer, rigidformer.Model(NANO), scene, own, 10, False)
    at = 0.2
    truth = np.array([1, 0.5, 0.25]) * at + (0, 0, 2 - 9.81 / 2 * at**2)
    assert np.abs(found.at(at)[0][0, :3] - truth).max() < 0.02


def test_points_without_bounds_are_refused(fails):
    save(box(1, 1, 1), [(3e38, 0, 0, 1, 0, 0, 0)] * 3)
    fails(("scene.safetensors", "--recorded", "--frames", "1"), 1, "seed 1: the record", "1000000 m away", "--index")


def test_soft_units_bend(works):
    works(SOFT, "--recorded", "--size", "96x64", "--frames", "3", "--mesh", "--rendered", "r.mp4", "--png", "png")
    frames = pictures("png", "tracking")
    assert (frames.any(-1).sum((1, 2)) > 500).all() and not np.array_equal(frames[0], frames[2])
    if HAS_PACKAGE:
        assert "predicted by" in works(SOFT, "--model", SHELL, "--size", "96x64", "--frames", "3")


def test_mistakes_have_names_and_remedies(folder, fails):
    (folder / "used/full").mkdir(parents=True)
    (folder / "empty").mkdir()
    (folder / "link").symlink_to("empty")
    whole, here = str(folder / "tracking.mp4"), str(folder)
    cases = [
        (["none.safetensors"], 1, "none.safetensors", "does not exist"),
        (["--size", "721x480"], 2, "odd", "722x480"),
        (["--size", "8x8"], 2, "16 to 4096"),
        (["--fps", "0"], 2, "--fps"),
        (["--frames", "0"], 2, "--frames"),
        (["--index", "7"], 1, "scene 7 of 1"),
        (["--seconds", "3"], 2, "--seconds 3", "0.500 s", "give less"),
        (["--eye", "3,0,1", "--look-at", "9,0,1"], 2, "sees no unit", "--look-at -1."),
        (["--eye", "1,1,1", "--look-at", "1,1,1"], 2, "two places"),
        (["--eye", "1,1"], 2, "three numbers"),
        (["--look-at", "1,1,1"], 2, "--eye"),
        (["--eye", "-1,1,1", "--azimuth", "-3"], 2, "--azimuth"),
        (["--out", "none/x.mp4"], 2, "none/x.mp4", "make it first"),
        (["--out", "used"], 2, "name a file in it"),
        (["--rendered", "tracking.mp4"], 2, "give two names"),
        (["--rendered", "./tracking.mp4"], 2, "give two names"),
        (["--rendered", whole], 2, "give two names"),
        (["--rendered", "used/../tracking.mp4"], 2, "give two names"),
        (["--png", "./tracking.mp4"], 2, "give two names"),
        (["--png", "used"], 2, "empty it"),
        (["--png", "."], 2, "folder that you are in"),
        (["--png", here], 2, "folder that you are in"),
        (["--png", "link"], 2, "--png link", "is a link"),
        (["--png", "link/"], 2, "is a link"),
        (["--out", "empty/x.mp4", "--png", "empty"], 2, "a video goes into this folder"),
        (["--out", "new/"], 2, "--out new/", "ends like a folder"),
        (["--rendered", "new/"], 2, "--rendered new/", "ends like a folder"),
    ]
    for arguments, code, *parts in cases:
        fails([*arguments, "--recorded"], code, *parts)
    fails(["--recorded", "--step", "5"], 2, "--recorded")
    assert sorted(os.listdir()) == ["empty", "link", "used"]


def test_a_scene_that_is_read_is_not_written_over(fails):
    save(box(1, 1, 1), [UP] * 3)
    before = Path("scene.safetensors").read_bytes()
    fails(["scene.safetensors", "--recorded", "--out", "scene.safetensors"], 2, "is what this command reads")
    assert Path("scene.safetensors").read_bytes() == before


def test_mistakes_of_predictions(fails, monkeypatch):
    monkeypatch.setitem(sys.modules, "rigidformer", None)
    fails([], 1, "needs the package rigidformer", "pip install", "--recorded")
    monkeypatch.undo()
    if HAS_PACKAGE:
        fails(["--step", "70"], 2, "frame 140", "121 frames", "smaller step")
        fails(["--model", "none.rfm"], 1, "none.rfm")


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_leaves_no_file(folder):
    command = [sys.executable, "-m", "rigidformer_lab.controls", "--recorded", "--frames", "50000", "--png", "png", "--rendered", "r.mp4"]
    path = os.pathsep.join(filter(None, (str(ROOT / "tools/lab"), os.environ.get("PYTHONPATH"))))
    # Where the tests run in the background, the shell ignores Ctrl-C for all that they start.
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path}, preexec_fn=heed)
    start = time.monotonic()
    while len(os.listdir()) < 3 or not any(os.listdir(name) for name in os.listdir() if os.path.isdir(name)):
        assert time.monotonic() < start + 120 and running.poll() is None, "it does not begin"
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    _, said = running.communicate(timeout=120)
    assert running.returncode == 130 and "interrupted; nothing was written" in said, said
    assert not os.listdir()


def test_the_module_needs_no_pytorch():
    code = "import sys; sys.modules['torch'] = None; import rigidformer_lab.controls.command, rigidformer_lab.controls.stage, rigidformer_lab.controls.files"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT / "tools/lab")


def test_the_commands_of_the_page_are_commands():
    text = (ROOT / "docs/CONTROLS.md").read_text() + parser().epilog
    lines = [line.split("rigidformer_lab.controls ")[1] for line in text.splitlines() if "-m rigidformer_lab.controls " in line]
    assert len(lines) >= 8
    for line in lines:
        options_of(shlex.split(line))


# The parts.


def test_frames_are_spread_over_the_whole_span():
    assert times(0.5, 3).tolist() == [0, 0.25, 0.5] and times(0.5, 1).tolist() == [0]


def test_pictures_are_png(folder):
    pixels = np.arange(3 * 5 * 3, dtype=np.uint8).reshape(3, 5, 3)
    Path("x.png").write_bytes(png(pixels))
    assert np.array_equal(picture("x.png"), pixels)


def test_samples_are_those_of_bt_601():
    for colour, samples in (((0, 0, 0), (16, 128, 128)), ((255,) * 3, (235, 128, 128)), ((255, 0, 0), (81, 90, 240)),
                            ((0, 255, 0), (145, 54, 34)), ((0, 0, 255), (41, 240, 110))):  # fmt: skip
        found = planes(np.full((2, 2, 3), colour, np.uint8))
        assert found.ravel().tolist() == [samples[0]] * 4 + list(samples[1:]), colour


#: 100 x 50 pixels, at the origin, with the middle of the picture straight ahead.
CAMERA = Camera((100, 50), 50.0, np.zeros(3), np.eye(3))


def test_colours_say_where_a_point_was():
    first = np.array([[0, 0, 1.0], [0, 0, 2.0]])
    palette = Palette(CAMERA, first)
    # Inverse depths .5 and 1: the percentiles lie .02 of the way within.
    assert np.allclose(palette.inverse_m, [0.51, 0.99])
    assert palette.colours(first).tolist() == [[128, 128, 255], [128, 128, 0]]
    z = 1 / 0.7512
    assert palette.colours(np.array([[-25 / 50 * z, 12.5 / 50 * z, z]])).tolist() == [[64, 191, 128]]
    # What begins beside the picture or behind the camera has the colour of its edge, and sets no range.
    beside = np.array([[9.0, 0, 1], [-9, -9, 1], [1, -1, -1]])
    palette = Palette(CAMERA, first[:1])
    assert not palette.shows(beside).any()
    assert palette.colours(beside).tolist() == [[255, 128, 128], [0, 0, 128], [255, 0, 128]]
    assert np.allclose(Palette(CAMERA, np.vstack((first, beside))).inverse_m, [0.51, 0.99])
    assert np.allclose(Palette(CAMERA, np.array([[99, 0, 0.1], [0, 0, -0.5]])).inverse_m, 10)


def drawn(seen, triangles=(), squares=(), side=2, first=None):
    seen = np.asarray(seen, float)
    shape = looks.Shape(np.zeros((0, 3)), np.zeros(0, int), np.array(squares, int), np.array(triangles, int).reshape(-1, 3),
                        np.zeros((0, 3), int), [])  # fmt: skip
    palette = Palette(CAMERA, np.array([[0, 0, 1.0], [0, 0, 2.0]]))
    palette.inverse_m = np.array([0.5, 1.0])
    return tracking.frame(palette, shape, seen, seen if first is None else first, 0.0, side)[0]


def test_a_point_is_a_square_about_its_place():
    # Seen at (60.2, 30.4): the square's middle is at (60, 30).
    pixels = drawn([[10.2 / 50 * 1.5, 5.4 / 50 * 1.5, 1.5]], squares=[0])
    assert np.argwhere(pixels.any(-1)).tolist() == [[29, 59], [29, 60], [30, 59], [30, 60]]
    assert pixels[29, 59].tolist() == [154, 155, 85]
    assert np.argwhere(drawn([[10.2 / 50, 5.4 / 50, 1]], squares=[0], side=1).any(-1)).tolist() == [[30, 60]]
    assert drawn([[1, 0, 1], [0, 0, -1]], squares=[0, 1], side=4).any(-1).sum() == 2 * 4, "edges cut, and nothing is behind the camera"


def test_the_nearest_is_in_front_whatever_the_order():
    near, far = [0, 0, 1], [0, 0, 2]
    for order in ([near, far], [far, near]):
        pixels = drawn(order, squares=[0, 1])
        assert pixels[pixels.any(-1)][:, 2].tolist() == [255] * 4
    for z, blue in ((0.9, 255), (1.5, 170)):
        wall = [[-9, -9, z], [9, -9, z], [0, 18, z]]
        assert drawn([*wall, [0, 0, 1.2]], [[0, 1, 2]], [3])[25, 50, 2] == blue


def test_a_surface_in_the_first_frame_has_the_colours_of_its_pixels():
    # A slope that fills the picture, from near on the left to far on the right.
    corners = [[-3, -9, 0.8], [9, -9, 4.0], [9, 30, 4.0], [-3, 30, 0.8]]
    pixels = drawn(corners, [[0, 1, 2], [0, 2, 3]]).astype(float)
    assert np.abs(pixels[..., 0] - 255 * (np.arange(100) + 0.5) / 100).max() < 0.6
    assert np.abs(pixels[..., 1] - 255 * (np.arange(50)[:, None] + 0.5) / 50).max() < 0.6
    assert pixels[0, 0, 2] > pixels[0, 99, 2]


def test_surfaces_that_reach_behind_the_camera_are_cut():
    # The ground below the camera: all of the lower half.
    lit = drawn([[-1e3, 1, -1e3], [1e3, 1, -1e3], [0, 1, 1e3]], [[0, 1, 2]]).any(-1)
    assert lit[25:].all() and not lit[:25].any()
    a, b, c, behind = [2.0, 0], [3.0, 1], [2.0, 2], [0.0, 4]
    cut = lambda *corners: raster.cut(np.array([corners]), np.array([corners])[..., 0], 1.0)[0].tolist()  # noqa: E731
    assert cut(a, b, c) == [[a, b, c]]
    assert cut(a, behind, behind) == [[a, [1, 2], [1, 2]]]
    assert cut(a, b, behind) == [[a, b, [1, 3]], [a, [1, 3], [1, 2]]]
    assert cut(behind, behind, behind) == []


def test_fragments_are_the_pixels_within(monkeypatch):
    rng = np.random.default_rng(1)
    monkeypatch.setattr(raster, "CHUNK", 300)
    places = rng.uniform(-10, 50, (40, 3, 2))
    places[0] = places[0, :1]  # no area
    found = np.zeros((40, 30 * 40), bool)
    for triangle, at, weights in raster.fragments(places, 40, 30):
        found[triangle, at] = True
        where = np.einsum("nk,nkd->nd", weights, places[triangle])
        assert np.abs(where - np.column_stack((at % 40 + 0.5, at // 40 + 0.5))).max() < 1e-6
    x, y = np.tile(np.arange(40) + 0.5, 30), np.repeat(np.arange(30) + 0.5, 40)
    side = lambda p, q: (q[:, :1] - p[:, :1]) * (y - p[:, 1:]) - (q[:, 1:] - p[:, 1:]) * (x - p[:, :1])  # noqa: E731
    turns = np.stack([side(places[:, a], places[:, b]) for a, b in ((0, 1), (1, 2), (2, 0))])
    expected = (turns >= 0).all(0) | (turns <= 0).all(0)
    expected[0] = False
    assert np.array_equal(found, expected)


def test_the_camera_is_as_near_as_shows_all():
    points = np.array([(i & 1, (i >> 1 & 1) / 4, (i >> 2) / 4) for i in range(8)], float) * 4
    for azimuth, elevation in ((-1.0, 0.6), (2.0, 0.0), (0.3, -0.5), (0.0, 1.55)):
        camera = fit(points, azimuth, elevation, (720, 480), 1.0)
        places = camera.places(camera.seen(points), 0.01)
        assert 0.97 < (np.ptp(places, axis=0) / (0.9 * 720, 0.9 * 480)).max() < 1.01
        assert (places > 0).all() and (places < (720, 480)).all()
    camera = between(np.array([0, -5.0, 1]), np.array([0, 0, 1.0]), (720, 480), 1.0)
    pixel = lambda x, z: camera.places(camera.seen(np.array([[x, 0, z]])), 0.01)[0]  # noqa: E731
    assert np.allclose(pixel(0, 1), (360, 240)) and pixel(1, 1)[0] > 360 and pixel(0, 2)[1] < 240
    assert abs(pixel(5 * np.tan(0.5), 1)[0] - 720) < 0.01  # an angle of view of 1 along the longer side
    assert between(np.ones(3), np.ones(3), (720, 480), 1.0) is None
    assert between(np.array([0, 0, 5.0]), np.zeros(3), (720, 480), 1.0).seen(np.array([[1.0, 0, 0]]))[0, 0] > 0


def test_poses_between_samples_lie_between_them():
    poses = np.array([[[0, 0, 0, 1, 0, 0, 0]], [[4, 0, 0, -np.cos(0.5), 0, 0, -np.sin(0.5)]]])
    moved = motion.Motion(poses, np.array([[[0.0, 0, 0]], [[8, 0, 0]]]), 2.0)
    pose, soft = moved.at(0.125)
    assert np.allclose(pose, [[1, 0, 0, np.cos(0.125), 0, 0, np.sin(0.125)]]) and np.allclose(soft, [[2, 0, 0]])
    assert moved.duration_s == 0.5 and np.allclose(moved.at(0.5)[0], poses[1])
    turn = motion.matrices(pose)[0]
    assert np.allclose(turn, [[np.cos(0.25), -np.sin(0.25), 0], [np.sin(0.25), np.cos(0.25), 0], [0, 0, 1]])


def test_hulls_face_outwards_and_flat_points_have_none():
    corners = box(1, 2, 3)
    faces = looks.hull_faces(corners)
    a, b, c = (corners[faces[:, k]] for k in range(3))
    assert len(faces) == 12 and (((np.cross(b - a, c - a)) * (a - corners.mean(0))).sum(1) > 0).all()
    assert len(looks.hull_faces(corners[:4])) == 0 and len(looks.hull_faces(corners[:3])) == 0
    # The edges of a box are sharp: a corner's normal is that of its face.
    normals = looks.smooth_normals(corners[faces], faces, looks.SMOOTH)
    assert np.allclose(normals, (np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a), axis=1)[:, None])[:, None])
    assert [len(piece) for piece in looks.surface(corners, [corners, corners + 5])[1]] == [12, 12]
