"""The exceptions. They say what is wrong and what to do."""

from __future__ import annotations

import errno as _errno
import os
from typing import Any, Optional


class RigidFormerError(Exception):
    """Any error of this package; nothing was changed by the call that raised it, unless its documentation says so."""


class InputError(RigidFormerError, ValueError):
    """What was given cannot be used: out of range, of another shape, not finite, or no model or scene file."""


class RangeError(InputError, OverflowError):
    """A whole number is negative, or larger than any that can be meant."""


class MemoryLimitError(InputError, MemoryError):
    """More memory than there is, or than the call may take. The text says how many bytes, and what to do."""


class StepError(RigidFormerError, RuntimeError):
    """A step was refused: there is nothing to step, a command is missing, or the prediction diverged."""


class FaultError(RigidFormerError, RuntimeError):
    """A fault of this package, and not of its caller. Objects that the call was to change refuse further ones."""


class FileError(RigidFormerError, OSError):
    """A file cannot be read or written. ``errno``, ``strerror`` and ``filename`` say why and which, where they are known, and it is a
    ``FileNotFoundError``, ``PermissionError``, ``IsADirectoryError``, ``NotADirectoryError`` or ``FileExistsError`` too."""

    def __new__(
        cls,
        text: str,
        errno: Optional[int] = None,
        filename: Any = None,
        kind: Optional[str] = None,
    ) -> FileError:
        number = _number(errno, kind)
        return super().__new__(_OF_NUMBER.get(number, cls) if cls is FileError else cls, text)

    def __init__(
        self,
        text: str,
        errno: Optional[int] = None,
        filename: Any = None,
        kind: Optional[str] = None,
    ) -> None:
        super().__init__(text)
        self.errno = _number(errno, kind)
        self.filename = None if filename is None else os.fspath(filename)
        self.strerror = None if self.errno is None else os.strerror(self.errno)

    def __str__(self) -> str:
        return str(self.args[0])

    def __reduce__(self) -> Any:
        # An OSError is pickled by its arguments alone.
        return FileError, (str(self), self.errno, self.filename)


def _number(errno: Optional[int], kind: Optional[str]) -> Optional[int]:
    return errno if errno is not None or kind is None else getattr(_errno, kind, None)


class _Missing(FileError, FileNotFoundError):
    pass


class _Forbidden(FileError, PermissionError):
    pass


class _Folder(FileError, IsADirectoryError):
    pass


class _NoFolder(FileError, NotADirectoryError):
    pass


class _Exists(FileError, FileExistsError):
    pass


_OF_NUMBER: dict[Optional[int], type[FileError]] = {
    _errno.ENOENT: _Missing,
    _errno.EACCES: _Forbidden,
    _errno.EPERM: _Forbidden,
    _errno.EISDIR: _Folder,
    _errno.ENOTDIR: _NoFolder,
    _errno.EEXIST: _Exists,
}

# Tracebacks show the name that users import.
for _class in (RigidFormerError, InputError, RangeError, MemoryLimitError, StepError, FaultError, FileError):
    _class.__module__ = "rigidformer"
for _class in _OF_NUMBER.values():
    _class.__module__, _class.__name__, _class.__qualname__ = "rigidformer", "FileError", "FileError"
