"""What a terminal would obey, in files, names and options, reaches neither it nor a file for people: it is escaped."""

from __future__ import annotations

import json
import re
import shlex
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import nls
import nls.cli
from models.visible import visible
from nls.cli import main
from sim.cli import main as sim
from tests.nls.cli.shell import SPOILED, Shell
from tests.nls.io.g2o_files import PLANE
from tests.nls.missions.folder.mission_files import TINY, folder, raw

HOSTILE = "\x1b]0;pwned\x07\x7f\x9b2J\u202egpj\u2066"
SHOWN = r"\x1b]0;pwned\x07\x7f\x9b2J\u202egpj\u2066"
RAW = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
FOR_PEOPLE = {".html", ".svg", ".kml", ".geojson", ".txt"}


def checked(shell: Shell, words: list[str], run: Callable[[list[str]], int] = main) -> str:
    """All that a command prints and writes for people; its status does not matter, an internal error does."""
    shell.capsys.readouterr()
    run(words)
    printed = "".join(shell.capsys.readouterr())
    assert "internal error" not in printed
    written = [path.read_text() for path in shell.folder.rglob("*") if path.suffix in FOR_PEOPLE and path.is_file()]
    for text in (printed, *written):
        assert not (found := RAW.search(text)), (words, text[max(found.start() - 60, 0) : found.start() + 60])
    return printed


def solve(file: str) -> list[str]:
    return ["solve", file, "-o", "out.g2o", "--plot", "p.svg", "--report", "r.html", "--json", "-"]


GRAPHS = {
    "tag.g2o": PLANE + f"TAG_{HOSTILE} 1 2\n",
    "line.g2o": PLANE + f"VERTEX_SE2 77 {HOSTILE}\n",
    "kind.json": json.dumps({"format": "leadline graph", "version": 1, "fixed": {}, "factors": {},
                             "values": {HOSTILE: {"space": "SE2", "numbers": [0], "X": [[0, 0, 0]]}}}),
    f"{HOSTILE}.g2o": PLANE,
    f"{HOSTILE}lost.g2o": None,
    "poses.csv": f"i,x_m,y_m,{HOSTILE}\n0,1,{HOSTILE},3\n",
}  # fmt: skip


@pytest.mark.parametrize("name", GRAPHS)
@pytest.mark.filterwarnings("default")
def test_of_a_graph_file(shell: Shell, name: str) -> None:
    if (text := GRAPHS[name]) is not None:
        (shell / name).write_text(text)
    file = name if name.startswith(("\x1b", "poses")) else f"{HOSTILE}-{name}"
    if file != name:
        (shell / name).rename(shell / file)
    printed = checked(shell, solve(file))
    for command in (["info", file], ["info", file, "--json", "-"], ["explain", file], ["convert", file, "o.json"]):
        checked(shell, command)
    checked(shell, ["plot", file, f"{HOSTILE}.svg"])
    checked(shell, ["evaluate", file, file])
    assert (
        SHOWN in printed or json.dumps(HOSTILE)[1:-1].encode().decode("unicode_escape") in json.loads(printed)["input"]
    )
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        try:
            print(nls.load(file)[2])
        except nls.LeadlineError as error:
            print(error)
    assert not any(RAW.search(str(warning.message)) for warning in given)
    out = shell.capsys.readouterr().out
    assert not RAW.search(out)
    assert SHOWN in out


def test_of_a_wrong_closure(shell: Shell) -> None:
    (shell / f"{HOSTILE}.g2o").write_text(SPOILED)
    file = shlex.quote(f"{HOSTILE}.g2o")
    assert SHOWN in checked(shell, shlex.split(f"solve {file} --robust gnc-tls --report r.html"))
    assert SHOWN in checked(shell, shlex.split(f"solve {file} --max-iterations 1 --init file"))
    assert SHOWN in (shell / "r.html").read_text()


