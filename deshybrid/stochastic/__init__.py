"""Discrete-time stochastic linear hybrid systems: Kalman filters for known and for unknown modes; useful alone."""
