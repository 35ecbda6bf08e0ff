"""The catalogue: physics that the reference model leaves out, one class an effect.

Attributes:
    CATALOGUE: all of them, as classes.
    IMPACT: those that act on normal impacts.
    SLIP: those that act on friction records.
    OBLIQUE: those that act on oblique impacts only.
    TUMBLE: those that act on tumbling bodies, or on the gyroscopes that measure them.
"""

from ..contact.effect import AbstractContactForce as AbstractContactForce
from ..contact.effect import AbstractDriveEffect as AbstractDriveEffect
from ..contact.effect import AbstractEffect as AbstractEffect
from ..contact.effect import AbstractElasticEffect as AbstractElasticEffect
from ..contact.effect import AbstractGasEffect as AbstractGasEffect
from ..contact.effect import AbstractGeometryEffect as AbstractGeometryEffect
from ..contact.effect import AbstractRestitutionEffect as AbstractRestitutionEffect
from ..contact.effect import AbstractSensorEffect as AbstractSensorEffect
from ..contact.effect import AbstractSizeEffect as AbstractSizeEffect
from ..contact.effect import AbstractStatefulEffect as AbstractStatefulEffect
from ..contact.effect import AbstractStiffnessEffect as AbstractStiffnessEffect
from ..contact.effect import AbstractSurfaceForce as AbstractSurfaceForce
from ..contact.effect import Parameter as Parameter
from ..contact.effect import family_of
from ..contact.effect import parameter as parameter
from ..contact.effect import parameters_of as parameters_of
from ..contact.effect import stage_of as stage_of
from ..contact.gripping import AbstractAxesEffect as AbstractAxesEffect
from ..contact.gripping import AbstractComplianceEffect as AbstractComplianceEffect
from ..contact.gripping import AbstractReactionEffect as AbstractReactionEffect
from ..contact.sliding import AbstractFrictionForce as AbstractFrictionForce
from ..contact.sliding import AbstractLoadEffect as AbstractLoadEffect
from ..contact.sliding import AbstractRubberEffect as AbstractRubberEffect
from ..contact.torque import AbstractGyroEffect as AbstractGyroEffect
from ..contact.torque import AbstractInertiaEffect as AbstractInertiaEffect
from ..contact.torque import AbstractInnerTorque as AbstractInnerTorque
from ..contact.torque import AbstractTorque as AbstractTorque
from .impact import IMPACT as IMPACT
from .impact import Adhesion as Adhesion
from .impact import AmbientPressure as AmbientPressure
from .impact import ArmServo as ArmServo
from .impact import GasLeak as GasLeak
from .impact import InflationGrowth as InflationGrowth
from .impact import MembraneArea as MembraneArea
from .impact import PolytropicGas as PolytropicGas
from .impact import PressureDependentRestitution as PressureDependentRestitution
from .impact import SensorFilter as SensorFilter
from .impact import SensorGain as SensorGain
from .impact import SensorHighpass as SensorHighpass
from .impact import SensorHysteresis as SensorHysteresis
from .impact import SensorLag as SensorLag
from .impact import SensorResonance as SensorResonance
from .impact import SpeedDependentRestitution as SpeedDependentRestitution
from .impact import StressSoftening as StressSoftening
from .impact import ViscoelasticWall as ViscoelasticWall
from .impact import ViscousDashpot as ViscousDashpot
from .impact import WallStiffness as WallStiffness
from .oblique import OBLIQUE as OBLIQUE
from .oblique import OffCentreReaction as OffCentreReaction
from .oblique import SensorCrosstalk as SensorCrosstalk
from .oblique import TangentialCompliance as TangentialCompliance
from .slip import SLIP as SLIP
from .slip import AdhesiveOffset as AdhesiveOffset
from .slip import FrictionalHeating as FrictionalHeating
from .slip import LoadExponent as LoadExponent
from .slip import Presliding as Presliding
from .slip import Stribeck as Stribeck
from .slip import ViscousFriction as ViscousFriction
from .tumble import TUMBLE as TUMBLE
from .tumble import AxisMisalignment as AxisMisalignment
from .tumble import ConstantTorque as ConstantTorque
from .tumble import EddyCurrent as EddyCurrent
from .tumble import GravityGradient as GravityGradient
from .tumble import GyroBias as GyroBias
from .tumble import GyroScale as GyroScale
from .tumble import InertiaAsymmetry as InertiaAsymmetry
from .tumble import InternalDamper as InternalDamper
from .tumble import QuadraticDrag as QuadraticDrag


CATALOGUE: tuple[type[AbstractEffect], ...] = (*IMPACT, *SLIP, *OBLIQUE, *TUMBLE)


def catalogue(family: str = AbstractEffect.family) -> tuple[type[AbstractEffect], ...]:
    """Catalogued effects on one family of records, as classes: `.id`, `.law`, `.reference`, `parameters_of(effect)`.

    Args:
        family: `impact`, `slip`, `tumble`, or `oblique` (on whose records the effects of the first two act too).
    """
    families = dict.fromkeys(effect.family for effect in CATALOGUE)
    if family not in families:
        raise ValueError(f"there is no family {family!r}; there are {', '.join(families)}")
    return tuple(effect for effect in CATALOGUE if family_of(effect) == family)
