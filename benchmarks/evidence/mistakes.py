"""Mistakes in logs of missions whose truth is known: what is named, whether it is the cause, and what its cure does.

    python benchmarks/evidence/mistakes.py [--mission NAME] [--only PATTERN] [--seeds N] [--out DIR]

Each mistake is imported and solved as a user would, by `nls import` and `nls solve`. The first cure that is printed is
followed to the letter, up to six times. With ``LEADLINE_DATA`` the clean controls have public logs, too.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import os
import re
import shutil
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
from cures import Cure, Unfollowable, cures_of
from mistake_base import Mistake
from mistake_kinds import MISTAKES
from mistake_missions import MISSIONS, Survey, toml
from script import make_page, markdown, pooled

from nls.cli import main as command
from sim.cli import main as simulated

SEEDS, CONTROLS, CURES, SHORT = 3, 20, 6, 140  # a cure for each of the tables
PATIENCE = 20.0  # s of processor time, fifty times what a right log takes: then the user presses Ctrl-C
WORSE = 1.5  # times the error of the right log: a wrong result
STATED = 3.0  # standard deviations that a result states where data of its own say a constant
SILENT, UNMEASURED, LOUD, CURED, HARMLESS = "silent", "unmeasured", "loud", "cured", "harmless"
KINDS = (SILENT, UNMEASURED, LOUD, CURED, HARMLESS)  # the worst first
ROW = re.compile(r"(\w+|max\|dx\|)  ")  # of the table of a command
MAPPINGS = Path(__file__).parents[2] / "docs" / "missions"
LOGS = "DVL", "GT"  # of an AUV
PUBLIC = {  # logs by the mapping of the documentation
    **{
        f"AUV at sea, trajectory {k}": (
            "auv-dvl",
            *(f"underwater-auv-dvl/{x}_trajectory{k}.csv" for x in ("DVL", "GT")),
        )
        for k in range(1, 8)
    },
    "HoloOcean": ("holoocean", "underwater-holoocean/underwater_data.txt.gz"),
    "Aracati": ("aracati", "aracati/keyframes.csv.gz", "aracati/truth.csv.gz"),
}
EXPLAINED = f"""\
Each mistake is made in the logs of missions with a known truth; `nls import` and `nls solve` read these logs.
The first printed cure is followed to the letter, at most {CURES} times. The table shows the worst of the seeds.

- dive: DVL, AHRS and depth, 720 m; GPS in the first and the last 6 s.
- usbl: as dive, with a ship that measures range, bearing and elevation every 4 s.
- rov: compass, depth and positions every 2 s, without a DVL.
- Error: root mean square of the positions over the track, against the truth.
- harmless: exit status 0, no cure, and an error within {WORSE} times that of the right log or, where larger, its stated
  sigma or that of the result. cured: harmless after a cure, or an error within {STATED:.0f} of the then stated sigmas.
- still loud: another exit status, or no answer in {PATIENCE:.0f} s. silent: exit status 0, a larger error. unmeasured:
  silent, but the answer says that no measurement checks this quantity of this table, or no error of this size.
