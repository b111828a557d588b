"""Soft units, bonds and joints in a world: bit for bit what rollouts of recorded scenes predict."""

from __future__ import annotations

from typing import Optional

import numpy as np
import pytest

import rigidformer as rf
from conftest import MODELS, at, cube, falling
from test_bits import bits, poses_of, run

STEP = 5
RATE_HZ = 60
LAST = 40
GROUND = rf.Plane([0, 0, 1])
NAN = float("nan")


def fallen(frame: int) -> float:
    """Metres after so many frames."""
    return 0.5 * 9.81 * (frame / RATE_HZ) ** 2


@pytest.fixture(scope="module")
def shell() -> rf.Model:
    return rf.Model(MODELS / "shell.rfm")


@pytest.fixture(scope="module")
def fragments() -> rf.Model:
    return rf.Model(MODELS / "fragments.rfm")


@pytest.fixture(scope="module")
def cloth() -> rf.Scene:
    """Four patches of a sheet fall onto a fixed cube, and a driven cube comes from the side."""
    side = np.linspace(-0.4, 0.4, 9)
    sheet = np.stack(np.meshgrid(side, side, [0.0], indexing="ij"), axis=-1)[:, :, 0]
    patches = [sheet[i : i + 5, j : j + 5].reshape(-1, 3) for i in (0, 4) for j in (0, 4)]
    units = [rf.Unit(patch, 0.05, rest=patch, young_pa=1e5, body=1) for patch in patches]
    units.append(rf.Unit(cube(), role="fixed"))
    # Its reference frame is the world at frame 0: what is observed counts from there.
    units.append(rf.Unit(cube(0.1) + [0.9, 0, 0.4], role="driven"))
    frames = range(LAST + 1)
    poses = [[at(z=0.7 - fallen(f))] * 4 + [at(z=0.2), at(x=-0.01 * f)] for f in frames]
    points = [np.concatenate(patches) + [0, 0, 0.7 - fallen(f)] for f in frames]
    return rf.Scene(units, poses, RATE_HZ, planes=[GROUND], soft_points=points)


@pytest.fixture(scope="module")
def pieces() -> rf.Scene:
    """Eight cubes that hold together to one, which is thrown on the ground; one bond is recorded to break."""
    places = 0.2 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(places[a] - places[b]).sum() < 0.3]
    poses = [[at(x, y, z + 1 - 0.06 * f - fallen(f)) for x, y, z in places] for f in range(LAST + 1)]
    bonds = [(a, b, 10 if pair == 3 else None) for pair, (a, b) in enumerate(pairs)]
    return rf.Scene([rf.Unit(cube(0.1), body=3)] * 8, poses, RATE_HZ, planes=[GROUND], bonds=bonds)


