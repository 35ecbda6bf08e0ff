"""The reference models that come with the toolkit, by name; nothing heavy is imported until one is made.

Each table is that of one family of tests, which holds it (`Family.models`).
"""

import dataclasses as dc
import math
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any


if TYPE_CHECKING:
    from .contact.effect import AbstractModel


@dc.dataclass(frozen=True)
class BuiltinModel:
    """A reference model that comes with the toolkit."""

    text: str  # which equations it is, one sentence
    law: str  # in one line
    source: str  # where the law comes from
    make: "Callable[[], AbstractModel]"  # builds the template
    # whether `discover` tries it in place of another before it stacks three effects. Readings that contradict
    # themselves, feed energy in, or give the same motion under another restitution (Eq. 6), are none.
    rival: bool = True
    needs: tuple[str, ...] = ()  # without their values from the campaign it is no such rival: its own are of one ball
    assumes: str = ""  # what it takes from elsewhere and no fit changes, and what to do about it, one sentence

    def is_rival(self, known: Mapping[str, Any]) -> bool:
        """Whether it is tried in place of another model on a campaign in which these parameters are known."""
        return self.rival and all(known.get(name) is not None for name in self.needs)


def _make(kind: str, *parts: Callable[[], Any], **choices: Any) -> Any:
    """A model of `ddetumble.contact`, such as `law.Ball`, from what makes its parts."""
    module, _, name = kind.partition(".")
    return getattr(import_module(f"ddetumble.contact.{module}"), name)(*(part() for part in parts), **choices)


_shell = partial(_make, "shell.InflatedShell")
_ball, _soft, _body = partial(_make, "law.Ball"), partial(_make, "law.PowerLaw"), partial(_make, "torque.RigidBody")
_quarter = partial(_ball, contact_radius_coefficient=0.25, doubled_core=True, damping_form="printed")
_rubber, _coulomb = partial(_make, "sliding.RubberFriction"), partial(_make, "sliding.CoulombFriction")
_curves = partial(_make, "sliding.SlipCurves")
_adhesion, _striker = partial(_make, "sliding.AdhesionHysteresis"), partial(_make, "gripping.Striker")
_GAS, _HUNT = "P' = P0 V0/V'", "Hunt & Crossley 1975, J. Appl. Mech. 42, 440"
_EQ6 = "Lankarani & Nikravesh 1990, J. Mech. Des. 112, 369"
_EQ8 = "mu = tan(delta_L) [pi/4 K sigma_0/p_r + pi/10 (3 P'/E*)^(2/3)]"
_EQ9 = "s_c mu_slip(s), mu_slip = a + a exp(b s) [c sinh(d s) - e cosh(d s)]"
_SLIP = ("The slip coefficients are those that Eq. 10 gives for the paper's rubber, and the intervals take them for "
         "exact; `-m eq10` fits them to these records.")
