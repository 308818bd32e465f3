"""References, roots, manifests, the store and the catalogue."""
