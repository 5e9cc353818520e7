"""Small valid files of every reader for `fuzz.py`, most of them from the tests, and what each reader makes of them."""

from __future__ import annotations

import gzip
import json
import re
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nls
from factors import Cauchy
from factors.base import Factor
from nls.io.native.data import json_of
from nls.io.native.structure import encoded
from nls.missions.folder.poses import read_poses
from nls.missions.importing import draft, import_logs, read_mapping

sys.path.append(str(Path(__file__).parents[2]))

from tests.nls.io.io_files import ALL
from tests.nls.missions.folder.mission_files import TINY, raw
from tests.nls.missions.scans.room_files import room

FOLDER = "mission_of_fuzz"
ROWS = 24  # of a table of a log


@dataclass
class Reading:
    """What was read.

    Attributes
    ----------
    whole : all of it, as text.
    measurements, variables : one text each; of logs the rows of the mission.
    fixed : names of variables that are held.
    report : of the reader; None where it has none.
    graph : and its values, where it is one.
    """

    whole: str
    measurements: Counter[str] = field(default_factory=Counter)
    variables: Counter[str] = field(default_factory=Counter)
    fixed: set[str] = field(default_factory=set)
    report: Any = None
    graph: tuple[nls.FactorGraph, nls.Values] | None = None


@dataclass(frozen=True)
class Seed:
    """A valid input.

    Attributes
    ----------
    reader : a row of the table.
    name : of the seed.
    files : content by name; one of them is changed in a mutant.
    read : the reader, of a folder with these files.
    form : of the files: tagged, bal, json, npz, poses, tables or logs, which tells how a reading is judged.
    """

    reader: str
    name: str
    files: dict[str, bytes]
    read: Callable[[Path], Reading]
    form: str
    dialect: str = "auto"

    def reading(self, folder: Path) -> Reading:
        """What is read in this folder, without its name."""
        read = self.read(folder)
        return replace(read, whole=read.whole.replace(str(folder), ""))


def plain(text: str) -> str:
    """A text of numbers, 0 without a sign."""
    return re.sub(r"-0\.0(?![0-9e])", "0.0", text)


def measured(factor: Factor) -> Iterator[str]:
    """The measurements of a factor, each as text."""
    for k in range(len(factor)):
        yield plain(json_of(encoded(factor[[k]])))


def graph_reading(loaded: tuple[nls.FactorGraph, nls.Values, Any]) -> Reading:
    """The reading of a graph, with its times and the truth of a mission."""
    graph, values, report = loaded
    variables = Counter(
        plain(f"{kind}{number} {stack.manifold} {X}")
        for kind, stack in values.stacks.items()
        for number, X in zip(stack.numbers.tolist(), stack.X.tolist(), strict=True)
    )
    fixed = {f"{key}" for keys in graph.fixed for key in keys}
    truth = getattr(report, "truth", None)
    stacks = truth.stacks.values() if isinstance(truth, nls.Values) else []
    beside = {
        "report": str(report),
        "unused": report.ignored,
        "warnings": report.warnings,
        "lines": [[source.path, source.lines.tolist()] for source in report.sources],
        "times": {kind: times.tolist() for kind, times in report.vertex_times.items()},
        "measured at": [times.tolist() for _, times in report.factor_times],
        "truth": [[stack.kind, stack.numbers.tolist(), stack.X.tolist()] for stack in stacks],
        "calibrations": sorted(getattr(report, "calibrations", {}).items()),
        "true keyframes": truth.poses.tolist() if hasattr(truth, "poses") else [],
        "plane": repr(getattr(report, "plane", None)),
        "drift": str(getattr(report, "drift", "")),
        "points": report.scans.points.tolist() if hasattr(report, "scans") else [],
    }
    measurements = Counter(text for factor in graph.factors for text in measured(factor))
    factors = [json_of(encoded(factor)) for factor in graph.factors]
    whole = json.dumps([sorted(variables.elements()), factors, sorted(fixed), beside])
    return Reading(whole, measurements, variables, fixed, report, (graph, values))


def graph_file(name: str, dialect: str) -> Callable[[Path], Reading]:
    return lambda folder: graph_reading(nls.load(folder / name, dialect=dialect))


def mission(folder: Path) -> Reading:
    return graph_reading(nls.load(folder))


def dives(folder: Path) -> Reading:
    return graph_reading(nls.load([folder / "dive_1", folder / "dive_2"]))


