"""Public names of contact mechanics and where they live."""

from .effect import AbstractLaw as AbstractLaw
from .effect import AbstractModel as AbstractModel
from .effect import Contact as Contact
from .gripping import StrikeLaw as StrikeLaw
from .gripping import Striker as Striker
from .law import AbstractDamped as AbstractDamped
from .law import AbstractReference as AbstractReference
from .law import ContactLaw as ContactLaw
from .shell import InflatedShell as InflatedShell
from .sliding import AbstractFriction as AbstractFriction
from .sliding import AdhesionHysteresis as AdhesionHysteresis
from .sliding import FrictionLaw as FrictionLaw
from .sliding import Slide as Slide
from .sliding import SlipCurves as SlipCurves
from .torque import Spin as Spin
from .torque import TumbleLaw as TumbleLaw

__all__: list[str]