@pytest.mark.filterwarnings("default")
def test_of_a_mission(shell: Shell) -> None:
    sonar = TINY["sonar"].replace("DIDSON", f"DIDSON{HOSTILE}")
    mission = folder(shell / f"m{HOSTILE}", sonar=sonar)
    words = ["solve", mission.name, "--report", "r.html", "--plot", "p.svg", "--allow-doubtful"]
    assert SHOWN in checked(shell, words)
    assert SHOWN in (shell / "r.html").read_text()
    files = {**raw(), "origin": "lat_deg,lon_deg\n54.0,10.0\n"}
    placed = folder(shell / f"p{HOSTILE}", files)
    checked(shell, ["solve", placed.name, "-o", "placed", "--plot", "q.svg"])
    assert SHOWN in (shell / "placed" / "track.kml").read_text()
    damaged = folder(shell / "d", raw(), poses=f"i,time_s\n{HOSTILE},1\n")
    assert SHOWN in checked(shell, ["solve", damaged.name, "-o", "x"])
    dives = folder(shell / "a"), folder(shell / f"b{HOSTILE}", closures=f"dive,i,j\n{HOSTILE},0,0\n")
    checked(shell, ["solve", *(dive.name for dive in dives)])


LOG = f"t [s];depth [m]{HOSTILE};note\n0;250;{HOSTILE}\n1;260;b\n"


@pytest.mark.parametrize(
    "mapping",
    [
        f'[depth]\ntime_s = "t [s]"\nz_m = {{ column = "{visible(HOSTILE)}", unit = "m" }}\n',
        f'["{HOSTILE[9:]}"]\ntime_s = "t [s]"\n',
        f"[depth]\ntime_s = {{ row = 0 }}\nz_m = 3\n# {HOSTILE[9:]}\n",
    ],
)
def test_of_a_log_and_its_mapping(shell: Shell, mapping: str) -> None:
    name = f"{HOSTILE}.csv"
    (shell / name).write_text(LOG)
    (shell / f"{HOSTILE}.toml").write_text(mapping)
    checked(shell, ["import", name])
    checked(shell, ["import", name, "--map", f"{HOSTILE}.toml", "-o", f"o{HOSTILE}"])


def test_a_draft_names_a_column_of_controls_so_that_it_is_found(shell: Shell) -> None:
    column = "depth\x9b\u202e\x7f"
    (shell / "log.csv").write_text(f"t [s],{column}\n0,1\n1,2\n")
    draft, _ = shell.both("import log.csv")
    assert not RAW.search(draft)
    (shell / "mapping.toml").write_text(draft.split("[noise]")[0])
    shell("import log.csv --map mapping.toml -o mission")
    assert (shell / "mission" / "depth.csv").read_text() == "time_s,z_m\n0.0,1.0\n1.0,2.0\n"


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (main, ["solve", "a.g2o", f"--{HOSTILE}"]),
        (main, ["solve", "a.g2o", "--robust", HOSTILE]),
        (main, ["new", f"n{HOSTILE}"]),
        (sim, ["ring", f"--{HOSTILE}"]),
        (sim, ["ring", "--laps", "1", "--per-lap", "4", "--out", f"s{HOSTILE}"]),
    ],
)
def test_of_options(shell: Shell, run: Callable[[list[str]], int], words: list[str]) -> None:
    (shell / "a.g2o").write_text(PLANE)
    try:
        printed = checked(shell, words, run)
    except SystemExit:
        printed = "".join(shell.capsys.readouterr())
    assert not RAW.search(printed)
    assert SHOWN in printed or repr(HOSTILE)[1:-1] in printed


def test_a_file_name_that_is_no_text(shell: Shell) -> None:
    Path(b"a\xff\x1b.g2o".decode("utf-8", "surrogateescape")).write_text(PLANE)
    name = next(shell.folder.iterdir()).name
    printed = checked(shell, ["solve", name, "--report", "r.html", "--plot", "p.svg"])
    assert r"a\udcff\x1b.g2o" in printed
    assert r"a\udcff\x1b.g2o" in (shell / "r.html").read_text()


def test_the_command_line_prints_in_one_place() -> None:
    cli = Path(nls.cli.__file__).parent
    printing = {file.name for file in cli.glob("*.py") if re.search(r"(?<![\w.`])print\(", file.read_text())}
    assert printing == {"outputs.py", "phase.py", "stream.py", "__init__.py"}  # reports in ASCII, versions, Ctrl-C
