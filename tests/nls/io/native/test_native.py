"""Native files: every graph bit for bit, in both forms; what is damaged is refused in a sentence, and runs nothing."""

from __future__ import annotations

import inspect
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import factors
import nls
import nls.io
import sim
from factors import Between, Cauchy, Diagonal, Huber, Isotropic, Noise, Position, Prior, RangeAzimuth
from factors.keys import Keys
from models import SE2, SE3, R
from models.errors import GraphError, GraphFileError, LeadlineError, OptionError
from nls import FactorGraph, Values, kinds
from nls.incremental.marginal import marginalized
from nls.io.native.data import archived
from tests.factors.samples import Sample, full_noise
from tests.factors.samples_sonar import ELIMINATING_SAMPLES
from tests.factors.test_conformity import SAMPLES, situation

FORMS = "npz", "json"
x, l = kinds("x", "l")
HERE = Path(__file__).parent / "files"
Change = Callable[[dict[str, Any]], None]


def same(graph: FactorGraph, values: Values, other: FactorGraph, its: Values) -> None:
    """Two graphs at two values have the same rows, to the bit."""
    mine, theirs = graph.linearize(values), other.linearize(its)
    assert np.array_equal(mine.b, theirs.b)
    assert mine.chi2 == theirs.chi2
    assert np.array_equal(mine.A.data, theirs.A.data)
    assert np.array_equal(mine.A.indices, theirs.A.indices)
    assert [f.kernel for f in graph.factors] == [f.kernel for f in other.factors]
    assert [f.convention for f in graph.factors] == [f.convention for f in other.factors]


def again(path: Path, graph: FactorGraph, values: Values) -> tuple[FactorGraph, Values]:
    nls.save(path, graph, values)
    return nls.load(path)[:2]


def small() -> tuple[FactorGraph, Values]:
    """Two poses and a landmark, one pose held; what the committed files hold."""
    noise = Diagonal(x=[0.1, 0.3], y=0.2, yaw=0.05)
    odometry = Between(x[[0, 1]], x[[1, 2]], [[1, 0, 0.1], [1, 0, 1 / 3]], noise, "g2o").robust(Cauchy(2.0))
    place = Position(x[2], [2.0, 0.1], Isotropic(0.5), offset=[0.1, 0.0])
    values = Values({x: (SE2, [[0, 0, 0], [1, 0, 0.1], [2, 0.1, 0.4]], [0, 1, 2]), l: (R(2), np.zeros((0, 2)))})
    return FactorGraph([odometry, place], [x[0]]), values


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("sample", [s for s in (*SAMPLES, *ELIMINATING_SAMPLES) if "function" not in s.name], ids=str)
def test_every_factor_is_the_same_to_the_bit(sample: Sample, form: str, tmp_path: Path) -> None:
    X, z = situation(sample, "truth", 3, 0)
    factor, values = sample.factor(z, full_noise(3, sample.dim, 0)), sample.values(X)
    graph = FactorGraph([factor, factor.robust(Huber(1.5)), factor[[2, 0]]])
    same(graph, values, *again(tmp_path / f"sample.{form}", graph, values))


def test_every_class_of_factors_noise_and_kernels_has_a_name() -> None:
    for name in factors.__all__:
        thing = getattr(factors, name)
        if inspect.isclass(thing) and not inspect.isabstract(thing) and issubclass(thing, Noise | factors.Kernel):
            arguments = {"Robust": (Isotropic(2.0), Huber(1.0)), "Isotropic": (2.0,), "Diagonal": ([0.1, 0.2, 0.3],)}
            made = thing(*arguments.get(name, (np.eye(3),) if issubclass(thing, Noise) else (1.5,)))
            noise = made if isinstance(made, Noise) else factors.Robust(Isotropic(1.0), made)
            graph, values = FactorGraph([Prior(x[0], [0.1, 0.2, 0.3], noise)]), Values({x: (SE2, [[0, 0, 0]])})
            read = nls.io.load_stream(_stream(graph, values), "memory")[0]
            assert type(read.factors[0].noise) is type(noise)
            same(graph, values, read, values)


def _stream(graph: FactorGraph, values: Values) -> io.BytesIO:
    return io.BytesIO(nls.io.rendered("memory.npz", graph, values)[0])


