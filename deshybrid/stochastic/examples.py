"""Small systems for documentation and first steps."""

from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem


def calm_and_wild() -> StochasticSystem:
    """Return a scalar random walk that is calm (variance 0.1 a step) or wild (9), measured with variance 1.

    >>> calm_and_wild().names
    ('calm', 'wild')
    """
    calm = Mode("calm", F=[[1.0]], H=[[1.0]], Q=[[0.1]], R=[[1.0]])
    wild = Mode("wild", F=[[1.0]], H=[[1.0]], Q=[[9.0]], R=[[1.0]])
    chain = ModeTransition.from_rows(("calm", "wild"), [[0.9, 0.1], [0.2, 0.8]])
    return StochasticSystem((calm, wild), chain, x=[0.0], P=[[1.0]], mu=[0.5, 0.5])


__all__ = ["calm_and_wild"]
