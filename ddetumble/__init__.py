"""ddetumble: compare impact models with measurements, learn which physical effect is missing, add it.

The loop in three lines:

    import ddetumble as dd
    found = dd.discover(dd.read_campaign("data/impact-b"))
    print(found)

and by hand:

    data, model = dd.read_campaign("data/impact-h"), dd.Ball()
    print(dd.compare(data, model, model + dd.effects.WallStiffness()))

Symbols used throughout, SI units, pressures absolute:

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

from ._lazy import attach as _attach


__version__ = "0.2.0"
__getattr__, __dir__, __all__ = _attach(__name__, __file__)
