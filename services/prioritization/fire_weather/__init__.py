"""Fire weather indices as maps, from upper-air weather, and the statement of what each index is."""
