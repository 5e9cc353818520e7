"""Errors and warnings: the base classes user code relies on, their sentences and attributes."""

from __future__ import annotations

import pickle

import numpy as np

from models import errors
from models.advice import Advice, listed

SECOND_BASES = {
    "GraphFileError": ValueError,
    "GraphError": ValueError,
    "NoiseModelError": ValueError,
    "EvaluationError": ArithmeticError,
    "JacobianError": ArithmeticError,
    "UnderconstrainedError": np.linalg.LinAlgError,
    "ResourceLimitError": MemoryError,
    "SingularGeometryError": ArithmeticError,
    "MissingSolverError": ImportError,
    "OptionError": ValueError,
}
ERRORS = sorted(name for name in errors.__all__ if name.endswith("Error") and name != "LeadlineError")


def test_every_class_of_the_module_is_public() -> None:
    defined = {n for n, c in vars(errors).items() if isinstance(c, type) and c.__module__ == errors.__name__}
    assert defined == set(errors.__all__)


def test_every_error_has_a_standard_base_and_is_made_of_its_message_alone() -> None:
    for name in ERRORS:
        error = getattr(errors, name)
        assert issubclass(error, errors.LeadlineError)
        assert issubclass(error, SECOND_BASES[name])
        assert not issubclass(errors.LeadlineError, SECOND_BASES[name])
    for name in (*ERRORS, "LeadlineError"):
        assert str(getattr(errors, name)("hello")).endswith("hello"), name
    assert issubclass(errors.NoiseModelError, errors.GraphError)
    assert issubclass(errors.JacobianError, errors.EvaluationError)
    assert issubclass(errors.GraphWarning, UserWarning)


def test_file_error_has_path_and_line_and_80_characters_of_it() -> None:
    error = errors.GraphFileError("too long", "a/b.g2o", 17, "0123456789" * 20)
    assert (error.path, error.line, error.text) == ("a/b.g2o", 17, "0123456789" * 8)
    assert str(error) == f"a/b.g2o:17: too long [{'0123456789' * 8}]"
    assert errors.GraphFileError("fits", "b.g2o", 3, "x" * 80).text == "x" * 80
    assert str(errors.GraphFileError("is empty", "c.g2o")) == "c.g2o: is empty"  # the whole file
    assert str(errors.GraphFileError("is empty")) == "<text>: is empty"
    assert errors.GraphFileError("is empty").line is None
    option = errors.OptionError("gauge", "frist", "one of first, prior")
    assert str(option) == "gauge: 'frist' is not possible; expected one of first, prior"
    assert (option.option, option.value, option.allowed) == ("gauge", "frist", "one of first, prior")


def test_advice_is_python_unless_the_shell_asks() -> None:
    cures = [Advice("qr"), Advice("gauge")]
    python = ["keep twice the digits: linear_solver=nls.QR()", "fix one pose of every part: gauge='first'"]
    assert listed(cures) == [cure.words() for cure in cures] == python
    assert listed(cures, shell=True) == [
        "keep twice the digits: --linear-solver qr",
        "fix one pose of every part: --gauge first",
    ]


def test_an_error_from_another_process_is_the_same() -> None:
    for error in (
        errors.OptionError("gauge", "firts", "first"),
        errors.GraphFileError("a bad line", "f.g2o", 3),
        errors.UnderconstrainedError("x0 is free", []),
    ):
        copied = pickle.loads(pickle.dumps(error))
        assert type(copied) is type(error)
        assert str(copied) == str(error)
        assert vars(copied) == vars(error)
