"""Public logs of real and simulated vehicles, read as plain arrays: one file of this folder for each."""

from .auv_dvl import AuvDvl, read_auv_dvl
from .caves import Caves, read_caves
from .holoocean import HoloOcean, read_holoocean
from .mrclam import Mrclam, read_mrclam
from .victoria_park import VictoriaPark, read_victoria_park

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
