"""The formats of graph files, trajectories and missions: one table, a row each.

A new format is one file with its reader and its writer, and one row of `FORMATS`. Both functions are imported when they
are used, and so is NumPy: the command line lists the formats without it.
"""

import os
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from importlib import import_module
from typing import Any, NamedTuple

SUBJECTS = {"repair_information": "information matrices", "ignore_tags": "tags", "drop_absent": "vertices to give"}
POSE_LINE = re.compile(rb"VERTEX_SE[23]\S*[ \t]+\S+[ \t]+(\S*)")  # its second word
POSE_NAME = re.compile(rb"[A-Za-z]+[0-9]+")


class Reading(NamedTuple):
    """The options of `nls.load` besides the file, in its order."""

    convention: str = "g2o"
    dialect: str = "auto"
    repair_information: bool = False
    elevation: str | None = None
    ignore_tags: Sequence[str] = ()
    drop_absent: bool = False


class Format(NamedTuple):
    """One format: a row of the table.

    Attributes
    ----------
    name : in options, reports and messages.
    holds, section : its contents, and the section of the page on formats that describes it.
    suffixes : endings of its names, without ``.gz``; one that stands in several rows leaves the choice to the user.
    looks : of the bytes, or of the path of a folder, why they are of this format; empty where they are not. None where
        tags or the name tell the format.
    reader : ``module:function``; of the bytes and the path, of a folder or a trajectory of the path. Returns graph,
        values and, last, the report.
    writer : ``module:function`` of path, name, graph, values and report. Returns the bytes, and notes on what they
        leave out.
    options : fields of `Reading` that the reader takes.
    by_name : whether the suffix decides, whatever the content.
    folder : whether it is a folder.
    tagged : whether its lines have tags, and its vertices ids: variables are of the kinds x, l and o.
    numbered : whether all vertices share one numbering.
    whole : whether it holds every graph, as one piece and not as lines.
    measurements, values : whether it holds these.
    entries : the matrix of an edge, where formats of one suffix differ in it.
    timeless : why its measurements are in no order of time.
    ranges : whether it has lines for ranges, which other files of lines have not.
    """

    name: str
    holds: str
    section: str
    suffixes: tuple[str, ...] = ()
    looks: Callable[[Any], str] | None = None
    reader: str = ""
    writer: str = ""
    options: tuple[str, ...] = ()
    by_name: bool = False
    folder: bool = False
    tagged: bool = False
    numbered: bool = False
    whole: bool = False
    measurements: bool = True
    values: bool = True
    entries: str = ""
    timeless: str = ""
    ranges: bool = False

    @property
    def loads(self) -> bool:
        """Whether `nls.load` reads its files."""
        return bool(self.reader) and self.measurements and not self.folder

    @property
    def poses_alone(self) -> bool:
        """Whether its files hold poses and no measurements: commands read them, by their names."""
        return bool(self.reader) and not self.measurements

    def read(self, how: Reading, *source: Any) -> tuple[Any, Any, Any]:
        """Graph, values and report of bytes and a path, or of a path; errors of the reader."""
        taken = {name: value for name in self.options if (value := getattr(how, name)) is not None}
        graph, values, *_, report = _named(self.reader)(*source, **taken)
        return graph, values, report

    def written(self, path: Any, *contents: Any) -> tuple[bytes, list[str]]:
        """The bytes of a file of graph, values and report, and what they leave out; errors of the writer."""
        data, notes = _named(self.writer)(path, self.name, *contents)
        return data, notes


def _named(name: str) -> Any:
    """The function ``module:function``."""
    module, _, function = name.partition(":")
    return getattr(import_module(module), function)


def _begins(pattern: bytes, reason: str) -> Callable[[bytes], str]:
    """A test whether bytes begin with a pattern."""
    begins = re.compile(pattern).match
    return lambda data: reason if begins(data) else ""


def _names_poses(data: bytes) -> str:
    """Whether the first pose has a name behind its time."""
    first = POSE_LINE.search(data, 0, 1 << 16)
    name = first and POSE_NAME.fullmatch(first[1])
    return f"'{name[0].decode():.30}' after a time is the name of a pose" if name else ""


def _are_scans(folder: object) -> str:
    return "keyframes and scans" if _named("nls.missions.scans.folder:is_scan_mission")(folder) else ""


def _tagged(name: str, holds: str, section: str, *suffixes: str, **more: Any) -> Format:
    """A dialect of `nls.io.dialects`."""
    options = ("convention", "dialect", *SUBJECTS)
    functions = None, "nls.io.read:read_graph", "nls.io.write:graph_text"
    return Format(name, holds, section, suffixes, *functions, options, tagged=True, **more)


def _native(name: str, looks: Callable[[Any], str]) -> Format:
    functions = looks, "nls.io.native.native:read_native", "nls.io.native.native:native_bytes"
    return Format(name, "any graph with its values, to the bit", "native-files", (f".{name}",), *functions, whole=True)


def _estimate(name: str, holds: str, writer: str, reader: str = "") -> Format:
    """A file without measurements."""
    functions = None, reader, writer, ("convention",)
    return Format(name, holds, "trajectories", (f".{name}",), *functions, measurements=False)


def _mission(name: str, holds: str, reader: str) -> Format:
    return Format(name, holds, "mission-folders", reader=reader, options=("elevation",), folder=True)


