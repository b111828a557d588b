"""Reference geometry of a unit, nearest points, rotations and the rigid projection.

Everything here has a twin in `rigidformer_core::geometry`; the definitions agree
to f32 rounding so that the golden vectors compare the same anchors and orders.
"""

from __future__ import annotations

import numba
import numpy as np
import torch

from .ground import groups, level_ground

#: Kernel radius of the centre's density weights, as a share of the unit's diameter.
DENSITY_RADIUS = 0.2


def canonical_order(points: np.ndarray) -> np.ndarray:
    """Indices that sort points by x, then y, then z: makes all that follows
    independent of the order in which the points were given."""
    return np.lexsort((points[:, 2], points[:, 1], points[:, 0]))


def _sequential_sum(values: np.ndarray) -> np.ndarray:
    return np.add.accumulate(values.astype(np.float32), axis=0, dtype=np.float32)[-1]


def density_centre(points: np.ndarray) -> np.ndarray:
    """Estimate of the centre of mass from points: their mean, each weighted by the
    inverse of the local point density, so that unevenly sampled surfaces do not
    pull it aside. Kernel (1 + (d / h)^2)^-4, h = 0.2 x diameter."""
    p = points.astype(np.float32)
    d2 = np.square(p[:, None] - p[None]).sum(-1, dtype=np.float32)
    diameter2 = d2.max()
    if diameter2 <= 0:
        return p[0].copy()
    q = np.float32(1) + d2 / (np.float32(DENSITY_RADIUS**2) * diameter2)
    q2 = q * q
    weight = np.float32(1) / _sequential_sum(np.float32(1) / (q2 * q2))
    return _sequential_sum(weight[:, None] * p) / _sequential_sum(weight)


#: Subdivision of the octahedron whose lattice points are the directions in which a unit's hull is felt for.
LATTICE = 8
#: A point deeper below the hull than this share of twice the greatest distance from the mean says that the hull is
#: not the unit's shape.
HOLLOW = np.float32(0.08)


def _octahedron(n):
    """Directions (4 n^2 + 2, 3) with |x| + |y| + |z| = n, and the triangles (8 n^2, 3)
    between them, counter-clockwise from outside."""
    rows, directions, triangles = {}, [], []

    def row(*direction):
        if direction not in rows:
            rows[direction] = len(directions)
            directions.append(direction)
        return rows[direction]

    for octant in range(8):
        x, y, z = (1 - 2 * (octant >> axis & 1) for axis in range(3))
        for i in range(n):
            for j in range(n - i):
                k = n - i - j
                a, b, c = (i, j, k), (i + 1, j, k - 1), (i, j + 1, k - 1)
                for corners in [(a, b, c), (b, (i + 1, j + 1, k - 2), c)][: 1 if k < 2 else 2]:
                    p, q, r = (row(x * u, y * v, z * w) for u, v, w in corners)
                    triangles.append((p, q, r) if x * y * z > 0 else (p, r, q))
    return np.array(directions, np.float32), np.array(triangles)


_DIRECTIONS, _TRIANGLES = _octahedron(LATTICE)


def felt_hull(points: np.ndarray):
    """The convex hull, felt for in 258 directions: the points' mean, them from there and how far they reach along each
    direction, six times the volume, and of the centroid's offset from the mean that times it."""
    p = points.astype(np.float32)
    middle = p[0] + _sequential_sum(p - p[0]) / np.float32(len(p))
    p = p - middle
    x, y, z = _DIRECTIONS.T
    dots = (p[:, :1] * x + p[:, 1:2] * y) + p[:, 2:] * z
    support = p[dots.argmax(0)]
    a, b, c = (support[_TRIANGLES[:, i]] for i in range(3))
    volume = (a * np.cross(b, c)).sum(1, dtype=np.float32)
    offset = _sequential_sum(volume[:, None] * ((a + b) + c)) / np.float32(4)
    return middle, (p, dots), _sequential_sum(volume), offset


