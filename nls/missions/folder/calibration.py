"""calibration.csv: numbers of the sensors that are not known exactly, each a variable with a prior, or a constant.

One row a number: its name, its value, and its standard deviation; 0 holds it at the value. A name that no measurement
of the mission uses is an error, so that no row is without effect.
"""

import numpy as np

from factors import Diagonal, Heading, Prior, Shifted
from factors.base import Factor
from factors.keys import Keys, Kind
from factors.replaced import replaced
from models import Manifold, R
from models.algebra import Array, Numbers
from models.options import did_you_mean
from nls.io.report import Source
from nls.missions.folder.table import Table

Compass = tuple[Keys, Array]  # poses and their yaw (n,), rad
Spaces = dict[Kind, tuple[Manifold, Array, Numbers]]  # of `nls.Values`

NAMES = {  # of a calibration: what it is
    "dvl_scale": "scale error of the DVL, a fraction: it reads 1 + this times the velocity",
    "dvl_yaw_rad": "the axes of the DVL are turned by this from those of dvl_mount.csv, to starboard",
    "ahrs_clock_s": "times of ahrs.csv are late by this",
    "fixes_clock_s": "times of fixes.csv are late by this",
    "usbl_clock_s": "times of usbl.csv are late by this",
    "ranges_clock_s": "times of ranges.csv are late by this",
    "declination_rad": "the headings of ahrs.csv are from a north that is this east of true north",
    "usbl_yaw_rad": "the axes of usbl.csv are turned by this from those of the ship, or of the vehicle, to starboard",
    "usbl_scale": "ranges of usbl.csv are 1 + this times the distance, as of a sound speed that is too high",
    "sound_speed_scale": "ranges of ranges.csv are 1 + this times the distance, as of a sound speed that is too high",
}


def wide(name: str) -> float:
    """The standard deviation of a calibration of which nothing is known before: rad, s or a fraction."""
    return next(sigma for end, sigma in {"_rad": 1.0, "_s": 10.0, "_scale": 0.3}.items() if name.endswith(end))


class Calibrations:
    """The rows of calibration.csv; those that measurements ask for become variables, or constants.

    Parameters
    ----------
    table : of the file; None where there is none.

    Raises
    ------
    GraphFileError
        A name that is none or stands there twice; a standard deviation below 0.
    """

    def __init__(self, table: Table | None) -> None:
        self._table = table
        self._rows: dict[str, tuple[float, float, int]] = {}  # value, standard deviation (0: held), row
        self._used: list[str] = []
        self._more: dict[Kind, tuple[int, float]] = {}
        if table is None:
            return
        numbers = table.measured("value", "sigma")
        for row, name in enumerate(table.text_of("name")):
            value, sigma = numbers[row].tolist()
            if name not in NAMES:
                near = f"{did_you_mean(name, NAMES)}; one of {', '.join(NAMES)}"
                raise table.at(row, f"no calibration is called {name!r}{near}")
            if name in self._rows:
                raise table.at(row, f"{name} was given before, on line {int(table.lines[self._rows[name][2]]) + 1}")
            if sigma < 0:
                raise table.at(row, f"sigma is {sigma!r}; expected a standard deviation, or 0 to fix the value")
            self._rows[name] = value, sigma, row

    def variable(self, name: str) -> Keys | None:
        """The variable of a name, which this marks as used; None where the number is known, see `value`."""
        if name not in self._rows:
            return None
        self._used.append(name)
        return Kind(name)[0] if self._rows[name][1] > 0 else None

    def value(self, name: str) -> float:
        """The value of a name; 0 where there is no row."""
        return self._rows[name][0] if name in self._rows else 0.0

    def shifted(self, factor: Factor, name: str, G: Array) -> Factor:
        """Measurements z (n, m) as believed, which change by G (n, m) with a calibration; the same where it is held."""
        if (variable := self.variable(name)) is None:
            return factor
        z = np.reshape(factor.z, G.shape) + G * self.value(name)
        return Shifted(replaced(factor, z=z), G[:, :, None], variable)

    def add(self, kind: Kind, count: int, sigma: float) -> None:
        """Variables in R(1) that a log needs, numbered from 0, that begin at 0, the first known to sigma."""
        self._more[kind] = count, sigma

    def headings(self, factor: Factor) -> Compass | None:
        """Poses and their yaw (n,) by a compass, with its calibrations as believed; None of other factors."""
        shift = np.zeros(1)
        while isinstance(factor, Shifted):
            shift = shift + factor.G[:, 0, 0] * self.value(factor.key.kind)
            factor = factor.factor
        return (factor.keys[0], factor.z.reshape(-1) - shift) if isinstance(factor, Heading) else None

    def given(self) -> dict[str, tuple[float, float]]:
        """Value and standard deviation before the measurements, of every variable and the first that a log needs."""
        rows = {name: self._rows[name][:2] for name in self.variables}
        return rows | {kind.name: (0.0, sigma) for kind, (_, sigma) in self._more.items()}

    @property
    def variables(self) -> dict[str, float]:
        """Names that are variables and used, with their values, in the order of the file."""
        return {name: value for name, (value, sigma, _) in self._rows.items() if sigma > 0 and name in self._used}

    def spaces(self) -> Spaces:
        """The variables for `nls.Values`, each number 0 of a kind of its own."""
        begin = {Kind(name): np.array([[value]]) for name, value in self.variables.items()}
        begin |= {kind: np.zeros((count, 1)) for kind, (count, _) in self._more.items()}
        return {kind: (R(1), X, np.arange(len(X), dtype=np.int64)) for kind, X in begin.items()}

    def priors(self) -> list[tuple[Factor, Source]]:
        """The prior of each variable in the file, and its line.

        Raises
        ------
        GraphFileError
            A row that no measurement uses.
        """
        if self._table is None:
            return []
        for name, (_, _, row) in self._rows.items():
            if name not in self._used:
                cure = "leave the row out, or add its file"
                raise self._table.at(row, f"no measurement of this mission depends on {name}; {cure}")
        used = [(Kind(name)[0], self._rows[name]) for name in self.variables]
        return [(Prior(k, [z], Diagonal([sigma])), self._table.source(np.array([row]))) for k, (z, sigma, row) in used]
