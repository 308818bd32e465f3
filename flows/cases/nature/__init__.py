"""The nature run: terrain, fuels, weather, soil, fire spread and what satellites see of it, from a seed."""
