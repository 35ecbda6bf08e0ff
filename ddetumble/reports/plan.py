"""Planned impacts as `plan.json` and a page: a view that turns, momentum and nutation over time, a table."""

import dataclasses as dc
import json
from importlib import metadata, resources
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import markupsafe
import numpy as np

from .._rotation import rotate_back
from ..dynamics.angles import measure_nutation
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import measure_momentum
from ..dynamics.surfaces import AbstractSurface, CylinderSurface, Polytope
from ..figures.plan import draw_contacts, draw_motion
from ..measurement.units import choose_time_unit
from ..planning.measured import (
    Extrapolation,
    format_extrapolation,
    list_extrapolations,
)
from ..planning.plan import Plan, find_end
from ..planning.problem import StrikeProblem
from ..planning.sequence import Sequence, measure_share
from ..planning.single import StrikePlan
from .outlook import list_outlook, show_outlook
from .page import Section, Table, draw_picture, write_page, write_whole


SCHEMA = "ddetumble.plan-result/2"
PLACES = 120  # times drawn between two impacts
ROUGH = 0.02  # share of the gradient left over, from which a plan is not called an optimum
SHOWN = 0.02  # share of the momentum from which an arrow of what is left can be seen
ENDED = 1e-3  # share of the score before, below which nothing is left to gain
FOUNDED = {
    "alone": "Each impact is the best of several starts for itself, from the motion that the one before left; the "
             "sequence as a whole is not proved to be the shortest. What is left of the gradient after the binding "
             "constraints' share says how nearly each is a first-order optimum.",
    "jointly": "The impacts were planned one after the other, and then optimised jointly, with the gradient through "
               "all of them and the motion between. What is left of that gradient after the binding constraints' "
               "share says how nearly the whole is a first-order optimum near where it began; another sequence may be "
               "better still."}
COLOURS = {"impulse": "#d55e00", "momentum": "#0072b2", "after": "#009e73"}


def list_impact(number: int, instant: float, share: float, plan: StrikePlan, beyond: list[Extrapolation]
                ) -> dict[str, Any]:
    """One impact as `plan.json` has it, SI."""
    design, collision, proof = plan.design, plan.collision, plan.certificate

    def row(vector):
        return [float(x) for x in np.asarray(vector)]

    return {
        "impact": number, "face": plan.face, "point": row(design.point), "instant": instant,
        "wait": float(design.instant), "attitude": row(design.attitude),
        "arm_velocity": row(design.velocity), "normal": row(design.normal), "initial_pressure": float(design.pressure),
        "approach_speed": float(collision.approach_speed), "tangential_speed": float(collision.tangential_speed),
        "duration": float(collision.separation), "peak_normal_force": float(collision.peak_force),
        "peak_depression": float(collision.peak_depression), "impulse": row(collision.impulse),
        "angular_momentum": row(collision.angular_momentum), "angular_velocity": row(collision.angular_velocity),
        "debris_velocity": row(collision.velocity), "share_left": share, "score": plan.score, "allowed": plan.allowed,
        "constraints": plan.values,
        "certificate": {"stationarity": proof.stationarity, "gradient_error": proof.gradient_error,
                        "binding": proof.binding, "edge_margin": proof.margin},
        "integrations": {"values": plan.tally.values, "gradients": plan.tally.slopes},
        "starts": [{"face": face, "score": score, "allowed": allowed} for face, score, allowed in plan.scores],
        "extrapolated": [{"value": one.value, **dc.asdict(one.measured)} for one in beyond],
    }  # fmt: skip


