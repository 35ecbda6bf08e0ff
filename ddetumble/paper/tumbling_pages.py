"""Section 5's stage in free rotation as a section of the booklet: Figures 16 and 17, and what nutation can change."""

from typing import Any

import numpy as np

from . import tumbling_figures as figures
from .free_tumbling import (
    DURATION,
    STEP,
    compare_motions,
    follow_stage,
    integrate_stage,
    limit_nutation,
    measure_angle,
    read_momentum,
    time_nutation,
    vary_moments,
)


ASYMMETRIES = (0.0, 0.02, 0.05, 0.1, 0.2)
DRAWN = 0.1  # relative difference of the transverse moments in the figures, an assumption
SHOWN = 300.0  # s


def examine_stage() -> tuple[dict[str, Any], dict[str, Any]]:
    """Motion of the stage from Table 5's momentum.

    Returns:
        The numbers for `paper.json`, SI units and angles in degrees; the figures by name.
    """
    tables = {"Table 5": read_momentum("table-5"), "Table 6": read_momentum("table-6")}
    start = tables["Table 5"].before
    times = STEP * np.arange(round(DURATION / STEP) + 1)
    alike, unlike = (vary_moments(asymmetry) for asymmetry in (0.0, DRAWN))
    free, uneven = follow_stage(start, alike, times), follow_stage(start, unlike, times)
    turns, rates = zip(*(compare_motions(course.motion, integrate_stage(start, moments, times))
                         for course, moments in ((free, alike), (uneven, unlike))), strict=True)
    size, along = float(np.linalg.norm(start)), start / np.linalg.norm(start)
    heights = free.path @ along
    rate = size / alike[0]
    shares = {"before": 1.0, **{f"after {name}": table.share for name, table in tables.items()}}
    numbers = {
        "moments": alike.tolist(), "momentum": size, "duration": DURATION, "step": STEP,
        "nutation": float(np.degrees(free.angles[:, 1].mean())),
        "nutation_change": float(np.degrees(np.ptp(free.angles[:, 1]))),
        "precession_rate": rate, "spin_rate": float((free.angles[-1, 2] - free.angles[0, 2]) / DURATION),
        "precessions": float((free.angles[-1, 0] - free.angles[0, 0]) / (2.0 * np.pi)),
        "circle": {"radius": float(np.mean(np.linalg.norm(free.path - heights[:, None] * along, axis=1))),
                   "height": float(heights.mean())},
        "tilt": [float(np.degrees(free.tilt.min())), float(np.degrees(free.tilt.max()))],
        "integration": {"attitude": max(turns), "rate": max(rates)},
        "cases": {when: {"share": share, "precession_rate": share * rate, "precession_period": 2 * np.pi / rate / share}
                  for when, share in shares.items()},
        "directions": {name: float(np.degrees(table.turn)) for name, table in tables.items()},
        "between_tables": float(np.degrees(measure_angle(start, tables["Table 6"].before))),
        "asymmetry": [{"asymmetry": one, "nutation": np.degrees(limit_nutation(start, vary_moments(one))).tolist(),
                       "period": time_nutation(start, vary_moments(one)) if one else None} for one in ASYMMETRIES],
    }  # fmt: skip
    both = {"printed cylinder": free, f"transverse moments 1 ± {DRAWN:g}": uneven}
    plain, other = ({when: follow_stage(share * start, moments, times) for when, share in shares.items()}
                    for moments in (alike, unlike))
    return numbers, {"figure-16": figures.draw_stage(both, start, SHOWN),
                     "figure-17": figures.draw_path(both, start, SHOWN),
                     "figure-20-nutation": figures.draw_changes(plain, other, SHOWN)}


def describe_stage(found: dict[str, Any]) -> str:
    """The one sentence on nutation, with its numbers."""
    row = next(row for row in found["asymmetry"] if row["asymmetry"] == DRAWN)
    low, high = row["nutation"]
    return (f"The paper speaks of tumbling with a changing nutation angle, but without torque the printed cylinder "
            f"keeps its angle to the momentum ({found['nutation']:.1f}° at the assumed start) for good; unequal "
            f"transverse moments would make it change (1 ± {DRAWN:g}: {low:.1f} to {high:.1f}°), and so would "
            f"measuring it from a fixed axis.")


