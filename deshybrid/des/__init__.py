"""Automata: discrete-event systems, epsilon-elimination, observers, observability, signatures."""