- If the answer lists causes that no measurement tells apart, the true cause counts: a look at the vehicle decides.
- Cause right: the first answer names the wrong column or constant and its error. Named and right leave out harmless
  and unmeasured mistakes."""


@dataclass(frozen=True)
class Answer:
    """What the program said: its exit status, and its lines."""

    status: int
    lines: list[str]

    @property
    def statements(self) -> list[str]:
        """Lines that say what is wrong, or what to do: of the rows of the table those with a cure or a cause."""
        said = [line for line in self.lines if line.strip()]
        return [line for line in said if not ROW.match(line) or cures_of(line) or "explains chi2" in line]

    @property
    def unchecked(self) -> dict[str, float]:
        """Quantities of tables that nothing checks, such as ``depth of depth.csv``, up to which size."""
        said = next((line for line in self.lines if line.startswith("unchecked ")), "").partition(" the ")[2]
        tables = [table.partition(":")[0].rpartition(" of ")[::2] for table in said.split("; ")]
        named = [(name.removeprefix("the "), file) for names, file in tables for name in names.split(", the ")]
        sizes = {name: (re.findall(r"below (\S+)", name) or ["inf"])[0] for name, _ in named}
        return {f"{name.partition(' (')[0]} of {file}": float(sizes[name]) for name, file in named}

    def misses(self, mistake: Mistake) -> bool:
        """True where the answer says that nothing checks what is wrong, or nothing as small as that."""
        return any(below > mistake.size for what, below in self.unchecked.items() if what in mistake.quantities)

    @property
    def alarm(self) -> bool:
        return self.status != 0 or any("implausible" in line for line in self.lines)


def quietly(act: Callable[[list[str]], int], words: list[str]) -> Answer:
    """The answer of a command line in this process."""
    said = io.StringIO()
    pictures = patch("nls.plot.picture.write_picture")  # three quarters of the time, and none is looked at
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), pictures:
        signal.setitimer(signal.ITIMER_PROF, PATIENCE)
        try:
            status = act(words)
        except SystemExit as end:
            status = int(end.code or 0)
        except KeyboardInterrupt:
            status = 130
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
    return Answer(status, said.getvalue().splitlines())


def asked(*words: str) -> Answer:
    """The answer of `nls`."""
    return quietly(command, list(words))


@dataclass
class Run:
    """One log on its way: its mapping as edited, the edits of its tables, options, what was said and the error."""

    survey: Survey
    folder: Path
    edits: list[Cure] = field(default_factory=list)
    options: list[str] = field(default_factory=list)
    answer: Answer = field(default_factory=lambda: Answer(0, []))
    error: float = np.nan
    sigma: float = np.nan

    def solve(self) -> None:
        """Import and solve, in the folder."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        logs = self.survey.write(self.folder)
        for cure in [cure for cure in self.edits if cure.of_log]:
            cure.edit(self.folder)
        self.error = self.sigma = np.nan
        with contextlib.chdir(self.folder):
            imported = asked("import", *logs, "--map", "map.toml", "-o", "mission")
            self.answer = imported
            if imported.status:
                return
            for cure in [cure for cure in self.edits if not cure.of_log]:
                cure.edit(self.folder / "mission")
            solved = asked("solve", "mission", "-o", "solved", *self.options)
        self.answer = Answer(solved.status, imported.lines + solved.lines)
        if (track := self.folder / "solved" / "trajectory.csv").exists():
            self.error, self.sigma = self.survey.error(track, self.folder / "mission" / "origin.csv")

    def follow(self, cure: Cure) -> None:
        """Take a cure."""
        if cure.of_mapping:
            cure.map(self.survey.mapping, toml(self.survey.mapping))
        elif cure.form == "option":
            self.options += ["--robust", str(cure.words[0])]
        else:
            self.edits.append(cure)


@dataclass(frozen=True)
class Verdict:
    """Of one mistake in one mission of one seed."""

    mission: str
    mistake: str
    seed: int
    kind: str  # of `KINDS`
    named: bool
    right: bool
    clean: float
    before: float
    after: float
    status: int
    cures: tuple[str, ...]
    said: str

    @property
    def cells(self) -> tuple[str, ...]:
        """Of the list."""
        cure = "; then ".join(f"`{cure}`" for cure in self.cures) or self.said[:SHORT].replace("`", "")
        cause = "right" if self.right else "wrong" if self.named else ""
        return self.mistake, self.kind, cause, cure.replace("|", "\\|"), meters(self.before), meters(self.after)


def meters(error: float) -> str:
    return f"{error:.3g}" if np.isfinite(error) else ""


def solved(survey: Survey, folder: Path) -> Run:
    """A log as it is."""
    run = Run(survey, folder)
    run.solve()
    return run


