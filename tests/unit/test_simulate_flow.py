"""The flow over any stretch of time equals the matrix exponential of the whole block."""

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location
from deshybrid.simulate.flow import build_flow, outputs_of

SYSTEM = HybridSystem("f", (), (), (), ("p", "q", "r"), ("u", "v"), ("y", "z"), ("w",))


def _location(scale: float) -> Location:
    rng = np.random.default_rng(4)
    dynamics = LinearDynamics(
        A=rng.normal(size=(3, 3)) * scale,
        B=rng.normal(size=(3, 1)),
        C=rng.normal(size=(1, 3)),
        D=np.array([[2.0]]),
        E=rng.normal(size=(3, 1)),
        f=rng.normal(size=3),
        g=np.array([0.5]),
    )
    return Location("a", dynamics, input_index=(1,), output_index=(1,))


@pytest.mark.parametrize("scale", [0.01, 1.0, 30.0, 1000.0])
@pytest.mark.parametrize("share", [1e-6, 0.1, 0.5, 1.0])
def test_state_after_a_duration_is_that_of_the_matrix_exponential(scale, share):
    """The unused input `u` has no influence, whatever its value."""
    location, tick = _location(scale), 0.01
    flow = build_flow(SYSTEM, location, tick)
    z = np.array([1.0, -2.0, 0.5, 99.0, 0.7, -0.3, 1.0])
    d = location.dynamics
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3] = d.A, d.B[:, 0] * 0.7 + d.E[:, 0] * -0.3 + d.f
    expected = (expm(block * tick * share) @ [1.0, -2.0, 0.5, 1.0])[:3]
    np.testing.assert_allclose(flow.after(z, tick * share), expected, rtol=1e-12, atol=1e-13)
    if share == 1.0:
        np.testing.assert_allclose(flow.whole @ z, expected, rtol=1e-12, atol=1e-13)


def test_measured_channels_are_those_of_the_location():
    location = _location(1.0)
    states, inputs = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([[9.0, 1.0], [9.0, 2.0]])
    channels, values = outputs_of(SYSTEM, location, states, inputs)
    assert channels == [1]
    expected = location.dynamics.C[0, :2] + 2.0 * np.array([1.0, 2.0]) + 0.5
    np.testing.assert_allclose(values[:, 0], expected)
