"""A bead over hills in the plane: impacts along the slope's normal, then sliding."""

import jax.numpy as jnp
import numpy as np

import hybrid as hy


class Hills(hy.Automaton):
    """A point mass above ``y = height cos(k x)``, frictionless, under gravity."""

    x = hy.state(unit="m")
    y = hy.state(unit="m")
    vx = hy.state(unit="m/s")
    vy = hy.state(unit="m/s")

    g: float = hy.parameter(9.81, unit="m/s^2", positive=True)
    r: float = hy.parameter(0.6, between=(0, 1), doc="coefficient of restitution")
    height: float = hy.parameter(0.1, unit="m")
    k: float = hy.parameter(1.0, unit="rad/m")

    @hy.mode(initial=True)
    def flight(self, t, s):
        return s.vx, s.vy, 0.0, -self.g

    impact = hy.contact(
        flight, gap=lambda self, t, s: s.y - self.height * jnp.cos(self.k * s.x), restitution="r"
    )


START = {"x": 0.5, "y": 0.5, "vx": 0.0, "vy": 0.0}
UNTIL = (0.0, 12.0)


def oracle(run):
    """Energy is kept while the bead slides, and lost by ``1 - r^2`` of the normal part before."""
    g, height, k = (float(run.parameters[n]) for n in ("g", "height", "k"))
    end, late = run.zeno[0], run(np.linspace(run.zeno[0].t, UNTIL[1], 50))
    energy = 0.5 * (late.vx**2 + late.vy**2) + g * late.y
    kept = 0.5 * (end.state.vx**2 + end.state.vy**2) + g * end.state.y
    yield "energy while sliding", float(np.max(np.abs(energy - kept))), 0.0, 1e-8
    yield "on the hills", float(np.max(np.abs(late.y - height * np.cos(k * late.x)))), 0.0, 1e-14
    u = (
        run.jumps.before.vy[0]
        + height * k * np.sin(k * run.jumps.before.x[0]) * run.jumps.before.vx[0]
    )
    w = (
        run.jumps.after.vy[0]
        + height * k * np.sin(k * run.jumps.after.x[0]) * run.jumps.after.vx[0]
    )
    yield "Newton's law on the gap's speed", -w / u, float(run.parameters["r"]), 1e-12
