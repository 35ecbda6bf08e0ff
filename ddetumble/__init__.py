"""ddetumble: compare impact models with measurements, learn which physical effect is missing, add it.

The loop in three lines:

    import ddetumble as dd
    found = dd.discover(dd.read_campaign("data/impact-b"))
    print(found)

and by hand:

    data, model = dd.read_campaign("data/impact-h"), dd.Ball()
    print(dd.compare(data, model, model + dd.effects.WallStiffness()).text())

Symbols used throughout, SI units, pressures absolute (`physics.md`'s names):

================  =======================  ====================================================
symbol            name                     unit and meaning
================  =======================  ====================================================
delta             `depression`             m, how far the ball is squeezed along the normal
w                 `depression_rate`        m/s, > 0 while loading
b                 `contact_radius`         m, radius of the flat contact disc
D                 `outer_diameter`         m, ball before deformation
P0, P'            `initial_pressure`,      Pa, gas before and during contact
                  `pressure`
e, v1             `restitution`,           -, m/s, speed at first touch
                  `approach_speed`
m_eff             `effective_mass`         kg, felt along the normal at the contact point
F_n               `normal_force`           N
K, tan delta_L    `adhesion_constant`,     -, Eq. 8
                  `loss_factor`
s, u              `slip`, `slip_speed`     m, m/s, sliding displacement and speed in the contact plane
omega             `angular_velocity`       rad/s, of the debris, body components
q                 `attitude`               -, unit quaternion, scalar first, body to inertial
I                 `inertia`                kg m², about the centre of mass, body components
L                 `angular_momentum`       N m s, inertial components
================  =======================  ====================================================

Nothing heavy is imported until a name is used; `__init__.pyi` lists them all.
"""

import importlib
import re
from pathlib import Path
from typing import Any


__version__ = "0.1.0"

# The stub, which type checkers read, is the one list of public names.
_HOMES = {name: home for home, name in re.findall(
    r"^from \.([\w.]*) import \w+ as (\w+)$", Path(__file__).with_suffix(".pyi").read_text("utf-8"), re.MULTILINE)}

__all__ = ["__version__", *sorted(_HOMES)]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Import a public name from its home when it is first used."""
    if name not in _HOMES:
        raise AttributeError(f"module 'ddetumble' has no attribute {name!r}")
    if not _HOMES[name]:
        return importlib.import_module(f".{name}", __name__)
    return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return list(__all__)
