"""Where and when: orbits, specular points, target coverage, station contacts, eclipses."""
