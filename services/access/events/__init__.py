"""Events of a satellite against the ground and the Sun: contacts with stations, eclipses, and their timeline."""
