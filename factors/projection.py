"""The image of a point in a camera with known calibration."""

from __future__ import annotations

import numpy.typing as npt

from factors.keys import Keys
from factors.mount import named_singularity
from factors.noise import Noise
from factors.range_azimuth import InSpace
from models.algebra import Array
from models.errors import OptionError
from models.sensors import Camera

__all__ = ["Projection"]


class Projection(InSpace):
    r"""Pixels of a point in a camera; camera axes x right, y down, z forward.

    .. math:: h(X, l) = f \, d(p_{xy} / p_z) + c, \quad p = (X \circ O)^{-1} l

    Parameters
    ----------
    pose : the vehicle(s), SE3; without an offset the camera(s), camera to world.
    target : the point(s), R(3); or other poses, of which the position is meant.
    z : (n, 2) pixels ``u`` (to the right) and ``v`` (down); normalized coordinates for a camera without numbers.
    noise : of ``u`` and ``v``, in the unit of z.
    camera : focal lengths f, center c and distortion d, `models.sensors.Camera`; one for all measurements.
    offset : pose of the camera on the vehicle, (7,) or (n, 7), or a variable in SE3; None: no offset.

    Raises
    ------
    GraphError
        Spaces or shapes that do not fit.
    OptionError
        A camera that is none.
    SingularGeometryError
        At evaluation: a point behind the camera or in its plane.

    Notes
    -----
    A point behind the camera is refused and never given the image of the opposite point in front. Damped optimizers
    turn back from a step that leads there. One view leaves the point on a ray, and images alone leave the whole scene
    without a scale. A range or a known distance gives it. Source: R. Hartley, A. Zisserman, Multiple View Geometry in
    Computer Vision, 2004, section 6.1.

    Examples
    --------
    A point seen by two cameras, half a meter apart:

    >>> import numpy as np
    >>> from factors import Isotropic, Projection
    >>> from models import SE3, R
    >>> from models.sensors import Camera
    >>> from nls import FactorGraph, Values, kinds
    >>> x, l = kinds("x", "l")
    >>> camera = Camera(focal=(600.0, 600.0), center=(640.0, 480.0))
    >>> graph = FactorGraph([Projection(x[[0, 1]], l[0], [[790.0, 480.0], [640.0, 480.0]], Isotropic(1.0), camera)])
    >>> graph.fix(x[[0, 1]])
    >>> values = Values({x: (SE3, np.array([[0, 0, 0, 0, 0, 0, 1], [0.5, 0, 0, 0, 0, 0, 1]])), l: (R(3), [0, 0, 4])})
    >>> graph.optimize(values).values[l[0]].round(4)
    array([0.5, 0. , 2. ])
    """

    measures = ("u", "v")
    damped = True
    shared = ("camera",)

    def __init__(
        self,
        pose: Keys,
        target: Keys,
        z: npt.ArrayLike,
        noise: Noise,
        camera: Camera = Camera(),  # noqa: B008  frozen
        offset: npt.ArrayLike | Keys | None = None,
    ) -> None:
        if not isinstance(camera, Camera):
            raise OptionError(f"{self.name}: camera", camera, "a camera such as Camera(focal=(600.0, 600.0))")
        super().__init__(pose, target, z, noise, offset)
        self.camera = camera

    def sense(self, p: Array) -> tuple[Array, Array]:
        return self.camera.project(p)

    def rays(self, z: Array) -> tuple[Array, Array]:
        with named_singularity(self):
            return self.camera.ray(z)
