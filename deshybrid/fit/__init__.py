"""Identification of a model's parameters from traces."""
