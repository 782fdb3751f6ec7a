"""An arm as a 3-D solid and as a rod, written apart from cosserat_jax to hold it against."""

from .arm import Arm, Loads
from .equilibrium import Bent, Solid
from .material import Rubber
from .mesh import Mesh
from .rod import Rod, rod

__all__ = ["Arm", "Bent", "Loads", "Mesh", "Rod", "Rubber", "Solid", "rod"]