MODELS: dict[str, BuiltinModel] = {
    "paper": BuiltinModel(
        "Eqs. 2 to 5 with a constant perimeter (b = pi depression/4), the core counted once, exact damping.",
        f"F_n = P' pi b^2 (1 + c_n w), b = pi delta/4, {_GAS}", f"the paper, Eqs. 2 to 5; {_HUNT}", _ball),
    "paper-eq6": BuiltinModel(
        "as paper, with the damping coefficient of Eq. 6, which delivers another restitution than asked for.",
        f"F_n = P' pi b^2 (1 + c_n w), b = pi delta/4, {_GAS}, c_n = 3 (1 - e^2)/(4 v1)",
        f"the paper, Eqs. 2 to 6; {_EQ6}", partial(_ball, damping_form="printed"), rival=False),
    "paper-doubled-core": BuiltinModel(
        "as paper, with the cylinder under the contact disc counted twice, as Eq. 2 prints it.",
        f"F_n = P' pi b^2 (1 + c_n w), b = pi delta/4, {_GAS}, V' with pi b^2 d twice",
        f"the paper, Eqs. 2 to 5 as printed; {_HUNT}", partial(_ball, doubled_core=True)),
    "paper-printed": BuiltinModel(
        "Eq. 7 as printed: b = depression/4 in the area alone, Eq. 2 with its doubled core, Eq. 6; a tenth of the "
        "force.", f"F_n = P' pi b^2 (1 + c_n w), b = delta/4, {_GAS}, V' of b = pi delta/4",
        f"the paper, Eqs. 2 to 7 as printed; {_EQ6}",
        partial(_quarter, volume_coefficient=math.pi / 4), rival=False),
    "paper-quarter": BuiltinModel(
        "Eq. 7 with b = depression/4 in the volume too, doubled core, Eq. 6; the perimeter is not kept.",
        f"F_n = P' pi b^2 (1 + c_n w), b = delta/4, {_GAS}", f"the paper, Eqs. 2 to 7, another reading; {_EQ6}",
        _quarter, rival=False),
    "paper-eq5-sign": BuiltinModel(
        "as paper, with the sign of Eq. 5 at face value: damping lowers the force while loading and feeds energy in.",
        f"F_n = P' pi b^2 (1 - c_n w), b = pi delta/4, {_GAS}", "the paper, Eq. 5 as printed",
        partial(_ball, damping_sign=-1.0), rival=False),
    "matunaga": BuiltinModel(
        "Eq. 1: a truncated sphere at constant pressure, with exact damping.",
        "F_n = P0 pi b^2 (1 + c_n w), b^2 = delta (D - delta)", f"the paper, Eq. 1 (Matunaga); {_HUNT}",
        partial(_ball, truncated=True)),
    "shell": BuiltinModel(
        "a rubber shell of Table 2 (40/60 mm) with gas in its cavity, side by side, with exact damping.",
        f"F_n = (P' pi b^2 + k_s delta) (1 + c_n w), k_s = 4 E t^2/(R sqrt(3 (1 - nu^2))), b = pi delta/4, {_GAS}",
        f"Table 2; Reissner 1946, J. Math. Phys. 25, 279; {_HUNT}", _shell,
        needs=("inner_diameter", "outer_diameter", "elastic_modulus", "poisson_ratio")),
    "power-law": BuiltinModel(
        "a soft body without gas: elastic force as a power of the depression and of one condition, exact damping.",
        "F_n = F_10 (delta/10 mm)^n (c/c_0)^beta (1 + c_n w)", f"Hertz 1882 is n = 3/2; {_HUNT}", _soft),
}  # fmt: skip
SLIP_MODELS: dict[str, BuiltinModel] = {
    "paper": BuiltinModel(
        "Eqs. 8 to 11 with e = 1: friction at zero slip is that of Eq. 8 alone.",
        f"f = mu F_n, {_EQ8} + {_EQ9}, e = 1", "the paper, Eqs. 8 to 11", _rubber, assumes=_SLIP),
    "paper-printed": BuiltinModel(
        "Eqs. 8 to 11 with e of Eq. 10 as printed: friction at zero slip is negative below 29 N.",
        f"f = mu F_n, {_EQ8} + {_EQ9}", "the paper, Eqs. 8 to 11 as printed",
        partial(_rubber, printed=True), rival=False, assumes=_SLIP),
    "eq10": BuiltinModel(
        "Eqs. 8 to 11 with the coefficients of Eq. 10 free (e held at 1), to be fitted to measured curves; written "
        "about 15 N (a_0 is a there), and Eq. 10's own a0, a1, b0 ... are among the derived quantities of a fit.",
        f"f = mu F_n, {_EQ8} + mu_slip(s) of Eq. 9; a linear, b, c and d quadratic in x = (F_n - 15 N)/(10 N)",
        "the paper, Eqs. 8 to 11",
        _curves, rival=False),
    "eq8": BuiltinModel("Eq. 8 alone, without the slip term.", f"f = mu F_n, {_EQ8}", "the paper, Eq. 8",
                        _adhesion),
    "coulomb": BuiltinModel("a constant coefficient of friction.", "f = mu F_n", "Coulomb 1785",
                            _coulomb),
}  # fmt: skip
OBLIQUE_MODELS: dict[str, BuiltinModel] = {
    "paper": BuiltinModel(
        "the ball of Eqs. 2 to 5 with the friction of Eq. 8; Eqs. 9 and 10 end at loads below those of an impact.",
        f"{MODELS['paper'].law}; {SLIP_MODELS['eq8'].law}", f"the paper, Eqs. 2 to 5 and 8; {_HUNT}",
        partial(_striker, _ball, _adhesion)),
    "coulomb": BuiltinModel(
        "the ball of Eqs. 2 to 5 with a constant coefficient of friction.", f"{MODELS['paper'].law}; f = mu F_n",
        f"the paper, Eqs. 2 to 5; Coulomb 1785; {_HUNT}", partial(_striker, _ball, _coulomb)),
    "power-law": BuiltinModel(
        "a soft body without gas, with a constant coefficient of friction.",
        f"{MODELS['power-law'].law}; f = mu F_n", f"{MODELS['power-law'].source}; Coulomb 1785",
        partial(_striker, _soft, _coulomb)),
}  # fmt: skip
_EULER = "I domega/dt + omega x I omega = 0, I = diag(1, 1, inertia_ratio)"
TUMBLE_MODELS: dict[str, BuiltinModel] = {
    "paper": BuiltinModel("torque-free rotation of a body of revolution, read by perfect gyroscopes (Section 5).",
                          _EULER, "Euler 1758; the paper, Section 5", _body),
    "rigid-body": BuiltinModel("the same as paper.", _EULER, "Euler 1758; the paper, Section 5", _body),
}  # fmt: skip


def list_names() -> str:
    """Names of all built-in models, in one line."""
    return ", ".join(dict.fromkeys((*MODELS, *SLIP_MODELS, *OBLIQUE_MODELS, *TUMBLE_MODELS)))
