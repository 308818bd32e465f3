"""Pictures of one fire: its arrival, what is known of its surroundings, where it may go next, and a film."""
