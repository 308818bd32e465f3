"""A walk over UBJSON (draft 12), to know that a model file is whole before XGBoost sees it.

XGBoost aborts the whole process on a truncated or foreign file; a worker must instead answer with an error.
"""

from __future__ import annotations

import struct

_FIXED = {b"Z": 0, b"N": 0, b"T": 0, b"F": 0, b"i": 1, b"U": 1, b"C": 1, b"I": 2, b"l": 4, b"d": 4, b"L": 8, b"D": 8}
_INTEGERS = {b"i": ">b", b"U": ">B", b"I": ">h", b"l": ">i", b"L": ">q"}
MAX_DEPTH = 64


def is_whole_object(content: bytes) -> bool:
    """True where ``content`` is one complete UBJSON object and nothing after it."""
    try:
        return content[:1] == b"{" and _value(content, 0, 0) == len(content)
    except (ValueError, struct.error):
        return False


def _value(content: bytes, at: int, depth: int) -> int:
    """The position after the value that starts with a type marker at ``at``; ValueError where it is broken."""
    return _body(content, content[at : at + 1], at + 1, depth)


def _body(content: bytes, kind: bytes, at: int, depth: int) -> int:
    if depth > MAX_DEPTH:
        raise ValueError("nested too deeply")
    if kind in _FIXED:
        return _within(content, at + _FIXED[kind])
    if kind in (b"S", b"H"):
        length, at = _integer(content, at)
        return _within(content, at + length)
    if kind in (b"{", b"["):
        return _container(content, kind == b"{", at, depth)
    raise ValueError(f"no such type {kind!r}")


def _container(content: bytes, keyed: bool, at: int, depth: int) -> int:
    kind = b""
    if content[at : at + 1] == b"$":
        kind, at = content[at + 1 : at + 2], at + 2
    if content[at : at + 1] == b"#":
        count, at = _integer(content, at + 1)
        if kind in _FIXED and not keyed:
            return _within(content, at + count * _FIXED[kind])
        for _ in range(count):
            at = _member(content, kind, keyed, at, depth)
        return at
    if kind:
        raise ValueError("a type without a count")
    end = b"}" if keyed else b"]"
    while content[at : at + 1] != end:
        at = _member(content, kind, keyed, at, depth)
    return at + 1


def _member(content: bytes, kind: bytes, keyed: bool, at: int, depth: int) -> int:
    if keyed:
        length, at = _integer(content, at)
        at = _within(content, at + length)
    return _body(content, kind, at, depth + 1) if kind else _value(content, at, depth + 1)


def _integer(content: bytes, at: int) -> tuple[int, int]:
    layout = _INTEGERS.get(content[at : at + 1])
    if layout is None:
        raise ValueError("no length")
    (value,) = struct.unpack_from(layout, content, at + 1)
    if value < 0:
        raise ValueError("negative length")
    return value, at + 1 + struct.calcsize(layout)


def _within(content: bytes, end: int) -> int:
    if end > len(content):
        raise ValueError("cut off")
    return end
