"""Dead reckoning: DVL velocities and gyro rates or attitudes, integrated into relative poses with covariances."""

from models.dead_reckoning.chain import chained
from models.dead_reckoning.legs import Legs, integrate
from models.dead_reckoning.plane import PlaneLegs, integrate_plane

__all__ = ["Legs", "PlaneLegs", "chained", "integrate", "integrate_plane"]
