"""The rendered video: shaded units between planes, with shadows, in the colours of the program's pictures."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..roles import DRIVEN, FIXED, FREE
from .camera import Camera
from .looks import SHEET_LIFT, SMOOTH, SMOOTH_SOFT, smooth_normals, surface, twins
from .motion import Record, alone, matrices
from .raster import Buffer, cut, fragments

#: Samples per pixel and axis.
SAMPLES = 3
#: Nearer than this nothing is drawn, metres.
NEAR_M = 0.05
#: From here on the grid of planes is one of metres, nearer of decimetres.
METRES_FROM_M = 2.5
SKY = np.array([0.955, 0.965, 0.98], np.float32)
#: Of a level plane in the light.
GROUND = np.array([0.86, 0.875, 0.895], np.float32)
GRID = np.array([0.70, 0.72, 0.76], np.float32)
#: Share of the ground's light that a plane has which stands upright, and that is left in a shadow.
UPRIGHT, SHADOW = 0.88, 0.66
#: Half the width of a grid line, and how far in front of its surface a point is drawn, as shares of the distance between two lines.
GRID_HALF, POINT_LIFT = 0.012, 0.02
#: Half the width of the lines between the triangles of a sheet, samples, and the light that is left there. Without them a smooth sheet
#: hides how it is bent.
LINE_HALF, LINE = 0.75, 0.80
#: Colours of free units. The first eight are told apart also without colour vision.
COLOURS = np.array([[0.26, 0.53, 0.84], [0.95, 0.58, 0.20], [0.25, 0.66, 0.44], [0.87, 0.33, 0.36], [0.58, 0.45, 0.78],
                    [0.96, 0.80, 0.30], [0.30, 0.72, 0.80], [0.90, 0.52, 0.72], [0.62, 0.47, 0.36], [0.60, 0.63, 0.68]])  # fmt: skip
OF_ROLE = {DRIVEN: np.array([0.24, 0.26, 0.30]), FIXED: np.array([0.76, 0.76, 0.74])}


def colour_of(unit: int, role: int) -> np.ndarray:
    """A colour of their own for free units. Driven ones are dark, fixed ones grey."""
    return OF_ROLE.get(int(role), COLOURS[unit % len(COLOURS)])


class Stage:
    """A scene as a camera sees it. away_m: how far off its units are."""

    def __init__(self, record: Record, camera: Camera, away_m: float):
        self.record, self.camera = record, camera
        self.grid_m = 0.1 if away_m < METRES_FROM_M else 1.0
        self.size = camera.size[0] * SAMPLES, camera.size[1] * SAMPLES
        right, _, forward = camera.axes
        light = np.array([0.0, 0.0, 1.0]) - right * 0.45 - forward * 0.25  # high, from behind the viewer's left shoulder
        self.light = light / np.linalg.norm(light)
        self._rigid()
        self._soft()
        self._planes()

    def _rigid(self):
        record, corners, normals, owner, dots = self.record, [], [], [], []
        for unit in np.flatnonzero(~record.soft):
            points, pieces = surface(record.points[unit], record.pieces[unit])
            if not pieces:  # what has no surface is its points
                dots.append((unit, record.points[unit].astype(np.float64)))
            for faces in pieces:
                own = points[faces].astype(np.float64)
                corners.append(own)
                normals.append(smooth_normals(own, faces, SMOOTH))
                owner.append(np.full(len(own), unit))
        nothing = [np.zeros((0, 3, 3))]
        self.corners, self.normals = np.concatenate(corners or nothing), np.concatenate(normals or nothing)
        self.owner = np.concatenate(owner) if owner else np.zeros(0, np.int64)
        self.dots = dots
        self.colours = np.array([colour_of(unit, role) for unit, role in enumerate(record.role)])

    def _soft(self):
        """Of each soft body its first unit, its triangles, and the points of one without triangles."""
        record = self.record
        units = np.flatnonzero(record.soft)
        self.twins = twins(record)
        counts = [len(record.points[unit]) for unit in units]
        row_unit = np.repeat(units, counts)
        body = alone(record.body)
        self.soft_bodies = []
        for number in dict.fromkeys(body[units].tolist()):
            rows = np.flatnonzero(body[row_unit] == number) if len(row_unit) else np.zeros(0, np.int64)
            faces = record.faces[np.isin(record.faces[:, 0], rows)] if len(record.faces) else record.faces
            self.soft_bodies.append((int(units[body[units] == number][0]), faces, rows))

    def _planes(self):
        """What each sample sees of the planes, which does not change: the plane, how it fades, and how much of a grid line it is on."""
        wide, high = self.size
        camera, count = self.camera, self.size[0] * self.size[1]
        self.plane = np.full(count, -1, np.int8)
        self.fade, self.tone, self.on_grid = (np.zeros(count, np.float32) for _ in range(3))
        for rows in range(0, high, 256):
            y, x = np.mgrid[rows : min(rows + 256, high), :wide]
            own = slice(rows * wide, rows * wide + x.size)
            across = ((x.ravel() + 0.5) / SAMPLES - camera.size[0] / 2) / camera.focal
            down = ((y.ravel() + 0.5) / SAMPLES - camera.size[1] / 2) / camera.focal
            ray = camera.axes[2] + across[:, None] * camera.axes[0] + down[:, None] * camera.axes[1]
            nearest = np.full(x.size, np.inf)
            for number, plane in enumerate(self.record.planes):
                normal, above = plane[:3], float(plane[:3] @ camera.eye - plane[3])
                climb = ray @ normal
                with np.errstate(divide="ignore", invalid="ignore"):
                    depth = -above / climb
                # A plane is seen from its free side only.
                sees = np.flatnonzero((climb < 0) & (depth > NEAR_M) & (depth < nearest))
                nearest[sees] = depth[sees]
                points = camera.eye + ray[sees] * depth[sees, None]
                axis = np.array([1.0, 0, 0]) if abs(normal[0]) < 0.9 else np.array([0, 1.0, 0])
                axis = axis - normal * (normal @ axis)
                axis = axis / np.linalg.norm(axis)
                lines = np.stack((points @ axis, points @ np.cross(normal, axis))) / self.grid_m
                is_on = np.abs(lines - np.round(lines)).min(0) < GRID_HALF
                fade = np.exp(-((depth[sees] / max(above, self.grid_m) / 7) ** 2))
                at = sees + own.start
                self.plane[at], self.fade[at], self.on_grid[at] = number, fade, np.where(is_on, fade, 0)
                self.tone[at] = UPRIGHT + (1 - UPRIGHT) * abs(normal[2])

    def pixels(self, poses: np.ndarray, soft: np.ndarray) -> np.ndarray:
        """(height, width, 3) The units in these poses (M, 7), and soft points (W, 3), in the world."""
        record = self.record
        turn = matrices(poses)
        own = turn[self.owner]
        corners = np.einsum("tij,tkj->tki", own, self.corners) + poses[self.owner, None, :3]
        normals = np.einsum("tij,tkj->tki", own, self.normals)
        owner, lift = self.owner, np.zeros(len(self.owner))
        dots = [(unit, points @ turn[unit].T + poses[unit, :3]) for unit, points in self.dots]
        for unit, faces, rows in self.soft_bodies:
            if not len(faces):
                dots.append((unit, soft[rows]))
                continue
            placed = soft[faces]
            sheet = smooth_normals(placed, self.twins[faces], SMOOTH_SOFT)
            facing = (np.cross(placed[:, 1] - placed[:, 0], placed[:, 2] - placed[:, 0]) * (self.camera.eye - placed[:, 0])).sum(1)
            sheet[facing < 0] *= -1  # seen from both sides
            side_m = np.linalg.norm(placed[:, 1] - placed[:, 0], axis=1).mean()
            corners, normals = np.concatenate((corners, placed)), np.concatenate((normals, sheet))
            owner = np.concatenate((owner, np.full(len(faces), unit)))
            lift = np.concatenate((lift, np.full(len(faces), SHEET_LIFT * side_m)))
        canvas = self._ground(corners)
        # What goes through a plane is seen all the same: that a prediction does so must not be hidden.
        buffer = Buffer(len(canvas))
        self._triangles(canvas, buffer, corners, normals, owner, lift)
        for unit, points in dots:
            free = FREE if record.soft[unit] else record.role[unit]
            self._dots(canvas, buffer, points, 0.45 * colour_of(unit, free))
        width, height = self.camera.size
        mean = canvas.reshape(height, SAMPLES, width, SAMPLES, 3).mean((1, 3))
        return np.floor(255 * mean.clip(0, 1) + 0.5).astype(np.uint8)

    def _seen(self, points: np.ndarray) -> np.ndarray:
        return (points - self.camera.eye) @ self.camera.axes.T

    def _places(self, seen: np.ndarray) -> np.ndarray:
        return SAMPLES * self.camera.places(seen, NEAR_M)

    def _ground(self, corners: np.ndarray) -> np.ndarray:
        """(samples, 3) The planes, and the shadows of triangles (T, 3, 3) on them."""
        light = np.ones(len(self.plane), np.float32)
        for number, plane in enumerate(self.record.planes):
            shadow = self._shadow(corners, plane)
            if shadow is not None:
                light = np.where(self.plane == number, 1 - (1 - SHADOW) * shadow, light)
        lit = GROUND + (GRID - GROUND) * self.on_grid[:, None]
        lit *= (self.tone * light)[:, None]
        return SKY + (lit - SKY) * np.where(self.plane >= 0, self.fade, 0)[:, None]

    def _shadow(self, corners: np.ndarray, plane: np.ndarray) -> np.ndarray | None:
        """(samples) How much of a plane lies in shadow, with soft edges. Light that comes flat or from behind casts none."""
        fall = float(plane[:3] @ self.light)
        if not fall > 0.05 or not len(corners):
            return None
        height = np.maximum(corners @ plane[:3] - plane[3], 0)
        seen = self._seen(corners - self.light * (height / fall)[..., None])
        seen, _ = cut(seen, seen[..., 2], NEAR_M)
        mask = np.zeros(len(self.plane), np.float32)
        for _, at, _ in fragments(self._places(seen), *self.size):
            mask[at] = 1
        mask = mask.reshape(self.size[::-1])
        for _ in range(2):
            for axis in (1, 0):
                mask = uniform_filter1d(mask, 4 * SAMPLES + 1, axis, mode="constant")
        return mask.ravel()

    def _shades(self, corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """(T, 3, 2) Factor of the surface's own colour, and white added to it."""
        view = self.camera.eye - corners
        view = view / np.linalg.norm(view, axis=-1, keepdims=True).clip(1e-12)
        half = self.light + view
        half = half / np.linalg.norm(half, axis=-1, keepdims=True).clip(1e-12)
        direct, fill = (normals @ self.light).clip(0), (normals * view).sum(-1).clip(0)
        gloss = 0.14 * (normals * half).sum(-1).clip(0) ** 24
        return np.stack((0.44 + 0.20 * (0.5 + 0.5 * normals[..., 2]) + 0.36 * direct + 0.12 * fill, gloss), -1)

    def _triangles(self, canvas, buffer: Buffer, corners, normals, owner, lift):
        whole = (self._seen(corners)[..., 2] >= NEAR_M).all(1)
        both, source = cut(np.concatenate((corners, normals), -1), self._seen(corners)[..., 2], NEAR_M)
        corners, normals = both[..., :3], both[..., 3:]
        colour, lift = self.colours[owner[source]], lift[source]
        seen, shades = self._seen(corners), self._shades(corners, normals)
        seen[..., 2] = np.maximum(seen[..., 2], NEAR_M)
        places = self._places(seen)
        inverse = 1 / np.maximum(seen[..., 2] - lift[:, None], 0.5 * seen[..., 2])
        lined = whole[source] & (lift > 0)  # a line along a cut would be none between two triangles
        a, b, c = (places[:, k] for k in range(3))
        area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        sides = np.stack([np.linalg.norm(p - q, axis=1).clip(1e-6) for p, q in ((b, c), (c, a), (a, b))], 1)
        heights = np.where(lined[:, None], area[:, None] / sides, np.inf)
        for triangle, at, weights in fragments(places, *self.size):
            ahead = buffer.put(at, (weights * inverse[triangle]).sum(1))
            own, weight = triangle[ahead], weights[ahead]
            shade = np.einsum("nk,nkd->nd", weight, shades[own])
            with np.errstate(invalid="ignore"):
                apart = np.where(lined[own, None], weight * heights[own], np.inf).min(1)
            left = np.where(apart < LINE_HALF, LINE, 1.0)
            canvas[at[ahead]] = (left[:, None] * (colour[own] * shade[:, :1] + shade[:, 1:])).clip(0, 1)

    def _dots(self, canvas, buffer: Buffer, points: np.ndarray, colour: np.ndarray):
        seen = self._seen(points)
        seen = seen[seen[:, 2] > NEAR_M]
        places = np.floor(self._places(seen) + 0.5)
        inside = ((places > -8) & (places < np.array(self.size) + 8)).all(1)
        places, depth = places[inside].astype(np.int64), seen[inside, 2] - POINT_LIFT * self.grid_m
        radius = SAMPLES * 1.15
        dy, dx = (offset.ravel() for offset in np.mgrid[-4:5, -4:5])
        round_ = dx**2 + dy**2 <= radius**2
        wide, high = self.size
        for x, y in zip(dx[round_], dy[round_]):
            column, row = places[:, 0] + x, places[:, 1] + y
            own = np.flatnonzero((column >= 0) & (column < wide) & (row >= 0) & (row < high))
            at = row[own] * wide + column[own]
            # In front of the surface that it lies on, not of others.
            at = at[(buffer.inverse[at] == 0) | (depth[own] * buffer.inverse[at] < 1)]
            canvas[at] += (colour - canvas[at]) * 0.75
