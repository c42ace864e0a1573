"""What cannot be meant is refused with one kind of error, which names the value."""

import numpy as np
import pytest

import hybrid as hy
from models.bouncing_ball import BouncingBall

START = {"x": 1.0, "v": 0.0}
HUGE = 10**400  # larger than any float


def run(start=START, t=(0.0, 1.0), **options):
    return hy.simulate(BouncingBall(), start, t, **options)


@pytest.mark.parametrize(
    "options",
    [
        {"mode": 3},
        {"mode": ["flight"]},
        {"rtol": "1e-3"},
        {"rtol": HUGE},
        {"atol": "small"},
        {"solver": ["scipy"]},
        {"solver": None},
        {"method": ["RK45"]},
        {"zeno": ["rest"]},
        {"max_jumps": True},
        {"max_jumps": 1.5},
        {"save": ["0.5"]},
        {"t": ("0", "1")},
        {"t": (0.0, 1j)},
        {"t": (0.0, HUGE)},
        {"t": np.array(["2020-01-01", "2020-01-02"], dtype="datetime64[s]")},
    ],
    ids=str,
)
def test_options(options):
    """An option of the wrong kind is an OptionError that names it."""
    with pytest.raises(hy.OptionError, match=next(iter(options))):
        run(**options)


@pytest.mark.parametrize(
    "start",
    [
        b"xv",
        "xv",
        {1.0, 0.0},
        [1.0 + 0j, 0.0],
        np.array([1 + 1j, 0]),
        np.ma.array([1.0, 0.0], mask=[False, True]),
        np.array([3, 4], dtype="datetime64[s]"),
        [HUGE, 0],
        None,
    ],
    ids=lambda start: type(start).__name__,
)
def test_starts(start):
    """Text, sets, dates, complex, masked and huge numbers are no starts."""
    with pytest.raises(hy.StartError, match="start"):
        run(start)


@pytest.mark.parametrize("value", ["9", None, 1j, HUGE, b"9", np.array(["1"])])
def test_parameters(value):
    """The model and the parameter are named."""
    with pytest.raises(hy.ParameterError, match=r"BouncingBall.g"):
        BouncingBall(g=value)


def test_a_mode_may_be_given_itself():
    """As in ``hy.edge``: the mode, or its name."""
    assert run(mode=BouncingBall.flight).final == run(mode="flight").final


def declared(more, flow=lambda self, t, s: (s.v, -1.0), **contact):
    """A class with some more in its body."""
    body = {"x": hy.state(), "v": hy.state(), "flight": hy.mode(flow), **more}
    if contact:
        gap = {"gap": lambda self, t, s: s.x, "restitution": 0.5}
        body["floor"] = hy.contact("flight", **{**gap, **contact})
    return type("Declared", (hy.Automaton,), body)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"y": hy.state(shape=(0,))}, r"state y: shape=\(0,\)"),
        ({"y": hy.state(shape="ab")}, "state y: shape='ab'"),
        ({"y": hy.state(shape=2.5)}, r"state y: shape=2\.5"),
        ({"keys": hy.state()}, "keys: a name in use"),
        ({"replace": hy.state()}, "replace: a name in use"),
        ({"spec": hy.parameter(1.0)}, "spec: a name in use"),
        ({"_spec": hy.parameter(1.0)}, "_spec: a name in use"),
        ({"parameters": hy.mode(lambda self, t, s: s)}, "parameters: a name in use"),
        ({"__init__": lambda self, a: None}, "an __init__ of its own"),
        ({"y": hy.state(), "flight": hy.mode(lambda self, t, s: (0, 0, 1j * s.x))}, "y: a complex"),
    ],
)
def test_declarations(more, said):
    """Shapes, names, an own __init__, complex flows: faults of the declaration."""
    with pytest.raises(hy.DeclarationError, match=said):
        declared(more)


@pytest.mark.parametrize(
    "mass",
    [0.0, -1.0, [0.0, 0.0], "m", np.nan, np.ones((2, 3)), 1j, [[1, 2], [0, 1]], [[1, 2], [2, 1]]],
)
def test_inverse_masses(mass):
    """A mass is a positive number; what is none is a fault of the declaration."""
    with pytest.raises(hy.DeclarationError, match="contact floor: inverse_mass"):
        declared({}, inverse_mass=mass)


@pytest.mark.parametrize("mass", [[1.0, 2.0], np.eye(2), lambda self, t, s: [[1.0, 2.0]]])
def test_inverse_masses_of_another_size(mass):
    """One number, or a matrix, for the positions of the gap."""
    model = declared({}, inverse_mass=mass)()
    with pytest.raises(hy.DeclarationError, match=r"contact floor: inverse_mass of shape .* where"):
        hy.simulate(model, [1.0, 0.0], (0.0, 1.0))
