"""The exceptions. Their texts are those of the Rust library: they say what is wrong and what to do."""

from __future__ import annotations

from typing import Optional


class RigidFormerError(Exception):
    """Any error of this package; nothing was changed by the call that raised it, unless its documentation says so."""


class InputError(RigidFormerError, ValueError):
    """What was given cannot be used: out of range, of another shape, not finite, or no model or scene file."""


class StepError(RigidFormerError, RuntimeError):
    """A step was refused: there is nothing to step, a command is missing, or the prediction diverged."""


class FileError(RigidFormerError, OSError):
    """A file cannot be read or written. ``errno`` is the system's number, where there is one."""

    def __init__(self, text: str, errno: Optional[int] = None) -> None:
        super().__init__(text)
        self.errno = errno

    def __str__(self) -> str:
        return str(self.args[0])


# Tracebacks and pickles show the name that users import.
for _class in (RigidFormerError, InputError, StepError, FileError):
    _class.__module__ = "rigidformer"