def follow_plan(problem: StrikeProblem, sequence: Sequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], angular momentum [N m s] and nutation angle [rad] from before the first to after the last impact."""
    inertia = problem.debris.inertia
    attitude, rates, begin = problem.attitude, problem.angular_velocity, 0.0
    found: list[tuple[np.ndarray, ...]] = []
    ends = [*sequence.instants, find_end(sequence)]
    for k, end in enumerate(ends):
        since = np.linspace(0.0, end - begin, PLACES)
        motion = propagate_torque_free(inertia, attitude, rates, since)
        momentum = measure_momentum(inertia, motion.attitude, motion.angular_velocity)
        nutation = measure_nutation(inertia, motion.angular_velocity)
        found.append((begin + since, np.asarray(momentum), np.asarray(nutation)))
        if k < len(sequence.impacts):
            after = sequence.impacts[k].collision
            attitude, rates, begin = after.attitude, after.angular_velocity, end + float(after.separation)
    time, momentum, nutation = (np.concatenate(part) for part in zip(*found, strict=True))
    return time, momentum, nutation


def trace_edges(surface: AbstractSurface) -> list[list[list[float]]]:
    """Lines that show a surface, each a row of points [m]."""
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    if isinstance(surface, CylinderSurface):
        radius, half = float(surface.radius), 0.5 * float(surface.length)
        rings = [radius * ring + [0.0, 0.0, z] for z in (-half, half)]
        rods = [np.stack([radius * ring[k] + [0.0, 0.0, z] for z in (-half, half)]) for k in range(0, 48, 6)]
        lines = [*rings, *rods]
    elif isinstance(surface, Polytope):
        from scipy.spatial import HalfspaceIntersection

        normals, offsets = np.asarray(surface.normals), np.asarray(surface.offsets)
        corners = HalfspaceIntersection(np.column_stack([normals, -offsets]), np.zeros(3)).intersections
        on = np.abs(corners @ normals.T - offsets) < 1e-6 * offsets.max()
        lines = [corners[[i, j]] for i in range(len(corners)) for j in range(i) if np.sum(on[i] & on[j]) >= 2]
    else:
        radius = float(surface.reach())
        lines = [radius * np.roll(ring, axis, axis=1) for axis in range(3)]
    return [np.asarray(line).round(4).tolist() for line in lines]


def make_view(problem: StrikeProblem, sequence: Sequence) -> markupsafe.Markup:
    """The body with points, impulses and angular momentum before and after, in the body frame, to be turned by hand."""
    reach = float(problem.debris.surface.reach())
    arrows = []
    momentum = np.asarray(problem.debris.inertia @ problem.angular_velocity)
    size = max(float(np.linalg.norm(momentum)), 1e-300)
    arrows.append({"tail": [0.0, 0.0, 0.0], "head": (1.3 * reach * momentum / size).tolist(),
                   "colour": COLOURS["momentum"], "label": "momentum before", "at": "head"})
    if sequence.impacts:
        left = np.asarray(problem.debris.inertia @ sequence.impacts[-1].collision.angular_velocity)
        if np.linalg.norm(left) > SHOWN * size:
            arrows.append({"tail": [0.0, 0.0, 0.0], "head": (1.3 * reach * left / size).tolist(),
                           "colour": COLOURS["after"], "label": "after", "at": "head"})
    largest = max((float(jnp.linalg.norm(plan.collision.impulse)) for plan in sequence.impacts), default=1.0)
    for number, plan in enumerate(sequence.impacts, 1):
        push = np.asarray(rotate_back(plan.design.attitude, plan.collision.impulse))
        head = np.asarray(plan.design.point)
        arrows.append({"tail": (head - 0.5 * reach * push / largest).tolist(), "head": head.tolist(),
                       "colour": COLOURS["impulse"], "label": str(number)})
    data = json.dumps({"lines": trace_edges(problem.debris.surface), "arrows": arrows, "reach": 1.3 * reach})
    script = resources.files("ddetumble.reports").joinpath("turning.js").read_text(encoding="utf-8")
    return markupsafe.Markup(
        '<canvas id="turning" tabindex="0" role="img" style="display:block;width:100%;touch-action:pan-y;cursor:grab" '
        'aria-label="The body with its impacts; drag or use the arrow keys to turn it"></canvas>'
        '<script type="application/json" id="turning-data">' + data.replace("<", "\\u003c") + "</script>"
        "<script>" + script + "</script>")


def write_plan(plan: Plan, folder) -> Path:
    """Write `plan.json` and `report.html` into a folder, made where it is not there; returns the page's path."""
    problem, sequence, share, ranges = plan.problem, plan.sequence, plan.settings.share, plan.ranges
    assessment, prospect, plan_for = plan.assessment, plan.prospect, plan.settings.plan_for
    title, source = plan.title, plan.source
    folder = Path(folder)
    sentence = plan.sentence
    beyond = list_extrapolations(ranges, sequence.impacts, problem.conditions)
    outside = [[one for one in beyond if one.impact == k] for k in range(1, len(sequence.impacts) + 1)]
    impacts = [list_impact(k + 1, sequence.instants[k], sequence.shares[k], one, outside[k])
               for k, one in enumerate(sequence.impacts)]
    best = sequence.refused
    result = {
        "schema": SCHEMA, "scenario": source, "title": title, "sentence": sentence, 
        "possible": True if impacts else None if best is not None and best.missed else False,
        "reached": sequence.reached, "wanted_share": share, "share_left": sequence.shares[-1] if impacts else 1.0,
        "impulse": sequence.impulse, "duration": sequence.duration,
        "joint": None if sequence.joint is None else dc.asdict(sequence.joint),
        "relaxations": [dc.asdict(one) for one in sequence.relaxations],
        "fewest_impacts": sequence.bound or None, "axial_share": sequence.floor,
        "impacts": impacts,
        "refused": None if best is None else {
            "face": best.face, "score": best.score, "untouched": best.untouched, "allowed": best.allowed,
            "estimate": best.estimate, "missed": best.missed,
            "share_left": measure_share(problem, np.asarray(best.collision.angular_velocity)),
            "constraints": best.values},
        "measured": [dc.asdict(one) for one in ranges],
        "uncertainty": None if assessment is None else list_outlook(assessment, plan_for, prospect),
        "version": metadata.version("ddetumble"),
    }  # fmt: skip
    time, momentum, nutation = follow_plan(problem, sequence)
    figures = [draw_picture("motion", "Angular momentum, inertial components, and nutation angle; dotted: impacts.",
                            draw_motion, time, momentum, nutation, sequence.instants)]
    if impacts:
        chosen = sorted({0, len(impacts) // 2, len(impacts) - 1})
        courses = [sequence.impacts[k].collision.course for k in chosen]
        drawn = ([np.asarray(c.time) for c in courses], [np.asarray(c.normal_force) for c in courses],
                 [np.linalg.norm(np.asarray(c.friction), axis=1) for c in courses], [f"impact {k + 1}" for k in chosen])
        alike = " Where there are fewer lines than impacts, some coincide." if len(chosen) > 1 else ""
        figures.append(draw_picture("contacts", f"Normal force and friction during contact.{alike}", draw_contacts,
                                    *drawn))
    unit, factor = choose_time_unit(find_end(sequence))
    table = Table(
        ["impact", f"at [{unit}]", "face", "point, body [m]", "arm's velocity, inertial [m/s]", "pressure [MPa]",
         "peak force [N]", "depression [mm]", "contact [ms]", "momentum left [%]", "limits reached"],
        [[str(one["impact"]), f"{factor * one['instant']:.{4 if unit == 'h' else 2}f}", one["face"],
          _list(one["point"]), _list(one["arm_velocity"]), f"{one['initial_pressure'] / 1e6:.3f}",
          f"{one['peak_normal_force']:.1f}", f"{1e3 * one['peak_depression']:.2f}", f"{1e3 * one['duration']:.1f}",
          f"{100 * one['share_left']:.3f}",
          ", ".join(one["certificate"]["binding"]) or "none"]
         for one in impacts])
    farther = [f"Impact {k}, beyond what was measured: {', '.join(map(format_extrapolation, others))}."
               for k, others in enumerate(outside, 1) if others]
    proofs = Table(
        ["impact", "gradient left over", "gradient against differences", "disc to edge [mm]",
         "integrations", "gradients", "score of each start"],
        [[str(one["impact"]), f"{one['certificate']['stationarity']:.1e}",
          f"{one['certificate']['gradient_error']:.1e}",
          f"{1e3 * one['certificate']['edge_margin']:.1f}", str(one["integrations"]["values"]),
          str(one["integrations"]["gradients"]),
          ", ".join(f"{start['score']:.4f}" for start in one["starts"])] for one in impacts])
    sections = [
        Section("Where to strike", [
            make_view(problem, sequence), "The body in its own frame. Blue: the angular momentum before; green: after "
            "the last impact, to the same scale, where enough is left. Orange: the impulse of each impact, its head at "
            "the point of contact. Drag to turn."]),
        Section("Before, between and after", [], figures=figures, tables=[table] if impacts else [], points=farther),
    ]
    if assessment is not None:
        sections.append(show_outlook(assessment, plan_for, prospect, share))
        sentence += " " + (assessment.sentences[0] if prospect is None else prospect.sentence)
    if impacts:
        sections.append(Section(
            "How well the plan is founded",
            [FOUNDED["jointly" if sequence.joint is not None and sequence.joint.taken else "alone"],
             *list_doubts(sequence)], tables=[proofs]))
    folder.mkdir(parents=True, exist_ok=True)
    page = write_page(title or "Planned impacts", sentence, sections, folder, "report.html")
    write_whole(folder / "plan.json", (json.dumps(result, indent=1, allow_nan=False) + "\n").encode())
    return page


def list_doubts(sequence: Sequence) -> list[str]:
    """Which impacts are no first-order optimum, and of which the gradient says nothing."""
    done = [k for k, plan in enumerate(sequence.impacts, 1) if plan.score <= ENDED * plan.untouched]
    rough = [k for k, plan in enumerate(sequence.impacts, 1)
             if plan.certificate.stationarity > ROUGH and k not in done]
    told = []
    if done:
        told.append(f"Impact {', '.join(map(str, done))} leaves next to nothing: there is nothing more to gain, and "
                    "where a size is nought it has no gradient.")
    if rough:
        told.append(f"No first-order optimum to {100 * ROUGH:g} % of the gradient: impact "
                    f"{', '.join(map(str, rough))}.")
    return told


def _list(vector) -> str:
    return ", ".join(f"{x:.3f}" for x in vector).replace("-", "−")
