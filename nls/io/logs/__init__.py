"""Public logs of real and simulated vehicles, read as plain arrays: one file of this folder for each."""

from nls.io.logs.auv_dvl import AuvDvl, read_auv_dvl
from nls.io.logs.caves import Caves, read_caves
from nls.io.logs.holoocean import HoloOcean, read_holoocean

__all__ = ["AuvDvl", "Caves", "HoloOcean", "read_auv_dvl", "read_caves", "read_holoocean"]
