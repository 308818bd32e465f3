"""CYGNSS raw intermediate-frequency recordings: header, two-bit samples, lost packets.

Layout after ATBD 148-0397: a 35-byte big-endian header (``DRT0``, GPS week u16, second u32, format u8, sampling rate
u32, four times front end u8 and local oscillator u32), then bytes interleaved over the channels, four samples a
byte, first sample in the high bits: 00 -> -1, 01 -> -3, 10 -> +1, 11 -> +3. A lost packet stands as 2048 zero bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import GPS_L1_HZ
from shared.errors import DomainError

HEADER = struct.Struct(">4sHIBI" + "BI" * 4)  # 35 bytes
MAGIC = b"DRT0"
LEVELS = np.array([-1, -3, 1, 3], dtype=np.int8)
LOST_PACKET_BYTES = 2048
_BYTE_SAMPLES = LEVELS[(np.arange(256)[:, None] >> np.array([6, 4, 2, 0])) & 3]


@dataclass(frozen=True)
class Header:
    """GPS week and second of the first sample, channels (zenith, starboard, port), sampling rate, oscillators (Hz)."""

    gps_week: int
    gps_second: int
    channels: int
    sampling_hz: float
    oscillator_hz: tuple[int, ...]

    def intermediate_hz(self, channel: int) -> float:
        """L1 as it lies in the recording of a channel."""
        return GPS_L1_HZ - self.oscillator_hz[channel]


@dataclass(frozen=True)
class Recording:
    """A memory-mapped recording: the bytes of each channel, (bytes, channels), without the header."""

    header: Header
    data: NDArray[np.uint8]

    @property
    def duration_s(self) -> float:
        return 4 * len(self.data) / self.header.sampling_hz

    def samples(self, channel: int, start: int, count: int) -> NDArray[np.int8]:
        """``count`` samples (-3, -1, 1, 3) of a channel from sample ``start``."""
        first, last = start // 4, -(-(start + count) // 4)
        return _BYTE_SAMPLES[self.data[first:last, channel]].reshape(-1)[start - 4 * first :][:count]

    def lost_bytes(self, rows: int | None = None) -> NDArray[np.bool_]:
        """True for each of the first ``rows`` rows of bytes (all) that lies in a lost packet: a run of 2048 or more
        zeros in the interleaved stream or in a channel. A run that goes on beyond is seen: a packet more is read.
        """
        count = len(self.data) if rows is None else min(rows, len(self.data))
        data = np.asarray(self.data[: count + LOST_PACKET_BYTES])
        lost = _in_long_runs(data.reshape(-1)).reshape(data.shape).any(axis=1)
        for channel in range(self.header.channels):
            lost |= _in_long_runs(data[:, channel])
        return lost[:count]


@numba.njit(cache=True)
def _in_long_runs(values):
    """True for each byte that lies in a run of LOST_PACKET_BYTES or more zeros, (n,)."""
    inside = np.zeros(values.size, np.bool_)
    run = 0
    for n in range(values.size + 1):
        if n < values.size and values[n] == 0:
            run += 1
            continue
        if run >= LOST_PACKET_BYTES:
            inside[n - run : n] = True
        run = 0
    return inside


def read_recording(path: str | Path) -> Recording:
    """Open a recording; DomainError for a short file, a wrong magic or an unknown format."""
    size = Path(path).stat().st_size
    name = Path(path).name
    if size < HEADER.size:
        raise DomainError(
            f"'{name}' is shorter than a header.", field="recording", value=size, accepted="35 bytes or more"
        )
    with open(path, "rb") as file:
        magic, week, second, layout, rate, *rest = HEADER.unpack(file.read(HEADER.size))
    if magic != MAGIC:
        raise DomainError(f"'{name}' is no raw-IF recording.", field="recording.magic", value=magic, accepted="DRT0")
    if layout > 3 or not 1_000_000 <= rate <= 100_000_000:
        raise DomainError(
            f"'{name}' has an unknown layout.",
            field="recording.header",
            value=f"format {layout}, {rate} Hz",
            accepted="format 0..3, 1..100 MHz",
        )
    channels = layout + 1
    rows = (size - HEADER.size) // channels
    if rows == 0:
        raise DomainError(
            f"'{name}' holds no sample.", field="recording", value=size, accepted="samples after the header"
        )
    data = np.memmap(path, dtype=np.uint8, mode="r", offset=HEADER.size, shape=(rows, channels))
    return Recording(Header(week, second, channels, float(rate), tuple(rest[1::2])), data)


def write_recording(path: str | Path, header: Header, samples: NDArray[np.int8]) -> None:
    """Write samples (-3, -1, 1, 3), (channels, count), count a multiple of four; the inverse of ``read_recording``."""
    code = np.select([samples == -1, samples == -3, samples == 1], [0, 1, 2], default=3).astype(np.uint8)
    quads = code.reshape(len(samples), -1, 4)
    packed = (quads[..., 0] << 6) | (quads[..., 1] << 4) | (quads[..., 2] << 2) | quads[..., 3]
    fronts = [value for n, oscillator in enumerate(header.oscillator_hz) for value in (n, oscillator)]
    head = HEADER.pack(MAGIC, header.gps_week, header.gps_second, header.channels - 1, int(header.sampling_hz), *fronts)
    Path(path).write_bytes(head + np.ascontiguousarray(packed.T).tobytes())
