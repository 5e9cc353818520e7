"""Errors and warnings: the base classes user code relies on, their sentences and attributes."""

from __future__ import annotations

import pickle
import warnings

import numpy as np
import pytest

from models import errors

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


@pytest.mark.parametrize("name", ERRORS)
def test_every_error_has_the_common_and_a_standard_base(name: str) -> None:
    error = getattr(errors, name)
    assert issubclass(error, errors.LeadlineError)
    assert issubclass(error, SECOND_BASES[name])
    assert not issubclass(errors.LeadlineError, SECOND_BASES[name])


def test_every_error_has_a_sentence() -> None:
    for name in sorted(set(ERRORS) - {"OptionError"}):
        message = str(getattr(errors, name)("a sentence"))
        assert message.endswith("a sentence"), name


def test_families() -> None:
    assert issubclass(errors.NoiseModelError, errors.GraphError)
    assert issubclass(errors.JacobianError, errors.EvaluationError)
    assert issubclass(errors.GraphWarning, UserWarning)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(errors.GraphWarning, match="a look"):
            warnings.warn("a look", errors.GraphWarning, stacklevel=1)


def test_file_error_begins_with_path_and_line() -> None:
    error = errors.GraphFileError("the number 'abc' is none", "a/b.g2o", 17, "EDGE_SE2 0 1 abc")
    assert str(error) == "a/b.g2o:17: the number 'abc' is none [EDGE_SE2 0 1 abc]"
    assert (error.path, error.line, error.text) == ("a/b.g2o", 17, "EDGE_SE2 0 1 abc")


def test_file_error_cuts_the_line_to_80_characters() -> None:
    error = errors.GraphFileError("too long", "b.g2o", 3, "0123456789" * 20)
    assert error.text == "0123456789" * 8
    assert str(error) == f"b.g2o:3: too long [{'0123456789' * 8}]"
    assert errors.GraphFileError("fits", "b.g2o", 3, "x" * 80).text == "x" * 80


def test_file_error_without_a_line_means_the_whole_file() -> None:
    assert str(errors.GraphFileError("is empty", "c.g2o")) == "c.g2o: is empty"
    assert str(errors.GraphFileError("is empty")) == "<text>: is empty"
    assert errors.GraphFileError("is empty").line is None


def test_option_error_says_what_was_expected() -> None:
    error = errors.OptionError("gauge", "frist", "one of first, prior")
    assert str(error) == "gauge: 'frist' is not possible; expected one of first, prior"
    assert (error.option, error.value, error.allowed) == ("gauge", "frist", "one of first, prior")


@pytest.mark.parametrize("name", [name for name in errors.__all__ if name.endswith("Error")])
def test_an_error_can_be_made_of_its_message_alone(name: str) -> None:
    assert str(getattr(errors, name)("hello")).endswith("hello")


def test_attributes() -> None:
    graph = errors.GraphError("m", ["x0", "x1"], "Between")
    assert (graph.keys, graph.factor) == (("x0", "x1"), "Between")
    noise = errors.NoiseModelError("m", "information", 3, -0.5)
    assert (noise.matrix, noise.index, noise.value, noise.keys) == ("information", 3, -0.5, ())
    evaluation = errors.EvaluationError("m", "Prior", ["x2"], 4, "residual")
    assert (evaluation.factor, evaluation.keys, evaluation.iteration) == ("Prior", ("x2",), 4)
    assert evaluation.where == "residual"
    jacobian = errors.JacobianError("m", "Prior", (0, 1, 2, 3), 1.0, -1.0)
    assert (jacobian.factor, jacobian.entry, jacobian.analytic, jacobian.numeric) == ("Prior", (0, 1, 2, 3), 1.0, -1.0)
    free = errors.UnderconstrainedError("m", ["x3"], 1, ["x3: yaw"], {"x": 1})
    assert (free.keys, free.nullity, free.components, free.values) == (("x3",), 1, ("x3: yaw",), {"x": 1})
    limit = errors.ResourceLimitError("m", 2e9, 1e9, "A")
    assert (limit.needed, limit.limit, limit.subject) == (2e9, 1e9, "A")
    singular = errors.SingularGeometryError("m", "Range", ["l1"])
    assert (singular.factor, singular.keys) == ("Range", ("l1",))


@pytest.mark.parametrize(
    "error",
    [
        errors.OptionError("gauge", "firts", "first"),
        errors.GraphFileError("a bad line", "f.g2o", 3),
        errors.UnderconstrainedError("x0 is free", []),
    ],
    ids=lambda error: type(error).__name__,
)
def test_an_error_from_another_process_is_the_same(error: errors.LeadlineError) -> None:
    copied = pickle.loads(pickle.dumps(error))
    assert type(copied) is type(error)
    assert str(copied) == str(error)
    assert vars(copied) == vars(error)
