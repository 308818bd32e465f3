"""The large-fire model: its columns, training, skill on unseen fires, and ratings of active fires."""