@pytest.mark.parametrize("kind", [factors.Covariance, factors.Information, factors.SqrtInformation])
def test_parts_of_a_batch_are_kept(kind: type[Noise], tmp_path: Path) -> None:
    """Matrices of a part are equal, or diagonal, where those of the whole are not."""
    full, diagonal = np.array([[9.0, 1.0, 0.0], [1.0, 4.0, 0.0], [0.0, 0.0, 1.0]]), np.diag([3.0, 3.0, 7.0])
    steps = Between(x[[0, 1, 2]], x[[1, 2, 3]], np.zeros((3, 3)), kind([full, full, diagonal]))
    values = Values({x: (SE2, np.zeros((4, 3)))})
    for part in ([0, 1], [2]):
        graph = FactorGraph([steps[part]])
        read, its = again(tmp_path / "part.npz", graph, values)
        assert type(read.factors[0].noise) is kind
        same(graph, values, read, its)


def test_what_a_window_left_is_kept(tmp_path: Path) -> None:
    world = sim.subsea(np.random.default_rng(1), laps=1)
    left, values = marginalized(world.graph.factors, world.start, [x[:20]])
    same(FactorGraph(left), values, *again(tmp_path / "window.json", FactorGraph(left), values))


def test_fixed_variables_and_times_are_kept(tmp_path: Path) -> None:
    graph, values = small()
    report = nls.LoadReport("log", "mission", "2-D", "log", vertex_times={"x": np.array([0.5, 1.5, 2.5])})
    for form in FORMS:
        nls.save(tmp_path / f"small.{form}", graph, values, report)
        read, its, notes = nls.load(tmp_path / f"small.{form}")
        assert read.fixed == [x[[0]]]
        assert its.stacks.keys() == values.stacks.keys()
        assert notes.vertex_times["x"].tolist() == [0.5, 1.5, 2.5]
        assert (notes.format, notes.dimension, notes.convention) == (form, "2-D", "g2o, log")
        assert read.optimize(its).chi2_final == graph.optimize(values).chi2_final


@pytest.mark.parametrize("form", FORMS)
def test_files_of_version_1_are_read(form: str) -> None:
    graph, values = small()
    read, its, _ = nls.load(HERE / f"version-1.{form}")
    same(graph, values, read, its)


class Gauge(Prior):
    """A factor of a user's."""


class Forgetful(Prior):
    """A factor that keeps a number its constructor does not take."""

    def __init__(self, key: Keys, z: npt.ArrayLike, noise: Noise) -> None:
        super().__init__(key, z, noise)
        self.secret = float(np.sum(z))

    secret = 0.0


def test_a_class_of_the_users_is_held_by_its_name(tmp_path: Path) -> None:
    values = Values({x: (R(1), [[0.0]])})
    graph = FactorGraph([Gauge(x[0], [[1.0]], Isotropic(0.5))])
    with pytest.raises(GraphError, match="Gauge is no class that a native file holds; name a factor class with"):
        nls.save(tmp_path / "gauge.npz", graph, values)
    nls.io.register("Gauge of a test")(Gauge)
    nls.io.register("Gauge of a test")(Gauge)
    read, its = again(tmp_path / "gauge.json", graph, values)
    same(graph, values, read, its)
    assert type(read.factors[0]) is Gauge
    with pytest.raises(OptionError, match="another name"):
        nls.io.register("Between")(Gauge)
    with pytest.raises(OptionError, match="a factor class"):
        nls.io.register("Function")(len)  # type: ignore[type-var]
    nls.io.register("Forgetful")(Forgetful)
    forgetful = Forgetful(x[0], [[1.0]], Isotropic(0.5))
    forgetful.secret = 7.0
    with pytest.raises(GraphError, match="would be read without its secret"):
        nls.save(tmp_path / "gauge.npz", FactorGraph([forgetful]), values)


@nls.io.register("Level of a test")
class Level(Prior):
    """A factor with a number of its own."""

    def __init__(self, key: Keys, z: npt.ArrayLike, noise: Noise, level: object = None) -> None:
        super().__init__(key, z, noise)
        self.level = level