def hull_centre(points: np.ndarray) -> np.ndarray | None:
    """Centroid of the convex hull, exact to a few millimetres a metre. None if the points are flat, or if some lie so
    deep that the hull is not the unit's shape."""
    middle, (p, dots), total, offset = felt_hull(points)
    radius = np.sqrt(np.square(p).sum(1).max())
    if not total > np.float32(1e-3) * radius**3:
        return None
    depth = ((dots.max(0) - dots) / np.sqrt(np.square(_DIRECTIONS).sum(1))).min(1).max()
    if depth > HOLLOW * 2 * radius:
        return None
    return middle + offset / total


def centre_of_mass(points: np.ndarray) -> np.ndarray:
    """Estimate of the centre of mass from points alone: the centroid of their hull, or
    where that is not the shape, their density-weighted mean."""
    centre = hull_centre(points)
    return density_centre(points) if centre is None else centre


#: Distances this close to the greatest count as equal, so that rounding does not decide
#: between the corners of a symmetric unit.
TIE = np.float32(1 - 1e-4)


def farthest_point_order(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Farthest-point ordering of all points: starts at the point farthest from the
    centre, ties to the lowest index."""
    p = points.astype(np.float32)

    def squared(reference):
        delta = p - reference
        return (delta[:, 0] ** 2 + delta[:, 1] ** 2) + delta[:, 2] ** 2

    def first_farthest(distance):
        return int(np.argmax(distance >= distance.max() * TIE))

    distance = np.full(len(p), np.inf, np.float32)
    order = np.empty(len(p), np.int64)
    index = first_farthest(squared(centre.astype(np.float32)))
    taken = np.zeros(len(p), bool)
    for k in range(len(p)):
        order[k] = index
        taken[index] = True
        if k + 1 == len(p):
            break
        distance = np.minimum(distance, squared(p[index]))
        left = np.where(taken, np.float32(-1), distance)
        far = left.max()
        index = int(np.argmax((left >= far * TIE) & ~taken))
    return order


def prepare_points(points: np.ndarray, centre: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) points -> (N, 3) points relative to their centre in farthest-point
    order, and the centre (3). The first four are the anchors. centre: where it is known."""
    p = points[canonical_order(points)].astype(np.float32)
    centre = centre_of_mass(p) if centre is None else centre
    order = farthest_point_order(p, centre)
    return p[order] - centre, centre


@numba.njit(parallel=True, cache=True, fastmath=False)
def _nearest(query, own, rotation, centre, radius, start, count, bank, scale, group, below, unit_out, local_out):
    batch, units, per_unit, _ = query.shape
    for job in numba.prange(batch * units):
        b = job // units
        m = job % units
        if count[b, m] == 0:
            continue
        for p in range(own[b, m]):
            x = query[b, m, p, 0]
            y = query[b, m, p, 1]
            z = query[b, m, p, 2]
            best = below[b, m, p] * below[b, m, p]
            who = unit_out[b, m, p]
            bx = x * 0
            by = x * 0
            bz = x * 0
            for j in range(units):
                if group[b, j] == group[b, m] or count[b, j] == 0:
                    continue
                dx = x - centre[b, j, 0]
                dy = y - centre[b, j, 1]
                dz = z - centre[b, j, 2]
                gap = np.sqrt(dx * dx + dy * dy + dz * dz) - radius[b, j]
                if gap > 0 and gap * gap > best:
                    continue
                r = rotation[b, j]
                s = 1 / scale[b, j]
                qx = (r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz) * s
                qy = (r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz) * s
                qz = (r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz) * s
                limit = best * s * s
                low = limit
                index = -1
                for k in range(start[b, j], start[b, j] + count[b, j]):
                    ex = bank[k, 0] - qx
                    ey = bank[k, 1] - qy
                    ez = bank[k, 2] - qz
                    e = ex * ex + ey * ey + ez * ez
                    if e < low:
                        low = e
                        index = k
                if index >= 0:
                    best = low * scale[b, j] * scale[b, j]
                    who = j
                    bx = bank[index, 0] * scale[b, j]
                    by = bank[index, 1] * scale[b, j]
                    bz = bank[index, 2] * scale[b, j]
            unit_out[b, m, p] = who
            local_out[b, m, p, 0] = bx
            local_out[b, m, p, 1] = by
            local_out[b, m, p, 2] = bz


def nearest_points(query, own, rotation, centre, radius, start, count, bank, scale, planes=None, group=None):
    """For every query point: the unit of the nearest point of any unit of another group, and
    that point in its unit's frame; or, where a plane is nearer or there is no such unit, what
    `Planes.nearest` names (PLANE - p or NOTHING).

    query (B, M, P, 3) world; own (B, M) query points in use; rotation (B, M, 3, 3);
    centre (B, M, 3); radius, scale (B, M) m, -; start, count (B, M) rows of the
    shape bank (K, 3, at scale 1); planes None: z = 0; group (B, M), None: one each.
    Returns (B, M, P) int64 and (B, M, P, 3)."""
    planes = planes or level_ground(0.0, 0.0, len(query), query)
    group = groups(None, count) if group is None else group
    with torch.no_grad():
        below, unit = planes.nearest(query.detach())
    if query.is_cuda:
        return _nearest_torch(query, rotation, centre, start, count, bank, scale, group, below, unit)
    unit = unit.numpy()
    local = np.zeros(query.shape, query.detach().numpy().dtype)
    arrays = [
        np.ascontiguousarray(t.detach().numpy())
        for t in (query, own, rotation, centre, radius, start, count, bank, scale, group, below)
    ]
    _nearest(*arrays, unit, local)
    return torch.from_numpy(unit), torch.from_numpy(local)


def _nearest_torch(query, rotation, centre, start, count, bank, scale, group=None, below=None, unit=None):
    """Brute force on an accelerator: all pairs, one target unit at a time. below, unit: as `Planes.nearest` has them."""
    b, m, p, _ = query.shape
    longest = int(count.max())
    row = torch.arange(longest, device=query.device)
    if below is None:
        below, unit = level_ground(0.0, 0.0, b, query).nearest(query)
    group = groups(None, count) if group is None else group
    best = below.square()
    local = torch.zeros_like(query)
    for j in range(m):
        index = (start[:, j, None] + row).clamp(max=len(bank) - 1)  # (B, K)
        target = bank[index] * scale[:, j, None, None]
        q = torch.einsum("bmpc,bcd->bmpd", query - centre[:, j, None, None], rotation[:, j])
        d2 = torch.cdist(
            q.reshape(b, m * p, 3), target, compute_mode="donot_use_mm_for_euclid_dist"
        ).square()
        d2 = d2.masked_fill((row >= count[:, j, None])[:, None], float("inf"))
        low, where = d2.min(-1)
        low = low.reshape(b, m, p)
        point = torch.gather(target, 1, where[..., None].expand(-1, -1, 3)).reshape(b, m, p, 3)
        better = (low < best) & (group != group[:, j, None])[..., None]
        best = torch.where(better, low, best)
        unit = torch.where(better, torch.full_like(unit, j), unit)
        local = torch.where(better[..., None], point, local)
    return unit, local


#: Squarings after which the greatest eigenvalue's share of `nearest_rotation` is all that is left.
SQUARINGS = 14


def nearest_rotation(covariance):
    """What `_Procrustes` gives, without a decomposition: Horn's quaternion, by squaring his matrix in f64. An accelerator takes small
    matrices' decompositions one after another."""
    c = covariance.double().flatten(-2).unbind(-1)  # rows: target, columns: reference
    xx, xy, xz, yx, yy, yz, zx, zy, zz = c
    rows = (
        xx + yy + zz, zy - yz, xz - zx, yx - xy,
        zy - yz, xx - yy - zz, xy + yx, xz + zx,
        xz - zx, xy + yx, yy - xx - zz, yz + zy,
        yx - xy, xz + zx, yz + zy, zz - xx - yy,
    )  # fmt: skip
    power = torch.stack(rows, -1).unflatten(-1, (4, 4))
    size = power.square().sum((-1, -2), keepdim=True).sqrt()
    power = power / size.clamp(min=1e-30) + 1.001 * torch.eye(4, dtype=power.dtype, device=power.device)  # no eigenvalue below 0
    for k in range(SQUARINGS):
        power = power @ power
        if k % 3 == 1 or k + 1 == SQUARINGS:
            power = power / power.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
    # The column that is longest: of the first of equals.
    best = power.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None].expand(*power.shape[:-1], 1)
    q = power.gather(-1, best)[..., 0]
    q = q / q.square().sum(-1, keepdim=True).sqrt()
    return quaternion_to_matrix(q).to(covariance.dtype)


