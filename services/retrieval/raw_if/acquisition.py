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
from scipy import fft

from services.retrieval.constants import CODE_LENGTH_CHIPS, CODE_RATE_HZ, GPS_L1_HZ
from services.retrieval.raw_if.ca_code import chips, replica
from services.retrieval.raw_if.recording import Recording
from shared.errors import DomainError

FloatArray = NDArray[np.float64]

DELAYS, DOPPLERS, DOPPLER_STEP_HZ = 69, 111, 50.0
ACQUISITION_MS = 20
ACQUISITION_STEP_HZ = 250.0
NOISE_OFFSET_CHIPS = 500.0  # half a code period away from the reflection
BLOCKS = 128  # per millisecond: at the edge of the map (2,750 Hz) a block loses 2.5 % of the power, 64 would lose 9.5 %
NOISE_DELAYS = slice(4, None, 16)  # delays a chip apart are enough for the noise
BATCH_MS = 16


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


def _lost_ms(recording: Recording, total: int) -> NDArray[np.bool_]:
    """True for each of the first ``total`` milliseconds that overlaps a lost packet."""
    rows = int(np.ceil((total + 1) * recording.header.sampling_hz * 1e-3 / 4))
    lost = np.flatnonzero(recording.lost_bytes(rows)) * 4
    marked = np.zeros(total + 1, dtype=bool)
    marked[np.minimum((lost * 1000 / recording.header.sampling_hz).astype(np.int64), total)] = True
    return marked


def acquire(
    recording: Recording, prn: int, channel: int, centre_hz: float, half_width_hz: float = 1000.0, within_ms: int = 1000
) -> Acquired:
    """Search code phase (all) and Doppler (``centre_hz`` +- ``half_width_hz``) over the first 20 milliseconds that lie
    in no lost packet, among the first ``within_ms``.
    """
    available = _check(recording, channel, 0, within_ms)
    rate = recording.header.sampling_hz
    size = int(rate * 1e-3)
    code = np.conj(fft.fft(replica(prn, np.arange(size) * (CODE_RATE_HZ / rate))))
    dopplers = centre_hz + np.arange(-half_width_hz, half_width_hz + 1.0, ACQUISITION_STEP_HZ)
    carriers = [_carrier(recording, channel, size, doppler) for doppler in dopplers]
    searched = np.flatnonzero(~_lost_ms(recording, available)[:available])[:ACQUISITION_MS]
    surface = np.zeros((dopplers.size, size))
    for ms in searched:
        samples = recording.samples(channel, int(np.ceil(ms * rate * 1e-3)), size).astype(np.float32)
        for power, carrier in zip(surface, carriers, strict=True):
            found = fft.ifft(fft.fft(samples * carrier, overwrite_x=True) * code, overwrite_x=True)
            power += _power(found)
    if not surface.any():
        raise DomainError("All milliseconds of the search lie in lost packets.", field="recording", accepted="samples")
    row, delay = np.unravel_index(int(surface.argmax()), surface.shape)
    # at sample 0 the code stands where it stood ``delay`` samples before its start; by the middle of the search the
    # Doppler of the code has moved it on
    moved = 1e-3 * float(searched.mean() + 0.5) * CODE_RATE_HZ * float(dopplers[row]) / GPS_L1_HZ
    phase = (-delay * CODE_RATE_HZ / rate - moved) % CODE_LENGTH_CHIPS
    return Acquired(float(phase), float(dopplers[row]), float(surface[row, delay] / surface.mean()))


def delay_doppler_map(
    recording: Recording, prn: int, channel: int, doppler_hz: float, milliseconds: int = 1000, search_hz: float = 1000.0
) -> DelayDopplerMap:
    """The 69 x 111 map around the acquired peak: one-millisecond coherent sums, powers added over ``milliseconds``.

    Delay rises down the rows in steps of a sample, Doppler along the columns in steps of 50 Hz. Milliseconds that
    overlap a lost packet are left out and counted. DomainError for an unknown PRN, channel or an empty recording.
    """
    found = acquire(recording, prn, channel, doppler_hz, search_hz, milliseconds)
    count = _check(recording, channel, 0, milliseconds)
    lost = _lost_ms(recording, count)[:count]
    kept = np.flatnonzero(~lost)
    if not kept.size:
        raise DomainError("All milliseconds lie in lost packets.", field="recording", value=count, accepted="samples")
    near, far = _summed_power(recording, prn, channel, found, kept)
    return DelayDopplerMap(near / far - 1.0, found, int(kept.size), int(lost.sum()), far / kept.size)


