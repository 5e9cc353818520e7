"""Every mistake of a command: one line before the work, nothing written, and what a terminal would obey is escaped."""

from __future__ import annotations

import json
import os
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
from tests.nls.cli.shell import RAY, SPOILED, Shell
from tests.nls.io.g2o_files import INFORMATION_2, PLANE
from tests.nls.io.io_files import PYFG
from tests.nls.missions.folder.mission_files import TINY, folder, raw
from tests.nls.missions.scans import room_files
from tests.nls.missions.scans.test_folder import FILES as SCANS

FILES = {
    "graph.g2o": PLANE,
    "wrong.g2o": PLANE + "EDGE_SE2 0 1 1\n",
    "negative.g2o": PLANE + "EDGE_SE2 1 3 0 2 3 500 0 0 400 0 -3\n",
    "pose.g2o": "VERTEX_SE2 0 0 0 0\n",
    "fixed.g2o": PLANE + "FIX 1\n",
    "square.g2o": PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n",
    "ray.g2o": PLANE + RAY,
    "a.pyfg": PYFG,
    "names.pyfg": PYFG.replace("A0", "AUV0").replace("A1", "ROV1"),
    "t.tum": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n",
    "huge.g2o": "\nEDGE_SE2 0 1 1.5 0 0 1e300 0 0 100 0 100\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 100\n",
    "log.csv": "a,b\n1,2\n",
    "a log.csv": "a,b\n1,2\n",
    "semi.csv": "a;b\n1;2\n",
    "tab.csv": "a\tb\n1\t2\n",
    "blank.csv": "0 1 2 3.5\n1 2 3 4.5\n",
    "logs/log.csv": "a,b\n1,2\n",
    "alone/survey.g2o": PLANE,
}
REFUSED = r"""
slove graph.g2o => ; did you mean 'solve'\?
solve graph.g2o --certfy => ; did you mean '--certify'\?
solve => the following arguments are required: FILE; see 'nls solve --help'$
stream {|graph.g2o} {--foo|--bar=3} => ^nls: unrecognized arguments: (--foo|--bar=3); see 'nls stream --help'$
solve {|graph.g2o} --robst dcs => arguments: --robst.*; did you mean '--robust'\?; see 'nls solve --help'$
info graph.g2o other.g2o => unrecognized arguments: other.g2o; see 'nls info --help'$
--foo => unrecognized arguments: --foo; see 'nls --help'$
solve square.g2o --robust gnc => ; did you mean 'gnc-tls'\?$
{solve|explain} huge.g2o => ^nls: huge.g2o:2: Between\(x0, x1\): its measurement .* too many for a chi2
solve graph.g2o {--init|--linear-solver|--convention|--gauge|--method|--dialect} zzz => invalid choice: 'zzz' [^;]*; see
solve graph.g2o --max-iterations -1 => --max-iterations: -1 is not possible
stream graph.g2o --lag {-1|0} => --lag: (-1|0) is not possible; expected a whole number of poses of at least 1$
{solve|explain|info} graph.g2o {--json ''|--json alone} => --json: '(|alone)' is not possible; expected
solve graph.g2o {-o|--covariance|--plot|--report} '' => (-o|--covariance|--plot|--report): '' is not possible
solve graph.g2o --covariance {c.xlsx|c|c.zip} => --covariance: 'c.*' is not possible; expected a file name ending in
{plot|convert} graph.g2o '' => ^nls: OUT: '' is not possible
stream m => m: is a folder; expected a file or a pipe: nls convert m m.npz writes one$
stream graph.g2o --checkpoint '' => --checkpoint: '' is not possible
solve graph.g2o --quiet --verbose => not allowed with argument
{solve|explain} graph.g2o --hold q => --hold: 'q' is not possible; expected one of the kinds x

{solve|info|explain} none.g2o => ^nls: none.g2o: cannot be read: No such file or directory; its folder has .*\.g2o
{solve|info|explain|stream} grahp.g2o => ^nls: grahp.g2o: cannot be read: .*; did you mean 'graph.g2o'\?$
{solve alnoe|solve graph.g2o alnoe|import alnoe} => ^nls: alnoe: cannot be read: .*; did you mean 'alone'\?$
import alone => ^nls: alone: is a folder .*; give its files: nls import alone/\*$
info 'a log.csv' => -> make a mission of a log: nls import 'a log.csv' prints
import log.csv --map mapping.toml => ^nls: -o is missing; expected a folder for the mission: -o mission$
import log.csv -o mission => --map is missing beside -o; a draft of a mapping: nls import LOG > mapping.toml
import log.csv --map alone/mapping.toml -o m => mapping.toml: cannot be read: No such file or directory$
{solve|info} wrong.g2o => wrong.g2o:9: 3 numbers after the tag, expected 11
{solve|info} negative.g2o => negative eigenvalue.* \[EDGE_SE2 1 3(.|\n)*-> .*: --repair-information$
{solve pose.g2o|explain t.tum} => (pose.g2o|t.tum): has no measurement: nothing to optimize; add edges
info {a.pyfg|t.tum} --repair-information => --repair-information: True is not .* (a.pyfg|t.tum) is in the format
{solve|explain|info|stream} graph.g2o --ignore-tags EDGE_SE2 => --ignore-tags: 'EDGE_SE2' is not .* tags that are not re
{info t.tum|explain m} {--drop-absent|--ignore-tags EDGE_X} => --(drop-absent|ignore-tags): .* has no (tags|vertices)
stream graph.g2o --drop-absent => unrecognized arguments: --drop-absent
solve alone => is a folder, but no mission: (.|\n)*-> read the file in it: .*alone/survey.g2o$
solve {log|semi|tab|blank}.csv => -> make a mission of a log: nls import .* prints a mapping(.|\n)*nls new FOLDER
solve logs => nls import logs/log.csv prints a mapping
solve columns => unknown column 'vel_x_m_s'; expected time_s.*did you mean 'vx_m_s'(.|\n)*.dvl. vx_m_s = "vel_x_m_s"
solve log.csv => -> give the folder, if the table belongs to a mission

solve graph.g2o {-o|--json|--covariance|--plot|--report} nowhere/a => 'nowhere/a' .* a file in a folder that exists
{info graph.g2o --json|explain graph.g2o --json|convert a.pyfg} nowhere/out.tum => a file in a folder that exists
solve graph.g2o {-o|--json|--plot} alone => 'alone' .* this is a folder
{plot graph.g2o|solve graph.g2o --plot} out.xyz => a file name ending in \.png, \.pdf, \.svg
solve graph.g2o --report page.pdf => --report: 'page.pdf' .* a file name ending in \.html, \.htm
solve graph.g2o {-o|--covariance|--plot} - => '-' is not possible; .* only --json writes to standard output
solve graph.g2o -o out.isam => such as g2o: isam files hold measurements only
{convert graph.g2o|solve graph.g2o -o} out.graph => or --to FORMAT; \*\.graph may be toro or graph
{solve|explain} graph.g2o --json graph.g2o => another name: this is the input
solve graph.g2o {--covariance graph.g2o|--json hard.png|--plot soft.png} => another name: this is the input
{plot graph.g2o hard.png|plot graph.g2o soft.png|stream graph.g2o --checkpoint graph.g2o} => another name: this is the i
solve graph.g2o {-o out.g2o --json out.g2o|-o out.g2o --covariance ./link.csv} => another output has this one
solve graph.g2o {--plot a.png --json alone/../a.png|--report a.html --json a.html} => another output has this one

solve a.pyfg -o out.g2o => cannot be written to a g2o file; poses A are written as x, points L as l
{convert fixed.g2o|solve fixed.g2o -o} out.pyfg => x1 is fixed, and a PyFactorGraph file has no line for that
convert names.pyfg out.g2o => or kinds of one or two letters, or let `nls convert` rename one kind of poses

{solve|explain} square.g2o --robust {magic:1|none} => one of huber, cauchy, .*, dcs; or none, of a mission: all c
solve square.g2o --robust {magic:1|none} => or gnc-tls\[:PROBABILITY\] or gnc-gm\[:PROBABILITY\]$
{solve|explain|stream} square.g2o --robust {huber:-1|huber:0|cauchy:nan|''} => --robust: '.*' is not possible; expected
solve square.g2o --robust huber:1 --robust cauchy:1 => --robust is given twice; expected one
solve square.g2o --robust Betwen=huber => ; did you mean 'Between'\?
solve square.g2o --robust {gnc|gnc-tsl|Between=gnc-tls} => gnc-tls\[:PROBABILITY\] or gnc-gm
solve square.g2o --robust gnc-tls:{2|x|} => such as gnc-tls:0\.99
solve square.g2o --robust gnc-tls --init chordal => begins with odometry
explain square.g2o --robust gnc-tls => one of huber, .*; nls solve has gnc-tls and gnc-gm
solve graph.g2o --certify -o out.g2o {--robust huber:1|--hold x} => ^nls: certify: .
solve graph.g2o --improve --sigmas estimate => expected stated with --improve
solve square.g2o --sigmas estimate {--robust gnc-tls|-o square.g2o} => (which rejects by|replaces) the stated sigmas
solve ray.g2o {--certify|--improve} => ^nls: ray.g2o:10: certify: Bearing\(x0, l20\)

solve m -o m => -o: 'm' is not possible; expected another folder than that of the mission
solve m -o {m/zpr.csv|m/zpr.csv/in|-|''} => -o: '.*' is not possible; expected a folder
solve m -o out.g2o => a folder: the solution of a mission is several files
solve m --to g2o => --to: 'g2o' is not possible; expected nothing
solve m --repair-information => the format mission, which has no information matrices
solve m --robust {Nothing|}=cauchy:1 => no type, or one of those in the graph: XYH, ZPR, Pos
{solve m --covariance|solve m --json|info m --json|explain m --json} m/zpr.csv => another name: this is the input
convert m a.g2o => a.g2o: a mission cannot be written as g2o, .*; npz and json hold it, and tum or kitti its poses$

solve scans --robust {huber:1|gnc-tls} => is not possible; expected for a scan mission one of gnc, cauchy, none
solve scans --sigmas estimate => --sigmas: 'estimate' is not possible; expected nothing
solve scans --elevation prior => a scan mission is of the plane
solve scans --init odometry => a scan mission starts from dead reckoning
solve scans --method dogleg => a scan mission chooses its own in each round
solve scans --hold x => a scan mission has only its keyframes and their drift
solve scans --certify => the drifts of a scan mission are no poses
solve scans --crs utm -o out => a scan mission has coordinates of its own
solve scans -o out.g2o => a folder: the solution of a mission is several files
solve scans m => a scan mission is solved alone
explain scans => nls solve scans -o OUT, then nls explain OUT/graph.npz
convert scans m.g2o => m.g2o
"""