def solve_three(matrix, vector):
    """x of matrix x = vector, (..., 3, 3) and (..., 3), by cross products."""
    a, b, c = matrix.unbind(-1)
    bc, ca, ab = torch.linalg.cross(b, c), torch.linalg.cross(c, a), torch.linalg.cross(a, b)
    rows = torch.stack((bc, ca, ab), -2)
    return (rows * vector[..., None, :]).sum(-1) / (a * bc).sum(-1, keepdim=True)


class _Procrustes(torch.autograd.Function):
    """Rotation nearest to a covariance, with the derivative of the polar factor:
    well-behaved for equal singular values, where the SVD's own derivative is not."""

    @staticmethod
    def forward(ctx, covariance):  # (..., 3, 3): sum of target outer reference
        if covariance.is_cuda:
            rotation = nearest_rotation(covariance)
        else:
            u, s, vh = torch.linalg.svd(covariance)
            sign = torch.det(u @ vh).sign()
            d = torch.ones_like(s)
            d[..., 2] = sign
            rotation = (u * d[..., None, :]) @ vh
        ctx.save_for_backward(rotation, covariance)
        return rotation

    @staticmethod
    def backward(ctx, grad):
        rotation, covariance = ctx.saved_tensors
        stretch = rotation.transpose(-1, -2) @ covariance
        eye = torch.eye(3, dtype=grad.dtype, device=grad.device)
        trace = torch.diagonal(stretch, dim1=-2, dim2=-1).sum(-1)[..., None, None]
        system = trace * eye - stretch
        system = system + (1e-6 + 1e-4 * trace.abs()) * eye
        body = rotation.transpose(-1, -2) @ grad
        skew = body - body.transpose(-1, -2)
        omega = torch.stack((skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]), -1)
        if grad.is_cuda:
            y = solve_three(system.transpose(-1, -2), omega)
        else:
            y = torch.linalg.solve(system.transpose(-1, -2), omega[..., None])[..., 0]
        zero = torch.zeros_like(y[..., 0])
        cross = torch.stack(
            (zero, -y[..., 2], y[..., 1], y[..., 2], zero, -y[..., 0], -y[..., 1], y[..., 0], zero),
            -1,
        ).reshape(grad.shape)
        return rotation @ cross


def kabsch(reference, target):
    """Rigid motion that carries reference anchors (..., A, 3) onto targets.
    Returns rotation (..., 3, 3) and translation (..., 3)."""
    reference_mean = reference.mean(-2, keepdim=True)
    target_mean = target.mean(-2, keepdim=True)
    covariance = (target - target_mean).transpose(-1, -2) @ (reference - reference_mean)
    rotation = _Procrustes.apply(covariance)
    moved = (rotation @ reference_mean.transpose(-1, -2))[..., 0]
    return rotation, target_mean[..., 0, :] - moved


def quaternion_to_matrix(q):
    """(..., 4) w, x, y, z -> (..., 3, 3), NumPy or Torch alike."""
    w, x, y, z = (q[..., i] for i in range(4))
    rows = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    stack = torch.stack if isinstance(q, torch.Tensor) else np.stack
    return stack(rows, -1).reshape(*q.shape[:-1], 3, 3)
