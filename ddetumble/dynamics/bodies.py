"""Shapes of debris with their mass properties; body z is the axis of symmetry, the origin the geometric centre."""

import importlib
from abc import abstractmethod
from pathlib import Path
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import InputError, error_place
from .._numerics import is_known, scalar


def integrate_mesh(vertices: Array, faces: Any) -> tuple[Array, Array, Array]:
    r"""Volume [m³], centre (3,) [m] and second moments about it $\int r r^T dV$ (3, 3) [m⁵] inside a closed mesh.

    By the divergence theorem: every triangle makes a tetrahedron with a point inside; with $D = \det(a, b, c)$ and $s =
    a + b + c$ it adds $D/6$ to the volume, $D s/24$ to the first moment and $D (a a^T + b b^T + c c^T + s s^T)/120$ to
    the second. Smooth in the vertices (vertices, 3) [m]; faces (faces, 3) are anticlockwise seen from outside.
    """
    middle = jnp.mean(vertices, axis=0)
    a, b, c = (vertices[faces[:, corner]] - middle for corner in range(3))
    six = jnp.sum(a * jnp.cross(b, c), axis=-1)
    s = a + b + c
    volume = jnp.sum(six) / 6.0
    centre = six @ s / (24.0 * volume)
    second = sum(jnp.einsum("f,fi,fj->ij", six, x, x) for x in (a, b, c, s)) / 120.0
    return volume, middle + centre, second - volume * jnp.outer(centre, centre)


class AbstractBody(eqx.Module):
    """A rigid body with the mass of its shape, of uniform density."""

    mass: eqx.AbstractVar[Array]

    def __check_init__(self):
        for name, value in vars(self).items():
            if name in ("vertices", "faces"):  # of a mesh, which checks them itself
                continue
            if is_known(value) and not (np.all(np.isfinite(value)) and np.all(np.asarray(value) > 0)):
                raise InputError(f"{name} of a {type(self).__name__} must be positive and finite; got "
                                 f"{np.asarray(value).tolist()}")

    @abstractmethod
    def inertia(self) -> Float[Array, "3 3"]:
        """Inertia tensor about the centre of mass, body components, shape (3, 3) [kg m²]."""

    def centre(self) -> Float[Array, " 3"]:
        """Centre of mass, body components, shape (3,) [m]; the origin of all but meshes."""
        return jnp.zeros(3)

    @abstractmethod
    def volume(self) -> Float[Array, ""]:
        """Volume of the material, scalar [m³]."""


@final
class Cylinder(AbstractBody):
    """Solid cylinder, such as the paper's rocket stage of 1000 kg, radius 1 m and length 3 m (Section 5).

    Attributes:
        mass: [kg].
        radius: [m].
        length: along body z [m].
    """

    mass: Array = eqx.field(converter=scalar, default=1000.0)
    radius: Array = eqx.field(converter=scalar, default=1.0)
    length: Array = eqx.field(converter=scalar, default=3.0)

    def inertia(self) -> Array:
        r"""$I_a = m r^2/2$, $I_t = m (3 r^2 + l^2)/12$, shape (3, 3) [kg m²]."""
        transverse = self.mass * (3.0 * self.radius**2 + self.length**2) / 12.0
        return jnp.diag(jnp.stack([transverse, transverse, 0.5 * self.mass * self.radius**2]))

    def volume(self) -> Array:
        r"""$\pi r^2 l$ [m³]."""
        return jnp.pi * self.radius**2 * self.length

    def end_face(self) -> Array:
        """Centre A of the upper end face, from the centre of mass, shape (3,) [m]."""
        return jnp.array([0.0, 0.0, 0.5]) * self.length


@final
class HollowCylinder(AbstractBody):
    """Tube without end faces.

    Attributes:
        mass: [kg].
        inner_radius: [m].
        outer_radius: [m].
        length: along body z [m].
    """

    mass: Array = eqx.field(converter=scalar)
    inner_radius: Array = eqx.field(converter=scalar)
    outer_radius: Array = eqx.field(converter=scalar)
    length: Array = eqx.field(converter=scalar)

    def __check_init__(self):
        if is_known((self.inner_radius, self.outer_radius)) and np.any(self.inner_radius >= self.outer_radius):
            raise InputError(f"inner_radius must be below outer_radius [m]; got {float(self.inner_radius):.6g} and "
                             f"{float(self.outer_radius):.6g}")

    def inertia(self) -> Array:
        r"""$I_a = m (r_i^2 + r_o^2)/2$, $I_t = m (3 (r_i^2 + r_o^2) + l^2)/12$, shape (3, 3) [kg m²]."""
        squares = self.inner_radius**2 + self.outer_radius**2
        transverse = self.mass * (3.0 * squares + self.length**2) / 12.0
        return jnp.diag(jnp.stack([transverse, transverse, 0.5 * self.mass * squares]))

    def volume(self) -> Array:
        r"""$\pi (r_o^2 - r_i^2) l$ [m³]."""
        return jnp.pi * (self.outer_radius**2 - self.inner_radius**2) * self.length

    def end_face(self) -> Array:
        """Centre of the upper end, from the centre of mass, shape (3,) [m]."""
        return jnp.array([0.0, 0.0, 0.5]) * self.length


