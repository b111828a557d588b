"""A world in PyBullet in which a ball pushes a cube over the ground, for the example `push` of rigidformer-planning.

    python -m rigidformer_lab.push_world

Reads a request a line from stdin and writes an answer a line to stdout, both JSON objects; ends with stdin. What cannot be
done is answered with {"error": text}, and the world is what it was.

    {"do": "reset", "seed": S}      a cube at rest, the ball beside it, and a goal, drawn from S alone
    {"do": "act", "path": P}        moves the ball along P: places [x, y] after each frame
    {"do": "rollout", "paths": [{"from": [x, y], "path": P}, ...]}
                                    the cube's poses after each frame of each path, from here, with the ball put to
                                    `from` first; the world stays as it is
    {"do": "close"}                 ends

A pose is [x, y, z, w, x, y, z]: position in metres and quaternion. `reset` answers with `frame_s` (seconds a frame),
`gravity_m_s2`, `ground` (friction, restitution), `cube` and `pusher` (`points` in the body's frame, `mass_kg`, `friction`,
`restitution`), `radius_m` of the ball, `edge_m` of the cube, `goal` ([x, y, yaw]) and the poses. `act` and `reset` give the
poses as `previous` and `current`, a frame apart, each {"cube": pose, "pusher": pose}. `rollout` answers with `poses` (paths,
frames, 7) of the cube.

The ball is moved by its velocity, set before each of the engine's steps of 1/240 s; it weighs 1000 times the cube and
feels nothing of it. It does not turn, keeps its height, and touches only the cube. The engine has PyBullet's own settings,
gravity 9.81 m/s2, and `plane.urdf` with friction 1, so that the cube and the ground have the cube's friction, .5, as the
cube and the ball have.

The seed draws, uniformly: the cube's turn, any (it lies at the origin); the direction of the goal, any, and its distance,
.1 to .3 m; how far the goal is turned from the cube, -60 to 60 degrees; the direction of the ball, any; it is .12 m from
the cube.
"""

from __future__ import annotations

import argparse
import json
import os
import sys

import numpy as np

from . import bullet

FRAME_S, SUB_STEPS = 1 / 60, 4
GRAVITY_M_S2 = (0.0, 0.0, -9.81)
EDGE_M, CUBE_KG, FRICTION, RESTITUTION = 0.05, 0.1, 0.5, 0.0
GROUND = (1.0, 0.0)  # friction, restitution
RADIUS_M, PUSHER_KG, PUSHER_FRICTION = 0.015, 100.0, 1.0
HEIGHT_M = 0.02
AWAY_M = 0.12
GOAL_M, GOAL_TURN_RAD = (0.1, 0.3), np.radians(60)
SETTLE_FRAMES = 30
BALL_POINTS = 128
REACH_M = 10.0
FASTEST_M_S = 2.0


class RequestError(ValueError):
    """A request cannot be met. The message says what would be right."""


def ball_points(count: int = BALL_POINTS) -> np.ndarray:
    """(count, 3) evenly over the ball, along a spiral."""
    index = np.arange(count)
    z = 1 - (2 * index + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * index
    across = np.sqrt(1 - z * z)
    return RADIUS_M * np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


class World:
    """The cube, the ball and the ground."""

    def __init__(self, pb, on: dict, seed: int):
        self.pb, self.on = pb, on
        rng = np.random.default_rng((seed, 81))
        turn, heading, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2 * np.pi), rng.uniform(*GOAL_M)
        turned, side = rng.uniform(-GOAL_TURN_RAD, GOAL_TURN_RAD), rng.uniform(0, 2 * np.pi)
        yaw = (turn + turned + np.pi) % (2 * np.pi) - np.pi
        self.goal = (distance * np.cos(heading), distance * np.sin(heading), yaw)
        self.place = np.array([AWAY_M * np.cos(side), AWAY_M * np.sin(side)])

        pb.resetSimulation(**on)
        pb.setPhysicsEngineParameter(deterministicOverlappingPairs=True, **on)
        pb.setGravity(*GRAVITY_M_S2, **on)
        pb.setTimeStep(FRAME_S / SUB_STEPS, **on)
        ground = pb.loadURDF(bullet.data_file("plane.urdf"), useFixedBase=True, **on)
        pb.changeDynamics(ground, -1, lateralFriction=GROUND[0], restitution=GROUND[1], **on)
        box = pb.createCollisionShape(pb.GEOM_BOX, halfExtents=[EDGE_M / 2] * 3, **on)
        self.cube = pb.createMultiBody(CUBE_KG, box, basePosition=(0, 0, EDGE_M / 2),
                                       baseOrientation=pb.getQuaternionFromEuler((0, 0, turn)), **on)
        pb.changeDynamics(self.cube, -1, lateralFriction=FRICTION, restitution=RESTITUTION, **on)
        ball = pb.createCollisionShape(pb.GEOM_SPHERE, radius=RADIUS_M, **on)
        self.pusher = pb.createMultiBody(PUSHER_KG, ball, basePosition=(*self.place, HEIGHT_M), **on)
        pb.changeDynamics(self.pusher, -1, lateralFriction=PUSHER_FRICTION, restitution=RESTITUTION, linearDamping=0.0,
                          angularDamping=0.0, **on)
        pb.setCollisionFilterPair(ground, self.pusher, -1, -1, 0, **on)
        self.previous = None
        for _ in range(SETTLE_FRAMES):
            self.frame(self.place)

    def poses(self) -> dict:
        return {"cube": bullet.pose_of(self.pb, self.on, self.cube), "pusher": bullet.pose_of(self.pb, self.on, self.pusher)}

    def frame(self, place) -> None:
        """Moves the ball to a place within a frame, at an even speed."""
        self.previous = self.poses()
        step_s = FRAME_S / SUB_STEPS
        begin, end = self.place, np.asarray(place, float)
        for step in range(1, SUB_STEPS + 1):
            now = np.array(self.pb.getBasePositionAndOrientation(self.pusher, **self.on)[0])
            to = np.array([*(begin + (end - begin) * step / SUB_STEPS), HEIGHT_M])
            # Gravity acts before the ball moves.
            velocity = (to - now) / step_s - np.array(GRAVITY_M_S2) * step_s
            self.pb.resetBaseVelocity(self.pusher, velocity, (0, 0, 0), **self.on)
            self.pb.stepSimulation(**self.on)
        self.place = end

    def act(self, path: np.ndarray) -> None:
        for place in path:
            self.frame(place)

    def put(self, place) -> None:
        """Puts the ball to a place, at rest."""
        self.place = np.asarray(place, float)
        self.pb.resetBasePositionAndOrientation(self.pusher, (*self.place, HEIGHT_M), (0, 0, 0, 1), **self.on)

    def rollout(self, paths: list[tuple[np.ndarray, np.ndarray]]) -> list[list[tuple[float, ...]]]:
        """(paths, frames, 7) the cube's poses; the world is then what it was."""
        state, place, previous = self.pb.saveState(**self.on), self.place, self.previous
        found = []
        try:
            for begin, path in paths:
                self.put(begin)
                frames = []
                for point in path:
                    self.frame(point)
                    frames.append(bullet.pose_of(self.pb, self.on, self.cube))
                found.append(frames)
                self.pb.restoreState(stateId=state, **self.on)
                self.place = place
        finally:
            self.pb.restoreState(stateId=state, **self.on)
            self.pb.removeState(state, **self.on)
            self.place, self.previous = place, previous
        return found

    def observed(self) -> dict:
        return {"previous": self.previous, "current": self.poses()}

    def description(self) -> dict:
        corners = np.array(np.meshgrid(*[(-EDGE_M / 2, EDGE_M / 2)] * 3, indexing="ij")).reshape(3, -1).T
        body = {"restitution": RESTITUTION}
        return {
            "frame_s": FRAME_S, "gravity_m_s2": GRAVITY_M_S2, "ground": GROUND, "edge_m": EDGE_M, "radius_m": RADIUS_M,
            "cube": {"points": corners.tolist(), "mass_kg": CUBE_KG, "friction": FRICTION, **body},
            "pusher": {"points": ball_points().tolist(), "mass_kg": PUSHER_KG, "friction": PUSHER_FRICTION, **body},
            "goal": self.goal, **self.observed(),
        }


