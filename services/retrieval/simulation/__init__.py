"""The satellites' stand-in: a forward model of CYGNSS delay-Doppler maps. The retrieval imports nothing from here."""