def tried(mistake: Mistake, clean: Run, seed: int, folder: Path) -> Verdict:
    """Make a mistake, and follow the cures."""
    survey = MISSIONS[clean.survey.mission](seed)
    mistake.spoil(survey)
    run = solved(survey, folder)
    first, before, followed = run.answer, run.error, list[str]()
    for _ in range(CURES):
        chosen = next(iter(choices(run.answer.statements, mistake, followed)), None)
        if chosen is None:
            break
        followed.append("; ".join(plain(cure) for cure in chosen))
        try:
            for cure in chosen:
                run.follow(cure)
            run.solve()
        except Unfollowable as error:
            followed[-1] += f": cannot be followed, {error}"
            break
    said = first.statements
    right = first.alarm and any(re.search(pattern, line, re.I) for pattern in mistake.right for line in said)
    arms = [float(word) for line in first.statements for word in re.findall(r"\+- (\S+) m too", line)]
    stated = float(np.hypot(run.sigma, max(arms, default=0.0)))  # an arm is known as well as it was said to be
    within = run.error <= max(WORSE * max(clean.error, clean.sigma, stated), STATED * stated * bool(followed))
    wrong = UNMEASURED if run.answer.misses(mistake) else SILENT
    kind = LOUD if run.answer.status else wrong if not within else CURED if followed or first.status else HARMLESS
    numbers = (clean.error, before, run.error)
    words = tuple(followed), " / ".join(said)
    return Verdict(survey.mission, mistake.name, seed, kind, first.alarm, right, *numbers, run.answer.status, *words)


def choices(statements: Iterable[str], mistake: Mistake, followed: Sequence[str]) -> Iterator[list[Cure]]:
    """Cures that were not followed yet: of several causes that of the one that was made first, if it is there."""
    causes = [line.split("; or ") for line in statements]
    several = [part for parts in causes if len(parts) > 1 for part in parts]
    made = [part for part in several if any(re.search(pattern, part, re.I) for pattern in mistake.right)]
    for part in [*made, *itertools.chain(*causes)]:
        cures = cures_of(part.partition(", or ")[0]) or cures_of(part)[:1]
        if cures and "; ".join(map(plain, cures)) not in followed:
            yield cures


def plain(cure: Cure) -> str:
    return cure.text.replace("`", "")


def without_mistake(data: Path | None, seeds: int, folder: Path) -> Iterator[tuple[str, int, int, str]]:
    """Logs without a mistake: name, how many, alarms and what they say."""
    for name in MISSIONS:
        runs = [solved(MISSIONS[name](seed), folder) for seed in range(seeds)]
        rms = [np.sqrt(np.mean(np.square([getattr(run, what) for run in runs]))) for what in ("error", "sigma")]
        said = f"error {rms[0]:.2f} m, stated {rms[1]:.2f} m (root mean squares)"
        yield f"simulated: {name}", len(runs), sum(run.answer.alarm for run in runs), said
    for world in ("hauv-floor", "hauv-hull"):
        quietly(simulated, [world, "--seed", "1", "--out", str(folder / world)])
        yield judged(f"simulated: {world}", asked("solve", str(folder / world)))
    if data is None:
        return
    for name, (mapping, *logs) in PUBLIC.items():
        target = str(folder / "public" / mapping / name)
        paths = (str(data / log) for log in logs)
        answer = asked("import", *paths, "--map", str(MAPPINGS / f"{mapping}.toml"), "-o", target)
        yield judged(name, answer if answer.status else asked("solve", target))


def judged(name: str, answer: Answer) -> tuple[str, int, int, str]:
    """The row of one control."""
    return name, 1, int(answer.alarm), " / ".join(answer.statements)[:200] if answer.alarm else ""


def verdicts(missions: Iterable[str], only: str, seeds: int, jobs: int) -> list[Verdict]:
    """Of all mistakes in some missions and seeds."""
    pairs = zip(*itertools.product(missions, range(seeds), [only]), strict=True)
    return [verdict for given in pooled(jobs, verdicts_of, *pairs) for verdict in given]


