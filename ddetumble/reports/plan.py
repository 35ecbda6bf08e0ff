"""Planned impacts as `plan.json` and a page: a view that turns, momentum and nutation over time, a table."""

import dataclasses as dc
import json
import math
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import markupsafe
import numpy as np
from scipy.spatial import HalfspaceIntersection

from .._rotation import rotate_back
from .._sentences import tell
from ..contact.effect import parameters_of, read_field
from ..contact.gripping import Striker
from ..dynamics.angles import measure_nutation
from ..dynamics.collision import Course
from ..dynamics.free_motion import propagate_torque_free
from ..dynamics.rigid import measure_momentum
from ..dynamics.surfaces import AbstractSurface, CylinderSurface, OffsetSurface, Polytope
from ..figures.planning import draw_contacts, draw_motion, draw_outlook, draw_prospect
from ..inference.files import write_json
from ..measurement.units import choose_time_unit
from ..planning.errors import NAMES
from ..planning.execution import Spread
from ..planning.measured import Extrapolation, format_extrapolation, list_extrapolations
from ..planning.plan import ENDED, Plan, find_end
from ..planning.prices import REACHED
from ..planning.problem import StrikeProblem, list_faces, measure_share
from ..planning.scenario import CLAMPED
from ..planning.sequence import Sequence
from ..planning.single import ROUGH, StrikePlan
from ..planning.surroundings import find_ambient
from ..planning.uncertainty import Assessment, Prospect
from .page import Section, Table, draw_picture, read_text, write_page


SCHEMA = "ddetumble.plan-result/2"
PLACES = 120  # times drawn between two impacts: a curve looks smooth, and a page stays small
SHOWN = 0.02  # share of the momentum from which an arrow of what is left can be seen: below it is shorter than its head
WORDS = {
    "best": "Of the contact, the impacts are planned for the best estimate.",
    "mean": "The impacts are planned for the mean over the draws, and every limit holds for the mean over its own "
            "worst share of them. That may leave more than the plan for the best estimate, which passes limits in "
            "some draws.",
    "tail": "The impacts are planned for the mean over the worst share of the draws, and every limit holds for the "
            "mean over its own worst share.",
}
UNLOADED = 0.01  # of the peak force, below which a ball hardly presses
CHEAP = 1e-6  # of the goal, N s or s, below which nothing is gained by a looser limit
# What the prices of impacts that were optimised together count: words, unit, and that unit's inverse.
GAINS = {"share": ("the momentum left", "points", 100.0), "impulse": ("the sum of all impulses", "N s", 1.0),
         "time": ("the time until the last separation", "s", 1.0)}
OUTCOME = ("momentum left, mean [%]", "95 % of draws below [%]", "more than before [%]", "missed [%]",
           "force, depression or face exceeded [%]")
# Unit in which errors are shown, and its number in SI.
UNITS = {"instant": ("s", 1.0), "place": ("mm", 1e3), "direction": ("°", 180.0 / np.pi), "speed": ("%", 100.0),
         "rates": ("%", 100.0), "attitude": ("°", 180.0 / np.pi), "inertia": ("%", 100.0), "centre": ("mm", 1e3)}
# Words of the rolling mass, which a mount that keeps the ball from turning makes `CLAMPED`.
ROLLING = next(one.text for one in parameters_of(Striker) if one.name == "rolling_mass")
# Whose parameters these are, which stand elsewhere in the law: the arm sets the mass, and creep is one of friction.
OWNERS = {"effective_mass": "arm", "creep_speed": "friction"}
NAMED = 8  # faces of which the view shows names: more would cover it
COLOURS = {"axes": "#66727f", "impulse": "#d55e00", "momentum": "#0072b2", "after": "#009e73"}


def _list_impact(number: int, instant: float, share: float, plan: StrikePlan, beyond: list[Extrapolation],
                 reached: tuple[str, ...], finding: str) -> dict[str, Any]:
    """One impact as `plan.json` has it, SI."""
    design, collision, proof = plan.design, plan.collision, plan.certificate
    arrays = {
        "point": design.point, "wait": design.instant, "attitude": design.attitude, "arm_velocity": design.velocity,
        "normal": design.normal, "initial_pressure": design.pressure, "approach_speed": collision.approach_speed,
        "tangential_speed": collision.tangential_speed, "duration": collision.separation,
        "peak_normal_force": collision.peak_force, "peak_depression": collision.peak_depression,
        "impulse": collision.impulse, "angular_momentum": collision.angular_momentum,
        "angular_velocity": collision.angular_velocity, "debris_velocity": collision.velocity,
    }  # fmt: skip
    return {
        "impact": number, "face": plan.face, "instant": instant,
        **{name: np.asarray(value).tolist() for name, value in arrays.items()},
        "share_left": share, "score": plan.score, "allowed": plan.allowed, "constraints": plan.values,
        "limits_reached": reached,
        "certificate": {**dc.asdict(proof), "finding": finding, "edge_margin": float(collision.margin)},
        "integrations": {"values": plan.tally.values, "gradients": plan.tally.slopes},
        "starts": [{"face": face, "score": score, "allowed": allowed} for face, score, allowed in plan.scores],
        "extrapolated": [{"value": one.value, **dc.asdict(one.measured)} for one in beyond],
    }  # fmt: skip


