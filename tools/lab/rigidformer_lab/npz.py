"""Arrays of .npz files that a user gives."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np


def arrays_of(path: Path, names, fail) -> dict[str, np.ndarray]:
    """The arrays of these names. `fail` is called with what is wrong, and raises."""
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except KeyError as error:
        fail(f"has no array of the name {error.args[0].split(' ')[0]}")
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        fail(f"cannot be read ({error})")
