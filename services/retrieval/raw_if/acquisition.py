"""From a raw-IF recording to a delay-Doppler map: FFT acquisition, then coherent milliseconds summed incoherently.

Each millisecond is mixed to baseband, correlated with the C/A code over all delays by FFT (acquisition), and, around
the peak, wiped off with the code at 69 delays and summed in short blocks, whose small Fourier transform gives 111
Doppler bins 50 Hz apart. The code phase follows absolute sample time and the code Doppler, so that 16036.2 samples a
millisecond do not drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from services.retrieval.constants import CODE_LENGTH_CHIPS, CODE_RATE_HZ, GPS_L1_HZ
from services.retrieval.raw_if.ca_code import replica
from services.retrieval.raw_if.recording import Recording
from shared.errors import DomainError

FloatArray = NDArray[np.float64]

DELAYS, DOPPLERS, DOPPLER_STEP_HZ = 69, 111, 50.0
ACQUISITION_MS = 20
ACQUISITION_STEP_HZ = 250.0
NOISE_OFFSET_CHIPS = 500.0  # half a code period away from the reflection
BLOCKS = 64  # per millisecond: 16 kHz of Doppler before aliasing


@dataclass(frozen=True)
class Acquired:
    """Where the reflection was found: code phase at sample 0 (chips), Doppler (Hz), peak over mean of the search."""

    code_phase_chips: float
    doppler_hz: float
    peak_to_mean: float


@dataclass(frozen=True)
class DelayDopplerMap:
    """Power (delay, Doppler) in units of the mean noise power, the noise floor removed, with what went in."""

    power: FloatArray
    acquired: Acquired
    milliseconds: int
    milliseconds_lost: int
    noise_power: float


def _check(recording: Recording, channel: int, first_ms: int, count: int) -> int:
    if not 0 <= channel < recording.header.channels:
        accepted = f"0..{recording.header.channels - 1}"
        raise DomainError("The recording has no such channel.", field="channel", value=channel, accepted=accepted)
    spare = 4 * len(recording.data) - int(recording.header.sampling_hz * 1e-3)  # samples before the last millisecond
    available = int(spare // (recording.header.sampling_hz * 1e-3)) + 1 - first_ms
    if available < 1:
        raise DomainError(
            "The recording ends before the first millisecond.",
            field="recording",
            value=f"{recording.duration_s:.4f} s",
            accepted="1 ms or more",
        )
    return min(count, available)


def _baseband(recording: Recording, channel: int, first: int, count: int, doppler_hz: float) -> NDArray[np.complex64]:
    """Samples mixed down by the intermediate frequency and a Doppler, phase continuous over the recording."""
    header = recording.header
    turns = np.arange(first, first + count) * ((header.intermediate_hz(channel) + doppler_hz) / header.sampling_hz)
    samples = recording.samples(channel, first, count).astype(np.float32)
    return samples * np.exp(-2j * np.pi * (turns % 1.0)).astype(np.complex64)


def _lost_ms(recording: Recording, total: int) -> NDArray[np.bool_]:
    """True for each of the first ``total`` milliseconds that overlaps a lost packet."""
    rows = int(np.ceil((total + 1) * recording.header.sampling_hz * 1e-3 / 4))
    lost = np.flatnonzero(recording.lost_bytes(rows)) * 4
    marked = np.zeros(total + 1, dtype=bool)
    marked[np.minimum((lost * 1000 / recording.header.sampling_hz).astype(np.int64), total)] = True
    return marked


def acquire(recording: Recording, prn: int, channel: int, centre_hz: float, half_width_hz: float = 1000.0) -> Acquired:
    """Search code phase (all) and Doppler (``centre_hz`` +- ``half_width_hz``) over the first milliseconds."""
    available = _check(recording, channel, 0, ACQUISITION_MS)
    rate = recording.header.sampling_hz
    size = int(rate * 1e-3)
    code = np.conj(np.fft.fft(replica(prn, np.arange(size) * (CODE_RATE_HZ / rate))))
    dopplers = centre_hz + np.arange(-half_width_hz, half_width_hz + 1.0, ACQUISITION_STEP_HZ)
    lost = _lost_ms(recording, available)
    surface = np.zeros((dopplers.size, size))
    for ms in np.flatnonzero(~lost[:available]):
        first = int(np.ceil(ms * rate * 1e-3))
        for k, doppler in enumerate(dopplers):
            spectrum = np.fft.fft(_baseband(recording, channel, first, size, doppler))
            surface[k] += np.abs(np.fft.ifft(spectrum * code)) ** 2
    if not surface.any():
        raise DomainError("All milliseconds of the search lie in lost packets.", field="recording", accepted="samples")
    row, delay = np.unravel_index(int(surface.argmax()), surface.shape)
    # at sample 0 the code stands where it stood ``delay`` samples before its start
    phase = (-delay * CODE_RATE_HZ / rate) % CODE_LENGTH_CHIPS
    return Acquired(float(phase), float(dopplers[row]), float(surface[row, delay] / surface.mean()))


def delay_doppler_map(
    recording: Recording, prn: int, channel: int, doppler_hz: float, milliseconds: int = 1000, search_hz: float = 1000.0
) -> DelayDopplerMap:
    """The 69 x 111 map around the acquired peak: one-millisecond coherent sums, powers added over ``milliseconds``.

    Delay rises down the rows in steps of a sample, Doppler along the columns in steps of 50 Hz. Milliseconds that
    overlap a lost packet are left out and counted. DomainError for an unknown PRN, channel or an empty recording.
    """
    found = acquire(recording, prn, channel, doppler_hz, search_hz)
    count = _check(recording, channel, 0, milliseconds)
    lost = _lost_ms(recording, count)[:count]
    kept = np.flatnonzero(~lost)
    if not kept.size:
        raise DomainError("All milliseconds lie in lost packets.", field="recording", value=count, accepted="samples")
    total = np.zeros((DELAYS, DOPPLERS))
    noise = 0.0
    for ms in kept:
        near, far = _one_millisecond(recording, prn, channel, found, int(ms))
        total += near
        noise += far
    power = total / noise - 1.0
    return DelayDopplerMap(power, found, int(kept.size), int(lost.sum()), noise / kept.size)


def _one_millisecond(recording, prn: int, channel: int, found: Acquired, ms: int) -> tuple[FloatArray, float]:
    """Power (delay, Doppler) around the peak in one millisecond, and the mean power well off the peak."""
    rate = recording.header.sampling_hz
    size = int(rate * 1e-3)
    first = int(np.ceil(ms * rate * 1e-3))
    signal = _baseband(recording, channel, first, size, found.doppler_hz)
    chip_rate = CODE_RATE_HZ * (1.0 + found.doppler_hz / GPS_L1_HZ)
    offsets = np.arange(DELAYS) - DELAYS // 2
    padded = np.arange(first - offsets[-1], first + size - offsets[0])
    code = replica(prn, found.code_phase_chips + padded * (chip_rate / rate))
    edges = np.linspace(0, size, BLOCKS + 1).astype(np.int64)
    near = _doppler_power(_block_sums(code, signal, edges, np.arange(DELAYS)[::-1]), edges, rate)
    away = replica(prn, found.code_phase_chips + NOISE_OFFSET_CHIPS + padded * (chip_rate / rate))
    far = _doppler_power(_block_sums(away, signal, edges, np.arange(DELAYS)[::16]), edges, rate)
    return near, float(far.mean())


@numba.njit(cache=True)
def _block_sums(code, signal, edges, starts):
    """Sums of code x signal over each block of the millisecond, the code read from sample ``starts[k]``, (k, block)."""
    sums = np.zeros((starts.size, edges.size - 1), np.complex64)
    for k in range(starts.size):
        for block in range(edges.size - 1):
            real, imaginary = np.float32(0.0), np.float32(0.0)
            for n in range(edges[block], edges[block + 1]):
                value = code[starts[k] + n]
                real += value * signal[n].real
                imaginary += value * signal[n].imag
            sums[k, block] = complex(real, imaginary)
    return sums


def _doppler_power(sums: NDArray[np.complex64], edges: NDArray[np.int64], rate: float) -> FloatArray:
    """Power at 111 Doppler bins of the block sums (rows, block) of one millisecond."""
    middle = (edges[:-1] + edges[1:] - 1) / 2.0 / rate
    doppler = (np.arange(DOPPLERS) - DOPPLERS // 2) * DOPPLER_STEP_HZ
    rotation = np.exp(-2j * np.pi * np.outer(middle, doppler))
    return np.abs(sums @ rotation) ** 2
