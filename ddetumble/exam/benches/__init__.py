"""Test benches of the exam, one a family."""

from .bench import Bench, HeldOut, Hidden
from .impact import IMPACT
from .oblique import OBLIQUE
from .slip import SLIP
from .tumble import TUMBLE


BENCHES: dict[str, Bench] = {bench.name: bench for bench in (IMPACT, SLIP, OBLIQUE, TUMBLE)}

__all__ = ["BENCHES", "Bench", "HeldOut", "Hidden"]