def poses(name: str) -> Callable[[Path], Reading]:
    """The reader of a trajectory: a pose is a variable."""

    def read(folder: Path) -> Reading:
        it = read_poses(folder / name)
        times, numbers, sigmas = ([] if a is None else a.tolist() for a in (it.times, it.numbers, it.sigmas))
        rows = Counter(str(X) for X in it.X.tolist())
        return Reading(json.dumps([it.X.tolist(), times, numbers, sigmas, it.oriented]), variables=rows)

    return read


def importing(*logs: str) -> Callable[[Path], Reading]:
    """The import of logs by a mapping: rows of the mission."""

    def read(folder: Path) -> Reading:
        it = import_logs([folder / log for log in logs], read_mapping(folder / "mapping.toml"))
        rows = Counter(
            f"{name} {row}"
            for name, text in it.files.items()
            if name.endswith(".csv")
            for row in text.decode().splitlines()[1:]
        )
        whole = json.dumps([{name: text.decode() for name, text in it.files.items() if name != "README.txt"}, it.notes])
        return Reading(whole, measurements=rows)

    return read


def drafting(folder: Path) -> Reading:
    return Reading(draft([folder / "log.csv"]))


GOOD_TUM = """# time x y z qx qy qz qw
0.5 0 0 1 0 0 0 1
1.5 1 0.25 1 0 0 0.19866933079506122 0.98006657784124163
2.5 2 -0.5 1.5 0.099833416646828155 0 0 0.99500416527802582
4 2.5 -0.75 2 0 0 0 1
"""
GOOD_KITTI = """1 0 0 0.5 0 1 0 0 0 0 1 2
0 -1 0 1.5 1 0 0 0.25 0 0 1 2
0 -1 0 2.5 1 0 0 0.75 0 0 1 2.5
"""
GOOD_POSES = """i,time_s,x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad,sigma_x_m,sigma_y_m,sigma_z_m
0,0.5,0,0,5,0,0,0,0.01,0.01,0.02
1,1.5,1,0.02,5.1,0.05,-0.03,0.05,0.02,0.015,0.02
3,2.5,2,0.08,5.25,-0.04,0.04,0.1,0.03,,0.02
"""
EXTRA = {  # tables beside those of TINY
    "closures": "i,j,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad,kernel\n"
    "0,3,1.44,0.03,0.1,0.05,0.05,0.02,cauchy:2\n1,3,0.93,0.1,0.05,0.05,0.05,0.02,huber:1\n",
    "fixes": "i,x_m,y_m,sigma_x_m,sigma_y_m,kernel\n1,0.6,0.1,0.5,0.5,huber:1.345\n3,1.4,0.2,0.5,0.5,none\n",
    "beacons": "beacon,x_m,y_m,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n3,12,-4,9,0.5,0.5,0.5\n5,-3,14,8,0.5,0.5,0.1\n",
    "ranges": "i,beacon,range_m,sigma_range_m\n0,3,13.3,0.1\n1,3,12.8,0.1\n2,5,14.7,0.1\n3,5,14.9,0.1\n",
    "origin": "lat_deg,lon_deg\n54.1,10.2\n",
    "poses": "i,time_s\n0,10\n1,11.5\n2,13\n3,14.25\n",
}
POSITIONED = {
    "fixes": "time_s,lat_deg,lon_deg,sigma_x_m,sigma_y_m\n0.5,54.1,10.2,1,1\n3.5,54.10002,10.20001,1,1\n",
    "origin": "lat_deg,lon_deg\n54.1,10.2\n",
    "calibration": "name,value,sigma\ndvl_scale,0.01,0.005\ndvl_yaw_rad,0.02,0.01\nahrs_clock_s,0,0\n"
    "fixes_clock_s,0.1,0.05\ndeclination_rad,0.03,0.01\n",
    "dvl_mount": "x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad\n0.3,0,0.1,0,0,0.1\n",
    "beacons": "beacon,lat_deg,lon_deg,z_m,sigma_x_m,sigma_y_m,sigma_z_m\n7,54.1001,10.2003,20,1,1,0.5\n",
    "ranges": "time_s,beacon,travel_time_s,sigma_travel_time_s,turn_around_s,ways,arm_x_m,arm_y_m,arm_z_m\n"
    "1,7,0.04,0.001,0.005,2,0.1,0,-0.2\n2.5,7,0.0405,0.001,0.005,2,0.1,0,-0.2\n",
    "sound-speed": "z_m,sound_speed_m_s\n0,1500\n10,1502\n30,1498\n",
    "usbl": "time_s,range_m,bearing_rad,elevation_rad,sigma_range_m,sigma_bearing_rad,sigma_elevation_rad,delay_s\n"
    "1.5,30,0.2,0.5,0.5,0.02,0.02,0.05\n4,31,0.22,0.48,0.5,0.02,0.02,0.05\n",
    "ship": "time_s,lat_deg,lon_deg,z_m,roll_rad,pitch_rad,yaw_rad\n"
    "-1,54.1,10.2004,0,0.01,0,1\n3,54.1,10.20041,0,0,0.01,1.01\n9,54.1,10.20042,0,0,0,1.02\n",
}
PATH = {
    "path": "time_s,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n"
    "0,0,0,0,0.05,0.05,0.01\n1,1,0,0.05,0.05,0.05,0.01\n2,2,0.1,0.1,0.05,0.05,0.01\n3.5,3.4,0.3,0.1,0.05,0.05,0.01\n",
    "truth": "time_s,roll_rad,pitch_rad,yaw_rad,x_m,y_m,z_m\n0,0,0,0,0,0,0\n2,0,0,0.1,2.1,0.1,0\n4,0,0,0.1,4,0.3,0\n",
    "fixes": "time_s,x_m,y_m,sigma_x_m,sigma_y_m\n0.5,0.6,0,0.5,0.5\n3,2.9,0.2,0.5,0.5\n",
}
LOG = """time;Heading [deg];pitch [deg];roll [deg];v fwd [cm/s];v stb [cm/s];v dn [cm/s];lock;depth (m)
2024-12-05T22:12:34.25Z;10;1;0.5;100;2;0;1;5
2024-12-05T22:12:34.75Z;11;1.5;0.25;101;3;1;1;5.25
2024-12-05T22:12:35.25Z;13;1;-0.5;-999;-999;-999;0;5.5
2024-12-05T22:12:35.75Z;12;0.5;0;103;1;-1;1;5.75
"""
MAPPING = """# a log of one vehicle
time_s = "time"

[dvl]
velocity = ["v fwd [cm/s]", "v stb [cm/s]", "v dn [cm/s]"]
valid = "lock"
missing = -999

[ahrs]
attitude = ["roll [deg]", "pitch [deg]", "Heading [deg]"]

[depth]
z_m = "depth (m)"

[noise]
sigma_v_m_s = 0.1
scale = 0.005
sigma_bridge_m_s_sqrt_s = 0.05
sigma_attitude = [0.002, 0.002, 0.005]
sigma_z_m = 0.05
"""
FIXES = "t,lat,lon,hdop,who\n" + "".join(f"{k}.5,54.10{k}1,10.2{k}02,1.{k},gps\n" for k in range(6))
FIXES_MAPPING = """[fixes]
time_s = { column = "t", offset = 2.0 }
lat_deg = "lat"
lon_deg = "lon"
sigma_x_m = { column = "hdop", scale = 2 }
sigma_y_m = 2.5
where = { column = "who", equals = "gps" }
[[beacons]]
beacon = 1
x_m = 5
y_m = -3
z_m = 20
sigma_position = [1, 1, 1]
[motion]
sigma_walk_m_sqrt_s = 0.3
"""
GYRO = {  # a heading from rates, a depth from pressure
    "noise": "sigma_v_m_s,scale,sigma_bridge_m_s_sqrt_s,sigma_roll_rad,sigma_pitch_rad,sigma_z_m,"
    "sigma_w_rad_s_sqrt_hz,sigma_bias_rad_s,sigma_bias_walk_rad_s_sqrt_s\n0.01,0.002,0.05,0.002,0.002,0.05,0.001,0.01,0.0001\n",
    "pressure": "time_s,pressure_pa\n-1,131325\n2,134000\n9,137000\n",
    "water": "density_kg_m3,atmosphere_pa\n1025,101000\n",
    "tide": "time_s,tide_m\n-5,0.5\n20,0.6\n",
    "gyro": "time_s,wx_rad_s,wy_rad_s,wz_rad_s\n" + "".join(f"{k / 4},0.001,-0.002,{0.01 * k}\n" for k in range(ROWS)),
}
SCANS = """[sonar]
azimuth = "right"
x_m = 0.3
yaw_rad = 0.1
[drift]
mean = 0.2
heading = false
"""


