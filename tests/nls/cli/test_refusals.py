"""Every mistake of a command: status 2 and one line that names it, before the work, with nothing written."""

from __future__ import annotations

import os
import re

import pytest

import nls
from nls.cli import main
from tests.nls.cli.shell import RAY, Shell
from tests.nls.io.g2o_files import INFORMATION_2, PLANE
from tests.nls.io.io_files import PYFG
from tests.nls.missions.folder.mission_files import TINY, folder

FILES = {
    "graph.g2o": PLANE,
    "wrong.g2o": PLANE + "EDGE_SE2 0 1 1\n",
    "nan.g2o": PLANE.replace("EDGE_SE2 1 2 1.01", "EDGE_SE2 1 2 nan"),
    "negative.g2o": PLANE + "EDGE_SE2 1 3 0 2 3 500 0 0 400 0 -3\n",
    "edge.g2o": PLANE + "EDGE_A,B 1 2\n",
    "absent.g2o": PLANE + f"EDGE_SE2 3 77 1 0 0 {INFORMATION_2}\n",
    "pose.g2o": "VERTEX_SE2 0 0 0 0\n",
    "fixed.g2o": PLANE + "FIX 1\n",
    "chain.g2o": "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n",
    "square.g2o": PLANE + f"EDGE_SE2 1 3 5 5 0 {INFORMATION_2}\n",
    "ray.g2o": PLANE + RAY,
    "lines.txt": "".join(f"EDGE2 {k} {k + 1} 1 0 0.1 100 0 50 200 0 0\n" for k in range(3)),
    "a.pyfg": PYFG,
    "kinds.pyfg": PYFG.replace("A1", "B1"),
    "names.pyfg": PYFG.replace("A0", "AUV0").replace("A1", "ROV1"),
    "t.tum": "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n",
    "bad": "0 1 2 3 0 0 0 2\n",
    "empty": "",
    "huge.g2o": "\nEDGE_SE2 0 1 1.5 0 0 1e300 0 0 100 0 100\nEDGE_SE2 1 2 1 0 0 100 0 0 100 0 100\n",
    "b.bal": "1 1 1\n0 0 10.5 -3\n0 0 0 0 0 0 500 0 0\n0.1 0.2 -5\n",
    "log.csv": "a,b\n1,2\n",
    "a log.csv": "a,b\n1,2\n",
    "clock.csv": "when,d\n01.06.2025 08:00:00,3\n",
    "clock.toml": '[depth]\ntime_s = "when"\nz_m = "d"\n',
    "alone/survey.g2o": PLANE,
}
REFUSED = r"""
frobnicate => invalid choice: 'frobnicate'
slove graph.g2o => ; did you mean 'solve'\?
solve graph.g2o --frobnicate => unrecognized arguments: --frobnicate
solve graph.g2o --certfy => ; did you mean '--certify'\?
explain graph.g2o --certfy => unrecognized arguments: --certfy; see 'nls explain --help'$
solve => the following arguments are required: FILE; see 'nls solve --help'$
stream {|graph.g2o} {--foo|--bar=3} => ^nls: unrecognized arguments: (--foo|--bar=3); see 'nls stream --help'$
solve {|graph.g2o} --robst dcs => arguments: --robst.*; did you mean '--robust'\?; see 'nls solve --help'$
info graph.g2o other.g2o => unrecognized arguments: other.g2o; see 'nls info --help'$
--foo => unrecognized arguments: --foo; see 'nls --help'$
solve square.g2o --robust gnc => ; did you mean 'gnc-tls'\?$
{solve|explain} huge.g2o => ^nls: huge.g2o:2: Between\(x0, x1\): its measurement .* too many for a chi2
solve graph.g2o {--init|--linear-solver|--convention|--gauge|--method|--dialect} zzz => invalid choice: 'zzz' [^;]*; see
explain graph.g2o --init nothing => invalid choice: 'nothing'
solve graph.g2o --gauge frist => ; did you mean 'first'\?
solve graph.g2o --method gauss => ; did you mean 'gauss-newton'\?
solve graph.g2o --max-iterations many => invalid int value: 'many'
solve graph.g2o --max-iterations -1 => --max-iterations: -1 is not possible
solve graph.g2o {--update-tol|--chi2-rtol} {nan|-1|inf} => --(update-tol|chi2-rtol): (nan|-1.0|inf) is not possible
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
import clock.csv --map clock.toml -o out => clock.csv:2: .* is no time of ISO 8601; write `time_format = "%m.%d.%Y
{import alone|import alone --map clock.toml -o out} => ^nls: alone: is a folder .*; give its files: nls import alone/\*$
info 'a log.csv' => -> make a mission of a log: nls import 'a log.csv' prints
import log.csv --map alone/mapping.toml -o m => mapping.toml: cannot be read: No such file or directory$
import log.csv --map nowhere/mapping.toml -o m => cannot be read: .*; there is no folder 'nowhere'$
plot none.g2o out.png => none.g2o: cannot be read
{solve|info} wrong.g2o => wrong.g2o:9: 3 numbers after the tag, expected 11
explain nan.g2o => nan.g2o:6: .*nan
{solve|info} negative.g2o => negative eigenvalue.* \[EDGE_SE2 1 3(.|\n)*-> .*: --repair-information$
{solve pose.g2o|explain t.tum} => (pose.g2o|t.tum): has no measurement: nothing to optimize; add edges
{solve|info} lines.txt => name the dialect
info {a.pyfg|t.tum} --repair-information => --repair-information: True is not .* (a.pyfg|t.tum) is in the format
solve graph.g2o --elevation free => no folder of a mission
{solve|explain|info|stream} edge.g2o => ^nls: edge.g2o:9: .* EDGE_A,B (.|\n)*-> leave .*: --ignore-tags EDGE_A,B$
{solve|explain|info|stream} edge.g2o --ignore-tags EDGE_SE2 => --ignore-tags: 'EDGE_SE2' is not .* tags that are not re
{solve|explain|info} absent.g2o => absent.g2o:9: .* vertex 77, (.|\n)*-> leave such edges out: --drop-absent$
{info t.tum|explain m} {--drop-absent|--ignore-tags EDGE_X} => --(drop-absent|ignore-tags): .* has no (tags|vertices)
stream graph.g2o --drop-absent => unrecognized arguments: --drop-absent
solve alone => is a folder, but no mission: (.|\n)*-> read the file in it: .*alone/survey.g2o$
solve log.csv => -> give the folder, if the table belongs to a mission

solve graph.g2o {-o|--json|--covariance} nowhere/out.g2o => 'nowhere/out.g2o' .* a file in a folder that exists
solve graph.g2o {--plot nowhere/out.png|--report nowhere/out.html} => a file in a folder that exists
{info|explain} graph.g2o --json nowhere/out.json => nowhere/out.json
convert a.pyfg nowhere/out.tum => a file in a folder that exists
solve graph.g2o {-o|--json|--plot} alone => 'alone' .* this is a folder
{plot graph.g2o|solve graph.g2o --plot} out.xyz => a file name ending in \.png, \.pdf, \.svg
solve graph.g2o --report page.pdf => --report: 'page.pdf' .* a file name ending in \.html, \.htm
solve graph.g2o {-o|--covariance|--plot} - => '-' is not possible; .* only --json writes to standard output
{convert graph.g2o|solve graph.g2o -o} '' => '' is not possible; expected the name of a file
solve graph.g2o -o out.isam => such as g2o: isam files hold measurements only
{convert graph.g2o|solve graph.g2o -o} out.graph => or --to FORMAT; \*\.graph may be toro or graph
{convert graph.g2o|solve graph.g2o -o} out.kity => \.toro, \.isam, \.pyfg, \.bal, \.npz, .*\.csv, \.ply, or --to FORMAT
{solve|explain} graph.g2o --json graph.g2o => another name: this is the input
solve graph.g2o {--covariance graph.g2o|--json hard.png|--plot soft.png} => another name: this is the input
plot graph.g2o {hard|soft}.png => another name: this is the input
solve graph.g2o {-o out.g2o --json out.g2o|-o out.g2o --covariance ./link.csv} => another output has this one
solve graph.g2o {--plot a.png --json alone/../a.png|--report a.html --json a.html} => another output has this one

convert graph.g2o out.bal => Between\(.*cannot be written to a bundle-adjustment file
solve a.pyfg -o out.bal => Between\(A0, A1\) cannot be written to a bundle-adjustment file
solve a.pyfg -o out.g2o => cannot be written to a g2o file; poses A are written as x, points L as l
{convert fixed.g2o|solve fixed.g2o -o} out.pyfg => x1 is held fixed, which a PyFactorGraph file has no line for
convert b.bal out.g2o => out.g2o: .
convert b.bal out.pyfg => variables c in .wx.* have no line in a PyFactorGraph file
convert {b.bal|kinds.pyfg} out.tum => poses of one kind, this graph has (none|A, B)
convert kinds.pyfg out.g2o => Range.A0, L3. cannot be written to a g2o file
convert names.pyfg out.g2o => or kinds of one or two letters, or let `nls convert` rename one kind of poses
convert empty out.tum => empty:1: is empty
convert bad out.g2o => is no graph

{solve|explain} square.g2o --robust {dcs|huber:|geman-mcclure} => robust: '.*' is not possible; expected \w*-?\w+:NUMBER
{solve|explain} square.g2o --robust {magic:1|none} => one of huber, cauchy, .*, dcs; or none, of a mission: all c
solve square.g2o --robust {magic:1|none} => or gnc-tls\[:PROBABILITY\] or gnc-gm\[:PROBABILITY\]$
{solve|explain|stream} square.g2o --robust {huber:-1|huber:0|cauchy:nan|''} => --robust: '.*' is not possible; expected
solve square.g2o --robust huber:1 --robust cauchy:1 => --robust is given twice; expected one
solve square.g2o --robust hubre:1 => ; did you mean 'huber'\?
solve square.g2o --robust Betwen=huber => ; did you mean 'Between'\?
solve square.g2o --robust gnc-tsl => ; did you mean 'gnc-tls'\?
solve square.g2o --robust {gnc|gnc-tsl|Between=gnc-tls} => gnc-tls\[:PROBABILITY\] or gnc-gm
solve square.g2o --robust gnc-tls:{2|x|} => such as gnc-tls:0\.99
solve square.g2o --robust gnc-tls --init chordal => begins with odometry
explain square.g2o --robust gnc-tls => one of huber, .*; nls solve has gnc-tls and gnc-gm
solve chain.g2o --robust gnc-tls => no loop closures, (.|\n)*-> use a robust kernel: --robust cauchy:1$
solve graph.g2o --certify -o out.g2o {--robust huber:1|--hold x} => ^nls: certify: .
solve graph.g2o --improve --sigmas estimate => expected stated with --improve
solve square.g2o --sigmas estimate {--robust gnc-tls|-o square.g2o} => (which rejects by|replaces) the stated sigmas
solve ray.g2o --improve => ^nls: ray.g2o:10: certify: Bearing\(x0, l20\)
solve ray.g2o --certify => ^nls: ray.g2o:10: certify: Bearing\(x0, l20\)

solve m -o m => -o: 'm' is not possible; expected another folder than that of the mission
solve m -o {m/zpr.csv|m/zpr.csv/in|-|''} => -o: '.*' is not possible; expected a folder
solve m -o out.g2o => a folder: the solution of a mission is several files
solve m --to g2o => --to: 'g2o' is not possible; expected nothing
solve m --dialect g2o => dialect: 'g2o' is not possible; expected auto: m is a folder
solve m --repair-information => the format mission, which has no information matrices
solve m --robust {Nothing|}=cauchy:1 => no type, or one of those in the graph: XYH, ZPR, Pos
solve m --robust XYH=dcs => robust: 'dcs' is not possible
{solve m --covariance|solve m --json|info m --json|explain m --json} m/zpr.csv => another name: this is the input
convert m a.g2o => a.g2o: a mission cannot be written as g2o, .*; npz and json hold it, and tum or kitti its poses$
{solve damaged|info damaged|plot damaged a.png} => damaged/contacts.csv:2: 'nan' is not a number
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
    for name, text in FILES.items():
        shell.file(text, name)
    os.link(shell / "graph.g2o", shell / "hard.png")
    (shell / "soft.png").symlink_to(shell / "graph.g2o")
    (shell / "link.csv").symlink_to(shell / "out.g2o")
    folder(shell / "m")
    folder(shell / "damaged", contacts=TINY["contacts"].replace("4.7457", "nan"))
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
