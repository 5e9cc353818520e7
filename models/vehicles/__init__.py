"""Equations of motion of vehicles, with their derivatives; the factors, the simulator and you use them."""

from models.vehicles.ackermann import ackermann
from models.vehicles.differential_drive import differential_drive, travel_sigmas, wheel_travel

__all__ = ["ackermann", "differential_drive", "travel_sigmas", "wheel_travel"]
