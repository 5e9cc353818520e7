"""mission.toml of a scan mission: how the sonar is mounted, and how wrong dead reckoning is.

[sonar]
azimuth = "left"       positive to the left, or "right"
x_m = 0.0              place of the sonar on the vehicle, x ahead, y to the left; also y_m
yaw_rad = 0.0          where it looks, positive to the left
[drift]                see `nls.missions.scans.Drift`: mean, stretch, length, step, yaw, heading
heading = false        no compass
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from models.options import did_you_mean, is_number
from nls.missions.folder.toml_file import TomlFile
from nls.missions.scans import Drift

__all__ = ["Settings", "read_settings"]

SIDES = {"left": 1.0, "right": -1.0}
MOUNT = ("x_m", "y_m", "yaw_rad")
KEYS = {"sonar": ("azimuth", *MOUNT), "drift": tuple(entry.name for entry in fields(Drift))}
SMALLEST = 1e-6  # of a drift: less is none
FAR, TURN = 1e3, 6.2832  # m, rad: no sonar is mounted farther away, or turned by more


@dataclass(frozen=True)
class Settings:
    """How a mission was sailed.

    Attributes
    ----------
    side : 1 where azimuths are positive to the left, -1 to the right.
    mount : pose of the sonar on the vehicle: x ahead and y to the left, m, and yaw, rad.
    drift : how wrong dead reckoning is.
    """

    side: float = 1.0
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    drift: Drift = field(default_factory=Drift)


def read_settings(path: str | Path) -> Settings:
    """The settings in a file.

    Raises
    ------
    GraphFileError
        No TOML, an unknown section or key, a value that cannot be: with file and line.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "mission.toml")
    ...     _ = file.write_text('[sonar]\\nazimuth = "right"\\nx_m = 0.4\\n')
    ...     settings = read_settings(file)
    >>> settings.side, settings.mount
    (-1.0, (0.4, 0.0, 0.0))
    """
    file = TomlFile.read(path)
    _refuse_unknown(file)
    sonar, drift = file.tree.get("sonar", {}), file.tree.get("drift", {})
    side = sonar.get("azimuth", "left")
    if not isinstance(side, str) or side not in SIDES:
        near = did_you_mean(side, SIDES) if isinstance(side, str) else ""
        raise file.error(
            "sonar", "azimuth", f"azimuth is {side!r}; expected the positive side, 'left' or 'right'{near}"
        )
    for name in MOUNT:
        limit, unit = (TURN, "rad") if name == "yaw_rad" else (FAR, "m")
        if not is_number(value := sonar.get(name, 0.0)) or not abs(value) <= limit:
            raise file.error("sonar", name, f"{name} is {value!r}; expected a number, {unit}, within {limit:g}")
    for name, value in drift.items():
        if name == "heading" and value is False:
            continue
        if not is_number(value) or not SMALLEST <= value <= FAR:
            none = ", or false: no compass" if name == "heading" else ""
            allowed = f"a number from {SMALLEST:g} to {FAR:g}{none}"
            raise file.error("drift", name, f"{name} is {value!r:.40}; expected {allowed}")
    x, y, yaw = (float(sonar.get(name, 0.0)) for name in MOUNT)
    given: dict[str, Any] = {name: None if value is False else float(value) for name, value in drift.items()}
    return Settings(SIDES[side], (x, y, yaw), Drift(**given))


def _refuse_unknown(file: TomlFile) -> None:
    """Refuse sections and keys that a mission does not have."""
    for section, content in file.tree.items():
        known = " and ".join(f"[{name}]" for name in KEYS)
        if section not in KEYS:
            raise file.error(section, "", f"unknown section {section!r}; expected {known}{did_you_mean(section, KEYS)}")
        if not isinstance(content, dict):
            raise file.error(section, "", f"{section} is {content!r}; expected a section, [{section}]")
        for key in content:
            if key not in KEYS[section]:
                near = did_you_mean(key, KEYS[section])
                message = f"[{section}] has no {key!r}; expected {', '.join(KEYS[section])}{near}"
                raise file.error(section, key, message)
