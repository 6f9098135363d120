"""Residual generators and decision functions."""