def verdicts_of(mission: str, seed: int, only: str) -> list[Verdict]:
    """Of all mistakes in one mission."""
    signal.signal(signal.SIGPROF, signal.default_int_handler)
    out: list[Verdict] = []
    with TemporaryDirectory() as name:
        clean = solved(MISSIONS[mission](seed), Path(name, "clean"))
        for mistake in [m for m in possible(clean.survey) if re.search(only, m.name)]:
            out.append(tried(mistake, clean, seed, Path(name, "spoiled")))
            print(f"{mission} {seed}: {' | '.join(out[-1].cells)}", flush=True)
    return out


def possible(survey: Survey) -> list[Mistake]:
    """Mistakes that its logs can have; where there is a ship, every third of those that a dive has, too."""
    own, others = list[Mistake](), list[Mistake]()
    for mistake in MISTAKES:
        if mistake.table in ("", *survey.logs):
            (own if mistake.table in ("usbl", "ship") else others).append(mistake)
    return others[:: 3 if own else 1] + own


def worst(of_mistake: Sequence[Verdict]) -> Verdict:
    """The worst of the seeds: the most silent, then the one whose cause is wrong."""
    return min(of_mistake, key=lambda v: (KINDS.index(v.kind), v.right, -v.after))


def summary(by_mission: Mapping[str, Sequence[Verdict]]) -> list[str]:
    """A row a mission."""
    rows = []
    for mission, given in by_mission.items():
        kinds = Counter(v.kind for v in given)
        harm = [v for v in given if v.kind not in (HARMLESS, UNMEASURED)]
        named, right = sum(v.named for v in harm), sum(v.right for v in harm)
        rows.append((mission, len(given), named, right, *(kinds[kind] for kind in KINDS[::-1])))
    titles = ("mission", "mistakes", "named", "cause right", "harmless", "cured", "still loud", UNMEASURED, "silent")
    return markdown(titles, rows)


def tables(given: Sequence[Verdict], clean: Iterable[tuple[str, int, int, str]]) -> list[str]:
    """Mistakes by mission, and controls."""
    by_mission: dict[str, list[Verdict]] = {}
    for mission in dict.fromkeys(v.mission for v in given):
        of_mission = [v for v in given if v.mission == mission]
        names = dict.fromkeys(v.mistake for v in of_mission)
        by_mission[mission] = [worst([v for v in of_mission if v.mistake == name]) for name in names]
    lines = [*summary(by_mission), EXPLAINED, "## Logs without a mistake"]
    rows = [(*numbers, said.replace("|", "\\|")) for *numbers, said in clean]
    lines += markdown(("log", "missions", "alarms", "remarks"), rows)
    for mission, worsts in by_mission.items():
        titles = ("mistake", "verdict", "cause", "cure as printed, or what was said", "error before, m", "after, m")
        lines += [f"## {mission}", *markdown(titles, (v.cells for v in worsts), names=4)]
    return lines


def page(mission: str | None, only: str, seeds: int, controls: int, jobs: int) -> list[str]:
    """The page without its head."""
    signal.signal(signal.SIGPROF, signal.default_int_handler)
    began = time.monotonic()
    given = verdicts([mission] if mission else MISSIONS, only, seeds, jobs)
    data = Path(folder) if (folder := os.environ.get("LEADLINE_DATA")) else None
    with TemporaryDirectory() as name:
        clean = list(without_mistake(data, controls, Path(name)))
    minutes = (time.monotonic() - began) / 60
    return [f"- `python {' '.join(sys.argv)}`, {minutes:.0f} min in {jobs} processes", *tables(given, clean)]


if __name__ == "__main__":
    make_page(
        *("Mistakes in logs", page),
        mission={"choices": MISSIONS, "help": "one of them alone"},
        only={"default": "", "metavar": "PATTERN", "help": "mistakes whose name has this regular expression"},
        seeds=(SEEDS, "of every mission"),
        controls=(CONTROLS, "clean missions of each kind"),
        jobs=(2, "processes"),
    )
