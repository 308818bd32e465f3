"""Physical and signal constants: the only numbers that the simulator and the retrieval share."""

from __future__ import annotations

SPEED_OF_LIGHT_M_S = 299_792_458.0
BOLTZMANN_J_K = 1.380649e-23
GPS_L1_HZ = 1_575.42e6  # IS-GPS-200
WAVELENGTH_M = SPEED_OF_LIGHT_M_S / GPS_L1_HZ  # 0.19029 m
CODE_RATE_HZ = 1.023e6  # C/A chips per second
CODE_LENGTH_CHIPS = 1023
SAMPLING_HZ = 16_036_200.0  # CYGNSS raw-IF recordings (ATBD 148-0397)
FILL = -9999.0  # CYGNSS level-1 fill value of floats
