"""Plausibility of a scenario: sizes that no debris, ball or arm has are asked about, never refused."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ..dynamics.surfaces import make_debris
from ..measurement.plausibility import RANGES, Implausibility
from .scenario import make_body
from .scenario_file import Scenario


# From the smallest CubeSats to beyond the largest satellites, for which no scenario of one ball is meant [m].
SIZE = (0.05, 50.0)
DENSITY = (1.0, 2.5e4)  # from satellites with folded-out arrays, taken for one box, to solid heavy metal [kg/m³]
OFF = (0.0, 0.05)  # of the body's extent, by which the middle of an area to strike may lie off the surface
# A turn in days to one in a second, at which spinning satellites were released: debris tumbles far more slowly [rad/s].
RATE = (1e-5, 6.3)
# Moments of inertia over those of uniform density: all mass on the surface makes 3, masts and arrays beyond it more.
PROPORTION = (0.05, 6.0)
FRACTION, ANGLE = (0.0, 0.5), (0.0, 45.0)  # of errors, beyond which nothing is known that a plan could be made for [°]


def check_scenario(scenario: Scenario, here: Path) -> tuple[Implausibility, ...]:
    """Find implausible sizes in a scenario whose files lie in the folder `here`: of the body its size, density, moments
    of inertia and angular velocity; of ball and arm pressure, mass and speed; an area to strike that lies off the body;
    errors of arm and estimate that leave nothing known.

    Returns:
        What should be asked about, none where all is ordinary; of size and density, of which one follows from the
        other, the first.
    """
    table, arm = scenario.debris, scenario.arm
    body = make_body(table, here)
    uniform = make_debris(body)
    size = 2.0 * float(uniform.surface.reach())
    density = float(body.mass) / float(body.volume())
    key = {"box": "lengths", "mesh": "scale", "sphere": "radius"}.get(table.shape, "length")
    shape = [_doubt(f"debris.{key}", "the body's largest extent", size, SIZE, "m", "is that in metres?"),
             _doubt("debris.mass", "the mean density of the body", density, DENSITY, "kg/m³",
                    "are its mass in kg and its shape in metres?")]
    found = [next(filter(None, shape), None)]
    if table.inertia is not None:
        ratios = np.diag(np.asarray(table.inertia, dtype=float)) / np.diag(np.asarray(uniform.inertia))
        worst = int(np.argmax(np.abs(np.log(np.maximum(ratios, 1e-300)))))
        found.append(_doubt("debris.inertia", f"the moment of inertia about body {'xyz'[worst]} over that of uniform "
                            "density", float(ratios[worst]), PROPORTION, "1",
                            "are its axes those of the shape, and its unit kg m²?"))
    if table.angular_velocity is not None:
        rate = float(np.linalg.norm(np.asarray(table.angular_velocity, dtype=float)))
        found.append(_doubt("debris.angular_velocity", "the angular velocity", rate, RATE, "rad/s",
                            "numbers without a unit are in rad/s; write \"25 deg/s\" if that is meant."))
    for pressure in scenario.limits.pressure:
        found.append(_doubt("limits.pressure", "an initial pressure", float(pressure), RANGES["initial_pressure"],
                            "Pa", "is that absolute, and in Pa?"))
    if scenario.limits.target is not None:
        off = abs(float(uniform.surface.find_foot(jnp.asarray(scenario.limits.target, float)).distance))
        found.append(_doubt("limits.target", "the distance of the target from the surface, over the body's extent",
                            off / size, OFF, "1", "is it in the coordinates of the shape, and in metres?"))
    if arm.mass is not None:
        found.append(_doubt("arm.mass", "the apparent mass", float(arm.mass), RANGES["moving mass"], "kg",
                            "is that in kg?"))
    found.append(_doubt("arm.speed", "the largest speed of the arm", float(arm.speed), RANGES["approach_speed"], "m/s",
                        "is that in m/s?"))
    found += [_doubt(f"errors.{name}", f"the error of the {what}", getattr(scenario.errors, name), FRACTION, "1",
                     "it is a share: 0.05 is 5 %.")
              for name, what in (("speed", "arm's speed"), ("rates", "angular velocity"), ("inertia", "inertia"))]
    found += [_doubt(f"errors.{name}_degrees", f"the error of the {name}", getattr(scenario.errors, f"{name}_degrees"),
                     ANGLE, "°", "is that in degrees?") for name in ("direction", "attitude")]
    found.append(_doubt("errors.place", "the error of the place, over the body's extent", scenario.errors.place / size,
                        FRACTION, "1", "is that in metres?"))
    return tuple({one.variable: one for one in reversed(found) if one is not None}.values())[::-1]


def _doubt(key: str, what: str, value: float, limits: tuple[float, float], unit: str, question: str
           ) -> Implausibility | None:
    """The question about a value beyond its limits; None where it lies within them."""
    low, high = limits
    if low <= value <= high:
        return None
    shown = "" if unit == "1" else f" {unit}"
    return Implausibility(key, value, low, high, unit, (), f"Sizes: {what} ({key}) is {value:.4g}{shown}, where "
                          f"{low:.6g} to {high:.6g}{shown} is expected; {question}")
