"""Triangles to pixels, with a depth buffer."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

#: Fragments worked on at a time, which bounds memory.
CHUNK = 1 << 20


def cut(corners: np.ndarray, depth: np.ndarray, near: float) -> tuple[np.ndarray, np.ndarray]:
    """The parts of triangles that are at least so deep, as triangles. corners: (T, 3, K) numbers that are affine over a triangle;
    depth: (T, 3). Gives the new corners (N, 3, K) and the triangle (N) that each is of."""
    front = depth >= near
    whole = np.flatnonzero(front.all(1))
    parts, sources = [corners[whole]], [whole]
    for source in np.flatnonzero(front.any(1) & ~front.all(1)):
        kept = []
        for a, b in ((0, 1), (1, 2), (2, 0)):
            at_a, at_b = depth[source, a], depth[source, b]
            if at_a >= near:
                kept.append(corners[source, a])
            if (at_a >= near) != (at_b >= near):
                share = (near - at_a) / (at_b - at_a)
                kept.append(corners[source, a] + (corners[source, b] - corners[source, a]) * share)
        for b, c in zip(kept[1:], kept[2:]):
            parts.append(np.stack((kept[0], b, c))[None])
            sources.append(np.array([source]))
    return np.concatenate(parts), np.concatenate(sources)


def _ranges(starts: np.ndarray, stops: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All whole numbers of many ranges, and the range that each is of."""
    counts = np.maximum(stops - starts, 0)
    owner = np.repeat(np.arange(len(counts)), counts)
    return np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts - starts, counts), owner


def fragments(places: np.ndarray, width: int, height: int) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Pixels whose middles triangles cover. places: (T, 3, 2) pixels. Yields, for some triangles at a time, the triangle (N), the pixel (N)
    as row * width + column, and the weights of the corners (N, 3)."""
    places = places.astype(np.float64)
    (ax, ay), (bx, by), (cx, cy) = (places[:, k].T for k in range(3))
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    sound = np.isfinite(places).all((1, 2)) & np.isfinite(area) & (np.abs(area) > 1e-12)
    kept = np.flatnonzero(sound)
    low = places[kept, :, 1].min(1).clip(0, height)
    high = places[kept, :, 1].max(1).clip(0, height)
    row, owner = _ranges(np.floor(low).astype(np.int64), np.ceil(high).astype(np.int64))
    triangle = kept[owner]
    # A corner's weight is slope * x + start over a row.
    left, right = np.zeros(len(row)), np.full(len(row), float(width))
    y = row + 0.5
    for p, q in ((1, 2), (2, 0), (0, 1)):
        (px, py), (qx, qy) = places[triangle, p].T, places[triangle, q].T
        slope = -(qy - py) / area[triangle]
        start = ((qx - px) * (y - py) + (qy - py) * px) / area[triangle]
        with np.errstate(divide="ignore", invalid="ignore"):
            bound = -start / slope
        left = np.where(slope > 0, np.maximum(left, bound), left)
        right = np.where(slope < 0, np.minimum(right, bound), right)
        right = np.where((slope == 0) & (start < 0), -1.0, right)
    # One pixel more on either side, for rounding; weights decide.
    first = np.floor(left - 1.5).clip(0, width).astype(np.int64)
    last = np.ceil(right + 1.5).clip(0, width).astype(np.int64)
    ends = np.cumsum(np.maximum(last - first, 0))
    begin = 0
    while begin < len(row):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + CHUNK, "right")))
        column, owner = _ranges(first[begin:end], last[begin:end])
        owner += begin
        own, x, y = triangle[owner], column + 0.5, row[owner] + 0.5
        weights = np.empty((len(own), 3))
        for k, (p, q) in enumerate(((1, 2), (2, 0), (0, 1))):
            (px, py), (qx, qy) = places[own, p].T, places[own, q].T
            weights[:, k] = ((qx - px) * (y - py) - (qy - py) * (x - px)) / area[own]
        inside = (weights >= 0).all(1)
        yield own[inside], (row[owner] * width + column)[inside], weights[inside]
        begin = end


class Buffer:
    """The inverse depth of each pixel, 1/m; 0: nothing is there."""

    def __init__(self, pixels: int):
        self.inverse = np.zeros(pixels)

    def put(self, pixels: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """Which fragments are in front of all others. Where several are equally near the first one counts."""
        ahead = np.flatnonzero(inverse > self.inverse[pixels])
        np.maximum.at(self.inverse, pixels[ahead], inverse[ahead])
        ahead = ahead[inverse[ahead] == self.inverse[pixels[ahead]]]
        _, once = np.unique(pixels[ahead], return_index=True)
        return ahead[once]
