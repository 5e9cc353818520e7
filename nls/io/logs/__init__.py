"""Public logs of real and simulated vehicles, read as plain arrays: one file of this folder for each."""

from nls.io.logs.auv_dvl import AuvDvl, read_auv_dvl
from nls.io.logs.caves import Caves, read_caves
from nls.io.logs.holoocean import HoloOcean, read_holoocean
from nls.io.logs.mrclam import Mrclam, read_mrclam
from nls.io.logs.victoria_park import VictoriaPark, read_victoria_park

__all__ = [
    "AuvDvl",
    "Caves",
    "HoloOcean",
    "Mrclam",
    "VictoriaPark",
    "read_auv_dvl",
    "read_caves",
    "read_holoocean",
    "read_mrclam",
    "read_victoria_park",
]