def _summed_power(
    recording: Recording, prn: int, channel: int, found: Acquired, kept: NDArray[np.int64]
) -> tuple[FloatArray, float]:
    """Power (delay, Doppler) around the peak, and the mean power well off it, both added over milliseconds."""
    rate = recording.header.sampling_hz
    size = int(rate * 1e-3)
    edges = np.linspace(0, size, BLOCKS + 1).astype(np.int64)
    wave = _carrier(recording, channel, size, found.doppler_hz)
    carrier, rotation = (wave.real.copy(), wave.imag.copy()), _rotation(edges, rate)
    signs = (1.0 - 2.0 * chips(prn)).astype(np.float32)
    step = CODE_RATE_HZ * (1.0 + found.doppler_hz / GPS_L1_HZ) / rate
    near, far = np.zeros((DELAYS, DOPPLERS)), 0.0
    for part in np.array_split(kept, -(-kept.size // BATCH_MS)):
        sums = np.empty((2, part.size, DELAYS, BLOCKS), np.complex64)
        for index, ms in enumerate(part):
            first = int(np.ceil(ms * rate * 1e-3))
            samples = recording.samples(channel, first, size).astype(np.float32)
            signal = samples * carrier[0], samples * carrier[1]
            start = found.code_phase_chips + (first - DELAYS // 2) * step
            for into, offset in zip(sums, (0.0, NOISE_OFFSET_CHIPS), strict=True):
                code = _code_samples(signs, start + offset, step, size + DELAYS)
                _block_sums(code, *signal, edges, into[index])
        near += _power(sums[0] @ rotation).sum(axis=0, dtype=np.float64)
        noise = _power(sums[1, :, NOISE_DELAYS] @ rotation)
        far += part.size * float(noise.mean(dtype=np.float64))
    return near, far


def _power(amplitude: NDArray[np.complex64]) -> NDArray[np.float32]:
    return amplitude.real**2 + amplitude.imag**2


def _carrier(recording: Recording, channel: int, size: int, doppler_hz: float) -> NDArray[np.complex64]:
    """One millisecond of the wave that mixes to baseband; where its phase begins does not matter to a power."""
    turns = np.arange(size) * ((recording.header.intermediate_hz(channel) + doppler_hz) / recording.header.sampling_hz)
    return np.exp(-2j * np.pi * (turns % 1.0)).astype(np.complex64)


def _rotation(edges: NDArray[np.int64], rate: float) -> NDArray[np.complex64]:
    """The small Fourier transform from the blocks of a millisecond to 111 Doppler bins, (block, Doppler)."""
    middle = (edges[:-1] + edges[1:] - 1) / 2.0 / rate
    doppler = (np.arange(DOPPLERS) - DOPPLERS // 2) * DOPPLER_STEP_HZ
    return np.exp(-2j * np.pi * np.outer(middle, doppler)).astype(np.complex64)


@numba.njit(cache=True)
def _code_samples(signs, start, step, count):
    """Code at ``count`` samples, the first at phase ``start`` (chips), ``step`` chips apart."""
    code = np.empty(count, np.float32)
    whole = np.floor(start / CODE_LENGTH_CHIPS) * CODE_LENGTH_CHIPS
    for n in range(count):
        chip = int(np.floor(start + n * step - whole))
        while chip >= CODE_LENGTH_CHIPS:
            chip -= CODE_LENGTH_CHIPS
        code[n] = signs[chip]
    return code


@numba.njit(cache=True)
def _block_sums(code, real, imaginary, edges, sums):
    """Sums of code x signal over each block for ``DELAYS`` delays a sample apart, into (delay, block).

    ``code`` begins with the last delay. Delays run innermost, four samples at a time: that keeps the processor's vector
    units busy, and every sum still adds its samples in their order, so that all machines give the same bytes.
    """
    a, b = np.empty(DELAYS, np.float32), np.empty(DELAYS, np.float32)
    for block in range(edges.size - 1):
        a[:], b[:] = 0.0, 0.0
        n, end = edges[block], edges[block + 1]
        while n + 4 <= end:
            c = code[n : n + DELAYS + 3]
            r0, r1, r2, r3 = real[n], real[n + 1], real[n + 2], real[n + 3]
            i0, i1, i2, i3 = imaginary[n], imaginary[n + 1], imaginary[n + 2], imaginary[n + 3]
            for k in range(DELAYS):
                a[k] = (((a[k] + c[k] * r0) + c[k + 1] * r1) + c[k + 2] * r2) + c[k + 3] * r3
            for k in range(DELAYS):
                b[k] = (((b[k] + c[k] * i0) + c[k + 1] * i1) + c[k + 2] * i2) + c[k + 3] * i3
            n += 4
        for m in range(n, end):
            for k in range(DELAYS):
                a[k] += code[m + k] * real[m]
                b[k] += code[m + k] * imaginary[m]
        for k in range(DELAYS):
            sums[DELAYS - 1 - k, block] = complex(a[k], b[k])
