"""The catalogue: physics that the reference model leaves out, one class an effect."""

from ..contact.effect import (
    AbstractContactForce,
    AbstractDriveEffect,
    AbstractEffect,
    AbstractElasticEffect,
    AbstractGasEffect,
    AbstractGeometryEffect,
    AbstractRestitutionEffect,
    AbstractSensorEffect,
    AbstractSizeEffect,
    AbstractStatefulEffect,
    AbstractStiffnessEffect,
    AbstractSurfaceForce,
    family_of,
    parameter,
    parameters_of,
    stage_of,
)
from ..contact.gripping import AbstractComplianceEffect, AbstractReactionEffect
from ..contact.sliding import AbstractFrictionForce, AbstractLoadEffect, AbstractRubberEffect
from ..contact.torque import AbstractGyroEffect, AbstractInertiaEffect, AbstractInnerTorque, AbstractTorque
from .impact import (
    IMPACT,
    Adhesion,
    AmbientPressure,
    ArmServo,
    GasLeak,
    InflationGrowth,
    MembraneArea,
    PolytropicGas,
    PressureDependentRestitution,
    SensorGain,
    SensorHighpass,
    SensorLag,
    SpeedDependentRestitution,
    StressSoftening,
    ViscoelasticWall,
    ViscousDashpot,
    WallStiffness,
)
from .oblique import OBLIQUE, OffCentreReaction, TangentialCompliance
from .slip import (
    SLIP,
    AdhesiveOffset,
    FrictionalHeating,
    LoadExponent,
    Presliding,
    Stribeck,
    ViscousFriction,
)
from .tumble import (
    TUMBLE,
    AxisMisalignment,
    ConstantTorque,
    EddyCurrent,
    GravityGradient,
    GyroBias,
    GyroScale,
    InertiaAsymmetry,
    InternalDamper,
)


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


__all__ = [
    "CATALOGUE", "IMPACT", "OBLIQUE", "SLIP", "TUMBLE", "AbstractComplianceEffect", "AbstractContactForce",
    "AbstractDriveEffect", "AbstractEffect", "AbstractElasticEffect", "AbstractFrictionForce", "AbstractGasEffect",
    "AbstractGeometryEffect", "AbstractGyroEffect", "AbstractInertiaEffect", "AbstractInnerTorque",
    "AbstractLoadEffect", "AbstractReactionEffect", "AbstractRestitutionEffect", "AbstractRubberEffect",
    "AbstractSensorEffect", "AbstractSizeEffect", "AbstractStatefulEffect", "AbstractStiffnessEffect",
    "AbstractSurfaceForce", "AbstractTorque", "Adhesion", "AdhesiveOffset", "AmbientPressure", "ArmServo",
    "AxisMisalignment", "ConstantTorque", "EddyCurrent", "FrictionalHeating", "GasLeak", "GravityGradient",
    "GyroBias", "GyroScale", "InertiaAsymmetry", "InflationGrowth", "InternalDamper", "LoadExponent",
    "MembraneArea", "OffCentreReaction", "PolytropicGas", "Presliding", "PressureDependentRestitution",
    "SensorGain", "SensorHighpass", "SensorLag", "SpeedDependentRestitution", "StressSoftening", "Stribeck",
    "TangentialCompliance", "ViscoelasticWall", "ViscousDashpot", "ViscousFriction", "WallStiffness", "catalogue",
    "parameter", "parameters_of", "stage_of",
]