def rollout_of(value) -> tuple[np.ndarray, np.ndarray]:
    """Where a path begins, and the path, checked."""
    if not isinstance(value, dict):
        raise RequestError('`paths` are objects {"from": [x, y], "path": [[x, y], ...]}')
    begin = path_of([value.get("from")])[0]
    return begin, path_of(value.get("path"), begin)


def path_of(value, start=None) -> np.ndarray:
    """(frames, 2) a path, checked."""
    try:
        path = np.array(value, float)
    except (TypeError, ValueError):
        path = np.empty(0)
    if path.ndim != 2 or path.shape[1] != 2 or not len(path) or not np.isfinite(path).all():
        raise RequestError("a path is a list of at least one [x, y], in metres")
    if np.abs(path).max() > REACH_M:
        raise RequestError(f"a path leads beyond {REACH_M:g} m")
    begin = path[0] if start is None else start
    speed = np.linalg.norm(np.diff(path, axis=0, prepend=[begin]), axis=1).max() / FRAME_S
    if speed > FASTEST_M_S:
        raise RequestError(f"a path moves at {speed:.2g} m/s; at most {FASTEST_M_S:g} m/s can be driven")
    return path


def answer(pb, on: dict, world: World | None, request: dict) -> tuple[World | None, dict]:
    """The world after a request, and what is answered."""
    what = request.get("do")
    if what == "reset":
        seed = request.get("seed")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise RequestError("`seed` is a whole number from 0 to 2^63 - 1")
        world = World(pb, on, seed)
        return world, world.description()
    if what not in ("act", "rollout"):
        raise RequestError(f"`do` is {what!r}; it is reset, act, rollout or close")
    if world is None:
        raise RequestError(f"`{what}` before the first `reset`")
    if what == "act":
        world.act(path_of(request.get("path"), world.place))
        return world, world.observed()
    paths = request.get("paths")
    if not isinstance(paths, list):
        raise RequestError("`paths` is a list of paths")
    return world, {"poses": world.rollout([rollout_of(path) for path in paths])}


def serve(lines, out) -> None:
    """Answers requests until `close` or the last line."""
    with bullet.world() as (pb, on):
        world = None
        for line in lines:
            try:
                try:
                    request = json.loads(line)
                except ValueError as error:
                    raise RequestError(f"a request is not JSON: {error}") from error
                if not isinstance(request, dict):
                    raise RequestError("a request is a JSON object")
                if request.get("do") == "close":
                    return
                world, found = answer(pb, on, world, request)
            except RequestError as error:
                found = {"error": str(error)}
            print(json.dumps(found), file=out, flush=True)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m rigidformer_lab.push_world", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args(arguments)
    # The engine's own words go to stderr: stdout has answers alone.
    out = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        import pybullet  # noqa: F401
    except ImportError as error:
        print(f"error: {error}; install the lab with tools/lab/setup.sh", file=sys.stderr)
        return 1
    try:
        serve(sys.stdin, out)
    except (KeyboardInterrupt, BrokenPipeError):
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
