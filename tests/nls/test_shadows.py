"""Packages of other programs that have the name of one of ours: one ImportError names the file and the ways out."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WAYS_OUT = ("Rename the other one", "python -P", "virtual environment")


def run(
    folder: Path, program: str, *options: str, path: str = "", name: str = "run.py"
) -> subprocess.CompletedProcess[str]:
    """A script in a folder, which is then the first place where Python looks for packages."""
    script = folder / name
    script.write_text(program)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [path, str(ROOT)]))}
    command = [sys.executable, "-W", "error", *options, str(script)]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=60)


def refusal(done: subprocess.CompletedProcess[str]) -> str:
    """The one error that a process ends with."""
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1, done.stderr
    return done.stderr[done.stderr.index("\nImportError: ") :]


@pytest.mark.parametrize(
    ("file", "first"),
    [
        ("models/__init__.py", "import nls"),
        ("models/__init__.py", "import sim"),
        ("models.py", "from factors import Between"),
        ("models/__init__.py models/errors.py", "from nls import load"),
    ],
)
def test_the_file_in_the_way_is_named_with_the_ways_out(tmp_path: Path, file: str, first: str) -> None:
    for name in file.split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    message = refusal(run(tmp_path, first))
    shadow = f"another 'models' shadows the package 'models' of leadline.\n  In the way: {tmp_path / file.split()[0]}"
    assert all(words in message for words in (shadow, str(ROOT / "models"), *WAYS_OUT))


@pytest.mark.parametrize("name", ["factors", "sim"])
def test_every_package_beside_nls_is_checked(tmp_path: Path, name: str) -> None:
    (tmp_path / f"{name}.py").touch()
    assert f"In the way: {tmp_path / name}.py (comes first on sys.path)" in refusal(run(tmp_path, "import nls"))


@pytest.mark.parametrize("first", ["import nls\nimport factors", "from factors import Between"])
def test_a_script_called_nls_is_named(tmp_path: Path, first: str) -> None:
    message = refusal(run(tmp_path, first, name="nls.py"))
    assert message.startswith(f"\nImportError: {tmp_path / 'nls.py'} has the name of the package 'nls' of leadline")


def test_the_ways_out_lead_out(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "__init__.py").touch()
    program = "import nls; nls.FactorGraph"
    assert run(tmp_path, program, "-P").returncode == 0
    (tmp_path / "models").rename(tmp_path / "networks")
    assert run(tmp_path, program).returncode == 0


def test_an_installed_package_counts(tmp_path: Path) -> None:
    other, folder = tmp_path / "site-packages", tmp_path / "work"
    (other / "models").mkdir(parents=True)
    folder.mkdir()
    (other / "models" / "__init__.py").touch()
    assert f"In the way: {other / 'models'}" in refusal(run(folder, "import nls", path=str(other)))


def test_a_package_imported_before_or_put_before_ours_later(tmp_path: Path) -> None:
    (tmp_path / "models.py").touch()
    assert "models.py (was imported before)" in refusal(run(tmp_path, "import models, nls"))
    stub = "import sys, types; sys.modules['models'] = types.ModuleType('models'); import nls"
    assert "a module without a file" in refusal(run(tmp_path, stub))
    later = "import sys; own = sys.path.pop(0); import nls; sys.path.insert(0, own); nls.load"
    assert "In the way" in refusal(run(tmp_path, later))


def test_a_folder_without_init_is_no_package_where_ours_is_found(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    assert run(tmp_path, "import nls; nls.FactorGraph").returncode == 0


def test_our_packages_under_another_name_of_their_folder_are_ours(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(ROOT, target_is_directory=True)
    program = f"import sys; sys.path.insert(0, {str(tmp_path / 'link')!r}); import factors, models; import nls"
    mixed = f"import models, sys; sys.path.insert(0, {str(tmp_path / 'link')!r}); import nls; nls.FactorGraph"
    for text in (program, mixed):
        done = run(tmp_path, text)
        assert done.returncode == 0, done.stderr
