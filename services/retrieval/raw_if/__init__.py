"""Raw-IF recordings: samples, C/A codes, acquisition, delay-Doppler map."""
