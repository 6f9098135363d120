"""The hybrid observer and its reference step."""
