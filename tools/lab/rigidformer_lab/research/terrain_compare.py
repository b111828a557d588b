"""Bodies on height fields beside MuJoCo, and the same bodies on a plane.

    python -m rigidformer_lab.research.terrain_compare          # --draws 20 --seconds 1

A box, a ball and a heap of eight boxes are let go just above the ground, with a speed of up to half a metre a second along it.
Grounds: a plane, the same plane as a height field, a slope of ten degrees as a plane and as a height field, stairs, hills and
ground of random heights. MuJoCo takes steps of a tenth of a millisecond with stiff contacts and an elliptic cone of
friction. The runtime takes steps of a sixtieth of a second by impulses alone. Errors are those of a unit at the end: medians. The
last two columns are of MuJoCo with contacts a quarter as stiff, beside itself. Needs `mujoco` and `rigidformer`.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

GRAVITY = 9.81
MUJOCO_STEP_S = 1e-4
TIME_CONSTANT_S = 0.001
FRICTION = 0.5
SIDES = 64


def grid(rows, columns, spacing, height):
    """(rows, columns) heights of a function about the origin, and their spacing."""
    x = (np.arange(columns) - (columns - 1) / 2) * spacing
    y = (np.arange(rows) - (rows - 1) / 2) * spacing
    heights = height(*np.meshgrid(x, y)).astype(np.float32)
    return heights, spacing


def grounds(rng):
    """By name: a plane's normal, or heights with their spacing and corner."""
    lean = np.deg2rad(10)
    tilted = np.array([-np.sin(lean), 0, np.cos(lean)])
    # Treads of 40 cm, risers of 10 cm over one centimetre.
    stairs = lambda x, y: 0.1 * np.floor(x / 0.4 + 0.5)  # noqa: E731
    phases = rng.uniform(0, 2 * np.pi, 4)

    def hills(x, y):
        return 0.06 * np.sin(2.1 * x + phases[0]) * np.sin(1.7 * y + phases[1]) + 0.03 * np.sin(4.1 * x + 2.3 * y + phases[2])

    return {
        "plane": np.array([0.0, 0, 1]),
        "plane as a field": grid(81, 81, 0.05, lambda x, y: 0 * x),
        "slope": tilted,
        "slope as a field": grid(81, 81, 0.05, lambda x, y: np.tan(lean) * x),
        "hills": grid(81, 81, 0.05, hills),
        "random heights": grid(41, 41, 0.1, lambda x, y: rng.uniform(0, 0.03, x.shape)),
        "stairs": grid(3, 401, 0.01, lambda x, y: stairs(x, y)),
    }


def ground_height(ground, x, y):
    if not isinstance(ground, tuple):
        return -(ground[0] * x + ground[1] * y) / ground[2]
    import rigidformer as rf

    return rf.HeightField(ground[0], spacing_of(ground), corner_of(ground)).height_m(float(x), float(y))


def spacing_of(ground):
    # Stairs are long strips: their rows are far apart.
    heights, spacing = ground
    return [spacing, 2.0 if heights.shape[0] == 3 else spacing]


def corner_of(ground):
    heights, _ = ground
    dx, dy = spacing_of(ground)
    return np.array([-(heights.shape[1] - 1) / 2 * dx, -(heights.shape[0] - 1) / 2 * dy, 0.0])


def bodies(kind, rng):
    """Half sizes (or a radius), places above the ground, turns and velocities."""
    heading = rng.uniform(0, 2 * np.pi)
    place = rng.uniform(-0.3, 0.3, 2)
    speed = rng.uniform(0.1, 0.5) * np.array([np.cos(heading), np.sin(heading), 0])
    turn = rng.uniform(-np.pi, np.pi)
    if kind == "ball":
        return [(rng.uniform(0.05, 0.1), np.array([*place, 0.02]), turn, speed)]
    if kind == "box":
        return [(rng.uniform(0.05, 0.12, 3), np.array([*place, 0.02]), turn, speed)]
    half = np.full(3, 0.06)
    spots = [(i, j, k) for k in range(2) for i in range(2) for j in range(2)]
    return [
        (half, np.array([0.13 * i + rng.uniform(-0.005, 0.005), 0.13 * j + rng.uniform(-0.005, 0.005), 0.03 + 0.125 * k]), 0.0, np.zeros(3))
        for i, j, k in spots
    ]


def place_over(ground, body):
    """The least height over the ground at which no corner is in it."""
    size, place, turn, _ = body
    if np.isscalar(size):
        angles = np.linspace(0, 2 * np.pi, 16)
        spots = [(r * size * np.cos(a), r * size * np.sin(a), np.sqrt(1 - r * r) * size) for a in angles for r in (0, 0.5, 0.9)]
    else:
        c, s = np.cos(turn), np.sin(turn)
        fractions = np.linspace(-1, 1, 7)
        spots = [(c * u * size[0] - s * v * size[1], s * u * size[0] + c * v * size[1], size[2]) for u in fractions for v in fractions]
    return place[2] + max(ground_height(ground, place[0] + x, place[1] + y) + z for x, y, z in spots)