@final
class Box(AbstractBody):
    """Solid cuboid.

    Attributes:
        mass: [kg].
        lengths: along body x, y, z, shape (3,) [m].
    """

    mass: Array = eqx.field(converter=scalar)
    lengths: Array = eqx.field(converter=scalar)

    def __check_init__(self):
        if np.shape(self.lengths) != (3,):
            raise InputError(f"a Box must have three lengths [m]; got the shape {np.shape(self.lengths)}")

    def inertia(self) -> Array:
        r"""$I_x = m (l_y^2 + l_z^2)/12$ and so on, shape (3, 3) [kg m²]."""
        squares = self.lengths**2
        return jnp.diag(self.mass * (jnp.sum(squares) - squares) / 12.0)

    def volume(self) -> Array:
        r"""$l_x l_y l_z$ [m³]."""
        return jnp.prod(self.lengths)


@final
class Sphere(AbstractBody):
    """Solid sphere.

    Attributes:
        mass: [kg].
        radius: [m].
    """

    mass: Array = eqx.field(converter=scalar)
    radius: Array = eqx.field(converter=scalar)

    def inertia(self) -> Array:
        r"""$2 m r^2/5$ about every axis, shape (3, 3) [kg m²]."""
        return 0.4 * self.mass * self.radius**2 * jnp.eye(3)

    def volume(self) -> Array:
        r"""$4 \pi r^3/3$ [m³]."""
        return 4.0 / 3.0 * jnp.pi * self.radius**3


@final
class Mesh(AbstractBody):
    """Solid inside a closed triangle mesh; its mass properties are differentiable in the vertices.

    Attributes:
        mass: [kg].
        vertices: shape (vertices, 3) [m].
        faces: indices of the corners, anticlockwise seen from outside, shape (faces, 3).
    """

    mass: Array = eqx.field(converter=scalar)
    vertices: Array = eqx.field(converter=scalar)
    faces: Any = eqx.field(converter=lambda faces: faces if not is_known(faces) else np.asarray(faces))

    def __check_init__(self):
        if is_known(self.faces):
            check_faces(self.faces, np.shape(self.vertices))
        if is_known((self.vertices, self.faces)):
            volume = float(integrate_mesh(self.vertices, self.faces)[0])
            if not volume > 0:
                raise InputError(f"a mesh must enclose a positive volume; this one has {volume:.6g} m³: where that is "
                                 "negative, reverse the order of the corners of every face")

    def inertia(self) -> Array:
        r"""$\rho (\mathrm{tr} C \, 1 - C)$ with the second moments $C$ about the centre, shape (3, 3) [kg m²]."""
        volume, _, second = integrate_mesh(self.vertices, self.faces)
        return self.mass / volume * (jnp.trace(second) * jnp.eye(3) - second)

    def centre(self) -> Array:
        """Centre of mass, shape (3,) [m]."""
        return integrate_mesh(self.vertices, self.faces)[1]

    def volume(self) -> Array:
        """Enclosed volume [m³]."""
        return integrate_mesh(self.vertices, self.faces)[0]


def read_mesh(file: str | Path, mass: Any, scale: Any = 1.0) -> Mesh:
    """Read a closed triangle mesh (STL, OBJ, PLY, OFF, glTF ...) by trimesh, which is an extra: `ddetumble[meshes]`.

    Args:
        file: path of the mesh; corners at the same place are merged.
        mass: of the body [kg].
        scale: metres per unit of the file [m]; 0.001 where it is in millimetres.

    Returns:
        A `Mesh`.

    Raises:
        InputError: where trimesh is not installed, or the file is missing, not understood, or not closed.
    """
    try:
        trimesh = importlib.import_module("trimesh")
    except ImportError:
        raise InputError('reading a mesh needs trimesh; install it with pip install "ddetumble[meshes]"') from None
    if not Path(file).is_file():
        raise InputError("this file does not exist", file=file)
    try:
        loaded = trimesh.load(str(file), force="mesh")
        loaded.merge_vertices()
        vertices, faces = np.asarray(loaded.vertices, dtype=float), np.asarray(loaded.faces)
    except Exception as problem:  # whatever its readers raise for a damaged file
        raise InputError(f"trimesh cannot read a mesh from this file ({problem})", file=file) from None
    with error_place(file=file):
        return Mesh(mass, scale * vertices, faces)


def check_faces(faces: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise `InputError` where faces (faces, 3) over vertices of a shape do not close a surface.

    Every edge has to be shared with exactly one other face that runs along it the other way.
    """
    if len(shape) != 2 or shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not faces.size:
        raise InputError(f"a mesh needs vertices of shape (vertices, 3) and faces of shape (faces, 3); got {shape} and "
                         f"{faces.shape}")
    if not np.issubdtype(faces.dtype, np.integer) or faces.min() < 0 or faces.max() >= shape[0]:
        raise InputError(f"the faces of a mesh must be whole numbers from 0 to {shape[0] - 1}, the rows of its "
                         f"vertices")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    forward, backward = edges @ [shape[0], 1], edges @ [1, shape[0]]
    wrong = ~np.isin(forward, backward)
    doubled = len(forward) - len(np.unique(forward))
    if wrong.any() or doubled:
        count = int(wrong.sum()) + doubled
        raise InputError(f"a mesh must be closed, each edge shared by two faces of the same sense; {count} of its "
                         f"{len(edges)} edges are not: close its holes, or give all faces the same sense")
