"""Surfaces of debris that a ball may strike: distance, normal, and how far the nearest edge is.

All points are in body components, from the centre of mass. Convex bodies only. A ball that reaches over an edge is no
longer squeezed between two planes, which the contact law assumes: `Foot.margin` says how far off that is.
"""

from abc import abstractmethod
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._errors import InputError
from .._numerics import is_known, safe_divide, safe_sqrt, scalar
from .bodies import AbstractBody, Box, Cylinder, Mesh, Sphere, check_faces, integrate_mesh
from .rigid import check_inertia


FAR = 1e6  # m, distance to an edge where there is none: beyond every body, so that no limit on it binds


@final
class Foot(eqx.Module):
    """The place of a surface that is nearest to a point."""

    distance: Float[Array, ""]  # of the point from the surface, below zero inside [m]
    normal: Float[Array, " 3"]  # outward, unit [-]
    # from there to each edge of the face, shape (edges,); below zero where the nearest place is the edge
    # itself, `FAR` for edges of other faces [m]
    margins: Float[Array, " edges"]

    @property
    def margin(self) -> Array:
        """To the nearest edge [m]."""
        return jnp.min(self.margins)


class AbstractSurface(eqx.Module):
    """A convex surface made of smooth faces."""

    @abstractmethod
    def face_names(self) -> tuple[str, ...]:
        """One name a face."""

    @abstractmethod
    def find_foot(self, point: Array) -> Foot:
        """The nearest place to a point near the surface, shape (3,) [m]."""

    @abstractmethod
    def place(self, face: Array, coordinates: Array) -> Array:
        """Point of a face, shape (3,) [m], at two coordinates, each in -1 to 1, which together reach all of it.

        The face may be traced, so that plans for all faces are one program.
        """

    @abstractmethod
    def reach(self) -> Array:
        """Largest distance of the surface from the centre of mass [m]."""

    @abstractmethod
    def find_pivots(self) -> Array:
        """Directions about which no normal force has a moment, as all normals meet that axis, shape (pivots, 3) [-]."""


@final
class CylinderSurface(AbstractSurface):
    """Side and end faces of a cylinder about body z; the centre of mass is in its middle."""

    radius: Array = eqx.field(converter=scalar)  # [m]
    length: Array = eqx.field(converter=scalar)  # [m]

    def face_names(self) -> tuple[str, ...]:
        """Side, upper end, lower end."""
        return ("side", "upper end", "lower end")

    def find_foot(self, point: Array) -> Foot:
        """Side where it is the nearer face, else an end; margins by the way along the face to upper and lower rim."""
        across = safe_sqrt(point[0] ** 2 + point[1] ** 2)
        up = jnp.where(point[2] < 0, -1.0, 1.0)
        beside, above = across - self.radius, up * point[2] - 0.5 * self.length
        side = beside > above
        outward = jnp.stack([safe_divide(point[0], across), safe_divide(point[1], across), jnp.zeros_like(across)])
        axial = jnp.stack([jnp.zeros_like(up), jnp.zeros_like(up), up])
        ends = jnp.stack([point[2], -point[2]]) - 0.5 * self.length
        margins = jnp.where(side, -ends, jnp.where(jnp.stack([up, -up]) > 0, -beside, FAR))
        return Foot(jnp.where(side, beside, above), jnp.where(side, outward, axial), margins)

    def place(self, face: Array, coordinates: Array) -> Array:
        """Side: turn over pi and height over half the length. Ends: a square mapped onto the disc, no two alike."""
        a, b = coordinates
        side = jnp.stack([jnp.cos(jnp.pi * a), jnp.sin(jnp.pi * a), b])
        disc = [a * jnp.sqrt(1.0 - 0.5 * b**2), b * jnp.sqrt(1.0 - 0.5 * a**2), jnp.ones_like(a)]
        share = jnp.where(face == 0, side, jnp.stack(disc) * jnp.where(face == 1, 1.0, jnp.array([1.0, 1.0, -1.0])))
        return share * jnp.stack([self.radius, self.radius, 0.5 * self.length])

    def reach(self) -> Array:
        """To the rim."""
        return jnp.sqrt(self.radius**2 + 0.25 * self.length**2)

    def find_pivots(self) -> Array:
        """The axis."""
        return jnp.array([[0.0, 0.0, 1.0]])


