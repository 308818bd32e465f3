"""When the fire reached every place, from scattered looks at it."""