@pytest.mark.parametrize("form", FORMS)
def test_what_no_file_holds_is_refused(form: str, tmp_path: Path) -> None:
    values = Values({x: (R(1), [[0.0]])})
    for level, sentence in (
        (np.inf, "inf is not finite"),
        (np.array([np.nan]), "not finite"),
        (np.array(["a"]), "array of <U1"),
    ):
        with pytest.raises(GraphError, match=sentence):
            nls.save(tmp_path / f"level.{form}", FactorGraph([Level(x[0], [[1.0]], Isotropic(1.0), level)]), values)
    for level in (np.array([True, False]), np.zeros((0, 5000)), 0.5, ("a", 3)):
        graph, _ = again(tmp_path / f"level.{form}", FactorGraph([Level(x[0], [[1.0]], Isotropic(1.0), level)]), values)
        np.testing.assert_array_equal(vars(graph.factors[0])["level"], level)


def test_single_measurements_are_read_as_they_are_evaluated(tmp_path: Path) -> None:
    world = sim.ring(np.random.default_rng(0), laps=2, per_lap=20)
    singles = FactorGraph([factor[[k]] for factor in world.graph.factors for k in range(len(factor))])
    graph, values = again(tmp_path / "singles.npz", singles, world.start)
    assert [len(factor) for factor in graph.factors] == [len(world.graph)]
    assert nls.gnc(graph, values).result.converged


def _json(change: Change) -> bytes:
    """The file of `small` as JSON, changed."""
    plain = json.loads(nls.io.rendered("small.json", *small())[0])
    change(plain)
    return json.dumps(plain).encode()


def _factor(**changes: Any) -> Change:
    return lambda plain: plain["factors"]["0"].update(changes)


