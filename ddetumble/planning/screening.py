r"""One impact in closed form, for thousands of designs at once: where searches start, never a plan's result."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .._rotation import rotate, rotate_back
from ..contact.damping import damped_work
from ..contact.gripping import Patch, find_height
from .strike_problem import (
    SLIPS,
    SPEED,
    Parting,
    StrikeProblem,
    judge_margins,
    keep_clear,
    read_design,
    score,
    span_plane,
)


SETTLED = 0.999  # of the arm's speed, to which designs that are looked at are brought: just inside
SOLVED = 6  # times that the restitution is put into its own equation, for three digits from 0.4 on
PROBE = 5e-3  # m, depression at which the contact is read off
RATES = np.linspace(0.0, 1.0, 9)  # over the approach speed, at which the largest force is looked for


@eqx.filter_jit
def screen(problem: StrikeProblem, faces: Array, designs: Array) -> tuple[Array, Array]:
    r"""What is wanted small and all constraints of many designs.

    Normal impulse $m (1 + e) v_1$, $1/m = n^T M^{-1} (n - \mu t)$ with $M^{-1}$ what an impulse at the point moves ball
    and surface by; friction that slides throughout or stops the slip; peaks of $k \delta^2 (1 + c_n w)$.

    Returns:
        The designs, their velocities changed where the arm is too slow for them, shape (designs, 7); the columns, shape
        (designs, 1 + constraints).
    """
    def one(face, x):
        x = _settle(problem, face, x)
        return x, _estimate(problem, face, x)

    return jax.vmap(one)(faces, designs)


def _settle(problem: StrikeProblem, face: Array, x: Array) -> Array:
    """A design whose arm is no faster than it can: its velocity cut along the normal first, then across."""
    design, most = read_design(problem, face, x), SETTLED * problem.limits.speed
    local = rotate_back(design.attitude, design.velocity)
    normal = rotate_back(design.attitude, design.normal)
    first, second = span_plane(normal)
    along, across = normal @ local, jnp.stack([first @ local, second @ local])
    kept = jnp.clip(along, -most, most)
    # Where the surface recedes faster than the arm can follow, nothing is kept of the approach: that stays a violation.
    approach = jnp.maximum(x[SPEED] + (along - kept) / problem.unit, jnp.minimum(x[SPEED], 0.0))
    size = jnp.sqrt(jnp.sum(across**2) + 1e-300)
    cut = jnp.minimum(1.0, jnp.sqrt(most**2 - kept**2) / size) - 1.0
    return x.at[SPEED].set(approach).at[SLIPS].add(cut * across / problem.unit)


def _estimate(problem: StrikeProblem, face: Array, x: Array) -> Array:
    limits, debris, reference, law = problem.limits, problem.debris, problem.law.reference, problem.law.normal
    design = read_design(problem, face, x)
    foot = debris.surface.find_foot(design.point)
    normal = foot.normal
    relative = rotate_back(design.attitude, design.velocity) - jnp.cross(design.angular_velocity, design.point)
    speed = -(normal @ relative)
    approach = jnp.maximum(speed, 1e-3 * limits.approach)
    conditions = {**problem.conditions, "initial_pressure": design.pressure, "approach_speed": approach}
    diameter, damping = law.start(conditions)
    contact = law.contact(conditions, diameter, jnp.zeros(()), jnp.asarray(PROBE), jnp.zeros(()),
                          jnp.zeros((len(law.stateful()),)))
    kappa = jnp.maximum(damping * approach, 0.0)
    restitution = 1.0 / (1.0 + 0.7 * kappa)
    for _ in range(SOLVED):
        again = jnp.sqrt(damped_work(kappa) / damped_work(-jnp.minimum(kappa * restitution, 0.999)))
        restitution = 0.6 * restitution + 0.4 * again

    across = relative + speed * normal
    slip = jnp.sqrt(jnp.sum(across**2) + 1e-12)
    height = find_height(diameter, jnp.zeros(()))
    patch = Patch(jnp.zeros(()), jnp.asarray(PROBE), contact.contact_radius, height, contact.pressure,
                  contact.elastic_force, conditions)
    friction = problem.law.limit(patch, slip, jnp.zeros(()), jnp.zeros(())) / contact.elastic_force
    # What a tangential impulse changes the slip by: of ball, arm and body. It stops the slip at most.
    inverse = jnp.linalg.inv(debris.inertia)  # the same for all designs, where to solve would be done for each
    lever, turned = jnp.cross(design.point, normal), jnp.cross(design.point, across / slip)
    give = (1.0 / reference.tangential_mass + 1.0 / reference.rolling_mass + 1.0 / debris.mass
            + turned @ inverse @ turned)
    mass = 1.0 / (1.0 / reference.ball.inertia() + 1.0 / debris.mass + lever @ inverse @ lever)
    friction = jnp.minimum(friction, slip / (give * mass * (1.0 + restitution) * approach))
    # Friction turns the body towards the ball or away from it, and so changes the mass that is felt along the normal.
    mass = 1.0 / jnp.maximum(1.0 / mass - friction * (lever @ inverse @ turned), 0.1 / mass)
    impulse = mass * (1.0 + restitution) * approach
    push = impulse * (friction * across / slip - normal)
    after = design.angular_velocity + inverse @ jnp.cross(design.point, push)

    # F = k depth^2 (1 + kappa s), s the rate over the approach: k depth^3 / 3 is the work of the spring down to s.
    stiff, rates = contact.elastic_force / PROBE**2, jnp.asarray(RATES)
    work = mass * approach**2 * (damped_work(kappa) - rates**2 * damped_work(kappa * rates))
    depths = jnp.cbrt(3.0 * work / stiff)
    force, depth = jnp.max(stiff * depths**2 * (1.0 + kappa * rates)), depths[0]

    # The disc slides on while the contact lasts, which is 1.4 depths over the speed on the way in and out.
    slide = 1.4 * depth / approach * (1.0 + 1.0 / restitution) * (1.0 - 0.5 * friction * impulse * give / slip) * across
    slid = jax.jvp(lambda point: debris.surface.find_foot(point).margins, (design.point,), (slide,))[1]
    margins = foot.margins + jnp.minimum(slid, 0.0) - contact.contact_radius * depth / PROBE
    back = normal * (normal @ push) / reference.ball.inertia()
    slowed = (push - normal * (normal @ push)) / reference.tangential_mass
    parting = Parting(design.attitude, after, jnp.zeros(3), rotate(design.attitude, push) / debris.mass,
                       design.velocity - rotate(design.attitude, back + slowed))
    return jnp.stack([
        score(problem, after), 1.0 - jnp.sum(design.velocity**2) / limits.speed**2, speed / limits.approach - 1.0,
        1.0 - force / limits.force, 1.0 - depth / limits.depression, *judge_margins(limits, margins),
        jnp.dot(design.normal, limits.chaser) - jnp.cos(limits.cone),
        keep_clear(problem, design, parting, height) / 0.01])
