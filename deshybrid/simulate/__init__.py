"""Executions of a hybrid system, traces, replay of an observer on a trace, and its score."""
