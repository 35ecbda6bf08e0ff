"""Public names of the dynamics and where they live."""

from .angles import from_euler_angles as from_euler_angles
from .angles import measure_nutation as measure_nutation
from .angles import measure_precession as measure_precession
from .angles import measure_spin as measure_spin
from .angles import to_euler_angles as to_euler_angles
from .bodies import Box as Box
from .bodies import Cylinder as Cylinder
from .bodies import HollowCylinder as HollowCylinder
from .bodies import Mesh as Mesh
from .bodies import Sphere as Sphere
from .bodies import read_mesh as read_mesh
from .collision import simulate_collision as simulate_collision
from .curves import friction_coefficient as friction_coefficient
from .curves import normal_force as normal_force
from .free_motion import propagate_torque_free as propagate_torque_free
from .impact import simulate_impact as simulate_impact
from .rigid import Tumble as Tumble
from .rigid import measure_energy as measure_energy
from .rigid import measure_momentum as measure_momentum
from .rigid import simulate_tumbling as simulate_tumbling
from .rigid import trace_point as trace_point
from .slide import simulate_sliding as simulate_sliding
from .strike import simulate_oblique_impact as simulate_oblique_impact
from .surfaces import Debris as Debris
from .surfaces import make_debris as make_debris

__all__: list[str]
