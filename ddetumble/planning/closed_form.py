r"""An impact by closed forms, for thousands of designs at once: what it leaves of the momentum, and every constraint.

A contact is short, but not as short as none: a ball that slides fast is on another place of the surface before it
leaves, and a body that turns brings that place towards it or takes it away. So the contact is judged twice, as it would
be from the first touch on, and from that at the place and with the velocity of its middle.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._rotation import from_rotation_vector, multiply, rotate, rotate_back
from ..contact.damping import damped_work
from ..contact.gripping import Patch, find_height
from ..inference.programs import keep_program
from .constraints import Parting, judge
from .problem import SLIPS, SPEED, Design, StrikeProblem, read_design, score, span_plane


SETTLED = 0.999  # of the arm's speed, to which designs that are looked at are brought: just inside
SOLVED = 6  # times that the restitution is put into its own equation, for three digits from 0.4 on
PROBE = 5e-3  # m, depression at which the contact is read off: that of a usual strike
SHARES = np.linspace(0.0, 1.0, 5)  # of the contact, at which the distance of the growing disc from edges is looked at
RATES = np.linspace(0.0, 1.0, 9)  # over the approach speed, at which the largest force is looked for


@keep_program((0.0, 0.0))
def screen(problem: StrikeProblem, faces: Array, designs: Array) -> tuple[Array, Array]:
    r"""Many designs, their velocities changed where the arm is too slow, shape (designs, 7), and what is wanted small
    and all constraints of these, by closed forms, shape (designs, 1 + constraints).

    Normal impulse $m (1 + e) v_1$, $1/m = n^T M^{-1} (n - \mu t)$ with $M^{-1}$ what an impulse at the point moves ball
    and surface by; friction that slides throughout or stops the slip; peaks of $k \delta^2 (1 + c_n w)$; all of it at
    the place that the disc has slid to, and with the velocity that the surface has turned to, half the contact later.
    """
    def one(face, x):
        x = _settle(problem, face, x)
        return x, _estimate(problem, face, x)

    return jax.vmap(one)(faces, designs)


def _settle(problem: StrikeProblem, face: Array, x: Array) -> Array:
    """A design whose arm is no faster than it can: its velocity cut along the normal first, then across."""
    design, most = read_design(problem, face, x), SETTLED * problem.limits.speed
    local, normal = rotate_back(design.attitude, design.velocity), rotate_back(design.attitude, design.normal)
    first, second = span_plane(normal)
    along, across = normal @ local, jnp.stack([first @ local, second @ local])
    kept = jnp.clip(along, -most, most)
    # Where the surface recedes faster than the arm can follow, nothing is kept of the approach: that stays a violation.
    approach = jnp.maximum(x[SPEED] + (along - kept) / problem.unit, jnp.minimum(x[SPEED], 0.0))
    size = jnp.sqrt(jnp.sum(across**2) + 1e-300)
    cut = jnp.minimum(1.0, jnp.sqrt(most**2 - kept**2) / size) - 1.0
    return x.at[SPEED].set(approach).at[SLIPS].add(cut * across / problem.unit)


class _Impulse(NamedTuple):
    """What closed forms make of a contact whose place, normal and relative velocity are those at its middle."""

    push: Array  # impulse on the surface, body components, shape (3,) [N s]
    slide: Array  # of the disc over the surface while the contact lasts, shape (3,) [m]
    duration: Array  # [s]
    force: Array  # at its peak [N]
    depth: Array  # [m]
    radius: Array  # of the disc, over the depth [-]
    restitution: Array  # [-]


def _find_impulse(problem: StrikeProblem, design: Design, point: Array, normal: Array, relative: Array,
                  touched: Array | None = None) -> _Impulse:
    """Of a place, its normal and the ball's velocity over the surface there, all in body components; `touched` is the
    approach speed at first touch, where that is another one.
    """
    debris, reference, law = problem.debris, problem.law.reference, problem.law.normal
    approach = jnp.maximum(-(normal @ relative), 1e-3 * problem.limits.approach)
    conditions = {**problem.conditions, "initial_pressure": design.pressure, "approach_speed": approach}
    diameter, damping = law.start(conditions)
    contact = law.press(conditions, diameter, jnp.asarray(PROBE))
    kappa = jnp.maximum(damping * approach, 0.0)
    restitution = 1.0 / (1.0 + 0.7 * kappa)
    for _ in range(SOLVED):
        again = jnp.sqrt(damped_work(kappa) / damped_work(-jnp.minimum(kappa * restitution, 0.999)))
        restitution = 0.6 * restitution + 0.4 * again

    across = relative - (normal @ relative) * normal
    slip = jnp.sqrt(jnp.sum(across**2) + 1e-12)
    patch = Patch(jnp.zeros(()), jnp.asarray(PROBE), contact.contact_radius, find_height(diameter, jnp.zeros(())),
                  contact.pressure, contact.elastic_force, conditions)
    friction = problem.law.limit(patch, slip, jnp.zeros(()), jnp.zeros(())) / contact.elastic_force
    # What a tangential impulse changes the slip by: of ball, arm and body. It stops the slip at most.
    inverse = jnp.linalg.inv(debris.inertia)  # the same for all designs, where to solve would be done for each
    lever, turned = jnp.cross(point, normal), jnp.cross(point, across / slip)
    give = (1.0 / reference.tangential_mass + 1.0 / reference.rolling_mass + 1.0 / debris.mass
            + turned @ inverse @ turned)
    mass = 1.0 / (1.0 / reference.ball.inertia() + 1.0 / debris.mass + lever @ inverse @ lever)
    friction = jnp.minimum(friction, slip / (give * mass * (1.0 + restitution) * approach))
    # Friction turns the body towards the ball or away from it, and so changes the mass that is felt along the normal.
    mass = 1.0 / jnp.maximum(1.0 / mass - friction * (lever @ inverse @ turned), 0.1 / mass)
    impulse = mass * (1.0 + restitution) * approach

    # F = k depth^2 (1 + kappa s), s the rate over the approach: k depth^3 / 3 is the work of the spring down to s.
    stiff, rates = contact.elastic_force / PROBE**2, jnp.asarray(RATES)
    # A constant pull changes the speed by a T / 2 until the middle of a half-wave, but its amplitude as a T / pi would.
    lead = approach if touched is None else jnp.maximum(touched + (approach - touched) / (0.5 * jnp.pi), 0.1 * approach)
    work = mass * lead**2 * (damped_work(kappa) - rates**2 * damped_work(kappa * rates))
    depths = jnp.cbrt(3.0 * work / stiff)
    force, depth = jnp.max(stiff * depths**2 * (1.0 + kappa * rates)), depths[0]
    duration = 1.4 * depth / approach * (1.0 + 1.0 / restitution)  # 1.4 depths over the speed on the way in and out
    slide = duration * (1.0 - 0.5 * friction * impulse * give / slip) * across
    return _Impulse(impulse * (friction * across / slip - normal), slide, duration, force, depth,
                    contact.contact_radius / PROBE, restitution)


def _estimate(problem: StrikeProblem, face: Array, x: Array) -> Array:
    """Score and constraints of a design whose arm is no faster than it can."""
    debris, reference = problem.debris, problem.law.reference
    design = read_design(problem, face, x)
    point, rates, inverse = design.point, design.angular_velocity, jnp.linalg.inv(problem.debris.inertia)
    foot = debris.surface.find_foot(point)
    relative = rotate_back(design.attitude, design.velocity) - jnp.cross(rates, point)
    first = _find_impulse(problem, design, point, foot.normal, relative)
    # Half the contact later the disc has slid on, and the surface has turned under the ball, which keeps its velocity:
    # what is struck is the place, and with the velocity, of the middle of the contact.
    spun = inverse @ jnp.cross(debris.inertia @ rates, rates)
    turning = -2.0 * jnp.cross(rates, relative) - jnp.cross(rates, jnp.cross(rates, point)) - jnp.cross(spun, point)
    place = point + 0.5 * first.slide
    middle = debris.surface.find_foot(place)
    struck = place - middle.distance * middle.normal
    blow = _find_impulse(problem, design, struck, middle.normal, relative + 0.5 * first.duration * turning,
                         -(foot.normal @ relative))
    after = rates + inverse @ jnp.cross(struck, blow.push)

    # No longer than from the first touch on: closed forms of a surface that turns away have no end.
    duration = jnp.minimum(first.duration, blow.duration)
    slide = blow.slide * duration / blow.duration
    slid = jax.jvp(lambda place: debris.surface.find_foot(place).margins, (point,), (slide,))[1]
    discs = blow.radius * blow.depth * jnp.sin(jnp.pi * SHARES)
    margins = jnp.min(foot.margins + SHARES[:, None] * slid - discs[:, None], axis=0)
    last = debris.surface.find_foot(point + slide)
    normal = middle.normal
    back = normal * (normal @ blow.push) / reference.ball.inertia()
    slowed = (blow.push - normal * (normal @ blow.push)) / reference.tangential_mass
    halfway, ended = (multiply(design.attitude, from_rotation_vector(part * duration * rates)) for part in (0.5, 1.0))
    # It has left where what it brings out of the contact is more than what the surface takes that comes after it.
    speed, chased, square = -(foot.normal @ relative), -2.0 * (normal @ turning) * blow.depth, blow.restitution**2
    leaving = (square * speed**2 - (1.0 - square) * chased) / (speed**2 + jnp.abs(chased))
    parting = Parting(ended, after, jnp.zeros(3), rotate(halfway, blow.push) / debris.mass,
                      design.velocity - rotate(halfway, back + slowed), point + slide - last.distance * last.normal,
                      margins, speed, blow.force, blow.depth, blow.depth * jnp.maximum(-leaving, 0.0))
    return jnp.stack([score(problem, after), *judge(problem, design, parting)])
