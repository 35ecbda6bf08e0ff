"""A file to begin an effect of one's own with: ten lines that already work, and the test of their contract."""

import inspect
import keyword
import re
from pathlib import Path
from typing import NamedTuple

from .._errors import InputError
from ..contact.function_effect import STAGES


class Law(NamedTuple):
    """A plain law to begin with at a stage."""

    unit: str  # of the amplitude k
    typical: float  # size of k that shows in a record
    text: str  # in one line
    code: str  # the same in Python


LAWS = {
    "elastic": Law("N/m", 2e3, "F_k gains k delta", "self.k * contact.depression"),
    "contact": Law("N s/m", 20.0, "F gains k w", "self.k * contact.depression_rate"),
    "surface": Law("Pa", -1e3, "F_n gains k pi b^2", "self.k * contact.contact_area"),
    "stiffness": Law("1/m", 10.0, "F_k times 1 + k delta", "1.0 + self.k * contact.depression"),
    "gas": Law("1/s", 2.0, "P' times 1 + k t", "1.0 + self.k * contact.time"),
    "geometry": Law("", 0.1, "b gains k delta", "self.k * contact.depression"),
    "size": Law("1/Pa", 2e-8, "D times 1 + k P0", "self.k * contact.initial_pressure"),
    "drive": Law("N", 2.0, "arm pushes with k", "self.k"),
    "restitution": Law("s/m", 0.1, "e times 1 - k v1", "1.0 - self.k * contact.approach_speed"),
    "sensor": Law("1/N", 1e-4, "reading = F (1 + k F)", "force.map(lambda f: f * (1.0 + self.k * f))"),
    "rubber": Law("s/m", 0.5, "Eq. 8 part times 1 + k u", "1.0 + self.k * slide.slip_speed"),
    "load": Law("1/N", 1e-3, "mu times 1 + k F_n", "1.0 + self.k * slide.normal_load"),
    "friction": Law("N/m", 20.0, "F_t gains k s", "self.k * slide.slip"),
    "compliance": Law("m/N", 2e-5, "tangential compliance gains k", "self.k"),
    "reaction": Law("", 0.02, "normal force acts k b ahead", "self.k * patch.contact_radius"),
    "axes": Law("", 0.02, "F_t reads F_t + k F_n", "normal_force, tangential_force + self.k * normal_force"),
    "torque": Law("1/s", 1e-5, "torque over transverse inertia = -k omega", "-self.k * spin.angular_velocity"),
    "gyroscope": Law("1/s", 1e-6, "reading = omega (1 + k t)", "angular_velocity * (1.0 + self.k * time[:, None])"),
}
SIGNS = {"compliance": ", sign=1, singular=True", "restitution": ", sign=1"}  # what else these amplitudes are


def write_template(name: str, stage: str = "elastic", folder: Path | str = ".") -> tuple[Path, Path]:
    """Write `NAME.py`, an effect that works, and `test_NAME.py`, which proves its contract.

    Args:
        name: id of the effect, such as `rim-stop`.
        stage: where it acts, a key of `LAWS`.
        folder: for the two files.

    Returns:
        Their paths.

    Raises:
        InputError: The name is none or taken, there is no such stage, or a file is there already.
    """
    from . import CATALOGUE

    if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"{name!r} is not a name for an effect: use lower-case words with hyphens, such as rim-stop")
    if any(name == effect.id for effect in CATALOGUE):
        raise InputError(f"the catalogue already has an effect {name!r}; choose another name")
    if stage not in LAWS:
        raise InputError(f"there is no stage {stage!r}; the stages are {', '.join(LAWS)}")
    module = name.replace("-", "_")
    if keyword.iskeyword(module) or re.fullmatch("con|prn|aux|nul|(com|lpt)[1-9]", module):
        raise InputError(f"{name!r} is a reserved word of Python or of Windows; choose another name")
    kind = "".join(word.capitalize() for word in name.split("-"))
    paths = Path(folder) / f"{module}.py", Path(folder) / f"test_{module}.py"
    for path in paths:
        if path.exists():
            raise InputError("this file exists already; nothing was written", file=path)
    paths[0].parent.mkdir(parents=True, exist_ok=True)
    for path, text in zip(paths, (_write_effect(name, kind, stage), _write_test(module, kind)), strict=True):
        draft = path.with_name(f".{path.name}.part")
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    return paths


def _write_effect(name: str, kind: str, stage: str) -> str:
    law, base = LAWS[stage], STAGES[stage]
    (method,) = base.__abstractmethods__
    act = getattr(base, method)
    order = "    order: ClassVar[int] = 9  # after those of the catalogue\n" if "order" in base.__annotations__ else ""
    return f'''"""{name}: say here what it is. Fields that the law may read: help({base.__module__})."""

from typing import ClassVar

from ddetumble.effects import {base.__name__}, parameter


class {kind}({base.__name__}):
    """{law.text}."""

    # Where physics sets limits, state them: limits=(0.0, 1e6), limits_reason="why". No value beyond them is an
    # explanation for `ddetumble discover`.
    k: float = parameter("{law.unit}", 0.0, typical={abs(law.typical):g}{SIGNS.get(stage, "")}, \
starts=({law.typical:g},), text="its size")
    id: ClassVar[str] = "{name}"
    law: ClassVar[str] = "{law.text}"
    reference: ClassVar[str] = "own; say where the law comes from"
{order}
    def {method}({", ".join(inspect.signature(act).parameters)}):
        """{(act.__doc__ or "").strip()}"""
        return {law.code}
'''


def _write_test(module: str, kind: str) -> str:
    return f'''"""The contract of {kind}: units, gradients, absent at its null, batches, one compilation."""

from {module} import {kind}

from ddetumble import check_effect


def test_contract():
    """Every clause holds."""
    check_effect({kind}).require()
'''
