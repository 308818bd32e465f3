"""Raw-IF recordings: C/A codes against the interface specification, a self-made recording acquired and mapped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from services.retrieval.constants import CODE_RATE_HZ, GPS_L1_HZ
from services.retrieval.raw_if.acquisition import DELAYS, DOPPLERS, acquire, delay_doppler_map
from services.retrieval.raw_if.ca_code import chips, replica
from services.retrieval.raw_if.recording import HEADER, Header, Recording, read_recording, write_recording
from shared.errors import DomainError

RATE_HZ = 16_036_200.0
INTERMEDIATE_HZ = 3_872_200
HEAD = Header(2209, 432_000, 3, RATE_HZ, (int(GPS_L1_HZ) - INTERMEDIATE_HZ,) * 4)

# First ten chips of PRN 1-32 in octal, IS-GPS-200 table 3-Ia.
FIRST_TEN_CHIPS = (
    1440, 1620, 1710, 1744, 1133, 1455, 1131, 1454, 1626, 1504, 1642, 1750, 1764, 1772, 1775, 1776,
    1156, 1467, 1633, 1715, 1746, 1763, 1063, 1706, 1743, 1761, 1770, 1774, 1127, 1453, 1625, 1712,
)  # fmt: skip


def test_codes_begin_as_published() -> None:
    for prn, octal in enumerate(FIRST_TEN_CHIPS, start=1):
        assert int("".join(map(str, chips(prn)[:10])), 2) == int(str(octal), 8), prn


def test_codes_are_gold_codes() -> None:
    """Periodic correlations of Gold codes of length 1023 take the values -65, -1, 63 only; balanced to one chip."""
    signs = {prn: 1.0 - 2.0 * chips(prn) for prn in (1, 7, 32)}
    for a, b in ((1, 1), (1, 7), (7, 32)):
        spectrum = np.fft.fft(signs[a]) * np.conj(np.fft.fft(signs[b]))
        values = set(np.round(np.fft.ifft(spectrum).real).astype(int))
        assert values <= {-65, -1, 63, 1023}
        assert (1023 in values) == (a == b)
    assert chips(5).sum() == 512


def test_unknown_prn_is_refused() -> None:
    with pytest.raises(DomainError) as error:
        chips(33)
    assert error.value.field == "prn"


def _samples(milliseconds: int, amplitude: float, phase: float, doppler_hz: float, prn: int = 7) -> np.ndarray:
    """Three channels of two-bit samples; the reflection of ``prn`` lies in the starboard one."""
    count = int(RATE_HZ * milliseconds * 1e-3) // 4 * 4
    n = np.arange(count)
    values = np.random.default_rng(3).standard_normal((3, count))
    code = replica(prn, phase + n * (CODE_RATE_HZ * (1 + doppler_hz / GPS_L1_HZ) / RATE_HZ))
    values[1] += amplitude * code * np.cos(2 * np.pi * (INTERMEDIATE_HZ + doppler_hz) / RATE_HZ * n)
    return (np.where(np.abs(values) > 1, 3, 1) * np.where(values >= 0, 1, -1)).astype(np.int8)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("raw_if") / "cyg01_raw_if_data.bin"
    write_recording(path, HEAD, _samples(14, 0.12, 400.25, 1730.0))
    return path


def test_header_and_samples_survive_the_file(recording: Path) -> None:
    read = read_recording(recording)
    assert HEADER.size == 35 and read.header == HEAD
    assert read.header.intermediate_hz(1) == INTERMEDIATE_HZ
    samples = _samples(14, 0.12, 400.25, 1730.0)
    for start in (0, 1, 4, 1003):
        assert np.array_equal(read.samples(2, start, 777), samples[2, start : start + 777])


def test_sample_codes_are_those_of_the_handbook(tmp_path: Path) -> None:
    """Byte 0b00011011 holds -1, -3, +1, +3, first sample in the high bits."""
    path = tmp_path / "one.bin"
    head = HEADER.pack(b"DRT0", 2209, 1, 0, 16_036_200, *(0, 0) * 4)
    path.write_bytes(head + bytes([0b00011011]) * 8)
    assert read_recording(path).samples(0, 0, 4).tolist() == [-1, -3, 1, 3]


def test_reflection_is_found_at_its_delay_and_doppler(recording: Path) -> None:
    found = acquire(read_recording(recording), 7, 1, 1500.0)
    offset_samples = (found.code_phase_chips - 400.25) * RATE_HZ / CODE_RATE_HZ
    assert abs(offset_samples) < 2.0
    assert abs(found.doppler_hz - 1730.0) <= 250.0
    assert found.peak_to_mean > 10.0


def test_absent_prn_is_not_found(recording: Path) -> None:
    assert acquire(read_recording(recording), 9, 1, 1500.0).peak_to_mean < 5.0


def test_map_has_its_peak_at_the_acquired_point_and_the_shape_of_the_ambiguity_function(recording: Path) -> None:
    made = delay_doppler_map(read_recording(recording), 7, 1, 1500.0, milliseconds=13)
    assert made.power.shape == (DELAYS, DOPPLERS)
    row, column = np.unravel_index(made.power.argmax(), made.power.shape)
    true_column = DOPPLERS // 2 + (1730.0 - made.acquired.doppler_hz) / 50.0
    true_row = DELAYS // 2 + (made.acquired.code_phase_chips - 400.25) * RATE_HZ / CODE_RATE_HZ
    assert abs(row - true_row) <= 2 and abs(column - true_column) <= 4
    peak = made.power[row, column]
    assert made.power[row + 8, column] / peak == pytest.approx((1 - 8 * 0.0638) ** 2, abs=0.12)
    assert made.power[row, column + 10] / peak == pytest.approx(np.sinc(0.5) ** 2, abs=0.15)
    assert np.abs(made.power[:14]).mean() < 0.15 * peak  # more than a chip before it: noise


def test_lost_packets_are_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "lost.bin"
    write_recording(path, HEAD, _samples(10, 0.12, 400.25, 1730.0))
    content = bytearray(path.read_bytes())
    start = HEADER.size + 3 * 4009 * 4 + 500  # within the fifth millisecond
    content[start : start + 2048] = bytes(2048)
    path.write_bytes(content)
    made = delay_doppler_map(read_recording(path), 7, 1, 1750.0, milliseconds=9, search_hz=250.0)
    assert (made.milliseconds, made.milliseconds_lost) == (8, 1)


@pytest.mark.parametrize(
    ("content", "field"),
    [
        (b"DRT0", "recording"),
        (HEADER.pack(b"DRT1", 1, 1, 2, 16_036_200, *(0, 0) * 4) + bytes(40), "recording.magic"),
        (HEADER.pack(b"DRT0", 1, 1, 9, 16_036_200, *(0, 0) * 4) + bytes(40), "recording.header"),
        (HEADER.pack(b"DRT0", 1, 1, 2, 0, *(0, 0) * 4) + bytes(40), "recording.header"),
        (HEADER.pack(b"DRT0", 1, 1, 2, 16_036_200, *(0, 0) * 4), "recording"),
    ],
)
def test_broken_recordings_are_named(tmp_path: Path, content: bytes, field: str) -> None:
    path = tmp_path / "broken.bin"
    path.write_bytes(content)
    with pytest.raises(DomainError) as error:
        read_recording(path)
    assert error.value.field == field


def test_a_recording_of_one_packet_is_too_short_to_map(tmp_path: Path) -> None:
    path = tmp_path / "short.bin"
    path.write_bytes(HEADER.pack(b"DRT0", 1, 1, 2, 16_036_200, *(0, 0) * 4) + bytes(range(1, 250)) * 12)
    with pytest.raises(DomainError) as error:
        delay_doppler_map(read_recording(path), 7, 1, 0.0)
    assert error.value.field == "recording"
    with pytest.raises(DomainError) as error:
        delay_doppler_map(read_recording(path), 7, 5, 0.0)
    assert error.value.field == "channel"


def test_map_is_the_correlation_written_out(recording: Path) -> None:
    """Each sample times code times wave, at every delay and Doppler, by plain matrix products over two milliseconds."""
    read = read_recording(recording)
    made = delay_doppler_map(read, 7, 1, 1500.0, milliseconds=2, search_hz=250.0)
    size, total = 16_036, np.zeros((DELAYS, DOPPLERS))
    doppler = (np.arange(DOPPLERS) - DOPPLERS // 2) * 50.0
    step = CODE_RATE_HZ * (1 + made.acquired.doppler_hz / GPS_L1_HZ) / RATE_HZ
    for first in (0, 16_037):  # the second millisecond begins at sample 16036.2
        n = np.arange(size)
        delays = np.arange(DELAYS)[:, None] - DELAYS // 2
        code = replica(7, made.acquired.code_phase_chips + (first + n[None, :] - delays) * step)
        wave = np.exp(-2j * np.pi * (INTERMEDIATE_HZ + made.acquired.doppler_hz + doppler) / RATE_HZ * n[:, None])
        total += np.abs(code @ (read.samples(1, first, size)[:, None] * wave)) ** 2
    expected = total / (2 * made.noise_power) - 1.0
    assert np.abs(made.power - expected).max() < 0.03 * expected.max()
    middle = slice(DOPPLERS // 2 - 10, DOPPLERS // 2 + 11)  # within 500 Hz the blocks lose 0.1 %
    assert np.abs(made.power - expected)[:, middle].max() < 0.002 * expected.max()


def test_lost_packets_at_the_start_move_the_search_on(tmp_path: Path) -> None:
    path = tmp_path / "late.bin"
    write_recording(path, HEAD, _samples(10, 0.12, 400.25, 1730.0))
    content = bytearray(path.read_bytes())
    content[HEADER.size : HEADER.size + 3 * 4009 * 4] = bytes(3 * 4009 * 4)
    path.write_bytes(content)
    made = delay_doppler_map(read_recording(path), 7, 1, 1750.0, milliseconds=9, search_hz=250.0)
    assert made.milliseconds_lost >= 4 and made.milliseconds == 9 - made.milliseconds_lost
    assert made.acquired.code_phase_chips == pytest.approx(400.25, abs=0.1)


def test_a_packet_lost_in_one_channel_is_seen(recording: Path) -> None:
    read = read_recording(recording)
    data = read.data.copy()
    data[5000:7048, 1] = 0
    lost = np.flatnonzero(Recording(read.header, data).lost_bytes())
    assert lost[0] <= 5000 and lost[-1] >= 7047 and lost.size < 2100
