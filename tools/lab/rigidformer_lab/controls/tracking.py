"""The tracking video: points and surfaces without light, in colours that say where they were in the first frame."""

from __future__ import annotations

import numpy as np

from .camera import Camera
from .looks import Shape
from .raster import CHUNK, Buffer, cut, fragments

#: What is nearer to the camera's plane, or behind it, counts as being there, metres.
NEAR_M = 0.01
#: Shares of the points that are farther than blue begins, and nearer than it ends, in per cent.
PERCENTILES = (2, 98)


class Palette:
    """The colours of a video, by the points (N, 3) of its first frame as `Camera.seen` gives them."""

    def __init__(self, camera: Camera, first: np.ndarray):
        self.camera = camera
        deep = first[self.shows(first)]
        deep = deep if len(deep) else first[first[:, 2] >= NEAR_M]
        #: Inverse depths where blue is 0 and 255, 1/m.
        self.inverse_m = np.percentile(1 / deep[:, 2], PERCENTILES) if len(deep) else np.zeros(2)

    def shows(self, seen: np.ndarray) -> np.ndarray:
        """Which points are in the picture, whatever is in front of them."""
        places = self.camera.places(seen, NEAR_M)
        return (seen[:, 2] >= NEAR_M) & (places >= 0).all(1) & (places < self.camera.size).all(1)

    def colours(self, first: np.ndarray) -> np.ndarray:
        """The colours (N, 3) of what was here in the first frame. Beside the picture they are those of its edge."""
        far, near = self.inverse_m
        inverse = 1 / np.maximum(first[:, 2], NEAR_M)
        blue = (inverse - far) / (near - far) if near > far else np.full(len(first), 0.5)
        parts = np.column_stack((self.camera.places(first, NEAR_M) / self.camera.size, blue))
        return np.floor(255 * parts.clip(0, 1) + 0.5).astype(np.uint8)


def frame(palette: Palette, shape: Shape, now: np.ndarray, first: np.ndarray, lift_m: float, side: int):
    """The pixels (height, width, 3) of a frame, and whether anything is in it. now, first: vertices (N, 3) as `Camera.seen` gives them;
    side: of a point's square, pixels."""
    width, height = palette.camera.size
    pixels, buffer = np.zeros((width * height, 3), np.uint8), Buffer(width * height)
    both = np.hstack((now, first))
    for triangles, lift in ((shape.triangles, 0.0), (shape.sheets, lift_m)):
        if len(triangles):
            _surfaces(palette, pixels, buffer, both[triangles], lift)
    _squares(palette, pixels, buffer, both[shape.squares], side)
    return pixels.reshape(height, width, 3), bool((buffer.inverse > 0).any())


def _surfaces(palette: Palette, pixels, buffer: Buffer, corners: np.ndarray, lift_m: float):
    """Triangles, (T, 3, 6): each place has the colour of where it was. They count as so much nearer than they are, which keeps what
    lies right under a sheet from showing through it."""
    corners, _ = cut(corners, corners[..., 2], NEAR_M)
    corners[..., 2] = np.maximum(corners[..., 2], NEAR_M)
    inverse = 1 / corners[..., 2]
    for triangle, at, weights in fragments(palette.camera.places(corners, NEAR_M), *palette.camera.size):
        # Inverse depth is affine over the picture. Places are affine over the surface, so their weights are divided by depth.
        parts = weights * inverse[triangle]
        whole = parts.sum(1)
        ahead = buffer.put(at, 1 / np.maximum(1 / whole - lift_m, 0.5 / whole))
        share = parts[ahead] / whole[ahead, None]
        pixels[at[ahead]] = palette.colours(np.einsum("nk,nkd->nd", share, corners[triangle[ahead], :, 3:]))


def _squares(palette: Palette, pixels, buffer: Buffer, spots: np.ndarray, side: int):
    """Points, (N, 6), as squares about their places."""
    spots = spots[spots[:, 2] >= NEAR_M]
    width, height = palette.camera.size
    colours = palette.colours(spots[:, 3:])
    starts = np.floor(palette.camera.places(spots, NEAR_M) - side / 2 + 0.5)
    near = ((starts > -side) & (starts < palette.camera.size)).all(1)
    spots, starts, colours = spots[near], starts[near].astype(np.int64), colours[near]
    rows, columns = (offset.ravel() for offset in np.mgrid[:side, :side])
    for begin in range(0, len(spots), max(1, CHUNK // side**2)):
        own = slice(begin, begin + max(1, CHUNK // side**2))
        x, y = (starts[own, :1] + columns).ravel(), (starts[own, 1:] + rows).ravel()
        spot = np.repeat(np.arange(len(starts))[own], side**2)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        at, spot = (y * width + x)[inside], spot[inside]
        ahead = buffer.put(at, 1 / spots[spot, 2])
        pixels[at[ahead]] = colours[spot[ahead]]