FORMATS = {
    row.name: row
    for row in (
        _tagged("g2o", "pose graph, with points and sensor offsets", "g2o", ".g2o", numbered=True),
        _tagged("toro", "pose graph", "toro-and-isam", ".toro", ".graph", numbered=True, entries="information"),
        _tagged("isam", "measurements of a pose graph, with points", "toro-and-isam", ".isam", values=False),
        _tagged("isam-covariance", "measurements of a pose graph, with points", "toro-and-isam", values=False),
        _tagged("graph", "pose graph", "toro-and-isam", ".graph", numbered=True, entries="covariance"),
        Format("pyfg", "pose graph with ranges", "pyfactorgraph", (".pyfg",), _names_poses)._replace(
            reader="nls.io.pyfg:read_pyfg",
            writer="nls.io.pyfg:pyfg_text",
            options=("convention", "ignore_tags"),
            by_name=True,
            ranges=True,
        ),
        Format("bal", "cameras and points", "bundle-adjustment", (".bal",))._replace(
            looks=_begins(rb"\s*[0-9]+[ \t]+[0-9]+[ \t]+[0-9]+[ \t\r]*(?:\n|$)", "three counts on its first line"),
            reader="nls.io.bal:read_bal",
            writer="nls.io.bal:bal_text",
            timeless="is bundle adjustment (bal), whose cameras are in no order of time",
        ),
        _native("npz", _begins(rb"PK\x03\x04", "an archive of arrays")),
        _native("json", _begins(rb"\s*\{", "a JSON object")),
        _estimate("tum", "poses", "nls.io.trajectory:trajectory_text", "nls.io.trajectory:load_trajectory"),
        _estimate("kitti", "poses", "nls.io.trajectory:trajectory_text", "nls.io.trajectory:load_trajectory"),
        _estimate("csv", "positions; a table of all values", "nls.io.table:values_text"),
        _estimate("ply", "positions; a table of all values", "nls.missions.charts.writers:cloud_text"),
        _mission("scan mission", "mission with sonar scans", "nls.missions.scans.folder:read_scan_mission")._replace(
            section="scan-missions", looks=_are_scans, options=()
        ),
        _mission("mission", "mission of a vehicle with its sensors", "nls.missions.folder.read:read_mission"),
        _mission("dives", "mission of a vehicle with its sensors", "nls.missions.folder.dives:read_dives"),
    )
}


def dialects() -> tuple[str, ...]:
    """The names that `nls.load` takes as its dialect."""
    return ("auto", *(row.name for row in FORMATS.values() if row.loads))


def outputs() -> tuple[str, ...]:
    """The names that `nls.save` takes as its dialect."""
    return tuple(row.name for row in FORMATS.values() if row.writer)


DIALECTS = dialects()  # of the library itself


def suffix_of(path: object) -> str:
    """The ending of a name, without that of its compression.

    Examples
    --------
    >>> suffix_of("logs/survey.G2O.gz"), suffix_of("survey")
    ('.g2o', '')
    """
    return os.path.splitext(str(path).lower().removesuffix(".gz"))[1]


def suffixes() -> dict[str, Format]:
    """The format of every suffix that stands for one."""
    every = [(suffix, row) for row in FORMATS.values() for suffix in row.suffixes]
    names = [suffix for suffix, _ in every]
    return {suffix: row for suffix, row in every if names.count(suffix) == 1}


def by_content(data: bytes, path: str) -> tuple[Format | None, str]:
    """The format of bytes and why; None where the tags of `nls.io.dialects` are to tell."""
    files = [row for row in FORMATS.values() if (row.looks or row.by_name) and row.loads]
    for row in sorted(files, key=lambda row: not row.whole):  # pieces first, whatever their names
        if row.by_name and suffix_of(path) in row.suffixes:
            return row, "by its name"
        if row.looks and (reason := row.looks(data)):
            return row, reason
    return None, ""


def of_folder(folder: object) -> Format:
    """The kind of mission that a folder holds."""
    return next((row for row in FORMATS.values() if row.folder and row.looks and row.looks(folder)), FORMATS["mission"])


def check_dialect(name: str, allowed: Collection[str]) -> str:
    """The name itself when it is one of these.

    Raises
    ------
    OptionError
    """
    if not isinstance(name, str) or name not in allowed:
        raise _option_error("dialect", name, "one of " + ", ".join(allowed))
    return name


def format_of(path: object, named: str | None, how: str = "dialect=FORMAT", option: str = "output file") -> str:
    """The format of a file to write: the one that was named, else the one its suffix stands for.

    Raises
    ------
    OptionError
        A suffix that stands for none, or, as ``.graph``, for several.
    """
    if named is not None:
        return named
    suffix = suffix_of(path)
    if (row := suffixes().get(suffix)) is not None:
        return row.name
    rows = [row for row in FORMATS.values() if suffix in row.suffixes]
    several = " or ".join(row.name for row in rows) + ", " + " or ".join(row.entries for row in rows)
    more = f"; *{suffix} may be {several}" if rows else ""
    raise _option_error(option, str(path), f"a name ending in {', '.join(suffixes())}, or {how}{more}")


def refuse_needless(path: str, format: str, how: Reading, allowed: Iterable[str] = ()) -> None:
    """Refuse options about `SUBJECTS` that a format does not have, but for those allowed.

    Raises
    ------
    OptionError
    """
    for option, subject in SUBJECTS.items():
        if option not in allowed and (value := getattr(how, option)):
            needless = f"{type(value)()!r}: {path} is in the format {format}, which has no {subject}"
            raise _option_error(option, value, needless)


def check_renumber(form: str) -> None:
    """Refuse new numbers for a file that needs none.

    Raises
    ------
    OptionError
    """
    shared = [row.name for row in FORMATS.values() if row.numbered]
    if form not in shared:
        allowed = f"an output in one of the formats {', '.join(shared)}, whose vertices share one numbering"
        raise _option_error("renumber", form, f"{allowed}; leave it out")


def _option_error(*words: Any) -> Exception:
    from models.errors import OptionError

    return OptionError(*words)
