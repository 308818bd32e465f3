"""Retrieval: what was seen. Delay-Doppler maps become burned area and soil moisture; the simulator stands in for
them.
"""
