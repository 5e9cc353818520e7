"""Public logs of real and simulated vehicles, read as plain arrays."""

from .landmarks import Mrclam, VictoriaPark, read_mrclam, read_victoria_park
from .underwater import AuvDvl, Caves, HoloOcean, read_auv_dvl, read_caves, read_holoocean

__all__ = ["AuvDvl", "Caves", "HoloOcean", "Mrclam", "VictoriaPark"]
__all__ += ["read_auv_dvl", "read_caves", "read_holoocean", "read_mrclam", "read_victoria_park"]
