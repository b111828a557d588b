"""Reads the weights of a packed model (`weights/FORMAT.md`), so that training can go on from a committed one."""

from __future__ import annotations

import pathlib
import struct
import zlib

import numpy as np
import torch

CONFIG_INTEGERS = 12  # width to scales
CONFIG_REST = 2 + 1 + 4 * 7  # features and motion (one byte each), gate, seven f32
RANGES = 14 * 2 * 4  # lowest and highest of each quantity, f32
DTYPES = (np.dtype("<f4"), np.dtype("<f2"), np.dtype("i1"))


class Cursor:
    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    def varint(self) -> int:
        value = shift = 0
        while True:
            byte = self.data[self.at]
            self.at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    def string(self) -> str:
        length = self.varint()
        self.at += length
        return self.data[self.at - length : self.at].decode()


def opened(path) -> tuple[Cursor, bytes]:
    """A cursor at the first entry of the provenance, and the payload."""
    data = pathlib.Path(path).read_bytes()
    magic, version, header_length, payload_offset, length, header_crc, payload_crc = struct.unpack_from("<8sIIQQII", data)
    header, payload = data[64 : 64 + header_length], data[payload_offset:]
    if magic != b"RFMODEL\0" or version not in range(1, 11):
        raise SystemExit(f"{path}: not a packed model of version 1 to 10; make one with `rigidformer pack`")
    if len(payload) != length or zlib.crc32(header) != header_crc or zlib.crc32(payload) != payload_crc:
        raise SystemExit(f"{path}: damaged or cut short; copy it again")
    cursor = Cursor(header)
    cursor.string()
    for _ in range(CONFIG_INTEGERS):
        cursor.varint()
    cursor.at += CONFIG_REST
    ranged = version == 9  # the version without ranges follows
    version = cursor.varint() if ranged else version
    has_rules = version == 10
    version = 4 if version in (8, 10) else version  # they have the fields of that one, and 10 more behind them
    if version > 1:  # hidden widths
        for _ in range(3):
            cursor.varint()
    if version > 2:  # length_m and longest_step
        cursor.at += 8
    if version > 4:  # directions
        cursor.varint()
    if version > 5:  # elastic
        cursor.varint(), cursor.varint()
        cursor.at += 20
        cursor.varint()
        cursor.at += 4
    if version > 6:  # bonds
        cursor.varint()
    if has_rules:  # scope, five bytes that are kept free, most units
        if any(cursor.data[cursor.at + 1 : cursor.at + 6]):
            raise ValueError("the model has a contact law, which is that of scenes now; train it again")
        cursor.at += 1 + 5
        cursor.varint()
    if ranged:  # what training saw
        cursor.at += RANGES
    return cursor, payload


def read_provenance(path) -> dict[str, str]:
    """Where the model comes from."""
    cursor, _ = opened(path)
    return {cursor.string(): cursor.string() for _ in range(cursor.varint())}


def read_weights(path) -> dict[str, torch.Tensor]:
    """Tensors by name, widened to f32."""
    cursor, payload = opened(path)
    for _ in range(cursor.varint()):
        cursor.string(), cursor.string()
    for _ in range(cursor.varint()):
        cursor.string()
        cursor.at += 4
    weights = {}
    for _ in range(cursor.varint()):
        name, kind = cursor.string(), cursor.varint()
        if kind >= len(DTYPES):
            raise SystemExit(f"{path}: {name} is in panels, which only hosts read; pack it without")
        dtype = DTYPES[kind]
        shape = [cursor.varint() for _ in range(cursor.varint())]
        offset, size = cursor.varint(), cursor.varint()
        values = np.frombuffer(payload, dtype, size // dtype.itemsize, offset).astype(np.float32)
        values = values.reshape(shape)
        if cursor.varint():
            scales = np.frombuffer(payload, "<f4", shape[0], cursor.varint())
            values = values * scales[:, None]
        weights[name] = torch.from_numpy(values.copy())
    return weights