def _values(**changes: Any) -> Change:
    return lambda plain: plain["values"]["x"].update(changes)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda plain: plain.update(version=2), "has version 2, this library reads 1"),
        (lambda plain: plain.update(format="other"), "does not say that its format is 'leadline graph'"),
        (lambda plain: plain.pop("factors"), "its factors are missing"),
        (lambda plain: plain.update(fixd={}), "the file: 'fixd' is no entry here; expected factors, fixed, format"),
        (lambda plain: plain["values"]["x"].update(tims=[1.0]), "values of 'x': 'tims' is no entry here"),
        (lambda plain: plain["values"]["x"].update(X=[[True] * 3] * 3), "values of 'x': expected arrays of numbers"),
        (_factor(type="os.system"), "factor 0 .os.system.: 'os.system' is no class of this library"),
        (_factor(type="Betwen"), "did you mean"),
        (_factor(type="Huber"), "Huber cannot be made of i, j, z, noise, convention"),
        (
            _factor(i={"kind": "x", "numbers": [0]}, j={"kind": "x", "numbers": []}),
            "its measurements z are of no variables",
        ),
        (_factor(z=[[1, 2]]), "expected"),
        (_factor(z=[[float("nan"), 0, 0]] * 2), "NaN is no finite number"),
        (_factor(noise={"type": "Diagonal", "x": [-0.1], "y": [0.1], "yaw": [0.1]}), "sigma of x"),
        (_factor(i={"kind": "x"}), "expected a thing with a type, or a kind and its numbers"),
        (_factor(limit=3), "Between cannot be made of .*limit"),
        (_factor(z={"array": "values.x.X"}), "the array 'values.x.X' is missing"),
        (_factor(z={"shape": [0, 10**15]}), "expected the shape of an array without numbers"),
        (_values(space="SE5"), "'SE5' is no space of this library"),
        (_values(space="R(99999999)"), "is no space"),
        (_values(numbers=[0, 0, 1]), "x0 is given twice"),
        (_values(X=[[0, 0]]), "values of 'x'"),
        (_values(times=[1, 2, 3]), "expected a time for each"),
        (_values(X="abc"), "expected arrays of numbers"),
        (lambda plain: plain.update(version=[1, 2]), "has version array"),
        (lambda plain: plain.update(format=[1, 2]), "does not say that its format"),
        (lambda plain: plain["fixed"].update(x=[77]), "fixed: x77"),
    ],
)
def test_what_cannot_be_right_is_named(change: Change, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "wrong.json"
    path.write_bytes(_json(change))
    with pytest.raises(GraphFileError, match=sentence) as caught:
        nls.load(path)
    assert str(caught.value).startswith(f"{path}")
    assert "\n" not in str(caught.value)


def zipped(content: bytes, packing: int = zipfile.ZIP_STORED) -> bytes:
    """An archive with this content of its structure."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as archive:
        archive.writestr("structure.npy", content)
    return out.getvalue()


def test_archives_that_are_something_else(tmp_path: Path) -> None:
    good, objects = nls.io.rendered("small.npz", *small())[0], io.BytesIO()
    np.savez(objects, structure=np.array([print], dtype=object))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117)
    for data, sentence in (
        (good[: len(good) // 2], "is a damaged npz file"),
        (objects.getvalue(), "holds object, expected numbers or text"),
        (zipped(b"\x93NUMPY\x01\x00v\x00" + header + b"\n"), "says 1000000000000 numbers of float64, and has 0 bytes"),
        (zipped(bytes(1 << 24), zipfile.ZIP_DEFLATED), "claims to unpack to 16,777,216 bytes"),
        (zipped(bytes(1 << 20), zipfile.ZIP_BZIP2), "is packed in a way that NumPy does not write"),
        (good.replace(b"'shape': ()", b"'shape': [ ", 1), "is a damaged npz file"),
        (archived({"z": np.zeros(3)}), "has no text 'structure'"),
        (archived({"structure": np.array("{")}), "is no JSON"),
        (archived({"structure": np.array("[" * 5000)}), "is no JSON|recursion|brackets"),
    ):
        (tmp_path / "wrong.npz").write_bytes(data)
        with pytest.raises(LeadlineError, match=sentence):
            nls.load(tmp_path / "wrong.npz")


def test_a_sonar_on_a_pose_in_space_by_hand(tmp_path: Path) -> None:
    """The text that a person reads."""
    graph = FactorGraph([RangeAzimuth(x[0], l[7], [5.0, 0.25], Diagonal(range=0.01, azimuth=0.005))])
    path = tmp_path / "contact.json"
    nls.save(path, graph, Values({x: (SE3, SE3.identity()), l: (R(3), [[5.0, 0, 0]], [7])}))
    assert json.loads(path.read_text())["factors"]["0"] == {
        "type": "RangeAzimuth",
        "pose": {"kind": "x", "numbers": [0]},
        "target": {"kind": "l", "numbers": [7]},
        "z": [5.0, 0.25],
        "noise": {"type": "Diagonal", "range": [0.01], "azimuth": [0.005]},
    }


HEAD = '{"format": "leadline graph",\n'


def text_of(folder: Path) -> str:
    """A graph of three priors on two variables."""
    graph = FactorGraph([Prior(l[[0, 1]], [[0.0, 1.0]], Isotropic(1.0)), Prior(x[0], [10.0], Isotropic(1.0))])
    nls.save(folder / "good.json", graph, Values({x: (R(1), [[0.0]]), l: (R(2), [[0.0, 0.0], [1.0, 1.0]])}))
    return (folder / "good.json").read_text()


@pytest.mark.parametrize("repeated", ["factors", "x", "l", "0", "1", "numbers", "X", "noise", "sigma", "type"])
def test_a_key_that_is_given_twice_is_named_with_its_line(repeated: str, tmp_path: Path) -> None:
    """The last such key of the file comes again, above itself, as quotes and braces in other texts do not disturb."""
    text = text_of(tmp_path)
    assert nls.load(tmp_path / "good.json")[0].chi2(nls.load(tmp_path / "good.json")[1]) > 0
    before, key, behind = text.rpartition(f'"{repeated}": ')
    twice = f'{before}{key}{{"\\"{repeated}\\": {{": [], "b": "{repeated}"}},\n\n{key}{behind}'
    assert json.loads(twice) == json.loads(text)  # it is lost without a word
    (tmp_path / "twice.json").write_text(twice)
    line = before.count("\n") + 3
    with pytest.raises(GraphFileError, match=rf"^\S+twice.json:{line}: the key '{repeated}' is given twice"):
        nls.load(tmp_path / "twice.json")


@pytest.mark.parametrize(
    ("rest", "line"),
    [
        (' "version": 1 \n\n\n\n', 2),
        (' "version": 1 \n\n\n\n "values": {}}', 2),
        (' "version": 1,\n\n\n ', 2),
        (' "version":\n\n\n\n }', 2),
        (' "version": [1, 2\n\n\n', 2),
        (' "version":\n\n 1,\n x: 3', 5),
        (' "version":\n\n one}', 4),
        (' "version": "1\n\n"}', 2),
    ],
)
def test_a_fault_is_named_where_it_is_not_where_it_is_noticed(rest: str, line: int, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(HEAD + rest)
    with pytest.raises(GraphFileError, match=rf"a\.json:{line}: is no JSON"):
        nls.load(tmp_path / "a.json")
