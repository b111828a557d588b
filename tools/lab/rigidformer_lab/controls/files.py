"""Videos and pictures that get their names once they are complete."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import struct
import tempfile
import zlib
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

from .errors import Failure, Usage

#: Y'CbCr 4:2:0 by BT.601 in limited range, from red, green and blue of 0 to 1. Decoders assume it that ignore what a file says.
MATRIX = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
OFFSET = np.array([16.0, 128.0, 128.0])
#: Of x264: without a loss for red, green and blue; else the finest step that players decode. Without pictures that refer to later ones, a
#: frame is decoded as soon as it is read.
EXACT = {"qp": "0", "preset": "fast", "bf": "0"}
SHARED = {"qp": "1", "preset": "fast", "profile": "high", "bf": "0"}


def planes(pixels: np.ndarray) -> np.ndarray:
    """Samples of 4:2:0 (rows and a half, columns), as PyAV takes them, from pixels (rows, columns, 3). Four pixels share their chroma."""
    height, width = pixels.shape[:2]
    luma = pixels @ (MATRIX[0] / 255) + OFFSET[0]
    mean = pixels.reshape(height // 2, 2, width // 2, 2, 3).mean((1, 3))
    chroma = mean @ (MATRIX[1:].T / 255) + OFFSET[1:]
    samples = np.concatenate((luma.ravel(), chroma[..., 0].ravel(), chroma[..., 1].ravel()))
    return np.floor(samples + 0.5).astype(np.uint8).reshape(height * 3 // 2, width)


def png(pixels: np.ndarray) -> bytes:
    """A PNG file of pixels (rows, columns, 3)."""
    height, width = pixels.shape[:2]
    rows = np.hstack((np.zeros((height, 1), np.uint8), pixels.reshape(height, -1)))  # no filter
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(rows.tobytes())), (b"IEND", b""))
    body = (struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


def _mode(path: str, usual: int):
    """Gives a temporary file or folder the rights of any new one."""
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, usual & ~mask)


class Video:
    """A video under a temporary name beside its own."""

    def __init__(self, path: Path, size: tuple[int, int], rate: Fraction, exact: bool):
        self.path, self.exact, self.rate, self.count = path, exact, rate, 0
        self.bytes = 0
        with self._written():
            handle, name = tempfile.mkstemp(prefix=".rigidformer-", suffix=".tmp", dir=path.parent)
            os.close(handle)
            self.temporary = Path(name)
            _mode(name, 0o666)
            self.container = av.open(name, "w", format="mp4", options={"movflags": "+faststart"})
            stream = self.container.add_stream("libx264rgb" if exact else "libx264", rate=rate, options=EXACT if exact else SHARED)
            stream.width, stream.height, stream.pix_fmt = *size, "rgb24" if exact else "yuv420p"
            coder = stream.codec_context
            coder.time_base = 1 / rate
            coder.color_range = ColorRange.JPEG if exact else ColorRange.MPEG
            coder.colorspace = 0 if exact else Colorspace.ITU601  # 0: red, green and blue as they are
            coder.color_primaries, coder.color_trc = ColorPrimaries.BT709, ColorTrc.IEC61966_2_1
            self.stream = stream

    @contextlib.contextmanager
    def _written(self):
        try:
            yield
        except (OSError, av.FFmpegError) as error:
            raise Failure(
                f"{self.path}: cannot be written: {error}; name a file in a folder that exists, that you may write to and that has room"
            ) from error

    def push(self, pixels: np.ndarray):
        """Adds a frame (rows, columns, 3)."""
        with self._written():
            made = (pixels, "rgb24") if self.exact else (planes(pixels), "yuv420p")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(made[0]), format=made[1])
            frame.pts, frame.time_base = self.count, 1 / self.rate
            if not self.exact:
                frame.colorspace, frame.color_range = Colorspace.ITU601, ColorRange.MPEG
            self.count += 1
            self.container.mux(self.stream.encode(frame))

    def close(self):
        with self._written():
            self.container.mux(self.stream.encode())
            self.container.close()
            with open(self.temporary, "rb") as file:
                os.fsync(file.fileno())
            self.bytes = self.temporary.stat().st_size

    def name(self):
        with self._written():
            os.replace(self.temporary, self.path)

    def discard(self):
        with contextlib.suppress(Exception):
            self.container.close()
        if hasattr(self, "temporary"):
            self.temporary.unlink(missing_ok=True)


class Files:
    """All files that a command line asks for. Leaving the `with` without `finish` leaves none of them."""

    def __init__(self, out: Path, rendered: Path | None, pictures: Path | None, size: tuple[int, int], rate: Fraction, exact: bool):
        self.videos: list[Video] = []
        self.pictures, self.folder = pictures, None
        try:
            if pictures is not None:
                try:
                    self.folder = Path(tempfile.mkdtemp(prefix=".rigidformer-", dir=pictures.parent))
                    _mode(str(self.folder), 0o777)
                except OSError as error:
                    raise Failure(
                        f"{pictures}: cannot be made: {error}; name a new folder below one that you may write to"
                    ) from error
            for path in (out, rendered):
                if path is not None:
                    self.videos.append(Video(path, size, rate, exact))
        except BaseException:
            self.discard()
            raise

    def __enter__(self) -> Files:
        return self

    def __exit__(self, *_):
        self.discard()

    def push(self, number: int, tracking: np.ndarray, rendered: np.ndarray | None):
        for video, what, pixels in zip((*self.videos, None), ("tracking", "rendered"), (tracking, rendered)):
            if pixels is None:
                continue
            video.push(pixels)
            if self.folder is not None:
                path = self.folder / f"{number:05}-{what}.png"
                try:
                    path.write_bytes(png(pixels))
                except OSError as error:
                    raise Failure(f"{self.pictures}: cannot be written: {error}; name a folder that has room") from error

    def finish(self):
        """Gives all files their names."""
        for video in self.videos:
            video.close()
        # Ctrl-C waits meanwhile, so that either all files have their names or none has.
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            for video in self.videos:
                video.name()
            self.videos = []
            if self.folder is not None:
                try:
                    if self.pictures.is_dir():
                        self.pictures.rmdir()  # an empty one makes room
                    os.rename(self.folder, self.pictures)
                except OSError as error:
                    raise Failure(f"{self.pictures}: cannot be made: {error}; give another name with --png") from error
                self.folder = None
        finally:
            signal.signal(signal.SIGINT, before)

    def discard(self):
        for video in self.videos:
            video.discard()
        self.videos = []
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder = None


def check(outputs: list[tuple[str, Path | None]], inputs: list[Path]):
    """Refuses outputs (option, path) that cannot be written, so that they cost no computation."""
    here, before = Path.cwd().resolve(), []
    for option, path in outputs:
        if path is None:
            continue
        own = None if path.name in ("", "..") else path.parent.resolve() / path.name
        is_png = option == "--png"
        if not path.parent.is_dir():
            problem = "its folder does not exist; make it first"
        elif own in before:
            problem = "two options name this file; give two names"
        elif is_png and (own is None or own == here or own.is_symlink()):
            problem = "is a link, or the folder that you are in; name a folder that does not exist"
        elif is_png and path.exists() and not path.is_dir():
            problem = "is a file; name a folder that does not exist"
        elif is_png and path.is_dir() and any(path.iterdir()):
            problem = "is a folder with something in it; name another one, or empty it"
        elif is_png and any(own in video.parents for video in before):
            problem = "a video goes into this folder; name another one"
        elif not is_png and path.is_dir():
            problem = "is a folder; name a file in it"
        elif path.exists() and any(source.exists() and path.samefile(source) for source in inputs):
            problem = "is what this command reads; give another name"
        else:
            before.append(own)
            continue
        raise Usage(f"{option} {path}: {problem}")