@final
class SphereSurface(AbstractSurface):
    """A sphere about the centre of mass."""

    radius: Array = eqx.field(converter=scalar)  # [m]

    def face_names(self) -> tuple[str, ...]:
        """One face."""
        return ("sphere",)

    def find_foot(self, point: Array) -> Foot:
        """Radially below the point; no edges."""
        size = safe_sqrt(jnp.sum(point**2))
        return Foot(size - self.radius, point / jnp.where(size > 0, size, 1.0), jnp.full((1,), FAR))

    def place(self, face: Array, coordinates: Array) -> Array:
        """Longitude over pi, and sine of the latitude."""
        a, b = coordinates
        flat = safe_sqrt(1.0 - b**2)
        return self.radius * jnp.stack([flat * jnp.cos(jnp.pi * a), flat * jnp.sin(jnp.pi * a), b])

    def reach(self) -> Array:
        """The radius."""
        return self.radius

    def find_pivots(self) -> Array:
        """All: every normal meets the centre."""
        return jnp.eye(3)


@final
class Polytope(AbstractSurface):
    r"""A convex body of flat faces, $\max_k (n_k \cdot x - o_k) \le 0$: boxes and convex meshes."""

    normals: Array  # outward, unit, shape (faces, 3) [-]
    offsets: Array  # distance of each face's plane from the centre of mass, shape (faces,) [m]
    anchors: Array  # a corner-centred place inside each face, shape (faces, 3) [m]
    spans: Array  # two half-diagonals of the rectangle that each face lies in, shape (faces, 2, 3) [m]
    radius: Array  # of the farthest corner [m]
    names: tuple[str, ...] = eqx.field(static=True)  # one a face

    def face_names(self) -> tuple[str, ...]:
        """As given."""
        return self.names

    def find_foot(self, point: Array) -> Foot:
        """Below the point on the face that it is farthest outside of; margins to the neighbouring planes."""
        heights = self.normals @ point - self.offsets
        face = jnp.argmax(heights)
        normal, distance = self.normals[face], heights[face]
        beyond = heights - distance * (self.normals @ normal)
        lean = jnp.sqrt(jnp.maximum(1.0 - (self.normals @ normal) ** 2, 1e-12))
        gaps = jnp.where(jnp.arange(heights.size) == face, FAR, -beyond / lean)
        return Foot(distance, normal, gaps)

    def place(self, face: Array, coordinates: Array) -> Array:
        """Within the rectangle around the face."""
        return self.anchors[face] + coordinates @ self.spans[face]

    def reach(self) -> Array:
        """To the farthest corner."""
        return self.radius

    def find_pivots(self) -> Array:
        """None."""
        return jnp.zeros((0, 3))


@final
class OffsetSurface(AbstractSurface):
    """A surface whose body's centre of mass is not where the surface itself takes it to be."""

    surface: AbstractSurface
    centre: Array = eqx.field(converter=scalar)  # of mass, in the coordinates of that surface, shape (3,) [m]

    def face_names(self) -> tuple[str, ...]:
        """Those of the surface."""
        return self.surface.face_names()

    def find_foot(self, point: Array) -> Foot:
        """That of the surface, which the offset moves."""
        return self.surface.find_foot(point + self.centre)

    def place(self, face: Array, coordinates: Array) -> Array:
        """That of the surface, from the centre of mass."""
        return self.surface.place(face, coordinates) - self.centre

    def reach(self) -> Array:
        """At most the surface's own and the offset together."""
        return self.surface.reach() + jnp.linalg.norm(self.centre)

    def find_pivots(self) -> Array:
        """Of those of the surface the ones along which the centre of mass lies off; of a sphere the offset itself."""
        pivots, centre = np.asarray(self.surface.find_pivots()), np.asarray(self.centre)
        size = float(np.linalg.norm(centre))
        if size == 0.0:
            return jnp.asarray(pivots)
        if len(pivots) == 3:
            return jnp.asarray(centre[None] / size)
        along = np.linalg.norm(np.cross(pivots, centre), axis=1) < 1e-9 * size
        return jnp.asarray(pivots[along])