@pytest.fixture(scope="module")
def arm() -> rf.Scene:
    """Two links that hang from a hand, swing and fall: parts of one body."""
    def link(end: np.ndarray, angle: float) -> tuple[list, np.ndarray]:
        way = np.array([np.cos(angle), 0, -np.sin(angle)])
        turn = [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
        return [*(end + 0.15 * way), *turn], end + 0.3 * way

    bar = cube() * [0.75, 0.1, 0.1]
    units = [rf.Unit(cube(0.05), role="driven", body=1)] + [rf.Unit(bar, body=1)] * 2
    poses = []
    for frame in range(LAST + 1):
        hand = np.array([0.01 * frame, 0, 1.2])
        upper, elbow = link(hand, 0.02 * frame)
        lower, _ = link(elbow, 0.05 * frame)
        poses.append([at(*hand), upper, lower])
    return rf.Scene(units, poses, RATE_HZ, planes=[GROUND])


def saved(scene: rf.Scene, path) -> rf.Scene:
    """What the program reads of it, as it reads it."""
    scene.save(path, dataset="test", provenance="the test", licence="none")
    return rf.Dataset(path).scene(0)


def world_of(model: rf.Model, scene: rf.Scene, **settings) -> rf.World:
    world = rf.World(model, units=len(scene.units), **settings)
    world.gravity_m_s2, world.planes = scene.gravity_m_s2, scene.planes
    return world


def drive(world: rf.World, scene: rf.Scene, frame: int) -> None:
    for number, id in enumerate(world.ids):
        if world.role(id) == "driven" and frame < scene.frames:
            world.drive(id, scene.poses[frame, number])


def draped(model: rf.Model, scene: rf.Scene, **settings) -> rf.World:
    """A world that observed frames 0 and 5."""
    world = world_of(model, scene, **settings)
    units = [unit.with_points(points) for unit, points in zip(scene.units, scene.points(0))]
    world.observe(STEP / scene.frame_rate_hz, units, scene.points(STEP))
    return world


@pytest.mark.parametrize("threads, kernel", [(1, "portable"), (2, None)])
def test_a_world_drapes_cloth_as_the_program_does(
    program, tmp_path, shell, cloth, threads: int, kernel: Optional[str]
):
    scene = saved(cloth, tmp_path / "cloth.safetensors")
    options = ["--model", MODELS / "shell.rfm", "--step", STEP, "--frames", LAST, "--out", tmp_path]
    run(program, "rollout", tmp_path / "cloth.safetensors", *options)
    expected = rf.Dataset(tmp_path / "predicted.safetensors").scene(0)
    by_hand = draped(shell, scene, threads=threads, kernel=kernel)
    soft = [id for id in by_hand.ids if by_hand.is_soft(id)]
    assert soft == by_hand.ids[:4]
    for sample, frame in enumerate(range(2 * STEP, LAST + 1, STEP), 2):
        drive(by_hand, scene, frame)
        by_hand.step()
        found = np.concatenate([by_hand.soft_points(id) for id in soft])
        assert (bits(found) == bits(expected.soft_points[sample])).all()
        assert (by_hand.pose(by_hand.ids[5]) == expected.poses[sample, 5]).all()
    rolled = rf.rollout(shell, scene, step=STEP, last_frame=LAST)
    assert (bits(rolled.points) == bits(expected.soft_points)).all()


def test_soft_points_are_in_the_order_of_the_unit(shell, cloth):
    world = draped(shell, cloth)
    for id, expected in zip(world.ids[:4], cloth.points(STEP)):
        assert (world.soft_points(id) == expected).all()
        # The simulator's own order is another one of the same places.
        assert sorted(world.points(id).round(4).tolist()) == sorted(expected.round(4).tolist())
    for id, unit, expected in zip(world.ids[:4], cloth.units, cloth.points(STEP)):
        way = expected.mean(axis=0) - unit.rest.mean(axis=0)
        assert np.allclose(world.pose(id), at(*way), atol=1e-6)


def test_soft_units_that_cannot_be(shell, edge, cloth):
    with pytest.raises(rf.InputError, match="give both"):
        rf.Unit(cube(), rest=cube())
    with pytest.raises(rf.InputError, match="give both"):
        rf.Unit(cube(), young_pa=1e4)
    with pytest.raises(rf.InputError, match="rest has shape"):
        rf.Unit(cube(), rest=cube()[:, :2], young_pa=1e4)
    with pytest.raises(rf.InputError, match="points has shape"):
        rf.Unit(cube()).with_points(cube()[:4])
    world = draped(shell, cloth)
    before = [world.soft_points(id) for id in world.ids[:4]]
    patch, sheet = cloth.units[0], world.ids[0]
    at_rest = patch.rest
    for unit in (
        rf.Unit(at_rest, rest=at_rest[:5], young_pa=1e4),
        rf.Unit(at_rest, rest=at_rest * NAN, young_pa=1e4),
        rf.Unit(at_rest, rest=at_rest * 0, young_pa=1e4),
        rf.Unit(at_rest, rest=at_rest, young_pa=0.0),
        rf.Unit(at_rest, rest=at_rest, young_pa=1e4, role="driven"),
        rf.Unit(at_rest, rest=at_rest, young_pa=1e4, pieces=[cube()]),
    ):
        with pytest.raises(rf.InputError, match="soft unit 0"):
            world.observe(0.1, [unit], [at_rest])
    calls = [
        (lambda: world.observe_poses(0.1, [patch], [at()], [at()]), "not poses"),
        (lambda: world.add(rf.Unit(cube()), at()), "observe it anew"),
        (lambda: world.add(patch, at()), "soft"),
        (lambda: world.remove(sheet), "observe it anew"),
        (lambda: world.set_poses(sheet, at(), at()), "observe it anew"),
        (lambda: world.set_velocity(sheet, [0, 0, 1], [0, 0, 0]), "observe it anew"),
        (lambda: world.set_role(sheet, "fixed"), "observe it anew"),
        (lambda: world.join(sheet, world.ids[4], [0, 0, 0], [0, 0, 0]), "is soft"),
        (lambda: world.soft_points(world.ids[4]), "is rigid"),
        (lambda: world.soft_points(12345), "unit id 12345"),
        (lambda: world.is_soft(12345), "unit id 12345"),
    ]
    for call, text in calls:
        with pytest.raises(rf.InputError, match=text):
            call()
    assert all((world.soft_points(id) == points).all() for id, points in zip(world.ids, before))
    with pytest.raises(rf.InputError, match="shell.rfm"):
        rf.World(edge).observe(0.1, [patch], [at_rest])
    with pytest.raises(rf.InputError, match="unit 0 is soft"):
        rf.BatchSimulator(shell).run(rf.Start(0.1, [patch], [at()], [at()]), 1, 1)


def test_scenes_of_soft_units_and_bonds(tmp_path, cloth, pieces):
    back = saved(cloth, tmp_path / "cloth.safetensors")
    assert (bits(back.soft_points) == bits(cloth.soft_points)).all()
    assert [unit.young_pa for unit in back.units] == [1e5] * 4 + [None] * 2
    assert (back.units[1].rest == cloth.units[1].points).all() and back.units[4].rest is None
    assert repr(back.units[0]) == "Unit(25 points, 0.05 kg, free, soft)"
    back = saved(pieces, tmp_path / "pieces.safetensors")
    assert back.bonds == pieces.bonds and back.bonds[3][2] == 10 and back.bonds[0][2] is None
    assert back.soft_points is None
    poses = [[at()] * len(cloth.units)]
    with pytest.raises(rf.InputError, match="unit 0 is soft; give soft_points"):
        rf.Scene(cloth.units, poses, RATE_HZ)
    with pytest.raises(rf.InputError, match="soft_points has shape"):
        rf.Scene(cloth.units, poses, RATE_HZ, soft_points=np.zeros((1, 3, 3)))
    with pytest.raises(rf.InputError, match="soft_points has shape"):
        rf.Scene(cloth.units[4:], [poses[0][4:]], RATE_HZ, soft_points=np.zeros((1, 3, 3)))
    for bond in [(0, 0, None), (0, 1, None)]:
        with pytest.raises(rf.InputError, match="bond"):
            rf.Scene([rf.Unit(cube())], [[at()]], RATE_HZ, bonds=[bond])
    with pytest.raises(rf.InputError, match="frame 41 is needed"):
        pieces.points(41)


def thrown(model: rf.Model, scene: rf.Scene) -> rf.World:
    """A world that observed frames 0 and 5, and holds what holds there."""
    world = world_of(model, scene)
    world.observe_poses(STEP / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[STEP])
    ids = world.ids
    held = [bond for bond in scene.bonds if bond[2] is None or bond[2] > STEP]
    world.bond([(ids[a], ids[b]) for a, b, _ in held])
    return world


def test_a_world_breaks_bonds_as_the_program_does(program, tmp_path, fragments, pieces):
    scene = saved(pieces, tmp_path / "pieces.safetensors")
    options = ["--model", MODELS / "fragments.rfm", "--step", STEP, "--frames", LAST, "--out", tmp_path]
    run(program, "rollout", tmp_path / "pieces.safetensors", *options)
    expected = rf.Dataset(tmp_path / "predicted.safetensors").scene(0)
    world = thrown(fragments, scene)
    broken = set()
    for sample in range(2, expected.frames):
        world.step()
        assert (bits(world.poses()) == bits(expected.poses[sample])).all()
        for bond, (_, _, breaks_at) in zip(world.bonds, expected.bonds):
            assert bond.holds == (breaks_at is None or sample < breaks_at)
            broken |= set() if bond.holds else {bond.units}
    # Some break, and not all.
    assert 0 < len(broken) < len(world.bonds)


def test_bonds_that_are_broken_by_hand(edge, pieces):
    """A model that breaks none: the record says when."""
    expected = rf.rollout(edge, pieces, step=STEP, last_frame=LAST)
    world = thrown(edge, pieces)
    ids = world.ids
    for sample in range(2, len(expected)):
        frame = int(expected.frames[sample - 1])
        for a, b, breaks_at in pieces.bonds:
            if breaks_at is not None and breaks_at <= frame:
                held = [bond.holds for bond in world.bonds if set(bond.units) == {ids[a], ids[b]}]
                assert world.break_bond((ids[a], ids[b])) == held[0]
        world.step()
        assert (bits(world.poses()) == bits(expected.poses[sample])).all()
        assert [bond.holds for bond in world.bonds] == expected.holding[sample]
    pair = world.bonds[3].units
    assert world.break_bond(pair) is False and world.bonds[3] == world.bonds[3]
    assert repr(world.bonds[3]) == f"Bond(({pair[0]}, {pair[1]}), holds=False)"


def test_bonds_that_cannot_be(edge, shell):
    world, _ = falling(edge)
    world.remove(world.ids[0])
    part = rf.Unit(cube(0.1), body=1)
    a, b, c = (world.add(part, at(x=0.2 * number, z=1)) for number in range(3))
    other = world.add(rf.Unit(cube(0.1)), at(x=2, z=1))
    world.bond([(a, b)])
    twin, _ = falling(edge)
    twin.remove(twin.ids[0])
    ids = [twin.add(part, at(x=0.2 * number, z=1)) for number in range(3)]
    twin.add(rf.Unit(cube(0.1)), at(x=2, z=1))
    twin.bond([ids[:2]])
    calls = [
        (lambda: world.bond([(a, 12345)]), "unit id 12345"),
        (lambda: world.bond([(a, a)]), "itself"),
        (lambda: world.bond([(a, c), (b, a)]), "bonded once"),
        (lambda: world.bond([(a, c), (c, a)]), "bonded once"),
        (lambda: world.bond([(a, other)]), "the same body"),
        (lambda: world.bond([(a, c)] * 100), "room for"),
        (lambda: world.break_bond((a, c)), "no bond"),
        (lambda: world.break_bond((a, 12345)), "unit id 12345"),
        (lambda: world.set_role(a, "driven"), "break its bonds"),
        (lambda: world.join(a, c, [0, 0, 0], [0, 0, 0]), "break its bonds"),
    ]
    for call, text in calls:
        with pytest.raises(rf.InputError, match=text):
            call()
    for pairs in ([(a,)], [(a, b, c)], [(-1, b)], [("a", "b")], [a, b], 5):
        with pytest.raises((TypeError, ValueError, OverflowError)):
            world.bond(pairs)
    assert [bond.units for bond in world.bonds] == [(a, b)]
    assert (bits(world.rollout(6)) == bits(twin.rollout(6))).all()
    elastic = rf.World(shell)
    elastic.dt_s = 1 / 60
    with pytest.raises(rf.InputError, match="such as edge"):
        elastic.bond([(elastic.add(part, at(z=1)), elastic.add(part, at(x=1, z=1)))])


def hanging(model: rf.Model, scene: rf.Scene) -> rf.World:
    """A world that observed frames 0 and 5, and hangs parts by the pivots that these show."""
    world = world_of(model, scene)
    world.observe_poses(STEP / scene.frame_rate_hz, scene.units, scene.poses[0], scene.poses[STEP])
    ids = world.ids
    for found in scene.pivots(STEP):
        world.join(ids[found.unit], ids[found.parent], found.pivot, found.parent_pivot)
    return world


def test_a_world_swings_an_arm_as_the_program_does(program, tmp_path, edge, arm):
    scene = saved(arm, tmp_path / "arm.safetensors")
    options = ["--join", "--step", STEP, "--frames", LAST, "--out", tmp_path]
    run(program, "rollout", tmp_path / "arm.safetensors", *options)
    frames, expected = poses_of(tmp_path / "poses.csv")
    world = hanging(edge, scene)
    assert [(joint.unit, joint.parent) for joint in world.joints] == [(2, 1), (3, 2)]
    apart = rf.rollout(edge, scene, step=STEP, last_frame=LAST).poses
    for sample, frame in enumerate(frames[2:], 2):
        drive(world, scene, frame)
        world.step()
        assert (bits(world.poses()) == bits(expected[sample])).all()
    assert (apart[-1] != expected[-1]).any()


def test_pivots_are_where_the_arm_was_made_to_turn(arm):
    first, second = arm.pivots(20)
    assert (first.unit, first.parent, second.unit, second.parent) == (1, 0, 2, 1)
    assert np.allclose(first.pivot, [-0.15, 0, 0], atol=1e-3)
    assert np.allclose(first.parent_pivot, [0, 0, 0], atol=1e-3)
    assert np.allclose(second.pivot, [-0.15, 0, 0], atol=1e-3)
    assert np.allclose(second.parent_pivot, [0.15, 0, 0], atol=1e-3)
    assert first.residual_m < 1e-4 and first == arm.pivots(20)[0] and first != second
    assert repr(first).startswith("Pivot(1, 0, [-0.1")
    with pytest.raises(rf.InputError, match="pivots take 2"):
        arm.pivots(0)
    assert rf.Dataset.embedded().scene(0).pivots(5) == []


def test_joints_that_cannot_be(edge, arm):
    world, twin = hanging(edge, arm), hanging(edge, arm)
    hand, upper, lower = world.ids
    zero = [0, 0, 0]
    calls = [
        (lambda: world.join(12345, hand, zero, zero), "unit id 12345"),
        (lambda: world.join(lower, 12345, zero, zero), "unit id 12345"),
        (lambda: world.join(upper, upper, zero, zero), "cannot hang"),
        (lambda: world.join(hand, lower, zero, zero), "cannot hang"),
        (lambda: world.join(lower, hand, [NAN, 0, 0], zero), "pivots must be finite"),
        (lambda: world.join(lower, hand, zero, [0, 1e7, 0]), "pivots must be finite"),
        (lambda: world.join(lower, hand, zero, [0, 0]), "parent_pivot has shape"),
        (lambda: world.unjoin(12345), "unit id 12345"),
        (lambda: world.bond([(upper, lower)]), "unjoin it"),
    ]
    for call, text in calls:
        with pytest.raises(rf.InputError, match=text):
            call()
    with pytest.raises(TypeError):
        world.join(lower, hand, "here", zero)
    assert world.joints == twin.joints
    assert (bits(world.rollout(6)) == bits(twin.rollout(6))).all()
    assert world.unjoin(lower) == twin.joints[1] and world.unjoin(lower) is None
    world.join(lower, hand, [-0.15, 0, 0], zero)
    assert repr(world.joints[1]) == f"Joint({lower}, {hand}, [-0.15, 0, 0], [0, 0, 0])"
    world.remove(hand)
    assert world.joints == []
    world.observe_poses(0.1, arm.units, arm.poses[0], arm.poses[5])
    assert world.joints == []