def write_tumbling():
    """The section, and what `paper.json` says of it."""
    from ..reports.page import Section

    found, drawn = examine_stage()
    cases, tilt = found["cases"], found["tilt"]
    before, five, six = cases.values()
    sentence = describe_stage(found)
    periods = [row["period"] for row in found["asymmetry"] if row["period"]]
    rows = [("transverse moments", "smallest nutation [°]", "largest nutation [°]", "period of nutation [s]")]
    rows += [(f"1 ± {row['asymmetry']:g}" if row["asymmetry"] else "equal, as printed",
              *(f"{angle:.2f}" for angle in row["nutation"]),
              f"{row['period']:.1f}" if row["period"] else "–") for row in found["asymmetry"]]
    turns = [("momentum", "share of |L| left", "precession rate [rad/s]", "time of one precession [s]")]
    turns += [(when, f"{case['share']:.4f}", f"{case['precession_rate']:.5f}", f"{case['precession_period']:.1f}")
              for when, case in cases.items()]
    section = Section(
        "Figures 16 and 17: the stage in free rotation, and which nutation can change",
        [f"{sentence} Two readings remain: three unequal moments, or an angle to an axis of the base frame.",
         f"What agrees with the paper: 1000 kg, 1 m and 3 m make a cylinder of {found['moments'][0]:.0f} and "
         f"{found['moments'][2]:.0f} kg m²; its precession rate is |L|/I_t whatever the attitude, "
         f"{before['precession_rate']:.4f} rad/s from the momentum of Table 5, {found['precessions']:.1f} turns in "
         f"{DURATION:.0f} s; after the impacts it is {100 * (1 - five['share']):.1f} and "
         f"{100 * (1 - six['share']):.1f} % lower, and every cycle takes longer in the same measure "
         f"({before['precession_period']:.0f} s before, {five['precession_period']:.0f} and "
         f"{six['precession_period']:.0f} s after). A moves on a circle about the momentum.",
         f"What does not follow: that the nutation angle is reduced by the impact. A torque along the momentum, which "
         f"is what the paper says and what both tables show within {max(found['directions'].values()):.2f}°, leaves "
         f"the succession of attitudes as it was and only slows it down, for any moments: each reading's range of "
         f"angles is the same before and after.",
         f"What the paper leaves open, and what is assumed here: the attitude and the rates at the start (here the "
         f"body frame coincides with OXYZ, and the components of Table 5 are taken in it; the momentum before the "
         f"impact differs by {found['between_tables']:.3f}° between Tables 5 and 6); the order of the Euler angles and "
         f"the axes X_L and Z_L (here precession about Y_L along the momentum, nutation about the line of nodes, spin "
         f"about the stage's axis; nutation and both rates do not depend on it); the places P₁ and P₂. No number of "
         f"Figures 16 to 24 is printed, so the curves themselves cannot be checked.",
         f"What would decide between the readings is the period of Figure 20's curve before the impact: "
         f"{before['precession_period']:.1f} s for an angle of the printed cylinder to any fixed axis, at the assumed "
         f"start {min(periods):.1f} to {max(periods):.1f} s for unequal moments up to 1 ± {ASYMMETRIES[-1]:g}.",
         f"All motion here is the closed form; the integrator, at the paper's {round(DURATION / STEP):,} steps of "
         f"{STEP:g} s, agrees with it to {found['integration']['attitude']:.0e} rad and "
         f"{found['integration']['rate']:.0e} rad/s."],
        figures=[
            ("figure-16", "Figure 16: the stage at t = 0, where its axes lie along X, Y, Z, with the momentum of "
             "Table 5 along Y_L; right, its angles and precession rate. P₁ and P₂ are not printed. The dashed stage "
             "has unequal transverse moments, an assumption.", drawn["figure-16"]),
            ("figure-17", f"Figure 17: the path of the end-face centre A in the base frame over {DURATION:.0f} s. The "
             f"printed cylinder: a circle of {found['circle']['radius']:.2f} m about the momentum, "
             f"{found['circle']['height']:.2f} m from the centre of mass; with unequal moments a band.",
             drawn["figure-17"]),
            ("figure-20-nutation", f"The two readings of a changing nutation angle before and after the impacts, all "
             f"from the same attitude. Left: the printed cylinder's angle to Z, {tilt[0]:.0f} to {tilt[1]:.1f}°. "
             f"Right: the angle to the momentum with transverse moments 1 ± {DRAWN:g}. Slower after the impacts, not "
             f"smaller.",
             drawn["figure-20-nutation"]),
        ],
        tables=[turns, rows])  # fmt: skip
    return section, {"sentence": sentence, **found}