def make_polytope(corners: Any, normals: Any, names: tuple[str, ...] = ()) -> Polytope:
    """A polytope from its corners, shape (corners, 3) [m], and the outward normals of its faces, shape (faces, 3)."""
    corners, normals = np.asarray(corners, dtype=float), np.asarray(normals, dtype=float)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    heights = corners @ normals.T
    offsets = heights.max(axis=0)
    if not np.all(offsets > 0):
        raise InputError("the centre of mass of a body to be struck must lie inside it")
    size = float(np.abs(corners).max())
    anchors, spans = np.zeros((len(normals), 3)), np.zeros((len(normals), 2, 3))
    for k, normal in enumerate(normals):
        own = corners[heights[:, k] > offsets[k] - 1e-9 * size]
        edge = own[np.argmax(np.linalg.norm(own - own[0], axis=1))] - own[0]
        if len(normals) == 6 and len(own) == 4:  # a rectangle: along its sides, not its diagonal
            edge = own[np.argsort(np.linalg.norm(own - own[0], axis=1))[1]] - own[0]
        first = edge / np.linalg.norm(edge)
        second = np.cross(normal, first)
        for axis, direction in enumerate((first, second)):
            along = own @ direction
            spans[k, axis] = 0.5 * (along.max() - along.min()) * direction
            anchors[k] += 0.5 * (along.max() + along.min()) * direction
        anchors[k] += offsets[k] * normal
    return Polytope(jnp.asarray(normals), jnp.asarray(offsets), jnp.asarray(anchors), jnp.asarray(spans),
                    jnp.asarray(np.linalg.norm(corners, axis=1).max()),
                    names or tuple(f"face {k + 1}" for k in range(len(normals))))


def merge_faces(vertices: Any, faces: Any) -> Polytope:
    """The surface of a closed convex mesh, triangles of one plane made one face; vertices from the centre of mass.

    Raises:
        InputError: where the mesh is not closed, or not convex by more than 1e-6 of its size.
    """
    vertices, faces = np.asarray(vertices, dtype=float), np.asarray(faces)
    check_faces(faces, vertices.shape)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    heights = vertices @ normals.T - np.sum(normals * a, axis=1)
    size = np.abs(vertices).max()
    if heights.max() > 1e-6 * size:
        raise InputError("a body to be struck must be convex; this mesh is not: a corner lies "
                         f"{heights.max():.3g} m outside one of its faces")
    kept: list[np.ndarray] = []
    for normal in normals:
        if not any(np.allclose(normal, one, atol=1e-6) for one in kept):
            kept.append(normal)
    return make_polytope(vertices, np.array(kept))


@final
class Debris(eqx.Module):
    """The debris that is struck: a rigid body and its surface.

    Attributes:
        mass: [kg].
        inertia: about the centre of mass, body components, shape (3, 3) [kg m²].
        surface: from the centre of mass, body components.
    """

    mass: Array = eqx.field(converter=scalar)
    inertia: Array = eqx.field(converter=scalar)
    surface: AbstractSurface

    def __check_init__(self):
        if is_known((self.mass, self.inertia)) and np.ndim(self.mass) == 0:
            if not float(self.mass) > 0:
                raise InputError(f"the mass of the debris must be positive [kg]; got {float(self.mass):g}")
            check_inertia(np.asarray(self.inertia))


def make_debris(body: AbstractBody, inertia: Any = None, centre: Any = None) -> Debris:
    """Debris of one of the shapes of `bodies`: a solid cylinder, sphere, box, or convex mesh.

    Args:
        body: shape, mass, and what is not given otherwise.
        inertia: about the centre of mass, body components, shape (3, 3) [kg m²]; of uniform density if not given,
            about an offset centre as well.
        centre: centre of mass from that of a body of uniform density, body components, shape (3,) [m].

    Raises:
        InputError: for a shape whose surface is not known here, a mesh that is not convex, an inertia that no body has,
            or a centre of mass outside the body.
    """
    if isinstance(body, Cylinder):
        surface = CylinderSurface(body.radius, body.length)
    elif isinstance(body, Sphere):
        surface = SphereSurface(body.radius)
    elif isinstance(body, Box):
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
        normals = np.concatenate([np.eye(3), -np.eye(3)])
        surface = make_polytope(0.5 * signs * np.asarray(body.lengths), normals, ("+x", "+y", "+z", "-x", "-y", "-z"))
    elif isinstance(body, Mesh):
        middle = integrate_mesh(body.vertices, body.faces)[1]
        surface = merge_faces(np.asarray(body.vertices) - np.asarray(middle), body.faces)
    else:
        raise InputError(f"a {type(body).__name__} cannot be struck, because its surface is not defined; use a "
                         "Cylinder, Sphere, Box or convex Mesh")
    tensor = jnp.asarray(body.inertia() if inertia is None else inertia, dtype=float)
    if centre is None or not np.any(centre):
        return Debris(body.mass, tensor, surface)
    if float(surface.find_foot(scalar(centre)).distance) >= 0.0:
        raise InputError("the centre of mass of a body to be struck must lie inside it")
    return Debris(body.mass, tensor, OffsetSurface(surface, centre))