def alternatives(words: str) -> list[str]:
    """``a {b|c}`` are ``a b`` and ``a c``."""
    before, brace, rest = words.partition("{")
    if not brace:
        return [words]
    choices, _, after = rest.partition("}")
    return [before + choice + end for choice in choices.split("|") for end in alternatives(after)]


def test_mistakes(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    (shell / "alone").mkdir()
    (shell / "logs").mkdir()
    for name, text in FILES.items():
        shell.file(text, name)
    os.link(shell / "graph.g2o", shell / "hard.png")
    (shell / "soft.png").symlink_to(shell / "graph.g2o")
    (shell / "link.csv").symlink_to(shell / "out.g2o")
    folder(shell / "m")
    room_files.write(shell / "scans", SCANS)
    folder(shell / "columns", raw(), dvl="time_s,vel_x_m_s,vy_m_s,vz_m_s,valid\n0,1,1,1,1.0\n")
    monkeypatch.setattr(nls.FactorGraph, "optimize", None)  # nothing is solved
    wrong = {}
    table = (line.split(" => ") for line in REFUSED.splitlines() if line)
    for words, pattern in ((words, pattern) for line, pattern in table for words in alternatives(line)):
        try:
            err = shell.refused(words)
        except AssertionError as error:
            wrong[words] = str(error)
        else:
            if not re.search(pattern, err.rstrip("\n")):
                wrong[words] = err
    assert wrong == {}


def test_a_folder_nobody_may_look_into(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sentence, no number of the operating system."""
    stat, closed = os.stat, f"{shell / 'closed'}{os.sep}"
    shell.file()

    def refusing(path: object, *_: object, **options: bool) -> os.stat_result:
        if str(path).startswith(closed):
            raise PermissionError(13, "Permission denied", path)
        return stat(path, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "stat", refusing)
    for option in ("-o", "--report", "--json"):
        err = shell.refused(f"solve graph.g2o {option} {closed}in/out.html")
        assert "a file in a folder that exists, and that you may look into" in err
        assert "Errno" not in err
    assert main(["solve", f"{closed}in.g2o"]) == 2
    assert "Errno" not in shell.capsys.readouterr().err


def test_special_files_take_several_outputs(shell: Shell) -> None:
    assert shell(f"solve {shell.file()} --quiet --covariance /dev/null --json /dev/null") == ""


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
