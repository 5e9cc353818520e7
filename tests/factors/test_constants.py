"""Numbers that a factor knows beside its measurements: a copy that stays, and a refusal of no numbers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from factors import DriftingStep, DvlLeg, Factor, Heading, Isotropic, Position, Shifted
from models.errors import GraphError
from nls import kinds

x, d, c = kinds("x", "d", "c")
UNIT = Isotropic(1.0)
FACTORS: dict[str, tuple[Callable[[npt.ArrayLike], Factor], npt.ArrayLike]] = {
    "length": (lambda numbers: DriftingStep(x[0], x[1], d[0], [1, 0, 0], UNIT, numbers), [1.0]),
    "ways": (lambda numbers: DvlLeg(x[0], x[1], [1, 0, 0], UNIT, numbers, c[0]), np.zeros((1, 3, 2))),
    "G": (lambda numbers: Shifted(Heading(x[0], 0.0, UNIT), numbers, c[0]), [[1.0]]),
    "offset": (lambda numbers: Position(x[0], [1, 2], UNIT, offset=numbers), [1.0, 2.0]),
}


@pytest.mark.parametrize("name", FACTORS)
def test_constants_are_numbers_and_stay_what_they_are(name: str) -> None:
    made, numbers = FACTORS[name]
    given = np.array(numbers)
    kept = getattr(made(given), name)
    given += 1
    np.testing.assert_array_equal(kept.ravel(), np.ravel(numbers))
    assert not kept.flags.writeable
    for wrong, reason in ((["a"], ".*'a'"), (x[2], "a variable; here it must be known")):
        with pytest.raises(GraphError, match=f"its {name} is not an array of numbers: {reason}"):
            made(wrong)  # type: ignore[arg-type]
