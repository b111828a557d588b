"""Passive joints of the runtime beside MuJoCo: energy, pivots and angles over two seconds.

    python -m rigidformer_lab.research.joints_compare          # --rate 60 --seconds 2

Three scenes without ground: a double pendulum and an arm of four links, which fall from the horizontal, and a box that swings
about a hinge which leans. MuJoCo takes steps of 0.1 ms by Runge-Kutta, without damping. The runtime takes observed steps, by
impulses alone. Energy drifts by a share of what falls over: sum of m g times the arm's length. Needs `mujoco` and `rigidformer`.
"""

from __future__ import annotations

import argparse

import numpy as np

GRAVITY = 9.81
MUJOCO_STEP_S = 1e-4


def link(half, pivot, parent_pivot, axis, mass):
    return {"half": half, "pivot": pivot, "parent_pivot": parent_pivot, "axis": axis, "mass": mass}


def rod(length, axis, mass, parent_pivot):
    return link([length / 2, 0.02, 0.03], [-length / 2, 0, 0], parent_pivot, axis, mass)


def scenes():
    """Links of each scene from the fixed post on; all begin with their frames along the world's axes, at rest."""
    y, z = [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
    leaning = (np.array([0.3, 1.0, 0.4]) / np.linalg.norm([0.3, 1.0, 0.4])).tolist()
    return {
        "double pendulum": [rod(0.5, y, 1.0, [0, 0, 0]), rod(0.4, y, 0.7, [0.25, 0, 0])],
        "arm of four links": [
            rod(0.4, z, 2.0, [0, 0, 0]),
            rod(0.4, y, 1.5, [0.2, 0, 0]),
            rod(0.3, y, 1.0, [0.2, 0, 0]),
            rod(0.2, z, 0.5, [0.15, 0, 0]),
        ],
        "box on a hinge": [link([0.3, 0.2, 0.05], [-0.3, 0.1, 0], [0, 0, 0], leaning, 3.0)],
    }


def moments(one):
    x, y, z = (side**2 / 3 for side in one["half"])
    return [one["mass"] * (y + z), one["mass"] * (x + z), one["mass"] * (x + y)]


def places(links):
    """Where the centres of links begin, metres."""
    centre, all_of = np.zeros(3), []
    for one in links:
        centre = centre + np.array(one["parent_pivot"]) - np.array(one["pivot"])
        all_of.append(centre)
    return all_of


def mujoco_model(links):
    import mujoco

    numbers = " ".join
    as_text = lambda values: numbers(f"{value:.9g}" for value in values)  # noqa: E731
    body, end = "", ""
    for number, one in enumerate(links):
        above = links[number - 1]["pivot"] if number else [0, 0, 0]
        place = np.array(one["parent_pivot"]) - np.array(above)
        # A body's frame has its origin in the joint, its centre is at minus the pivot.
        body += (
            f'<body pos="{as_text(place)}"><joint name="j{number}" type="hinge" axis="{as_text(one["axis"])}"/>'
            f'<inertial pos="{as_text(-np.array(one["pivot"]))}" mass="{one["mass"]}" diaginertia="{as_text(moments(one))}"/>'
        )
        end += "</body>"
    xml = (
        f'<mujoco><compiler angle="radian"/><option timestep="{MUJOCO_STEP_S}" gravity="0 0 -{GRAVITY}" integrator="RK4">'
        f'<flag contact="disable" energy="enable"/></option><worldbody>{body}{end}</worldbody></mujoco>'
    )
    return mujoco.MjModel.from_xml_string(xml)


def by_mujoco(links, rate, steps):
    """(steps + 1, joints) angles, and how far energy drifts, J."""
    import mujoco

    model = mujoco_model(links)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start, drift, angles = data.energy.sum(), 0.0, [data.qpos.copy()]
    for step in range(steps):
        while data.time < (step + 1) / rate - MUJOCO_STEP_S / 2:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        # Steps do not end on frames: the rest of the way by the velocity.
        rest = (step + 1) / rate - data.time
        angles.append(data.qpos + data.qvel * rest + data.qacc * rest**2 / 2)
        drift = max(drift, abs(data.energy.sum() - start))
    return np.array(angles), drift


def rotation(q):
    w, x, y, z = np.asarray(q, np.float64) / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def by_runtime(links, rate, steps):
    """(steps + 1, joints) angles, how far energy drifts (J), and how far pivots come apart (m)."""
    import rigidformer as rf

    world = rf.World(rf.Model("edge"), units=len(links) + 1, points=8 * (len(links) + 1))
    world.dt_s, world.network, world.planes, world.gravity_m_s2 = 1 / rate, False, [], [0, 0, -GRAVITY]
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    base = world.add(rf.Unit(signs * np.float32(0.02), role="fixed", body=1), [0, 0, 0, 1, 0, 0, 0])
    ids = []
    for one, place in zip(links, places(links)):
        unit = rf.Unit(signs * np.array(one["half"], np.float32), mass_kg=one["mass"], body=1, inertia_kg_m2=moments(one))
        ids.append(world.add(unit, [*place, 1, 0, 0, 0]))
        parent = ids[-2] if len(ids) > 1 else base
        world.join(ids[-1], parent, one["pivot"], one["parent_pivot"], kind="revolute", axis=one["axis"])

    def energy():
        total = 0.0
        for one, unit in zip(links, ids):
            pose, motion = np.asarray(world.pose(unit), np.float64), np.asarray(world.velocity(unit), np.float64)
            spin = rotation(pose[3:]).T @ motion[3:]
            total += one["mass"] * (motion[:3] @ motion[:3] / 2 + GRAVITY * pose[2]) + spin @ (np.array(moments(one)) * spin) / 2
        return total

    def apart():
        worst = 0.0
        for number, one in enumerate(links):
            own, above = (np.asarray(world.pose(unit), np.float64) for unit in (ids[number], ids[number - 1] if number else base))
            gap = own[:3] + rotation(own[3:]) @ one["pivot"] - above[:3] - rotation(above[3:]) @ one["parent_pivot"]
            worst = max(worst, float(np.linalg.norm(gap)))
        return worst

    read = lambda: [world.joint_position(unit) for unit in ids]  # noqa: E731
    start, drift, gap, angles = energy(), 0.0, 0.0, [read()]
    for _ in range(steps):
        world.step()
        angles.append(read())
        drift, gap = max(drift, abs(energy() - start)), max(gap, apart())
    return np.unwrap(np.array(angles), axis=0), drift, gap


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, nargs="*", default=[30.0, 60.0], help="observed steps a second")
    parser.add_argument("--seconds", type=float, default=2.0)
    arguments = parser.parse_args()
    print("|scene|steps, 1/s|energy, %|MuJoCo's, %|pivots, mm|angles, rad: at 0.5, 1, 1.5, 2 s|")
    print("|---|---|---|---|---|---|")
    for name, links in scenes().items():
        reach = sum(2 * one["half"][0] for one in links)
        scale = sum(one["mass"] for one in links) * GRAVITY * reach
        for rate in arguments.rate:
            steps = round(arguments.seconds * rate)
            (theirs, their_drift), (ours, drift, gap) = by_mujoco(links, rate, steps), by_runtime(links, rate, steps)
            errors = np.abs(ours - np.unwrap(theirs, axis=0)).max(axis=1)
            quarters = [f"{errors[: round(steps * part) + 1].max():.1e}" for part in (0.25, 0.5, 0.75, 1)]
            print(
                f"|{name}|{rate:g}|{100 * drift / scale:.4f}|{100 * their_drift / scale:.6f}|{1e3 * gap:.4f}|{', '.join(quarters)}|",
                flush=True,
            )


if __name__ == "__main__":
    main()