def follow_plan(problem: StrikeProblem, sequence: Sequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], angular momentum [N m s] and nutation angle [rad] from before the first to after the last impact.

    The angle is nan where so little momentum is left that its direction says nothing.
    """
    inertia = problem.debris.inertia
    least = ENDED * float(np.linalg.norm(np.asarray(inertia @ problem.angular_velocity)))
    attitude, rates, begin = problem.attitude, problem.angular_velocity, 0.0
    found: list[tuple[np.ndarray, ...]] = []
    ends = [*sequence.instants, find_end(sequence)]
    for k, end in enumerate(ends):
        since = np.linspace(0.0, end - begin, PLACES)
        motion = propagate_torque_free(inertia, attitude, rates, since)
        momentum = measure_momentum(inertia, motion.attitude, motion.angular_velocity)
        nutation = np.where(np.linalg.norm(momentum, axis=-1) > least,
                            measure_nutation(inertia, motion.angular_velocity), np.nan)
        found.append((begin + since, np.asarray(momentum), nutation))
        if k < len(sequence.impacts):
            after = sequence.impacts[k].collision
            attitude, rates, begin = after.attitude, after.angular_velocity, end + float(after.separation)
    time, momentum, nutation = (np.concatenate(part) for part in zip(*found, strict=True))
    return time, momentum, nutation


def _trace_edges(surface: AbstractSurface) -> list[list[list[float]]]:
    """Lines that show a surface, each a row of points [m]."""
    if isinstance(surface, OffsetSurface):
        return [(np.asarray(line) - np.asarray(surface.centre)).round(4).tolist()
                for line in _trace_edges(surface.surface)]
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    ring = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    if isinstance(surface, CylinderSurface):
        ends = [float(surface.radius) * ring + [0.0, 0.0, z * float(surface.length)] for z in (-0.5, 0.5)]
        lines = [*ends, *(np.stack([end[k] for end in ends]) for k in range(0, 48, 6))]
    elif isinstance(surface, Polytope):
        corners, offsets = _find_corners(surface), np.asarray(surface.offsets)
        on = np.abs(corners @ np.asarray(surface.normals).T - offsets) < 1e-6 * offsets.max()
        lines = [corners[[i, j]] for i in range(len(corners)) for j in range(i) if np.sum(on[i] & on[j]) >= 2]
    else:
        lines = [float(surface.reach()) * np.roll(ring, axis, axis=1) for axis in range(3)]
    return [np.asarray(line).round(4).tolist() for line in lines]


def _find_corners(surface: Polytope) -> np.ndarray:
    """Corners of a polytope, shape (corners, 3) [m]."""
    planes = np.column_stack([np.asarray(surface.normals), -np.asarray(surface.offsets)])
    return HalfspaceIntersection(planes, np.zeros(3)).intersections


def _place_names(surface: AbstractSurface) -> list[dict[str, Any]]:
    """Names of the faces, each at a place of its own beside the axes, body components from the centre of mass; none of
    more than `NAMED`.
    """
    names = surface.face_names()
    return [] if not 1 < len(names) <= NAMED else [
        {"name": name, "at": np.asarray(surface.place(jnp.asarray(k), jnp.full(2, 0.5))).round(4).tolist()}
        for k, name in enumerate(names)]


def _make_view(problem: StrikeProblem, sequence: Sequence) -> markupsafe.Markup:
    """The body with points, impulses and angular momentum before and after, in the body frame, to be turned by hand."""
    reach = float(problem.debris.surface.reach())
    arrows = []
    momentum = np.asarray(problem.debris.inertia @ problem.angular_velocity)
    size = max(float(np.linalg.norm(momentum)), 1e-300)

    def add(tail, head, colour: str, label: str, **more):
        arrows.append({"tail": np.asarray(tail).tolist(), "head": np.asarray(head).tolist(), "colour": COLOURS[colour],
                       "label": label, **more})

    add(np.zeros(3), 1.3 * reach * momentum / size, "momentum", "momentum before", at="head")
    if sequence.impacts:
        left = np.asarray(problem.debris.inertia @ sequence.impacts[-1].collision.angular_velocity)
        if np.linalg.norm(left) > SHOWN * size:
            add(np.zeros(3), 1.3 * reach * left / size, "after", "after", at="head")
    for axis, name in zip(np.eye(3), "xyz", strict=True):
        add(np.zeros(3), 0.45 * reach * axis, "axes", name, at="head")
    pushes = [np.asarray(rotate_back(plan.design.attitude, plan.collision.impulse)) for plan in sequence.impacts]
    largest = max(map(np.linalg.norm, pushes), default=1.0)
    for number, (plan, push) in enumerate(zip(sequence.impacts, pushes, strict=True), 1):
        head = np.asarray(plan.design.point)
        add(head - 0.5 * reach * push / largest, head, "impulse", str(number))
    data = json.dumps({"lines": _trace_edges(problem.debris.surface),
                       "faces": _place_names(problem.debris.surface), "arrows": arrows, "reach": 1.3 * reach})
    return markupsafe.Markup(
        '<canvas id="turning" tabindex="0" role="img" style="display:block;width:100%;touch-action:pan-y;cursor:grab" '
        'aria-label="The body with its impacts; drag or use the arrow keys to turn it"></canvas>'
        '<script type="application/json" id="turning-data">' + data.replace("<", "\\u003c") + "</script>"
        "<script>" + read_text("turning.js") + "</script>")


def save_plan(plan: Plan, folder) -> Path:
    """Write `plan.json` into a folder, made where it is not there; returns the file's path.

    Raises:
        InputError: The folder cannot be written.
    """
    path = Path(folder) / "plan.json"
    write_json(path, _list_plan(plan))
    return path


def _find_outside(plan: Plan) -> list[list[Extrapolation]]:
    """Values of every impact that are beyond what was measured."""
    beyond = list_extrapolations(plan.ranges, plan.sequence.impacts, plan.problem.conditions)
    return [[one for one in beyond if one.impact == k] for k in range(1, len(plan.sequence.impacts) + 1)]


def _list_impacts(plan: Plan) -> list[dict[str, Any]]:
    """Every impact as `plan.json` has it, SI."""
    sequence, settings = plan.sequence, plan.settings
    impacts = [_list_impact(k, *one) for k, one in enumerate(zip(
        sequence.instants, sequence.shares, sequence.impacts, _find_outside(plan), plan.reached, plan.optimality,
        strict=True), 1)]
    for one, left in zip(impacts, plan.goals_left, strict=True):
        one["goal_left"] = left
    for one in impacts if settings.chaser_mass else ():
        one["chaser_velocity"] = [-part / settings.chaser_mass for part in one["impulse"]]
    return impacts


def _list_plan(plan: Plan) -> dict[str, Any]:
    """The content of `plan.json`."""
    impacts = _list_impacts(plan)
    problem, sequence, settings = plan.problem, plan.sequence, plan.settings
    assessment, prospect, best = plan.assessment, plan.prospect, sequence.refused
    return {
        "schema": SCHEMA, "scenario": plan.source, "title": plan.title, "sentence": plan.sentence,
        "possible": True if impacts else None if best is not None and best.missed else False,
        "reached": sequence.reached if plan.asked else None, "wanted_share": settings.share if plan.asked else None,
        "goal": {"name": problem.goal.describe(), "before": plan.goal[0], "after": plan.goal[1],
                 "share_left": plan.goals_left[-1] if impacts else 1.0, "share_left_beyond": plan.goal_beyond},
        "share_left": sequence.left, "drift": plan.drift,
        "impulse": sequence.impulse, "duration": sequence.duration, "joint": sequence.joint,
        "relaxations": sequence.relaxations, "fewest_impacts": sequence.bound or None, "axial_share": sequence.floor,
        "impacts": impacts,
        "prices": [{"impact": k, **dc.asdict(price)} for k, prices in enumerate(plan.prices, 1) for price in prices],
        "rules": plan.rules,
        "errors": plan.spreads, "errors_after": plan.after, "plan_for_errors": settings.errors.plan_for,
        "refused": None if best is None else {
            "face": best.face, "score": best.score, "untouched": best.untouched, "allowed": best.allowed,
            "estimate": best.estimate, "missed": best.missed,
            "share_left": measure_share(problem, best.collision.angular_velocity),
            "constraints": best.values},
        "contact": {"fits": plan.fits, "ball": type(problem.law.reference.ball).__name__,
                    "friction": type(problem.law.reference.friction).__name__,
                    "assumed": plan.assumed,
                    "parameters": [dict(zip(("of", "text", "value", "unit"), one, strict=True))
                                   for one in _list_contact(plan)]},
        "measured": plan.ranges, "misfits": plan.misfits,
        "ambient_pressure": float(find_ambient(problem.law.effects)), "doubts": plan.doubts,
        "within": settings.within or None,
        "share_left_beyond": None if plan.beyond is None else plan.beyond.left,
        "uncertainty": None if assessment is None else {
            **vars(assessment), "plan_for": settings.plan_for, "sequence": prospect},
        "version": metadata.version("ddetumble"),
    }  # fmt: skip


def write_plan(plan: Plan, folder) -> Path:
    """Write `plan.json` and `report.html` into a folder, made where it is not there; returns the page's path.

    Raises:
        InputError: The folder cannot be written.
    """
    save_plan(plan, folder)
    problem, sequence, settings = plan.problem, plan.sequence, plan.settings
    assessment, prospect = plan.assessment, plan.prospect
    impacts, outside = _list_impacts(plan), _find_outside(plan)
    followed = follow_plan(problem, sequence)
    rest = " A body that is all but at rest has no nutation angle." if np.isnan(followed[2]).any() else ""
    figures = [draw_picture("motion", "Angular momentum (inertial components) and nutation angle; dotted: the impacts."
                            f"{rest}", draw_motion, *followed, sequence.instants)]
    sections = [_show_problem(plan), Section("Where to strike", [
        _make_view(problem, sequence), "The body in its own frame, with its axes x, y, z and the names of its faces. "
        "Blue: the angular momentum before; green: after the last impact, to the same scale, if enough is left. "
        "Orange: the impulse of each impact, with its head at the point of contact. Drag to turn."])]
    tables, sentence = [], plan.sentence
    if impacts:
        chosen = sorted({0, len(impacts) // 2, len(impacts) - 1})
        courses = [sequence.impacts[k].collision.course for k in chosen]
        alike = " Where there are fewer lines than impacts, some coincide." if len(chosen) > 1 else ""
        figures.append(draw_picture(
            "contacts", f"Normal force and friction during contact.{alike}", draw_contacts,
            [course.time for course in courses], [course.normal_force for course in courses],
            [np.linalg.norm(course.friction, axis=1) for course in courses], [f"impact {k + 1}" for k in chosen]))
        unit, factor = choose_time_unit(find_end(sequence))
        others = _head_goal(problem)
        rows = [[str(one["impact"]), f"{factor * one['instant']:.{4 if unit == 'h' else 2}f}", one["face"],
                 _join(one["point"]), _join(one["arm_velocity"]),
                 f"{math.degrees(math.atan2(one['tangential_speed'], one['approach_speed'])):.1f}",
                 f"{one['initial_pressure'] / 1e6:.3f}",
                 _show(one["peak_normal_force"], 1), _show(1e3 * one["peak_depression"], 2),
                 _show(1e3 * one["duration"], 1), f"{100 * one['share_left']:.3f}",
                 *(f"{100 * one['goal_left']:.3f}" for _ in others),
                 ", ".join(map(_say_limit, one["limits_reached"])) or "none"] for one in impacts]
        tables.append(Table(
            ["impact", f"at [{unit}]", "face", "point, body [m]", "arm's velocity, inertial [m/s]", "to the normal [°]",
             "pressure [MPa]", "peak force [N]", "depression [mm]", "contact [ms]", "momentum left [%]", *others,
             "limits reached"], rows,
            "To the normal: the angle at which the ball comes to the face, of its velocity relative to the place that "
            "is struck."))
    farther = [f"Impact {k} is beyond what was measured: {', '.join(map(format_extrapolation, others))}."
               for k, others in enumerate(outside, 1) if others]
    unloaded = [(effect.id, find_unloaded(one.collision.course)) for one in sequence.impacts
                for effect in problem.law.friction.pick("friction")]
    for name, force in sorted((one for one in unloaded if one[1]), key=lambda one: -one[1])[:1]:
        farther.append(f"Friction does not vanish with the load: where the ball hardly presses, at first touch and at "
                       f"separation, it is up to {force:.3g} N by {name}. Tests slide under load, so that this is an "
                       "extrapolation.")
    sections.append(Section("Before, between and after", figures=figures, tables=tables, points=farther))
    if plan.rules:
        sections.append(_show_alternatives(plan))
    if plan.spreads:
        sections.append(_show_errors(plan))
    if assessment is not None:
        sections.append(_show_outlook(assessment, settings.plan_for, prospect, settings.share))
        sentence += " " + (assessment.sentences[0] if prospect is None else prospect.sentence)
    if impacts:
        sections.append(_show_proofs(plan, impacts))
    return write_page(plan.title or "Planned impacts", sentence, sections, folder, facts=_list_facts(plan))


def _head_goal(problem: StrikeProblem) -> list[str]:
    """Head of a column of the goal that is left, where that is not the momentum, which has a column of its own."""
    return [] if problem.goal.is_momentum() else [f"{problem.goal.name().removeprefix('the ')} left [%]"]


def find_unloaded(course: Course) -> float:
    """Largest friction of a contact while its normal force is below `UNLOADED` of the peak [N]; 0 where it is as small
    beside its own peak, five times over.
    """
    load, friction = np.asarray(course.normal_force), np.linalg.norm(np.asarray(course.friction), axis=1)
    found = float(np.max(friction, initial=0.0, where=load <= UNLOADED * load.max()))
    return found if found > 5.0 * UNLOADED * friction.max() else 0.0


def _list_facts(plan: Plan) -> list[tuple[str, str, str]]:
    """What the impacts leave and what they give the body, on average with errors where these were drawn, and what they
    take; nothing without an impact.
    """
    found, erring = plan.sequence, plan.erring
    if not found.impacts:
        return []
    goal = plan.problem.goal
    left = f"{100 * found.left:.2f} %" if found.left >= 1e-4 else "less than 0.01 %"
    drift, count = f"{1e3 * plan.drift:.3g} mm/s", len(found.impacts)
    facts = [("angular momentum left", left, ""), ("drift given to the body", drift, "")]
    if erring is not None:
        mean, spread = (1e3 * part for part in erring.drift)
        facts = [("angular momentum left", f"{100 * erring.mean:.2f} %", f"on average with errors; {left} without"),
                 ("drift given to the body", f"{mean:.3g} ± {spread:.2g} mm/s", f"with errors; {drift} without")]
    if not goal.is_momentum():
        alone, words = f"{_show_little(plan.goals_left[-1])} %", f"{goal.name().removeprefix('the ')} left"
        facts.insert(0, (words, alone, "") if erring is None else (
            words, f"{_show_little(erring.goal)} %", f"on average with errors; {alone} without"))
    return [*facts, ("impulse", f"{found.impulse:.4g} N s", f"of {count} impact{'s' * (count > 1)}")]


def _list_contact(plan: Plan) -> list[tuple[str, str, float, str]]:
    """Parameters of the contact law that strikes: what has it, its words, its value and unit; an effect at its null,
    as of a rival model, is left out.
    """
    law, striker = plan.problem.law, plan.problem.law.reference
    found = []
    for part, model in (("ball", striker.ball), ("friction", striker.friction), ("arm", striker),
                        *((effect.id, effect) for effect in law.effects)):
        own = [one for one in parameters_of(model) if model is not striker or "." not in one.field]
        values = [float(one.transform.publish(read_field(model, one.field))) for one in own]
        amplitudes = [value for one, value in zip(own, values, strict=True) if one.kind == "amplitude"]
        if not amplitudes or any(amplitudes):
            # The mass of a fitted ball is that of what it is mounted on; an effect's parameter needs its name, too.
            found += [(OWNERS.get(one.name, part), one.text if one.kind == "reference" and one.text else
                       f"{one.name} ({one.text})", value, one.unit) for one, value in zip(own, values, strict=True)]
    return found


def _list_ball(plan: Plan) -> list[list[str]]:
    """Rows on the ball, its friction and its arm."""
    striker = plan.problem.law.reference
    source = " and ".join(f"{name}, fitted to the campaign {campaign}" for name, campaign in plan.fits.items())
    rows = [["ball", "contact model", type(striker.ball).__name__ + (f", from {source}" if source else " (of no fit)")],
            ["friction", "friction model", type(striker.friction).__name__]]
    for part, words, value, unit in _list_contact(plan):
        if words == ROLLING and value >= CLAMPED:
            rows.append([part, "mount", "keeps the ball from turning"])
        else:
            shown = f"{1e3 * value:.4g} mm" if unit == "m" else f"{value:.4g} {unit}".rstrip()
            rows.append([part, words, shown])
    return sorted(rows, key=lambda row: ({"ball": 0, "friction": 1, "arm": 3}.get(row[0], 2)))


def _describe_shape(surface: AbstractSurface) -> str:
    """The shape of a body and its size."""
    if isinstance(surface, OffsetSurface):
        return _describe_shape(surface.surface)
    if isinstance(surface, CylinderSurface):
        return f"cylinder of radius {float(surface.radius):.4g} m and length {float(surface.length):.4g} m"
    if isinstance(surface, Polytope):
        sizes = " × ".join(f"{one:.4g}" for one in np.ptp(_find_corners(surface), axis=0))
        return f"{len(surface.normals)} faces, {sizes} m along body x, y, z"
    return f"sphere of radius {float(surface.reach()):.4g} m"


def _describe_attitude(attitude: np.ndarray) -> str:
    """How a body is turned against inertial axes, from its unit quaternion, scalar first, shape (4,)."""
    w, axis = abs(attitude[0]), attitude[1:] * (1.0 if attitude[0] >= 0 else -1.0)
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        return "body axes along inertial ones"
    return f"turned by {_show(np.degrees(2.0 * np.arctan2(size, w)), 2)}° about ({_join(axis / size)}), inertial"


def list_inertia(inertia: np.ndarray) -> list[tuple[str, str]]:
    """The tensor of inertia (3, 3) [kg m²] as given, and where it is not diagonal its principal moments, smallest
    first, with their axes in body components and the angle from each to the nearest body axis."""
    moments = np.diag(inertia)
    close = 1e-9 * float(np.max(moments))
    if np.allclose(inertia, np.diag(moments), atol=close):
        return [("moments of inertia about body x, y, z", f"{', '.join(f'{one:.4g}' for one in moments)} kg m²")]
    whole = "; ".join(", ".join(f"{one:.4g}" for one in row) for row in inertia).replace("-", "−")
    rows = [("tensor of inertia, rows of body x, y, z", f"({whole}) kg m²")]
    moments, axes = np.linalg.eigh(inertia)
    for k in range(3):
        same = np.flatnonzero(np.abs(moments - moments[k]) <= close)
        if len(same) == 2:  # any two axes of their plane
            other = axes[:, next(i for i in range(3) if i not in same)]
            if k == same[0]:
                rows.append(("principal moments, two", f"{moments[k]:.4g} kg m², about every axis normal to "
                                                       f"({_join(other)})"))
            continue
        nearest = int(np.argmax(np.abs(axes[:, k])))
        axis = axes[:, k] * np.sign(axes[nearest, k])
        angle = np.degrees(np.arctan2(np.linalg.norm(np.delete(axis, nearest)), axis[nearest]))
        rows.append(("principal moment", f"{moments[k]:.4g} kg m², about ({_join(axis)}), {angle:.1f}° from body "
                                         f"{'xyz'[nearest]}"))
    return rows


def _show_problem(plan: Plan) -> Section:
    """What is struck, what is allowed and what is wanted, as they were given."""
    problem, limits, goal = plan.problem, plan.problem.limits, plan.problem.goal
    debris, rates = problem.debris, np.asarray(problem.angular_velocity)
    inertia = np.asarray(debris.inertia)
    turn = float(np.linalg.norm(rates))
    faces = debris.surface.face_names()
    allowed = ", ".join(faces[k] for k in list_faces(problem)[:6]) + (", ..." if len(list_faces(problem)) > 6 else "")
    area = "" if np.isinf(float(limits.radius)) else (
        f", within {float(limits.radius):.3g} m of ({_join(np.asarray(limits.target))}) m from the centre of mass")
    pressures = " to ".join(dict.fromkeys(f"{float(one) / 1e6:.4g}" for one in limits.pressure))
    window = " to ".join(dict.fromkeys(f"{float(one):.4g}" for one in limits.window))
    waits = " to ".join(dict.fromkeys(f"{float(one):.4g}" for one in limits.wait_again().window))
    again = f"; further impacts {waits} s after the end of the one before" if plan.settings.impacts > 1 else ""
    share, count = plan.settings.share, plan.settings.impacts
    ended = f", none once {100 * share:g} % of the momentum is left"
    rows = [
        ["debris", "shape", _describe_shape(debris.surface)],
        ["debris", "mass", f"{float(debris.mass):.4g} kg"],
        *(["debris", *row] for row in list_inertia(inertia)),
        *([["debris", "centre of mass, from that of uniform density",
            f"({_join(np.asarray(debris.surface.centre))}) m"]]
          if isinstance(debris.surface, OffsetSurface) else []),
        ["debris", "attitude at time 0", _describe_attitude(np.asarray(problem.attitude))],
        ["debris", "angular velocity, body", f"({_join(rates)}) rad/s, {_show(np.degrees(turn), 2)} °/s in all"],
        ["debris", "angular momentum", f"{float(np.linalg.norm(inertia @ rates)):.4g} N m s"],
        ["debris", "rotational energy", f"{0.5 * float(rates @ inertia @ rates):.4g} J"],
        *_list_ball(plan),
        ["allowed", "faces", allowed + area],
        ["allowed", "arm's speed", f"up to {float(limits.speed):.3g} m/s"],
        ["allowed", "approach speed", f"from {float(limits.approach):.3g} m/s"],
        ["allowed", "peak force", f"up to {float(limits.force):.4g} N"],
        ["allowed", "depression", f"up to {1e3 * float(limits.depression):.3g} mm"],
        ["allowed", "pressure", f"{pressures} MPa"],
        ["allowed", "distance from edges", f"from {1e3 * float(limits.edge):.3g} mm"],
        ["allowed", "first touch", f"{window} s after time 0{again}"],
        ["allowed", "clearance", "the ball keeps clear of the rest of the body for "
                                 f"{float(limits.clearance):.3g} s before and after the contact"],
        ["allowed", "side", f"outward normal of the face within {np.degrees(float(limits.cone)):.3g}° of the chaser, "
                            f"which is towards ({_join(np.asarray(limits.chaser))}), inertial"],
        ["wanted", "to be small", goal.describe()],
        ["wanted", "momentum left", f"{100 * share:g} %, in at most {count} impact{'s' * (count != 1)}"]
        if plan.asked else ["wanted", "impacts", f"at most {count}" + ended * (count > 1)],
    ]  # fmt: skip
    return Section("What was asked", tables=[Table(["", "quantity", "value"], rows)])


def _say_limit(name: str) -> str:
    """The name of a limit as readers say it: an instant is early or late."""
    return name.replace("lowest instant", "earliest instant").replace("highest instant", "latest instant")


def _number_impacts(found: Iterable[Iterable[str]]) -> dict[str, list[int]]:
    """Numbers of the impacts, from 1 on, by each of the names that they have."""
    numbers: dict[str, list[int]] = {}
    for k, names in enumerate(found, 1):
        for name in names:
            numbers.setdefault(_say_limit(name), []).append(k)
    return numbers


def _show_alternatives(plan: Plan) -> Section:
    """What limits cost, and what simple rules make of the same place."""
    tables, first, joint = [], plan.sequence.impacts[0], plan.sequence.joint
    rows = [[str(k), price.key, price.change, f"{100 * price.gain:.2g}"]
            for k, prices in enumerate(plan.prices, 1) for price in prices if price.gain > CHEAP]
    if rows:
        tables.append(Table(["impact", "limit", "change", "gain [points]"], rows,
                            f"What a limit costs: hundredths of {plan.problem.goal.name()} at the start, that the "
                            "impact would gain if it were a little looser, to first order."))
    together = [] if joint is None or not joint.taken else [one for one in joint.prices if one.gain > CHEAP]
    if together:
        words, unit, scale = GAINS[together[0].of]
        tables.append(Table(["limit", "change", f"gain [{unit}]"],
                            [[one.key, one.change, f"{scale * one.gain:.2g}"] for one in together],
                            f"What a limit costs: by how much {words} would be less if it were a little looser for all "
                            "impacts, which were optimised together, to first order."))
    own = measure_share(plan.problem, np.asarray(first.collision.angular_velocity))
    shown = [["as planned", f"{100 * own:.2f}", "none", _show(float(np.linalg.norm(first.design.velocity)), 3),
              f"{100 * own:.2f}"]]
    for blow in plan.rules:
        shown.append([blow.rule, "–" if np.isnan(blow.share) else f"{100 * blow.share:.2f}",
                      ", ".join(blow.violated) or "none", "–" if np.isnan(blow.speed) else _show(blow.speed, 3),
                      "–" if np.isnan(blow.allowed_share) else f"{100 * blow.allowed_share:.2f}"])
    tables.append(Table(
        ["direction of the blow", "momentum left [%]", "limits violated", "speed within limits [m/s]",
         "momentum left within limits [%]"], shown,
        "The first impact beside simple rules at the same place, instant and pressure: with the planned arm speed, and "
        "with the best that the limits allow (–: along this direction no speed keeps them all). Against the velocity "
        "of the struck point is the paper's rule."))
    told = tell("plan.costs", limits=_number_impacts(plan.reached), within=REACHED, priced=bool(rows or together),
                ended=plan.optimality[-1] == "nothing left", rough="not an optimum" in plan.optimality,
                count=len(plan.impacts))
    return Section("What limits cost, and what simple rules would do", told, tables=tables)


def _show_errors(plan: Plan) -> Section:
    """What errors of the arm and of the estimated motion make of the first impact."""
    own = measure_share(plan.problem, np.asarray(plan.sequence.impacts[0].collision.angular_velocity))
    heads = [f"{one.removesuffix(' [%]')}, mean [%]" for one in _head_goal(plan.problem)]
    rows = []
    for one in plan.spreads:
        unit, scale = UNITS.get(one.error, ("", 1.0))
        size = "" if one.error == "all" else f"{scale * one.size:.3g} {unit}"
        rows.append([NAMES.get(one.error, "all together"), size, *(f"{100 * one.goal:.2f}" for _ in heads),
                     *_list_outcome(one)])
    impulses = np.array([one.collision.impulse for one in plan.impacts])
    outliers = [NAMES.get(one.error, "all together") for one in plan.spreads if one.mean > one.q95]
    told = tell("plan.errors", left=own, draws=plan.settings.errors.draws,
                planned=WORDS[plan.settings.errors.plan_for] if plan.settings.errors.plan_for != "best" else "",
                chaser=plan.settings.chaser_mass, count=len(impulses), outliers=outliers,
                recoil=1e3 * np.linalg.norm(impulses[0]), recoils=1e3 * np.linalg.norm(impulses.sum(axis=0)))
    apart = " Its draws are others than those of the table below, so that both differ by chance."
    tables = [Table(["error of", "standard deviation", *heads, *OUTCOME], rows,
                    "The first impact." + apart * bool(plan.after))]
    if plan.after:
        tables.append(Table(
            ["impact", "momentum left, as planned [%]", *heads, *OUTCOME, "drift given to the body [mm/s]"],
            [[str(k), f"{100 * float(planned):.2f}", *(f"{100 * one.goal:.2f}" for _ in heads), *_list_outcome(one),
              f"{1e3 * one.drift[0]:.3g} ± {1e3 * one.drift[1]:.2g}"]
             for k, (planned, one) in enumerate(zip(plan.sequence.shares, plan.after, strict=True), 1)],
            "After each impact, all errors together and those of the arm drawn anew. The first is struck by the "
            "estimate of the motion; before each further one the arm has looked again. Nothing is planned again."))
    return Section("What errors do to the plan", told, tables=tables)


def _list_outcome(one: Spread) -> list[str]:
    """Cells of `OUTCOME`, all in per cent."""
    return [f"{100 * one.mean:.2f}", f"{100 * one.q95:.2f}",
            *(f"{100 * part:.0f}" for part in (one.raised, one.missed, one.violated))]


def _show_outlook(found: Assessment, plan_for: str, prospect: Prospect | None, share: float) -> Section:
    """Sentences, the momentum left under every draw, and numbers of every model."""
    rows = []
    for name, one in (*found.models.items(), ("all, by their weights", found.whole)):
        left, force, depth = one.share_left, one.peak_normal_force, one.peak_depression
        passed = ", ".join(f"{limit} {100 * part:.0f} %" for limit, part in one.violated.items() if part > 0)
        rows.append([name, f"{one.weight:.2f}", f"{_show_little(left.mean)} ± {_show_little(left.sd)}",
                     f"{_show_little(left.q05)} to {_show_little(left.q95)}", _show_little(left.tail),
                     f"{_show(force.mean, 1)} ± {_show(force.sd, 1, 2)}",
                     f"{_show(1e3 * depth.mean, 2)} ± {_show(1e3 * depth.sd, 2, 2)}",
                     passed or "none", f"{100 * one.regret.loss:.2f}"])
    table = Table(
        ["model", "weight", "momentum left, mean ± sd [%]", "5 to 95 % of the draws [%]",
         f"worst {100 * found.tail:.0f} % [%]", "peak force [N]", "depression [mm]", "limits violated in",
         "cost of the wrong plan [%]"], rows if len(found.models) > 1 else rows[:1],
        "For the first impact. The last column is the relative loss in the goal by a plan made for another model.")
    pictures = [draw_picture(
        "outlook", "Angular momentum left by the first impact, for draws of the contact law. Dashed: "
        "the mean over the worst share.", draw_outlook, {name: one.draws for name, one in found.models.items()},
        found.whole.best_estimate, found.whole.share_left.tail)]
    sentences = list(found.sentences)
    if prospect is not None:
        low, high, tail = np.array([(one.q05, one.q95, one.tail) for one in prospect.share_left]).T
        pictures.append(draw_picture(
            "prospect", "Angular momentum left after each impact, for the same draws and without replanning.",
            draw_prospect, prospect.best_estimate, low, high, tail, share))
        sentences.insert(1, prospect.sentence)
    return Section("Uncertainty of the outcome", [*sentences, WORDS[plan_for], found.note], figures=pictures,
                   tables=[table])


def _show_proofs(plan: Plan, impacts: list[dict[str, Any]]) -> Section:
    """How nearly each impact is an optimum: which are none to first order, and of which the gradient says nothing."""
    joint, found = plan.sequence.joint, _number_impacts([(finding,) for finding in plan.optimality])
    told = tell("plan.optimality", jointly=joint is not None and joint.taken, count=len(impacts), found=found,
                rough=ROUGH, compared=any(len(one.scores) > 1 for one in plan.impacts))
    rows = []
    for one in impacts:
        proof, count = one["certificate"], one["integrations"]
        judged = proof["finding"] in ("optimum", "not an optimum")
        rows.append([str(one["impact"]), *(f"{proof[name]:.1e}" if judged else "–" for name in (
            "stationarity", "gradient_error")),
                     _show(1e3 * proof["edge_margin"], 1), str(count["values"]), str(count["gradients"]),
                     ", ".join(f"{start['score']:.4f}" for start in one["starts"])])
    header = ("impact", "unbalanced gradient", "gradient against differences", "disc to edge [mm]", "integrations",
              "gradients", "score of each start")
    return Section("Optimality of the plan", told, tables=[Table(header, rows)])


def _show(value: float, places: int, digits: int = 3) -> str:
    """A number to so many decimal places, and to more where that would leave it fewer than so many digits."""
    size = abs(value) if math.isfinite(value) and value else 1.0
    return f"{value:.{max(places, digits - 1 - math.floor(math.log10(size)))}f}"


def _show_little(share: float) -> str:
    """A share in per cent to two decimal places, and that it is below these where they would show nothing of it."""
    return f"{100 * share:.2f}" if 100 * share >= 0.005 else "< 0.01"


def _join(vector) -> str:
    """Components of a vector, all to the places that give its largest three digits, and three at least."""
    places = len(_show(max(map(abs, vector)), 3).partition(".")[2])
    return ", ".join(f"{x:z.{places}f}" for x in vector).replace("-", "−")