def moments(mass, size):
    if np.isscalar(size):
        return [0.4 * mass * size**2] * 3
    x, y, z = size**2 / 3
    return [mass * (y + z), mass * (x + z), mass * (x + y)]


def by_mujoco(ground, all_bodies, starts, seconds, time_constant_s=TIME_CONSTANT_S):
    import mujoco

    text = lambda values: " ".join(f"{value:.9g}" for value in np.ravel(values))  # noqa: E731
    contact = f'friction="{FRICTION} 0 0" condim="3" solref="{time_constant_s} 1" solimp=".95 .99 .0005"'
    asset = ""
    if isinstance(ground, tuple):
        heights = ground[0]
        dx, dy = spacing_of(ground)
        low, high = float(heights.min()), float(heights.max())
        lift = max(high - low, 1e-3)
        half = [(heights.shape[1] - 1) / 2 * dx, (heights.shape[0] - 1) / 2 * dy]
        asset = f'<hfield name="h" nrow="{heights.shape[0]}" ncol="{heights.shape[1]}" size="{half[0]} {half[1]} {lift} 0.5"/>'
        geom = f'<geom type="hfield" hfield="h" pos="0 0 {low}" {contact}/>'
    else:
        quat = np.zeros(4)
        mujoco.mju_quatZ2Vec(quat, ground)
        geom = f'<geom type="plane" size="9 9 .1" quat="{text(quat)}" {contact}/>'
    xml = ""
    for (size, _, turn, _), start in zip(all_bodies, starts):
        shape = f'type="sphere" size="{size}"' if np.isscalar(size) else f'type="box" size="{text(size)}"'
        xml += (
            f'<body pos="{text(start)}" quat="{np.cos(turn / 2)} 0 0 {np.sin(turn / 2)}"><freejoint/>'
            f'<inertial pos="0 0 0" mass="1" diaginertia="{text(moments(1.0, size))}"/><geom {shape} {contact}/></body>'
        )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{MUJOCO_STEP_S}" gravity="0 0 -{GRAVITY}" cone="elliptic" impratio="20" noslip_iterations="5" '
        f'integrator="implicitfast"/><size memory="64M"/><asset>{asset}</asset><worldbody>{geom}{xml}</worldbody></mujoco>'
    )
    if isinstance(ground, tuple):
        model.hfield_data[:] = ((ground[0] - low) / lift).ravel()
    data = mujoco.MjData(model)
    for number, body in enumerate(all_bodies):
        data.qvel[6 * number : 6 * number + 3] = body[3]
    for _ in range(round(seconds / MUJOCO_STEP_S)):
        mujoco.mj_step(model, data)
    return data.qpos.reshape(-1, 7).copy()


def sphere(radius, count=200):
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    return radius * np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], 1)


def box_points(half, across=5):
    steps = np.linspace(-1, 1, across)
    return half * np.array([[x, y, z] for x in steps for y in steps for z in steps if max(abs(x), abs(y), abs(z)) == 1])


def by_runtime(rf, model, ground, all_bodies, starts, seconds, rate):
    """Poses at the end, seconds of processor time a step."""
    world = rf.World(model, units=len(all_bodies), points=256 * len(all_bodies))
    world.dt_s = 1 / rate
    world.gravity_m_s2 = [0, 0, -GRAVITY]
    world.network = False
    if isinstance(ground, tuple):
        world.planes = []
        world.height_field = rf.HeightField(ground[0], spacing_of(ground), corner_of(ground), friction=1.0, restitution=0.0)
    else:
        world.planes = [rf.Plane(ground, friction=1.0, restitution=0.0)]
    ids = []
    for (size, _, turn, speed), start in zip(all_bodies, starts):
        points = sphere(size) if np.isscalar(size) else box_points(size)
        # MuJoCo takes the greater of two coefficients, the runtime their product.
        coefficient = FRICTION if len(all_bodies) == 1 else FRICTION**0.5
        unit = rf.Unit(points.astype(np.float32), 1.0, coefficient, 0.0, inertia_kg_m2=moments(1.0, size))
        pose = np.array([*start, np.cos(turn / 2), 0, 0, np.sin(turn / 2)], np.float32)
        ids.append(world.add(unit, pose))
        world.set_velocity(ids[-1], speed, [0, 0, 0])
    if len(all_bodies) > 1 and isinstance(ground, tuple):
        field = world.height_field
        world.height_field = rf.HeightField(field.heights_m, field.spacing_m, field.corner_m, friction=FRICTION**0.5, restitution=0.0)
    elif len(all_bodies) > 1:
        world.planes = [rf.Plane(ground, friction=FRICTION**0.5, restitution=0.0)]
    steps = round(seconds * rate)
    start = time.perf_counter()
    for _ in range(steps):
        world.step()
    spent = (time.perf_counter() - start) / steps
    return np.array([world.pose(one) for one in ids]), spent


