"""Active-fire products of others as looks: fire, no fire, cloud and water told apart, footprints by scan angle."""
