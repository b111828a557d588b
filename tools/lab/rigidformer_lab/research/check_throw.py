"""Plays a planned throw in PyBullet, the simulator of the training data: does it hit there too?

    cargo run --release -p rigidformer-planning --example throw -- --json > throw.json
    python -m rigidformer_lab.research.check_throw throw.json
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path

import numpy as np

from ..movi import FRAME_RATE_HZ, GRAVITY_M_S2, GROUND_FRICTION, GROUND_RESTITUTION, MATERIALS, PRIMITIVE_SUB_STEPS

# As in planning/examples/throw/scene.rs.
BALL_RADIUS_M = 0.35
WALL_HALF_M = (0.24, 0.80, 0.50)
START_M = ((0.0, 0.0, 1.0), (1.9, 0.0, 0.5), (3.6, 0.0, 3.1))
BALL, WALL, TARGET = range(3)


def play(velocity, spin, seconds, step_s):
    """Centres (frames, 3 bodies, 3) at 240 Hz of a throw with a mean velocity over the step before frame 0."""
    import pybullet as pb

    client = pb.connect(pb.DIRECT)
    on = {"physicsClientId": client}
    try:
        pb.setPhysicsEngineParameter(restitutionVelocityThreshold=0.0, warmStartingFactor=0.0, useSplitImpulse=True,
                                     contactSlop=0.0, enableConeFriction=False, deterministicOverlappingPairs=True, **on)
        pb.setGravity(*GRAVITY_M_S2, **on)
        pb.setTimeStep(1.0 / (FRAME_RATE_HZ * PRIMITIVE_SUB_STEPS), **on)
        floor = pb.createMultiBody(0, pb.createCollisionShape(pb.GEOM_PLANE, **on), useMaximalCoordinates=True, **on)
        pb.changeDynamics(floor, -1, contactProcessingThreshold=0, lateralFriction=GROUND_FRICTION,
                          restitution=GROUND_RESTITUTION, mass=0, **on)
        sphere = 4 / 3 * math.pi * BALL_RADIUS_M**3
        shapes = (
            ("metal", sphere, dict(shapeType=pb.GEOM_SPHERE, radius=BALL_RADIUS_M)),
            ("metal", 8 * math.prod(WALL_HALF_M), dict(shapeType=pb.GEOM_BOX, halfExtents=WALL_HALF_M)),
            ("rubber", sphere, dict(shapeType=pb.GEOM_SPHERE, radius=BALL_RADIUS_M)),
        )
        bodies = []
        for number, ((material, volume, shape), place) in enumerate(zip(shapes, START_M)):
            friction, restitution, density = MATERIALS[material]
            mass = 0.0 if number == WALL else density * volume  # PyBullet never moves what has no mass
            body = pb.createMultiBody(mass, pb.createCollisionShape(**shape, **on), basePosition=place,
                                      useMaximalCoordinates=True, **on)
            pb.changeDynamics(body, -1, contactProcessingThreshold=0, lateralFriction=friction,
                              restitution=restitution, mass=mass, **on)
            bodies.append(body)
        # Falling since half a step.
        fall = np.array(GRAVITY_M_S2) * step_s / 2
        pb.resetBaseVelocity(bodies[BALL], np.array(velocity) + fall, spin or (0, 0, 0), **on)
        pb.resetBaseVelocity(bodies[TARGET], fall, (0, 0, 0), **on)
        centres = []
        for _ in range(round(seconds * FRAME_RATE_HZ) + 1):
            centres.append([pb.getBasePositionAndOrientation(body, **on)[0] for body in bodies])
            for _ in range(PRIMITIVE_SUB_STEPS):
                pb.stepSimulation(**on)
        return np.array(centres)
    finally:
        pb.disconnect(client)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.research.check_throw", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("throw", type=Path, help="what the example throw printed with --json")
    options = parser.parse_args(arguments)
    try:
        document = json.loads(options.throw.read_text())
        throws = {name: document[name] for name in ("planned", "straight")}
        last = np.array(document["poses"])[-1, :, :3]
        step_s, steps = document["step"] / FRAME_RATE_HZ, document["steps"]
    except (OSError, ValueError, KeyError) as error:
        print(f"error: {options.throw}: not what the example throw prints with --json ({error})", file=sys.stderr)
        return 1
    for name, throw in throws.items():
        centres = play(throw["velocity_m_s"], throw["spin_rad_s"], steps * step_s, step_s)
        apart = np.linalg.norm(centres[:, TARGET] - centres[:, BALL], axis=1).min()
        moved = centres[-1, TARGET] - centres[0, TARGET]
        print(f"{name}: centres {apart:.2f} m apart at least ({throw['miss_m']:.2f} by the model), target moved "
              f"({moved[0]:.2f}, {moved[1]:.2f}) m ({throw['target_moved_m'][0]:.2f}, {throw['target_moved_m'][1]:.2f})")
        if name == "planned":
            away = np.linalg.norm(centres[-1, TARGET] - last[TARGET])
            print(f"planned: after {steps * step_s:.1f} s the target is {away:.2f} m from the model's, the ball "
                  f"{np.linalg.norm(centres[-1, BALL] - last[BALL]):.2f} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
