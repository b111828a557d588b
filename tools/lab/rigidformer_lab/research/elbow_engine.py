"""Rolls recorded elbow tosses out in PyBullet, with the hinge between the boxes, and prints the errors of `rigidformer evaluate`.

    python -m rigidformer_lab.research.elbow_engine elbow.safetensors

Each toss begins with the recorded poses and velocities of frame 0. Errors are means over all later frames of a toss and both
boxes, then over tosses. The engine has the file's masses, inertias, friction and restitution; nothing is fitted. `--joint` says
what holds the boxes: the hinge as built (`hinge`), its pivot alone (`point`), or nothing (`none`).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from ..bullet import add_plane, paced_world, steady_signs
from ..elbow import AXIS, EDGES_M, PIVOT_1_M, PIVOT_2_M
from ..geometry import quaternion_to_matrix
from ..scenes import TEST, read_scenes

STEPS_A_FRAME = 8


def _xyzw(pose):
    w, x, y, z = pose[3:]
    return [x, y, z, w]


def roll(poses, velocity, physics, inertia, plane, gravity, rate, frames, joint):
    """(2, frames, 7) poses of the boxes. poses: (2, 7) at frame 0, velocity: (2, 6)."""
    out = np.empty((2, frames, 7))
    out[:, 0] = poses
    with paced_world(gravity, 1 / (rate * STEPS_A_FRAME)) as (pb, on):
        add_plane(pb, on, plane)
        box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=np.array(EDGES_M) / 2, **on)
        mass, friction, restitution = (float(value) for value in physics[0])
        if joint == "none":
            bodies = [pb.createMultiBody(mass, box, basePosition=pose[:3], baseOrientation=_xyzw(pose), **on) for pose in poses]
            links = [(body, -1) for body in bodies]
            pb.setCollisionFilterPair(*bodies, -1, -1, 0, **on)
        else:
            turn = [quaternion_to_matrix(pose[3:] / np.linalg.norm(pose[3:])) for pose in poses]
            # A link's frame has its origin in the joint.
            hung = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=np.array(EDGES_M) / 2, collisionFramePosition=-PIVOT_2_M, **on)
            kind = pb.JOINT_REVOLUTE if joint == "hinge" else pb.JOINT_SPHERICAL
            body = pb.createMultiBody(
                mass, box, basePosition=poses[0, :3], baseOrientation=_xyzw(poses[0]), linkMasses=[mass],
                linkCollisionShapeIndices=[hung], linkVisualShapeIndices=[-1], linkPositions=[PIVOT_1_M],
                linkOrientations=[[0, 0, 0, 1]], linkInertialFramePositions=[-PIVOT_2_M],
                linkInertialFrameOrientations=[[0, 0, 0, 1]], linkParentIndices=[0], linkJointTypes=[kind],
                linkJointAxis=[AXIS], flags=pb.URDF_USE_SELF_COLLISION_EXCLUDE_ALL_PARENTS, **on,
            )  # fmt: skip
            links = [(body, -1), (body, 0)]
            relative = turn[0].T @ turn[1]
            spin = turn[0].T @ (velocity[1, 3:] - velocity[0, 3:])
            if joint == "hinge":
                angle = np.arctan2(relative[0, 2], relative[0, 0])
                pb.resetJointState(body, 0, angle, float(spin @ AXIS), **on)
                pb.setJointMotorControl2(body, 0, pb.VELOCITY_CONTROL, force=0, **on)
            else:
                x, y, z, w = _relative(poses)
                pb.resetJointStateMultiDof(body, 0, [x, y, z, w], (relative.T @ spin).tolist(), **on)
                pb.setJointMotorControlMultiDof(body, 0, pb.POSITION_CONTROL, targetPosition=[0, 0, 0, 1], positionGain=0,
                                                velocityGain=0, force=[0, 0, 0], **on)
        for number, (body, link) in enumerate(links):
            pb.changeDynamics(body, link, lateralFriction=friction, restitution=restitution, linearDamping=0,
                              angularDamping=0, jointDamping=0, localInertiaDiagonal=[float(v) for v in inertia[number]], **on)
            if link == -1:
                pb.resetBaseVelocity(body, velocity[number, :3].tolist(), velocity[number, 3:].tolist(), **on)
        for frame in range(1, frames):
            for _ in range(STEPS_A_FRAME):
                pb.stepSimulation(**on)
            for number, (body, link) in enumerate(links):
                place, (x, y, z, w) = (
                    pb.getBasePositionAndOrientation(body, **on) if link < 0 else
                    pb.getLinkState(body, link, computeForwardKinematics=True, **on)[:2]
                )  # fmt: skip
                out[number, frame] = [*place, w, x, y, z]
    steady_signs(out)
    return out


def _relative(poses):
    """Quaternion x, y, z, w of the second box in the frame of the first."""
    (w1, x1, y1, z1), (w2, x2, y2, z2) = poses[0, 3:], poses[1, 3:]
    left = np.array([[w1, x1, y1, z1], [-x1, w1, z1, -y1], [-y1, -z1, w1, x1], [-z1, y1, -x1, w1]])
    w, x, y, z = left @ [w2, x2, y2, z2]
    return x, y, z, w


def errors(found, truth):
    """Means over later frames and boxes: metres, degrees."""
    position = np.linalg.norm(found[:, 1:, :3] - truth[:, 1:, :3], axis=-1).mean()
    cosine = np.abs((found[:, 1:, 3:] * truth[:, 1:, 3:]).sum(-1)) / np.linalg.norm(truth[:, 1:, 3:], axis=-1)
    return position, np.degrees(2 * np.arccos(np.clip(cosine, 0, 1))).mean()


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.elbow_engine", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tosses", type=Path, help="file of rigidformer_lab.elbow")
    parser.add_argument("--split", type=int, default=TEST, help="0 train, 2 test (default %(default)s)")
    parser.add_argument("--limit", type=int, help="so many tosses (default: all)")
    parser.add_argument("--joint", choices=("hinge", "point", "none"), default="hinge")
    options = parser.parse_args(arguments)
    file = read_scenes(options.tosses)
    found = []
    for scene in file.scenes_of_split(options.split)[: options.limit]:
        rows = list(file.units_of_scene(scene))
        frames = file.frames_of_scene(scene)
        truth = np.asarray(file.unit_poses[rows, :frames], np.float64)
        velocity = np.asarray(file.unit_velocity[rows], np.float64)
        mine = roll(truth[:, 0], velocity, file.unit_physics[rows], file.inertias[rows],
                    file.planes_of_scene(scene)[0].tolist(), file.gravity_m_s2, file.frame_rate_hz, frames, options.joint)
        found.append(errors(mine, truth))
    (metres, degrees), (metres_sd, degrees_sd) = np.mean(found, 0), np.std(found, 0, ddof=1)
    print(json.dumps({"tosses": len(found), "joint": options.joint, "position_m": round(metres, 4),
                      "position_sd_m": round(metres_sd, 4), "rotation_deg": round(degrees, 1),
                      "rotation_sd_deg": round(degrees_sd, 1)}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
