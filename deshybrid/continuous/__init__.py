"""Switched error dynamics: gains, dwell-time certificates, ultimate bounds."""
