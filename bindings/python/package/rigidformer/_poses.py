"""Poses of others, whose quaternions have w last."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ._errors import InputError


def from_xyzw(poses: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Poses or quaternions with w last (x, y, z, w: ROS, SciPy, PyBullet, Isaac) in this package's order, w first.

    Parameters
    ----------
    poses : array, (..., 7) or (..., 4)
        Positions in metres and unit quaternions, or unit quaternions alone.

    Returns
    -------
    array of float32
        Of the same shape; a new one.

    Raises
    ------
    InputError
        The last side is neither 7 nor 4, or there is something else than numbers.

    >>> import rigidformer as rf
    >>> rf.from_xyzw([0, 0, 1, 0, 0, 0, 1]).tolist()
    [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    """
    return _turned(poses, 1)


def to_xyzw(poses: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """This package's poses or quaternions, w first, with w last: x, y, z, w.

    Parameters
    ----------
    poses : array, (..., 7) or (..., 4)
        As of ``World.poses``, or unit quaternions alone.

    Returns
    -------
    array of float32
        Of the same shape; a new one.

    Raises
    ------
    InputError
        The last side is neither 7 nor 4, or there is something else than numbers.

    >>> import rigidformer as rf
    >>> rf.to_xyzw([1, 0, 0, 0]).tolist()
    [0.0, 0.0, 0.0, 1.0]
    """
    return _turned(poses, -1)


def _turned(poses: npt.ArrayLike, places: int) -> npt.NDArray[np.float32]:
    try:
        with np.errstate(over="ignore"):
            turned = np.array(poses, np.float32)
    except (ValueError, OverflowError) as error:
        raise InputError(f"poses cannot be read as numbers: {error}") from None
    if turned.ndim == 0 or turned.shape[-1] not in (4, 7):
        raise InputError(f"poses has shape {turned.shape}; give (..., 7), or (..., 4) for quaternions alone")
    turned[..., -4:] = np.roll(turned[..., -4:], places, axis=-1)
    return turned