def angle(a, b):
    return float(np.degrees(2 * np.arccos(min(1.0, abs(float(np.dot(a / np.linalg.norm(a), b / np.linalg.norm(b))))))))


def cost(rf, model, rounds=7):
    """Times of a step of twenty boxes, as multiples of those of flight over a plane: medians of turns."""
    corners = (0.08 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])).astype(np.float32)
    hills = lambda x, y: 0.06 * np.sin(2.1 * x) * np.sin(1.7 * y)  # noqa: E731
    fields = {
        "a plane": None,
        "10,201 heights": grid(101, 101, 0.04, hills),
        "1,002,001 heights": grid(1001, 1001, 0.004, hills),
    }

    def world(ground, high, still):
        made = rf.World(model, units=20, points=160, threads=1)
        made.dt_s, made.network = 1 / 60, False
        if ground is not None:
            made.planes, made.height_field = [], rf.HeightField(ground[0], ground[1], corner_of(ground), friction=1.0)
        for number in range(20):
            x, y = 0.4 * (number % 5) - 0.8, 0.4 * (number // 5) - 0.6
            made.add(rf.Unit(corners, 1.0, 0.8, 0.0), np.array([x, y, high, 1, 0, 0, 0], np.float32))
        if still:
            made.step(120)
        return made.copy()

    times = {}
    for _ in range(rounds):
        for name, ground in fields.items():
            for state, high, still in (("flight", 100.0, False), ("landing", 0.2, False), ("at rest", 0.2, True)):
                one = world(ground, high, still)
                start = time.perf_counter()
                one.step(20)
                times.setdefault((state, name), []).append((time.perf_counter() - start) / 20)
    base = np.median(times["flight", "a plane"])
    for (state, name), spent in times.items():
        print(f"{state:8} {name:18} {np.median(spent) / base:8.2f}")


def main():
    import rigidformer as rf

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=1.0)
    parser.add_argument("--rate", type=float, default=60.0, help="steps a second")
    parser.add_argument("--cost", action="store_true", help="times of steps instead")
    parser.add_argument("--seed", type=int, default=430_001)
    arguments = parser.parse_args()
    model = rf.Model("edge")
    if arguments.cost:
        return cost(rf, model)
    print(f"{'ground':18} {'body':5} {'position, mm':>13} {'turn, degrees':>14} {'a step, ms':>11} {'MuJoCo, mm':>11} {'degrees':>8}")
    for name in grounds(np.random.default_rng(0)):
        for kind in ("box", "ball", "heap"):
            way, turn, spent, own_way, own_turn = [], [], [], [], []
            for draw in range(arguments.draws):
                rng = np.random.default_rng(arguments.seed + draw)
                ground = grounds(rng)[name]
                chosen = bodies(kind, np.random.default_rng(arguments.seed + 1000 + draw))
                starts = [np.array([*body[1][:2], place_over(ground, body)]) for body in chosen]
                if kind == "heap":
                    base = max(start[2] - body[1][2] for start, body in zip(starts, chosen))
                    starts = [np.array([*body[1][:2], base + body[1][2]]) for body in chosen]
                theirs = by_mujoco(ground, chosen, starts, arguments.seconds)
                softer = by_mujoco(ground, chosen, starts, arguments.seconds, 2 * TIME_CONSTANT_S)
                ours, one = by_runtime(rf, model, ground, chosen, starts, arguments.seconds, arguments.rate)
                spent.append(one)
                way += list(np.linalg.norm(ours[:, :3] - theirs[:, :3], axis=1) * 1e3)
                turn += [angle(a, b) for a, b in zip(ours[:, 3:], theirs[:, 3:])]
                own_way += list(np.linalg.norm(softer[:, :3] - theirs[:, :3], axis=1) * 1e3)
                own_turn += [angle(a, b) for a, b in zip(softer[:, 3:], theirs[:, 3:])]
            own = f"{np.median(own_way):11.2f} {np.median(own_turn):8.2f}"
            print(f"{name:18} {kind:5} {np.median(way):13.2f} {np.median(turn):14.2f} {np.median(spent) * 1e3:11.3f} {own}", flush=True)


if __name__ == "__main__":
    main()
