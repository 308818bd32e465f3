"""How long a day of level-1 and a second of raw-IF take, and the memory of the day: the long part of the benchmark."""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path

import netCDF4
import numpy as np

from services.retrieval.constants import CODE_RATE_HZ, GPS_L1_HZ, SAMPLING_HZ
from services.retrieval.looks.features import read_observations
from services.retrieval.raw_if.acquisition import delay_doppler_map
from services.retrieval.raw_if.ca_code import replica
from services.retrieval.raw_if.recording import Header, read_recording, write_recording
from services.retrieval.simulation.observations import simulate_nominal
from services.retrieval.simulation.training_world import DAY_MS, WorldPlan, make_specular_points, make_surface

DAY_SAMPLES = 172_800  # half a second each
OSCILLATOR_HZ = 1_571_547_800
PRN, PHASE_CHIPS, DOPPLER_HZ = 7, 400.25, 1730.0


def day_of_level1() -> tuple[float, float]:
    """Seconds to read, screen and describe a day of one satellite (172,800 samples of four maps), and the peak memory
    (MiB) of this process afterwards, its libraries included.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "day.nc"
        _write_day(path)
        start = time.perf_counter()
        read_observations([path])
        seconds = time.perf_counter() - start
    return seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _write_day(path: Path) -> None:
    """A sound part repeated to the length of a day."""
    plan = WorldPlan(6600, 38.0, -110.0)
    points = make_specular_points(plan, plan.first_ms, plan.first_ms + 3 * DAY_MS, 0)
    part = path.with_name("part.nc")
    simulate_nominal(points, make_surface(plan), 1).write(part, {})
    with netCDF4.Dataset(part) as source, netCDF4.Dataset(path, "w") as target:
        source.set_auto_maskandscale(False)
        target.set_auto_maskandscale(False)
        for name, dimension in source.dimensions.items():
            target.createDimension(name, DAY_SAMPLES if name == "sample" else dimension.size)
        length = source.dimensions["sample"].size
        for name in source.variables.keys() - {"raw_counts"}:
            variable = source.variables[name]
            fill = getattr(variable, "_FillValue", None)
            options = {"zlib": True, "complevel": 1} if variable.ndim else {}
            made = target.createVariable(name, variable.dtype, variable.dimensions, fill_value=fill, **options)
            made.setncatts({key: variable.getncattr(key) for key in variable.ncattrs() if key != "_FillValue"})
            if not variable.ndim:
                made[...] = variable[...]
                continue
            values = variable[:]
            for start in range(0, DAY_SAMPLES, length):
                count = min(length, DAY_SAMPLES - start)
                made[start : start + count] = values[:count]


def second_of_raw_if() -> tuple[float, float]:
    """Seconds to map one second of a recording (1,000 ms), and the error of its code phase in chips."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "raw.bin"
        head = Header(2209, 432_000, 3, SAMPLING_HZ, (OSCILLATOR_HZ,) * 4)
        write_recording(path, head, _samples(int(1.001 * SAMPLING_HZ) // 4 * 4, head.intermediate_hz(1)))
        recording = read_recording(path)
        delay_doppler_map(recording, PRN, 1, DOPPLER_HZ, milliseconds=2, search_hz=250.0)
        start = time.perf_counter()
        made = delay_doppler_map(recording, PRN, 1, DOPPLER_HZ + 40.0, milliseconds=1000)
        return time.perf_counter() - start, abs(made.acquired.code_phase_chips - PHASE_CHIPS)


def _samples(count: int, intermediate_hz: float) -> np.ndarray:
    """Noise in three channels, a reflection 18 dB below it in the second."""
    rng = np.random.default_rng(3)
    n = np.arange(count)
    values = rng.standard_normal((3, count), dtype=np.float32)
    code = replica(PRN, PHASE_CHIPS + n * (CODE_RATE_HZ * (1 + DOPPLER_HZ / GPS_L1_HZ) / SAMPLING_HZ))
    values[1] += 0.12 * code * np.cos(2 * np.pi * (((intermediate_hz + DOPPLER_HZ) / SAMPLING_HZ * n) % 1.0))
    return (np.where(np.abs(values) > 1, 3, 1) * np.where(values >= 0, 1, -1)).astype(np.int8)


if __name__ == "__main__":
    print("level-1 day: {:.1f} s, {:.0f} MiB".format(*day_of_level1()))
    print("raw-IF second: {:.2f} s, code phase off by {:.3f} chips".format(*second_of_raw_if()))