def tables(*parts: dict[str, str], **changed: str) -> dict[str, bytes]:
    """Files of a mission."""
    merged = {name: text for part in (*parts, changed) for name, text in part.items()}
    return {f"{FOLDER}/{name}.csv": text.encode() for name, text in merged.items()}


def inside(read: Callable[[Path], Reading]) -> Callable[[Path], Reading]:
    """The reader of the folder in a folder."""
    return lambda folder: read(folder / FOLDER)


def short(files: dict[str, str]) -> dict[str, str]:
    """The beginning of logs."""
    return {name: "\n".join(text.splitlines()[:ROWS]) + "\n" for name, text in files.items()}


def native(form: str, text: str, dialect: str) -> bytes:
    """A graph as a native file."""
    with TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", nls.GraphWarning)
        file = Path(name, "graph.g2o")
        file.write_text(text)
        graph, values, report = nls.load(file, dialect=dialect)
        if dialect == "g2o":
            graph.factors[0] = graph.factors[0].robust(Cauchy(2.0))
        nls.save(Path(name, f"graph.{form}"), graph, values, report)
        return Path(name, f"graph.{form}").read_bytes()


def seeds() -> list[Seed]:
    """All of them, in the order of the readers."""
    out = []
    for name, (dialect, text) in ALL.items():
        file = f"seed.{dialect if dialect in ('pyfg', 'bal') else 'txt'}"
        form = "bal" if dialect == "bal" else "tagged"
        out.append(Seed(dialect, name, {file: text.encode()}, graph_file(file, dialect), form, dialect))
    some = {name: ALL[name] for name in ("poses of the plane", "every tag of space", "pyfg", "bal")}
    for form in ("json", "npz"):
        for name, (dialect, text) in some.items():
            file = f"seed.{form}"
            out.append(Seed(form, name, {file: native(form, text, dialect)}, graph_file(file, "auto"), form))
    for name in ("every tag of the plane", "isam, space"):
        packed = gzip.compress(ALL[name][1].encode(), mtime=0)
        out.append(Seed("gzip", name, {"seed.gz": packed}, graph_file("seed.gz", ALL[name][0]), "tagged", ALL[name][0]))
    packed = gzip.compress(native("json", *some["pyfg"][::-1]), mtime=0)
    out.append(Seed("gzip", "json", {"seed.json.gz": packed}, graph_file("seed.json.gz", "auto"), "json"))
    for form, text in (("tum", GOOD_TUM), ("kitti", GOOD_KITTI), ("csv", GOOD_POSES)):
        name = f"seed.{form}"
        out.append(Seed(f"poses, {form}", form, {name: text.encode()}, poses(name), "poses", form))
    log = short(raw())
    missions = {
        "odometry and sonar": tables(TINY),
        "with positions": tables(TINY, EXTRA),
        "a log": tables(log),
        "a log with positions": tables(log, POSITIONED),
        "a log with pressure and gyro": tables(
            {name: text for name, text in log.items() if name != "depth"},
            {"ahrs": "".join(line.rpartition(",")[0] + "\n" for line in log["ahrs"].splitlines())},
            GYRO,
        ),
        "contacts without names": tables(
            {name: text for name, text in TINY.items() if name != "landmarks"},
            {"contacts": "".join(re.sub("^(.*?),.*?,", r"\1,", row) + "\n" for row in TINY["contacts"].splitlines())},
        ),
        "a path": tables(PATH),
        "packed": {
            f"{name}.gz" if "contacts" in name else name: gzip.compress(text, mtime=0) if "contacts" in name else text
            for name, text in tables(TINY).items()
        },
    }
    out += [Seed("mission", name, files, inside(mission), "tables") for name, files in missions.items()]
    scans = {
        f"{FOLDER}/{name}.csv": b"".join(text.splitlines(keepends=True)[: 4 * ROWS])
        for name, text in room(laps=1).items()
    }
    scans[f"{FOLDER}/mission.toml"] = SCANS.encode()
    out.append(Seed("scan mission", "a room", scans, inside(mission), "tables"))
    two = {f"dive_{k}/{name}.csv": text.encode() for k in (1, 2) for name, text in TINY.items()}
    two["dive_1/dive_closures.csv"] = (
        b"i,dive,j,x_m,y_m,yaw_rad,sigma_x_m,sigma_y_m,sigma_yaw_rad\n1,dive_2,2,0.5,0,0,0.1,0.1,0.05\n"
    )
    out.append(Seed("dives", "two", two, dives, "tables"))
    for name, mapping, text in (("a log", MAPPING, LOG), ("fixes", FIXES_MAPPING, FIXES)):
        files = {"mapping.toml": mapping.encode(), "log.csv": text.encode()}
        out.append(Seed("import", name, files, importing("log.csv"), "logs"))
        out.append(Seed("import, draft", name, {"log.csv": text.encode()}, drafting, "draft"))
    return out


READERS = (
    *("g2o", "toro", "isam", "isam-covariance", "graph", "pyfg", "bal", "json", "npz", "gzip"),
    *("poses, tum", "poses, kitti", "poses, csv", "mission", "scan mission", "dives", "import", "import, draft"),
)
