"""Linear algebra of one location."""
